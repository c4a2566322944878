"""The user's own MODTRAN: its input for a state, its runs, and the terms of equation 3.7 from its output.

``HYPERVAL_MODTRAN`` names the executable, ``HYPERVAL_MODTRAN_VERSION`` says 4, 5 or 6 (default 6), and
``HYPERVAL_MODTRAN_DATA`` the DATA folder of versions 4 and 5 (default: beside the executable).

Input is ``tape5`` of versions 4 and 5, with columns as in the manuals (MODTRAN4 v3r1, MODTRAN 5.2.2; column 51 of
card 1A belongs to SOLCON there, and real decks have a flag in it), or the JSON of version 6.

Output is a channel file (``.chn``) or spectral output (``tape7``, ``.tp7``) in radiance mode.  Fields of ``tape7`` can
be blank, so rows are cut at columns, never at spaces; its radiance is per wavenumber, W cm-2 sr-1 / cm-1.

Over uniform ground of reflectance rho (3.7 with rho_m = rho_ave = rho)

    ground(rho) = A rho / (1 - S rho)            GRND_RFLT
    path(rho)   = L_a + B rho / (1 - S rho)      SOL_SCAT, which holds SING_SCAT already

so rho / ground = 1/A - (S/A) rho is a straight line: two albedos above 0 give A and S, the black run gives L_a, the
brightest B.  DRCT_RFLT / GRND_RFLT tells the sun from the sky.  Emission (PTH_THRML, SURF_EMIS) is part of L_a, as the
black run has it.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import solar
from hyperval.atmosphere.state import AerosolMix, AtmosphericState, range_from_aot550
from hyperval.atmosphere.terms import Arrays, AtmosphericTerms, cached, run_program
from hyperval.data import Array, Mask
from hyperval.errors import package_table, reader, refusal, refuse
from hyperval.paths import read_text
from hyperval.progress import track
from hyperval.storage import last_line, number_of, scratch_folder, sha256_of
from hyperval.units import radiance_per_wavelength, to_internal

MAX_BYTES = 256 << 20
_RADIANCE = to_internal("W cm-2 sr-1 nm-1", "radiance")
_TABLE = package_table("atmosphere/modtran.yaml")
RADIANCE_COLUMNS = tuple(_TABLE["tape7"]["names"])
TOTAL_PARTS = ("thermal", "path", "ground")  # of the total radiance
_WIDTH_STEP_NM = 1e-4  # four decimals of a width are printed
_MIN_RADIANCE = 1e-28  # in the unit of the file: below the range of its exponent's digits nothing adds up
_SURREF = slice(73, 80)


_Layout = dict[str, Any]  # how one kind of output is written: modtran.yaml says what stands where
_TAPE7, _CHANNELS = _TABLE["tape7"], _TABLE["channels"]


@dataclass(frozen=True)
class _Table:
    """One table of a file: the lines before it, and its columns, NaN where blank."""

    path: Path
    line: int  # of the heading
    head: list[str]
    columns: dict[str, Array]

    def refuse(self, wrong: Mask, name: str, **values: Any) -> None:
        """Raise the error of a name where rows are wrong, at the first of them; of columns their numbers are told."""
        where = f"{self.path}:{self.line + int(np.argmax(wrong)) + 1}"
        of_rows = {key: value[wrong] if isinstance(value, np.ndarray) else value for key, value in values.items()}
        refuse(wrong.any(), name, where, **of_rows)

    def radiances(self, layout: _Layout, converted: Callable[[Array], Array]) -> dict[str, Any]:
        """The radiances of a run, converted; 0 where the file is blank: a term that the run did not compute."""
        added = {name: sum(np.nan_to_num(self.columns[c]) for c in columns) for name, columns in layout["sums"].items()}
        total, together = np.asarray(added["radiance"]), np.asarray(sum(added[part] for part in TOTAL_PARTS))
        wrong = np.abs(total - together) > layout["rounding"] * np.abs(total) + _MIN_RADIANCE
        parts = " + ".join(column for part in TOTAL_PARTS for column in layout["sums"][part])
        self.refuse(wrong, "modtran.sum", layout=layout, parts=parts, total=total, sum=together)
        return {name: converted(np.asarray(values)) for name, values in added.items()}


def _tables(path: Path, layout: _Layout) -> list[_Table]:
    """All tables of a file; raises InputError where it holds none, or one that is cut short."""
    tables: list[_Table] = []
    ends, head, rows, heading, number = list[int](), list[str](), list[list[float]](), 0, 0
    for number, line in enumerate([*read_text(path, MAX_BYTES).splitlines(), ""], 1):
        where = f"{path}:{number}"
        if not ends and not re.match(layout["heading"], line):
            head.append(line)
        elif not ends:
            other, names = not re.fullmatch(layout["columns"], line.strip()), " ".join(line.split()[:6])
            refuse(other, "modtran.columns", where, names=names, wanted=layout["what"])
            # A name ends where its column ends, so that the widths of another release show in the heading.
            ends, heading = [m.end() for m in re.finditer(r"\S+", line)][: len(layout["names"])], number
        elif not re.match(layout["end"], line):
            rows.append(_row(line, ends, where, layout["blank"]))
        else:
            refuse(not rows, "modtran.no_rows", f"{path}:{heading}", wanted=layout["what"])
            tables.append(_Table(path, heading, head, dict(zip(layout["names"], np.array(rows).T, strict=True))))
            ends, head, rows = [], [], []
    refuse(ends, "modtran.no_end", f"{path}:{heading}")
    refuse(not tables, "modtran.no_table", path, wanted=layout["what"])
    refuse(any(line.strip() for line in head), "modtran.no_case", f"{path}:{number - len(head) + 1}")
    return tables


def _row(line: str, ends: list[int], where: str, blank: float | None) -> list[float]:
    """The numbers of one row, cut at the given column ends."""
    short, surplus = blank is None and len(line) < ends[-1], blank is not None and line[ends[-1] :].strip()
    refuse(short, "modtran.short", where, found=len(line), wanted=ends[-1])
    refuse(surplus, "modtran.beyond", where, last=ends[-1], count=len(ends))
    values = []
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        text = line[start:end].strip()
        value = blank if blank is not None and not text else number_of(text)
        wrong = (text or blank is None) and not np.isfinite(value)
        refuse(wrong, "modtran.number", where, text=text, first=start + 1, last=end)
        values.append(value)
    return values


class Coefficients(NamedTuple):
    """A, B and S: (n,) each, A and B in the unit of the radiances, or over mu0 E0 / pi where a file prints them."""

    direct: Array
    adjacency: Array
    spherical_albedo: Array


@dataclass(frozen=True)
class ModtranRun:
    """What MODTRAN wrote of one run over uniform ground: a case of tape7, or a table of a channel file.

    Attributes
    ----------
    where : file and line of the heading
    columns : name -> (n,) as in the file, NaN where blank
    albedo : reflectance of the ground; NaN where it cannot be told
    wavelength_nm : (n,) increasing samples, or spectral moments of channels [nm]
    radiance : (n,) total radiance [uW cm-2 sr-1 nm-1], the sum of the next three
    thermal : (n,) emitted part of it (path emission, path scatter, surface) [same]
    path : (n,) solar radiance scattered into the path, from ground of this reflectance too [same]
    ground : (n,) radiance of the viewed ground [same]
    ground_of_sun : (n,) part of it that the direct sun lights [same]
    sun : (n,) that of the top of the atmosphere; of channels mu0 E0 / pi [same]
    transmittance : (n,) ground to sensor, direct [1]
    width_nm : (n,) equivalent widths of channels [nm]; None: samples
    printed : the coefficients that a channel file prints
    """

    where: str
    columns: dict[str, Array]
    albedo: float
    wavelength_nm: Array
    radiance: Array
    thermal: Array
    path: Array
    ground: Array
    ground_of_sun: Array
    sun: Array
    transmittance: Array
    width_nm: Array | None = None
    printed: Coefficients | None = None


@reader
def read_tape7(path: Path) -> list[ModtranRun]:
    """All cases of a ``tape7`` or ``.tp7`` file, packed or not.

    Raises
    ------
    InputError : missing, too large, not a tape7, a row that does not fit its columns, radiances that do not
        sum up to TOTAL_RAD, or no end mark (with file:line).
    """
    return [_tape7_run(table) for table in _tables(Path(path), _TAPE7)]


def _tape7_run(table: _Table) -> ModtranRun:
    nu, emissivity = table.columns["FREQ"], table.columns["DIR_EM"]
    table.refuse(~(np.diff(nu, prepend=-np.inf) > 0), "modtran.wavenumber", value=nu)
    albedo = number_of(table.head[0][_SURREF]) if table.head else np.nan
    if not 0.0 <= albedo <= 1.0:
        constant = np.all(np.isfinite(emissivity)) and np.ptp(emissivity) <= 1e-4
        albedo = round(float(1.0 - np.median(emissivity)), 4) if constant else np.nan
    return ModtranRun(
        f"{table.path}:{table.line}", table.columns, albedo, wavelength_nm=1e7 / nu[::-1],
        transmittance=np.nan_to_num(table.columns["TOT_TRANS"])[::-1],
        **table.radiances(_TAPE7, lambda values: radiance_per_wavelength(values, nu)[::-1]),
    )  # fmt: skip


@reader
def read_channels(path: Path) -> list[ModtranRun]:
    """All tables of a channel file, ``.chn`` or ``.chn.gz``, in their order.

    Raises
    ------
    InputError : missing, too large, not such a file, a row that contradicts itself, channels missing between the
        first and the last, tables of different length, or a last line that is cut off.
    """
    tables = _tables(Path(path), _CHANNELS)
    sizes = [table.columns["channel"].size for table in tables]
    for table, size in zip(tables, sizes, strict=True):
        refuse(size != sizes[0], "modtran.size", f"{path}:{table.line + size}", size=size, first=sizes[0])
    return [_channel_run(table) for table in tables]


def _channel_run(table: _Table) -> ModtranRun:
    t = table.columns
    width, number, total = t["width in nm"], t["channel"], t["channel radiance"]
    following, product = np.arange(1.0, number.size + 1), t["radiance per nm"] * width
    table.refuse(width <= 0.0, "modtran.width", width=width)
    table.refuse(number != following, "modtran.channel", found=number, wanted=following)
    rounding = _CHANNELS["rounding"] * np.abs(total) + np.abs(t["radiance per nm"]) * _WIDTH_STEP_NM
    table.refuse(np.abs(product - total) > rounding, "modtran.product", total=total, product=product)
    # Sensors with overlapping spectrometers list their channels out of order.
    order = np.argsort(t["spectral moment"], kind="stable")
    radiances = table.radiances(_CHANNELS, lambda values: (values / width * _RADIANCE)[order])
    printed = Coefficients(*(t[name][order] for name in "ABS"))
    # A channel file does not state the ground: its light is F A rho / (1 - S rho).
    full = radiances["sun"] * printed.direct
    bright = full > 0.05 * full.max()
    ratio = radiances["ground"][bright] / full[bright]
    albedos = ratio / (1.0 + printed.spherical_albedo[bright] * ratio)
    return ModtranRun(
        f"{table.path}:{table.line}", t, float(np.median(albedos)) if bright.any() else 0.0,
        wavelength_nm=t["spectral moment"][order], transmittance=t["path transmittance"][order],
        width_nm=width[order], printed=printed, **radiances,
    )  # fmt: skip


_OF_THE_RUNS = {"solar_spectrum": "of the MODTRAN run", "emission": "of the black run, part of the path radiance"}
MAX_ALBEDO_OF_AIR = 0.9  # a spherical albedo beyond it is rounding of a ground radiance near zero
_MIN_TRANSMITTANCE = 1e-4
_LINES_NM = 4.0  # resolved lines: a window's level is the largest value this close to it
_FWHM_PER_WIDTH = 2.0 * np.sqrt(np.log(2.0) / np.pi)  # 0.9394, a Gaussian of that equivalent width
# Places between absorption bands where a channel's transmittance is scattering alone, nearly.
_CONTINUUM_NM = (412.0, 443.0, 490.0, 670.0, 780.0, 865.0, 1040.0, 1240.0, 1640.0)


def solve_coefficients(
    albedos: Sequence[float], ground: npt.ArrayLike, path: npt.ArrayLike, spherical_albedo: Array | None = None
) -> Coefficients:
    """A, B and S that reproduce the runs (3.7 over uniform ground).

    Parameters
    ----------
    albedos : reflectance of each run: one 0, and two different ones above it; the least and the greatest of these
        are reproduced exactly, others are left as a check
    ground, path : (runs, n) ground-reflected and scattered radiance, any one unit
    spherical_albedo : (n,) taken where no light is reflected; None: interpolated from where it is

    Raises
    ------
    UsageError : albedos that do not determine the terms.
    """
    rho, ground_radiance, scattered = list(albedos), np.asarray(ground, dtype=float), np.asarray(path, dtype=float)
    positive = {a for a in rho if a > 0.0}
    refuse(len(rho) != len(ground_radiance), "modtran.albedos", albedos=len(rho), runs=len(ground_radiance))
    few = rho.count(0.0) != 1 or len(positive) < 2 or len(positive) != len(rho) - 1 or max(rho) > 1.0
    refuse(few, "modtran.few", albedos=rho)
    black, low, high = (rho.index(r) for r in (0.0, min(positive), max(rho)))
    lit = (ground_radiance[low] > 0.0) & (ground_radiance[high] > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        at_low, at_high = rho[low] / ground_radiance[low], rho[high] / ground_radiance[high]
        slope = (at_high - at_low) / (rho[high] - rho[low])  # -S/A
        s = -slope / (at_low - slope * rho[low])  # over 1/A
    valid = lit & np.isfinite(s) & (s > -0.01) & (s < MAX_ALBEDO_OF_AIR)
    elsewhere = _of_neighbours(s, valid) if spherical_albedo is None else spherical_albedo
    s = np.maximum(np.where(valid, s, elsewhere), 0.0)
    from_bright = (1.0 - s * rho[high]) / rho[high]
    return Coefficients(ground_radiance[high] * from_bright, (scattered[high] - scattered[black]) * from_bright, s)


def _of_neighbours(values: Array, valid: Mask) -> Array:
    """The values, where they are not known straight between those that are; 0 where none is."""
    index = np.arange(values.size)
    return np.interp(index, index[valid], values[valid]) if valid.any() else np.zeros(values.size)


def terms_from_runs(runs: Sequence[ModtranRun], albedos: Sequence[float] | None = None) -> AtmosphericTerms:
    """Terms that reproduce runs which differ in nothing but the ground.

    At the channels of a channel file they follow from its radiances instead of the printed coefficients; the printed
    spherical albedo is used where no light is reflected.

    Parameters
    ----------
    albedos : ground reflectance of each run; None: what the runs say, of channels to 0.01

    Raises
    ------
    UsageError : albedos unknown or insufficient.
    InputError : runs of different wavelengths.
    """
    for run in runs:
        refuse(not np.array_equal(run.wavelength_nm, runs[0].wavelength_nm), "modtran.unlike", run.where)
    stated = [round(run.albedo, 2) if run.printed else run.albedo for run in runs] if albedos is None else albedos
    rho, printed = [float(a) for a in stated], runs[0].printed
    found = solve_coefficients(
        rho, [run.ground for run in runs], [run.path for run in runs], printed and printed.spherical_albedo
    )
    black, bright = runs[rho.index(0.0)], runs[rho.index(max(rho))]
    with np.errstate(divide="ignore", invalid="ignore"):
        efficiency = np.where(black.sun > 0.0, found.direct / black.sun, 0.0)
        share = bright.ground_of_sun / max(rho) / found.direct
    where = [run.where for run in runs]
    provenance = {"engine": "MODTRAN", "solved_from": where, "albedos": rho, **_OF_THE_RUNS}
    terms = _terms(black, found, black.path + black.thermal, efficiency, provenance)
    # The sky's part of the irradiance of black ground; in the dark that of the neighbours.
    valid = np.isfinite(share)
    sky = np.clip(1.0 - _of_neighbours(share, valid), 0.0, 1.0) if valid.any() else np.zeros(valid.size)
    return replace(terms, diffuse_fraction=sky)


def _terms(
    run: ModtranRun, found: Coefficients, path_radiance: Array, efficiency: Array, provenance: dict[str, Any]
) -> AtmosphericTerms:
    """Terms at the wavelengths of a run; ``efficiency`` is A over the sun, the rest that of black ground.

    The ground irradiance is pi A / (direct transmittance of the path) [uW cm-2 nm-1], NaN where the path is opaque.
    """
    opaque, width = run.transmittance <= _MIN_TRANSMITTANCE, run.width_nm
    return AtmosphericTerms(
        wavelength_nm=run.wavelength_nm,
        path_radiance=path_radiance,
        **found._asdict(),
        ground_irradiance=np.pi * found.direct / np.where(opaque, np.nan, run.transmittance),
        gas_transmittance=over_continuum(run.wavelength_nm, efficiency, _LINES_NM if width is None else 0.0),
        provenance=provenance,
        fwhm_nm=None if width is None else _FWHM_PER_WIDTH * width,
        diffuser_radiance=None if width is None else run.sun,
    )


def read_modtran_runs(paths: Sequence[Path], albedos: Sequence[float] | None = None) -> AtmosphericTerms:
    """Terms from the output of several runs: a channel file of several tables, or tape7 files of one or more cases.

    Raises
    ------
    InputError, UsageError : as :func:`read_tape7`, :func:`read_channels` and :func:`terms_from_runs`.
    """
    refuse(not paths, "modtran.none")
    read = [read_channels if Path(p).name.removesuffix(".gz").endswith(".chn") else read_tape7 for p in paths]
    return terms_from_runs([run for runs, path in zip(read, paths, strict=True) for run in runs(path)], albedos)


@reader
def read_chn(path: Path) -> AtmosphericTerms:
    """Terms at the channels of a MODTRAN ``.chn`` (or ``.chn.gz``) file, from the coefficients that it prints.

    Over bright ground they fall short of the radiance in the same file by up to 1 % in all (A 0.1-0.6 %, B 2-9 %):
    of three runs and more :func:`read_modtran_runs` gives terms that reproduce them.

    The run with the darkest ground gives the path radiance: emission and path radiance less what uniform ground
    adds to it.  The terms are channel averages; the file
    holds no gas transmittance apart from scattering, so ``gas_transmittance`` is the coefficient A over
    its continuum through the windows: good for sorting windows from absorption, no more.

    Raises
    ------
    InputError : missing, not a channel file, a row that does not fit its columns (with file:line).
    """
    runs = read_channels(path)
    run = min(runs, key=lambda r: r.albedo)
    assert run.printed is not None  # noqa: S101 - of a channel file
    efficiency, b, s = run.printed
    added = run.sun * b * run.albedo / (1.0 - s * run.albedo)
    provenance = {"engine": "MODTRAN", "file": str(path), "blocks": len(runs)}
    found = Coefficients(run.sun * efficiency, run.sun * b, s)
    return _terms(run, found, run.thermal + run.path - added, efficiency, provenance)


def over_continuum(wavelength_nm: Array, coefficient: Array, reach_nm: float = 0.0) -> Array:
    """A coefficient over its continuum through the windows, 0-1; (n,), a stand-in for gas transmittance.

    ``reach_nm`` takes the largest value within that distance of a window, for spectra with resolved lines.
    """
    inside = [w for w in _CONTINUUM_NM if wavelength_nm[0] <= w <= wavelength_nm[-1]]
    level = np.interp(inside, wavelength_nm, coefficient)
    if reach_nm > 0.0:
        level = np.array([coefficient[np.abs(wavelength_nm - w) <= reach_nm].max(initial=0.0) for w in inside])
    if not inside:
        inside, level = [wavelength_nm[0]], coefficient.max(keepdims=True)
    continuum = np.exp(np.interp(np.log(wavelength_nm), np.log(inside), np.log(np.maximum(level, 1e-30))))
    return np.asarray(np.clip(coefficient / continuum, 0.0, 1.0))


ALBEDOS = (0.0, 0.1, 0.5)  # of the uniform ground of the runs: enough for A, B, S and L_a
_EARTH_RADIUS_KM = 6371.23

MODELS, HAZES, FIELDS = (_TABLE[name] for name in ("models", "hazes", "fields"))


def _haze(state: AtmosphericState) -> tuple[int, str]:
    """IHAZE of the card and of the JSON input: none where there is no aerosol, since a range of 0 is a default."""
    kind = "a mix" if isinstance(state.aerosol, AerosolMix) else state.aerosol
    refuse(kind not in HAZES, "modtran.aerosol", name=kind, known=", ".join(HAZES))
    number, word = HAZES[kind if state.aerosol_optical_depth > 0.0 else "none"]
    return int(number), str(word)


def _angles(state: AtmosphericState) -> tuple[float, float, float]:
    """Zenith of the line of sight at the sensor (180: nadir), zenith of the sun, its azimuth less the sensor's.

    A straight line over a round Earth, without refraction; the sun's angles are those at the ground.
    """
    zenith, azimuth = state.sun
    sine = np.sin(np.deg2rad(state.view_zenith_deg)) * (
        (_EARTH_RADIUS_KM + state.ground_altitude_km) / (_EARTH_RADIUS_KM + state.sensor_altitude_km)
    )
    return 180.0 - float(np.rad2deg(np.arcsin(sine))), zenith, (azimuth - state.view_azimuth_deg) % 360.0


def _day(state: AtmosphericState) -> int:
    """Day of the year; for a stated distance the day of the first half-year that has it."""
    if state.day_of_year is not None:
        return state.day_of_year
    if state.time_utc is not None:
        return solar.parse_utc(state.time_utc).timetuple().tm_yday
    distance = state.distance_au
    return min(range(4, 186), key=lambda day: abs(solar.distance_on_day(day) - distance))


def tape5(state: AtmosphericState, version: int = 5) -> str:
    """The deck: one case for each albedo of ``ALBEDOS``, radiance with the sun, from the ground to the sensor.

    Parameters
    ----------
    state : atmosphere, sun and sensor
    version : 4 or 5, which differ in cards 1, 1A and 4.  Version 4 takes the aerosol as meteorological range (the
        LOWTRAN rule), version 5 as optical depth at 550 nm

    Raises
    ------
    UsageError : an unknown version, or a state that MODTRAN cannot be told.
    """
    refuse(version not in (4, 5), "modtran.cards", version=version)
    view, sun, azimuth = _angles(state)
    haze, depth, ground_km = _haze(state)[0], state.aerosol_optical_depth, state.ground_altitude_km
    amount = (-depth if version == 5 else range_from_aot550(depth, ground_km)) if haze else 0.0
    fields = {
        "model": MODELS[state.model][0], "haze": haze, "amount": amount, "ground": ground_km, "day": _day(state),
        "water": _amount("g", state.water_vapour_g_cm2), "ozone": _amount("a", state.ozone_atm_cm),
        "sensor": state.sensor_altitude_km, "view": view, "azimuth": azimuth, "sun": sun,
    }  # fmt: skip
    cards = _TABLE["cards"][version]
    return "".join(cards.format(albedo=albedo, more=int(albedo != ALBEDOS[-1]), **fields) for albedo in ALBEDOS)


def _amount(unit: str, value: float | None) -> str:
    """Ten columns: the unit's letter and the amount; blank keeps the model's own."""
    return " " * 10 if value is None else f"  {unit}{value:7.5f}"


def modtran6_json(state: AtmosphericState) -> str:
    """The input of MODTRAN 6: one case for each albedo of ``ALBEDOS``, all under one name and so in one output.

    Raises
    ------
    UsageError : a state that MODTRAN cannot be told.
    """
    (view, sun, azimuth), (haze, word) = _angles(state), _haze(state)
    stated: dict[str, dict[str, Any]] = {
        "ATMOSPHERE": {"MODEL": MODELS[state.model][1]}, "SURFACE": {"SURREF": 0.0},
        # A negative range is an optical depth at 550 nm.
        "AEROSOLS": {"IHAZE": word} | ({"VIS": -state.aerosol_optical_depth} if haze else {}),
        "GEOMETRY": {"OBSZEN": view, "IDAY": _day(state), "PARM1": azimuth, "PARM2": sun},
    }  # fmt: skip
    for field, (section, key, of_unit, unit) in FIELDS.items():
        if getattr(state, field) is not None:
            stated[section] |= {key: getattr(state, field)} | ({of_unit: unit} if unit else {})
    fixed = _TABLE["input"]
    sections = {section: fixed.get(section, {}) | stated.get(section, {}) for section in (*stated, *fixed)}
    grounds = [sections["SURFACE"] | {"SURREF": albedo} for albedo in ALBEDOS]
    cases = [
        {"NAME": _NAME, "DESCRIPTION": "", "CASE": number, **sections, "SURFACE": ground}
        for number, ground in enumerate(grounds)
    ]
    return json.dumps({"MODTRAN": [{"MODTRANINPUT": case} for case in cases]}, indent=2) + "\n"


_MAX_BYTES = 16 << 20
_NADIR_DEG = 0.5  # a line of sight this close to the vertical is one
_COMMON_YEAR = 2018  # the input has a day of the year and no year


@reader
def read_modtran_json(path: Path) -> list[dict[str, Any]]:
    """The MODTRANINPUT of every case of a MODTRAN 6 JSON input file.

    Raises
    ------
    InputError : missing, too large, not JSON, or not MODTRAN input.
    """
    document = json.loads(read_text(path, _MAX_BYTES))
    cases: Any = document.get("MODTRAN") if isinstance(document, dict) else None
    refuse(not isinstance(cases, list) or not cases, "modtran.no_list", path)
    for number, case in enumerate(cases):
        stated = isinstance(case, dict) and isinstance(case.get("MODTRANINPUT"), dict)
        refuse(not stated, "modtran.no_input", f"{path}, case {number}")
    return [case["MODTRANINPUT"] for case in cases]


def stated_fields(inputs: dict[str, Any], where: str) -> dict[str, Any]:
    """Fields of :class:`AtmosphericState` that one case of MODTRAN 6 input states, and no others.

    A meteorological range stands as such, a negative one as ``aot550``; the sun by place and time is turned into
    angles (the year does not matter to 0.1 degree).

    Raises
    ------
    InputError : a value of the wrong kind.
    """
    try:
        geometry, aerosols = inputs.get("GEOMETRY", {}), inputs.get("AEROSOLS", {})
        fields: dict[str, Any] = _sun(geometry)
        models, hazes = ({word: ours for ours, (_, word) in words.items()} for words in (MODELS, HAZES))
        names = models.get(inputs.get("ATMOSPHERE", {}).get("MODEL")), hazes.get(aerosols.get("IHAZE"))
        fields |= {name: ours for name, ours in zip(("model", "aerosol"), names, strict=True) if ours}
        for name, (place, key, of_unit, unit) in FIELDS.items():
            section = inputs.get(place, {})
            if str(section.get(of_unit, "")).lower() == unit if unit else key in section:
                fields[name] = float(section[key])
        amount = float(aerosols.get("VIS", 0.0))
        if amount != 0.0 and fields.get("aerosol") != "none":
            fields |= {"aot550": -amount} if amount < 0.0 else {"meteorological_range_km": amount}
        if 90.0 - abs(float(geometry.get("OBSZEN", 180.0)) - 90.0) <= _NADIR_DEG:
            fields["view_zenith_deg"] = 0.0
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise refusal("modtran.value", where, why=error) from error
    return fields


def stated_albedo(inputs: dict[str, Any]) -> float | None:
    """Ground reflectance of a case over uniform ground; None where it does not state one."""
    surface = inputs.get("SURFACE", {})
    if surface.get("SURFTYPE") == "REFL_CONSTANT" and isinstance(surface.get("SURREF"), int | float):
        return float(surface["SURREF"])
    name = str(surface.get("SURFP", {}).get("CSALB", ""))
    if surface.get("NSURF", 1) == 1 and name.startswith("LAMB_CONST_") and name.endswith("_PCT"):
        return int(name.removeprefix("LAMB_CONST_").removesuffix("_PCT")) / 100.0
    return None


def _sun(geometry: dict[str, Any]) -> dict[str, Any]:
    day = int(geometry["IDAY"]) if geometry.get("IDAY") else None
    fields: dict[str, Any] = {} if day is None else {"day_of_year": day}
    if geometry.get("IPARM") in (2, 12):
        fields["solar_zenith_deg"] = float(geometry["PARM2"])
    elif geometry.get("IPARM") in (1, 11) and day is not None and "GMTIME" in geometry:
        when = datetime(_COMMON_YEAR, 1, 1, tzinfo=UTC) + timedelta(days=day - 1, hours=float(geometry["GMTIME"]))
        longitude = (-float(geometry["PARM2"]) + 180.0) % 360.0 - 180.0  # MODTRAN counts west
        zenith, azimuth = solar.solar_position(float(geometry["PARM1"]), longitude, when)
        fields |= {"solar_zenith_deg": zenith, "solar_azimuth_deg": azimuth}
    return fields


EXECUTABLE, VERSION, DATA = "HYPERVAL_MODTRAN", "HYPERVAL_MODTRAN_VERSION", "HYPERVAL_MODTRAN_DATA"
TIMEOUT_S = 3600.0
_NAME = "hyperval"
_SCHEME = 2  # raise when the numbers in the cache change their meaning


@dataclass(frozen=True)
class Modtran:
    """An installed MODTRAN: its executable, version 4, 5 or 6, and for 4 and 5 its DATA folder."""

    executable: Path
    version: int
    data: Path | None


def configured_modtran() -> Modtran:
    """The MODTRAN that the environment names.

    Raises
    ------
    EngineError : none is named, it cannot be executed, or the version is unknown; the message says how to mend it.
    """
    named, version = os.environ.get(EXECUTABLE, "").strip(), os.environ.get(VERSION, "6").strip()
    data = os.environ.get(DATA, "").strip()
    refuse(not named, "modtran.unset")
    program = shutil.which(named)
    refuse(program is None, "modtran.program", f"{EXECUTABLE}={named}")
    refuse(version not in ("4", "5", "6"), "modtran.version", key=VERSION, version=version)
    executable = Path(str(program)).resolve()
    folder = Path(data) if data else executable.parent / "DATA"
    refuse(data and not folder.is_dir(), "modtran.data", f"{DATA}={data}")
    return Modtran(executable, int(version), folder.resolve() if folder.is_dir() else None)


def run_modtran(deck: str, modtran: Modtran, folder: Path, timeout_s: float = TIMEOUT_S) -> Path:
    """Start MODTRAN on a deck in ``folder`` and return its output file: a ``.tp7``, ``tape7`` or ``.chn``.

    Raises
    ------
    EngineError : it cannot be started, takes longer than ``timeout_s``, fails, or leaves no output.
    """
    where, mend, six = str(modtran.executable), str(refusal("modtran.unset").mend), modtran.version == 6
    of_six, of_others = [f"{_NAME}.{end}" for end in ("json", "tp7", "chn")], ["tape5", "tape7", "tape5.tp7"]
    input_name, *candidates = of_six if six else of_others
    if modtran.data is not None and not six:
        (folder / "DATA").symlink_to(modtran.data)
    (folder / input_name).write_text(deck, encoding="ascii")
    done = run_program([where, input_name] if six else [where], "MODTRAN", mend, timeout_s=timeout_s, cwd=folder)
    said = last_line(done.stderr or done.stdout)
    refuse(done.returncode != 0, "modtran.failed", where, code=done.returncode, said=said)
    found = [folder / name for name in candidates if (folder / name).is_file()]
    refuse(not found, "modtran.nothing", where, names=", ".join(candidates), said=said, version=modtran.version)
    return found[0]


def modtran_terms(state: AtmosphericState, folder: Path) -> AtmosphericTerms:
    """The terms of a state by the configured MODTRAN: runs over ground of 0, 0.1 and 0.5, solved and cached.

    Raises
    ------
    EngineError : no MODTRAN, or it failed.
    InputError : its output cannot be read.
    UsageError : a state that MODTRAN cannot be told.
    """
    modtran = configured_modtran()
    six = modtran.version == 6
    deck = modtran6_json(state) if six else tape5(state, modtran.version)
    binary = sha256_of(modtran.executable)
    inputs = {"scheme": _SCHEME, "binary": binary, "version": modtran.version, "deck": deck}

    def compute() -> Arrays:
        with scratch_folder("modtran") as scratch:
            for _ in track([0], f"MODTRAN {modtran.version}", total=1):
                output = run_modtran(deck, modtran, Path(scratch))
            terms = read_modtran_runs([output], ALBEDOS)
        widths = {} if terms.fwhm_nm is None else {"fwhm_nm": terms.fwhm_nm}
        return {"wavelength_nm": terms.wavelength_nm, **terms.spectra(), **widths}

    values: dict[str, Any] = dict(cached(folder, "modtran", inputs, compute))
    of_it = {"engine": f"MODTRAN {modtran.version}", "executable_sha256": binary, "albedos": list(ALBEDOS)}
    provenance = {**of_it, **_OF_THE_RUNS, "state": state.model_dump(mode="json")}
    return AtmosphericTerms(**values, provenance=provenance)

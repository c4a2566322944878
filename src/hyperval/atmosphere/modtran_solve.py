"""The terms of equation 3.7 from what MODTRAN wrote.

With the same atmosphere over uniform ground of reflectance rho (3.7 with rho_m = rho_ave = rho):

    ground(rho) = A rho / (1 - S rho)            GRND_RFLT
    path(rho)   = L_a + B rho / (1 - S rho)      SOL_SCAT, which holds SING_SCAT already

so rho / ground = 1/A - (S/A) rho is a straight line: two albedos above 0 give A and S, the black run gives L_a, the
brightest B.  DRCT_RFLT / GRND_RFLT tells the sun from the sky.  Emission (PTH_THRML, SURF_EMIS) is part of L_a, as
the black run has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.modtran_read import ChannelBlock, Tape7Case, read_chn_blocks, read_tape7
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import InputError, UsageError, reader
from hyperval.units import radiance_per_wavelength

Array = npt.NDArray[np.float64]

GREATEST_ALBEDO_OF_AIR = 0.9  # a spherical albedo beyond it is rounding of a ground radiance near zero
_LEAST_TRANSMITTANCE = 1e-4
_LINES_NM = 4.0  # resolved lines: a window's level is the largest value this close to it
_FWHM_PER_WIDTH = 2.0 * np.sqrt(np.log(2.0) / np.pi)  # 0.9394, a Gaussian of that equivalent width
# Places between absorption bands where a channel's transmittance is scattering alone, nearly.
_CONTINUUM_NM = (412.0, 443.0, 490.0, 670.0, 780.0, 865.0, 1040.0, 1240.0, 1640.0)


@dataclass(frozen=True)
class Coefficients:
    """A, B and S of the runs: (n,) each, A and B in the unit of the radiances."""

    direct: Array
    adjacency: Array
    spherical_albedo: Array


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
    rho = checked_albedos(albedos)
    seen, scattered = np.asarray(ground, dtype=float), np.asarray(path, dtype=float)
    black, low, high = (rho.index(r) for r in (0.0, min(r for r in rho if r > 0.0), max(rho)))
    lit = (seen[low] > 0.0) & (seen[high] > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        at_low, at_high = rho[low] / seen[low], rho[high] / seen[high]
        slope = (at_high - at_low) / (rho[high] - rho[low])  # -S/A
        inverse = at_low - slope * rho[low]  # 1/A
        s = -slope / inverse
    known = lit & np.isfinite(s) & (s > -0.01) & (s < GREATEST_ALBEDO_OF_AIR)
    if spherical_albedo is None:
        index = np.arange(s.size)
        spherical_albedo = np.interp(index, index[known], s[known]) if known.any() else np.zeros(s.size)
    s = np.maximum(np.where(known, s, spherical_albedo), 0.0)
    from_bright = (1.0 - s * rho[high]) / rho[high]
    return Coefficients(seen[high] * from_bright, (scattered[high] - scattered[black]) * from_bright, s)


def checked_albedos(albedos: Sequence[float]) -> list[float]:
    """The albedos as a list, when they determine the terms; raises UsageError."""
    rho = [float(a) for a in albedos]
    positive = {a for a in rho if a > 0.0}
    if rho.count(0.0) != 1 or len(positive) < 2 or len(positive) != len(rho) - 1 or max(rho) > 1.0:
        raise UsageError(
            f"albedos {rho}",
            expected="one run over black ground and two or more over different brighter ground, 0-1",
        )
    return rho


def terms_from_tape7(cases: Sequence[Tape7Case], albedos: Sequence[float] | None = None) -> AtmosphericTerms:
    """Terms at the wavenumbers of tape7 cases in radiance mode, turned to radiance per wavelength.

    Parameters
    ----------
    cases : runs that differ in nothing but the ground
    albedos : their ground reflectance; None: what the cases say (SURREF, or 1 - DIR_EM)

    Raises
    ------
    UsageError : albedos unknown or insufficient.
    InputError : cases of other modes or of different wavenumbers.
    """
    for case in cases:
        if case.mode != "radiance":
            raise InputError(
                f"{case.mode} mode", where=case.where, expected="radiance mode with the sun (IEMSCT 2)"
            )
        if not np.array_equal(case.wavenumber_cm, cases[0].wavenumber_cm):
            raise InputError("other wavenumbers than the first run", where=case.where)
    rho = checked_albedos(_stated_albedos(cases) if albedos is None else albedos)
    if len(rho) != len(cases):
        raise UsageError(f"{len(rho)} albedos for {len(cases)} runs")
    nu = cases[0].wavenumber_cm

    def per_wavelength(case: Tape7Case, *names: str) -> Array:
        """Sum of columns [uW cm-2 sr-1 nm-1], by increasing wavelength."""
        total = sum((case.column(name) for name in names), np.zeros(nu.size))
        return radiance_per_wavelength(total, nu)[::-1]

    black, bright = cases[rho.index(0.0)], cases[rho.index(max(rho))]
    return _terms(
        rho,
        [per_wavelength(case, "GRND_RFLT") for case in cases],
        [per_wavelength(case, "SOL_SCAT") for case in cases],
        1e7 / nu[::-1],
        emission=per_wavelength(black, "PTH_THRML", "SURF_EMIS"),
        sun=per_wavelength(black, "TOA_SUN"),
        sunlit=per_wavelength(bright, "DRCT_RFLT"),
        transmittance=black.column("TOT_TRANS")[::-1],
        reach_nm=_LINES_NM,
        solved_from=[case.where for case in cases],
    )


def terms_from_blocks(blocks: Sequence[ChannelBlock], albedos: Sequence[float] | None = None) -> AtmosphericTerms:
    """Terms at the channels of a channel file's blocks, from their radiances instead of the printed coefficients.

    The printed spherical albedo is used where no light is reflected.  ``albedos`` None: found from each block, to
    0.01.

    Raises
    ------
    UsageError : albedos that do not determine the terms.
    InputError : blocks of different channels.
    """
    for block in blocks:
        if not np.array_equal(block.wavelength_nm, blocks[0].wavelength_nm):
            raise InputError("the blocks of the channel file have different channels")
    rho = checked_albedos([round(b.reflectance(), 2) for b in blocks] if albedos is None else albedos)
    if len(rho) != len(blocks):
        raise UsageError(f"{len(rho)} albedos for {len(blocks)} runs")
    black, bright = blocks[rho.index(0.0)], blocks[rho.index(max(rho))]
    terms = _terms(
        rho,
        [b.ground for b in blocks],
        [b.path for b in blocks],
        black.wavelength_nm,
        emission=black.thermal,
        sun=black.unit_radiance,
        sunlit=bright.ground_of_sun,
        transmittance=black.path_transmittance,
        spherical_albedo=black.spherical_albedo,
    )
    return replace(terms, fwhm_nm=_FWHM_PER_WIDTH * black.width_nm, diffuser_radiance=black.unit_radiance)


def _terms(
    rho: list[float], ground: Sequence[Array], path: Sequence[Array], wavelength_nm: Array, *,
    emission: Array, sun: Array, sunlit: Array, transmittance: Array, spherical_albedo: Array | None = None,
    reach_nm: float = 0.0, **record: object,
) -> AtmosphericTerms:  # fmt: skip
    """Terms that reproduce runs.

    ``emission``, ``sun`` and ``transmittance`` are those of the black run, ``sunlit`` is the part of the brightest
    ground's radiance that the sun lights; ``record`` goes into the provenance.
    """
    solution = solve_coefficients(rho, ground, path, spherical_albedo)
    with np.errstate(divide="ignore", invalid="ignore"):
        efficiency = np.where(sun > 0.0, solution.direct / sun, 0.0)
        share = sunlit / max(rho) / solution.direct
    return AtmosphericTerms(
        wavelength_nm=wavelength_nm,
        path_radiance=path[rho.index(0.0)] + emission,
        direct=solution.direct,
        adjacency=solution.adjacency,
        spherical_albedo=solution.spherical_albedo,
        ground_irradiance=_ground_irradiance(solution.direct, transmittance),
        gas_transmittance=over_continuum(wavelength_nm, efficiency, reach_nm),
        provenance={
            "engine": "MODTRAN",
            **record,
            "albedos": rho,
            "solar_spectrum": "of the MODTRAN run",
            "emission": "of the black run, part of the path radiance",
        },
        diffuse_fraction=_diffuse(share),
    )


def read_modtran_runs(paths: Sequence[Path], albedos: Sequence[float] | None = None) -> AtmosphericTerms:
    """Terms from the output of several runs: a channel file of several blocks, or tape7 files of one or more cases.

    Raises
    ------
    InputError, UsageError : as :func:`read_tape7`, :func:`read_chn_blocks` and the solvers.
    """
    if not paths:
        raise UsageError("no MODTRAN output named", expected="a .chn file, or one or more tape7 files")
    if all(_is_chn(path) for path in paths):
        return terms_from_blocks([b for path in paths for b in read_chn_blocks(path)], albedos)
    return terms_from_tape7([case for path in paths for case in read_tape7(path)], albedos)


def _is_chn(path: Path) -> bool:
    return Path(path).name.removesuffix(".gz").endswith(".chn")


def _stated_albedos(cases: Sequence[Tape7Case]) -> list[float]:
    albedos = []
    for case in cases:
        albedo = case.albedo()
        if albedo is None:
            raise UsageError(
                "the case does not state one albedo", where=case.where, mend="hand in the albedos of all runs"
            )
        albedos.append(albedo)
    return albedos


def _ground_irradiance(direct: Array, transmittance: Array) -> Array:
    """pi A / (direct transmittance of the path) [uW cm-2 nm-1]; NaN where the path is opaque."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(transmittance > _LEAST_TRANSMITTANCE, np.pi * direct / transmittance, np.nan)


def _diffuse(sun_share: Array) -> Array:
    """Sky's part of the irradiance of black ground, 1 - DRCT_RFLT / (A rho); in the dark that of the neighbours."""
    known = np.isfinite(sun_share)
    if not known.any():
        return np.zeros(sun_share.size)
    index = np.arange(sun_share.size)
    return np.clip(1.0 - np.interp(index, index[known], sun_share[known]), 0.0, 1.0)


@reader
def read_chn(path: Path) -> AtmosphericTerms:
    """Terms at the channels of a MODTRAN ``.chn`` (or ``.chn.gz``) file, from the coefficients that it prints.

    Over bright ground they fall short of the radiance in the same file by up to 1 % in all (A 0.1-0.6 %, B 2-9 %):
    of three runs and more :func:`read_modtran_runs` gives terms that reproduce them.

    The run with the darkest ground gives the path radiance.  The terms are channel averages; the file
    holds no gas transmittance apart from scattering, so ``gas_transmittance`` is the coefficient A over
    its continuum through the windows: good for sorting windows from absorption, no more.  The
    ground irradiance is pi F A / (direct transmittance of the path), NaN where that vanishes.

    Raises
    ------
    InputError : missing, not a channel file, a row that does not fit its columns (with file:line).
    """
    blocks = read_chn_blocks(path)
    block = min(blocks, key=ChannelBlock.reflectance)
    direct = block.unit_radiance * block.direct
    return AtmosphericTerms(
        wavelength_nm=block.wavelength_nm,
        path_radiance=block.path_over_black(),
        direct=direct,
        adjacency=block.unit_radiance * block.diffuse,
        spherical_albedo=block.spherical_albedo,
        ground_irradiance=_ground_irradiance(direct, block.path_transmittance),
        gas_transmittance=over_continuum(block.wavelength_nm, block.direct),
        provenance={"engine": "MODTRAN", "file": str(path), "blocks": len(blocks)},
        fwhm_nm=_FWHM_PER_WIDTH * block.width_nm,
        diffuser_radiance=block.unit_radiance,
    )


def over_continuum(wavelength_nm: Array, coefficient: Array, reach_nm: float = 0.0) -> Array:
    """A coefficient over its continuum through the windows, 0-1; (n,), a stand-in for gas transmittance.

    ``reach_nm`` takes the largest value within that distance of a window, for spectra with resolved lines.
    """
    inside = [w for w in _CONTINUUM_NM if wavelength_nm[0] <= w <= wavelength_nm[-1]]
    if not inside:
        return np.clip(coefficient / max(float(coefficient.max()), 1e-30), 0.0, 1.0)
    if reach_nm > 0.0:
        level = np.array([coefficient[np.abs(wavelength_nm - w) <= reach_nm].max(initial=0.0) for w in inside])
    else:
        level = np.interp(inside, wavelength_nm, coefficient)
    continuum = np.exp(np.interp(np.log(wavelength_nm), np.log(inside), np.log(np.maximum(level, 1e-30))))
    return np.asarray(np.clip(coefficient / continuum, 0.0, 1.0))

"""MODTRAN channel files (``.chn``): the terms at the channels of the user's own MODTRAN run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.modtran_text import fixed_columns, text_lines
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import InputError, UsageError
from hyperval.units import radiance_to_internal

Array = npt.NDArray[np.float64]

_COLUMNS = 26  # numeric columns, then the description
_RADIANCE = radiance_to_internal("W cm-2 sr-1 nm-1")
_FWHM_PER_WIDTH = 2.0 * np.sqrt(np.log(2.0) / np.pi)  # 0.9394, a Gaussian of that equivalent width
# Places between absorption bands where a channel's transmittance is scattering alone, nearly.
_CONTINUUM_NM = (412.0, 443.0, 490.0, 670.0, 780.0, 865.0, 1040.0, 1240.0, 1640.0)


@dataclass(frozen=True)
class ChannelBlock:
    """One table of a channel file: one run over ground of one reflectance.

    Attributes
    ----------
    wavelength_nm : (n,) spectral moments [nm]
    width_nm : (n,) equivalent widths [nm]
    radiance : (n,) total radiance [uW cm-2 sr-1 nm-1]
    thermal : (n,) emitted part of it (path emission, path scatter, surface) [same]
    path : (n,) solar radiance scattered into the path, from ground of this block's reflectance too [same]
    ground : (n,) radiance of the viewed ground [same]
    ground_of_sun : (n,) part of it that the direct sun lights [same]
    unit_radiance : (n,) mu0 E0 / pi [same]
    direct, diffuse : (n,) reflectance coefficients A and B [1]
    spherical_albedo : (n,) [1]
    path_transmittance : (n,) ground to sensor, direct [1]
    """

    wavelength_nm: Array
    width_nm: Array
    radiance: Array
    thermal: Array
    path: Array
    ground: Array
    ground_of_sun: Array
    unit_radiance: Array
    direct: Array
    diffuse: Array
    spherical_albedo: Array
    path_transmittance: Array

    def reflectance(self) -> float:
        """Ground reflectance of the run, from ground = F A rho / (1 - S rho); the file does not state it."""
        full = self.unit_radiance * self.direct
        bright = full > 0.05 * full.max()
        if not np.any(bright):
            return 0.0
        ratio = self.ground[bright] / full[bright]
        return float(np.median(ratio / (1.0 + self.spherical_albedo[bright] * ratio)))

    def path_over_black(self) -> Array:
        """L_a [uW cm-2 sr-1 nm-1]: emission and path radiance less what uniform ground adds to it."""
        rho = self.reflectance()
        added = self.unit_radiance * self.diffuse * rho / (1.0 - self.spherical_albedo * rho)
        return self.thermal + self.path - added


def read_chn(path: Path, albedos: Sequence[float] | None = None) -> AtmosphericTerms:
    """Terms at the channels of a MODTRAN ``.chn`` (or ``.chn.gz``) file.

    Without ``albedos`` the coefficients are those that the file prints.  Over bright ground they fall
    short of the radiance in the same file by up to 1 % in all (A 0.1-0.6 %, B 2-9 %).  A file of
    several runs can do better: with the ground reflectance of each run in ``albedos`` the path radiance is
    taken from the darkest and A and B from the brightest run, which they then reproduce to 1e-4.

    The run with the darkest ground gives the path radiance.  The terms are channel averages; the file
    holds no gas transmittance apart from scattering, so ``gas_transmittance`` is the coefficient A over
    its continuum through the windows: good for sorting windows from absorption, no more.  The
    ground irradiance is pi F A / (direct transmittance of the path), NaN where that vanishes.

    Raises
    ------
    InputError : missing, not a channel file, a row that does not fit its columns (with file:line).
    UsageError : ``albedos`` does not fit the runs of the file.
    """
    blocks = read_chn_blocks(path)
    block = min(blocks, key=ChannelBlock.reflectance)
    if albedos is not None:
        block = _fitted(blocks, albedos, str(path))
    with np.errstate(divide="ignore", invalid="ignore"):
        down = np.where(block.path_transmittance > 1e-4, block.direct / block.path_transmittance, np.nan)
    return AtmosphericTerms(
        wavelength_nm=block.wavelength_nm,
        path_radiance=block.path_over_black(),
        direct=block.unit_radiance * block.direct,
        adjacency=block.unit_radiance * block.diffuse,
        spherical_albedo=block.spherical_albedo,
        ground_irradiance=np.pi * block.unit_radiance * down,
        gas_transmittance=over_continuum(block.wavelength_nm, block.direct),
        provenance={"engine": "MODTRAN", "file": str(path), "blocks": len(blocks)},
        fwhm_nm=_FWHM_PER_WIDTH * block.width_nm,
    )


def _fitted(blocks: list[ChannelBlock], albedos: Sequence[float], where: str) -> ChannelBlock:
    """The darkest block with A and B from the radiance of the brightest; S is the printed one."""
    if len(albedos) != len(blocks) or min(albedos) != 0.0 or not 0.0 < max(albedos) <= 1.0:
        raise UsageError(
            f"albedos {list(albedos)} for {len(blocks)} runs",
            where=where,
            expected="one ground reflectance for each run: one of them 0, the largest above 0 and at most 1",
        )
    black = blocks[list(albedos).index(0.0)]
    bright, rho = blocks[int(np.argmax(albedos))], max(albedos)
    to_coefficient = (1.0 - black.spherical_albedo * rho) / (rho * np.maximum(black.unit_radiance, 1e-30))
    return replace(
        black,
        direct=bright.ground * to_coefficient,
        diffuse=(bright.path - black.path) * to_coefficient,
    )


def read_chn_blocks(path: Path) -> list[ChannelBlock]:
    """All tables of a channel file, in their order; errors as :func:`read_chn`."""
    lines = text_lines(Path(path), "a MODTRAN .chn file")
    blocks: list[ChannelBlock] = []
    number = 0
    while number < len(lines):
        if not _is_rule(lines[number]):
            number += 1
            continue
        ends = _column_ends(lines[number], f"{path}:{number + 1}")
        rows = []
        number += 1
        while number < len(lines) and lines[number].strip():
            rows.append(_row(lines[number], ends, f"{path}:{number + 1}"))
            number += 1
        if not rows:
            raise InputError("a table without rows", where=f"{path}:{number + 1}")
        # Sensors with overlapping spectrometers list their channels out of order.
        blocks.append(_block(np.array(sorted(rows, key=lambda row: row[0]))))
    if not blocks:
        raise InputError("no channel table", where=str(path), expected="a MODTRAN .chn file")
    return blocks


def _block(t: Array) -> ChannelBlock:
    width = t[:, 8]

    def density(column: Array) -> Array:
        """Channel radiance [W cm-2 sr-1] to average spectral radiance."""
        return np.asarray(column / width * _RADIANCE)

    return ChannelBlock(
        wavelength_nm=t[:, 0],
        width_nm=width,
        radiance=t[:, 4] * _RADIANCE,
        thermal=density(t[:, 11] + t[:, 12] + t[:, 13]),
        path=density(t[:, 14] + t[:, 15]),
        ground=density(t[:, 16]),
        ground_of_sun=density(t[:, 17]),
        unit_radiance=density(t[:, 18]),
        direct=t[:, 21],
        diffuse=t[:, 22],
        spherical_albedo=t[:, 23],
        path_transmittance=t[:, 24],
    )


def _is_rule(line: str) -> bool:
    return line.startswith("----") and not line.strip("- ")


def _column_ends(rule: str, where: str) -> list[int]:
    """Where each column ends, from the line of dashes under the heads."""
    ends = [i + 1 for i, c in enumerate(rule) if c == "-" and (i + 1 == len(rule) or rule[i + 1] != "-")]
    if len(ends) != _COLUMNS + 1:
        raise InputError(
            f"{len(ends)} columns", where=where, expected=f"the {_COLUMNS} columns of MODTRAN 5.3 or 6"
        )
    return ends[:_COLUMNS]


def _row(line: str, ends: list[int], where: str) -> list[float]:
    values = fixed_columns(line, ends, where)
    if values[8] <= 0.0:
        raise InputError(f"equivalent width {values[8]:g} nm", where=where, expected="a positive width")
    return values


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
    return np.clip(coefficient / continuum, 0.0, 1.0)

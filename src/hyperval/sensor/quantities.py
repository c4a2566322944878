"""What sensor files are made of: numbers with sources, bands, throughput, blur, spectral calibration."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from hyperval.config import Model
from hyperval.sensor.response import aperture_throughput, f_number_throughput, psf_fwhm_from_mtf
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Source = Annotated[str, Field(min_length=3)]


class Quantity(Model):
    """A number, or a table over wavelength, with its source."""

    value: float | None = None
    table: list[tuple[float, float]] | None = Field(None, description="[nm, value] pairs, wavelength increasing")
    source: Source

    @model_validator(mode="after")
    def _one_of(self) -> Quantity:
        if (self.value is None) == (self.table is None):
            raise ValueError("give either value or table")
        if self.table is not None and (len(self.table) < 2 or np.any(np.diff([w for w, _ in self.table]) <= 0)):
            raise ValueError("a table needs at least two rows in rising wavelength")
        return self

    def at(self, wavelength_nm: Array) -> Array:
        """(B,) values: linear in wavelength, the end values beyond the table."""
        if self.table is None:
            return np.full(wavelength_nm.shape, self.value, dtype=float)
        w, v = np.array(self.table).T
        return np.asarray(np.interp(wavelength_nm, w, v))

    @property
    def assumed(self) -> bool:
        """True when the source says that the number is an assumption."""
        return self.source.lower().startswith("assumed")


class RegularBands(Model):
    """Evenly spaced bands."""

    first_nm: float = Field(gt=0)
    step_nm: float = Field(gt=0)
    count: int = Field(gt=0, le=5000)
    fwhm_nm: float = Field(gt=0)


class StatedGap(Model):
    """A part of the spectrum that the sensor leaves out on purpose."""

    range_nm: tuple[float, float] = Field(description="from the last band before it to the first after it [nm]")
    source: Source


class Bands(Model):
    """The band set: a table of [centre nm, FWHM nm, good 0/1], evenly spaced bands, or such bands part by part."""

    table: list[tuple[float, float, int]] | None = None
    regular: RegularBands | None = None
    parts: list[RegularBands] | None = Field(None, min_length=1, description="evenly spaced bands, by spectrometer")
    spacing: Literal["contiguous", "separate"] = Field(
        "contiguous", description="separate: a multispectral sensor, whose bands need not touch"
    )
    gaps: tuple[StatedGap, ...] = Field((), description="parts that are left out on purpose")
    beside: str | None = Field(
        None,
        description="sensor of the library with another set of bands, which the datasheet shows beside it",
    )
    source: Source

    @model_validator(mode="after")
    def _one_of(self) -> Bands:
        if sum(given is not None for given in (self.table, self.regular, self.parts)) != 1:
            raise ValueError("give either table, regular or parts")
        return self

    @property
    def fwhms(self) -> list[float]:
        """Widths as the file lists them [nm]: of each band of a table, or one of each part."""
        if self.table is not None:
            return [fwhm for _, fwhm, _ in self.table]
        return [p.fwhm_nm for p in self.parts or ([self.regular] if self.regular is not None else [])]

    @property
    def axis(self) -> SpectralAxis:
        """The bands as an axis (for 3.13)."""
        if self.table is not None:
            rows: Array = np.array(self.table, dtype=np.float64)
            return SpectralAxis(rows[:, 0], rows[:, 1], rows[:, 2] > 0)
        parts = self.parts or ([self.regular] if self.regular is not None else [])
        centres = [r.first_nm + r.step_nm * np.arange(r.count, dtype=np.float64) for r in parts]
        widths = [np.full(r.count, r.fwhm_nm) for r in parts]
        return SpectralAxis(np.concatenate(centres), np.concatenate(widths))


class Throughput(Model):
    """A Omega by one of the conventions of (3.14).

    value: ``cm2_sr``; square-ifov, cone: ``aperture_m``, ``ifov_mrad``, ``obscuration``;
    f-number: ``f_number``, ``pixel_pitch_um``; slit: ``f_number``, ``slit_width_um``, ``slit_height_um``.
    """

    convention: Literal["value", "square-ifov", "cone", "f-number", "slit"] = "square-ifov"
    cm2_sr: float | None = Field(None, gt=0)
    aperture_m: float | None = Field(None, gt=0)
    ifov_mrad: float | None = Field(None, gt=0)
    obscuration: float = Field(0.0, ge=0, lt=1)
    f_number: float | None = Field(None, gt=0)
    pixel_pitch_um: float | None = Field(None, gt=0)
    slit_width_um: float | None = Field(None, gt=0)
    slit_height_um: float | None = Field(None, gt=0)
    source: Source

    @model_validator(mode="after")
    def _complete(self) -> Throughput:
        needs = {
            "value": ("cm2_sr",),
            "square-ifov": ("aperture_m", "ifov_mrad"),
            "cone": ("aperture_m", "ifov_mrad"),
            "f-number": ("f_number", "pixel_pitch_um"),
            "slit": ("f_number", "slit_width_um", "slit_height_um"),
        }[self.convention]
        lacking = [name for name in needs if getattr(self, name) is None]
        if lacking:
            raise ValueError(f"the convention {self.convention} needs {', '.join(lacking)}")
        return self

    @property
    def value_cm2_sr(self) -> float:
        """A Omega [cm2 sr] (3.14)."""
        match self.convention:
            case "value":
                return float(self.cm2_sr or 0)
            case "f-number":
                return f_number_throughput(self.f_number or 0, (self.pixel_pitch_um or 0) ** 2)
            case "slit":
                return f_number_throughput(
                    self.f_number or 0, (self.slit_width_um or 0) * (self.slit_height_um or 0)
                )
        return aperture_throughput(
            self.aperture_m or 0,
            1e-3 * (self.ifov_mrad or 0),
            obscuration=self.obscuration,
            convention=self.convention,
        )


class Blur(Model):
    """Point spread function in two directions, by widths or by MTF: pairs (along, across) the track."""

    fwhm_pixels: tuple[float, float] | None = Field(None, description="Gaussian besides the aperture [pixels]")
    mtf_at_nyquist: tuple[float, float] | None = Field(None, description="of the pixel, aperture included [1]")
    source: Source

    @model_validator(mode="after")
    def _one_of(self) -> Blur:
        if (self.fwhm_pixels is None) == (self.mtf_at_nyquist is None):
            raise ValueError("give either fwhm_pixels or mtf_at_nyquist")
        if self.fwhm_pixels is not None and not all(0 <= w <= 5 for w in self.fwhm_pixels):
            raise ValueError("fwhm_pixels lies between 0 and 5")
        if self.mtf_at_nyquist is not None and not all(0.01 <= m <= 2 / np.pi for m in self.mtf_at_nyquist):
            raise ValueError("mtf_at_nyquist lies between 0.01 and 0.6366, which the aperture alone passes")
        return self

    @property
    def fwhm(self) -> tuple[float, float]:
        """FWHM of the Gaussian (along, across) [pixels]."""
        if self.fwhm_pixels is not None:
            return self.fwhm_pixels
        along, across = psf_fwhm_from_mtf(np.array(self.mtf_at_nyquist, dtype=float))
        return float(along), float(across)


class SpectralShift(Model):
    """Where the bands of a range truly stand: true minus nominal centre, and the smile across the track."""

    range_nm: tuple[float, float] | None = Field(None, description="bands it holds for; None: all")
    shift_nm: float = Field(0.0, ge=-50, le=50, description="at the middle of the track [nm]")
    smile_nm: tuple[float, ...] = Field(
        (), max_length=8, description="c1, c2, ...: adds c1 x + c2 x^2 + ..., x from -1 to 1 across the track"
    )
    columns: int | None = Field(None, ge=2, description="samples across the track; with smile_nm")
    source: Source

    @model_validator(mode="after")
    def _complete(self) -> SpectralShift:
        if bool(self.smile_nm) != (self.columns is not None):
            raise ValueError("smile_nm and columns go together")
        return self

    def at(self, column: float | None) -> float:
        """Shift [nm] at a sample, counted from 0; None is the middle of the track.

        Raises ValueError when the column lies outside the track.
        """
        if column is None or self.columns is None:
            return self.shift_nm
        x = 2.0 * column / (self.columns - 1) - 1.0
        if not -1.0 <= x <= 1.0:
            raise ValueError(f"column {column:g} lies outside 0-{self.columns - 1}")
        return self.shift_nm + sum(c * x ** (k + 1) for k, c in enumerate(self.smile_nm))

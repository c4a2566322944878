"""Where a scenario's or a campaign's spectra and covariances come from."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from hyperval.config import Model


def exactly_one(model: Model, names: tuple[str, ...]) -> None:
    """Raise ValueError unless exactly one of the fields is given."""
    given = [n for n in names if getattr(model, n) is not None]
    if len(given) != 1:
        raise ValueError(f"give exactly one of {', '.join(names)}" + (f": {given} are given" if given else ""))


class Replicates(Model):
    """Several spectra of one surface, whose mean, covariance and number are taken.

    A bare name or list of names stands for ``files``.
    """

    files: str | list[str] = Field(
        description="files, or patterns such as spectra/grass*.asd; every spectrum of every file counts"
    )
    records: list[str | int] | None = Field(
        None, min_length=2, description="which spectra of the files, by name or number from 0; None: all"
    )
    wavelength_unit: str | None = Field(None, description="stated when the files do not say")
    reflectance_unit: str | None = Field(None, description="stated when the files do not say: fraction, percent")

    @model_validator(mode="before")
    @classmethod
    def _bare(cls, value: Any) -> Any:
        return {"files": value} if isinstance(value, str | list) else value

    @property
    def references(self) -> tuple[str, ...]:
        """The files as they are named."""
        return (self.files,) if isinstance(self.files, str) else tuple(self.files)


class SpectrumSource(Model):
    """A reflectance spectrum: built in, constant, from a file, or measured on the imagery."""

    builtin: str | None = Field(None, description="name of a built-in surface")
    constant: float | None = Field(None, ge=0, le=1.5, description="the same reflectance in every band [1]")
    file: str | None = Field(None, description="field spectrum or library file")
    replicates: Replicates | None = Field(
        None, description="field spectra of one surface: their mean, covariance and standard error"
    )
    library: str | None = Field(None, description="statistics library: mean and covariance of classes (NetCDF)")
    measured: str | None = Field(None, description="region of the collection whose statistics are handed in")
    record: str | int | None = Field(
        None, description="which spectrum of a file of several: name, number from 0, or mean of all"
    )
    gaps: Literal["refused", "allowed"] = Field(
        "refused", description="usable bands beyond the ends of the spectrum; where allowed they are left out"
    )
    wavelength_unit: str | None = Field(None, description="stated when the file does not say")
    reflectance_unit: str | None = Field(None, description="stated when the file does not say: fraction, percent")

    @model_validator(mode="after")
    def _check(self) -> SpectrumSource:
        exactly_one(self, ("builtin", "constant", "file", "replicates", "library", "measured"))
        if self.file is None and (self.wavelength_unit or self.reflectance_unit):
            raise ValueError("record and units belong to a file")
        if self.file is None and self.library is None and self.record is not None:
            raise ValueError("record and units belong to a file")
        if self.library is not None and not isinstance(self.record, str | None):
            raise ValueError("a record of a statistics library goes by name")
        return self


class CovarianceSource(Model):
    """Spread from pixel to pixel: built in, measured, none, or a relative one with a correlation length."""

    builtin: str | None = None
    replicates: Replicates | None = Field(None, description="field spectra of one surface")
    library: str | None = Field(None, description="statistics library (NetCDF)")
    record: str | None = Field(None, description="with library: name of the class")
    measured: str | None = None
    relative_sd: float | None = Field(
        None, ge=0, description="standard deviation as a part of the mean [1]; 0: none"
    )
    correlation_nm: float | None = Field(None, gt=0, description="with relative_sd; None: fully correlated")
    band_sd: float = Field(0.0, ge=0, description="with relative_sd: independent part of each band [1]")

    @model_validator(mode="after")
    def _check(self) -> CovarianceSource:
        exactly_one(self, ("builtin", "replicates", "library", "measured", "relative_sd"))
        if self.record is not None and self.library is None:
            raise ValueError("record belongs to a library")
        return self

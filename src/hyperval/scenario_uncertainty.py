"""What a scenario says of the uncertainty of its inputs."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from hyperval.config import Model


class SpectrumUncertainty(Model):
    """Standard uncertainty of the field spectrum of one subject."""

    subject: str = Field(description="entries of the same subject are independent and add up")
    relative: float | None = Field(None, gt=0, lt=1, description="as a part of the reflectance")
    absolute: float | None = Field(None, gt=0, lt=1, description="in reflectance")
    from_file: bool = Field(False, description="the standard deviation that the spectrum's file carries")
    divisor: Literal["standard_error", "spread"] = Field(
        "spread", description="with from_file: divide by the root of the file's n, or not"
    )
    correlation_nm: float | None = Field(None, gt=0, description="correlation length; None: fully correlated")

    @model_validator(mode="after")
    def _check(self) -> SpectrumUncertainty:
        if sum([self.relative is not None, self.absolute is not None, self.from_file]) != 1:
            raise ValueError("give exactly one of relative, absolute, from_file")
        return self


class EngineUncertainty(Model):
    """How far the radiative-transfer engine itself may be off, as a part of the ground-reflected radiance.

    u = relative + per_optical_depth * (-ln T_gas): absorption bands are worse than windows.
    """

    relative: float = Field(ge=0, lt=1)
    per_optical_depth: float = Field(0.0, ge=0, lt=10)
    path_relative: float = Field(0.0, ge=0, lt=1, description="of the path radiance")
    correlation_nm: float | None = Field(None, gt=0)


class CollectedReflectance(Model):
    """Error of the reflectance that the collection holds, common to all its pixels: that of its compensation.

    Statistics taken from the image have it, field spectra have not; it enters the scores of objects.
    """

    relative: float = Field(0.0, ge=0, lt=1, description="as a part of the reflectance")
    absolute: float = Field(0.0, ge=0, lt=1, description="in reflectance")
    correlation_nm: float | None = Field(None, gt=0, description="correlation length; None: fully correlated")


class Uncertainty(Model):
    """Standard uncertainties of the inputs; each is a source of the budget."""

    psf_fwhm_pixels: float | None = Field(
        None, gt=0, lt=5, description="of the blur of targets with geometry, common to all; for object scores"
    )
    position_m: float | None = Field(
        None, gt=0, lt=100, description="of the places of neighbours in line and sample; for object scores"
    )
    collected_reflectance: CollectedReflectance | None = None

    aot550: float | None = Field(None, gt=0, description="absolute")
    water_vapour_g_cm2: float | None = Field(None, gt=0, description="absolute [g cm-2]")
    ozone_atm_cm: float | None = Field(None, gt=0, description="absolute [atm cm]")
    solar_irradiance_relative: float | None = Field(None, gt=0, lt=1, description="common to all bands")
    adjacency_reflectance_relative: float | None = Field(
        None, gt=0, lt=1, description="of the reflectance of the surroundings, common to all bands"
    )
    engine: EngineUncertainty | None = None
    field_spectra: list[SpectrumUncertainty] = Field(default_factory=list)

"""What was published of a sensor's signal-to-noise ratio, and what is known not to agree."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from hyperval.config import Model
from hyperval.sensor.quantities import Quantity, Source

Row = tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]]


class ReferenceScene(Model):
    """A uniform ground under a standard atmosphere: what a published figure refers to."""

    reflectance: float = Field(gt=0, le=1.2, description="of the ground, as far as the eye reaches [1]")
    solar_zenith_deg: float = Field(ge=0, lt=85)
    sensor_altitude_km: float = Field(ge=0, le=100_000, description="above sea level; 100 and more is space [km]")
    ground_altitude_km: float = Field(0.0, ge=0, le=5, description="above sea level [km]")
    meteorological_range_km: float = Field(23.0, ge=2, le=300, description="at the ground, rural aerosol [km]")
    model: str = Field("midlatitude-summer", description="standard atmosphere, as in a scenario")
    source: Source


class PublishedSnr(Model):
    """Signal-to-noise ratios that were published, with the radiance they refer to.

    At most one of ``radiance`` and ``scene``; with neither, the publication does not say what it refers to, and
    the figures are shown and not judged.
    """

    table: list[Row] = Field(min_length=1, description="rows [nm, SNR]")
    says: Literal["value", "at least"] = Field("value", description="a figure that is met, or a lower bound")
    radiance: Quantity | None = Field(None, description="reference radiance [uW cm-2 sr-1 nm-1]")
    scene: ReferenceScene | None = Field(None, description="the scene that gives the reference radiance")
    source: Source

    @model_validator(mode="after")
    def _one_reference(self) -> PublishedSnr:
        if self.radiance is not None and self.scene is not None:
            raise ValueError("give radiance or scene, not both")
        return self


class KnownDiscrepancy(Model):
    """A check that this sensor is known not to pass, and why: it is then shown and does not decide."""

    check: str = Field(min_length=3, description="product/metric or product/metric/subject, as in results.csv")
    reason: str = Field(min_length=10, description="why it does not pass, and why that stands")

"""What a scenario says of the uncertainty of its inputs."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, GetCoreSchemaHandler, PlainSerializer, PlainValidator, model_validator

from hyperval.config import Model
from hyperval.spectra.lag_kernel import LagKernel, lag_kernel

Distribution = Literal["normal", "uniform", "triangular", "log-normal"]


class Spread(float):
    """A standard uncertainty and the distribution of the error; a plain number is that of a normal one.

    In YAML a number, or ``{standard: 0.02, distribution: uniform}``; for a uniform or triangular error
    ``half_width`` may stand instead of ``standard``: root 3 or root 6 times as large (JCGM 100:2008, 4.3.7, 4.3.9).
    """

    distribution: Distribution

    def __new__(cls, standard: float, distribution: Distribution = "normal") -> Spread:
        """The number itself, with its distribution."""
        made = super().__new__(cls, standard)
        made.distribution = distribution
        return made

    def __getnewargs__(self) -> tuple[float, Distribution]:  # type: ignore[override]
        return float(self), self.distribution

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Read a number or a mapping; written back the same way."""
        return handler.generate_schema(Annotated[Any, PlainValidator(_read_spread), PlainSerializer(_plain_spread)])


def _read_spread(value: Any) -> Spread:
    if isinstance(value, Spread):
        return value
    distribution: Any = "normal"
    if isinstance(value, dict):
        known = {"standard", "half_width", "distribution"}
        if not set(value) <= known or ("standard" in value) == ("half_width" in value):
            raise ValueError("give standard or half_width, and distribution")
        distribution = value.get("distribution", "normal")
        if distribution not in get_args(Distribution):
            raise ValueError(f"unknown distribution {distribution!r}: one of {', '.join(get_args(Distribution))}")
        number = value.get("standard", value.get("half_width"))
        if "half_width" in value:
            if distribution not in ("uniform", "triangular"):
                raise ValueError("half_width belongs to a uniform or triangular distribution")
            number = _number(number) / math.sqrt(3.0 if distribution == "uniform" else 6.0)
    else:
        number = value
    return Spread(_number(number), distribution)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value <= 0:
        raise ValueError("a standard uncertainty is a positive number")
    return float(value)


def _plain_spread(value: Spread) -> float | dict[str, Any]:
    if getattr(value, "distribution", "normal") == "normal":
        return float(value)
    return {"standard": float(value), "distribution": value.distribution}


class SpectralForm(Model):
    """Distribution of an error over wavelength, and how it hangs together between bands."""

    distribution: Distribution = Field("normal", description="of the error in each band or group")
    correlation_nm: float | None = Field(None, gt=0, description="correlation length; None: fully correlated")
    nugget: float = Field(
        0.0, ge=0, le=1, description="with correlation_nm: part of the variance that is each band's own"
    )
    lags: list[tuple[float, float]] = Field(
        default_factory=list,
        max_length=200,
        description="correlations that were measured, [lag in nm, correlation], in place of correlation_nm and "
        "nugget, which follow from them",
    )
    correlation: Literal["systematic", "random", "groups", "arms"] | None = Field(
        None,
        description="systematic: one error for all bands; random: one for each; groups: one for each range of "
        "groups_nm; arms: one for each arm of the sensor; None: systematic, or by correlation_nm",
    )
    groups_nm: list[tuple[float, float]] = Field(
        default_factory=list, max_length=50, description="wavelength ranges of the groups [nm]"
    )

    @model_validator(mode="after")
    def _one_form(self) -> SpectralForm:
        given = [n for n in ("correlation", "correlation_nm", "lags") if getattr(self, n)]
        if len(given) > 1:
            raise ValueError(f"give {' or '.join(given)}, not both")
        if self.nugget and self.correlation_nm is None:
            raise ValueError("nugget goes with correlation_nm")
        if len(self.lags) == 1 or any(d <= 0 or not -1 <= rho <= 1 for d, rho in self.lags):
            raise ValueError("lags are two or more pairs of a lag above 0 nm and a correlation of -1 to 1")
        if bool(self.groups_nm) != (self.correlation == "groups"):
            raise ValueError("groups_nm goes with correlation: groups")
        if self.kernel is not None and self.distribution not in ("normal", "log-normal"):
            raise ValueError("an error with a correlation length is normal or log-normal")
        return self

    @property
    def kernel(self) -> LagKernel | None:
        """Nugget and length, as stated or from the measured lags; None for another form."""
        if self.lags:
            return lag_kernel(self.lags)
        return None if self.correlation_nm is None else LagKernel(self.nugget, self.correlation_nm)


class SpectrumUncertainty(SpectralForm):
    """Standard uncertainty of the field spectrum of one subject."""

    subject: str = Field(description="entries of the same subject are independent and add up")
    relative: float | None = Field(None, gt=0, lt=1, description="as a part of the reflectance")
    absolute: float | None = Field(None, gt=0, lt=1, description="in reflectance")
    from_file: bool = Field(False, description="the standard deviation that the spectrum's file carries")
    divisor: Literal["standard_error", "spread"] = Field(
        "spread", description="with from_file: divide by the root of the file's n, or not"
    )

    @model_validator(mode="after")
    def _check(self) -> SpectrumUncertainty:
        if sum([self.relative is not None, self.absolute is not None, self.from_file]) != 1:
            raise ValueError("give exactly one of relative, absolute, from_file")
        return self


class FineStructure(SpectralForm):
    """Error of the shape of single absorption lines and bands, as a part of the ground-reflected radiance.

    u = relative + per_optical_depth * (-ln T_gas).
    """

    relative: float = Field(ge=0, lt=1)
    per_optical_depth: float = Field(0.0, ge=0, lt=10)


class EngineUncertainty(SpectralForm):
    """How far the radiative-transfer engine itself may be off, as a part of the ground-reflected radiance.

    u = relative + per_optical_depth * (-ln T_gas): absorption bands are worse than windows.
    """

    relative: float = Field(ge=0, lt=1)
    per_optical_depth: float = Field(0.0, ge=0, lt=10)
    path_relative: float = Field(0.0, ge=0, lt=1, description="of the path radiance")
    fine_structure: FineStructure | None = Field(
        None, description="besides: the error that changes from band to band, with a form of its own"
    )


class CollectedReflectance(Model):
    """Error of the reflectance that the collection holds, common to all its pixels: that of its compensation.

    Statistics taken from the image have it, field spectra have not; it enters the scores of objects.
    """

    relative: float = Field(0.0, ge=0, lt=1, description="as a part of the reflectance")
    absolute: float = Field(0.0, ge=0, lt=1, description="in reflectance")
    correlation_nm: float | None = Field(None, gt=0, description="correlation length; None: fully correlated")


class RelativeUncertainty(SpectralForm):
    """Standard uncertainty of a factor on something that varies with wavelength."""

    relative: float = Field(gt=0, lt=1, description="as a part of it")


class RadianceUncertainty(SpectralForm):
    """Standard uncertainty of an added radiance."""

    absolute: float = Field(gt=0, description="[uW cm-2 sr-1 nm-1]")


class ShiftUncertainty(SpectralForm):
    """Standard uncertainty of the places of the bands."""

    absolute: float = Field(gt=0, le=50, description="[nm]")


class NamedSpread(Model):
    """Standard uncertainty of a number of one subject."""

    subject: str
    absolute: Spread = Field(description="standard uncertainty, in the unit of the number")


class SampledStatistics(Model):
    """A surface whose mean and covariance were measured on finitely many samples."""

    subject: str
    effective_n: float | None = Field(
        None, gt=3, description="independent samples behind them; None: the number that came with them"
    )
    mean: bool = Field(True, description="whether the mean was measured on them too")


class Uncertainty(Model):
    """Standard uncertainties of the inputs; each is a source of the budget."""

    method: Literal["linear", "monte-carlo", "both"] = Field(
        "linear",
        description="propagation: linearised; by draws; or both, compared, where the draws give the interval of "
        "P_D wherever the two differ",
    )
    samples: int = Field(400, ge=40, le=100_000, description="draws of the budget")
    seed: int = Field(0, ge=0, description="of the draws")
    psf_fwhm_pixels: Spread | None = Field(
        None, description="of the blur of targets with geometry, common to all [pixels]"
    )
    position_m: float | None = Field(
        None, gt=0, lt=100, description="of the places of neighbours in line and sample; for object scores"
    )
    collected_reflectance: CollectedReflectance | None = None

    aot550: Spread | None = Field(None, description="absolute")
    angstrom_exponent: Spread | None = Field(None, description="absolute")
    aerosol_share_below: Spread | None = Field(None, description="absolute")
    meteorological_range_km: Spread | None = Field(None, description="absolute [km], in place of aot550")
    water_vapour_g_cm2: Spread | None = Field(None, description="absolute [g cm-2]")
    ozone_atm_cm: Spread | None = Field(None, description="absolute [atm cm]")
    solar_zenith_deg: Spread | None = Field(None, description="absolute [deg]")
    solar_azimuth_deg: Spread | None = Field(None, description="absolute [deg]")
    view_zenith_deg: Spread | None = Field(None, description="absolute [deg]")
    view_azimuth_deg: Spread | None = Field(None, description="absolute [deg]")
    sensor_altitude_km: Spread | None = Field(None, description="absolute [km]")
    ground_altitude_km: Spread | None = Field(None, description="absolute [km]")
    surroundings_altitude_km: Spread | None = Field(None, description="absolute [km]")
    solar_irradiance_relative: Spread | None = Field(None, description="below 1; common to all bands")
    adjacency_reflectance_relative: Spread | None = Field(
        None, description="below 1; of the reflectance of the surroundings, common to all bands"
    )
    engine: EngineUncertainty | None = None
    field_spectra: list[SpectrumUncertainty] = Field(default_factory=list)
    sensor_gain: RelativeUncertainty | None = Field(
        None, description="of the recorded radiance; leave it out where the collection states its calibration"
    )
    sensor_offset: RadianceUncertainty | None = Field(None, description="of the recorded radiance")
    noise: RelativeUncertainty | None = Field(None, description="of the noise standard deviation")
    electrons: RelativeUncertainty | None = Field(None, description="of the electrons per radiance")
    elm_panels: RelativeUncertainty | None = Field(
        None,
        description="of the reflectance of each panel of the empirical line, independent between panels; for "
        "detection, as the collection states it for its reflectance",
    )
    wavelength_shift: ShiftUncertainty | None = Field(None, description="of the band centres")
    fills: list[NamedSpread] = Field(default_factory=list, description="mean fill of targets or their subjects [1]")
    fractions: list[NamedSpread] = Field(
        default_factory=list, description="area fractions of classes; the others give way in proportion"
    )
    sampled_statistics: list[SampledStatistics] = Field(
        default_factory=list, description="surfaces whose mean and covariance come from finite samples"
    )

    @model_validator(mode="after")
    def _check(self) -> Uncertainty:
        if self.aot550 is not None and self.meteorological_range_km is not None:
            raise ValueError("the aerosol has one uncertainty: aot550 or meteorological_range_km")
        for name in ("solar_irradiance_relative", "adjacency_reflectance_relative"):
            if (getattr(self, name) or 0.0) >= 1.0:
                raise ValueError(f"{name} is below 1")
        for name in ("fills", "fractions", "sampled_statistics"):  # field_spectra: entries of a subject add up
            subjects = [item.subject for item in getattr(self, name)]
            if len(set(subjects)) < len(subjects):
                raise ValueError(f"{name}: a subject stands twice")
        return self

    def check_atmosphere(self, atmosphere: object) -> None:
        """Raise ValueError for an uncertainty of a number that the atmosphere leaves to the engine."""
        for name in (
            "meteorological_range_km", "water_vapour_g_cm2", "ozone_atm_cm", "angstrom_exponent",
            "aerosol_share_below", "surroundings_altitude_km",
        ):  # fmt: skip
            if getattr(self, name) is not None and getattr(atmosphere, name) is None:
                raise ValueError(f"{name} is given, but atmosphere.{name} is not: state it there, too")

    def check_subjects(self, surfaces: Collection[str], targets: Collection[str], classes: Collection[str]) -> None:
        """Raise ValueError for an uncertainty of a subject that the scene does not have."""
        for key, known, what in (
            ("field_spectra", surfaces, "no class, panel, site or target"),
            ("sampled_statistics", surfaces, "no class, panel, site or target"),
            ("fills", targets, "no target or subject"),
            ("fractions", classes, "no class"),
        ):
            for item in getattr(self, key):
                if item.subject not in known:
                    raise ValueError(f"{key}: {what} {item.subject!r}; there are {', '.join(sorted(known))}")

"""The uncertain inputs of a prediction, as its scenario states them (``uncertainty:``)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.cases import Origins
from hyperval.prediction.departure import Departure, StatisticsDeparture
from hyperval.prediction.forms import covariance_directions, spectrum_error_sd
from hyperval.prediction.input import Input, Kind, number_input, spectral_input
from hyperval.prediction.input_paths import Given, input_path
from hyperval.prediction.setup import Setup
from hyperval.scenario import Scenario
from hyperval.scenario_uncertainty import SampledStatistics, SpectralForm

Array = npt.NDArray[np.float64]

ENGINE, ENGINE_LINES, ENGINE_PATH = (
    "radiative-transfer engine", "engine's fine structure", "engine's path radiance"
)  # fmt: skip
AEROSOL, WATER, SURROUNDINGS, BLUR = (
    "aerosol optical depth", "water vapour", "surroundings", "blur (PSF width)"
)  # fmt: skip
# Numbers: name for users, kind, path, field of ``uncertainty``.
_NUMBERS: tuple[tuple[str, Kind, str, str], ...] = (
    (AEROSOL, "atmosphere", "atmosphere.aot550", "aot550"),
    ("meteorological range", "atmosphere", "atmosphere.meteorological_range_km", "meteorological_range_km"),
    ("Angstrom exponent", "atmosphere", "atmosphere.angstrom_exponent", "angstrom_exponent"),
    ("share of aerosol below the sensor", "atmosphere", "atmosphere.aerosol_share_below", "aerosol_share_below"),
    (WATER, "atmosphere", "atmosphere.water_vapour_g_cm2", "water_vapour_g_cm2"),
    ("ozone", "atmosphere", "atmosphere.ozone_atm_cm", "ozone_atm_cm"),
    ("solar zenith angle", "atmosphere", "atmosphere.solar_zenith_deg", "solar_zenith_deg"),
    ("solar azimuth", "atmosphere", "atmosphere.solar_azimuth_deg", "solar_azimuth_deg"),
    ("view zenith angle", "atmosphere", "atmosphere.view_zenith_deg", "view_zenith_deg"),
    ("view azimuth", "atmosphere", "atmosphere.view_azimuth_deg", "view_azimuth_deg"),
    ("sensor altitude", "atmosphere", "atmosphere.sensor_altitude_km", "sensor_altitude_km"),
    ("ground height", "atmosphere", "atmosphere.ground_altitude_km", "ground_altitude_km"),
    (
        "ground height of the surroundings",
        "atmosphere",
        "atmosphere.surroundings_altitude_km",
        "surroundings_altitude_km",
    ),
    ("solar irradiance", "atmosphere", "light.irradiance", "solar_irradiance_relative"),
    (SURROUNDINGS, "scene", "light.surroundings", "adjacency_reflectance_relative"),
)
# Over wavelength, of the sensor: name, path, field of ``uncertainty``, whether it needs light.
_SENSOR: tuple[tuple[str, str, str, bool], ...] = (
    ("sensor gain", "sensor.gain", "sensor_gain", False),
    ("sensor offset", "sensor.offset", "sensor_offset", False),
    ("noise", "sensor.noise", "noise", True),
    ("electrons per radiance", "sensor.electrons", "electrons", True),
    ("wavelength shift", "sensor.wavelength_shift_nm", "wavelength_shift", False),
    ("reflectance of the dark panel", "line.dark", "elm_panels", False),
    ("reflectance of the bright panel", "line.bright", "elm_panels", False),
)


def inputs_of(given: Given, *, shapes: bool = True) -> list[Input]:
    """The uncertain inputs in the order in which budgets list them: light, surfaces, sensor.

    ``shapes=False`` leaves out the errors of engine and field spectra, whose covariances a prediction uses as they
    stand.

    Raises
    ------
    UsageError : an uncertainty of what the scenario does not have.
    """
    return [*_of_light(given, shapes), *_of_scene(given, shapes), *_of_sensor(given)]


def given_of(scenario: Scenario, origins: Origins | None = None) -> Given:
    """What the inputs of a scenario are made of.

    The engine is run only where the error of the engine depends on the absorption of gases.
    """
    source = origins or Origins()
    setup = source.setup(scenario, Departure())

    def terms() -> AtmosphericTerms:
        state = setup.scenario.atmosphere
        assert state is not None  # noqa: S101 - asked for by inputs of the light alone
        return source.terms(setup, state)

    return given_with(setup, terms)


def given_with(setup: Setup, terms: Callable[[], AtmosphericTerms]) -> Given:
    """What the inputs of a scenario that was read are made of."""
    return Given(setup.scenario, setup.used.axis, setup.used.sensor, setup.surfaces, terms)


def gas_depth(gas_transmittance: Array) -> Array:
    """-ln T_gas, at most that of a transmittance of 1e-6 [1]."""
    return np.asarray(-np.log(np.clip(gas_transmittance, 1e-6, 1.0)))


def field_spectrum_of(subject: str) -> str:
    """Name of the input that is the error of a subject's field spectrum."""
    return f"field spectrum of {subject}"


def spectrum_inputs(given: Given) -> list[Input]:
    """Errors of field spectra, as stated or as replicate spectra say of their own mean."""
    inputs: list[Input] = []
    number: dict[str, int] = {}
    for item in given.scenario.uncertainty.field_spectra:
        subject = item.subject
        number[subject] = number.get(subject, 0) + 1
        name = field_spectrum_of(subject) + ("" if number[subject] == 1 else f" ({number[subject]})")
        sd = spectrum_error_sd(item, given.surfaces[subject], given.axis)
        inputs.append(spectral_input(given, name, "surface", f"surfaces.[{subject}].mean", sd, item))
    for subject, surface in given.surfaces.items():
        if subject not in number and surface.mean_error is not None:
            rows = covariance_directions(np.nan_to_num(surface.mean_error))
            words = "as between replicate spectra"
            inputs.append(_mean_input(given, field_spectrum_of(subject), "surface", subject, rows, words))
    return inputs


def _mean_input(given: Given, name: str, kind: Kind, subject: str, rows: Array, words: str) -> Input:
    path = f"surfaces.[{subject}].mean"
    at = input_path(given, path)
    return Input(name, kind, path, at.nominal, rows, at.to, correlation=words)


def _of_light(given: Given, shapes: bool) -> list[Input]:
    """Atmosphere, sun and view; the engine's errors on the ground-reflected radiance and on the path."""
    u = given.scenario.uncertainty
    if given.scenario.atmosphere is None:
        return []
    inputs = [
        number_input(given, name, kind, path, spread)
        for name, kind, path, field in _NUMBERS
        if (spread := getattr(u, field)) is not None
    ]
    if u.engine is None or not shapes:
        return inputs
    for name, part in ((ENGINE, u.engine), (ENGINE_LINES, u.engine.fine_structure)):
        if part is None or not (part.relative > 0 or part.per_optical_depth > 0):
            continue
        sd = np.full(len(given.axis), part.relative)
        if part.per_optical_depth > 0:  # greater where gases absorb
            sd = sd + part.per_optical_depth * gas_depth(given.terms().gas_transmittance)
        inputs.append(spectral_input(given, name, "engine", "light.ground", sd, part))
    if u.engine.path_relative > 0:
        inputs.append(spectral_input(given, ENGINE_PATH, "engine", "light.path", u.engine.path_relative, u.engine))
    return inputs


def _of_scene(given: Given, shapes: bool) -> list[Input]:
    """Surfaces, then fills and fractions, then what sampling leaves open."""
    u = given.scenario.uncertainty
    inputs = spectrum_inputs(given) if shapes else []
    for item in u.fills:
        inputs.append(
            number_input(given, f"fill of {item.subject}", "scene", f"fill.[{item.subject}]", item.absolute)
        )
    for item in u.fractions:
        name = f"area fraction of {item.subject}"
        inputs.append(number_input(given, name, "scene", f"fraction.[{item.subject}]", item.absolute))
    for sampled in u.sampled_statistics:
        inputs += _sampled(sampled, given)
    return inputs


def _of_sensor(given: Given) -> list[Input]:
    """Gain, offset, noise, electrons, places of the bands, panels of the line, blur; the image's compensation."""
    u, light = given.scenario.uncertainty, given.scenario.atmosphere is not None
    inputs = []
    for name, path, field, needs_light in _SENSOR:
        form = getattr(u, field)
        if form is not None and (light or not needs_light):
            sd = form.relative if hasattr(form, "relative") else form.absolute
            inputs.append(spectral_input(given, name, "sensor", path, sd, form))
    widths = [p.fill.geometry for t in given.scenario.scene.targets for p in t.populations]
    if u.psf_fwhm_pixels is not None and any(g is not None for g in widths):
        inputs.append(number_input(given, BLUR, "sensor", "blur", u.psf_fwhm_pixels))
    stated = u.collected_reflectance
    if stated is not None and not light:  # what the image's reflectance is off by
        form = SpectralForm(correlation_nm=stated.correlation_nm)
        for name, path, sd in (
            ("compensation (gain)", "sensor.gain", stated.relative),
            ("compensation (offset)", "sensor.offset", stated.absolute),
        ):
            if sd > 0:
                inputs.append(spectral_input(given, name, "sensor", path, sd, form))
    return inputs


def _sampled(item: SampledStatistics, given: Given) -> list[Input]:
    """Mean and covariance that were estimated from n independent normal samples.

    The mean is normal with covariance S / n.  The truth behind S is an inverse Wishart draw,
    Sigma^-1 ~ W(S^-1 / (n - 1), nu).  With nu = n - B the separation d^T Sigma^-1 d of a matched filter is
    distributed as its pivot says, (n - 1) d^T Sigma^-1 d / d^T S^-1 d ~ chi-square(n - B) (Muirhead, Aspects of
    Multivariate Statistical Theory, 1982, theorem 3.2.12).  Below n = 2 B + 2 the covariance moves by one factor.
    """
    subject, surface = item.subject, given.surfaces[item.subject]
    n = item.effective_n or surface.n
    if n is None:
        raise UsageError(
            f"uncertainty: sampled_statistics of {subject!r}: its source does not say how many samples",
            mend="give effective_n",
        )
    inputs = []
    covariance, words = surface.covariance, f"sampling of {n:.4g} independent samples"
    if item.mean:
        rows = covariance_directions(covariance / n)
        if rows.shape[0]:
            inputs.append(_mean_input(given, f"sampled mean of {subject}", "sampling", subject, rows, words))
    # The variance of any one score: s^2 of n - 1 degrees of freedom, log-normal with half of it on its root.
    path = f"surfaces.[{subject}].spread"
    at = input_path(given, path)
    spread = Input(
        f"sampled covariance of {subject}", "sampling", path, at.nominal,
        np.array([[np.sqrt(0.5 / (n - 1.0))]]), at.to, "log-normal", words,
        draws=lambda rng: Departure(statistics={subject: drawn_covariance(covariance, n, rng)}),
    )  # fmt: skip
    return [*inputs, spread]


def drawn_covariance(covariance: Array, n: float, rng: np.random.Generator) -> StatisticsDeparture:
    """A truth behind a covariance (B, B) that was estimated from ``n`` samples (see :func:`_sampled`)."""
    live = np.diag(covariance) > 0
    bands = int(live.sum())
    nu = round(n - bands)
    if nu < bands + 2:
        return StatisticsDeparture(factor=float((n - 1.0) / rng.chisquare(n - 1.0)))
    sd = np.sqrt(np.diag(covariance)[live])
    root = np.linalg.cholesky(covariance[np.ix_(live, live)] / np.outer(sd, sd) + 1e-12 * np.eye(bands))
    # Bartlett: A A^T ~ W(I, nu) with A lower triangular; Sigma = (n - 1) R A^-T A^-1 R^T has the law asked for.
    a = np.tril(rng.standard_normal((bands, bands)), -1)
    a[np.diag_indices(bands)] = np.sqrt(rng.chisquare(nu - np.arange(bands)))
    half = np.linalg.solve(a, (sd[:, None] * root).T).T  # R A^-T up to the order of factors
    out = np.zeros_like(covariance)
    out[np.ix_(live, live)] = (n - 1.0) * half @ half.T
    return StatisticsDeparture(covariance=out)

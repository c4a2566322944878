"""Uncertain inputs of the sensor."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.budget_input import BudgetInput, Given, factor_input, scalar_input, spectral_input
from hyperval.prediction.departure import Departure
from hyperval.prediction.forms import directions, value_at
from hyperval.scenario import ElmPanels
from hyperval.scenario_uncertainty import SpectralForm

Array = npt.NDArray[np.float64]


def sensor_inputs(given: Given) -> list[BudgetInput]:
    """Gain, offset, noise, electrons, places of the bands, blur; what the image's compensation is off by."""
    u, light = given.scenario.uncertainty, given.scenario.atmosphere is not None
    bands = len(given.axis)

    def rows(sd: float, form: SpectralForm) -> Array:
        return directions(np.full(bands, sd), form, given.axis, given.sensor)

    def positive(factor: Array) -> Array:
        return np.maximum(factor, 1e-3)

    found = []
    if u.sensor_gain is not None:
        at = rows(u.sensor_gain.relative, u.sensor_gain)
        found.append(factor_input("sensor gain", "sensor", at, u.sensor_gain, lambda f: Departure(recorded_gain=f)))
    if u.sensor_offset is not None:
        shape = rows(u.sensor_offset.absolute, u.sensor_offset)
        found.append(
            spectral_input(
                "sensor offset", "sensor", shape, u.sensor_offset, lambda c: Departure(recorded_offset=c @ shape)
            )
        )
    if u.noise is not None and light:
        at = rows(u.noise.relative, u.noise)
        found.append(factor_input("noise", "sensor", at, u.noise, lambda f: Departure(noise_factor=positive(f))))
    if u.electrons is not None and light:
        at = rows(u.electrons.relative, u.electrons)
        found.append(
            factor_input(
                "electrons per radiance", "sensor", at, u.electrons, lambda f: Departure(signal_factor=positive(f))
            )
        )
    if u.wavelength_shift is not None:
        places = rows(u.wavelength_shift.absolute, u.wavelength_shift)
        found.append(
            spectral_input(
                "wavelength shift", "sensor", places, u.wavelength_shift,
                lambda c: Departure(wavelength_shift_nm=c @ places),
            )
        )  # fmt: skip
    found += _panels(given)
    found += _blur(given)
    return found + ([] if light else _compensation(given))


def _panels(given: Given) -> list[BudgetInput]:
    """Errors e of the reflectances of the two panels, as parts of them.

    The line through (rho_1 (1 + e_1), L_1) and (rho_2 (1 + e_2), L_2) gives, where L is linear in rho,
    rho + rho_1 e_1 (rho_2 - rho)/(rho_2 - rho_1) + rho_2 e_2 (rho - rho_1)/(rho_2 - rho_1).
    """
    stated, elm = given.scenario.uncertainty.elm_panels, given.scenario.processing.elm
    if stated is None:
        return []
    if not isinstance(elm, ElmPanels):
        raise UsageError("uncertainty: elm_panels needs an empirical line of two panels")
    low, high = elm.reflectances
    rows = directions(np.full(len(given.axis), stated.relative), stated, given.axis, given.sensor)

    def dark(e: Array) -> Departure:
        slope = -low * e / (high - low)
        return Departure(retrieval_gain=1.0 + slope, retrieval_offset=-high * slope)

    def bright(e: Array) -> Departure:
        slope = high * e / (high - low)
        return Departure(retrieval_gain=1.0 + slope, retrieval_offset=-low * slope)

    return [
        factor_input(f"reflectance of the {name} panel", "sensor", rows, stated, lambda f, at=at: at(f - 1.0))  # type: ignore[misc]
        for name, at in (("dark", dark), ("bright", bright))
    ]


def _blur(given: Given) -> list[BudgetInput]:
    """One blur for all targets whose fill follows from geometry."""
    spread = given.scenario.uncertainty.psf_fwhm_pixels
    widths = {}
    for t in given.scenario.scene.targets:
        for i, population in enumerate(t.subjects):
            if population.fill.geometry is not None:
                path = f"scene.targets.[{t.name}].subjects.{i}.fill.geometry.psf_fwhm_pixels"
                widths[path] = population.fill.geometry.psf_fwhm_pixels
        if t.fill is not None and t.fill.geometry is not None:
            path = f"scene.targets.[{t.name}].fill.geometry.psf_fwhm_pixels"
            widths[path] = t.fill.geometry.psf_fwhm_pixels
    if spread is None or not widths:
        return []

    def at(z: float) -> Departure:
        settings: dict[str, object] = {}
        for path, stated in widths.items():
            moved = [float(np.clip(value_at(w, spread, z), 0.0, 5.0)) for w in np.atleast_1d(stated or 0.0)]
            settings[path] = moved[0] if len(moved) == 1 else moved
        return Departure(settings=settings)

    return [scalar_input("blur (PSF width)", "sensor", spread, at, tuple(widths))]


def _compensation(given: Given) -> list[BudgetInput]:
    """In the reflectance domain: what the image's reflectance is off by, seen in surfaces not measured on it."""
    stated = given.scenario.uncertainty.collected_reflectance
    if stated is None:
        return []
    form = SpectralForm(correlation_nm=stated.correlation_nm)
    found = []
    if stated.relative > 0:
        rows = directions(np.full(len(given.axis), stated.relative), form, given.axis)
        found.append(
            factor_input("compensation (gain)", "sensor", rows, form, lambda f: Departure(recorded_gain=f))
        )
    if stated.absolute > 0:
        shape = directions(np.full(len(given.axis), stated.absolute), form, given.axis)
        found.append(
            spectral_input(
                "compensation (offset)", "sensor", shape, form, lambda c: Departure(recorded_offset=c @ shape)
            )
        )
    return found

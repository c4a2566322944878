"""Equations 3.21-3.29 on the arrays that the forward model runs through, against matrices written out.

Two truths of light, noise, area fractions and surroundings go through the model together; each is worked out by
itself (``plain_scene.py``).
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from plain_scene import PlainScene

from hyperval.atmosphere import AtmosphericTerms
from hyperval.model import Evaluation, Origins, World, beta_fill, read_world, with_values
from hyperval.model.detection import class_scores, surroundings_variance, target_scores
from hyperval.model.forward import pixel_spreads
from hyperval.model.objects import object_scores
from hyperval.model.radiance import target_pixels
from hyperval.model.stated import SurfaceStatistics
from hyperval.scenario import Scenario
from hyperval.sensor import NoiseModel, Sensor
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import ClassStatistics

B = 4
RNG = np.random.default_rng(3280)
KAPPA = (0.05, 0.2)
FRACTIONS = np.array([[0.7, 0.3], [0.4, 0.6]])
GAINS = np.array([[1.0, 2.0], [1.5, 0.5]])


def some_terms(level: float) -> AtmosphericTerms:
    w = np.linspace(450.0, 900.0, B)
    a, b = level * (1.0 + 0.1 * np.arange(B)), 0.3 * level * np.ones(B)
    return AtmosphericTerms(w, 0.2 * np.ones(B), a, b, np.linspace(0.05, 0.2, B), np.ones(B), np.ones(B), {},
                            None, np.linspace(0.3, 0.1, B))  # fmt: skip


AXIS = SpectralAxis(np.linspace(450.0, 900.0, B), np.full(B, 10.0))


def some_noise(scale: float) -> NoiseModel:
    return NoiseModel(scale * 4e3 * np.ones(B), 30.0 * np.ones(B), 1.0, np.full(B, 5.0), 12, 0.0,
                      np.full(B, 0.5 * scale))  # fmt: skip


def surface(name: str, mean: float, spread: float) -> SurfaceStatistics:
    x = RNG.normal(0.0, spread, (40, B)).cumsum(axis=1)
    return SurfaceStatistics(name, AXIS, mean + 0.02 * np.arange(B), np.cov(x.T) + spread**2 * np.eye(B))


SURFACES = {s.name: s for s in (surface("soil", 0.2, 0.02), surface("grass", 0.35, 0.03), surface("plank", 0.55, 0.02))}
TERMS, NOISE = (some_terms(3.0), some_terms(2.0)), (some_noise(1.0), some_noise(0.5))
BEAM, SKY = np.array([1.0, 0.4]), np.array([1.0, 0.8])
SCENARIO = {
    "name": "two",
    "sensor": "prospectir-vs",
    "atmosphere": {"aot550": 0.0, "sensor_altitude_km": 1, "solar_zenith_deg": 30, "solar_azimuth_deg": 0,
                   "day_of_year": 200},
    "scene": {
        "classes": [{"name": n, "fraction": 0.5, "spectrum": {"measured": n}} for n in ("soil", "grass")],
        "targets": [{"name": "plank", "host": "grass", "spectrum": {"measured": "plank"}, "fill": {"fixed": 0.3}}],
    },
    "processing": {"detectors": ["cem"], "bands": {"drop_bad": False, "windows_only": False}},
}  # fmt: skip


def both(**more: np.ndarray) -> World:
    """The two truths."""
    measured = {n: ClassStatistics(n, AXIS, s.mean, s.covariance, 40) for n, s in SURFACES.items()}
    sensor = SimpleNamespace(
        name="stand-in", axis=AXIS, noise=lambda *a: NOISE[0], true_axis=lambda axis, *a: axis, notes=lambda *a: [],
        specification=SimpleNamespace(psf=None), operated_noise=lambda *a: Sensor.operated_noise(sensor, *a),
    )  # fmt: skip
    origins = Origins(
        AXIS, measured, engine=lambda state: replace(TERMS[int(state.aot550 > 0)], fwhm_nm=AXIS.fwhm_nm), sensor=sensor
    )
    moved = {
        "atmosphere.aot550": np.array([0.0, 0.5]),
        "sensor_changes.signal_factor": np.array([1.0, 0.5]),
        "sensor_changes.calibration_error_percent": np.array([0.5, 0.25]),
        "scene.adjacency.effective_neighbours": 1.0 / np.array(KAPPA),
        "scene.targets.plank.illumination.beam": BEAM,
        "scene.targets.plank.illumination.sky_view": SKY,
    }
    for m, name in enumerate(("soil", "grass")):
        moved |= {f"scene.classes.{name}.fraction": FRACTIONS[:, m], f"scene.classes.{name}.gain": GAINS[:, m]}
    world = read_world(Scenario.model_validate(SCENARIO), origins)
    world.stated.of_pixels[:] = False  # spreads of the ground itself, to which the noise comes
    return with_values(world, moved | more)


def plain(u: int, fractions: np.ndarray = FRACTIONS) -> PlainScene:
    """One of the truths."""
    shares, gains = (dict(zip(("soil", "grass"), each[u], strict=True)) for each in (fractions, GAINS))
    return PlainScene(TERMS[u], NOISE[u], SURFACES, shares, "plank", "grass", gains, KAPPA[u], BEAM[u], SKY[u])


def designed():
    e = Evaluation(both())
    filters, _, _ = e.filters["plank", "cem"]
    assert not e.problems
    return e, filters


def test_3_22_to_3_25_filters_of_two_truths():
    _, filters = designed()
    for u in (0, 1):
        w, mu = plain(u).filter
        assert filters.weights[u] == pytest.approx(w, rel=1e-9)
        assert filters.offset[u] == pytest.approx(w @ mu, rel=1e-9)


def test_3_27_and_3_29_scores_of_the_classes():
    e, filters = designed()
    means, sds = class_scores(e.retrieval, filters)
    for u in (0, 1):
        for m, of_class in enumerate(plain(u).classes.values()):
            mean, variance = plain(u).scores(of_class)
            assert means[u, m] == pytest.approx(mean, abs=1e-10)  # (3.27)
            assert sds[u, m] ** 2 == pytest.approx(variance, rel=1e-9)  # (3.29)


@pytest.mark.parametrize("alike", [True, False])
def test_3_11_surroundings_by_their_matrix_and_by_the_classes(alike):
    """Truths of one background have a Sigma_ave, others go through the classes together."""
    rng = np.random.default_rng(311)
    fractions = np.tile(FRACTIONS[:1], (2, 1)) if alike else FRACTIONS
    moved = {f"scene.classes.{n}.fraction": fractions[: 1 if alike else 2, m] for m, n in enumerate(("soil", "grass"))}
    v = rng.normal(size=(2, 3, B))
    e = Evaluation(both(**moved))
    assert e.bands.size == B
    found = surroundings_variance(e.retrieval.classes, v)
    for u in (0, 1):
        sigma = plain(u, fractions).surroundings
        assert found[u] == pytest.approx(np.diag(v[u] @ sigma @ v[u].T), rel=1e-11)
        assert np.diag(e.retrieval.classes.covariance(u)) == pytest.approx(np.diag(sigma), rel=1e-11)
        around = e.retrieval.classes.scene_variances()
        assert around[u if len(around) > 1 else 0] == pytest.approx(np.diag(sigma), rel=1e-11)


def test_3_26_and_3_28_scores_of_target_pixels_in_their_own_light():
    e, filters = designed()
    found = target_scores(e.retrieval, filters, e.material(0, e.world), np.arange(2))
    fills, gains = np.array([[0.0, 0.3, 1.0]]), np.array([1.0, 3.0])
    means, sds = found.moments(fills, gains, np.arange(2))
    for u in (0, 1):
        for i, f in enumerate(fills[0]):
            mean, variance = plain(u).scores(plain(u).pixel(f, gains[u]))
            assert means[u, i] == pytest.approx(mean, abs=1e-10)  # (3.26)
            assert sds[u, i] ** 2 == pytest.approx(variance, rel=1e-9)  # (3.28)


def test_3_7_light_on_a_target_in_the_shade():
    e = Evaluation(both())
    target = e.material(0, e.world)
    lit, under, factor = e.retrieval.light.surface(target.mean, target.beam, target.sky)
    light = plain(1).light()
    assert np.asarray(factor)[:, 0] == pytest.approx(np.array([np.ones(B), light]))
    assert lit[1, 0] == pytest.approx(light * SURFACES["plank"].mean)
    assert under[1, 0] == pytest.approx(0.8 * SURFACES["plank"].mean)


def test_3_12_target_pixels_of_a_fill():
    e, f, one = Evaluation(both()), 0.3, plain(1)
    means, noise, sides, _ = target_pixels(e.retrieval, e.material(0, e.world), np.array([f]))
    d_b, (mean, covariance) = (1 - f) * sides[0][-1, 0] + f * sides[1][-1, 0], one.pixel(f)
    slope, around = e.retrieval.slope[1], e.retrieval.classes.covariance(1)
    whole = one.within(f, 1.0) * np.outer(slope, slope) + around * np.outer(d_b, d_b) + np.diag(noise[1, 0])
    assert means[1, 0] == pytest.approx(mean, rel=1e-9)
    assert whole == pytest.approx(covariance, rel=1e-9)
    levels = {n: one.level(s.mean) for n, s in SURFACES.items()} | {"plank": one.b + one.k * mean}
    spreads = pixel_spreads(e, 1, levels)
    for name, (_, own) in zip(SURFACES, [*one.classes.values(), one.pixel(f)], strict=True):
        assert spreads["reflectance", name][0] == pytest.approx(own, rel=1e-9)


def test_3_26_and_3_28_drawn_scores_of_objects():
    drawn = object_scores(both(), [(np.arange(2), Evaluation(both()))], np.array([1]), 40_000)["plank", "cem"].values
    mean, variance = plain(1).scores(plain(1).pixel(0.3))
    z = (drawn - mean) / np.sqrt(variance)
    assert abs(z.mean()) < 5.0 / np.sqrt(z.size)  # (3.26)
    assert abs(z.var() - 1.0) < 5.0 * np.sqrt(2.0 / z.size)  # (3.28)


def test_3_28_by_monte_carlo():
    """200,000 pixels of drawn fills through light, noise and filter; |z| of mean and variance < 5, failure 1e-6."""
    rng, n = np.random.default_rng(3281), 200_000
    e, filters = designed()
    found = target_scores(e.retrieval, filters, e.material(0, e.world), np.arange(2))
    fill, one = beta_fill(0.3, 0.1), plain(1)
    means, sds = found.moments(fill.values[None], np.full(1, 1.0), np.array([1]))
    mean = float(fill.weights @ means[0])
    variance = float(fill.weights @ (sds[0] ** 2 + (means[0] - mean) ** 2))
    own, host, light = SURFACES["plank"], SURFACES["grass"], one.light()
    f = rng.choice(fill.values, n, p=fill.weights)[:, None]
    target = light * rng.multivariate_normal(own.mean, own.covariance, n)
    background = rng.multivariate_normal(host.mean, one.gains["grass"] * host.covariance, n)
    under = f * 0.8 * own.mean + (1 - f) * host.mean
    away = rng.multivariate_normal(np.zeros(B), one.kappa * one.gains["grass"] * one.surroundings, n)
    level = one.level(f * target + (1 - f) * background) + one.slope_around(under) * away
    typical = one.level(f * light * own.mean + (1 - f) * host.mean)
    level = level + rng.standard_normal((n, B)) * np.sqrt(one.noise.variance(typical))
    score = ((level - one.b) / one.k) @ filters.weights[1] - filters.offset[1]
    assert abs(score.mean() - mean) < 5 * score.std() / np.sqrt(n)
    kurtosis = np.mean((score - score.mean()) ** 4) / score.var() ** 2
    assert abs(score.var() - variance) < 5 * score.var() * np.sqrt((kurtosis - 1) / n)

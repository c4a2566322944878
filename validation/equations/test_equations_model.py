"""Equations 3.21-3.29 on the arrays that the forward model runs through, against matrices written out.

Two settings of light, noise, area fractions and surroundings go through the model together; each is worked out by
itself here, with diagonal matrices and inverses as the equations are printed.
"""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.prediction.background import Settings, View, ground_of, seen_classes, stacked, stacked_noise
from hyperval.prediction.filters import (
    FILL_NODES,
    Designer,
    Material,
    law_scores,
    lit_surface,
    noise_of,
    responses,
    target_population,
)
from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.scenario import ElmPanels, Processing
from hyperval.scene.fill import beta_fill
from hyperval.sensor.noise import NoiseModel

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


def some_noise(scale: float) -> NoiseModel:
    return NoiseModel(scale * 4e3 * np.ones(B), 30.0 * np.ones(B), 1.0, np.full(B, 5.0), 12, 0.0, "bit",
                      np.full(B, 0.5 * scale))  # fmt: skip


def surface(name: str, mean: float, spread: float) -> SurfaceStatistics:
    x = RNG.normal(0.0, spread, (40, B)).cumsum(axis=1)
    return SurfaceStatistics(name, mean + 0.02 * np.arange(B), np.cov(x.T) + spread**2 * np.eye(B), "drawn")


SURFACES = {s.name: s for s in (surface("soil", 0.2, 0.02), surface("grass", 0.35, 0.03), surface("plank", 0.55, 0.02))}
TERMS, NOISE = (some_terms(3.0), some_terms(2.0)), (some_noise(1.0), some_noise(0.5))
MATERIAL = Material("plank", 1, np.array([1.0, 0.4]), np.array([1.0, 0.8]))


def both() -> Settings:
    grounds = tuple(ground_of(SURFACES, ["soil", "grass"], f) for f in FRACTIONS)
    view = View(
        stacked(TERMS, B),
        np.array([g.average for g in grounds])[:, None, :],
        stacked_noise(NOISE, B),
        np.array(KAPPA)[:, None, None],
        "corrected",
        ElmPanels(),
    )
    return Settings(view, FRACTIONS, GAINS, grounds, np.arange(2))


class Plain:
    """One setting, by the equations one after the other."""

    def __init__(self, u: int):
        self.t, self.noise, self.kappa, self.g = TERMS[u], NOISE[u], KAPPA[u], GAINS[u]
        self.f, means = FRACTIONS[u], np.array([SURFACES[n].mean for n in ("soil", "grass")])
        self.average = self.f @ means  # (3.8)
        self.surroundings = sum(
            f * (SURFACES[n].covariance + np.outer(m - self.average, m - self.average))
            for f, n, m in zip(self.f, ("soil", "grass"), means, strict=True)
        )
        low, high = self.level(np.full(B, 0.1)), self.level(np.full(B, 0.6))
        self.k = (high - low) / 0.5
        self.b = low - 0.1 * self.k

    def level(self, rho: np.ndarray) -> np.ndarray:
        t = self.t
        return t.path_radiance + (t.direct * rho + t.adjacency * self.average) / (1 - t.spherical_albedo * self.average)

    def seen(self, rho: np.ndarray, under: np.ndarray, covariance: np.ndarray, gain: float):
        t, trapping = self.t, 1 - self.t.spherical_albedo * self.average
        d_a, d_b = t.direct / trapping, (t.direct * t.spherical_albedo * under + t.adjacency) / trapping**2
        sigma = np.diag(d_a) @ covariance @ np.diag(d_a)
        sigma = sigma + self.kappa * gain * np.diag(d_b) @ self.surroundings @ np.diag(d_b)  # (3.11)
        sigma = sigma + np.diag(self.noise.variance(self.level(rho)))  # (3.16)-(3.19)
        return (self.level(rho) - self.b) / self.k, np.diag(1 / self.k) @ sigma @ np.diag(1 / self.k)

    def classes(self):
        found = [(SURFACES[n], g) for n, g in zip(("soil", "grass"), self.g, strict=True)]
        return [self.seen(s.mean, s.mean, g * s.covariance, g) for s, g in found]

    def filter(self) -> tuple[np.ndarray, np.ndarray]:
        seen = self.classes()
        mu = sum(f * m for f, (m, _) in zip(self.f, seen, strict=True))
        sigma = sum(f * (c + np.outer(m - mu, m - mu)) for f, (m, c) in zip(self.f, seen, strict=True))
        d = (self.level(SURFACES["plank"].mean) - self.b) / self.k - mu  # (3.22)
        w = np.linalg.inv(sigma) @ d / (d @ np.linalg.inv(sigma) @ d)  # (3.23)-(3.25)
        return w, mu

    def light(self, beam: float, sky: float) -> np.ndarray:
        back, q = self.t.spherical_albedo * self.average, self.t.diffuse_fraction
        return (1 - back) * ((1 - q) * beam + q * sky) + back * sky


def designed(at: Settings):
    seen = seen_classes(at)
    level = at.levels(SURFACES["plank"].mean[None])
    wanted = [("cem", ((level - seen.offset) / seen.gain)[:, 0])]
    filters, problems = Designer(Processing(), ["soil", "grass"], B).design(at, seen, wanted)
    assert not problems
    return seen, filters[0]


def test_3_22_to_3_25_filters_of_two_settings():
    _, filters = designed(both())
    for u in (0, 1):
        w, mu = Plain(u).filter()
        assert filters.weights[u] == pytest.approx(w, rel=1e-9)
        assert filters.offset[u] == pytest.approx(w @ mu, rel=1e-9)


def test_3_27_and_3_29_scores_of_the_classes():
    at = both()
    seen, filters = designed(at)
    means, sds = law_scores(at, seen, filters)
    for u in (0, 1):
        w, mu = Plain(u).filter()
        for m, (mean, covariance) in enumerate(Plain(u).classes()):
            assert means[u, m] == pytest.approx(w @ (mean - mu), abs=1e-10)  # (3.27)
            assert sds[u, m] ** 2 == pytest.approx(w @ covariance @ w, rel=1e-9)  # (3.29)


@pytest.mark.parametrize("count", [3, 40])
def test_3_11_surroundings_by_their_matrix_and_by_the_classes(count):
    """Grounds of a small batch have a Sigma_ave each, those of a large one go through the classes together."""
    rng = np.random.default_rng(311)
    fractions = rng.dirichlet([1.0, 2.0], count)
    grounds = tuple(ground_of(SURFACES, ["soil", "grass"], f) for f in fractions)
    view = View(None, np.array([g.average for g in grounds])[:, None, :], None, 0.1, "corrected", None)
    v = rng.normal(size=(count, 3, B))
    found = Settings(view, fractions, np.ones((count, 2)), grounds, np.arange(count)).surroundings(v)
    means = np.array([SURFACES[n].mean for n in ("soil", "grass")])
    for u, f in enumerate(fractions):
        sigma = sum(
            p * (SURFACES[n].covariance + np.outer(m - f @ means, m - f @ means))
            for p, n, m in zip(f, ("soil", "grass"), means, strict=True)
        )
        assert found[u] == pytest.approx(np.diag(v[u] @ sigma @ v[u].T), rel=1e-11)


def test_3_26_and_3_28_scores_of_target_pixels_in_their_own_light():
    at = both()
    seen, filters = designed(at)
    found = responses(at, seen, filters, MATERIAL)
    fills, gains = np.array([[0.0, 0.3, 1.0]]), np.array([1.0, 3.0])
    means, sds = found.at(fills, gains, np.arange(2))
    own, host = SURFACES["plank"], SURFACES["grass"]
    for u in (0, 1):
        one = Plain(u)
        w, mu = one.filter()
        light = one.light(MATERIAL.beam[u], MATERIAL.sky[u])
        for i, f in enumerate(fills[0]):
            rho = f * light * own.mean + (1 - f) * host.mean  # (3.10)
            under = f * MATERIAL.sky[u] * own.mean + (1 - f) * host.mean
            lit = np.diag(light) @ own.covariance @ np.diag(light)
            inside = f**2 * gains[u] * lit + (1 - f) ** 2 * one.g[1] * host.covariance  # (3.12)
            mean, covariance = one.seen(rho, under, inside, one.g[1])
            assert means[u, i] == pytest.approx(w @ (mean - mu), abs=1e-10)  # (3.26)
            assert sds[u, i] ** 2 == pytest.approx(w @ covariance @ w, rel=1e-9)  # (3.28)


def test_3_7_light_on_a_target_in_the_shade():
    lit, under, factor = lit_surface(both(), MATERIAL)
    light = Plain(1).light(0.4, 0.8)
    assert np.asarray(factor)[:, 0] == pytest.approx(np.array([np.ones(B), light]))
    assert lit[1, 0] == pytest.approx(light * SURFACES["plank"].mean)
    assert under[1, 0] == pytest.approx(0.8 * SURFACES["plank"].mean)


def test_3_12_target_pixels_of_random_fill():
    at, fill = both(), beta_fill(0.4, 0.1)
    seen = seen_classes(at)
    found = target_population(at, seen, 1, MATERIAL, fill, 3.0)
    one, own, host = Plain(1), SURFACES["plank"], SURFACES["grass"]
    light = one.light(0.4, 0.8)
    d = light * own.mean - host.mean
    inside = fill.values[:, None, None] ** 2 * 3.0 * (np.diag(light) @ own.covariance @ np.diag(light))
    inside = inside + (1 - fill.values[:, None, None]) ** 2 * one.g[1] * host.covariance
    inside = np.einsum("k,kij->ij", fill.weights, inside) + fill.variance * np.outer(d, d)  # (3.12) over the fill
    assert found.covariance == pytest.approx(inside, rel=1e-9)
    rho, under = host.mean + 0.4 * d, host.mean + 0.4 * (0.8 * own.mean - host.mean)
    mean, covariance = one.seen(rho, under, inside, one.g[1])
    slope, around = seen.slope[1], at.grounds[1].covariance
    whole = inside * np.outer(slope, slope) + around * np.outer(found.around, found.around) + np.diag(found.noise)
    assert found.mean == pytest.approx(mean, rel=1e-9)
    assert whole == pytest.approx(covariance, rel=1e-9)


def test_3_16_to_3_19_noise_at_a_retrieved_reflectance():
    at = both()
    one = Plain(1)
    rho = np.array([0.1, 0.2, 0.4, 0.6])
    expected = one.noise.variance(one.b + one.k * rho) / one.k**2
    assert noise_of(at, seen_classes(at), 1, rho) == pytest.approx(expected, rel=1e-10)


def test_3_28_by_monte_carlo():
    """200,000 pixels of drawn fills through light, noise and filter; |z| of mean and variance < 5, failure 1e-6."""
    rng, at, n = np.random.default_rng(3281), both(), 200_000
    seen, filters = designed(at)
    found = responses(at, seen, filters, MATERIAL)
    fill, one = beta_fill(0.3, 0.1), Plain(1)
    means, sds = found.at(fill.values[None], np.full(1, 1.0), np.array([1]))
    mean = float(fill.weights @ means[0])
    variance = float(fill.weights @ (sds[0] ** 2 + (means[0] - mean) ** 2))
    own, host = SURFACES["plank"], SURFACES["grass"]
    f = rng.choice(fill.values, n, p=fill.weights)[:, None]
    light = one.light(0.4, 0.8)
    target = light * rng.multivariate_normal(own.mean, own.covariance, n)
    behind = rng.multivariate_normal(host.mean, one.g[1] * host.covariance, n)
    trapping = 1 - one.t.spherical_albedo * one.average
    under = f * 0.8 * own.mean + (1 - f) * host.mean
    d_b = (one.t.direct * one.t.spherical_albedo * under + one.t.adjacency) / trapping**2
    away = rng.multivariate_normal(np.zeros(B), one.kappa * one.g[1] * one.surroundings, n)
    level = one.level(f * target + (1 - f) * behind) + d_b * away
    typical = one.level(f * light * own.mean + (1 - f) * host.mean)
    level = level + rng.standard_normal((n, B)) * np.sqrt(one.noise.variance(typical))
    score = ((level - one.b) / one.k) @ filters.weights[1] - filters.offset[1]
    assert FILL_NODES.size == 9
    assert abs(score.mean() - mean) < 5 * score.std() / np.sqrt(n)
    kurtosis = np.mean((score - score.mean()) ** 4) / score.var() ** 2
    assert abs(score.var() - variance) < 5 * score.var() * np.sqrt((kurtosis - 1) / n)

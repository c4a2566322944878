"""A pixel that a target fills in part keeps the law of its host: limits, drawn pixels, one law everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from test_prediction_mixtures import drawn, of_region, two_clusters
from uncertain_scene import AXIS, scenario

from hyperval.model import (
    Evaluation,
    Origins,
    predict,
    read,
)
from hyperval.statistics_library import builtin_class

BANDS = len(AXIS)
LINEAR = ("cem", "cem-correlation", "matched-filter")
GAIN = {"grass": 1.5, "asphalt": 0.7}  # of the classes' covariances
SQUARE = "{geometry: {side_m: 0.3, gsd_m: 0.7, heading_deg: 10, psf_fwhm_pixels: 0.8, pixels: ranked, n: 3}}"


def scene(fill: str = "{fixed: 0.1}", tail: object = "null", detectors: str = "cem", host: str = "asphalt"):
    """Planks on a host whose class has the tail, beside another class."""
    return scenario(
        "",
        **{
            "spectrum: {builtin: grass}}": "spectrum: {measured: field}, mixture: auto, tail_dof: measured, gain: 1.5}",
            "spectrum: {builtin: asphalt}}": f"spectrum: {{builtin: asphalt}}, tail_dof: {tail}, gain: 0.7}}",
            "host: asphalt": f"host: {host}\n      covariance: {{relative_sd: 0.05}}",
            "fill: {fixed: 0.1}": f"fill: {fill}",
            "detectors: [cem]": f"elm: none, samples: 4000, detectors: [{detectors}]",
        },
    )


def run(of, components=None, **kwargs):
    origins = Origins(AXIS, {"field": of_region(components)})
    return predict(of, origins, **kwargs), Evaluation(read(of, origins))


def drawn_host(host, dof, n, rng):
    """Pixels (n, B) of a class by plain draws."""
    of = builtin_class(host, AXIS)
    if host == "grass":
        away = drawn(two_clusters(dof), n, rng) - of.mean
    else:
        z = rng.standard_normal((n, BANDS)) * np.sqrt((dof - 2.0) / rng.chisquare(dof, n))[:, None]
        away = z @ np.linalg.cholesky(of.covariance).T
    return of.mean + np.sqrt(GAIN[host]) * away


def host_exceedance(curve, made, there, detector, host):
    """P(score > x) of the host's class alone at the thresholds of a curve: its part of (3.33)."""
    scores, stated = there.scores("tenth", detector).classes, there.stated
    own = [j for j, law in enumerate(stated.laws) if law.owner == stated.classes.index(host)]
    total, part = 0.0, scores.fraction[0, own] / scores.fraction[0, own].sum()
    for j, p in zip(own, part, strict=True):
        m, s, nu = scores.mean[0, j], scores.sd[0, j], scores.dof[0, j]
        law = stats.norm(m, s) if np.isinf(nu) else stats.t(nu, m, s * np.sqrt((nu - 2.0) / nu))
        total = total + p * law.sf(curve.threshold)
    return total


@pytest.mark.parametrize("detector", LINEAR)
@pytest.mark.parametrize("dof", [2.2, 4.0, 9.0, 60.0])
def test_an_empty_pixel_passes_as_often_as_its_host(dof, detector):
    # The fill of 1e-9 leaves the score where it is: what remains is the quadrature over the tails.
    for fill in ("{fixed: 1e-9}", "{mean: 1e-8, sd: 1e-9}"):
        made, there = run(scene(fill, dof, detector))
        for unit in ("pixel", "object"):
            curve = made.roc["tenth", detector, unit]
            expected = host_exceedance(curve, made, there, detector, "asphalt")
            some = expected > 1e-9
            assert some.sum() > 100
            assert curve.pd[some] == pytest.approx(expected[some], rel=2e-5)


@pytest.mark.parametrize(("dof", "host"), [(3.0, "asphalt"), (8.0, "asphalt"), (np.inf, "grass"), (5.0, "grass")])
@pytest.mark.parametrize("fill", [0.0, 0.05, 0.3])
def test_detections_are_those_of_drawn_pixels(dof, host, fill):
    # 1,000,000 pixels; thresholds within 4.5 standard deviations: by chance fails in 5e-4 of all runs together.
    components, n, rng = two_clusters(dof if host == "grass" else np.inf), 1_000_000, np.random.default_rng(11)
    made, there = run(
        scene(f"{{fixed: {max(fill, 1e-9)}}}", dof if host == "asphalt" else "null", host=host), components
    )
    curve = made.roc["tenth", "cem", "pixel"]
    filters, plank = there.filters["plank", "cem"][0], there.stated.surfaces["plank"]
    behind = drawn_host(host, dof, n, rng)
    own = plank.mean + rng.standard_normal((n, BANDS)) @ np.linalg.cholesky(plank.covariance + 1e-15 * np.eye(BANDS)).T
    pixels = fill * own + (1.0 - fill) * behind
    scores = pixels[:, there.bands] @ filters.weights[0] - filters.offset[0]
    for level in (0.5, 0.1, 1e-2, 1e-3, 1e-4):
        at = int(np.argmin(np.abs(np.log(curve.pfa / level))))
        p = curve.pd[at]
        assert abs(float(np.mean(scores > curve.threshold[at])) - p) < 4.5 * np.sqrt(p * (1.0 - p) / n) + 3.0 / n


@pytest.mark.parametrize(("dof", "host"), [(None, "asphalt"), (3.0, "asphalt"), (np.inf, "grass"), (5.0, "grass")])
@pytest.mark.parametrize("fill", ["{fixed: 0.1}", SQUARE])
def test_drawn_objects_have_the_law_of_their_curve(dof, host, fill):
    components = two_clusters(dof if host == "grass" else np.inf)
    made, _ = run(scene(fill, (dof or "null") if host == "asphalt" else "null", host=host), components, objects=True)
    curve = made.roc["tenth", "cem", "object"]
    draws = np.sort(made.object_scores["tenth", "cem"].values, axis=None)
    found = 1.0 - np.searchsorted(draws, curve.threshold) / draws.size
    # The greatest error of a sampled distribution of 38,400: 0.0083 once in a thousand.
    assert found == pytest.approx(curve.pd, abs=0.0083)
    far = curve.pd < 2e-3  # a few per cent of what lies far out: 5 standard deviations
    assert np.all(np.abs(found - curve.pd)[far] < 5.0 * np.sqrt(curve.pd[far] / draws.size) + 2.0 / draws.size)


@pytest.mark.parametrize(("dof", "host"), [(4.0, "asphalt"), (np.inf, "grass"), (5.0, "grass")])
def test_ace_sees_the_same_pixels(dof, host):
    # 400,000 pixels and 4,000 draws of the model: within 4.5 standard deviations of both (its error as stated).
    components, n, rng = two_clusters(dof if host == "grass" else np.inf), 400_000, np.random.default_rng(12)
    of = scene("{fixed: 0.03}", dof if host == "asphalt" else "null", "ace", host)
    made, there = run(of, components)
    curve, ground = made.roc["tenth", "ace", "pixel"], there.stated.surfaces
    names, fractions = ("grass", "asphalt"), (0.7, 0.3)
    mean = sum(f * ground[k].mean for f, k in zip(fractions, names, strict=True))
    away = [ground[k].mean - mean for k in names]
    within = [GAIN[k] * ground[k].covariance for k in names]
    spread = sum(f * (c + np.outer(d, d)) for f, c, d in zip(fractions, within, away, strict=True))
    behind = drawn_host(host, dof, n, rng)
    plank = ground["plank"]
    own = plank.mean + rng.standard_normal((n, BANDS)) @ np.linalg.cholesky(plank.covariance + 1e-15 * np.eye(BANDS)).T
    root = np.linalg.inv(np.linalg.cholesky(spread))
    y, axis = (0.03 * own + 0.97 * behind - mean) @ root.T, root @ (plank.mean - mean)
    scores = (y @ axis) ** 2 / np.einsum("ij,ij->i", y, y) / (axis @ axis)
    for level in (0.3, 0.1, 1e-2, 1e-3):
        at = int(np.argmin(np.abs(np.log(curve.pfa / level))))
        p = curve.pd[at]
        error = np.sqrt(p * (1.0 - p) * (1.0 / n + 1.0 / 4000))
        assert abs(float(np.mean(scores > curve.threshold[at])) - p) < 4.5 * error

"""Classes that are mixtures, and pixels that a target fills in part: the law of the host, as drawn."""

from dataclasses import replace

import numpy as np
import pytest
from uncertain_scene import AXIS, scenario

from hyperval.data import Components
from hyperval.errors import UsageError
from hyperval.model import Evaluation, Origins, predict, read_world
from hyperval.statistics_library import ClassStatistics, builtin_class

BANDS = len(AXIS)


def of_region(components: Components | None, tail_dof: float | None = None) -> ClassStatistics:
    """Grass, whose moments are those of its components where it has some."""
    grass = builtin_class("grass", AXIS)
    covariance = grass.covariance + 1e-5 * np.eye(BANDS) if components is None else components.covariance
    return ClassStatistics("field", AXIS, grass.mean, covariance, 500, "a region", tail_dof, components)


def two_clusters(dof: float = np.inf) -> Components:
    """A broad cluster, and one of 5 % that lies off towards the spectrum of the planks."""
    grass, plank = builtin_class("grass", AXIS), builtin_class("yellow-paint-plank", AXIS)
    away = 0.15 * (plank.mean - grass.mean)
    wide = grass.covariance + 1e-5 * np.eye(BANDS)
    return Components(np.array([0.95, 0.05]), np.array([-0.05 * away, 0.95 * away]), np.array([wide, 0.3 * wide]), dof)


def mixed(mixture: object = "auto", tail: object = "null", detectors: str = "cem"):
    return scenario(
        "",
        **{
            "spectrum: {builtin: grass}}": f"spectrum: {{measured: field}}, mixture: {mixture}, tail_dof: {tail}}}",
            "detectors: [cem]": f"elm: none, samples: 1500, detectors: [{detectors}]",
        },
    )


def curve_of(statistics: ClassStatistics, of):
    return predict(of, Origins(AXIS, {"field": statistics})).roc["tenth", "cem", "pixel"]


@pytest.mark.parametrize("tail", ["null", "measured"])
def test_one_component_is_the_class_itself(tail):
    whole = of_region(None, 5.0)
    one = Components(np.ones(1), np.zeros((1, BANDS)), whole.covariance[None], 5.0 if tail == "measured" else np.inf)
    before, after = (
        curve_of(s, mixed(m, tail)) for s, m in ((whole, "null"), (replace(whole, components=one), "auto"))
    )
    assert after.threshold == pytest.approx(before.threshold, rel=1e-12)
    assert after.pd == pytest.approx(before.pd, rel=1e-12, abs=1e-15)


def drawn(components: Components, count: int, rng: np.random.Generator) -> np.ndarray:
    """Pixels (count, B) of grass with these components, by plain draws."""
    which = rng.choice(len(components), size=count, p=components.weights)
    out = np.empty((count, BANDS))
    for k in range(len(components)):
        here = which == k
        z = rng.standard_normal((here.sum(), BANDS)) @ np.linalg.cholesky(components.covariances[k]).T
        if np.isfinite(components.dof):
            z *= np.sqrt((components.dof - 2.0) / rng.chisquare(components.dof, here.sum()))[:, None]
        out[here] = builtin_class("grass", AXIS).mean + components.offsets[k] + z
    return out


def test_what_is_not_there_is_refused():
    with pytest.raises(UsageError, match="3 components are asked for, its source has 2"):
        curve_of(of_region(two_clusters()), mixed(3))
    with pytest.raises(UsageError, match="its source has none"):
        curve_of(of_region(None), mixed(2))
    assert curve_of(of_region(None), mixed("auto")).pd.size  # one law is an answer too
    with pytest.raises(UsageError, match="do not fit 10 bands"):
        replace(of_region(None), components=two_clusters().at(np.arange(4)))


SLOW = pytest.mark.slow
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
    return predict(of, origins, **kwargs), Evaluation(read_world(of, origins))


def drawn_host(host, dof, n, rng):
    """Pixels (n, B) of a class by plain draws."""
    of = builtin_class(host, AXIS)
    if host == "grass":
        away = drawn(two_clusters(dof), n, rng) - of.mean
    else:
        z = rng.standard_normal((n, BANDS)) * np.sqrt((dof - 2.0) / rng.chisquare(dof, n))[:, None]
        away = z @ np.linalg.cholesky(of.covariance).T
    return of.mean + np.sqrt(GAIN[host]) * away


@pytest.mark.parametrize(("dof", "host"), [(3.0, "asphalt"), (8.0, "asphalt"), (np.inf, "grass"), (5.0, "grass")])
@pytest.mark.parametrize("fill", [pytest.param(0.0, marks=SLOW), 0.05, pytest.param(0.3, marks=SLOW)])
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
@pytest.mark.parametrize("fill", ["{fixed: 0.1}", SQUARE, SQUARE.replace("ranked, n: 3", "touched")])
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


def test_ace_of_a_population_is_the_mean_over_its_pixels_whatever_others_there_are():
    each = (0.02, 0.05, 0.1, 0.9)
    fills = (f"{{listed: {[[f] for f in each]}}}", *(f"{{fixed: {f}}}" for f in each))
    whole, *alone = (run(scene(f, detectors="ace"))[0].roc["tenth", "ace", "pixel"].pd for f in fills)
    assert whole == pytest.approx(np.mean(alone, axis=0), abs=0.01)


@pytest.mark.parametrize(
    ("dof", "host"),
    [pytest.param(4.0, "asphalt", marks=SLOW), pytest.param(np.inf, "grass", marks=SLOW), (5.0, "grass")],
)
def test_ace_sees_the_same_pixels(dof, host):
    # 400,000 pixels and 4,000 draws of the model: within 4.5 standard deviations of both (its error as stated).
    components, n, rng = two_clusters(dof if host == "grass" else np.inf), 400_000, np.random.default_rng(12)
    made, there = run(scene("{fixed: 0.03}", dof if host == "asphalt" else "null", "ace", host), components)
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

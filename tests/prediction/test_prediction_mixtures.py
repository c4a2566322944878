"""Classes that are mixtures: false alarms as drawn, one component as the class, departures, refusals, draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from uncertain_scene import AXIS, scenario

from hyperval.data import ClassStatistics, Components
from hyperval.errors import UsageError
from hyperval.model import Evaluation, Origins, predict, read
from hyperval.statistics_library import builtin_class

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


def curves(statistics: ClassStatistics, of=None):
    made = predict(of or mixed(), Origins(AXIS, {"field": statistics}))
    return made.roc["tenth", "cem", "pixel"], made


@pytest.mark.parametrize("tail", ["null", "measured"])
def test_one_component_is_the_class_itself(tail):
    whole = of_region(None, 5.0)
    one = Components(np.ones(1), np.zeros((1, BANDS)), whole.covariance[None], 5.0 if tail == "measured" else np.inf)
    before, after = (
        curves(s, mixed(m, tail))[0] for s, m in ((whole, "null"), (replace(whole, components=one), "auto"))
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


@pytest.mark.parametrize(("dof", "tail"), [(np.inf, "null"), (6.0, "measured")])
def test_false_alarms_are_those_of_drawn_pixels(dof, tail):
    # 400,000 pixels; five thresholds within 4.5 standard deviations: by chance fails in 3e-5 of runs.
    components, rng = two_clusters(dof), np.random.default_rng(1)
    of = mixed("auto", tail).model_copy(deep=True)
    curve, _ = curves(of_region(components), of)
    group = Evaluation(read(of, Origins(AXIS, {"field": of_region(components)})))
    filters = group.filters["plank", "cem"][0]
    n, asphalt = 400_000, builtin_class("asphalt", AXIS)
    grass = drawn(components, int(0.7 * n), rng)
    rest = asphalt.mean + rng.standard_normal((n - len(grass), BANDS)) @ np.linalg.cholesky(asphalt.covariance).T
    scores = np.concatenate([grass, rest])[:, group.bands] @ filters.weights[0] - filters.offset[0]
    for level in (0.3, 0.1, 0.03, 1e-2, 1e-3):
        at = int(np.argmin(np.abs(np.log(curve.pfa / level))))
        p = curve.pfa[at]
        share = float(np.mean(scores > curve.threshold[at]))
        assert abs(share - p) < 4.5 * np.sqrt(p * (1.0 - p) / n)
    single = curves(of_region(components), mixed("null"))[0]
    at = int(np.argmin(np.abs(np.log(curve.pfa / 1e-2))))  # what the moments alone would say is something else
    assert abs(single.threshold[at] - curve.threshold[at]) > 0.05 * abs(curve.threshold[at])


def test_what_is_not_there_is_refused():
    with pytest.raises(UsageError, match="3 components are asked for, its source has 2"):
        curves(of_region(two_clusters()), mixed(3))
    with pytest.raises(UsageError, match="its source has none"):
        curves(of_region(None), mixed(2))
    assert curves(of_region(None), mixed("auto"))[0].pd.size  # one law is an answer too
    good = two_clusters()
    with pytest.raises(UsageError, match="sum to 1"):
        Components(np.array([0.5, 0.6]), good.offsets, good.covariances)
    with pytest.raises(UsageError, match="contradict each other"):
        Components(good.weights, good.offsets[:1], good.covariances)
    with pytest.raises(UsageError, match="not positive semi-definite"):
        Components(good.weights, good.offsets, -good.covariances)
    with pytest.raises(UsageError, match="exceed 2"):
        Components(good.weights, good.offsets, good.covariances, 1.5)
    with pytest.raises(UsageError, match="do not fit 10 bands"):
        replace(of_region(None), components=good.at(np.arange(4)))

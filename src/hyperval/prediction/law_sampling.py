"""Errors of the background's laws where they were fitted to pixels of an image, by leaving out its parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from hyperval.prediction.background import seen_classes
from hyperval.prediction.batch import Batch
from hyperval.prediction.cases import Case, Origins, points_of, settings_of
from hyperval.prediction.departure import Departure
from hyperval.prediction.filters import law_scores
from hyperval.prediction.setup import Setup
from hyperval.prediction.uncertainty import probit
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.processing.intervals import Z95
from hyperval.processing.law_jackknife import jackknife_directions
from hyperval.processing.thresholds import ClassScores, false_alarm_grid, log_false_alarm
from hyperval.products import ExceedanceCurve, RocCurve
from hyperval.scenario import Scenario

Array = npt.NDArray[np.float64]
Filter = tuple[str, str]


def setups_without(scenario: Scenario, origins: Origins, truth: Departure) -> Iterable[Sequence[Setup]]:
    """For each region whose law is known from its pixels, the scenario as it truly is without each part of them."""
    if origins.left_out is None or not scenario.scene.targets or not _linear(scenario):
        return
    # A part may leave a mixture with fewer components than the class asks for.
    classes = [c.model_copy(update={"mixture": "auto"}) if c.has_mixture else c for c in scenario.scene.classes]
    free = scenario.model_copy(update={"scene": scenario.scene.model_copy(update={"classes": classes})})
    for region, without in origins.left_out():
        measured = origins.measured or {}
        yield [replace(origins, measured={**measured, region: part}).setup(free, truth) for part in without]


def law_directions(batch: Batch, case: Case, setups: Iterable[Sequence[Setup]]) -> dict[Filter, Array]:
    """(target, linear detector) -> (D, K) changes of ln P_FA (3.33) at the thresholds of its curve.

    One for each part of each region, independent of each other; the square root of the sum of their squares is the
    standard error that the pixels leave.  The filters stay: they look at both sides through the same weights.

    Parameters
    ----------
    case : the first of the batch
    """
    grid = batch.scenario.processing.false_alarm_grid
    pfa = false_alarm_grid(grid.lowest, grid.per_decade)
    names = [(t, d) for t in batch.targets for d in _linear(batch.scenario)]
    thresholds = {(t.name, d): batch.scores(t.populations[0].name, d).thresholds(pfa[None])[0] for t, d in names}
    directions: dict[Filter, list[Array]] = {key: [] for key in thresholds}
    for region in setups:
        values: dict[Filter, list[Array]] = {key: [] for key in thresholds}
        for setup in region:
            laws = _law_scores(batch, replace(case, setup=setup))
            for key, x in thresholds.items():
                rows = laws[key].rows(np.zeros(x.size, int))
                values[key].append(log_false_alarm(x, rows)[0])
        for key, each in values.items():
            directions[key].append(jackknife_directions(each))
    return {key: np.concatenate(parts) for key, parts in directions.items() if parts}


def _law_scores(batch: Batch, case: Case) -> dict[Filter, ClassScores]:
    """Scores of the background's laws of another case by the filters of the first evaluation of a batch."""
    settings = settings_of([case])
    group = next(g for g in batch.groups if 0 in g.numbers)
    own = np.flatnonzero(group.numbers == 0)
    at = settings.at(group.bands, batch.needed)
    seen = seen_classes(at)
    points = points_of([case], np.zeros(1, int))
    dof = points.dof if points.law_dof is None else points.law_dof
    return {
        key: ClassScores(settings.law_fractions(), *law_scores(at, seen, filters.rows(own)), dof)
        for key, (filters, _, _) in group.filters.items()
    }


def with_law_errors(
    exceedance: Mapping[Filter, ExceedanceCurve], directions: Mapping[Filter, Array]
) -> dict[Filter, ExceedanceCurve]:
    """The predicted curves, with 95 % limits where the law was fitted to pixels."""
    curves = dict(exceedance)
    for key, of_curve in directions.items():
        half, p = Z95 * np.sqrt((of_curve**2).sum(axis=0))[::-1], curves[key].probability
        curves[key] = replace(curves[key], lower=p * np.exp(-half), upper=np.minimum(p * np.exp(half), 1.0))
    return curves


def with_law_limits(curve: RocCurve, alarms: ExceedanceCurve) -> RocCurve:
    """The curve with the limits of P_FA at its thresholds taken into those of P_D.

    Where the background has more alarms than the law says, the threshold of a P_FA lies higher and P_D lower: the
    limits are the curve drawn against those of P_FA, in quadrature with the curve's own, in probit.
    """
    z, low, high = (probit(pd) for pd in (curve.pd, curve.pd_lower, curve.pd_upper))
    # Limits of P_FA rise with it; far out, where the law says little, they need not.
    less = np.maximum.accumulate(np.log(alarms.lower[::-1]))
    more = np.minimum.accumulate(np.log(alarms.upper))[::-1]
    at = np.log(curve.pfa)
    up = z + np.hypot(high - z, np.maximum(_read(at, less, z) - z, 0.0))
    down = z - np.hypot(z - low, np.maximum(z - _read(at, more, z), 0.0))
    return replace(curve, pd_lower=ndtr(np.maximum.accumulate(down)), pd_upper=ndtr(np.maximum.accumulate(up)))


def _read(at: Array, x: Array, z: Array) -> Array:
    """A curve z over x, both rising, at places ``at``; beyond its ends with the slope over ``at`` there."""
    below, above = (z[1] - z[0]) / (at[1] - at[0]), (z[-1] - z[-2]) / (at[-1] - at[-2])
    inside = np.interp(at, x, z)
    return np.asarray(inside + below * np.minimum(at - x[0], 0.0) + above * np.maximum(at - x[-1], 0.0))


def _linear(scenario: Scenario) -> list[str]:
    return [d for d in scenario.processing.detectors if d in LINEAR_DETECTORS]

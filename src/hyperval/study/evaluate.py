"""Evaluating the points of a study: by the fast evaluator where it serves, by ``predict`` where it does not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.datasets import resolve
from hyperval.errors import UsageError
from hyperval.predict import predict
from hyperval.prediction.terms import remembered
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.spectra.axis import SpectralAxis
from hyperval.study.atmosphere import FewStates, Table, few_states, table
from hyperval.study.fast import Batch
from hyperval.study.levers import PFA, Lever, lever_of
from hyperval.study.metrics import of_batch, of_prediction
from hyperval.study.prepared import Prepared, not_fast, prepare
from hyperval.study.schema import Output

Array = npt.NDArray[np.float64]
Column = npt.NDArray[Any]
Columns = Mapping[str, Column]
_KEPT = 16  # prepared scenarios in memory


@dataclass(frozen=True)
class Sky:
    """Which states of the atmosphere a study needs.

    Attributes
    ----------
    states : entry -> values (runs,), a run of the engine for each;  nodes : entry -> nodes of a table
    """

    states: Mapping[str, Column] = field(default_factory=dict)
    nodes: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def build(
        self, scenario: Scenario, axis: SpectralAxis, *, show_progress: bool | None = False
    ) -> FewStates | Table | None:
        """Run the engine on the bands ``axis``; None in the reflectance domain."""
        if scenario.atmosphere is None:
            return None
        engine = engine_on(scenario, axis)
        if self.nodes:
            return table(scenario.atmosphere, engine, self.nodes, show_progress=show_progress)
        return few_states(scenario.atmosphere, engine, self.states, show_progress=show_progress)


def engine_on(scenario: Scenario, axis: SpectralAxis) -> Callable[[AtmosphericState], AtmosphericTerms]:
    """The engine of a scenario on some bands."""

    def terms(state: AtmosphericState) -> AtmosphericTerms:
        if state.engine == "table":
            return atmospheric_terms(state, resolve=lambda r: resolve(r, scenario.folder)).at_bands(axis)
        return remembered(atmospheric_terms, state, axis, cache_dir=None, show_progress=False)

    return terms


@dataclass(frozen=True)
class Ready:
    """A scenario ready for evaluation; ``slow`` says why it goes through ``predict``, None where it does not."""

    scenario: Scenario
    prepared: Prepared
    terms: FewStates | Table | None
    slow: str | None


def make_ready(
    scenario: Scenario, sky: Sky, slow: str | None = None, *, show_progress: bool | None = False
) -> Ready:
    """Read what a scenario names and run its atmosphere.

    ``slow`` : why it is not to be evaluated fast, whatever the scenario says.
    """
    prepared = prepare(scenario)
    terms = sky.build(scenario, prepared.true_axis, show_progress=show_progress)
    return Ready(scenario, prepared, terms, slow or not_fast(scenario))


@dataclass(frozen=True)
class Evaluator:
    """A scenario and everything that its evaluation needs; goes to other processes as it is.

    Attributes
    ----------
    base : the scenario with the study's settings
    sky : states of the atmosphere, for variants whose bands differ
    anew : entries after whose change everything is read anew, besides those that :func:`lever_of` knows
    """

    base: Ready
    sky: Sky
    anew: frozenset[str] = frozenset()

    @cached_property
    def _variants(self) -> dict[str, Ready]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "_variants"}

    def lever(self, path: str) -> Lever:
        """What a path moves in this scenario."""
        return Lever("prepare", key=path) if path in self.anew else lever_of(self.base.scenario, path)

    def values(self, columns: Columns, outputs: Sequence[Output]) -> tuple[Array, dict[int, str]]:
        """Outputs (n, O) at n points, NaN where there is none, and why, by the number of the point.

        ``columns``: dotted path -> (n,) values, None where an entry is left as it is.
        """
        n = len(next(iter(columns.values())))
        found = np.full((n, len(outputs)), np.nan)
        problems: dict[int, str] = {}
        for rows, changes, moved in self._groups(columns, n):
            self._fill(found, problems, rows, changes, {p: _tidy(columns[p][rows]) for p in moved}, outputs)
        return found, problems

    def variant(self, changes: Mapping[str, Any]) -> Ready:
        """The scenario with some entries changed, read anew; the latest 16 are kept."""
        if not changes:
            return self.base
        key = repr(sorted(changes.items()))
        if key not in self._variants:
            if len(self._variants) >= _KEPT:
                self._variants.pop(next(iter(self._variants)))
            self._variants[key] = make_ready(with_settings(self.base.scenario, changes), self.sky, self.base.slow)
        return self._variants[key]

    def _groups(self, columns: Columns, n: int) -> list[tuple[Column, dict[str, Any], list[str]]]:
        """Points that share what is read anew, and of which the same entries move: rows, changes, moving paths."""
        anew = [p for p in columns if self.lever(p).needs_preparation]
        if not anew and all(c.dtype != object for c in columns.values()):
            return [(np.arange(n), {}, list(columns))]
        groups: dict[str, tuple[list[int], dict[str, Any], list[str]]] = {}
        for i in range(n):
            changes = {p: _plain(columns[p][i]) for p in anew if columns[p][i] is not None}
            moved = [p for p in columns if p not in anew and columns[p][i] is not None]
            groups.setdefault(repr((changes, moved)), ([], changes, moved))[0].append(i)
        return [(np.array(rows), changes, moved) for rows, changes, moved in groups.values()]

    def _fill(
        self, found: Array, problems: dict[int, str], rows: Column, changes: Mapping[str, Any], columns: Columns,
        outputs: Sequence[Output],
    ) -> None:  # fmt: skip
        """Evaluate some points; where they can not be evaluated together, those that can not at all are found."""
        try:
            ready = self.variant(changes)
            evaluate = self._one_by_one if ready.slow else self._together
            found[rows], lacking = evaluate(ready, columns, rows.size, outputs)
            problems |= {int(rows[i]): why for i, why in lacking.items()}
        except UsageError as error:
            if rows.size == 1:
                problems[int(rows[0])] = " ".join(str(error).split())
                return
            for half in np.array_split(np.arange(rows.size), 2):
                part = {p: c[half] for p, c in columns.items()}
                self._fill(found, problems, rows[half], changes, part, outputs)

    def _together(
        self, ready: Ready, columns: Columns, n: int, outputs: Sequence[Output]
    ) -> tuple[Array, dict[int, str]]:
        batch = self.batch(ready, columns, n)
        values = np.stack([of_batch(batch, o, columns.get(PFA)) for o in outputs], axis=1)
        return values, {i: batch.problems[int(s)] for i, s in enumerate(batch.of_point) if int(s) in batch.problems}

    def batch(self, ready: Ready, columns: Columns, n: int) -> Batch:
        """The points as a batch of the fast evaluator."""
        return Batch(ready.prepared, {self.lever(p): c for p, c in columns.items()}, n, ready.terms)

    def _one_by_one(
        self, ready: Ready, columns: Columns, n: int, outputs: Sequence[Output]
    ) -> tuple[Array, dict[int, str]]:
        found, problems = np.full((n, len(outputs)), np.nan), {}
        for i in range(n):
            point = {p: _plain(c[i]) for p, c in columns.items()}
            try:
                prediction = self.predicted(ready, point)
                pfa = point.get(PFA)
                found[i] = [of_prediction(prediction, ready.scenario, o, pfa) for o in outputs]
            except UsageError as error:
                problems[i] = " ".join(str(error).split())
        return found, problems

    def predicted(self, ready: Ready, point: Mapping[str, Any]) -> Any:
        """``predict`` at one point, with the atmosphere of the study."""
        scenario = with_settings(ready.scenario, {p: v for p, v in point.items() if p != PFA})
        moved = {self.lever(p).key: np.array([v]) for p, v in point.items() if self.lever(p).kind == "atmosphere"}
        if ready.terms is None:
            return predict(scenario)
        terms, axis = ready.terms(moved, 1), ready.prepared.true_axis
        flat = {k: v[0, 0] for k, v in vars(terms).items() if isinstance(v, np.ndarray) and v.ndim == 3}
        # Told to be averages over the bands themselves, the terms are taken as they stand.
        on_bands = replace(terms, **{**flat, "wavelength_nm": axis.centre_nm, "fwhm_nm": axis.fwhm_nm})
        stated = scenario.atmosphere
        other = engine_on(scenario, axis)
        return predict(scenario, engine=lambda s: on_bands if s == stated else other(s))


def difference_from_predict(evaluator: Evaluator, point: Mapping[str, Any]) -> float:
    """Greatest relative difference between the fast evaluator and ``predict`` at one point.

    Over the radiance and SNR of all classes, panels and sites, and P_D of all curves where it is above 1e-12.
    """
    changes = {p: v for p, v in point.items() if evaluator.lever(p).needs_preparation}
    moved = {p: v for p, v in point.items() if p not in changes}
    ready = evaluator.variant(changes)
    prediction = evaluator.predicted(ready, moved)
    batch = evaluator.batch(ready, {p: _tidy(_single(v)) for p, v in moved.items()}, 1)
    pairs = [(batch.radiance(s)[0], e.mean) for s, e in prediction.radiance.items() if s in _pure(ready.scenario)]
    pairs += [(batch.snr(s)[0], e.mean) for s, e in prediction.snr.items() if s in _pure(ready.scenario)]
    for (subject, detector, unit), curve in prediction.roc.items():
        scores = batch.scores(subject, detector) if unit == "pixel" else batch.object_scores(subject, detector)
        pairs.append((scores.detection(curve.pfa[None, :])[0], curve.pd))
    worst = 0.0
    for ours, theirs in pairs:
        held = np.isfinite(theirs) & (np.abs(theirs) > 1e-12)
        gap = np.abs(ours[held] - theirs[held]) / np.abs(theirs[held])
        worst = max(worst, float(np.max(np.where(np.isnan(gap), np.inf, gap), initial=0.0)))
    return worst


def _pure(scenario: Scenario) -> set[str]:
    return {s.name for s in (*scenario.scene.classes, *scenario.scene.panels, *scenario.scene.sites)}


def _tidy(column: Column) -> Column:
    """Numbers as floats, lists as tuples, which can be told apart and counted."""
    if column.dtype != object:
        return column
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in column):
        return column.astype(float)
    found = np.empty(column.size, dtype=object)
    found[:] = [tuple(v) if isinstance(v, list) else v for v in column]
    return found


def _single(value: Any) -> Column:
    found = np.empty(1, dtype=object)
    found[0] = value
    return found


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    value = list(value) if isinstance(value, tuple) else value
    return int(value) if isinstance(value, float) and value.is_integer() else value

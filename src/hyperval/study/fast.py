"""Many evaluations of one prepared scenario: radiance, SNR, scores and ROC of a batch of points.

Points that share atmosphere, sensor and background share their filter; everything else of a batch goes through
arrays. The numbers are those of :func:`hyperval.predict.predict`, to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.predict import detection_bands
from hyperval.prediction.fills import fills_of_objects, moments
from hyperval.scenario import Adjacency, Fill, TargetSubject
from hyperval.study.filters import Designer, Filters, SeenClasses, seen_classes
from hyperval.study.levers import Lever
from hyperval.study.prepared import Prepared, stacked_noise
from hyperval.study.target_scores import PointScores, responses
from hyperval.study.thresholds import ClassScores
from hyperval.study.views import Views, views

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Columns = Mapping[Lever, npt.NDArray[Any]]
# The terms (U, 1, B) at U values of the inputs of the atmosphere; one row where nothing of it moves.
TermsAt = Callable[[Mapping[str, npt.NDArray[Any]], int], AtmosphericTerms]
_OF_A_VIEW = ("atmosphere", "changes", "operation", "fraction", "gain", "kappa")


@dataclass(frozen=True)
class _Group:
    """Settings of one set of detector bands: numbers, the views on those bands, what is seen, the designer."""

    settings: Index
    at: Views
    seen: SeenClasses
    designer: Designer
    bands: npt.NDArray[np.intp]


class Batch:
    """n points of a study; quantities are computed when asked for.

    Parameters
    ----------
    columns : what moves -> (n,) values
    terms_at : the atmosphere; not called in the reflectance domain

    Attributes
    ----------
    problems : setting number -> why it has no filter
    of_point : (n,) number of the setting that each point has
    """

    def __init__(self, prepared: Prepared, columns: Columns, n: int, terms_at: TermsAt | None):
        self.prepared, self.columns, self.n = prepared, columns, n
        shared = [lever for lever in columns if lever.kind in _OF_A_VIEW]
        first, self.of_point = _distinct([columns[lever] for lever in shared], n)
        self._views = self._make_views({lever: columns[lever][first] for lever in shared}, first.size, terms_at)
        self.problems: dict[int, str] = {}
        self._made: dict[Any, Any] = {}

    # ---- what a setting of atmosphere, sensor and background is ----------------------------------------------

    def _make_views(self, columns: Columns, count: int, terms_at: TermsAt | None) -> Views:
        scene = self.prepared.scenario.scene
        fractions = np.tile([c.fraction for c in scene.classes], (count, 1))
        gains = np.tile([c.gain for c in scene.classes], (count, 1))
        kappa = np.full(count, scene.adjacency.kappa)
        of: dict[str, dict[str, npt.NDArray[Any]]] = {"atmosphere": {}, "changes": {}, "operation": {}}
        for lever, values in columns.items():
            if lever.kind == "fraction":
                fractions[:, lever.item] = values
            elif lever.kind == "gain":
                gains[:, lever.item] = values
            elif lever.kind == "kappa":
                kappa = np.array([Adjacency(effective_neighbours=v).kappa for v in values.tolist()])
            else:
                of[lever.kind][lever.key] = values
        if self.prepared.scenario.atmosphere is None:
            return views(self.prepared, None, None, fractions, gains, kappa)
        assert terms_at is not None  # noqa: S101 - given with every atmosphere
        return views(
            self.prepared, terms_at(of["atmosphere"], count), self._noise(of["changes"], of["operation"], count),
            fractions, gains, kappa,
        )  # fmt: skip

    def _noise(self, changes: Mapping[str, Any], operation: Mapping[str, Any], count: int) -> Any:
        moved = {**changes, **{f"run {k}": v for k, v in operation.items()}}
        first, index = _distinct(list(moved.values()), count)
        models = [
            self.prepared.noise(
                {k: _plain(v[i]) for k, v in changes.items()}, {k: _plain(v[i]) for k, v in operation.items()}
            )
            for i in first
        ]
        stacked = stacked_noise(models)
        if len(models) == 1:
            return stacked
        changed: dict[str, Any] = {}
        for name, value in vars(stacked).items():
            if isinstance(value, np.ndarray) and value.ndim == 3:
                changed[name] = value[index]
            elif isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
                changed[name] = tuple(x[index] for x in value)
        return replace(stacked, **changed)

    # ---- spectra -------------------------------------------------------------------------------------------

    def radiance(self, subject: str) -> Array:
        """Mean radiance of a class, panel or site at each setting (U, B) (3.7) [uW cm-2 sr-1 nm-1]."""
        return self._once(("radiance", subject), lambda: self._level(subject))

    def snr(self, subject: str, calibration: bool = True) -> Array:
        """SNR of a class, panel or site at each setting (U, B) (3.20) [1]; with C_R or without."""

        def found() -> Array:
            noise = self._views.view.noise
            if noise is None:
                raise UsageError("the scenario has no sensor noise", mend="name an atmosphere and a sensor")
            return np.asarray(noise.snr(self.radiance(subject)[:, None, :], calibration=calibration)[:, 0])

        return self._once(("snr", subject, calibration), found)

    def _level(self, subject: str) -> Array:
        return self._views.levels(self.prepared.surfaces[subject].mean[None, :])[:, 0]

    # ---- detection -----------------------------------------------------------------------------------------

    @cached_property
    def _groups(self) -> list[_Group]:
        """Settings by the bands that their detectors use."""
        p, scene = self.prepared, self.prepared.scenario.scene
        known = np.ones(len(p.axis), bool)
        for name in [c.name for c in scene.classes] + [t.name for t in scene.targets]:
            known &= np.isfinite(p.surfaces[name].mean)
        for spectrum in p.looked_for.values():
            known &= np.isfinite(spectrum)
        patterns, which = np.unique(self._views.lit() & known, axis=0, return_inverse=True)
        found = []
        for number, usable in enumerate(patterns):
            bands = detection_bands(p.scenario, p.axis, usable)
            key = bands.tobytes()
            if key not in p.designers:
                p.designers.clear()  # one set of bands serves nearly all points, and each holds large matrices
                p.designers[key] = Designer(p, bands)
            designer = p.designers[key]
            settings = np.flatnonzero(which.reshape(-1) == number)
            at = self._views.rows(settings).at(bands)
            seen = seen_classes(at, p.class_means[:, bands])
            found.append(_Group(settings, at, seen, designer, bands))
        return found

    @cached_property
    def _filters(self) -> list[dict[tuple[str, str], tuple[Filters, Array, Array]]]:
        """For each group: (target, detector) -> filters, theta_m (U, M), sigma_m (U, M)."""
        scenario, out = self.prepared.scenario, []
        for g in self._groups:
            names, wanted = [], []
            for t in scenario.scene.targets:
                level = g.at.levels(self.prepared.looked_for[t.name][None, g.bands])
                spectrum = ((level - g.seen.offset) / g.seen.gain)[:, 0]
                for detector in scenario.processing.detectors:
                    names.append((t.name, detector))
                    wanted.append((detector, spectrum))
            filters, problems = g.designer.design(g.at, g.seen, wanted)
            self.problems |= {int(s): p for s, p in zip(g.settings, problems, strict=True) if p}
            scores = [g.designer.class_scores(g.at, g.seen, f) for f in filters]
            out.append({n: (f, *s) for n, f, s in zip(names, filters, scores, strict=True)})
        return out

    def scores(self, population: str, detector: str) -> PointScores:
        """What the ROC of a target population needs at each point (3.26-3.29), pixel by pixel."""
        return self._once(("scores", population, detector), lambda: self._scores(population, detector, False))

    def object_scores(self, population: str, detector: str) -> PointScores:
        """The same where an object is detected when one of its pixels is."""
        return self._once(("objects", population, detector), lambda: self._scores(population, detector, True))

    def _scores(self, population: str, detector: str, objects: bool) -> PointScores:
        number, subject = self._population(population)
        fills = self._fills(number, subject, objects)
        means, sds = (np.full((self.n, fills.values.shape[1]), np.nan) for _ in range(2))
        for g, filters in zip(self._groups, self._filters, strict=True):
            points = np.flatnonzero(np.isin(self.of_point, g.settings))
            rows, response = self._responses(g, number, filters[self._target(number).name, detector][0], points)
            gain = self._column("target_gain", number, self._target(number).gain)[points]
            own = fills.values if fills.values.shape[0] == 1 else fills.values[points]
            means[points], sds[points] = response.at(own, gain, rows)
        classes, which = self._classes(number, detector)
        if not objects or fills.shape is None:
            weights = np.broadcast_to(fills.weights, means.shape)
            return PointScores(classes, which, means, sds, weights)
        shape = (self.n, *fills.shape)
        held = (means.reshape(shape), sds.reshape(shape))
        return PointScores(classes, which, means, sds, np.full(means.shape, np.nan), held)

    def _classes(self, number: int, detector: str) -> tuple[ClassScores, Index]:
        """Scores of the background for each different combination of setting and tails."""
        scene = self.prepared.scenario.scene
        size = (len(self._views), len(scene.classes))
        means, sds = np.full(size, np.nan), np.full(size, np.nan)
        for g, filters in zip(self._groups, self._filters, strict=True):
            _, means[g.settings], sds[g.settings] = filters[self._target(number).name, detector]
        given = [c.tail_dof or self.prepared.surfaces[c.name].tail_dof or np.inf for c in scene.classes]
        tails = {lever.item: np.asarray(v, float) for lever, v in self.columns.items() if lever.kind == "tail"}
        first, which = _distinct([self.of_point, *tails.values()], self.n)
        dof = np.tile(np.asarray(given, float), (first.size, 1))
        for item, values in tails.items():
            dof[:, item] = values[first]
        settings = self.of_point[first]
        return ClassScores(self._views.fractions[settings], means[settings], sds[settings], dof), which

    def _responses(self, g: _Group, number: int, filters: Filters, points: Index) -> tuple[Index, Any]:
        target, p = self._target(number), self.prepared
        light = target.illumination
        beam = self._column("beam", number, light.beam if light else 1.0)[points]
        sky = self._column("sky", number, light.sky_view if light else 1.0)[points]
        local = np.searchsorted(g.settings, self.of_point[points])
        first, rows = _distinct([local, beam, sky], points.size)
        settings = local[first]
        shade = None if np.all(beam == 1.0) and np.all(sky == 1.0) else (beam[first], sky[first])
        if shade is not None and p.scenario.atmosphere is None:
            raise UsageError("illumination: shade needs the light of an atmosphere")
        own, cut = p.surfaces[target.name], np.ix_(g.bands, g.bands)
        host = p.class_names.index(target.host)
        surfaces = own.mean[g.bands], own.covariance[cut], p.class_means[host][g.bands], host
        seen = SeenClasses(*(getattr(g.seen, n)[settings] for n in _SEEN))
        at = g.at.rows(settings)
        chosen = Filters(filters.weights[settings], filters.offset[settings])
        return rows, responses(g.designer, at, seen, chosen, surfaces, shade)

    def _fills(self, number: int, subject: int, objects: bool) -> _Fills:
        """Fills of the pixels of a population (f of 3.10) at each point, or of the pixels of its objects."""
        thesis = self.prepared.scenario.formulation == "thesis"
        base = self._target(number).populations[subject]
        moved = {
            lever.key: v
            for lever, v in self.columns.items()
            if lever.kind == "fill" and (lever.item, lever.subject) == (number, subject)
        }
        if list(moved) == ["fixed"] and base.fill.fixed is not None:
            values = np.asarray(moved["fixed"], float)[:, None]
            _within(values, 0.0, 1.0, "fill")
            return _Fills(values, np.ones((1, 1)), None)
        first, which = _distinct(list(moved.values()), self.n) if moved else (np.zeros(1, int), None)
        each: list[tuple[Any, Any, Any]] = []
        for i in first:
            fill = _changed_fill(base.fill, {k: _plain(v[i]) for k, v in moved.items()})
            dist = moments(TargetSubject(name=base.name, fill=fill), thesis)
            if not objects:
                each.append((dist.values, dist.weights, None))
                continue
            places = np.array([[dist.mean]]) if thesis else fills_of_objects(fill)
            alone = places.shape[1] == 1 and dist.values.size >= places.shape[0]
            each.append((dist.values, dist.weights, None) if alone else (places.ravel(), None, places.shape))
        if any(e[2] != each[0][2] for e in each):
            raise UsageError("the number of pixels of an object moves", mend="study one number at a time")
        width = max(e[0].size for e in each)
        values = np.array([np.pad(e[0], (0, width - e[0].size)) for e in each])
        weights = np.array([np.pad(e[1] if e[1] is not None else e[0] * 0, (0, width - e[0].size)) for e in each])
        if which is None:
            return _Fills(values, weights, each[0][2])
        return _Fills(values[which], weights[which], each[0][2])

    # ---- small things --------------------------------------------------------------------------------------

    def _population(self, name: str) -> tuple[int, int]:
        for number, target in enumerate(self.prepared.scenario.scene.targets):
            for subject, population in enumerate(target.populations):
                if population.name == name:
                    return number, subject
        raise UsageError(f"no target population {name!r}")

    def _target(self, number: int) -> Any:
        return self.prepared.scenario.scene.targets[number]

    def _column(self, kind: str, number: int, default: float) -> Array:
        lever = Lever(kind, number)
        return np.asarray(self.columns[lever], float) if lever in self.columns else np.full(self.n, default)

    def _once(self, key: Any, make: Callable[[], Any]) -> Any:
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


@dataclass(frozen=True)
class _Fills:
    """(n or 1, K) fills and weights; ``shape`` (places, pixels) of objects whose pixels lie along K."""

    values: Array
    weights: Array
    shape: tuple[int, int] | None


_SEEN = ("gain", "offset", "slope", "around", "means", "noise", "mean")


def _distinct(columns: Sequence[npt.NDArray[Any]], n: int) -> tuple[Index, Index]:
    """First point of each different row of the columns, and the number of its row for each point."""
    if not columns:
        return np.zeros(1, int), np.zeros(n, int)
    codes = np.zeros(n, int)
    for column in columns:
        _, code = np.unique(column, return_inverse=True)
        _, codes = np.unique(codes * (int(code.max(initial=0)) + 1) + code.reshape(-1), return_inverse=True)
    _, first = np.unique(codes, return_index=True)
    return first, codes.reshape(-1)


def _changed_fill(fill: Fill, changes: Mapping[str, Any]) -> Fill:
    data = fill.model_dump(exclude_unset=True)
    for key, value in changes.items():
        parts, at = key.split("."), data
        for part in parts[:-1]:
            at = at.setdefault(part, {})
        at[parts[-1]] = value
    try:
        return Fill.model_validate(data)
    except ValueError as error:
        raise UsageError(f"fill with {dict(changes)}: {error}") from error


def _within(values: Array, low: float, high: float, name: str) -> None:
    if not np.all((values >= low) & (values <= high)):
        raise UsageError(f"{name} {values.min():g} to {values.max():g}", expected=f"{low:g} to {high:g}")


def _plain(value: Any) -> Any:
    """A value as a model takes it: a whole number where it is one."""
    value = value.item() if hasattr(value, "item") else value
    return int(value) if isinstance(value, float) and value.is_integer() else value

"""Columns of a study: which inputs move as columns of numbers, what each touches, and the batch they make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.background import Ground, Settings, ground_of, with_class_levels
from hyperval.prediction.batch import Batch, Points, distinct
from hyperval.prediction.cases import Case, points_of
from hyperval.prediction.fills import Fills, object_fills_of, pixel_fills, stacked_fills
from hyperval.prediction.filters import Designer
from hyperval.prediction.input_paths import BatchColumn
from hyperval.prediction.setup import Setup
from hyperval.prediction.view import View, on_arrays, stacked_noise
from hyperval.scenario import Adjacency, Fill, TargetSubject
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.operation import SensorChanges, SensorOperation, binned_noise, changed_noise
from hyperval.study.design import plain

Array = npt.NDArray[np.float64]
Columns = Mapping[BatchColumn, npt.NDArray[Any]]
# The terms (U, 1, B) at U values of the inputs of the atmosphere; one row where nothing of it moves.
TermsAt = Callable[[Mapping[str, npt.NDArray[Any]], int], AtmosphericTerms]
_OF_A_SETTING = ("atmosphere", "changes", "operation", "fraction", "gain", "kappa")
# Where target pixels are part of the filter's statistics, what moves them moves the filter.
_OF_TARGETS = ("target_gain", "beam", "sky", "fill")


@dataclass(frozen=True, eq=False)
class Stage:
    """A scenario with everything read that the columns of a study leave alone, kept from batch to batch.

    Attributes
    ----------
    terms : the atmosphere, run; None in the reflectance domain
    """

    setup: Setup
    terms: TermsAt | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What goes to other processes: no memory of earlier batches, and no covariance that nothing asks for."""
        scene = self.setup.scenario.scene
        needed = {s.name for s in (*scene.classes, *scene.targets)}
        surfaces = {
            n: s if n in needed else replace(s, covariance=np.empty((0, 0))) for n, s in self.setup.surfaces.items()
        }
        return {"setup": replace(self.setup, surfaces=surfaces), "terms": self.terms}

    @cached_property
    def designers(self) -> dict[bytes, Designer]:
        """Matrices that serve one batch after the other."""
        return {}

    @cached_property
    def _grounds(self) -> dict[bytes, Ground]:
        return {}

    @cached_property
    def _noises(self) -> dict[tuple[Any, ...], NoiseModel]:
        return {}

    def ground(self, fractions: Array) -> Ground:
        """The surfaces under area fractions (M,); UsageError where they do not sum to 1."""
        key = fractions.tobytes()
        if key not in self._grounds:
            self._grounds.clear()  # those of one batch at most: each holds a matrix
            ground = ground_of(self.setup.surfaces, self.setup.classes, fractions)
            self._grounds[key] = replace(ground, room=self._room)
        return self._grounds[key]

    @cached_property
    def _room(self) -> dict[bytes, Any]:
        return {}

    def noise(self, changes: Mapping[str, Any], operation: Mapping[str, Any]) -> NoiseModel:
        """The noise (3.13)-(3.20) with other numbers of the sensor or of how it is run.

        ``changes`` and ``operation`` are entries of ``sensor_changes`` and ``sensor_operation`` that differ from
        the scenario's.
        """
        scenario, run = self.setup.scenario, self.setup.scenario.sensor_operation
        if operation:
            stated = run.model_dump(exclude_unset=True) if run else {}
            run = SensorOperation.model_validate({**stated, **operation})
        key = tuple(sorted(operation.items()))
        if key not in self._noises:
            sensor = self.setup.used.sensor
            assert sensor is not None  # noqa: S101 - asked for with an atmosphere alone
            if len(self._noises) > 64:
                self._noises.clear()
            self._noises[key] = sensor.noise(None, run)
        model, differ = self._noises[key], scenario.sensor_changes
        if changes:
            stated = differ.model_dump(exclude_unset=True) if differ else {}
            differ = SensorChanges.model_validate({**stated, **changes})
        if differ is not None:
            model = changed_noise(model, differ)
        return binned_noise(model, run.spectral_binning) if run and run.spectral_binning > 1 else model


def batch_of_columns(stage: Stage, columns: Columns, n: int) -> Batch:
    """n points of a study as evaluations of the model.

    Parameters
    ----------
    columns : what moves -> (n,) values
    """
    setup = stage.setup
    whole = setup.scenario.processing.filter_statistics == "scene"
    shared = [
        column for column in columns if column.kind in _OF_A_SETTING or (whole and column.kind in _OF_TARGETS)
    ]
    first, setting = distinct([columns[column] for column in shared], n)
    settings = _settings(stage, {column: columns[column][first] for column in shared}, first.size)
    points = _points(setup, columns, setting)
    return Batch(setup.scenario, setup.used.axis, setup.signatures, settings, points, designers=stage.designers)


def _settings(stage: Stage, columns: Columns, count: int) -> Settings:
    scenario = stage.setup.scenario
    scene = scenario.scene
    fractions = np.tile([c.fraction for c in scene.classes], (count, 1))
    gains = np.tile([c.gain for c in scene.classes], (count, 1))
    kappa = np.full(count, scene.adjacency.kappa)
    of: dict[str, dict[str, npt.NDArray[Any]]] = {"atmosphere": {}, "changes": {}, "operation": {}}
    for column, values in columns.items():
        if column.kind == "fraction":
            fractions[:, column.item] = values
        elif column.kind == "gain":
            gains[:, column.item] = values
        elif column.kind == "kappa":
            kappa = np.array([Adjacency(effective_neighbours=v).kappa for v in values.tolist()])
        elif column.kind in of:
            of[column.kind][column.key] = values
    terms, noise = None, None
    if scenario.atmosphere is not None:
        assert stage.terms is not None  # noqa: S101 - run with every atmosphere
        terms, noise = stage.terms(of["atmosphere"], count), _noise(stage, of["changes"], of["operation"], count)
    different, which = np.unique(fractions, axis=0, return_inverse=True)
    grounds = tuple(stage.ground(f) for f in different)
    which = which.reshape(-1)
    elm = scenario.processing.elm
    view = View(
        terms,
        np.array([stage.setup.average(g.average) for g in grounds])[which][:, None, :],
        noise,
        kappa[:, None, None],
        scenario.formulation,
        None if elm == "none" else elm,
    )
    return with_class_levels(Settings(view, fractions, gains, grounds, which))


def _noise(stage: Stage, changes: Mapping[str, Any], operation: Mapping[str, Any], count: int) -> NoiseModel:
    first, index = distinct([*changes.values(), *operation.values()], count)
    models = [
        stage.noise({k: plain(v[i]) for k, v in changes.items()}, {k: plain(v[i]) for k, v in operation.items()})
        for i in first
    ]
    stack = stacked_noise(models, len(stage.setup.used.axis))
    return stack if len(models) == 1 else on_arrays(stack, lambda x: x[index] if x.ndim == 3 else x)


def _points(setup: Setup, columns: Columns, setting: npt.NDArray[np.intp]) -> Points:
    n, scene = setting.size, setup.scenario.scene
    base = points_of([Case(setup, None, None)], np.zeros(1, int))
    changed: dict[str, Array] = {"dof": base.dof, "gain": base.gain, "beam": base.beam, "sky": base.sky}
    names = {"tail": "dof", "target_gain": "gain", "beam": "beam", "sky": "sky"}
    for column, values in columns.items():
        if column.kind in names:
            name = names[column.kind]
            whole = np.array(np.broadcast_to(changed[name], (n, changed[name].shape[1])))
            whole[:, column.item] = values
            changed[name] = whole

    def fills(target: int, population: int, objects: bool) -> Fills | None:
        of = {x.key: v for x, v in columns.items() if (x.kind, x.item, x.subject) == ("fill", target, population)}
        base_fill = scene.targets[target].populations[population].fill
        return _moved_fills(base_fill, of, n, setup.scenario.formulation == "thesis", objects) if of else None

    return Points(
        setting, changed["dof"], changed["gain"], changed["beam"], changed["sky"], fills, law_dof=base.law_dof
    )


def _moved_fills(base: Fill, columns: Mapping[str, npt.NDArray[Any]], n: int, thesis: bool, objects: bool) -> Fills:
    """Fills of n points of which some entries of the scenario's fill move."""
    if list(columns) == ["fixed"] and base.fixed is not None:
        values = np.asarray(columns["fixed"], float)[:, None]
        if not np.all((values >= 0.0) & (values <= 1.0)):
            raise UsageError(f"fill {values.min():g} to {values.max():g}", expected="0 to 1")
        return Fills(values, np.ones((1, 1)))
    first, which = distinct(list(columns.values()), n)
    make = object_fills_of if objects else pixel_fills
    subjects = [
        TargetSubject(name="fill", fill=_changed_fill(base, {k: plain(v[i]) for k, v in columns.items()}))
        for i in first
    ]
    return stacked_fills([make(s, thesis) for s in subjects], which)


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

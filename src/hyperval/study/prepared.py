"""A scenario made ready for many evaluations: everything that the numbers of a study leave alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval import datasets
from hyperval.predict import surfaces_of
from hyperval.prediction.inputs import Resolve, Sources, SurfaceStatistics, filled
from hyperval.prediction.setup import instrument, with_sensor_blur
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.scenario import DarkestPixel, Scenario
from hyperval.scene.mixture import average_reflectance, mixture_covariance
from hyperval.sensor.changes import SensorChanges, changed_noise
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.operation import SensorOperation, binned_noise
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Bands = npt.NDArray[np.intp]
# Arrays of a noise model that may differ from one setting of the sensor to the next.
_NOISE_ARRAYS = (
    "electrons_per_radiance", "fixed_noise", "lsb_electrons", "bits", "bit_error_rate", "calibration_percent",
    "full_scale", "readings", "digital_readings", "calibration_readings",
)  # fmt: skip


@dataclass(frozen=True)
class Surroundings:
    """Averages over the classes for one set of fractions: rho_ave (B,) of (3.8), Sigma_ave (B, B) of (3.11)."""

    average: Array
    covariance: Array


@dataclass(frozen=True)
class Prepared:
    """A scenario on its bands, all spectra read.

    Attributes
    ----------
    scenario : with the sensor's blur where it states none
    surfaces : name -> statistics of every class, panel, site and target
    looked_for : target -> (B,) reflectance that its filter looks for
    sensor : None in the reflectance domain
    """

    scenario: Scenario
    axis: SpectralAxis
    true_axis: SpectralAxis
    surfaces: Mapping[str, SurfaceStatistics]
    looked_for: Mapping[str, Array]
    sensor: Sensor | None

    def __getstate__(self) -> dict[str, Any]:
        """What goes to other processes: no memory of earlier batches, and no covariance that nothing asks for."""
        scene, state = self.scenario.scene, {f.name: getattr(self, f.name) for f in fields(self)}
        needed = {s.name for s in (*scene.classes, *scene.targets)}
        state["surfaces"] = {
            n: s if n in needed else replace(s, covariance=np.empty((0, 0))) for n, s in self.surfaces.items()
        }
        return state

    @property
    def class_names(self) -> list[str]:
        """Names of the M background classes."""
        return [c.name for c in self.scenario.scene.classes]

    @cached_property
    def class_means(self) -> Array:
        """(M, B) mean reflectances."""
        return np.array([self.surfaces[n].mean for n in self.class_names])

    @cached_property
    def class_covariances(self) -> Array:
        """(M, B, B) reflectance covariances."""
        return np.array([self.surfaces[n].covariance for n in self.class_names])

    @cached_property
    def designers(self) -> dict[bytes, Any]:
        """Room for what :mod:`hyperval.study.fast` keeps for a set of detector bands from batch to batch."""
        return {}

    def surroundings(self, fractions: Array) -> Surroundings:
        """Averages for area fractions (M,) (3.8, 3.11); UsageError where they do not sum to 1."""
        means = np.array([filled(m) for m in self.class_means])
        return Surroundings(
            average_reflectance(fractions, means), mixture_covariance(fractions, means, self.class_covariances)
        )

    def noise(self, changes: Mapping[str, Any], operation: Mapping[str, Any]) -> NoiseModel:
        """The noise (3.13)-(3.20) with other numbers of the sensor or of how it is run.

        ``changes`` and ``operation`` are entries of ``sensor_changes`` and ``sensor_operation`` that differ from
        the scenario's.
        """
        assert self.sensor is not None  # noqa: S101 - asked for with an atmosphere alone
        scenario = self.scenario
        run = scenario.sensor_operation
        if operation:
            stated = run.model_dump(exclude_unset=True) if run else {}
            run = SensorOperation.model_validate({**stated, **operation})
        found = self._noise_as_run(run)
        differ = scenario.sensor_changes
        if changes:
            stated = differ.model_dump(exclude_unset=True) if differ else {}
            differ = SensorChanges.model_validate({**stated, **changes})
        if differ is not None:
            found = changed_noise(found, differ)
        return binned_noise(found, run.spectral_binning) if run and run.spectral_binning > 1 else found

    def _noise_as_run(self, run: SensorOperation | None) -> NoiseModel:
        assert self.sensor is not None  # noqa: S101
        key = run.model_dump_json() if run else ""
        if key not in self._noises:
            if len(self._noises) > 64:
                self._noises.clear()
            self._noises[key] = self.sensor.noise(None, run)
        return self._noises[key]

    @cached_property
    def _noises(self) -> dict[str, NoiseModel]:
        return {}


def prepare(scenario: Scenario, resolve: Resolve | None = None) -> Prepared:
    """Read and check everything that a scenario names, for :func:`hyperval.study.fast.evaluate`.

    Raises
    ------
    UsageError, InputError : as :func:`hyperval.predict.predict`.
    """
    find = resolve or (lambda reference: datasets.resolve(reference, scenario.folder))
    used = instrument(scenario, None, None, find)
    scenario = with_sensor_blur(scenario, used.sensor)
    on, true = used.axis, used.true_axis
    surfaces, looked_for = surfaces_of(scenario, Sources(true, {}, find, on), Sources(on, {}, find))
    return Prepared(scenario, on, true, surfaces, looked_for, used.sensor)


def not_fast(scenario: Scenario) -> str | None:
    """Why a scenario must be evaluated by ``predict`` point by point; None where the fast evaluator serves."""
    processing = scenario.processing
    slow = [d for d in processing.detectors if d not in LINEAR_DETECTORS]
    if slow:
        return f"processing.detectors: {', '.join(slow)} has no closed form"
    if processing.features is not None:
        return "processing.features: the components differ from evaluation to evaluation"
    if processing.filter_statistics != "background":
        return "processing.filter_statistics: scene"
    if isinstance(processing.elm, DarkestPixel):
        return "processing.elm: darkest pixel"
    if any(p.position_m is not None for t in scenario.scene.targets for p in t.populations):
        return "position_m: targets that share pixels"
    if any(c.tail_dof == "measured" for c in scenario.scene.classes):
        return "tail_dof: measured"
    return None


def stacked_noise(models: list[NoiseModel]) -> NoiseModel:
    """Noise models of U settings as one whose arrays are (U, 1, B), so that levels (U, S, B) go through it."""
    first = models[0]
    if len(models) == 1:
        return first
    changes: dict[str, Any] = {}
    for name in _NOISE_ARRAYS:
        values = [getattr(m, name) for m in models]
        if values[0] is None or all(v is values[0] for v in values):
            continue
        found = np.stack([np.broadcast_to(v, first.fixed_noise.shape) for v in values])[:, None, :]
        changes[name] = found
    if first.measured is not None:
        triples = [m.measured for m in models if m.measured is not None]
        changes["measured"] = tuple(np.stack([t[i] for t in triples])[:, None, :] for i in range(3))
    return replace(first, **changes)


def banded(value: Any, bands: Bands) -> Any:
    """A dataclass of arrays (..., B) with the bands that ``bands`` names; everything else as it is."""
    changes: dict[str, Any] = {}
    for f in fields(value):
        item: Any = getattr(value, f.name)
        if isinstance(item, tuple) and item and isinstance(item[0], np.ndarray):
            changes[f.name] = tuple(x[..., bands] for x in item)
        elif isinstance(item, np.ndarray) and item.ndim:
            changes[f.name] = item[..., bands]
    return replace(value, **changes)


__all__ = ["Bands", "Prepared", "Surroundings", "banded", "not_fast", "prepare", "stacked_noise"]

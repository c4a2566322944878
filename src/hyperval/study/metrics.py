"""The numbers that a study asks for, from a batch of the model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.batch import Batch
from hyperval.prediction.detection import detect
from hyperval.processing.ace_model import NUMERICAL_DETECTORS
from hyperval.processing.roc_reading import detection_at, log10_false_alarm_at
from hyperval.products import RocCurve
from hyperval.scenario import Scenario
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.windows import in_window
from hyperval.study.schema import Output

Array = npt.NDArray[np.float64]
_PER_DECADE = 20


def detector_of(output: Output, scenario: Scenario) -> str:
    """The detector that an output reads: the one it names, or the scenario's first."""
    return output.detector or scenario.processing.detectors[0]


def check_outputs(outputs: list[Output], scenario: Scenario, axis: SpectralAxis) -> None:
    """Refuse outputs of subjects, detectors or bands that the scenario does not have.

    Raises
    ------
    UsageError : with the output's name.
    """
    scene = scenario.scene
    pure = [s.name for s in (*scene.classes, *scene.panels, *scene.sites)]
    populations = [p.name for t in scene.targets for p in t.populations]
    for o in outputs:
        spectral = o.kind in ("snr", "radiance")
        if spectral and scenario.atmosphere is None:
            raise UsageError(f"output {o.name!r}: the scenario has no atmosphere, so no {o.kind}")
        if not spectral and not scenario.processing.detectors:
            raise UsageError(f"output {o.name!r}: the scenario has no detectors", mend="add processing.detectors")
        among = pure if spectral else populations
        if o.subject not in among:
            raise UsageError(f"output {o.name!r}: no subject {o.subject!r}", expected="one of " + ", ".join(among))
        if o.detector is not None and o.detector not in scenario.processing.detectors:
            raise UsageError(
                f"output {o.name!r}: the scenario does not run {o.detector!r}",
                expected="one of " + ", ".join(scenario.processing.detectors),
            )
        if spectral:
            bands_of(o, axis)


def bands_of(output: Output, axis: SpectralAxis) -> npt.NDArray[np.intp]:
    """Numbers of the bands that a spectral output reads.

    Raises
    ------
    UsageError : no band there.
    """
    w = axis.centre_nm
    if output.band_nm is not None:
        at = int(np.argmin(np.abs(w - output.band_nm)))
        if abs(w[at] - output.band_nm) > 2.0 * axis.fwhm_nm[at]:
            raise UsageError(f"output {output.name!r}: no band at {output.band_nm:g} nm")
        return np.array([at])
    assert output.range_nm is not None  # noqa: S101 - the model's own check
    low, high = output.range_nm
    bands = np.flatnonzero((w >= low) & (w <= high) & axis.good & in_window(w))
    if not bands.size:
        raise UsageError(f"output {output.name!r}: no usable band from {low:g} to {high:g} nm")
    return bands


def log_range(output: Output) -> Array:
    """Probabilities over which ``log-auc`` averages, even in their logarithm."""
    low, high = output.pfa_range
    return np.geomspace(low, high, max(2, round(np.log10(high / low) * _PER_DECADE)) + 1)


def of_batch(batch: Batch, output: Output, pfa: Array | None) -> Array:
    """An output at every point of a batch (n,); ``pfa`` (n,) where an input moves it."""
    scenario = batch.scenario
    if output.kind in ("snr", "radiance"):
        bands = bands_of(output, batch.axis)
        if output.kind == "snr":
            values = batch.snr(output.subject, output.calibration_error)
        else:
            values = batch.radiance(output.subject)
        return np.asarray(values[:, bands].mean(axis=1)[batch.points.setting])
    detector = detector_of(output, scenario)
    if detector in NUMERICAL_DETECTORS:
        return _of_curves(batch, detector, output, pfa)
    if output.kind == "pd" and output.by == "object":
        scores = batch.object_scores(output.subject, detector)
    else:
        scores = batch.scores(output.subject, detector)
    if output.kind == "pd":
        at = np.array([[output.pfa]]) if pfa is None else np.asarray(pfa, float)[:, None]
        return np.asarray(scores.detection(at)[:, 0])
    if output.kind == "log10-pfa":
        return scores.log10_false_alarm(np.full(len(batch), output.pd))
    if output.kind == "auc":
        return scores.auc()
    x = log_range(output)
    return np.asarray(np.trapezoid(scores.detection(x[None, :]), np.log(x), axis=1) / np.log(x[-1] / x[0]))


def _of_curves(batch: Batch, detector: str, output: Output, pfa: Array | None) -> Array:
    """An output of a detector whose curves are drawn: between their points they are read as all curves are."""
    values = np.empty(len(batch))
    for i, detection in enumerate(detect(batch, points=range(len(batch)))):
        curve = detection.roc[output.subject, detector, output.by]
        if output.kind == "pd":
            at = output.pfa if pfa is None else float(pfa[i])
            assert at is not None  # noqa: S101 - the schema asks for it
            values[i] = detection_at(curve, at)
        elif output.kind == "log10-pfa":
            values[i] = log10_false_alarm_at(curve, output.pd)
        elif output.kind == "auc":
            values[i] = _area(curve)
        else:
            x = log_range(output)
            values[i] = np.trapezoid(detection_at(curve, x), np.log(x)) / np.log(x[-1] / x[0])
    return values


def _area(curve: RocCurve) -> float:
    """Area under a curve, read between its points and joined to (1, 1)."""
    low, high = float(curve.pfa[0]), float(curve.pfa[-1])
    x = np.concatenate([np.geomspace(low, 0.1, 400, endpoint=False), np.linspace(0.1, high, 901)])
    y = detection_at(curve, np.clip(x, low, high))
    return float(np.trapezoid(np.append(y, 1.0), np.append(x, 1.0)))

"""The numbers that a study asks for, of many truths of its scenario at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.data import NUMERICAL_DETECTORS
from hyperval.errors import UsageError
from hyperval.model import Evaluation, World, evaluations, with_values
from hyperval.model.detection import detect
from hyperval.model.roc import WHOLE, RocArea, curve_area, detection_at, log10_false_alarm_at
from hyperval.scenario import Scenario
from hyperval.spectra.axis import SpectralAxis, in_window
from hyperval.study.schema import Output
from hyperval.study.tables import Column

Array = npt.NDArray[np.float64]
Columns = Mapping[str, Column]
PFA = "pfa"  # beside the paths of the scenario: the false-alarm probability at which P_D is read
_PER_DECADE = 20


def check_outputs(outputs: list[Output], scenario: Scenario, axis: SpectralAxis) -> None:
    """Refuse outputs of subjects, detectors or bands that the scenario does not have.

    Raises
    ------
    UsageError : with the output's name.
    """
    scene, detectors = scenario.scene, scenario.processing.detectors
    pure = [s.name for s in (*scene.classes, *scene.panels, *scene.sites)]
    populations = [p.name for t in scene.targets for p in t.populations]
    for o in outputs:
        where = f"output {o.name!r}"
        spectral = o.kind in ("snr", "radiance")
        among = pure if spectral else populations
        if spectral and scenario.atmosphere is None:
            raise UsageError(f"{where}: the scenario has no atmosphere, so no {o.kind}")
        if not spectral and not detectors:
            raise UsageError(f"{where}: the scenario has no detectors", mend="add processing.detectors")
        if o.subject not in among:
            raise UsageError(f"{where}: no subject {o.subject!r}", expected="one of " + ", ".join(among))
        if o.detector not in (None, *detectors):
            raise UsageError(
                f"{where}: the scenario does not run {o.detector!r}", expected="one of " + ", ".join(detectors)
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


def of_truths(e: Evaluation, output: Output, pfa: Array | None) -> Array:
    """An output in every truth of an evaluation (n,); ``pfa`` (n,) where an input moves it."""
    if output.kind in ("snr", "radiance"):
        bands = bands_of(output, e.axis)
        snr = output.kind == "snr"
        values = e.snr(output.subject, output.calibration_error) if snr else e.radiance(output.subject)
        return np.asarray(values[:, bands].mean(axis=1))
    detector = output.detector or e.scenario.processing.detectors[0]
    if detector in NUMERICAL_DETECTORS:
        return _of_curves(e, detector, output, pfa)
    objects = output.kind == "pd" and output.by == "object"
    scores = e.scores(output.subject, detector, objects)
    if output.kind == "pd":
        at = np.array([[output.pfa]]) if pfa is None else np.asarray(pfa, float)[:, None]
        return np.asarray(scores.detection(at)[:, 0])
    if output.kind == "log10-pfa":
        return scores.log10_false_alarm(np.full(len(e), output.pd))
    if output.kind == "auc":
        return scores.auc()
    low, high = output.pfa_range  # probabilities even in their logarithm
    x = np.geomspace(low, high, max(2, round(np.log10(high / low) * _PER_DECADE)) + 1)
    return np.asarray(np.trapezoid(scores.detection(x[None, :]), np.log(x), axis=1) / np.log(x[-1] / x[0]))


def _of_curves(e: Evaluation, detector: str, output: Output, pfa: Array | None) -> Array:
    """An output of a detector whose curves are drawn: between their points they are read as all curves are."""
    values = np.empty(len(e))
    for i, detection in enumerate(detect(e, points=range(len(e)))):
        curve = detection.roc[output.subject, detector, output.by]
        if output.kind == "pd":
            at = output.pfa if pfa is None else float(pfa[i])
            assert at is not None  # noqa: S101 - the schema asks for it
            values[i] = detection_at(curve, at)
        elif output.kind == "log10-pfa":
            values[i] = log10_false_alarm_at(curve, output.pd)
        else:
            area = WHOLE if output.kind == "auc" else RocArea(*output.pfa_range, logarithmic=True)
            values[i] = curve_area(curve, area)
    return values


@dataclass(frozen=True)
class Evaluator:
    """The world of a study's scenario; goes to other processes as it is."""

    world: World

    def values(self, columns: Columns, outputs: Sequence[Output]) -> tuple[Array, dict[int, str]]:
        """Outputs (n, O) at n points, NaN where there is none, and why, by the number of the point.

        ``columns``: dotted path -> (n,) values, None where an entry is left as it is.  Where points can not be
        evaluated together, those that can not at all are found.
        """
        n = len(next(iter(columns.values())))
        values, problems, pieces = np.full((n, len(outputs)), np.nan), dict[int, str](), [np.arange(n)]
        while pieces:
            rows = pieces.pop()
            moved = {p: c[rows] for p, c in columns.items()}
            pfa = moved.pop(PFA, None)
            try:
                # Without anything that moves there is one truth, read at many P_FA.
                for index, e in evaluations(with_values(self.world, moved or {"line.offset": np.zeros(rows.size)})):
                    at, of = rows[index], None if pfa is None else pfa[index]
                    values[at] = np.stack([of_truths(e, o, of) for o in outputs], axis=1)
                    problems |= {int(at[u]): " ".join(str(error).split()) for u, error in e.problems.items()}
            except UsageError as error:
                if rows.size > 1:
                    pieces += np.array_split(rows, 2)
                else:
                    problems[int(rows[0])] = " ".join(str(error).split())
        return values, problems

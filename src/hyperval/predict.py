"""From a scenario to its products by statistics alone: the forward model (3.7-3.33)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericTerms
from hyperval.prediction.batch import Batch
from hyperval.prediction.cases import (
    Case,
    Engine,
    Origins,
    Setup,
    batch_of,
    case_of,
    engine_notes,
    saturation_notes,
    sensor_notes,
    unstated_notes,
)
from hyperval.prediction.departure import Departure, Given, moved_on, pixels_of_object
from hyperval.prediction.detection import PredictedDetection, RocKey, detect
from hyperval.prediction.input import UncertainInput, spectrum_error_covariance
from hyperval.prediction.inputs import SurfaceStatistics, class_tail
from hyperval.prediction.monte_carlo import Propagated, drawn_curve, limits, propagate, with_intervals
from hyperval.prediction.object_scores import expected_scores, object_scores_of_truths, predicted_object_scores
from hyperval.prediction.spectra import MeanError, spectral_products, without_calibration_error
from hyperval.prediction.uncertainty import (
    DRAWN_SHIFT,
    Change,
    Moved,
    Steps,
    given_with,
    inputs_of,
    law_directions,
    mean_shifts,
    moved_predictions,
    probit,
    setups_without,
    shift_notes,
    spectrum_inputs,
    steps_of,
    with_bands,
    with_law_errors,
    with_law_limits,
    with_moves,
)
from hyperval.products import SPECTRA, PixelDistribution, PredictedProducts, RocCurve
from hyperval.scenario import BackgroundClass, Scenario, Uncertainty

__all__ = ["Origins", "predict", "predictions", "without_calibration_error"]

Array = npt.NDArray[np.float64]
Again = Callable[[Iterable[Departure]], Iterator[PredictedProducts]]
_TOGETHER = 16  # truths in one batch: their matrices and products are in memory at once


def predict(
    scenario: Scenario,
    origins: Origins | None = None,
    *,
    departure: Departure | None = None,
    objects: bool | int = False,
    object_curves: bool = True,
) -> PredictedProducts:
    """Predict radiance, SNR, reflectance, detector scores and ROC of a scenario (3.7-3.33).

    Parameters
    ----------
    scenario : what to predict
    origins : bands, measured statistics, files, engine and sensor where they are not those that the scenario says
    departure : how the truth departs from the scenario; None: not at all
    objects : also draw the scores of whole objects, which takes a few seconds where there are many; a number is
        that of draws where no input is uncertain
    object_curves : also the ROC curves of whole objects, half of the time where there are many targets

    Returns
    -------
    Prediction.  Subjects of ``radiance`` and ``reflectance`` are classes, panels, sites and target
    populations; ``snr`` holds each class, panel and site twice, with C_R and under
    :func:`without_calibration_error`.  In the reflectance domain there is no radiance and no SNR.
    A shifted spectrometer is labelled by its nominal bands.

    Raises
    ------
    UsageError : a scenario that contradicts itself, or a covariance that cannot be inverted.
    InputError : a file that is missing or corrupt.
    EngineError : the atmosphere engine failed.
    """
    origins, truth = origins or Origins(), departure or Departure()
    case = case_of(scenario, origins, truth)
    given = given_with(case.setup, lambda: cast(AtmosphericTerms, case.terms))
    inputs = inputs_of(given, shapes=False)
    steps = steps_of(case, origins, truth, inputs)

    def again(truths: Iterable[Departure], stand_in: Engine | None = None) -> Iterator[PredictedProducts]:
        from_here = replace(origins, engine=stand_in or origins.engine)
        return predictions(scenario, (moved_on(truth, d) for d in truths), from_here)

    setups = setups_without(scenario, origins, truth)
    products, changes = _prediction(case, steps, objects, object_curves, setups)
    if products.roc:
        means = _of_background(given, inputs)
        truths = (moved_on(truth, item.direction(k, z)) for item in means for k in range(item.size) for z in (1, -1))
        for key, pairs in _changes_of(_curves(scenario, truths, origins), products.roc).items():
            changes[key] += pairs
    moves = moved_predictions([i for i in inputs if not i.subject], again)
    filters = {p.name: t.name for t in scenario.scene.targets for p in t.populations}
    linear, drawn = scenario.uncertainty.method == "linear", inputs_of(given) if departure is None else []
    products = _with_moves(
        products, changes, moves, filters,
        lambda: _propagated(case, None, drawn, again, origins).draws.curves if linear and drawn else {},
    )  # fmt: skip
    if linear or not drawn:
        return products
    return with_intervals(products, _propagated(case, products, drawn, again, origins), scenario.uncertainty.method)


def predictions(
    scenario: Scenario,
    truths: Iterable[Departure],
    origins: Origins | None = None,
    *,
    objects: bool | int = False,
    object_curves: bool = True,
) -> Iterator[PredictedProducts]:
    """Predictions of truths that depart from a scenario, in their order, each without a budget of its own.

    Spectra are read once; truths are evaluated together.
    """
    for together, batch in _batches(scenario, truths, origins or Origins()):
        detections = detect(batch, object_curves=object_curves, points=range(len(together)))
        scores = None
        if objects and detections[0].roc:
            setups = [case.setup for case in together]
            scores = object_scores_of_truths(batch, setups, None if objects is True else objects)
        for number, (case, detection) in enumerate(zip(together, detections, strict=True)):
            if scores:
                detection = replace(detection, object_scores=scores[number])
            yield _joined(case, batch, number, Steps(), detection)


def _batches(scenario: Scenario, truths: Iterable[Departure], origins: Origins) -> Iterator[tuple[list[Case], Batch]]:
    """Truths that are evaluated together, nothing of them uncertain, in their order."""
    bare, waiting, like = scenario.model_copy(update={"uncertainty": Uncertainty()}), iter(truths), None
    while some := list(islice(waiting, _TOGETHER)):
        if like is None:
            like = case_of(bare, origins, Departure())
        for together in _alike([case_of(bare, origins, truth, like) for truth in some]):
            yield together, batch_of(together, spectrum_errors(together[0].setup))


def _curves(scenario: Scenario, truths: Iterable[Departure], origins: Origins) -> Iterator[Mapping[RocKey, Array]]:
    """P_D (K,) of whole curves in each truth."""
    for together, batch in _batches(scenario, truths, origins):
        curves = detect(batch)[0].curves
        for number in range(len(together)):
            yield {key: of[number] for key, of in curves.items()}


def _alike(cases: Sequence[Case]) -> Iterator[list[Case]]:
    """Neighbouring cases that can be evaluated together: what is looked for, and how, is the same."""
    together: list[Case] = []
    for case in cases:
        if together and not _same_task(together[0].setup, case.setup):
            yield together
            together = []
        together.append(case)
    if together:
        yield together


def _same_task(a: Setup, b: Setup) -> bool:
    if a.scenario.scene is not b.scenario.scene and _sizes(a) != _sizes(b):
        return False
    if a.signatures is b.signatures and a.used is b.used:
        return True
    same = a.scenario.processing == b.scenario.processing and a.scenario.formulation == b.scenario.formulation
    same = same and list(a.surfaces) == list(b.surfaces) and len(a.used.axis) == len(b.used.axis)
    return same and all(np.array_equal(v, b.signatures[n], equal_nan=True) for n, v in a.signatures.items())


def _sizes(setup: Setup) -> list[int]:
    """Number of pixels of an object of each population."""
    return [pixels_of_object(p.fill) for t in setup.scenario.scene.targets for p in t.populations]


def spectrum_errors(setup: Setup) -> dict[str, Array]:
    """Subject -> (B, B) error covariance of its field spectrum.

    What replicate spectra say of their own mean stands where the scenario does not say it of the subject; several
    entries of one subject are independent.
    """
    stated = {item.subject for item in setup.scenario.uncertainty.field_spectra}
    errors: dict[str, Array] = {
        name: s.mean_error for name, s in setup.surfaces.items() if s.mean_error is not None and name not in stated
    }
    for item in setup.scenario.uncertainty.field_spectra:
        one = spectrum_error_covariance(item, setup.surfaces[item.subject], setup.used.axis, setup.used.sensor)
        errors[item.subject] = errors[item.subject] + one if item.subject in errors else one
    return errors


def _prediction(
    case: Case, steps: Steps, objects: bool | int, object_curves: bool, setups: Iterable[Sequence[Setup]]
) -> tuple[PredictedProducts, dict[RocKey, list[Change]]]:
    """A case with the errors of its spectra by light and sensor.

    The second part are the changes of probit P_D by one standard uncertainty of each input of light and sensor, and
    by the field spectra of the targets.

    Parameters
    ----------
    setups : of the case without parts of the pixels that the laws of its background were fitted to
    """
    errors, pairs = spectrum_errors(case.setup), len(steps.plus)
    cases = [case, *steps.plus, *steps.minus]
    shifts = (1.0, -1.0) if any(t.name in errors for t in case.setup.scenario.scene.targets) else ()
    batch = batch_of(cases, errors, shifts)
    detection = detect(batch, object_curves=object_curves)[0]
    if objects and detection.roc:
        points, targets = np.arange(1 + 2 * pairs), case.setup.scenario.scene.targets
        draws = None if objects is True else objects
        scores = predicted_object_scores(batch, points, targets, draws)
        detection = replace(detection, object_scores=scores, expected_scores=expected_scores(batch, points))
    detection = replace(
        detection, exceedance=with_law_errors(detection.exceedance, law_directions(batch, case, setups))
    )
    return _joined(case, batch, 0, steps, detection), _changes(detection, pairs)


def _changes(detection: PredictedDetection, pairs: int) -> dict[RocKey, list[Change]]:
    """Changes of probit P_D by one standard uncertainty, from evaluations in the order of :func:`_prediction`."""
    out = {}
    for key, curves in detection.curves.items():
        z = probit(curves)
        pairs_of = [(z[1 + k] - z[0], z[1 + pairs + k] - z[0]) for k in range(pairs)]
        if len(z) > 1 + 2 * pairs:
            pairs_of.append((z[-2] - z[0], z[-1] - z[0]))
        out[key] = pairs_of
    return out


def _joined(case: Case, batch: Batch, number: int, steps: Steps, detection: PredictedDetection) -> PredictedProducts:
    """One evaluation of a batch as a prediction."""
    setup, settings = case.setup, batch.settings
    scenario, axis = setup.scenario, setup.used.axis
    view = settings.view.row(number)
    if view.retrieval is not None:  # what the line is off by is seen by the detectors alone
        view = replace(view, retrieval=None)
    ground, engine = settings.grounds[settings.which[number]], scenario.uncertainty.engine
    errors = [MeanError("field spectrum", name, error) for name, error in batch.errors.items()]
    if scenario.uncertainty.sampled_statistics:
        given = given_with(setup, lambda: cast(AtmosphericTerms, case.terms))
        means = [i for i in inputs_of(given, shapes=False) if i.subject]
        errors += [MeanError(i.name, i.subject, i.rows.T @ i.rows) for i in means]
    spectra = spectral_products(case, ground, view, steps, errors, engine)
    notes = [f"formulation: {scenario.formulation}", *unstated_notes(scenario.atmosphere, scenario.uncertainty)]
    notes += engine_notes(scenario.atmosphere, case.terms)
    if detection.roc:
        notes.append(f"detectors use {batch.groups[0].bands.size} of {len(axis)} bands")
    notes += detection.notes
    if case.noise is not None:
        notes += sensor_notes(setup.used) + saturation_notes(spectra.full_scale, axis)
    return PredictedProducts(
        axis,
        spectra.radiance,
        spectra.snr,
        spectra.reflectance,
        detection.scores,
        detection.roc,
        object_scores=detection.object_scores,
        exceedance=detection.exceedance,
        distribution={c.name: _distribution(c, setup.surfaces[c.name]) for c in scenario.scene.classes},
        notes=tuple(notes),
        provenance=_provenance(case),
        noise=spectra.noise,
        full_scale=spectra.full_scale,
        expected_scores=detection.expected_scores,
        toa_reflectance=spectra.toa_reflectance,
    )


def _distribution(c: BackgroundClass, surface: SurfaceStatistics) -> PixelDistribution:
    """How the pixels of a class are distributed about their mean."""
    parts, tail = surface.components, class_tail(c, surface) or math.inf
    if parts is None:
        return PixelDistribution(tail)
    own = parts.stretched(math.sqrt(c.gain))
    dof = [tail if isinstance(c.tail_dof, float) else parts.dof] * len(parts)
    clusters = zip(own.weights.tolist(), own.offsets, own.covariances, dof, strict=True)
    return PixelDistribution(tail, clusters=tuple(clusters))


def _of_background(given: Given, inputs: Iterable[UncertainInput]) -> list[UncertainInput]:
    """Spectra that move the background or were sampled; field spectra of targets are in the curves already."""
    classes = {c.name for c in given.scenario.scene.classes}
    return [*(i for i in spectrum_inputs(given) if i.subject in classes), *(i for i in inputs if i.subject)]


def _changes_of(
    curves: Iterable[Mapping[RocKey, Array]], stated: Mapping[RocKey, RocCurve]
) -> dict[RocKey, list[Change]]:
    """Changes of probit P_D from curves of truths, each input up and then down."""
    out: dict[RocKey, list[Change]] = {key: [] for key in stated}
    each = iter(curves)
    for up, down in zip(each, each, strict=True):
        for key, curve in stated.items():
            out[key].append((probit(up[key]) - probit(curve.pd), probit(down[key]) - probit(curve.pd)))
    return out


def _with_moves(
    prediction: PredictedProducts,
    changes: Mapping[RocKey, list[Change]],
    moves: Sequence[Moved],
    filters: Mapping[str, str],
    draw: Callable[[], Mapping[Any, Array]],
) -> PredictedProducts:
    """The prediction with the errors by inputs that change surfaces, fills or bands, and limits of its curves.

    ``filters`` : population -> the target that its filter looks for;  ``draw`` : curves (N, K) of truths drawn from
    the budget, asked for where errors shift the mean of P_D by so much that their directions do not add up
    """
    spectra: dict[str, Any] = {p: dict(getattr(prediction, p)) for p in SPECTRA}
    for product, estimates in spectra.items():
        with_moves(estimates, product, moves)
    curves = ({k: c.pd for k, c in p.roc.items()} for m in moves for p in (m.plus, m.minus))
    moved = _changes_of(curves, prediction.roc)
    whole = {key: [*changes[key], *moved[key]] for key in prediction.roc}
    roc, shifts = with_bands(prediction.roc, whole), mean_shifts(prediction.roc, whole)
    drawn = draw() if any(shift > DRAWN_SHIFT for shift in shifts.values()) else {}
    far = {key: limits(drawn[key]) for key, shift in shifts.items() if shift > DRAWN_SHIFT and key in drawn}
    roc |= {key: drawn_curve(prediction.roc[key], interval) for key, interval in far.items()}
    notes = shift_notes(shifts, far, len(next(iter(drawn.values()))) if drawn else 0)
    for (population, detector, unit), curve in roc.items():
        alarms = prediction.exceedance.get((filters[population], detector))
        if alarms is not None and np.any(alarms.upper > alarms.probability):
            roc[population, detector, unit] = with_law_limits(curve, alarms)
    return replace(prediction, **spectra, roc=roc, notes=(*prediction.notes, *notes))


def _propagated(
    case: Case, stated: PredictedProducts | None, inputs: list[UncertainInput],
    again: Callable[..., Iterator[PredictedProducts]], origins: Origins,
) -> Propagated:  # fmt: skip
    """The budget drawn, beside its linear propagation where the prediction is given."""
    scenario = case.setup.scenario
    shifts = any(np.any(np.asarray(i.moved(1.0).wavelength_shift_nm) != 0.0) for i in inputs)
    bands = None if shifts else case.setup.used.true_axis
    u = scenario.uncertainty
    return propagate(
        scenario, stated, inputs, again, samples=u.samples, seed=u.seed,
        engine=lambda state: origins.whole_terms(scenario, state), axis=bands,
        show_progress=origins.show_progress,
    )  # fmt: skip


def _provenance(case: Case) -> dict[str, object]:
    scenario, sensor = case.setup.scenario, case.setup.used.sensor
    record: dict[str, object] = {
        "scenario": scenario.name,
        "formulation": scenario.formulation,
        "atmosphere": case.terms.provenance if case.terms else None,
        "sensor": {"name": sensor.name, "source": sensor.specification.source} if sensor else None,
        "spectra": {name: s.source for name, s in case.setup.surfaces.items()},
    }
    if scenario.atmosphere is not None and scenario.atmosphere.time_utc is not None:
        record["time_utc"] = scenario.atmosphere.time_utc
    if scenario.sensor_operation is not None:
        record["sensor_operation"] = scenario.sensor_operation.model_dump(mode="json")
    if scenario.sensor_changes is not None:
        record["sensor_changes"] = scenario.sensor_changes.model_dump(mode="json")
    return record

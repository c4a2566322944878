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
from hyperval.prediction.budget import given_with, inputs_of, spectrum_inputs
from hyperval.prediction.cases import Case, Engine, Origins, batch_of, case_of
from hyperval.prediction.certain_objects import object_scores_of_truths
from hyperval.prediction.departure import Departure, moved_on
from hyperval.prediction.detection import Detection, RocKey, detect
from hyperval.prediction.expected_scores import expected_scores
from hyperval.prediction.forms import spectrum_error_covariance
from hyperval.prediction.input import Input
from hyperval.prediction.input_paths import Given
from hyperval.prediction.inputs import class_tail
from hyperval.prediction.law_sampling import law_directions, setups_without, with_law_errors, with_law_limits
from hyperval.prediction.object_scores import predicted_object_scores
from hyperval.prediction.setup import Setup, engine_notes, saturation_notes, sensor_notes, unstated_notes
from hyperval.prediction.spectra import spectral_products, without_calibration_error
from hyperval.prediction.uncertainty import (
    Change,
    Moved,
    Steps,
    moved_predictions,
    probit,
    steps_of,
    with_bands,
    with_moves,
)
from hyperval.products import SPECTRA, PixelDistribution, Prediction
from hyperval.scenario import Scenario
from hyperval.scenario_uncertainty import Uncertainty

__all__ = ["Origins", "predict", "predictions", "without_calibration_error"]

Array = npt.NDArray[np.float64]
Again = Callable[[Iterable[Departure]], Iterator[Prediction]]
_TOGETHER = 16  # truths in one batch: their matrices and products are in memory at once
_MOST_OF_CLASSES = 8  # directions of a class's spectrum whose effect on the curves is followed


def predict(
    scenario: Scenario,
    origins: Origins | None = None,
    *,
    departure: Departure | None = None,
    objects: bool | int = False,
    object_curves: bool = True,
) -> Prediction:
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

    def again(truths: Iterable[Departure], stand_in: Engine | None = None) -> Iterator[Prediction]:
        from_here = replace(origins, engine=stand_in or origins.engine)
        return predictions(scenario, (moved_on(truth, d) for d in truths), from_here)

    setups = setups_without(scenario, origins, truth)
    products, changes = _prediction(case, steps, objects, object_curves, setups)
    filters = {p.name: t.name for t in scenario.scene.targets for p in t.populations}
    of_classes = _of_classes(products, given, again)
    products = _with_moves(products, changes, moved_predictions(inputs, again), of_classes, filters)
    if scenario.uncertainty.method == "linear" or departure is not None:
        return products
    return _propagated(case, products, inputs_of(given), again, origins)


def predictions(
    scenario: Scenario,
    truths: Iterable[Departure],
    origins: Origins | None = None,
    *,
    objects: bool | int = False,
    object_curves: bool = True,
) -> Iterator[Prediction]:
    """Predictions of truths that depart from a scenario, in their order, each without a budget of its own.

    Spectra are read once; truths are evaluated together.
    """
    bare, source = scenario.model_copy(update={"uncertainty": Uncertainty()}), origins or Origins()
    waiting, like = iter(truths), None
    while some := list(islice(waiting, _TOGETHER)):
        if like is None:
            like = case_of(bare, source, Departure())
        cases = [case_of(bare, source, truth, like) for truth in some]
        for together in _alike(cases):
            batch = batch_of(together, spectrum_errors(together[0].setup))
            detections = detect(batch, object_curves=object_curves, points=range(len(together)))
            scores = None
            if objects and detections[0].roc:
                setups = [case.setup for case in together]
                scores = object_scores_of_truths(batch, setups, None if objects is True else objects)
            for number, (case, detection) in enumerate(zip(together, detections, strict=True)):
                if scores:
                    detection = replace(detection, object_scores=scores[number])
                yield _joined(case, batch, number, Steps(), detection)


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
    if a.signatures is b.signatures and a.used is b.used:
        return True
    same = a.scenario.processing == b.scenario.processing and a.scenario.formulation == b.scenario.formulation
    same = same and list(a.surfaces) == list(b.surfaces) and len(a.used.axis) == len(b.used.axis)
    return same and all(np.array_equal(v, b.signatures[n], equal_nan=True) for n, v in a.signatures.items())


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
) -> tuple[Prediction, dict[RocKey, list[Change]]]:
    """A case with the errors of its spectra by light and sensor.

    The second part are the changes of probit P_D by one standard uncertainty of each input of light and sensor, and
    by the field spectra of the targets.

    Parameters
    ----------
    setups : of the case without parts of the pixels that the laws of its background were fitted to
    """
    errors = spectrum_errors(case.setup)
    leading = steps.leading
    cases = [case, *(steps.plus[i] for i in leading), *(steps.minus[i] for i in leading)]
    shifts = (1.0, -1.0) if any(t.name in errors for t in case.setup.scenario.scene.targets) else ()
    batch = batch_of(cases, errors, shifts)
    detection = detect(batch, object_curves=object_curves)[0]
    if objects and detection.roc:
        points, targets = np.arange(1 + 2 * len(leading)), case.setup.scenario.scene.targets
        draws = None if objects is True else objects
        scores = predicted_object_scores(batch, points, targets, draws)
        detection = replace(detection, object_scores=scores, expected_scores=expected_scores(batch, points))
    detection = replace(
        detection, exceedance=with_law_errors(detection.exceedance, law_directions(batch, case, setups))
    )
    return _joined(case, batch, 0, steps, detection), _changes(detection, len(leading))


def _changes(detection: Detection, pairs: int) -> dict[RocKey, list[Change]]:
    """Changes of probit P_D by one standard uncertainty, from evaluations in the order of :func:`_prediction`."""
    out = {}
    for key, curves in detection.curves.items():
        z = probit(curves)
        pairs_of = [(z[1 + k] - z[0], z[1 + pairs + k] - z[0]) for k in range(pairs)]
        if len(z) > 1 + 2 * pairs:
            pairs_of.append((z[-2] - z[0], z[-1] - z[0]))
        out[key] = pairs_of
    return out


def _joined(case: Case, batch: Batch, number: int, steps: Steps, detection: Detection) -> Prediction:
    """One evaluation of a batch as a prediction."""
    setup, settings = case.setup, batch.settings
    scenario, axis = setup.scenario, setup.used.axis
    view = settings.view.row(number)
    if view.retrieval is not None:  # what the line is off by is seen by the detectors alone
        view = replace(view, retrieval=None)
    ground, engine = settings.grounds[settings.which[number]], scenario.uncertainty.engine
    spectra = spectral_products(case, ground, view, steps, batch.errors, engine)
    notes = [f"formulation: {scenario.formulation}", *unstated_notes(scenario.atmosphere, scenario.uncertainty)]
    notes += engine_notes(scenario.atmosphere, case.terms)
    if detection.roc:
        notes.append(f"detectors use {batch.groups[0].bands.size} of {len(axis)} bands")
    notes += detection.notes
    if case.noise is not None:
        notes += sensor_notes(setup.used) + saturation_notes(spectra.full_scale, axis)
    tails = {c.name: class_tail(c, setup.surfaces[c.name]) for c in scenario.scene.classes}
    return Prediction(
        axis,
        spectra.radiance,
        spectra.snr,
        spectra.reflectance,
        detection.scores,
        detection.roc,
        object_scores=detection.object_scores,
        exceedance=detection.exceedance,
        distribution={name: PixelDistribution(dof or math.inf) for name, dof in tails.items()},
        notes=tuple(notes),
        provenance=_provenance(case),
        noise=spectra.noise,
        full_scale=spectra.full_scale,
        expected_scores=detection.expected_scores,
        toa_reflectance=spectra.toa_reflectance,
    )


def _of_classes(prediction: Prediction, given: Given, again: Again) -> list[Moved]:
    """Moved spectra of classes, which move the background; those of targets are in the curves already."""
    if not prediction.roc:
        return []
    classes = {c.name for c in given.scenario.scene.classes}
    inputs = [i for i in spectrum_inputs(given) if i.subject in classes]
    return moved_predictions(inputs, again, most=_MOST_OF_CLASSES)


def _with_moves(
    prediction: Prediction,
    changes: Mapping[RocKey, list[Change]],
    moves: Sequence[Moved],
    of_classes: Sequence[Moved],
    filters: Mapping[str, str],
) -> Prediction:
    """The prediction with the errors by inputs that change surfaces, fills or bands, and limits of its curves.

    ``filters`` : population -> the target that its filter looks for
    """
    spectra: dict[str, Any] = {p: dict(getattr(prediction, p)) for p in SPECTRA}
    for product, estimates in spectra.items():
        with_moves(estimates, product, moves)
    pairs = [*moves, *of_classes]
    whole = {}
    for key, curve in prediction.roc.items():
        z = probit(curve.pd)
        moved = [(probit(m.plus.roc[key].pd) - z, probit(m.minus.roc[key].pd) - z) for m in pairs]
        whole[key] = [*changes[key], *moved]
    roc = with_bands(prediction.roc, whole)
    for (population, detector, unit), curve in roc.items():
        alarms = prediction.exceedance.get((filters[population], detector))
        if alarms is not None and np.any(alarms.upper > alarms.probability):
            roc[population, detector, unit] = with_law_limits(curve, alarms)
    return replace(prediction, **spectra, roc=roc)


def _propagated(
    case: Case, stated: Prediction, inputs: list[Input], again: Callable[..., Iterator[Prediction]],
    origins: Origins,
) -> Prediction:  # fmt: skip
    """The prediction with its budget drawn; unchanged where nothing is uncertain."""
    from hyperval.prediction.monte_carlo import propagate, with_intervals

    if not inputs:
        return stated
    scenario = case.setup.scenario
    shifts = any(np.any(np.asarray(i.moved(1.0).wavelength_shift_nm) != 0.0) for i in inputs)
    bands = None if shifts else case.setup.used.true_axis
    u = scenario.uncertainty
    propagation = propagate(
        scenario, stated, inputs, again, samples=u.samples, seed=u.seed,
        engine=lambda state: origins.whole_terms(scenario, state), axis=bands,
        show_progress=origins.show_progress,
    )  # fmt: skip
    return with_intervals(stated, propagation, u.method)


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

"""From a scenario to its products by statistics alone: the forward model (3.7-3.33).

Spectra are radiance, SNR, noise and reflectance of every subject, with their errors (3.7-3.20, and the empirical line).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from hyperval.atmosphere import AtmosphericTerms
from hyperval.data import Array, Errors, Index
from hyperval.model.detection import Evaluation, RocKey, detect, evaluations
from hyperval.model.inputs import (
    UncertainInput,
    inputs_of,
    interpolation_input,
    spectrum_errors,
)
from hyperval.model.objects import (
    Shares,
    expected_scores,
    object_scores,
    shares_of,
)
from hyperval.model.propagate import Changes, joined, probit, with_law_errors, with_uncertainty
from hyperval.model.radiance import (
    Background,
    Light,
    of_truth,
    retrieved_covariance,
    retrieved_reflectance,
    target_light,
    target_pixel_covariance,
    target_pixel_reflectance,
    toa_reflectance,
)
from hyperval.model.stated import Origins, Stated, Truth
from hyperval.model.world import World, find, read, settled, with_truths
from hyperval.products import PixelDistribution, PredictedProducts, SpectralEstimate
from hyperval.scenario import Scenario, Uncertainty
from hyperval.spectra.axis import SpectralAxis

SpectralErrors = Mapping[tuple[str, str], Mapping[str, Errors]]  # (product, subject) -> source -> its errors
_DIRECTIONS = 32  # directions whose spectra are in memory at once
_ROUNDING = 1e-9  # of an error: what rounding leaves where nothing follows
_SEEN_BY_NO_SPECTRUM = ("dark", "bright", "line_gain", "line_offset", "spread", "tail", "fine_texture")


def without_calibration_error(subject: str) -> str:
    """Name under which ``snr`` holds a subject with C_R left out of (3.20)."""
    return f"{subject} (no calibration error)"


def combined(
    errors: Mapping[str, Errors], covariances: Mapping[str, Array], bands: int
) -> tuple[Array, dict[str, Array]]:
    """Error covariance (B, B) and budget from independent sources, some of them as covariances (B, B)."""
    every = {source: known(c) for source, c in covariances.items()}
    budget = {s: e.budget for s, e in errors.items()} | {s: np.sqrt(np.diag(c)) for s, c in every.items()}
    total = np.zeros((bands, bands))
    for part in (*(e.covariance for e in errors.values()), *every.values()):
        total += part
    return total, budget


def known(covariance: Array) -> Array:
    """The matrix with 0 where nothing is known; unchanged, and not copied, where all is."""
    return covariance if np.isfinite(np.sum(covariance)) else np.nan_to_num(covariance)


def reflectances(e: Evaluation) -> dict[str, tuple[Array, Array]]:
    """Subject -> (U or 1, 1, B) what it reflects, as a surface in the open would have to, and what meets light of the
    surroundings (3.10).
    """
    world, scene, mean = e.world, e.scenario.scene, e.world.mean

    def of(name: str) -> Array:
        number = world.surface(name)
        return mean[:, number : number + 1]

    out = {s.name: 2 * (of(s.name),) for s in (*scene.classes, *scene.panels, *scene.sites)}
    placed = [shares_at(world, number) for number in range(len(e.stated.populations))]
    light = e.light.rows(e.which)
    full = {t.name: target_light(world, light, number)[:2] for number, t in enumerate(scene.targets)}
    for (t, _, population), fills, shares in zip(e.stated.populations, world.pixel_fills, placed, strict=True):
        host, name = of(scene.targets[t].host), scene.targets[t].name
        if shares is None:
            mean_fill = (fills.weights * fills.values).sum(axis=1)[:, None]
            one, under = (target_pixel_reflectance(mean_fill, x, host) for x in full[name])
        else:
            each = [[sum(s.mean[j] for j, n in enumerate(s.names) if n == name) for name in full] for s in shares[0]]
            fractions = np.array(each, dtype=float)[shares[1]]
            one, under = (
                host + sum(fractions[:, j, None, None] * (x[k] - host) for j, x in enumerate(full.values()))
                for k in (0, 1)
            )
        out[population.name] = one, under
    return out


def shares_at(world: World, number: int) -> tuple[list[Shares], Index] | None:
    """The different shares of an object's pixels at its place, and which (U,) of them each truth has; None where there
    is no place, or the printed form.
    """
    stated, scenario = world.stated, world.stated.scenario
    t, _, population = stated.populations[number]
    if scenario.formulation == "thesis" or population.fill.geometry is None or population.position_m is None:
        return None
    models, which = world.fill_models(number)
    position, populations = scenario.uncertainty.position_m, world.populations_at(0)
    each: list[Any] = []
    for fill in models:
        key = "shares", number, repr((fill, [p.fill for _, p in populations]))
        moved, seed = population.model_copy(update={"fill": fill}), scenario.processing.seed
        make = partial(shares_of, stated.targets[t].name, moved, populations, position, seed)
        each.append(stated.once(key, make))
    return each, which


def mean_spectra(e: Evaluation) -> dict[tuple[str, str], Array]:
    """(product, subject) -> (U or 1, B) mean spectra of all truths (3.7-3.20)."""
    names, out = e.stated.names, dict[tuple[str, str], Array]()
    bare = {name: without_calibration_error(name) for name in names["surface"] if name not in names["target"]}
    each, light = e.once("reflectances", partial(reflectances, e)), e.light.rows(e.which)
    for name, (rho, _) in each.items():
        level = light.level(rho)
        if not light.radiant or light.elm is not None:
            # What the empirical line is off by belongs to collected reflectance, not to the predicted one.
            out["reflectance", name] = retrieved_reflectance(light.library_line, level)[:, 0]
        if light.radiant:
            out["radiance", name] = level[:, 0]
            white = light.terms.diffuser_radiance
            if white is not None and e.scenario.is_of_space:
                out["toa_reflectance", name] = toa_reflectance(level, white)[:, 0]
            if light.noise is not None and name in bare:
                for key, with_c in ((name, True), (bare[name], False)):
                    out["snr", key] = light.noise.snr(level, calibration=with_c)[:, 0]
    return out


def spectral_errors(world: World, inputs: Iterable[UncertainInput]) -> SpectralErrors:
    """Errors of the mean spectra of one truth: half the difference of up and down along each direction of each input,
    the rest held.
    """
    out: dict[tuple[str, str], dict[str, Errors]] = {}
    state = world.stated.scenario.atmosphere
    day = str(state.time_utc or "")[:10] if state is not None else ""
    for item in inputs:
        if find(world.stated, item.path).field in _SEEN_BY_NO_SPECTRUM:
            continue
        least = _ROUNDING * float(np.abs(item.rows).max(initial=0.0))
        of_spectrum = item.subject and item.kind == "surface"
        name = "field spectrum" if of_spectrum else item.name
        scale = *item.scale, day if item.path.startswith("atmosphere.") else ""
        for start in range(0, len(item.rows), _DIRECTIONS):
            some = range(start, min(start + _DIRECTIONS, len(item.rows)))
            there = with_truths(world, [item.direction(k, z) for z in (1.0, -1.0) for k in some])
            whole = joined(((index, mean_spectra(Evaluation(part))) for index, part in settled(there)), there.size)
            for key, values in whole.items():
                rows = 0.5 * (values[: len(some)] - values[len(some) :])
                if item.kind == "engine" and key[0] == "reflectance":  # the empirical line takes it off
                    continue
                if of_spectrum and not np.nanmax(np.abs(rows), initial=0.0) > least:
                    continue
                each = out.setdefault(key, {})
                before = [each[name].rows] if name in each else []
                each[name] = Errors(np.concatenate([*before, np.nan_to_num(rows)]), np.inf, *scale)
    return out


def spectral_prediction(e: Evaluation, u: int, errors: SpectralErrors | None) -> PredictedProducts:
    """All spectra of one truth with their errors (3.7-3.20); scores and curves come later (:func:`detect`).

    ``errors`` : None: mean spectra alone, whose matrices are 0
    """
    stated, world, v = e.stated, e.world.rows(np.array([u])), int(e.which[u])
    out: dict[str, Any] = {p: {} for p in ("radiance", "snr", "reflectance", "toa_reflectance", "noise", "full_scale")}
    bands, populations = len(e.axis), [p.name for _, _, p in stated.populations]
    means = {key: of_truth(values, u) for key, values in e.once("spectra", lambda: mean_spectra(e)).items()}
    each = e.once("reflectances", partial(reflectances, e))
    light = e.light.row(v)
    terms = light.terms if light.radiant else None
    notes = [f"formulation: {e.scenario.formulation}", *(terms.notes if terms else ())]
    if not e.scenario.uncertainty.model_dump(exclude_defaults=True):
        notes.append("the scenario states no uncertainty: intervals and tests contain little but the collection's own")
    levels = {name: light.level(of_truth(rho, u)[0]) for name, (rho, _) in each.items()}
    if light.radiant and light.noise is not None:
        if light.noise.full_scale is not None:
            out["full_scale"] = {name: light.noise.full_scale_fraction(level) for name, level in levels.items()}
        out["noise"] = {n: asdict(light.noise.breakdown(x)) for n, x in levels.items() if n not in populations}
        notes += [*stated.notes, *saturation_notes(out["full_scale"], e.axis)]
    out["distribution"] = {name: _distribution(world, m) for m, name in enumerate(stated.classes)}
    out |= {"notes": tuple(notes), "provenance": provenance_of(stated, terms)}
    spreads = {} if errors is None else pixel_spreads(e, u, levels)
    for (product, key), mean in means.items():
        pixel, shapes = spreads.get((product, key), (None, {}))
        own = (errors or {}).get((product, key), {})
        total, budget = (np.broadcast_to(0.0, 2 * (bands,)), {}) if errors is None else combined(own, shapes, bands)
        pixel, own = None if pixel is None else known(pixel), {} if product == "snr" else own
        out[product][key] = SpectralEstimate(mean, total, pixel, None, budget, errors=own)
    return PredictedProducts(e.axis, **out)


Spread = tuple[Array, Mapping[str, Array]]


def pixel_spreads(e: Evaluation, u: int, levels: Mapping[str, Array]) -> dict[tuple[str, str], Spread]:
    """(product, subject) -> covariance of the pixels of one truth (3.11, 3.12), and of the mean of an object at its
    place by source, (B, B) each.

    ``levels`` : subject -> (B,) mean signal
    """
    world, v, bands = e.world.rows(np.array([u])), int(e.which[u]), np.arange(len(e.axis))
    populations = [p.name for _, _, p in e.stated.populations]
    light, one = e.light.row(v), e.light.rows(np.array([v]))
    pixels = {
        name: _mixed(world, one, populations.index(name)) if name in populations else (*_of_surface(world, name), {})
        for name in levels
    }
    around, line, slope = Background.of(e.at, bands).covariance(v), light.library_line, light.slope()
    out: dict[tuple[str, str], Spread] = {}
    for name, (_, met) in e.once("reflectances", partial(reflectances, e)).items():
        covariance, gain, others = pixels[name]
        seen = light.pixel_covariance(levels[name], of_truth(met, u)[0], covariance, around, gain)
        through = {source: c * np.outer(slope, slope) for source, c in others.items()}  # by the slope of the pixel
        back = {source: retrieved_covariance(line, c) for source, c in through.items()}
        out["radiance", name], out["reflectance", name] = (seen, through), (retrieved_covariance(line, seen), back)
    return out


def _of_surface(world: World, name: str) -> tuple[Array, float]:
    """(B, B) covariance of a surface in one truth, its gain included, and that gain: g_m of a class, 1 of any other."""
    classes, stretch = world.stated.classes, world.stretch[0, world.surface(name)]
    gain = float(world.column("class_gain")[0, classes.index(name)]) if name in classes else 1.0
    factor = gain * (stretch[0] ** 2 if stretch.size == 1 else np.outer(stretch, stretch))
    covariance = world.stated.surfaces[name].covariance
    return covariance if np.all(factor == 1.0) else factor * covariance, gain


def _mixed(world: World, light: Light, number: int) -> tuple[Array, float, Mapping[str, Array]]:
    """Covariance of target pixels of one population (3.10, 3.12), gain of the host, and errors (B, B) of the mean of
    one object at its place by source.
    """
    stated, t = world.stated, world.stated.populations[number][0]
    target = stated.targets[t]
    full = {o.name: target_light(world, light, i)[0][0, 0] for i, o in enumerate(stated.targets)}
    shade, own = target_light(world, light, t)[2], _of_surface(world, target.name)[0]
    if np.ndim(shade):
        factor = np.asarray(shade)[0, 0]
        own = own * np.outer(factor, factor)
    host, (behind, gain) = world.mean[0, world.surface(target.host)], _of_surface(world, target.host)
    fills, weights = world.pixel_fills[number].values[0], world.pixel_fills[number].weights[0]
    fill = float(weights @ fills)
    covariance = target_pixel_covariance(
        fill, float(weights @ (fills - fill) ** 2), full[target.name], own, host, behind,
        target_gain=float(world.column("target_gain")[0, t]),
        fine_texture=float(world.column("fine_texture")[0, world.surface(target.name)]),
        formulation=stated.scenario.formulation,
    )  # fmt: skip
    shares = shares_at(world, number)
    if shares is None:
        return covariance, gain, {}
    return covariance, gain, shares[0][shares[1][0]].errors(full, host, behind)


def saturation_notes(full_scale: Mapping[str, Array], axis: SpectralAxis) -> list[str]:
    """One note for each subject whose mean radiance passes full scale."""
    notes = []
    for subject, part in full_scale.items():
        over = part > 1.0
        if over.any():
            at = int(np.nanargmax(part))
            notes.append(
                f"SATURATION: {subject} passes full scale in {int(over.sum())} bands, "
                f"at most {part[at]:.2f} of it at {axis.centre_nm[at]:g} nm"
            )
    return notes


def provenance_of(stated: Stated, terms: AtmosphericTerms | None) -> dict[str, object]:
    """Where the numbers of a prediction come from."""
    scenario, sensor = stated.scenario, stated.sensor
    record: dict[str, object] = {
        "scenario": scenario.name,
        "formulation": scenario.formulation,
        "atmosphere": terms.provenance if terms else None,
        "sensor": {"name": sensor.name, "source": sensor.specification.source} if sensor else None,
        "spectra": {name: s.source for name, s in stated.surfaces.items()},
    }
    if scenario.atmosphere is not None and scenario.atmosphere.time_utc is not None:
        record["time_utc"] = scenario.atmosphere.time_utc
    for name in ("sensor_operation", "sensor_changes"):
        if (there := getattr(scenario, name)) is not None:
            record[name] = there.model_dump(mode="json")
    return record


_TOGETHER = 16  # truths evaluated at once: their matrices and products are in memory together


def predict(
    scenario: Scenario,
    origins: Origins | None = None,
    *,
    truth: Truth | None = None,
    objects: bool | int = False,
    object_curves: bool = True,
) -> PredictedProducts:
    """Predict radiance, SNR, reflectance, detector scores and ROC of a scenario (3.7-3.33).

    Parameters
    ----------
    scenario : what to predict
    origins : bands, measured statistics, files, engine and sensor where they are not those that the scenario says
    truth : dotted path -> what truly stands there (:data:`hyperval.model.PATHS`); None: all is as stated
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
    source = origins or Origins()
    world = settled(with_truths(read(scenario, source), [truth or {}]))[0][1]
    world = replace(world, stated=replace(world.stated, before=None))
    inputs, errors, lit = inputs_of(world), spectrum_errors(world), scenario.atmosphere is not None
    linear = [i for i in inputs if lit or not i.of_light]
    of_spectra = spectral_errors(world, [*linear, *interpolation_input(world)])
    products, changes = _prediction(world, of_spectra, errors, linear, objects, object_curves, source, truth or {})
    return with_uncertainty(products, world, inputs if truth is None else [], changes, _predictions)


def predictions(
    scenario: Scenario,
    truths: Iterable[Truth],
    origins: Origins | None = None,
    *,
    objects: bool | int = False,
    object_curves: bool = True,
) -> Iterator[PredictedProducts]:
    """Predictions of truths in which something is moved, in their order, each without a budget of its own.

    Spectra are read once; truths are evaluated together.  Mean spectra, scores and curves: matrices (B, B) of each
    subject would take most of the time, and a hundred times the memory.

    Parameters
    ----------
    truths : dotted path -> what truly stands there (:data:`hyperval.model.PATHS`), of each
    """
    return _predictions(read(scenario, origins), truths, objects, object_curves)


def _predictions(
    world: World, truths: Iterable[Truth], objects: bool | int = False, object_curves: bool = True
) -> Iterator[PredictedProducts]:
    certain = world.stated.scenario.model_copy(update={"uncertainty": Uncertainty()})
    world = replace(world, stated=replace(world.stated, scenario=certain, kept={}))
    waiting, errors = iter(truths), spectrum_errors(world)
    while some := list(islice(waiting, _TOGETHER)):
        out: dict[int, PredictedProducts] = {}
        for index, e in evaluations(with_truths(world, some), errors):
            spectra = [spectral_prediction(e, u, None) for u in range(len(e))]
            found = detect(e, object_curves=object_curves, points=range(len(e)), spectra=spectra)
            for u, (number, prediction) in enumerate(zip(index.tolist(), found, strict=True)):
                if objects and prediction.roc:
                    scores = object_scores(e, np.array([u]), None if objects is True else objects)
                    prediction = replace(prediction, object_scores=scores)
                out[number] = prediction
        yield from (out[number] for number in range(len(some)))


def _prediction(
    world: World, of_spectra: SpectralErrors, errors: Mapping[str, Array], inputs: Sequence[UncertainInput],
    objects: bool | int, object_curves: bool, origins: Origins, truth: Truth,
) -> tuple[PredictedProducts, dict[RocKey, Changes]]:  # fmt: skip
    """One truth, and the changes of probit P_D by one standard uncertainty up and down, for each direction of each
    input; of the targets' field spectra for the one that their filter looks along.
    """
    stated = world.stated
    light = [i for i in inputs if i.of_light and i.kind != "engine"]
    # Errors of the engine go by the ground, which the empirical line takes off; a target's spectrum by its filter.
    others = [i for i in inputs if not i.of_light and (i.subject in stated.classes or i.kind != "surface")]
    others.sort(key=lambda i: not i.subject)
    of_light, of_others = ([(i, k) for i in some for k in range(i.size)] for some in (light, others))
    along = [None] if any(t.name in errors for t in stated.targets) else []
    moves, pairs = [*of_light, *along, *of_others], len(of_light)
    signed = [(move, z) for z in (1.0, -1.0) for move in moves]
    truths = [{}, *({} if move is None else move[0].direction(move[1], z) for move, z in signed)]
    every = with_truths(world, truths)
    parts = evaluations(every, errors, np.array([0.0, *(z * (move is None) for move, z in signed)]))
    e = parts[0][1]
    prediction = detect(e, object_curves=object_curves, spectra=[spectral_prediction(e, 0, of_spectra)])[0]
    for _, part in parts[1:]:
        detect(part, object_curves=object_curves)
    if prediction.roc:
        if objects:
            steps = np.array([0, *range(1, pairs + 1), *range(len(moves) + 1, len(moves) + pairs + 1)])
            here = Evaluation(every.rows(steps), errors)
            scores = object_scores(here, np.arange(steps.size), None if objects is True else objects)
            prediction = replace(prediction, object_scores=scores, expected_scores=expected_scores(here))
        prediction = with_law_errors(prediction, e, origins, truth)
    z = joined(((index, {key: probit(pd) for key, pd in part.curves.items()}) for index, part in parts), every.size)
    up, down = slice(1, len(moves) + 1), slice(len(moves) + 1, None)
    return prediction, {key: (x[up] - x[0], x[down] - x[0]) for key, x in z.items()}


def _distribution(world: World, number: int) -> PixelDistribution:
    """How the pixels of a class are distributed about their mean."""
    stated = world.stated
    name, tail = stated.classes[number], float(world.column("tail")[0, number])
    parts = stated.surfaces[name].components
    if parts is None:
        return PixelDistribution(tail)
    stretch = world.stretch[0, world.surface(name)]
    own = parts.stretched(stretch * math.sqrt(float(world.column("class_gain")[0, number])))
    dof = [float(world.law_dof[0, j]) for j, law in enumerate(stated.laws) if law.owner == number]
    clusters = zip(own.weights.tolist(), own.offsets, own.covariances, dof, strict=True)
    return PixelDistribution(tail, clusters=tuple(clusters))

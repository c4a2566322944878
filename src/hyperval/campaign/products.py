"""Both sides of a campaign: its collection, observed once, and the predictions of its scenarios.

Scenarios take from the collection what they leave open, such as class fractions and fill fractions; where its header,
map or truth contradicts a scenario, a warning says so.  Either side can be made again with something changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from rasterio.crs import CRS
from rasterio.warp import transform as reproject

from hyperval import model, observe
from hyperval.atmosphere.solar import parse_utc
from hyperval.attribute import ScenarioModel, Truths, exchanged_pairs, few_objects, scale_warnings, substitutions
from hyperval.campaign.schema import Campaign, Job, load_scenarios
from hyperval.collection import Detection
from hyperval.compare import compare_products, judge_rows, mark_fitted, would_decide
from hyperval.compare.spectra import MIN_OF_NOISE, snr_beside_texture
from hyperval.config import twice
from hyperval.data import NUMERICAL_DETECTORS, Mask
from hyperval.datasets import InputLog
from hyperval.errors import UsageError, needed, one_of, refuse
from hyperval.imagery import TargetObject, sun_zenith_deg, time_notes
from hyperval.pixels import average_roc, compact_parts, with_shared_pixels
from hyperval.products import Abundance, ExceedanceCurve, PredictedProducts, Products, ScoreDistribution
from hyperval.progress import bars
from hyperval.results import Outcome, Result
from hyperval.scenario import BackgroundClass, Fill, Scenario
from hyperval.settings import with_settings
from hyperval.storage import scratch_folder


def completed_scenario(scenario: Scenario, place: observe.Place | None, detection: Detection | None) -> Scenario:
    """The scenario with what it leaves to the collection; as it is where everything is stated.

    ``scene.fractions: measured``: a class counts the pixels of the region of its name, else of the one that its
    statistics come from; targets, their guard and what the collection leaves out do not count.  ``fill: {truth:
    true}``: the fills of the objects of the same subject.

    Raises
    ------
    UsageError : no image, a class without a region, or no pixel in any; a subject whose objects the truth does not
        know, or not by the fill of their pixels.
    """
    settings: dict[str, Any] = {}
    if scenario.scene.fractions != "stated":
        place = needed(place, "fractions.image", name=scenario.name)
        counts = {c.name: int(place.pixels_of(_region_of(c, place)).sum()) for c in scenario.scene.classes}
        refuse(not any(counts.values()), "fractions.none", name=scenario.name)
        settings = {f"scene.classes.[{name}].fraction": n / sum(counts.values()) for name, n in counts.items()}
    asked = {
        f"scene.targets.[{t.name}]{f'.subjects.[{p.name}]' * bool(t.subjects)}.fill": p.name
        for t in scenario.scene.targets
        for p in t.populations
        if p.fill.truth is not None
    }
    fills = observe.subject_fills(_objects(place, detection)) if asked else {}
    for path, name in asked.items():
        offered = one_of(fills, "targets from a finer image or from abundances")
        refuse(name not in fills, "fractions.fill", name=name, there=offered)
        settings[path] = {"listed": fills[name]}
    return with_settings(scenario, settings) if settings else scenario


def _region_of(surface: BackgroundClass, place: observe.Place) -> str:
    spread = surface.covariance.measured if surface.covariance is not None else None
    names = (name for name in (surface.name, surface.spectrum.measured, spread) if name in place.regions)
    regions = one_of(place.regions, "a region of its name")
    return str(needed(next(names, None), "fractions.region", name=surface.name, regions=regions))


def _objects(place: observe.Place | None, detection: Detection | None) -> dict[str, list[TargetObject]]:
    """The objects of the truth by the subject that they are counted with."""
    groups: dict[str, list[TargetObject]] = {}
    if place is not None and detection is not None:
        for target in detection.targets:
            groups |= observe.target_groups(place.targets, target, detection.group)
    return groups


# A flight line is seldom longer; over this distance the sun's zenith angle changes by a tenth of a degree.
MAX_KM = 10.0
MAX_SUN_DEG = 1.0  # a path of 1 % more or less at a zenith angle of 30 degrees
_KM_PER_DEGREE = 111.2
# Half a pixel of three is common where targets lie at random on the grid; a factor of 1.5 is another footprint.
MAX_PIXEL_RATIO = 1.5
MAX_LENGTH_RATIO = 1.05


def contradictions(side: ObservedCampaign, prediction: Products | None, rows: Sequence[Result]) -> Iterator[str]:
    """Warnings where cube and truth say otherwise than a scenario: of time, place and sun, and of its targets.

    A prediction of 12 pixels for each object, beside a truth that scores 3, is of another population: its P_D by
    pixel is too low and that by object too high, and nothing else in the table would say why.
    """
    place = side.observed.place
    if place is None:
        return
    yield from scale_warnings(rows)
    where, sun, truth = cube_centre(place), sun_zenith_deg(place.cube.raster), _objects(place, side.campaign.detection)
    for scenario in side.scenarios:
        yield from _model_warnings(side, scenario) if prediction is not None else ()
        yield from _fraction_warnings(side.campaign.detection, place, scenario)
        named, state = f"scenario {scenario.name!r}", scenario.atmosphere
        if state is not None and state.time_utc is not None:
            yield from time_notes(place.cube.raster.description.entries, parse_utc(str(state.time_utc)), scenario.name)
        if state is not None and sun is not None and abs(sun[0] - state.sun[0]) > MAX_SUN_DEG:
            angles = f"at a zenith angle of {sun[0]:.2f} degrees in {sun[1]}, at {state.sun[0]:.2f} in {named}"
            yield f"warning: the sun is {angles}"
        latitude, longitude = (state.latitude_deg, state.longitude_deg) if state is not None else (None, None)
        if where is not None and latitude is not None and longitude is not None:
            north, east = where[0] - latitude, (where[1] - longitude + 180.0) % 360.0 - 180.0  # on a sphere
            km = _KM_PER_DEGREE * math.hypot(north, east * math.cos(math.radians(0.5 * (where[0] + latitude))))
            lies = f"at latitude {where[0]:.3f}, longitude {where[1]:.3f}, {km:.0f} km from the place of {named}"
            yield from [f"warning: the cube lies {lies} ({latitude:g}, {longitude:g})"] if km > MAX_KM else []
        for population in (p for item in scenario.scene.targets for p in item.populations):
            if differences := ", ".join(_object_differences(place, population.fill, truth.get(population.name, ()))):
                yield f"warning: {population.name!r} of {named}: {differences}"


MIN_APART = 0.01  # of the greatest reflectance: spectra that lie nearer are of one surface


ALL_OF_IT = 0.95  # of the background: regions that hold less of it do not tell what it is made of
MAX_FRACTION = 0.02  # by which P_FA at 0.1 is some 3 % off where classes differ much


def _fraction_warnings(detection: Detection | None, place: observe.Place, scenario: Scenario) -> Iterator[str]:
    """A warning where the pixels that false alarms are counted on are another mixture of classes than is stated.

    >>> from types import SimpleNamespace as Of
    >>> at = {"scene": np.arange(10) > 1, "field": np.arange(10) > 4, "court": np.arange(10) < 5}
    >>> place = Of(regions=at, pixels_of=lambda name: at[name])
    >>> where = {"spectrum": Of(measured=None), "covariance": None, "fraction": 0.5}
    >>> classes = [Of(name="field", **where), Of(name="lawn", **where | {"spectrum": Of(measured="court")})]
    >>> stated = Of(name="x", scene=Of(fractions="stated", classes=classes))
    >>> next(_fraction_warnings(Of(false_alarms=["scene"]), place, stated))[9:84]
    "'field' is 0.625 of the pixels that false alarms are counted on (no target,"
    """
    classes, regions = scenario.scene.classes, list[str]()
    with suppress(UsageError):  # of a class without a region
        regions = [_region_of(c, place) for c in classes]
    if detection is None or scenario.scene.fractions != "stated" or not regions:
        return
    counted = place.pixels_of(*detection.false_alarms)
    shares = [float(np.mean(place.pixels_of(name)[counted])) for name in regions] if counted.any() else []
    if sum(shares) < ALL_OF_IT:
        return
    share, one = max(zip(shares, classes, strict=True), key=lambda item: abs(item[0] - item[1].fraction))
    if abs(share - one.fraction) > MAX_FRACTION:
        where = "of the pixels that false alarms are counted on (no target, guard or region that is left out)"
        stated = f"{one.fraction:.3g} of the scene in {scenario.name!r}: state that, or scene.fractions: measured"
        yield f"warning: {one.name!r} is {share:.3g} {where}, and {stated}"


def _model_warnings(side: ObservedCampaign, scenario: Scenario) -> Iterator[str]:
    """Warnings where bands of the image are not as wide as the sensor's, or its filters look for another spectrum."""
    detected, detection, place = side.observed.detected, side.campaign.detection, side.observed.place
    stated, axis = model.read_world(scenario, side.origins(scenario)).stated, side.observed.observation.axis
    sensor_axis = stated.sensor.axis if stated.sensor is not None else axis
    times = float(np.median(axis.fwhm_nm / np.interp(axis.centre_nm, sensor_axis.centre_nm, sensor_axis.fwhm_nm)))
    if max(times, 1.0 / times) > 1.2:  # as much more of the signal
        yield f"warning: bands of the image are {times:.2g} times as wide as those of the sensor (collection.bands)"
    if detected is None or detection is None or place is None:
        return
    for target in detection.targets:
        forms = (detected.bank.forms[observe.map_name(target.name, name)][1] for name in detection.detectors)
        for spectrum in [one for one in forms if one is not None][:1]:  # the same for each detector that has one
            subjects = observe.target_groups(place.targets, target, detection.group)
            for name in dict.fromkeys(stated.targets[t].name for t, _, p in stated.populations if p.name in subjects):
                gap = float(np.abs(stated.signatures[name][detected.bank.bands] - spectrum).max())
                if gap > MIN_APART * np.abs(spectrum).max():
                    words = f"in the image than in the model of {name!r}, up to {gap:.2g} apart"
                    yield f"warning: filters of {target.name!r} look for another spectrum {words} (filter_spectrum)"


def cube_centre(place: observe.Place) -> tuple[float, float] | None:
    """Latitude and longitude of the middle of the cube [degrees], by its map or its table; None without."""
    raster, table = place.cube.raster, place.table
    of_map = raster.transform and raster.transform @ (raster.samples / 2.0, raster.lines / 2.0)
    crs, middle = (table.crs, table.middle) if table is not None else (raster.crs, of_map)
    if crs is None or middle is None:
        return None
    longitude, latitude = (x[0] for x in reproject(crs, CRS.from_epsg(4326), *([x] for x in middle))[:2])
    return (latitude, longitude) if math.isfinite(latitude) and math.isfinite(longitude) else None


def _object_differences(place: observe.Place, fill: Fill, members: Sequence[TargetObject]) -> Iterator[str]:
    """How a scenario's objects differ from those of the truth, in pixels on average over their places on the grid."""
    geometry = fill.geometry
    if geometry is None or not members:
        return
    is_touched = geometry.pixels == "touched"
    stated = float(np.mean(model.touched_counts(geometry)) if is_touched else model.object_pixel_count(fill))
    counted = float(np.mean([np.count_nonzero(observe.scored_part(o, place).part) for o in members]))
    pixel_m, sides_m = math.sqrt(place.pixel_area_m2 or 0.0), [o.side_m for o in members if math.isfinite(o.side_m)]
    side_m = float(np.mean(sides_m)) if sides_m else None
    for words, value, other, most in (
        ("the prediction counts {:.3g} pixels for each object, the truth {:.3g}", stated, counted, MAX_PIXEL_RATIO),
        ("its pixels are {:g} m wide (gsd_m), those of the image {:.3g} m", geometry.gsd_m, pixel_m, MAX_LENGTH_RATIO),
        ("its sides are {:g} m (side_m), those of the truth {:.3g} m", geometry.side_m, side_m, MAX_LENGTH_RATIO),
    ):
        if value and other and max(value / other, other / value) > most:
            yield words.format(value, other)


@dataclass(frozen=True)
class ObservedCampaign:
    """A campaign and what its collection says, while the files, simulated ones too, are there."""

    campaign: Campaign
    inputs: InputLog
    scenarios: Sequence[Scenario]
    observed: observe.Observed
    seed: int | None
    read: model.Read = field(default_factory=dict)  # what scenarios read is kept here

    def origins(self, scenario: Scenario) -> model.Origins:
        """What the prediction of a scenario takes from the collection: bands, measured statistics, files."""
        return model.Origins(
            self.observed.observation.axis, self._laws.statistics(scenario),
            partial(self.inputs.resolve, base=scenario.folder),  # references of a scenario are relative to its own file
            left_out=lambda: self._laws.jackknife_replicates(scenario), read=self.read,
        )  # fmt: skip

    @cached_property
    def _laws(self) -> observe.RegionLaws:
        return observe.RegionLaws(self.observed)

    def with_shared_pixels(self, key: tuple[str, str], law: ExceedanceCurve) -> ExceedanceCurve:
        """A predicted curve of (target, detector) with what its law shares with the false alarms that are counted."""
        detected, place, detection = self.observed.detected, self.observed.place, self.campaign.detection
        if not law.left_out or detected is None or place is None or detection is None:
            return law
        scores = detected.score_maps[observe.map_name(*key)]
        counted = place.pixels_of(*detection.false_alarms) & np.isfinite(scores)
        number, first = np.full(scores.shape, -1), 0
        for region, without in law.left_out.items():
            parts = self._laws.parts(region)
            number = np.where(counted & (number < 0) & (parts >= 0), parts + first, number)
            first += len(without)
        background = counted & (number < 0)
        number[background] = first + compact_parts(*np.nonzero(background))
        return with_shared_pixels(law, scores, number)

    def with_shared_count(self, score: ScoreDistribution) -> ScoreDistribution:
        """Predicted scores with how many pixels of their classes are among those that false alarms are counted on."""
        place, detection = self.observed.place, self.campaign.detection
        if not score.n or place is None or detection is None:
            return score
        surfaces = (c.spectrum.measured for scenario in self.scenarios for c in scenario.scene.classes)
        measured = place.pixels_of(*(region for region in surfaces if region))
        return replace(score, shared=int(np.count_nonzero(measured & place.pixels_of(*detection.false_alarms))))


@contextmanager
def observe_campaign(
    job: Job, *, question: Callable[[Sequence[Scenario], InputLog], Campaign] | None = None
) -> Iterator[ObservedCampaign]:
    """Read the scenarios of a campaign, simulate its collection where it is simulated, and observe it once.

    Parameters
    ----------
    question : the campaign to observe in place of the job's, once its files are there

    Raises
    ------
    MissingDataError : files of a registered data set that are not on this machine.
    HypervalError : anything else that the user can mend.
    """
    campaign, inputs = job.campaign, InputLog.of_file(job.path)
    with ExitStack() as stack:
        read = partial(load_scenarios, resolve=inputs.resolve, base=inputs.base, words=job.words)
        scenarios = [one for source in campaign.scenarios for one, *_ in read(source)]
        seed = None
        if campaign.collection.simulate:
            from hyperval.simulate import load_inputs, load_scene, simulate

            path = inputs.resolve(campaign.collection.simulate)
            scene, scratch = load_scene(path), stack.enter_context(scratch_folder("simulated"))
            simulate(scene, scratch, inputs=load_inputs(scene, path.parent))
            inputs.simulated, seed = scratch, scene.seed
        if question is not None:
            campaign = question(scenarios, inputs)
        settings = campaign.collection, campaign.detection, inputs.resolve
        observed = observe.observe(*settings, classification=campaign.classification)
        for path in observed.place.source_files if observed.place is not None else ():  # such as a cube's header
            inputs.add(path)
        scenarios = [completed_scenario(scenario, observed.place, campaign.detection) for scenario in scenarios]
        yield ObservedCampaign(campaign, inputs, scenarios, observed, seed)


def predicted_side(
    side: ObservedCampaign, predictions: Sequence[PredictedProducts], truths: Sequence[model.Truth] | None = None
) -> PredictedProducts:
    """The predicted side: the predictions, and those that depend on the settings of the campaign.

    The latter are the errors of its classifier and the areas by its unmixing.

    Parameters
    ----------
    truths : what is moved in each scenario, as in the predictions; None: nothing
    """
    observed, detection, task = side.observed, side.campaign.detection, side.campaign.classification
    nominal = observed.detected.nominal_area_m2 if observed.detected is not None else {}
    areas = {k: Abundance(v, 0.0, modelled=False) for k, v in nominal.items()}
    if (unmixed := observed.unmixed) and detection and (unmixing := detection.unmixing):
        truths = truths or [{} for _ in side.scenarios]
        for scenario, prediction, truth in zip(side.scenarios, predictions, truths, strict=True):
            inputs = scenario, side.origins(scenario), truth, prediction
            areas |= model.predicted_areas(*inputs, unmixed, seed=unmixing.seed)
    joined = joined_prediction(side, side.scenarios, predictions)
    errors = joined.classification
    if task is not None:
        quantity = str(observed.observation.provenance.get("quantity", "radiance"))
        training = observe.training_pixels(task, observed.observation.distribution, observed.masks)
        sides = merged_predictions(predictions), observe.class_sets(task), task.features
        errors = model.predicted_classification(*sides, quantity, task.seed, training)
    shared = {key: side.with_shared_pixels(key, law) for key, law in joined.exceedance.items()}
    scores = {key: side.with_shared_count(score) for key, score in joined.scores.items()}
    return replace(joined, classification=errors, scores=scores, exceedance=shared, abundance=areas)


def joined_prediction(
    side: ObservedCampaign, scenarios: Sequence[Scenario], predictions: Sequence[PredictedProducts]
) -> PredictedProducts:
    """The predictions of scenarios in one, without what came from its collection, and with the campaign's pools.

    Their curves are averaged as the collection counts its targets; a subject of which it has none that is whole does
    not count.

    >>> from types import SimpleNamespace as Of
    >>> from hyperval.products import RocCurve, SpectralAxis
    >>> fine, coarse = np.array([1e-4, 1e-3, 1e-2, 0.1, 1.0]), np.array([1e-3, 0.1, 1.0])
    >>> curves = {("a", "cem"): RocCurve(fine, *[fine**0.5] * 4), ("b", "cem"): RocCurve(coarse, *[coarse**0.2] * 4)}
    >>> drawn = {(*key, unit): curve for key, curve in curves.items() for unit in ("pixel", "object")}
    >>> named = [*drawn, *(("a+b", "cem", unit) for unit in ("pixel", "object"))]
    >>> roc = {key: Of(n_target={"a": 3}.get(key[0], 1)) for key in named}
    >>> del roc["b", "cem", "object"]
    >>> detection = Of(pools=[Of(name="a+b", subjects=["a", "b"])])
    >>> side = Of(observed=Of(observation=Of(roc=roc), place=None), campaign=Of(detection=detection))
    >>> joined = joined_prediction(side, [], [PredictedProducts(SpectralAxis([500.0], 10.0), roc=drawn)]).roc
    >>> [joined["a+b", "cem", unit].pd.round(3).tolist() for unit in ("pixel", "object")]
    [[0.087, 0.176, 0.395, 1.0], [0.01, 0.032, 0.1, 0.316, 1.0]]
    """
    whole = without_circular_spectra(merged_predictions(predictions), scenarios, side.observed.place)
    curves, observed, detection = dict(whole.roc), side.observed.observation.roc, side.campaign.detection
    for pool in detection.pools if detection is not None else ():
        for name, detector, unit in observed:
            keys = [key for subject in pool.subjects if (key := (subject, detector, unit)) in observed]
            if name == pool.name and all(key in whole.roc for key in keys):
                counts = [observed[key].n_target or 0 for key in keys]
                curves[name, detector, unit] = average_roc([whole.roc[key] for key in keys], counts)
    return replace(whole, roc=curves)


def merged_predictions(predictions: Sequence[PredictedProducts]) -> PredictedProducts:
    """One prediction out of several scenarios on the same axis; no subject may stand in two of them."""
    first, *rest = predictions
    if not rest:
        return first
    parts: dict[str, Any] = {}
    for name in (f.name for f in fields(first) if isinstance(getattr(first, f.name), Mapping)):
        parts[name] = {key: item for p in predictions for key, item in getattr(p, name).items()}
        double = twice(str(key) for p in predictions for key in getattr(p, name))
        refuse(double and name != "provenance", "scenarios.twice", name=name, keys=double)
    parts["provenance"] = {"scenarios": [dict(p.provenance) for p in predictions]}
    return replace(first, **parts, notes=tuple(dict.fromkeys(n for p in predictions for n in p.notes)))


def without_circular_spectra(
    prediction: PredictedProducts, scenarios: Sequence[Scenario], place: observe.Place | None = None
) -> PredictedProducts:
    """The prediction without what was measured in the collection it is compared with: that always agrees.

    A covariance that was measured on other pixels than those of its subject stays: one part of the scene predicts
    the other.  The pixels are those of ``place``; without it every measured covariance counts as the subject's own.
    """
    surfaces = [s for x in scenarios for s in (*x.scene.classes, *x.scene.panels, *x.scene.sites)]
    taken = {s.name for s in surfaces if s.spectrum.measured is not None}
    measured = [(s.name, s.covariance.measured) for s in surfaces if s.covariance and s.covariance.measured is not None]
    masks: Mapping[str, Mask] = place.regions if place is not None else {}
    spread = {s for s, region in measured if not {s, region} <= masks.keys() or np.any(masks[s] & masks[region])}
    radiance, reflectance = (
        {k: replace(v, pixel_covariance=None) if k in spread else v for k, v in spectra.items() if k not in taken}
        for spectra in (prediction.radiance, prediction.reflectance)
    )
    fitted = {c.name for x in scenarios for c in x.scene.classes if c.tail_dof == "measured"}
    tails = {k: v for k, v in prediction.distribution.items() if k not in fitted}
    why = f"not compared, as their statistics come from the collection itself: {', '.join(sorted(taken))}"
    notes = (*prediction.notes, *[why] * bool(taken))
    return replace(prediction, radiance=radiance, reflectance=reflectance, distribution=tails, notes=notes)


# Of a limit of a normalised difference: how far it may be off.
_STEP, _STEPS = 0.05, (-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0)
_MAX_TRIED = 18  # spectra in the place of those that detectors look for
_BANDS = ("windows", "good", "all")  # that detectors may be given
OBJECT_DRAWS = 1600  # of an object's score: the same each time, so that differences are free of their scatter


def outcomes(side: ObservedCampaign, prediction: PredictedProducts) -> list[Result]:
    """Every comparison of a campaign with its outcome.

    It needs no second look at the collection, so that it can be called for a prediction that was moved.

    Parameters
    ----------
    prediction : of :func:`predicted_side`
    """
    campaign, sides = side.campaign, (prediction, side.observed.observation)
    method = "+".join(sorted({s.atmosphere.engine for s in side.scenarios if s.atmosphere})) or "statistics"
    margin, fitted_on = campaign.equivalence_margin, campaign.fitted_on
    rows = compare_products(*sides, method=method, equivalence_margin=margin, fitted_on=fitted_on)
    pools = {pool.name: pool.subjects for pool in campaign.detection.pools} if campaign.detection else {}
    return mark_fitted(judge_rows(rows, campaign.comparisons), fitted_on, pools)


def undecided_criteria(side: ObservedCampaign, rows: Iterable[Result], predicted: Products) -> list[tuple[Result, str]]:
    """The inconclusive criteria, each with what would have to be known better, or counted, to decide it."""
    sides = predicted, side.observed.observation, side.campaign.fitted_on
    found = [(row, would_decide(row, *sides)) for row in rows if row.gates and row.outcome is Outcome.UNDECIDED]
    return [(row, words) for row, words in found if words]


@bars(False)
def undecided_criteria_of(job: Job) -> list[tuple[Result, str]]:
    """Those of a campaign whose collection takes no time to look at."""
    with observe_campaign(job) as side:
        prediction = predicted_side(side, [model.predict(s, side.origins(s)) for s in side.scenarios])
        return undecided_criteria(side, outcomes(side, prediction), prediction)


def attribution_model(side: ObservedCampaign, prediction: Products) -> ScenarioModel:
    """What attribution asks: the scenarios with something moved, and the collection, measured again.

    A signal-to-noise ratio that is in part texture is not asked about.
    """

    def valid_snr(products: Products) -> Products:
        kept = {s: e for s, e in products.snr.items() if np.median(snr_beside_texture(prediction, s)) >= MIN_OF_NOISE}
        return replace(products, snr=kept)

    observation = valid_snr(side.observed.observation)
    # Where every object is one pixel, the scores of pixels say the same.
    draws = OBJECT_DRAWS if any(few_objects(observation, *key) for key in observation.object_scores) else False

    def predict_truths(scenario: Scenario, truths: Truths, budgeted: bool) -> Iterator[PredictedProducts]:
        # Scores and false alarms of pixels and draws of objects are looked at, not curves of objects, and
        # not what takes draws of its own for each of a hundred truths.
        closed = [name for name in scenario.processing.detectors if name not in NUMERICAL_DETECTORS]
        processing = scenario.processing.model_copy(update={"detectors": closed})
        lighter = scenario.model_copy(update={"processing": processing}) if closed else scenario
        origins = replace(side.origins(scenario), emulated_steps=not budgeted)
        return model.predictions(lighter, truths, origins, objects=draws, object_curves=False)

    # Predicted once, however often nothing is moved in it; the scenario is kept, whose number another would get.
    as_stated: dict[int, tuple[Scenario, PredictedProducts]] = {}

    def predict_scenario(scenario: Scenario, truths: Truths, budgeted: bool) -> Iterator[PredictedProducts]:
        moved = predict_truths(scenario, [truth for truth in truths if truth], budgeted)
        for truth in truths:
            if not truth and id(scenario) not in as_stated:
                as_stated[id(scenario)] = scenario, next(predict_truths(scenario, [{}], True))
            yield next(moved) if truth else as_stated[id(scenario)][1]

    def predicted(scenarios: Sequence[Scenario], truths: Sequence[Truths], budgeted: bool) -> Iterator[Products]:
        sides = [predict_scenario(s, [truth[i] for truth in truths], budgeted) for i, s in enumerate(scenarios)]
        return (joined_prediction(side, scenarios, parts) for parts in zip(*sides, strict=True))

    def remeasure(changes: Mapping[str, Any], mistake: Mapping[str, Any]) -> Products:
        if "exchanged" in mistake and not side.observed.place:
            one, other = mistake["exchanged"]
            names, sites = {one: other, other: one}, side.campaign.collection.spectra
            swapped = [s.model_copy(update={"subject": names.get(s.subject, s.subject)}) for s in sites]
            changes = {"collection.spectra": swapped}
        changed = with_settings(side.campaign, changes)  # no residual is an area; of displaced regions spectra tell
        detection = None if mistake.get("regions") else changed.detection
        detection = detection and detection.model_copy(update={"unmixing": None, "areas": []})
        before = side.observed if changed.collection == side.campaign.collection else None
        if before is not None and before.place is not None and mistake:
            is_shifted = {"nm", "scale"} & set(mistake)  # regions by rule are then elsewhere too
            place = observe.open_place(changed.collection, side.inputs.resolve, mistake) if is_shifted else before.place
            sampling = {} if {"gain", "offset", "nm", "scale"} & mistake.keys() else before.sampling
            before = replace(before, place=place.with_injected_error(mistake), sampling=sampling)
        return valid_snr(observe.observe(changed.collection, detection, side.inputs.resolve, before=before).observation)

    looked_for = spectrum_entries(side.campaign.detection.targets if side.campaign.detection else ())
    worlds = [model.read_world(scenario, side.origins(scenario)) for scenario in side.scenarios]
    sides = observation, prediction
    return ScenarioModel(side.scenarios, worlds, predicted, *sides, remeasure, exchange_settings(side), looked_for)


def spectrum_entries(items: Iterable[Any], key: str = "name") -> dict[str, Any]:
    """The entry of each spectrum as in the file, by name or another ``key``."""
    return {getattr(one, key): one.spectrum.model_dump(exclude_none=True, exclude_defaults=True) for one in items}


def exchange_settings(side: ObservedCampaign) -> dict[str, tuple[Mapping[Any, Mapping[str, Any]], str]]:
    """What may be exchanged in a collection: the settings of each pair, and "".

    For a limit of a rule: the settings by number of steps, and the step.

    >>> from types import SimpleNamespace as Of
    >>> truth = Of(rasters=Of(materials={"red": "red.hdr", "green": "green.hdr", "blue": "blue.hdr"}))
    >>> detection = Of(background=["lawn"], bands="good", targets=[])
    >>> from hyperval.collection import PanelReference, RegionSource
    >>> lawn = {"name": "lawn", "normalized_difference": {"high_nm": (790, 880), "low_nm": (650, 680), "above": 0.6}}
    >>> drawn = [RegionSource.model_validate(lawn), RegionSource(name="all", whole_image=True)]
    >>> panels = [PanelReference(region=f"of {x}", spectrum={"constant": x}) for x in (0.1, 0.2)]
    >>> collection = Of(empirical_line=Of(panels=panels), targets=truth, regions=drawn)
    >>> campaign = Of(collection=collection, detection=detection)
    >>> found = exchange_settings(Of(campaign=campaign, scenarios=[], observed=Of(place=Of(regions=["lawn", "lot"]))))
    >>> pairs, _ = found["exchanged materials of the truth"]
    >>> len(pairs), list(pairs["red and blue"].items())[0]
    (3, ('collection.targets.rasters.materials.[red]', 'blue.hdr'))
    >>> (pair,) = found["exchanged panels of the empirical line"][0].values()
    >>> list(pair.items())[1]
    ('collection.empirical_line.panels.[of 0.2].spectrum', {'constant': 0.1})
    >>> found["pixels behind the filters"][0]["scene"], found["bands of the detectors"][0].keys()
    ({'detection.background': ['scene']}, dict_keys(['windows', 'all']))
    >>> limits, step = found["limit 0.6 of the normalised difference"]
    >>> step, limits[-2.0]
    ('0.05 of the index', {'collection.regions.[lawn].normalized_difference.above': 0.5})
    """
    collection, detection, place = side.campaign.collection, side.campaign.detection, side.observed.place
    line, rasters = collection.empirical_line, collection.targets and collection.targets.rasters
    panels = exchanged_pairs(spectrum_entries(line.panels if line else (), "region"))
    materials = exchanged_pairs(rasters.materials if rasters else {})
    of_model = spectrum_entries(target for scenario in side.scenarios for target in scenario.scene.targets)
    in_place = substitutions(spectrum_entries(detection.targets if detection else ()), of_model, "of the model")
    looked_for = in_place if len(in_place) <= _MAX_TRIED else {}
    background = detection.background if detection and place else []
    names = [name for name in (*place.regions, observe.SCENE) if [name] != background] if place and background else []
    steps: dict[float, dict[float, dict[str, float]]] = {}
    for region in collection.regions:
        rule = region.normalized_difference
        ends = rule.model_dump(include={"above", "below"}, exclude_defaults=True) if rule else {}
        for end, limit in ends.items():
            for z, changes in steps.setdefault(limit, {z: {} for z in _STEPS}).items():
                changes[f"collection.regions.[{region.name}].normalized_difference.{end}"] = limit + _STEP * z

    def settings_at(path: str, changes: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        return {words: {path.format(name): entry for name, entry in one.items()} for words, one in changes.items()}

    found = {
        "exchanged panels of the empirical line": settings_at("collection.empirical_line.panels.[{}].spectrum", panels),
        "exchanged materials of the truth": settings_at("collection.targets.rasters.materials.[{}]", materials),
        "spectrum that detectors look for": settings_at("detection.targets.[{}].spectrum", looked_for),
        "pixels behind the filters": {name: {"detection.background": [name]} for name in names},
        "bands of the detectors": {b: {"detection.bands": b} for b in _BANDS if detection and b != detection.bands},
    }
    words = f"{_STEP:g} of the index"
    limits = {f"limit {x:g} of the normalised difference": (steps[x], words) for x in sorted(steps)}
    return limits | {what: (settings, "") for what, settings in found.items()}

"""From a collection to its products: open, measure the pixels of every label in one pass, compensate, detect.

For a region's pixels also tails, the number of independent ones, the error of their mean and the mixtures of classes;
and the error of a classifier trained on some lines and tested on others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations
from typing import Any, Literal, cast

import numpy as np

from hyperval import pixels as px
from hyperval.collection import Classification, CollectionSection, Detection
from hyperval.data import Array, Components, Index, Mask, SampleStatistics, statistics_of
from hyperval.errors import UsageError, refusal, refuse, told_of
from hyperval.imagery import Cube, TargetObject, all_pixels
from hyperval.model import ClassLaw, UnmixedAreas, class_features, covariance_directions, feature_bands, measured_error
from hyperval.model.intervals import student_factor
from hyperval.observe import sites
from hyperval.observe.detect import BACKGROUND, Detected, detect, scored_part, target_groups, unmix
from hyperval.observe.open import IMAGE, Place, check_line_for_detection, open_place, said
from hyperval.paths import Resolve
from hyperval.pixels import EmpiricalLine, Labels
from hyperval.products import ClassificationError, EstimatedPart, ObservedProducts, PixelDistribution, SpectralEstimate
from hyperval.progress import track, watch_lines
from hyperval.scenario import BackgroundClass, Scenario
from hyperval.statistics_library import ClassStatistics

LINE = "empirical line"
CIRCULAR = "the empirical line goes through this panel whatever it reflects: no degree of freedom is left"
MAX_PIXELS = 20_000  # of a region, drawn at random, to bound memory
MAX_NUMBERS = 8_000_000  # pixels times bands held at once
MIN_PIXELS = 200
PIXELS_PER_BAND = 10  # with fewer, distances are taken in fewer components
COMPONENTS = 6  # leading ones whose correlation on the ground is measured
WINDOW, REACH, WINDOWS = 64, 24, 12  # [pixels]; windows of the image in which correlation is measured
QUANTILES = 160
MIN_FOR_CORRELATION = 50  # with fewer, a correlation on the ground is within chance
PIXELS_PER_FEATURE = 3  # with fewer for training, sampling dominates the classifier's error
_DRAWS_PER_WINDOW = 16  # pixels drawn for each window
_TAIL_SEED, _MEAN_SEED, _LAW_SEED = 31, 37, 41
MAX_FOR_SNR = 2_000_000  # pixels times bands of a region used for its SNR


@dataclass(frozen=True, eq=False)
class Observed:
    """An observation with intermediate results from the imagery.

    Attributes
    ----------
    observation : the products
    statistics : region -> mean and covariance in reflectance (after the empirical line), for scenarios that
        take measured statistics
    place : the opened collection with its empirical line, None where there is no cube
    masks, sampling : subject -> its pixels, the error of their mean in the cube's values
    detected : filters and score maps, None without detection
    unmixed : areas by unmixing with the inputs of their prediction, None where not asked for
    """

    observation: ObservedProducts
    statistics: Mapping[str, ClassStatistics] = field(default_factory=dict)
    place: Place | None = None
    masks: Labels = field(default_factory=lambda: Labels.from_masks((0, 0)))
    sampling: Mapping[str, EstimatedPart] = field(default_factory=dict)
    detected: Detected | None = None
    unmixed: UnmixedAreas | None = None


def observe(
    collection: CollectionSection,
    detection: Detection | None,
    resolve: Resolve,
    *,
    classification: Classification | None = None,
    before: Observed | None = None,
) -> Observed:
    """Measure what a collection holds.

    Parameters
    ----------
    collection, detection, classification : as in a campaign file; a simulated collection must have been
        written first and stands here as its cube
    resolve : turns a file reference into a path
    before : the same collection observed for another detection, whose results for unchanged regions are reused

    Raises
    ------
    InputError, MissingDataError : files that are missing or corrupt.
    UsageError : names and settings that do not fit.
    """
    if collection.radcalnet is not None:
        return Observed(sites.observe_radcalnet(collection.radcalnet, resolve))
    if collection.spectra:
        return Observed(sites.observe_spectra(collection, resolve))
    place = (before and before.place) or open_place(collection, resolve)
    cube = place.cube
    masks, populations = _region_labels(place, detection)
    earlier_sampling = {} if before is None else before.sampling
    tails = {} if before is None else before.observation.distribution
    unchanged = {n for n in earlier_sampling if before and n in masks and np.array_equal(before.masks[n], masks[n])}
    sites.refuse_saturated(collection.empirical_line, masks, place)
    watch = watch_lines("statistics", cube.bytes_per_line, cube.lines)
    needed = cube.axis.good | (detection is not None and detection.bands == "all")
    measured = px.region_statistics(cube, masks, needed, watch=watch)
    sampling = {
        n: earlier_sampling[n] if n in unchanged else _sampling_error(place, masks[n], measured[n])
        for n in track([*place.regions, *populations], "sampling")
    }
    place = replace(place, statistics=measured)
    place = replace(place, line=place.line or sites.empirical_line(collection.empirical_line, place, sampling, resolve))
    detected, unmixed = None, None
    if detection is not None:
        if detection.targets:  # anomalies are the same in radiance
            check_line_for_detection(place, collection)
        detected = detect(place, detection, resolve)
        if detection.unmixing is not None:
            unmixed = unmix(place, detection, detection.unmixing, detected.bank.bands, resolve)
    products: dict[str, Any] = _spectra(place, collection, sampling, resolve)
    products |= {kind: dict(entries) for kind, entries in detected.products.items()} if detected else {}
    if unmixed is not None:
        products["abundance"] |= unmixed.areas
    distribution = {name: d for name, d in tails.items() if name in unchanged}
    for name in track([n for n in place.regions if n not in unchanged], "tails"):
        tail = pixel_tails(place, masks[name], measured[name])
        distribution |= {} if tail is None else {name: tail}
    names, good = collection.snr_regions, cube.axis.good
    snr = {n: px.snr_decorrelated(_thinned_pixels(place, masks, n), sampling[n].covariance, good) for n in names}
    remark = said("classifiers", used=cube.axis.clear.sum(), bands=cube.bands)
    observation = ObservedProducts(
        axis=cube.axis,
        snr=snr,
        distribution=distribution,
        classification=class_errors(place, masks, classification) if classification else {},
        notes=_observation_notes(place, detection, detected, masks) + ((remark,) if classification else ()),
        provenance={"quantity": cube.quantity, "description": cube.description},
        **products,
    )
    classes = _class_statistics(place, detection, detected, distribution)
    return Observed(observation, classes, place, masks, sampling, detected, unmixed)


def _region_labels(place: Place, detection: Detection | None) -> tuple[Labels, list[str]]:
    """Every population whose statistics are needed, as one label image; and the subjects of targets among them.

    A target's subject has at least two pixels, for its mean spectrum.  Where several spectra stand for one material
    their subjects hold the same pixels, and the first one counts.
    """
    # All pixels of a region count where targets and guards would leave none.
    members = {n: place.counted(n) if place.counted(n).any() else pixels for n, pixels in place.regions.members.items()}
    members[px.SCENE] = place.counted(px.SCENE)
    populations: dict[str, Mask] = {}
    if detection is not None:
        members[BACKGROUND] = place.counted(*detection.background)
        by_material = {t.material: t for t in reversed(detection.targets)}
        for target in (t for t in detection.targets if by_material[t.material] is t):
            for subject, objects in target_groups(place.targets, target, detection.group).items():
                pixels = all_pixels([scored_part(item, place) for item in objects], place.cube.shape)
                if subject not in members and np.count_nonzero(pixels) > 1:
                    populations[subject] = pixels
    return Labels(place.labels.number, members).with_masks(populations.items()), list(populations)


def _sampling_error(place: Place, region: Mask, sample: SampleStatistics) -> EstimatedPart:
    """The error of a mean, with the rounding of values stored in steps."""
    sampling, cube = mean_error(place, region, sample), place.cube
    if cube.step is None or sample.n < 2:
        return sampling
    spread = np.sqrt(np.clip(np.diag(sample.covariance), 0.0, None))
    rounding = np.diag(sites.rounding_variance(cube.step, spread))
    return sampling.of_each(lambda c: c + rounding)


def _observation_notes(
    place: Place, detection: Detection | None, detected: Detected | None, masks: Mapping[str, Mask]
) -> tuple[str, ...]:
    """Notes on an observation."""
    axis, notes, measured = place.cube.axis, list(place.notes), place.statistics
    if not place.cube.axis.numbered:
        means = [measured[name].mean for name in place.regions or (px.SCENE,)]
        notes += sites.wavelength_notes(means, axis, reflectance=place.cube.quantity == "reflectance")
    if detection is not None:
        notes += _truth_warnings(place.targets, {target.material for target in detection.targets})
        # Populations of filter and false alarms that differ.
        filters, alarms = masks[BACKGROUND], place.pixels_of(*detection.false_alarms)
        if not np.array_equal(filters, alarms):
            names = {key: ", ".join(getattr(detection, key)) for key in ("background", "false_alarms")}
            notes.append(said("populations", filters=filters.sum(), alarms=alarms.sum(), **names))
        if IMAGE in detection.background:
            notes.append(said("image", within=(filters & place.near_targets).sum()))
    notes += [said("single", name=name) for name in place.regions if measured[name].n == 1]
    notes += [] if place.line is None else sites.line_notes(place.line, axis)
    return (*notes, *(detected.notes if detected else ()))


def _truth_warnings(objects: Sequence[TargetObject], materials: Set[str]) -> Iterator[str]:
    """Objects of the truth that no detector looks for, and those that it lists twice.

    >>> def target(name, material, line):
    ...     part = np.ones((1, 1), bool)
    ...     return TargetObject(name, material, 1.0, 1.0, (9, 9), (0, 0), part, None, {"name": name, "line": line})
    >>> listed = [("a", "red", "1"), ("b", "red", "1"), ("c", "Red", "2"), ("d", "blue", "3")]
    >>> for words in _truth_warnings([target(*entry) for entry in listed], {"red"}):
    ...     print(words)
    warning: 2 of 4 target objects are looked for by no detection target: Red, blue
    warning: 1 target objects are listed again, alike but for the name: each counts by itself
    """
    unsought = [item.material for item in objects if item.material not in materials]
    if unsought:
        prefix = "warning: " * bool({m.casefold() for m in unsought} & {m.casefold() for m in materials})
        names = ", ".join(dict.fromkeys(unsought))
        yield f"{prefix}{len(unsought)} of {len(objects)} target objects are looked for by no detection target: {names}"
    # All attributes of an object but its name, and its pixels.
    distinct = {(repr({**o.attributes, "name": o.material}), o.corner, o.part.tobytes()) for o in objects}
    if repeated := len(objects) - len(distinct):
        yield f"warning: {repeated} target objects are listed again, alike but for the name: each counts by itself"


def _spectra(
    place: Place, collection: CollectionSection, sampling: Mapping[str, EstimatedPart], resolve: Resolve
) -> dict[str, dict[str, SpectralEstimate]]:
    """Radiance, where the image holds it, and reflectance of every subject by its statistics and their error.

    The error of the empirical line is common to all pixels and correlated between bands.  A panel's reflectance is that
    of the line through the other panels, for an independent check.  Where they fix none, it is circular.
    """
    cube, line, stated = place.cube, place.line, collection.calibration
    if cube.quantity != "radiance" and line is None:
        return {"reflectance": {n: _estimate(cube, place.statistics[n], error, {}) for n, error in sampling.items()}}
    radiance, reflectance = dict[str, SpectralEstimate](), dict[str, SpectralEstimate]()
    relative = None if stated is None else sites.calibration_covariance(np.ones(cube.bands), cube.axis, stated, resolve)
    scale = None if relative is None else covariance_directions(relative)
    for name, error in sampling.items():
        sample = place.statistics[name]
        parts = {} if relative is None else {sites.CALIBRATION: relative * np.outer(sample.mean, sample.mean)}
        radiance[name] = _estimate(cube, sample, error, parts, scale=scale)
        if line is None:
            continue
        if (used := line.without_panel(name) if name in line.names else line) is None:
            errors = {LINE: line.error_covariance(sample.mean, own=name)}
            reflectance[name] = _estimate(cube, sample, None, errors, line, circular=CIRCULAR)
        else:
            errors, estimated = {LINE: used.error_covariance(sample.mean)}, used.estimated_parts(sample.mean)
            reflectance[name] = _estimate(cube, sample, error, errors, used, estimated, scale=used.scale_errors)
    return {"radiance": radiance if cube.quantity == "radiance" else {}, "reflectance": reflectance}


def _estimate(
    cube: Cube,
    sample: SampleStatistics,
    sampling: EstimatedPart | None,
    parts: Mapping[str, Array],
    line: EmpiricalLine | None = None,
    estimated: tuple[EstimatedPart, ...] = (),
    circular: str = "",
    scale: Array | None = None,
) -> SpectralEstimate:
    """A mean after the line, if any, with the error of its sampling and the other ``parts``.

    ``scale`` (K, B) : relative errors of differences of pixels, along independent directions
    """
    mean, gain = (sample.mean, np.ones(cube.bands)) if line is None else (line.reflectance(sample.mean), line.gain)
    gains, spread = np.outer(gain, gain), sample.n > 1
    if sampling is not None and spread:
        scaled = sampling.of_each(lambda c: c / gains)
        parts, estimated = {"sampling": scaled.covariance, **parts}, (scaled, *estimated)
    return sites.spectral_estimate(
        mean, parts, pixel_covariance=sample.covariance / gains if spread else None, n=sample.n,
        estimated=estimated, circular=circular, spread_errors=None if scale is None else np.stack([scale, 0.0 * scale]),
        rounding=None if cube.step is None else cube.step**2 / 12.0 / gain**2,
    )  # fmt: skip


def _thinned_pixels(place: Place, masks: Labels, name: str) -> Array:
    """Valid pixels (n, B) of a region, evenly thinned to bound memory."""
    region = masks[name] if name in masks else place.region(name)
    count = int(np.count_nonzero(region))
    step = -(-count // min(MAX_PIXELS, MAX_FOR_SNR // place.cube.bands))
    return place.cube.spectra(px.nth_pixels(region, np.arange(0, count, step)))


def _class_statistics(
    place: Place, detection: Detection | None, detected: Detected | None, distribution: Mapping[str, PixelDistribution]
) -> dict[str, ClassStatistics]:
    """Statistics of each region in reflectance; none where the image holds radiance without a line."""
    if place.cube.quantity == "radiance" and place.line is None:
        return {}
    classes = {}
    for name in place.regions:
        sample = place.statistics[name]
        if detection is not None and detected is not None and name in detection.background:
            # Model and image make their filters of the same covariance.
            sample = sample.shrunk(detected.bank.shrinkage, detected.bank.bands)
        mean, covariance = place.in_reflectance(sample)
        # A band without a gain has no reflectance; the detectors do not use it either.
        finite = np.isfinite(mean)
        mean, covariance = np.where(finite, mean, 0.0), np.where(np.outer(finite, finite), covariance, 0.0)
        # Tails of the leading components: over all bands noise dilutes those that make false alarms.
        tails = distribution.get(name, PixelDistribution(leading_tail_dof=np.inf))
        classes[name] = ClassStatistics(
            name, place.cube.axis, mean, (covariance + covariance.T) / 2.0, sample.n,
            f"{sample.n} pixels of region {name}",
            tails.leading_tail_dof if np.isfinite(tails.leading_tail_dof) else None, tail_scale=tails.leading_scale,
        )  # fmt: skip
    return classes


def pixel_tails(place: Place, region: Mask, statistics: SampleStatistics) -> PixelDistribution | None:
    """The tails of a region's pixels in the windows of the atmosphere; None with too few of them.

    Pixels are drawn at random (the seed is fixed), at most 20,000; correlation on the ground is measured in windows
    of the image, at lags of up to 24 pixels: along the leading components, and of the distances.

    Parameters
    ----------
    region : (lines, samples) the pixels that ``statistics`` were taken from, in the cube's values
    """
    n, axis = statistics.n, place.cube.axis
    variance = np.diag(statistics.covariance)
    bands = np.flatnonzero(place.cube.axis.clear & np.isfinite(variance) & (variance > 0))
    if n < MIN_PIXELS or bands.size < px.MIN_LEADING:
        return None
    rng = np.random.default_rng(_TAIL_SEED)
    mean, covariance = statistics.mean[bands], statistics.covariance[np.ix_(bands, bands)]
    eigen = px.EigenDirections.from_covariance(covariance)
    dimension = min(eigen.values.size, n // PIXELS_PER_BAND)
    vectors, values = eigen.vectors[:, :dimension], eigen.values[:dimension]
    leading, count = px.leading_count(values, float(np.trace(covariance))), min(COMPONENTS, dimension)

    def project(pixels: Array) -> Array:
        scores = (pixels - mean) @ vectors
        scores /= np.sqrt(values)
        # The logarithm keeps a few far pixels of heavy tails from dominating the correlation.
        log_distances = np.log([np.einsum("nk,nk->n", s, s) + 1e-12 for s in (scores, scores[:, :leading])])
        return np.concatenate([scores[:, :count].T, log_distances])

    def centred(projected: Array) -> Array:
        projected[count:] -= projected[count:].mean(axis=1, keepdims=True)
        return projected

    windows = _projected_windows(place, region, bands, rng, project, centred)
    reach = min(REACH, max(*region.shape) - 1)
    n_mean, n_variance = px.independent_pixels(windows, px.neighbour_shares(region, reach, rng), n, reach)
    lines, samples = px.drawn_pixels(region, max(min(MAX_PIXELS, MAX_NUMBERS // len(axis)), MIN_PIXELS), rng)
    order, dimensions = np.lexsort((samples, lines)), (dimension, leading)
    parts = [
        [px.squared_mahalanobis(pixels, mean, vectors[:, :k], values[:k]) for k in dimensions]
        for pixels, _ in place.valid_pixels(lines[order], samples[order], bands)
    ]
    distances = [np.concatenate(part) for part in zip(*parts, strict=True)]
    if distances[0].size < MIN_PIXELS:
        return None
    full, lead = (
        px.fit_tail_dof(d, k, estimated_on=n, independent=independent / n * d.size)
        for d, k, independent in zip(distances, dimensions, n_mean[count:], strict=True)
    )
    ordered = np.sort(px.left_out_distances(distances[1], n))[::-1]
    # At most 160 of them, closest together in the upper tail, with the share beyond each.
    rank = np.unique(np.round(np.geomspace(1, ordered.size, QUANTILES)).astype(int))
    return PixelDistribution(
        full.dof, full.lower, full.upper, full.normality_p_value, dimension, lead.dof, lead.lower, lead.upper,
        leading, full.n, n_variance[:count], ordered[rank - 1][::-1], (rank / (ordered.size + 1.0))[::-1],
        int(np.count_nonzero(region.any(axis=0))), leading_scale=lead.scale,
    )  # fmt: skip


def _projected_windows(
    place: Place,
    region: Mask,
    bands: Index | Mask,
    rng: np.random.Generator,
    project: Callable[[Array], Array],
    transform: Callable[[Array], Array] = lambda values: values,
) -> Iterator[tuple[Array, Mask]]:
    """(K, lines, samples) projections (K, n) by ``project`` of a region's valid pixels (n, b) in windows, and masks.

    It is 0 at the other pixels of the window.  A part of a window is in memory at a time: whole windows of all bands
    would be half of a run's memory.  Windows are those cells of a grid that hold pixels drawn at random: overlapping
    windows would count pairs of pixels several times, and so overestimate correlation.
    """
    count = int(np.count_nonzero(region))
    lines, samples = px.nth_pixels(region, rng.choice(count, min(_DRAWS_PER_WINDOW * WINDOWS, count), replace=False))
    corners = zip((lines // WINDOW * WINDOW).tolist(), (samples // WINDOW * WINDOW).tolist(), strict=True)
    for row, column in list(dict.fromkeys(corners))[:WINDOWS]:
        mask = region[row : row + WINDOW, column : column + WINDOW].copy()
        lines, samples = np.nonzero(mask)
        parts = [(project(pixels), valid) for pixels, valid in place.valid_pixels(lines + row, samples + column, bands)]
        mask[mask] = np.concatenate([valid for _, valid in parts])
        values = np.concatenate([values for values, _ in parts], axis=1)
        image = np.zeros((len(values), *mask.shape))
        image[:, mask] = transform(values) if mask.any() else values
        yield image, mask


def mean_error(place: Place, region: Mask, statistics: SampleStatistics) -> EstimatedPart:
    """Error covariance (B, B) of a region's mean, in the cube's values, with its degrees of freedom.

    Correlation on the ground is measured along the leading components, and the rest together, in windows of the
    image, at lags of up to 24 pixels; regions of fewer than 50 pixels count as independent ones.  Few independent
    pixels widen the error (:func:`~hyperval.pixels.small_sample_factor`, :func:`~hyperval.model.student_factor`).
    Fewer pixels than bands have the covariance of few common factors and independent bands
    (:func:`~hyperval.pixels.factor_covariance`).  The sample covariance and both without the widening, which tests
    make by their degrees of freedom, are given besides.
    """
    n, covariance = statistics.n, statistics.covariance
    variance = np.diag(covariance)
    valid = np.flatnonzero(np.isfinite(variance) & (variance > 0) & place.cube.axis.good)
    if valid.size == 0:
        return EstimatedPart(covariance / n, float(n - 1))
    sample = covariance[np.ix_(valid, valid)]
    structured, common, dof = px.factor_covariance(sample, n) if n <= valid.size else (sample, sample, float(n - 1))

    def full(part: Array) -> Array:
        expanded: Array = covariance * (np.trace(part) / np.trace(sample))  # bad bands too are correlated on the ground
        expanded[np.ix_(valid, valid)] = part
        return expanded

    if n < MIN_FOR_CORRELATION:
        model, factors = full(structured / n), full(common / n)
        return EstimatedPart(student_factor(n - 1) ** 2 * model, dof, model, covariance / n, n - 1.0, factors)
    mean, rng = statistics.mean[valid], np.random.default_rng(_MEAN_SEED)
    components = px.covariance_components(structured, rng)
    windows = _projected_windows(place, region, valid, rng, lambda pixels: components.scores(pixels - mean))
    reach = min(REACH, max(*region.shape) - 1)
    n_mean, n_variance = px.independent_pixels(windows, px.neighbour_shares(region, reach, rng), n, reach)
    mean_dof = float(np.median(n_variance)) - 1.0
    widened, model, variances, factors = (
        full(px.mean_error_covariance(c, components, n_effective))
        for c, n_effective in (
            (structured, n_mean / px.small_sample_factor(n_mean)), (structured, n_mean), (sample, n_mean),
            (common, n_mean),
        )
    )  # fmt: skip
    return EstimatedPart(widened, mean_dof * dof / (n - 1), model, variances, mean_dof, factors)


Key = tuple[str, int | Literal["auto"], bool]
Mixture = tuple[px.ClassMixture, Components | None]


class RegionLaws:
    """Mixtures of the regions of one collection, each fitted once, and their jackknife replicates."""

    def __init__(self, observed: Observed):
        # Without an image there are no statistics, and place is not used.
        self._place, self._masks = cast(Place, observed.place), observed.masks
        self._tails, self._statistics = observed.observation.distribution, observed.statistics
        self.parts, self._fitted, self._jackknifed = cache(self._parts), cache(self._fit), cache(self._jackknife)

    def _draw_pixels(self, region: str) -> tuple[Array, Index, Index, Index]:
        """The pixels of a region that its laws are fitted to, at most 20,000 drawn at random (seed fixed).

        Their reflectance (n, B), 0 in a band without a gain as in the statistics of the class; their lines and samples
        (n,); and the good bands in the windows of the atmosphere.
        """
        axis, rng = self._place.cube.axis, np.random.default_rng(_LAW_SEED)
        limit = max(min(MAX_PIXELS, MAX_NUMBERS // len(axis)), 2)
        lines, samples = px.drawn_pixels(self._masks[region], limit, rng)
        pixels, valid = self._place.pixel_values(lines, samples)
        finite = np.isfinite(pixels[valid]).all(axis=0)
        pixels = np.where(finite, pixels, 0.0)
        lead = np.flatnonzero(self._place.cube.axis.clear & finite)
        return pixels[valid], lines[valid], samples[valid], lead

    def _parts(self, region: str) -> Index:
        """(lines, samples) part of the image that a region's pixels are left out with; -1 of other pixels."""
        mask = self._masks[region]
        number = np.full(mask.shape, -1)
        number[mask] = px.compact_parts(*np.nonzero(mask))
        return number

    def statistics(self, scenario: Scenario) -> Mapping[str, ClassStatistics]:
        """The collection's statistics with the components that the classes of a scenario ask for.

        Raises
        ------
        UsageError : too few pixels or blocks of the image; two classes that ask one region for different ones.
        """
        statistics = dict(self._statistics)
        for region, (c, key) in self._mixture_keys(scenario).items():
            with told_of(f"mixture of class {c.name!r}, region {region!r}"):
                mixture = key and self._fitted(*key)
            if mixture is not None:
                statistics[region] = replace(statistics[region], components=mixture[1])
        return statistics

    def jackknife_replicates(self, scenario: Scenario) -> Iterator[tuple[str, list[ClassStatistics]]]:
        """(region, its statistics without each of its parts), for the regions that the classes take their law from.

        None of a region without pixels, or of fewer than two parts.
        """
        for region, (c, key) in self._mixture_keys(scenario).items():
            if replicates := self._jackknifed(region, key, c.tail_dof == "measured"):
                yield region, replicates

    def _jackknife(self, region: str, key: Key | None, tails: bool) -> list[ClassStatistics]:
        """The statistics of a region without each of its parts; ``tails``: with tails fitted to each."""
        replicates, mixture = [], key and self._fitted(*key)
        (pixels, lines, samples, lead), full = self._draw_pixels(region), self._statistics[region]
        part = self.parts(region)[lines, samples]
        for number, (mean, cov) in enumerate(px.moments_without_each(pixels, part)):
            dof, scale = full.tail_dof, full.tail_scale
            if tails and dof is not None:  # within the limits of the fit to all pixels
                remaining, tail = pixels[part != number][:, lead], self._tails[region]
                limits = tail.leading_lower, tail.leading_upper
                fit = px.fit_leading_tails(remaining, mean[lead], cov[np.ix_(lead, lead)], limits)
                dof, scale = fit.dof if np.isfinite(fit.dof) else None, fit.scale
            law = None if mixture is None else mixture[0].components_without(pixels, part, number)
            replicates.append(replace(full, mean=mean, covariance=cov, tail_dof=dof, tail_scale=scale, components=law))
        return replicates

    def _mixture_keys(self, scenario: Scenario) -> dict[str, tuple[BackgroundClass, Key | None]]:
        """Region -> the first class that takes its law from there, and the mixture that the classes ask for."""
        keys: dict[str, tuple[BackgroundClass, Key | None]] = {}
        for c in scenario.scene.classes:
            region = c.spectrum.measured if c.covariance is None else c.covariance.measured
            if region is None or region not in self._statistics:
                continue
            mixes = c.mixture if c.has_mixture else None
            key = None if mixes is None else (region, mixes, c.tail_dof is not None)
            earlier = keys.setdefault(region, (c, key))[1]
            if key is not None and earlier is None:
                keys[region] = (c, key)
            elif key is not None and earlier != key:
                raise UsageError(f"two classes ask for different components of region {region!r}")
        return keys

    def _fit(self, region: str, count: int | Literal["auto"], tails: bool) -> Mixture | None:
        """The mixture of a region; blocks for the choice of its number are those of false alarms: about 64."""
        (pixels, lines, samples, lead), place = self._draw_pixels(region), self._place
        side = px.block_side(int(np.count_nonzero(self._masks[region])))
        block = (lines // side) * (place.cube.samples // side + 1) + samples // side
        mixture = px.class_mixture(pixels, block, count, tails=tails, lead=lead, seed=_LAW_SEED)
        return None if mixture is None else (mixture, mixture.components(pixels))


def class_errors(place: Place, masks: Labels, task: Classification) -> dict[tuple[str, str], ClassificationError]:
    """Errors by (classes, features); classes joined by " / ".

    Blocks of whole lines are dealt out at random (the campaign's seed) to training and test.

    Raises
    ------
    UsageError : a region that is none, or one with too few pixels in either half.
    """
    halves = {n: _split(place, masks[n] if n in place.regions else place.pixels_of(n), n, task) for n in task.classes}
    errors = {}
    for chosen in class_sets(task):
        for choice in task.features:
            bands = feature_bands(place.cube.axis.centre_nm, place.cube.axis.clear, choice.bands_nm)
            trained = [statistics_of(halves[name][0][0][:, bands]) for name in chosen]
            laws = [ClassLaw(s.mean, s.covariance) for s in trained]
            psi = class_features(laws, choice.pca)
            for name, sample in zip(chosen, trained, strict=True):
                if sample.n < PIXELS_PER_FEATURE * psi.shape[0]:
                    raise refusal("classes.few", n=sample.n, name=name, features=psi.shape[0], least=PIXELS_PER_FEATURE)
            tested = [halves[name][1] for name in chosen]
            errors[" / ".join(chosen), choice.name] = measured_error(
                [law.project(psi) for law in laws],
                [pixels[:, bands] @ psi.T for pixels, _ in tested],
                [blocks for _, blocks in tested],
            )
    return errors


def class_sets(task: Classification) -> list[tuple[str, ...]]:
    """All classes together, and every pair of them where the campaign asks for pairs."""
    return [tuple(task.classes), *(combinations(task.classes, 2) if task.pairs and len(task.classes) > 2 else ())]


def training_pixels(task: Classification, laws: Mapping[str, PixelDistribution], masks: Labels) -> dict[str, float]:
    """Independent pixels that train each class: half of those of its region, at most as many as are taken.

    In a region too small for their number to be measured every pixel counts.

    >>> task = Classification(classes=["a", "b", "c"], features=[{"name": "all"}], pixels=500)
    >>> laws = {"a": PixelDistribution(effective_n=np.array([200.0, 600.0])), "b": PixelDistribution()}
    >>> training_pixels(task, laws, {"a": np.ones(9000), "b": np.ones(150), "c": np.ones(9000)})
    {'a': 150.0, 'b': 75.0, 'c': 500.0}
    """
    counts = {name: laws.get(name, PixelDistribution()).effective_n for name in task.classes}
    independent = {k: np.count_nonzero(masks[k]) if n is None else 1.0 / np.mean(1.0 / n) for k, n in counts.items()}
    return {name: min(0.5 * float(n), float(task.pixels)) for name, n in independent.items()}


def _split(place: Place, region: Mask, name: str, task: Classification) -> list[tuple[Array, Index]]:
    """Pixels (n, B) of a class that train, and those that test, each with the block of lines that it lies in."""
    lines, samples = np.nonzero(region)
    block = lines // task.block_lines
    blocks = np.unique(block)
    refuse(blocks.size < 2, "classes.block", name=name, block_lines=task.block_lines)
    # Half of the blocks that hold the class train.
    order = np.random.default_rng([task.seed, place.cube.lines]).permutation(-(-place.cube.lines // task.block_lines))
    shuffled = order[np.isin(order, blocks)]
    trains, parts = np.isin(block, shuffled[: shuffled.size // 2]), []
    for half in (np.flatnonzero(trains), np.flatnonzero(~trains)):
        thinned = half[:: max(-(-half.size // task.pixels), 1)]  # evenly thinned
        pixels, valid = place.cube.marked_pixels((lines[thinned], samples[thinned]))
        refuse(np.count_nonzero(valid) < 2, "features.pixels", name=name)
        parts.append((pixels[valid], block[thinned][valid]))
    return parts

"""Filters, scores and detection curves of one collection; anomalies where no target is looked for.

The filters of a collection: each detector and target on the background's statistics, in the bands they use.

The objects of the truth: which subject holds them, their curves, and their areas by the sum of their scores.

Areas of the target objects by unmixing their pixels: endmembers are the target and the background around it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hyperval.collection import Detection, DetectionTarget, UnmixedTarget, Unmixing
from hyperval.data import SampleStatistics, statistics_of
from hyperval.errors import InputError, UsageError
from hyperval.executors import single_blas_thread
from hyperval.imagery.regions import objects
from hyperval.imagery.truth import TargetMasks, TargetObject, all_pixels
from hyperval.model import Sources, UnmixedSubject, labelled
from hyperval.model.filters import PositiveDefinite, fully_constrained, own_mean_sampling, whitened
from hyperval.observe.place import IMAGE, SCENE, Place
from hyperval.pixels import (
    ANOMALY_DETECTORS,
    ANOMALY_LEVELS,
    FEWEST_FOR_A_CURVE,
    LEAST_EXPECTED_ALARMS,
    WITHOUT_COVARIANCE,
    AlarmBlocks,
    EmpiricalLine,
    LocalWindow,
    PixelDetector,
    Placed,
    PresetThresholds,
    Whitener,
    alarms_before_first,
    block_side,
    drawn_pixels,
    empirical_roc,
    exceedance_curve,
    footprint,
    footprint_maxima,
    footprint_sums,
    object_scores,
    pixel_detector,
    placed_with_halo,
    pooled_roc,
    preset_thresholds,
    score_cube,
    score_cube_locally,
    snr_from_moments,
    values_on,
    whitener_of,
    with_summary,
)
from hyperval.products import (
    ANOMALIES,
    Abundance,
    ExceedanceCurve,
    ObjectScores,
    RocCurve,
    ScoreDistribution,
    background_of,
)
from hyperval.progress import track, watch_lines
from hyperval.spectra.axis import SpectralAxis, in_window

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BACKGROUND = "detector background"
# Below this many pixels for each band a sample covariance is shrunk (Ledoit & Wolf 2004).
FEW_PIXELS_PER_BAND = 3


@dataclass(frozen=True, eq=False)
class FilterBank:
    """What scores the pixels.

    Attributes
    ----------
    detectors : by the names of the score maps
    forms : the same by the detector's name and the target's spectrum (F,), None for anomalies
    bands : (B,) those that the filters use, F of them
    whitener : of the background, where a detector needs it
    shrinkage : of the background's covariance, 0 where there were pixels enough
    background : mean (F,) and covariance that the filters are made of, None where no detector inverts one
    """

    detectors: Mapping[str, PixelDetector]
    forms: Mapping[str, tuple[str, Array | None]]
    bands: Mask
    whitener: Whitener | None
    shrinkage: float
    notes: tuple[str, ...]
    background: tuple[Array, PositiveDefinite] | None = None


def map_name(target: str, detector: str) -> str:
    """Name of the score map of a target; anomalies have one map for all targets."""
    return detector if detector in ANOMALY_DETECTORS else f"{target}-{detector}"


def filter_bank(
    place: Place,
    detection: Detection,
    measured: Mapping[str, SampleStatistics],
    elm: EmpiricalLine | None,
    spectra: Mapping[str, Array],
) -> FilterBank:
    """Every detector for every target.

    Parameters
    ----------
    measured : statistics of the regions and of :data:`BACKGROUND` in the cube's values
    spectra : (B,) reflectance by target

    Raises
    ------
    UsageError : names that no region has, a singular background, no band left.
    """
    background, shrinkage = measured[BACKGROUND], 0.0
    bands, left_out = usable_bands(detection, place.cube.axis, list(spectra.values()), elm, background)
    notes = [f"detectors use {int(bands.sum())} of {len(place.cube.axis)} bands", *left_out]
    if background.n < FEW_PIXELS_PER_BAND * int(bands.sum()):
        # Few, so they fit in memory; the pass has not summed the fourth moment.
        few = statistics_of(_complete(place.cube.pixels(place.background(detection.background))))
        background, shrinkage = replace(background, covariance=few.shrunk_covariance), few.shrinkage
        notes.append(f"{background.n} background pixels are few: covariance shrunk by {shrinkage:.3g}")
    mean, covariance = in_reflectance(background, elm)
    for name in detection.undesired:
        place.region(name)  # refuses a name that no region has
    undesired = np.array([in_reflectance(measured[name], elm)[0][bands] for name in detection.undesired])
    forms = {
        map_name(t.name, name): (name, None if name in ANOMALY_DETECTORS else spectra[t.name][bands])
        for t in detection.targets
        for name in detection.detectors
    } or {name: (name, None) for name in detection.detectors}  # anomalies need no target
    whitener = inverted = None
    with single_blas_thread():  # small matrices: more threads only wait for each other
        if not set(detection.detectors) <= set(WITHOUT_COVARIANCE):
            inverted = PositiveDefinite(covariance[np.ix_(bands, bands)])
            notes.append(f"condition number of the background matrix at unit diagonal: {inverted.condition:.3g}")
        detectors = {
            key: pixel_detector(name, spectrum, mean[bands], inverted, undesired)
            for key, (name, spectrum) in forms.items()
        }
        by_distance = any(d.quadratic == "distance" for d in detectors.values())
        if inverted is not None and (detection.local_window or by_distance):
            whitener = whitener_of(mean[bands], inverted)
    behind = None if inverted is None else (mean[bands], inverted)
    return FilterBank(detectors, forms, bands, whitener, shrinkage, tuple(notes), behind)


def in_reflectance(statistics: SampleStatistics, elm: EmpiricalLine | None) -> tuple[Array, Array]:
    """Mean (B,) and covariance (B, B) after the empirical line; as they stand without one."""
    if elm is None:
        return statistics.mean, statistics.covariance
    return elm.reflectance(statistics.mean), statistics.covariance / np.outer(elm.gain, elm.gain)


def _complete(pixels: Array) -> Array:
    """The pixels (n, B) that are finite in every band, as the statistics of regions take them."""
    return pixels[np.isfinite(pixels).all(axis=1)]


def _by_number(target: DetectionTarget, bands: int, resolve: Callable[[str], Path]) -> Array:
    """(B,) spectrum of a target where bands go by number: a text file with a row for each; its last number counts.

    Raises
    ------
    UsageError : a spectrum that is no file.
    InputError : a row without a number, or another number of rows.
    """
    if target.spectrum.file is None:
        raise UsageError(
            f"the spectrum of {target.name!r} goes by wavelength, the bands of the cube by number",
            expected="a text file with one row for each band",
        )
    path, values = resolve(target.spectrum.file), []
    for number, line in enumerate(path.read_text("utf-8", errors="replace").splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        try:
            values += [float(words[-1])] if words else []
        except ValueError as error:
            raise InputError(
                "not a row of numbers", where=f"{path}:{number}", expected="a number; a heading begins with #"
            ) from error
    if len(values) != bands or not np.all(np.isfinite(values)):
        raise InputError(f"{len(values)} values for {bands} bands", where=str(path), expected="one row a band")
    return np.array(values)


def usable_bands(
    detection: Detection,
    axis: SpectralAxis,
    spectra: Sequence[Array],
    elm: EmpiricalLine | None,
    background: SampleStatistics,
) -> tuple[Mask, list[str]]:
    """Bands (B,) that detectors use, and the others with the first rule that leaves them out, in words.

    Parameters
    ----------
    spectra : (B,) of the targets, NaN where they are not known
    background : in the cube's own values; its noise tells the SNR of a band

    Raises
    ------
    UsageError : no band is left.
    """
    left, parts = np.ones(len(axis), bool), []
    rules = {
        "bad in the band list": axis.good if detection.bands in ("good", "windows") else left,
        "in absorption bands": in_window(axis.centre_nm) if detection.bands == "windows" else left,
        "not in the target spectra": np.isfinite(spectra).all(axis=0) if len(spectra) else left,
        "without a gain of the empirical line": left if elm is None else elm.usable,
        f"with an SNR below {detection.least_snr or 0:g} in the background": None,
    }
    for reason, keep in rules.items():
        if keep is None:  # of the bands that are left
            keep = _clear(left, background, detection.least_snr)
        lost, left = np.flatnonzero(left & ~keep), left & keep
        if lost.size:
            runs = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
            ends = [sorted({f"{axis.centre_nm[r[0]]:.4g}", f"{axis.centre_nm[r[-1]]:.4g}"}, key=float) for r in runs]
            parts.append(f"{lost.size} {reason} ({', '.join('-'.join(e) for e in ends)} nm)")
    if not left.any():
        raise UsageError(
            f"no band is left for the detectors: {'; '.join(parts)}",
            mend="look at the bad-band list, the target spectra and detection.least_snr",
        )
    return left, [f"bands that the detectors do not use: {'; '.join(parts)}"] if parts else []


def _clear(left: Mask, background: SampleStatistics, least_snr: float | None) -> Mask:
    """(B,) where the SNR of the background, by the bands that are left, reaches what is asked for."""
    at, keep = np.flatnonzero(left), np.ones_like(left)
    if least_snr is not None and at.size >= 3:
        keep[at] = snr_from_moments(background.mean[at], background.covariance[np.ix_(at, at)]) >= least_snr
    return keep


# Names in braces are replaced as they stand: str.format would take widths that fill the memory.
_BRACES = re.compile(r"\{([^{}]*)\}")


Areas = dict[tuple[str, str], Abundance]
Nominal = dict[tuple[str, str], float]


def scored_pixels(target: TargetObject, place: Place) -> Placed:
    """The pixels of an object that are scored, in their window."""
    if place.target_pixels == "touched" or target.centre_pixel is None:
        return target.placed
    return target.centre_pixel, np.ones((1, 1), bool)


def target_groups(objects: Sequence[TargetObject], target: DetectionTarget, form: str) -> dict[str, list[TargetObject]]:
    """Objects of the target's material by subject name, in the order of the truth."""
    out: dict[str, list[TargetObject]] = {}
    for item in objects:
        if item.material != target.material:
            continue
        words = {"name": item.name, "material": item.material, **item.attributes, "target": target.name}
        subject = _subject(form, words)
        out.setdefault(subject, []).append(item)
    if not out:
        known = sorted({o.material for o in objects})
        raise UsageError(
            f"target {target.name!r}: the truth has no object of material {target.material!r}",
            expected="one of " + ", ".join(known) if known else "a truth with targets",
        )
    return out


def _subject(form: str, words: Mapping[str, str]) -> str:
    unknown = [word for word in _BRACES.findall(form) if word not in words]
    if unknown:
        raise UsageError(
            f"detection.group {form!r} does not fit the truth: no {unknown[0]!r}",
            expected="names in braces out of " + ", ".join(sorted(words)),
        )
    return _BRACES.sub(lambda match: words[match[1]], form)


def target_areas(place: Place, detection: Detection, maps: Mapping[str, Array]) -> tuple[Areas, Nominal]:
    """Sum of scores over each object times the pixel area, and the area that the truth states [m2].

    By subject and detector, for every check that is asked for.  The uncertainty is the spread of the same sum over
    background that has the object's footprint.  Both are means over the objects of a subject.
    """
    areas: Areas = {}
    nominal: Nominal = {}
    for check in detection.areas:
        if place.pixel_area_m2 is None:
            raise UsageError("areas need the ground area of a pixel; the cube is not georeferenced")
        target = next((t for t in detection.targets if t.name == check.target), None)
        if target is None or check.detector not in detection.detectors:
            raise UsageError(f"areas: no score map of target {check.target!r} with detector {check.detector!r}")
        sums = _FootprintSums(place, detection, maps[f"{check.target}-{check.detector}"], check.margin_pixels)
        for subject, members in target_groups(place.targets, target, detection.group).items():
            total, pixels, variance = (sum(part) for part in zip(*(sums.of(o) for o in members), strict=True))
            each = place.pixel_area_m2 / len(members)
            areas[subject, check.detector] = Abundance(total * each, float(np.sqrt(variance)) * each, int(pixels))
            stated = float(np.mean([o.area_m2 for o in members]))
            if np.isfinite(stated):  # a truth may say where the objects are and not how large
                nominal[subject, check.detector] = stated
    return areas, nominal


class _FootprintSums:
    """Sums of one score map over the footprints of objects, and over the background."""

    def __init__(self, place: Place, detection: Detection, scores: Array, margin: int) -> None:
        self._scores, self._margin = scores, margin
        self._targets = all_pixels(place.targets, place.cube.shape)
        # A background of "image" holds the targets too; their sums say nothing of the error.
        self._taken = ~(place.background(detection.background) & ~place.near_targets)
        self._spread: dict[tuple[tuple[int, ...], bytes], float] = {}  # variance of the sum, by shape of the footprint

    def of(self, item: TargetObject) -> tuple[float, int, float]:
        """Sum over an object with its margin, without the pixels of others; pixels, and variance of the sum."""
        corner, grown = placed_with_halo(item.placed, self._margin, self._scores.shape)
        summed = grown & (~_window(self._targets, corner, grown) | _window(item.mask, corner, grown))
        shape = footprint(summed)
        key = shape.shape, shape.tobytes()
        if key not in self._spread:
            elsewhere = footprint_sums(self._scores, shape, self._taken)
            self._spread[key] = float(np.var(elsewhere, ddof=1)) if elsewhere.size > 1 else float("nan")
        total = float(np.nansum(_window(self._scores, corner, grown)[summed]))
        return total, int(summed.sum()), self._spread[key]


def _window(image: npt.NDArray[Any], corner: tuple[int, int], like: Mask) -> npt.NDArray[Any]:
    """The part of an image under a window of the size of ``like``."""
    return image[corner[0] : corner[0] + like.shape[0], corner[1] : corner[1] + like.shape[1]]


Pixels = tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]  # lines and samples

METHODS = {"equal": "fcls", "background": "fcls-weighted"}
PLACES = 60  # of the background, at which the same sum is taken for its error


@dataclass(frozen=True, eq=False)
class Unmixed:
    """Areas by (subject, method), and what the prediction needs for each subject.

    ``bands`` (B,) were used; ``covariances``: method -> (F, F) weights of the fit, None for equal ones.
    """

    areas: Mapping[tuple[str, str], Abundance]
    subjects: tuple[UnmixedSubject, ...]
    bands: Mask
    covariances: Mapping[str, Array | None]
    pixel_area_m2: float
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True, eq=False)
class _ObjectSurroundings:
    """An object, and the places of the background at which its footprint was laid too.

    Attributes
    ----------
    pixels : (N, F) reflectance of the pixels of all footprints, the object's first
    place : (N,) footprint that each belongs to
    background : (P, F) mean reflectance around each footprint
    ring : pixels around the object
    """

    pixels: Array
    place: npt.NDArray[np.intp]
    background: Array
    ring: int


def unmix(
    place: Place,
    detection: Detection,
    measured: Mapping[str, SampleStatistics],
    elm: EmpiricalLine | None,
    bands: Mask,
    resolve: Callable[[str], Path],
    *,
    show_progress: bool | None = None,
) -> Unmixed:
    """Area of every target object from the sum of its abundances over the pixels that may hold a part of it.

    The uncertainty is the spread of the same sum over footprints laid at random on the background, which have
    their own surroundings as endmember: it holds the background's spread with its correlation on the ground.

    Raises
    ------
    UsageError : names that do not fit, or a cube without ground size of its pixels.
    InputError : an object without background around it.
    """
    task = detection.unmixing
    if task is None:
        raise UsageError("the detection has no 'unmixing'")
    if place.pixel_area_m2 is None:
        raise UsageError("unmixing: areas need the ground area of a pixel; the cube is not georeferenced")
    region = place.pixels_of(task.background)
    covariances: dict[str, Array | None] = {}
    for weights in task.weights:
        _, covariance = in_reflectance(measured[task.background], elm)
        covariances[METHODS[weights]] = None if weights == "equal" else covariance[np.ix_(bands, bands)]
    noise = {name: None if c is None else PositiveDefinite(c) for name, c in covariances.items()}
    chosen = [(item, _named(detection, item.target)) for item in task.targets]
    sources = Sources(place.cube.axis, {}, resolve)
    spectra = {t.name: sources.spectrum(t.spectrum, t.name).mean for _, t in chosen}
    rng = np.random.default_rng(task.seed)
    surroundings_of: dict[str, _ObjectSurroundings] = {}
    areas: dict[tuple[str, str], Abundance] = {}
    subjects: list[UnmixedSubject] = []
    work = [(item, target, *parts) for item, target in chosen for parts in _subjects(place, detection, item, target)]
    for item, target, subject, population, members in track(work, "unmixing", show=show_progress):
        nominal = float(np.mean([o.area_m2 for o in members]))
        if not np.isfinite(nominal):
            raise UsageError(
                f"the truth does not say how large the targets of {subject!r} are, which unmixing is compared with",
                where="detection.unmixing",
                mend="state side_m in collection.targets, or leave unmixing out",
            )
        for o in members:
            if o.name not in surroundings_of:
                surroundings_of[o.name] = _surroundings(place, o, region, task, elm, bands, rng)
        around = [surroundings_of[o.name] for o in members]
        spectrum = spectra[target.name][bands]
        for method, factor in noise.items():
            areas[subject, labelled(method, item.endmembers)] = _area(
                around, spectrum, factor, place.pixel_area_m2, nominal
            )
        subjects.append(
            UnmixedSubject(
                subject, population, item.scenario_target or item.target, spectra[target.name],
                item.relative_uncertainty, item.correlation_nm, item.endmembers, len(members), nominal,
                int(np.mean([s.ring for s in around])),
            )
        )  # fmt: skip
    return Unmixed(areas, tuple(subjects), bands, covariances, place.pixel_area_m2)


def _area(
    around: list[_ObjectSurroundings],
    spectrum: Array,
    noise: PositiveDefinite | None,
    pixel_area: float,
    nominal: float,
) -> Abundance:
    total, variance, n = 0.0, 0.0, 0
    for s in around:
        between = np.stack([np.broadcast_to(spectrum, s.background.shape), s.background], axis=1)
        parts = fully_constrained(whitened(s.pixels, noise), whitened(between, noise)[s.place])[:, 0]
        own, *elsewhere = np.bincount(s.place, parts, minlength=len(s.background)).tolist()
        total += own
        n += int(np.count_nonzero(s.place == 0))
        variance += float(np.var(elsewhere, ddof=1)) if len(elsewhere) > 1 else float("nan")
    count = len(around)
    return Abundance(total / count * pixel_area, float(np.sqrt(variance)) / count * pixel_area, n, nominal)


def _named(detection: Detection, name: str) -> DetectionTarget:
    for target in detection.targets:
        if target.name == name:
            return target
    raise UsageError(
        f"unmixing: no detection target {name!r}", expected="one of " + ", ".join(t.name for t in detection.targets)
    )


def _subjects(
    place: Place, detection: Detection, item: UnmixedTarget, target: DetectionTarget
) -> Iterator[tuple[str, str, list[TargetObject]]]:
    """Subject, the scenario's population that stands for it, and the objects."""
    stands = target.model_copy(update={"name": item.scenario_target or item.target})
    names = target_groups(place.targets, stands, detection.group)
    for (subject, members), population in zip(
        target_groups(place.targets, target, detection.group).items(), names, strict=True
    ):
        yield subject, population, members


def _surroundings(
    place: Place,
    target: TargetObject,
    region: Mask,
    task: Unmixing,
    elm: EmpiricalLine | None,
    bands: Mask,
    rng: np.random.Generator,
) -> _ObjectSurroundings:
    lines, samples = np.nonzero(target.part)
    corners = [target.corner, *_free_places(region, lines, samples, rng)]
    parts: list[Pixels] = []
    for line, sample in corners:
        own = lines + line, samples + sample
        parts += [own, _ring(own, region, task.ring_pixels)]
    read = _reflectance(place, parts, elm, bands)
    blocks = list(zip(read[::2], read[1::2], strict=True))
    ring = len(blocks[0][1])
    if not ring:
        raise InputError(
            f"target {target.name!r} has no pixel of {task.background!r} within {task.ring_pixels} pixels",
            expected="background around every target",
        )
    whole = [blocks[0], *((x, r) for x, r in blocks[1:] if len(r) and len(x) == lines.size)]
    pixels = np.concatenate([x for x, _ in whole])
    place_of = np.repeat(np.arange(len(whole)), [len(x) for x, _ in whole])
    return _ObjectSurroundings(pixels, place_of, np.array([r.mean(axis=0) for _, r in whole]), ring)


def _ring(own: Pixels, region: Mask, reach: int) -> Pixels:
    """The pixels of the region within ``reach`` pixels of some pixels, these left out."""
    first = np.maximum([own[0].min() - reach, own[1].min() - reach], 0)
    last = np.minimum([own[0].max() + reach + 1, own[1].max() + reach + 1], region.shape)
    inside = np.zeros(tuple(last - first), bool)
    inside[own[0] - first[0], own[1] - first[1]] = True
    near = ndimage.distance_transform_edt(~inside) <= reach
    lines, samples = np.nonzero(near & ~inside & region[first[0] : last[0], first[1] : last[1]])
    return lines + first[0], samples + first[1]


def _reflectance(place: Place, parts: list[Pixels], elm: EmpiricalLine | None, bands: Mask) -> list[Array]:
    """(n, F) reflectance of the valid ones among several sets of pixels, all read at once: each line once."""
    flat = [lines * place.cube.samples + samples for lines, samples in parts]
    every, index = np.unique(np.concatenate(flat), return_inverse=True)
    at = np.divmod(every, place.cube.samples)
    values, usable = place.pixels_at(*at, elm)
    reflectance = values[:, bands]
    valid = usable & np.isfinite(reflectance).all(axis=1)
    ends = np.cumsum([f.size for f in flat])[:-1]
    return [reflectance[i[valid[i]]] for i in np.split(index, ends)]


def _free_places(
    region: Mask, lines: npt.NDArray[np.intp], samples: npt.NDArray[np.intp], rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Places at random at which a footprint, given by its pixels, lies on the region as a whole."""
    height, width = int(lines.max()) + 1, int(samples.max()) + 1
    if height > region.shape[0] or width > region.shape[1]:
        return []
    free = np.ones((region.shape[0] - height + 1, region.shape[1] - width + 1), bool)
    for line, sample in zip(lines.tolist(), samples.tolist(), strict=True):
        free &= region[line : line + free.shape[0], sample : sample + free.shape[1]]
    places = np.argwhere(free)
    if not len(places):
        return []
    chosen = rng.choice(len(places), min(PLACES, len(places)), replace=False)
    return [(int(a), int(b)) for a, b in places[chosen]]


BY_PIXEL = "object-by-pixel"  # objects by their halos, alarms by pixel
_MOST_INFLUENCES = 4000  # pixels that tell how far the mean of all moves by chance: its error to 3 %
_MOST_SCORES = 500  # that a product keeps of one population: the exact ends of a curve


MOST_NAMED = 10


@dataclass(frozen=True, eq=False)
class Detected:
    """What the detectors found.

    Attributes
    ----------
    bank : the filters
    score_maps : "TARGET-DETECTOR" -> (lines, samples) score
    outlines : "TARGET-DETECTOR" -> mask of each object that was looked for
    products : scores, roc, abundance, object_scores and exceedance by their keys
    nominal_area_m2 : area of the targets as the truth states it, by the keys of "abundance"
    notes : what is to be said of it
    """

    bank: FilterBank
    score_maps: Mapping[str, Array]
    outlines: Mapping[str, Mapping[str, Mask]]
    products: Mapping[str, Mapping[Any, Any]]
    nominal_area_m2: Mapping[tuple[str, str], float]
    notes: tuple[str, ...] = ()


def detect(
    place: Place,
    detection: Detection,
    measured: Mapping[str, SampleStatistics],
    elm: EmpiricalLine | None,
    resolve: Callable[[str], Path],
    *,
    show_progress: bool | None = None,
) -> Detected:
    """Score the image with every detector and target, and count what is found.

    Parameters
    ----------
    measured : statistics of the regions and of the detectors' background in the cube's values

    Raises
    ------
    UsageError : names that do not fit, a singular background.
    InputError : target spectra or truth that are missing.
    """
    axis = place.cube.axis
    if place.by_number:
        spectra = {t.name: _by_number(t, len(axis), resolve) for t in detection.targets}
    else:
        sources = Sources(axis, {}, resolve)
        spectra = {t.name: sources.spectrum(t.spectrum, t.name).mean for t in detection.targets}
    bank = filter_bank(place, detection, measured, elm, spectra)
    maps, remarks = _score_maps(place, detection, bank, elm, show_progress)
    found = _Curves(place, detection, maps, bank, elm)
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        for detector in detection.detectors:
            found.add(target, detector, groups)
    for name, scores in maps.items() if not detection.targets else ():
        noise = found.background(scores, ANOMALIES, name)
        found.scores[background_of(ANOMALIES), name] = _moments(noise.scores)
        remarks.append(anomaly_note(place, name, scores, found.alarms))
    found.add_pools()
    if detection.halo_pixels:
        remarks.append(
            f"curves '{BY_PIXEL}' count every pixel as a false alarm and give an object the best of its halo, as "
            "MUUFL's scoring does: they favour detection, those 'object' do not"
        )
    if detection.first_detection:
        remarks.append(
            "alarms_before_first counts false alarms up to the best pixel of any object, as RIT's self-test does: "
            "it favours targets of many pixels or pieces, of which the luckiest stands for all"
        )
    areas, nominal = target_areas(place, detection, maps)
    products: dict[str, Mapping[Any, Any]] = {
        "scores": found.scores, "roc": found.roc, "abundance": areas, "object_scores": found.of_objects,
        "exceedance": found.exceedance,
    }  # fmt: skip
    outlines = {key: TargetMasks(list(objects.values())) for key, objects in found.outlined.items()}
    return Detected(bank, maps, outlines, products, nominal, (*bank.notes, *remarks))


def _score_maps(
    place: Place, detection: Detection, bank: FilterBank, elm: EmpiricalLine | None, show: bool | None
) -> tuple[dict[str, Array], list[str]]:
    """Score (lines, samples) by the keys of the bank, and what is to be said of it."""
    cube, local = place.cube, detection.local_window
    watch = watch_lines("scores", cube.bytes_per_line, cube.lines, show=show)
    if local is None or bank.whitener is None:
        maps = score_cube(
            cube, bank.detectors, elm, bank.bands, whitener=bank.whitener, needed=cube.axis.good, watch=watch
        )
        return maps, []
    window = LocalWindow(local.outer_pixels, local.inner_pixels)
    surroundings = place.background([IMAGE] if IMAGE in detection.background else [SCENE])
    maps, lonely = score_cube_locally(
        cube, bank.forms, bank.whitener, window, surroundings, elm, bank.bands, needed=cube.axis.good, watch=watch
    )
    note = (
        f"background means from windows of {window.outer} less {window.inner} pixels; "
        f"{lonely} pixels without surroundings take the mean of the background. "
        "Predicted scores are against that mean throughout"
    )
    return maps, [note]


class _Curves:
    """Products of the score maps, subject by subject."""

    def __init__(
        self, place: Place, detection: Detection, maps: Mapping[str, Array], bank: FilterBank, elm: EmpiricalLine | None
    ):
        self.place, self.detection, self.maps, self.bank, self.elm = place, detection, maps, bank, elm
        self.alarms = place.background(detection.false_alarms)
        area = place.pixel_area_m2
        self.area_km2 = None if area is None else float(self.alarms.sum()) * area / 1e6
        self.scores: dict[tuple[str, str], ScoreDistribution] = {}
        self.roc: dict[tuple[str, str, str], RocCurve] = {}
        self.outlined: dict[str, dict[str, TargetObject]] = {}
        self.of_objects: dict[tuple[str, str], ObjectScores] = {}
        self.exceedance: dict[tuple[str, str], ExceedanceCurve] = {}

    def add(self, target: DetectionTarget, detector: str, groups: Mapping[str, list[TargetObject]]) -> None:
        """Scores and curves of every subject of a target by one detector."""
        key = map_name(target.name, detector)
        scores = self.maps[key]
        self.outlined.setdefault(key, {}).update({o.name: o for members in groups.values() for o in members})
        noise = self.background(scores, target.name, detector)
        thresholds = preset_thresholds(noise)
        error, bias = self._mean_sampling(key, detector, noise.scores.size)
        background = replace(_moments(noise.scores), mean_error=error, mean_bias=bias)
        for subject, members in groups.items():
            if (subject, detector) in self.scores:
                raise UsageError(
                    f"two targets give the subject {subject!r}",
                    where="detection.group",
                    mend="let the group hold {target}, the name of the detection target",
                )
            self.scores[background_of(subject), detector] = background
            self._subject(subject, detector, members, scores, noise, thresholds)

    def background(self, scores: Array, looked_for: str, detector: str) -> AlarmBlocks:
        """The scores of the background with their places; how often they exceed a threshold is a product."""
        noise = AlarmBlocks.of_map(scores, self.alarms, classes=self.place.classes)
        if noise.scores.size >= FEWEST_FOR_A_CURVE:
            self.exceedance[looked_for, detector] = exceedance_curve(noise)
        return noise

    def _mean_sampling(self, key: str, detector: str, n: int) -> tuple[float, float]:
        """Error and bias of the background's mean score where the filter was made of the same pixels, else NaN."""
        behind, made_of = self.bank.background, self.place.background(self.detection.background)
        if detector != "cem-correlation" or behind is None or self.bank.shrinkage or self.detection.local_window:
            return np.nan, np.nan
        if not np.array_equal(made_of, self.alarms):
            return np.nan, np.nan
        lines, samples = drawn_pixels(self.alarms, _MOST_INFLUENCES, np.random.default_rng(0))
        at = np.lexsort((samples, lines))
        lines, samples = lines[at], samples[at]
        values, usable = self.place.pixels_at(lines, samples, self.elm)
        pixels = values[:, self.bank.bands]
        usable &= np.isfinite(pixels).all(axis=1)
        stratum = self.place.classes[lines, samples][usable]
        weights = self.bank.detectors[key].weights[0]
        return own_mean_sampling(weights, *behind, pixels[usable], stratum, n)

    def _subject(
        self,
        subject: str,
        detector: str,
        members: Sequence[TargetObject],
        scores: Array,
        noise: AlarmBlocks,
        thresholds: PresetThresholds,
    ) -> None:
        objects = {o.name: scored_pixels(o, self.place) for o in members}
        pixels = np.concatenate([values_on(scores, placed) for placed in objects.values()])
        pixels = pixels[np.isfinite(pixels)]
        if pixels.size == 0:
            raise InputError(f"no valid pixel on the targets of {subject!r}")
        self.scores[subject, detector] = _moments(pixels)
        by_pixel = empirical_roc(pixels, thresholds, unit="pixel", background_area_km2=self.area_km2)
        self.roc[subject, detector, "pixel"] = with_summary(by_pixel, pixels, noise)
        best = object_scores(scores, objects, self.detection.halo_pixels)
        by_object, counted, at = noise, int(np.count_nonzero(self.alarms)), thresholds
        if self.detection.halo_pixels:
            by_object, counted = self._placements(scores, objects)
            at = preset_thresholds(by_object)
        else:  # the model does not know what a halo may catch
            self.of_objects[subject, detector] = ObjectScores(np.array(list(best.values())), tuple(best))
        curve = self._object_curve(best, by_object, at, counted)
        if self.detection.first_detection:
            curve = replace(curve, alarms_before_first=alarms_before_first(pixels, noise.scores))
        self.roc[subject, detector, "object"] = curve
        if self.detection.halo_pixels:
            outside = self._outside(objects, scores.shape)
            every = AlarmBlocks.of_map(scores, outside, classes=self.place.classes)
            counted = int(np.count_nonzero(outside))
            self.roc[subject, detector, BY_PIXEL] = self._object_curve(best, every, preset_thresholds(every), counted)

    def _object_curve(
        self, best: Mapping[str, float], noise: AlarmBlocks, thresholds: PresetThresholds, pixels: int
    ) -> RocCurve:
        """ROC of objects, each with the greatest score over its pixels and the halo around them.

        Without a halo a false alarm is a background pixel.  With one it is a placement of an object's footprint on
        the background, where noise has as many chances as it has on the object; objects of different shapes each
        bring their own placements, objects of one shape the same.  Or it is every pixel outside the halos, as the
        MUUFL Gulfport collection is scored (Bullwinkle): that favours detection, as an object has as many chances as
        its halo has pixels, a false alarm one.

        Parameters
        ----------
        noise, thresholds, pixels : scores of the false alarms, what they say of every curve, and pixels behind them
        """
        area, bootstrap = self.place.pixel_area_m2, self.detection.bootstrap
        scores = np.array(list(best.values()))
        scores = scores[np.isfinite(scores)]
        area_km2 = None if area is None else pixels * area / 1e6
        curve = empirical_roc(scores, thresholds, unit="object", background_area_km2=area_km2)
        return with_summary(curve, scores, noise, draws=bootstrap.draws, rng=np.random.default_rng(bootstrap.seed))

    def _outside(self, objects: Mapping[str, Placed], shape: tuple[int, ...]) -> Mask:
        """(lines, samples) the background outside the halos of objects."""
        outside = self.alarms.copy()
        for placed in objects.values():
            corner, grown = placed_with_halo(placed, self.detection.halo_pixels, shape)
            _window(outside, corner, grown)[grown] = False
        return outside

    def _placements(self, scores: Array, objects: Mapping[str, Placed]) -> tuple[AlarmBlocks, int]:
        """Greatest score of every placement of the objects' footprints on the background, and the pixels looked at.

        Raises
        ------
        UsageError : the footprint fits nowhere on the background.
        """
        halo, parts, looked_at = self.detection.halo_pixels, [], 0
        shapes = []
        for name, (_, part) in objects.items():
            shapes.append(footprint(part, halo))
            if any(np.greater(shapes[-1].shape, scores.shape)):
                raise UsageError(
                    f"the object {name!r} with a halo of {halo} pixels is larger than the image, {scores.shape}",
                    where="detection.halo_pixels",
                    expected="a halo that leaves background around the object",
                )
        # The placements of one shape count once, however many objects have it: they are the same pixels.
        for shape in {(s.shape, s.tobytes()): s for s in shapes}.values():
            parts.append(footprint_maxima(scores, shape, ~self.alarms))
            looked_at += parts[-1][0].size * shape.size
        maxima, lines, samples = (np.concatenate(part) for part in zip(*parts, strict=True))
        if maxima.size == 0:
            names = ", ".join(objects)
            raise UsageError(
                f"with a halo of {halo} pixels no footprint of the targets fits on the background ({names})",
                where="detection.halo_pixels",
            )
        # Blocks as large on the ground as those of the pixels.
        side = block_side(int(np.count_nonzero(self.alarms)))
        return AlarmBlocks.of_places(maxima, lines, samples, side, self.place.classes[lines, samples]), looked_at

    def add_pools(self) -> None:
        """Curves of several subjects counted together."""
        for pool in self.detection.pools:
            if any(pool.name == subject for subject, _, _ in self.roc):
                raise UsageError(f"the pool {pool.name!r} bears the name of a subject or of another pool")
            for detector in self.detection.detectors:
                for unit in ("pixel", "object"):
                    lacking = [s for s in pool.subjects if (s, detector, unit) not in self.roc]
                    if lacking:
                        raise UsageError(f"pool {pool.name!r}: no curve of {', '.join(lacking)}")
                    curves = [self.roc[s, detector, unit] for s in pool.subjects]
                    first = [c.alarms_before_first for c in curves if c.alarms_before_first is not None]
                    pooled = replace(pooled_roc(curves), alarms_before_first=min(first, default=None))
                    self.roc[pool.name, detector, unit] = pooled


def _moments(values: Array) -> ScoreDistribution:
    sd = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    tail = np.partition(values, values.size - _MOST_SCORES)[-_MOST_SCORES:] if values.size > _MOST_SCORES else values
    return ScoreDistribution(float(np.mean(values)), sd, int(values.size), greatest=np.sort(tail)[::-1])


def anomaly_note(place: Place, detector: str, scores: Array, background: Mask) -> str:
    """The strongest groups of touching pixels above the threshold that the background passes at a low rate.

    The rate is the lowest of 1e-4, 1e-3 and 1e-2 at which the background leaves ten pixels or more: they fix the
    threshold, and belong to the groups themselves where the background is the whole scene.
    """
    noise = scores[background & np.isfinite(scores)]
    level = next((p for p in ANOMALY_LEVELS if p * noise.size >= LEAST_EXPECTED_ALARMS), None)
    if level is None:
        return f"{detector}: {noise.size} background pixels are too few for a threshold of anomalies"
    threshold = float(np.sort(noise)[noise.size - 1 - int(level * noise.size)])
    labels, count = objects(np.nan_to_num(scores, nan=-np.inf) > threshold)
    if not count:
        return f"{detector}: no pixel beyond {threshold:.4g}, which {level:g} of the background exceeds"
    inside = labels > 0
    best = np.full(count + 1, -np.inf)
    np.maximum.at(best, labels[inside], scores[inside])
    sizes = np.bincount(labels[inside], minlength=count + 1)
    strongest = np.argsort(-best[1:], kind="stable")[:MOST_NAMED] + 1
    words = [_in_words(place, scores, labels == number, int(sizes[number])) for number in strongest]
    more = f"; and {count - MOST_NAMED} weaker" if count > MOST_NAMED else ""
    return (
        f"{detector}: {count} anomalies, groups of touching pixels beyond {threshold:.4g}, which {level:g} of the "
        f"background exceeds: {'; '.join(words)}{more}"
    )


def _in_words(place: Place, scores: Array, group: Mask, size: int) -> str:
    line, sample = (int(i) for i in np.unravel_index(np.argmax(np.where(group, scores, -np.inf)), scores.shape))
    where = f"line {line}, sample {sample}"
    transform = place.cube.transform
    if transform is not None:
        x, y = transform @ (sample + 0.5, line + 0.5)
        where += f" ({x:.2f}, {y:.2f})"
    return f"{where}: {scores[line, sample]:.4g}, {size} pixel{'' if size == 1 else 's'}"

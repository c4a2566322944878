"""Filters, scores and detection curves of one collection; anomalies where no target is looked for.

A place with the statistics of its labels gives filters in the bands that they use, these the score maps, and these
what is counted on the objects of the truth and on the background: moments, ROC, areas by the sum of scores.  Areas
are also found by unmixing: endmembers are the target and the background around it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hyperval.collection import Detection, DetectionTarget, Unmixing
from hyperval.data import SampleStatistics, statistics_of
from hyperval.errors import InputError, UsageError, one_of, refusal
from hyperval.executors import single_blas_thread
from hyperval.imagery.regions import objects
from hyperval.imagery.truth import TargetMasks, TargetObject, all_pixels
from hyperval.model import PositiveDefinite, Sources, UnmixedSubject, fully_constrained, labelled, own_mean_sampling
from hyperval.model.filters import whitened
from hyperval.observe.open import IMAGE, SCENE, Place, number_rows
from hyperval.pixels import (
    ANOMALY_DETECTORS,
    ANOMALY_LEVELS,
    FEWEST_FOR_A_CURVE,
    LEAST_EXPECTED_ALARMS,
    WITHOUT_COVARIANCE,
    AlarmBlocks,
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
from hyperval.products import ANOMALIES, Abundance, ObjectScores, ScoreDistribution, background_of
from hyperval.progress import track, watch_lines
from hyperval.spectra import in_window

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]
Resolve = Callable[[str], Path]
Groups = dict[str, list[TargetObject]]

BACKGROUND = "detector background"
BY_PIXEL = "object-by-pixel"  # objects by their halos, alarms by pixel
# Below this many pixels for each band a sample covariance is shrunk (Ledoit & Wolf 2004).
FEW_PIXELS_PER_BAND = 3
MOST_NAMED = 10  # anomalies
_MOST_INFLUENCES = 4000  # pixels that tell how far the mean of all moves by chance: its error to 3 %
_MOST_SCORES = 500  # that a product keeps of one population: the exact ends of a curve


def map_name(target: str, detector: str) -> str:
    """Name of the score map of a target; anomalies have one map for all targets."""
    return detector if detector in ANOMALY_DETECTORS else f"{target}-{detector}"


def scored_pixels(target: TargetObject, place: Place) -> Placed:
    """The pixels of an object that are scored, in their window."""
    if place.target_pixels == "touched" or target.centre_pixel is None:
        return target.placed
    return target.centre_pixel, np.ones((1, 1), bool)


def target_groups(objects: Sequence[TargetObject], target: DetectionTarget, form: str) -> Groups:
    """Objects of the target's material by subject name, in the order of the truth."""
    out: Groups = {}
    for item in objects:
        if item.material == target.material:
            words = {"name": item.name, "material": item.material, **item.attributes, "target": target.name}
            out.setdefault(_subject(form, words), []).append(item)
    if not out:
        raise refusal(
            "detection.material",
            name=target.name,
            material=target.material,
            known=one_of(sorted({o.material for o in objects}), "a truth with targets"),
        )
    return out


# Names in braces are replaced as they stand: str.format would take widths that fill the memory.
_BRACES = re.compile(r"\{([^{}]*)\}")


def _subject(form: str, words: Mapping[str, str]) -> str:
    unknown = [word for word in _BRACES.findall(form) if word not in words]
    if unknown:
        raise refusal(
            "detection.group", form=form, word=unknown[0], known="names in braces out of " + ", ".join(sorted(words))
        )
    return _BRACES.sub(lambda match: words[match[1]], form)


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


def detect(place: Place, detection: Detection, resolve: Resolve, *, show_progress: bool | None = None) -> Detected:
    """Score the image with every detector and target, and count what is found.

    Parameters
    ----------
    place : with the statistics of its regions and of the detectors' background (:data:`BACKGROUND`)

    Raises
    ------
    UsageError : names that do not fit, a singular background.
    InputError : target spectra or truth that are missing.
    """
    bank = _filter_bank(place, detection, _target_spectra(place, detection, resolve))
    maps, notes = _score_maps(place, detection, bank, show_progress)
    curves, outlined = _Curves(place, detection, bank), dict[str, dict[str, TargetObject]]()
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        for detector in detection.detectors:
            key = map_name(target.name, detector)
            outlined.setdefault(key, {}).update({o.name: o for members in groups.values() for o in members})
            curves.add(key, target.name, detector, groups, maps[key])
    for name, scores in maps.items() if not detection.targets else ():
        noise = curves.background(scores, ANOMALIES, name)
        curves.products["scores"][background_of(ANOMALIES), name] = _moments(noise.scores)
        notes.append(_anomaly_note(place, name, scores, curves.alarms))
    _add_pools(curves.products["roc"], detection)
    if detection.halo_pixels:
        notes.append(
            f"curves '{BY_PIXEL}' count every pixel as a false alarm and give an object the best of its halo, as "
            "MUUFL's scoring does: they favour detection, those 'object' do not"
        )
    if detection.first_detection:
        notes.append(
            "alarms_before_first counts false alarms up to the best pixel of any object, as RIT's self-test does: "
            "it favours targets of many pixels or pieces, of which the luckiest stands for all"
        )
    areas, nominal = target_areas(place, detection, maps)
    outlines = {key: TargetMasks(list(members.values())) for key, members in outlined.items()}
    products = curves.products | {"abundance": areas}
    return Detected(bank, maps, outlines, products, nominal, (*bank.notes, *notes))


def _target_spectra(place: Place, detection: Detection, resolve: Resolve) -> dict[str, Array]:
    """(B,) reflectance of each target."""
    if place.by_number:
        return {t.name: _by_number(t, place.cube.bands, resolve) for t in detection.targets}
    sources = Sources(place.cube.axis, {}, resolve)
    return {t.name: sources.spectrum(t.spectrum, t.name).mean for t in detection.targets}


def _by_number(target: DetectionTarget, bands: int, resolve: Resolve) -> Array:
    """(B,) spectrum of a target where bands go by number: a text file with a row for each; its last number counts."""
    if target.spectrum.file is None:
        raise UsageError(
            f"the spectrum of {target.name!r} goes by wavelength, the bands of the cube by number",
            expected="a text file with one row for each band",
        )
    path = resolve(target.spectrum.file)
    values = number_rows(path, "spectrum by band")[0][:, -1]
    if len(values) != bands or not np.all(np.isfinite(values)):
        raise InputError(f"{len(values)} values for {bands} bands", where=str(path), expected="one row a band")
    return values


def _filter_bank(place: Place, detection: Detection, spectra: Mapping[str, Array]) -> FilterBank:
    """Every detector for every target, by their ``spectra`` (B,) in reflectance."""
    background, shrinkage = place.statistics[BACKGROUND], 0.0
    bands, notes = _usable_bands(place, detection, list(spectra.values()))
    if background.n < FEW_PIXELS_PER_BAND * int(bands.sum()):
        # Few, so they fit in memory; the pass has not summed the fourth moment.
        pixels = place.cube.pixels(place.background(detection.background))
        few = statistics_of(pixels[np.isfinite(pixels).all(axis=1)])
        background, shrinkage = replace(background, covariance=few.shrunk_covariance), few.shrinkage
        notes.append(f"{background.n} background pixels are few: covariance shrunk by {shrinkage:.3g}")
    mean, covariance = place.in_reflectance(background)
    for name in detection.undesired:
        place.region(name)  # refuses a name that no region has
    undesired = np.array([place.in_reflectance(place.statistics[n])[0][bands] for n in detection.undesired])
    forms = {
        map_name(t.name, name): (name, None if name in ANOMALY_DETECTORS else spectra[t.name][bands])
        for t in detection.targets
        for name in detection.detectors
    } or {name: (name, None) for name in detection.detectors}  # anomalies need no target
    whitener = inverted = behind = None
    with single_blas_thread():  # small matrices: more threads only wait for each other
        if not set(detection.detectors) <= set(WITHOUT_COVARIANCE):
            inverted = PositiveDefinite(covariance[np.ix_(bands, bands)])
            behind = mean[bands], inverted
            notes.append(f"condition number of the background matrix at unit diagonal: {inverted.condition:.3g}")
        detectors = {
            key: pixel_detector(name, spectrum, mean[bands], inverted, undesired)
            for key, (name, spectrum) in forms.items()
        }
        by_distance = any(d.quadratic == "distance" for d in detectors.values())
        if behind is not None and (detection.local_window or by_distance):
            whitener = whitener_of(*behind)
    return FilterBank(detectors, forms, bands, whitener, shrinkage, tuple(notes), behind)


def _usable_bands(place: Place, detection: Detection, spectra: Sequence[Array]) -> tuple[Mask, list[str]]:
    """Bands (B,) that detectors use, and in words how many, and the others with the first rule that leaves them out.

    Parameters
    ----------
    spectra : (B,) of the targets, NaN where they are not known
    """
    axis, line = place.cube.axis, place.line
    left, parts = np.ones(len(axis), bool), list[str]()
    rules: dict[str, Mask | None] = {
        "bad in the band list": axis.good if detection.bands in ("good", "windows") else left,
        "in absorption bands": in_window(axis.centre_nm) if detection.bands == "windows" else left,
        "not in the target spectra": np.asarray(np.isfinite([left, *spectra]).all(axis=0)),
        "without a gain of the empirical line": left if line is None else line.usable,
        f"with an SNR below {detection.least_snr or 0:g} in the background": None,
    }
    for reason, keep in rules.items():
        if keep is None:  # of the bands that are left
            keep = _clear(left, place.statistics[BACKGROUND], detection.least_snr)
        lost, left = np.flatnonzero(left & ~keep), left & keep
        if lost.size:
            runs = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
            ends = [sorted({f"{axis.centre_nm[r[0]]:.4g}", f"{axis.centre_nm[r[-1]]:.4g}"}, key=float) for r in runs]
            parts.append(f"{lost.size} {reason} ({', '.join('-'.join(e) for e in ends)} nm)")
    if not left.any():
        raise refusal("detection.bands", rules="; ".join(parts))
    notes = [f"detectors use {int(left.sum())} of {len(axis)} bands"]
    return left, [*notes, f"bands that the detectors do not use: {'; '.join(parts)}"] if parts else notes


def _clear(left: Mask, background: SampleStatistics, least_snr: float | None) -> Mask:
    """(B,) where the SNR of the background, by the bands that are left, reaches what is asked for."""
    at, keep = np.flatnonzero(left), np.ones_like(left)
    if least_snr is not None and at.size >= 3:
        keep[at] = snr_from_moments(background.mean[at], background.covariance[np.ix_(at, at)]) >= least_snr
    return keep


def _score_maps(
    place: Place, detection: Detection, bank: FilterBank, show: bool | None
) -> tuple[dict[str, Array], list[str]]:
    """Score (lines, samples) by the keys of the bank, and what is to be said of it."""
    cube, local, line = place.cube, detection.local_window, place.line
    common: dict[str, Any] = {
        "needed": cube.axis.good, "watch": watch_lines("scores", cube.bytes_per_line, cube.lines, show=show),
    }  # fmt: skip
    if local is None or bank.whitener is None:
        return score_cube(cube, bank.detectors, line, bank.bands, whitener=bank.whitener, **common), []
    window = LocalWindow(local.outer_pixels, local.inner_pixels)
    around = place.background([IMAGE] if IMAGE in detection.background else [SCENE])
    maps, lonely = score_cube_locally(cube, bank.forms, bank.whitener, window, around, line, bank.bands, **common)
    return maps, [
        f"background means from windows of {window.outer} less {window.inner} pixels; "
        f"{lonely} pixels without surroundings take the mean of the background. "
        "Predicted scores are against that mean throughout"
    ]


class _Curves:
    """What is counted on score maps, subject by subject: ``products`` by their names and keys."""

    def __init__(self, place: Place, detection: Detection, bank: FilterBank):
        self.place, self.detection, self.bank = place, detection, bank
        self.alarms = place.background(detection.false_alarms)
        self.products: dict[str, dict[Any, Any]] = {k: {} for k in ("scores", "roc", "object_scores", "exceedance")}

    def background(self, scores: Array, looked_for: str, detector: str) -> AlarmBlocks:
        """The scores of the background with their places; how often they exceed a threshold is a product."""
        noise = AlarmBlocks.of_map(scores, self.alarms, classes=self.place.classes)
        if noise.scores.size >= FEWEST_FOR_A_CURVE:
            self.products["exceedance"][looked_for, detector] = exceedance_curve(noise)
        return noise

    def add(self, key: str, target: str, detector: str, groups: Groups, scores: Array) -> None:
        """Scores and curves of every subject of a target by one detector, on the score map of this key."""
        found, noise = self.products["scores"], self.background(scores, target, detector)
        thresholds = preset_thresholds(noise)
        error, bias = self._mean_sampling(key, detector, noise.scores.size)
        background = replace(_moments(noise.scores), mean_error=error, mean_bias=bias)
        for subject, members in groups.items():
            if (subject, detector) in found:
                raise refusal("detection.subject", "detection.group", subject=subject)
            found[background_of(subject), detector] = background
            self._add_subject(subject, detector, members, scores, noise, thresholds)

    def _mean_sampling(self, key: str, detector: str, n: int) -> tuple[float, float]:
        """Error and bias of the background's mean score where the filter was made of the same pixels, else NaN."""
        place, bank, detection = self.place, self.bank, self.detection
        if detector != "cem-correlation" or bank.background is None or bank.shrinkage or detection.local_window:
            return np.nan, np.nan
        if not np.array_equal(place.background(detection.background), self.alarms):
            return np.nan, np.nan
        lines, samples = drawn_pixels(self.alarms, _MOST_INFLUENCES, np.random.default_rng(0))
        order = np.lexsort((samples, lines))
        lines, samples = lines[order], samples[order]
        values, usable = place.pixels_at(lines, samples)
        pixels = values[:, bank.bands]
        usable &= np.isfinite(pixels).all(axis=1)
        stratum = place.classes[lines, samples][usable]
        return own_mean_sampling(bank.detectors[key].weights[0], *bank.background, pixels[usable], stratum, n)

    def _add_subject(
        self,
        subject: str,
        detector: str,
        members: Sequence[TargetObject],
        scores: Array,
        noise: AlarmBlocks,
        thresholds: PresetThresholds,
    ) -> None:
        """Moments of the subject's pixels, and its curves by pixel and by object.

        An object has the greatest score over its pixels and the halo around them.  Without a halo a false alarm is a
        background pixel.  With one it is a placement of an object's footprint on the background, where noise has as
        many chances as it has on the object; objects of different shapes each bring their own placements, objects of
        one shape the same.  Or it is every pixel outside the halos, as the MUUFL Gulfport collection is scored
        (Bullwinkle): that favours detection, as an object has as many chances as its halo has pixels, a false alarm
        one.
        """
        halo, roc = self.detection.halo_pixels, self.products["roc"]
        placed = {o.name: scored_pixels(o, self.place) for o in members}
        pixels = np.concatenate([values_on(scores, own) for own in placed.values()])
        pixels = pixels[np.isfinite(pixels)]
        if pixels.size == 0:
            raise InputError(f"no valid pixel on the targets of {subject!r}")
        self.products["scores"][subject, detector] = _moments(pixels)
        counted = int(np.count_nonzero(self.alarms))
        by_pixel = empirical_roc(pixels, thresholds, unit="pixel", background_area_km2=self._km2(counted))
        roc[subject, detector, "pixel"] = with_summary(by_pixel, pixels, noise)
        best = object_scores(scores, placed, halo)
        if halo:
            outside = self._outside(placed.values(), scores.shape)
            every = AlarmBlocks.of_map(scores, outside, classes=self.place.classes)
            alarms = {"object": self._placements(scores, placed), BY_PIXEL: (every, int(np.count_nonzero(outside)))}
        else:  # the model does not know what a halo may catch
            alarms = {"object": (noise, counted)}
            self.products["object_scores"][subject, detector] = ObjectScores(np.array(list(best.values())), tuple(best))
        found, bootstrap = np.array(list(best.values())), self.detection.bootstrap
        found = found[np.isfinite(found)]
        for unit, (others, looked_at) in alarms.items():
            at = preset_thresholds(others) if halo else thresholds
            curve = empirical_roc(found, at, unit="object", background_area_km2=self._km2(looked_at))
            rng = np.random.default_rng(bootstrap.seed)
            roc[subject, detector, unit] = with_summary(curve, found, others, draws=bootstrap.draws, rng=rng)
        if self.detection.first_detection:
            first, key = alarms_before_first(pixels, noise.scores), (subject, detector, "object")
            roc[key] = replace(roc[key], alarms_before_first=first)

    def _km2(self, pixels: int) -> float | None:
        """Ground area of so many pixels [km2]."""
        area = self.place.pixel_area_m2
        return None if area is None else pixels * area / 1e6

    def _outside(self, placed: Iterable[Placed], shape: tuple[int, ...]) -> Mask:
        """(lines, samples) the background outside the halos of objects."""
        outside = self.alarms.copy()
        for own in placed:
            corner, grown = placed_with_halo(own, self.detection.halo_pixels, shape)
            _window(outside, corner, grown)[grown] = False
        return outside

    def _placements(self, scores: Array, placed: Mapping[str, Placed]) -> tuple[AlarmBlocks, int]:
        """Greatest score of every placement of the objects' footprints on the background, and the pixels looked at."""
        halo, where = self.detection.halo_pixels, "detection.halo_pixels"
        shapes = {}  # the placements of one shape count once, however many objects have it: they are the same pixels
        for name, (_, part) in placed.items():
            shape = footprint(part, halo)
            shapes[shape.shape, shape.tobytes()] = shape
            if any(np.greater(shape.shape, scores.shape)):
                raise refusal("detection.halo", where, name=name, halo=halo, shape=scores.shape)
        parts = [footprint_maxima(scores, shape, ~self.alarms) for shape in shapes.values()]
        looked_at = sum(part[0].size * shape.size for part, shape in zip(parts, shapes.values(), strict=True))
        maxima, lines, samples = (np.concatenate(part) for part in zip(*parts, strict=True))
        if maxima.size == 0:
            what = f"with a halo of {halo} pixels no footprint of the targets fits on the background"
            raise UsageError(f"{what} ({', '.join(placed)})", where=where)
        # Blocks as large on the ground as those of the pixels.
        side = block_side(int(np.count_nonzero(self.alarms)))
        return AlarmBlocks.of_places(maxima, lines, samples, side, self.place.classes[lines, samples]), looked_at


def _add_pools(roc: dict[Any, Any], detection: Detection) -> None:
    """Curves of several subjects counted together."""
    for pool in detection.pools:
        if any(pool.name == subject for subject, _, _ in roc):
            raise UsageError(f"the pool {pool.name!r} bears the name of a subject or of another pool")
        for detector in detection.detectors:
            for unit in ("pixel", "object"):
                if lacking := [s for s in pool.subjects if (s, detector, unit) not in roc]:
                    raise UsageError(f"pool {pool.name!r}: no curve of {', '.join(lacking)}")
                curves = [roc[s, detector, unit] for s in pool.subjects]
                first = [c.alarms_before_first for c in curves if c.alarms_before_first is not None]
                pooled = replace(pooled_roc(curves), alarms_before_first=min(first, default=None))
                roc[pool.name, detector, unit] = pooled


def _moments(values: Array) -> ScoreDistribution:
    sd = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    tail = np.partition(values, values.size - _MOST_SCORES)[-_MOST_SCORES:] if values.size > _MOST_SCORES else values
    return ScoreDistribution(float(np.mean(values)), sd, int(values.size), greatest=np.sort(tail)[::-1])


def _anomaly_note(place: Place, detector: str, scores: Array, background: Mask) -> str:
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
    numbers = np.arange(1, count + 1)
    best, sizes = ndimage.maximum(scores, labels, numbers), np.bincount(labels.ravel())[1:]
    strongest = np.argsort(-best, kind="stable")[:MOST_NAMED]
    words = [_in_words(place, scores, labels == numbers[i], int(sizes[i])) for i in strongest]
    more = f"; and {count - MOST_NAMED} weaker" if count > MOST_NAMED else ""
    return (
        f"{detector}: {count} anomalies, groups of touching pixels beyond {threshold:.4g}, which {level:g} of the "
        f"background exceeds: {'; '.join(words)}{more}"
    )


def _in_words(place: Place, scores: Array, group: Mask, size: int) -> str:
    line, sample = (int(i) for i in np.unravel_index(np.argmax(np.where(group, scores, -np.inf)), scores.shape))
    where = f"line {line}, sample {sample}"
    if place.cube.transform is not None:
        x, y = place.cube.transform @ (sample + 0.5, line + 0.5)
        where += f" ({x:.2f}, {y:.2f})"
    return f"{where}: {scores[line, sample]:.4g}, {size} pixel{'' if size == 1 else 's'}"


def target_areas(
    place: Place, detection: Detection, maps: Mapping[str, Array]
) -> tuple[dict[tuple[str, str], Abundance], dict[tuple[str, str], float]]:
    """Sum of scores over each object times the pixel area, and the area that the truth states [m2].

    By subject and detector, for every check that is asked for.  The uncertainty is the spread of the same sum over
    background that has the object's footprint.  Both are means over the objects of a subject.
    """
    areas: dict[tuple[str, str], Abundance] = {}
    nominal: dict[tuple[str, str], float] = {}
    targets = {t.name: t for t in detection.targets}
    for check in detection.areas:
        pixel_area, target = _pixel_area(place, "areas"), targets.get(check.target)
        if target is None or check.detector not in detection.detectors:
            raise UsageError(f"areas: no score map of target {check.target!r} with detector {check.detector!r}")
        sums = _footprint_sums(place, detection, maps[f"{check.target}-{check.detector}"], check.margin_pixels)
        for subject, members in target_groups(place.targets, target, detection.group).items():
            total, pixels, variance = (sum(part) for part in zip(*map(sums, members), strict=True))
            each = pixel_area / len(members)
            areas[subject, check.detector] = Abundance(total * each, float(np.sqrt(variance)) * each, int(pixels))
            stated = float(np.mean([o.area_m2 for o in members]))
            if np.isfinite(stated):  # a truth may say where the objects are and not how large
                nominal[subject, check.detector] = stated
    return areas, nominal


def _pixel_area(place: Place, what: str) -> float:
    if place.pixel_area_m2 is None:
        raise UsageError(f"{what} need the ground area of a pixel; the cube is not georeferenced")
    return place.pixel_area_m2


def _footprint_sums(
    place: Place, detection: Detection, scores: Array, margin: int
) -> Callable[[TargetObject], tuple[float, int, float]]:
    """What gives the sum of a score map over an object with its margin, its pixels, and the variance of the sum."""
    targets = all_pixels(place.targets, place.cube.shape)
    # A background of "image" holds the targets too; their sums say nothing of the error.
    taken = ~(place.background(detection.background) & ~place.near_targets)
    spread: dict[tuple[tuple[int, ...], bytes], float] = {}  # by shape of the footprint

    def of(item: TargetObject) -> tuple[float, int, float]:
        corner, grown = placed_with_halo(item.placed, margin, scores.shape)
        summed = grown & (~_window(targets, corner, grown) | _window(item.mask, corner, grown))  # not those of others
        shape = footprint(summed)
        key = shape.shape, shape.tobytes()
        if key not in spread:
            elsewhere = footprint_sums(scores, shape, taken)
            spread[key] = float(np.var(elsewhere, ddof=1)) if elsewhere.size > 1 else float("nan")
        return float(np.nansum(_window(scores, corner, grown)[summed])), int(summed.sum()), spread[key]

    return of


def _window(image: npt.NDArray[Any], corner: tuple[int, int], like: Mask) -> npt.NDArray[Any]:
    """The part of an image under a window of the size of ``like``."""
    return image[corner[0] : corner[0] + like.shape[0], corner[1] : corner[1] + like.shape[1]]


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
    place: Indices
    background: Array
    ring: int


def unmix(
    place: Place, detection: Detection, task: Unmixing, bands: Mask, resolve: Resolve, *, show: bool | None = None
) -> Unmixed:
    """Area of every target object from the sum of its abundances over the pixels that may hold a part of it.

    The uncertainty is the spread of the same sum over footprints laid at random on the background, which have
    their own surroundings as endmember: it holds the background's spread with its correlation on the ground.

    Raises
    ------
    UsageError : names that do not fit, or a cube without ground size of its pixels.
    InputError : an object without background around it.
    """
    pixel_area, region = _pixel_area(place, "unmixing: areas"), place.pixels_of(task.background)
    covariance = place.in_reflectance(place.statistics[task.background])[1][np.ix_(bands, bands)]
    covariances = {METHODS[w]: None if w == "equal" else covariance for w in task.weights}
    noise = {name: None if c is None else PositiveDefinite(c) for name, c in covariances.items()}
    targets = {t.name: t for t in detection.targets}
    for item in task.targets:
        if item.target not in targets:
            raise UsageError(f"unmixing: no detection target {item.target!r}", expected=one_of(targets))
    sources, rng = Sources(place.cube.axis, {}, resolve), np.random.default_rng(task.seed)
    surroundings: dict[str, _ObjectSurroundings] = {}
    areas: dict[tuple[str, str], Abundance] = {}
    subjects: list[UnmixedSubject] = []
    for item in track(task.targets, "unmixing", show=show):
        target, whole = targets[item.target], sources.spectrum(targets[item.target].spectrum, item.target).mean
        # What the scenario's population is called that stands for each subject.
        stands = target.model_copy(update={"name": item.scenario_target or item.target})
        populations = target_groups(place.targets, stands, detection.group)
        groups = target_groups(place.targets, target, detection.group)
        for (subject, members), population in zip(groups.items(), populations, strict=True):
            nominal = float(np.mean([o.area_m2 for o in members]))
            if not np.isfinite(nominal):
                raise refusal("unmixing.size", "detection.unmixing", subject=subject)
            for o in members:
                if o.name not in surroundings:
                    surroundings[o.name] = _surroundings(place, o, region, task, bands, rng)
            around = [surroundings[o.name] for o in members]
            for method, weights in noise.items():
                found = _unmixed_area(around, whole[bands], weights, pixel_area, nominal)
                areas[subject, labelled(method, item.endmembers)] = found
            subjects.append(
                UnmixedSubject(
                    subject, population, item.scenario_target or item.target, whole, item.relative_uncertainty,
                    item.correlation_nm, item.endmembers, len(members), nominal,
                    int(np.mean([s.ring for s in around])),
                )
            )  # fmt: skip
    return Unmixed(areas, tuple(subjects), bands, covariances, pixel_area)


def _unmixed_area(
    around: Sequence[_ObjectSurroundings],
    spectrum: Array,
    noise: PositiveDefinite | None,
    pixel_area: float,
    nominal: float,
) -> Abundance:
    total, variance, n, count = 0.0, 0.0, 0, len(around)
    for s in around:
        between = np.stack([np.broadcast_to(spectrum, s.background.shape), s.background], axis=1)
        parts = fully_constrained(whitened(s.pixels, noise), whitened(between, noise)[s.place])[:, 0]
        own, *elsewhere = np.bincount(s.place, parts, minlength=len(s.background)).tolist()
        total += own
        n += int(np.count_nonzero(s.place == 0))
        variance += float(np.var(elsewhere, ddof=1)) if len(elsewhere) > 1 else float("nan")
    return Abundance(total / count * pixel_area, float(np.sqrt(variance)) / count * pixel_area, n, nominal)


def _surroundings(
    place: Place, target: TargetObject, region: Mask, task: Unmixing, bands: Mask, rng: np.random.Generator
) -> _ObjectSurroundings:
    lines, samples = np.nonzero(target.part)
    parts: list[tuple[Indices, Indices]] = []
    for line, sample in (target.corner, *_free_places(region, target.part, rng)):
        own = lines + line, samples + sample
        parts += [own, _ring(own, region, task.ring_pixels)]
    read = list(_valid_reflectance(place, parts, bands))
    (own_pixels, own_ring), *others = zip(read[::2], read[1::2], strict=True)
    if not len(own_ring):
        raise refusal("unmixing.ring", name=target.name, background=task.background, ring_pixels=task.ring_pixels)
    whole = [(own_pixels, own_ring), *((x, r) for x, r in others if len(r) and len(x) == lines.size)]
    of = np.repeat(np.arange(len(whole)), [len(x) for x, _ in whole])
    means = np.array([r.mean(axis=0) for _, r in whole])
    return _ObjectSurroundings(np.concatenate([x for x, _ in whole]), of, means, len(own_ring))


def _ring(own: tuple[Indices, Indices], region: Mask, reach: int) -> tuple[Indices, Indices]:
    """The pixels of the region within ``reach`` pixels of some pixels, these left out."""
    first = np.maximum([own[0].min() - reach, own[1].min() - reach], 0)
    last = np.minimum([own[0].max() + reach + 1, own[1].max() + reach + 1], region.shape)
    inside = np.zeros(tuple(last - first), bool)
    inside[own[0] - first[0], own[1] - first[1]] = True
    near = ndimage.distance_transform_edt(~inside) <= reach
    lines, samples = np.nonzero(near & ~inside & region[first[0] : last[0], first[1] : last[1]])
    return lines + first[0], samples + first[1]


def _valid_reflectance(place: Place, parts: Sequence[tuple[Indices, Indices]], bands: Mask) -> Iterator[Array]:
    """(n, F) reflectance of the valid ones among several sets of pixels, all read at once: each line once."""
    flat = [lines * place.cube.samples + samples for lines, samples in parts]
    every, index = np.unique(np.concatenate(flat), return_inverse=True)
    values, usable = place.pixels_at(*np.divmod(every, place.cube.samples))
    reflectance = values[:, bands]
    valid = usable & np.isfinite(reflectance).all(axis=1)
    for own in np.split(index, np.cumsum([f.size for f in flat])[:-1]):
        yield reflectance[own[valid[own]]]


def _free_places(region: Mask, part: Mask, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Corners at random at which a footprint lies on the region as a whole."""
    fits = ndimage.binary_erosion(region, part, origin=(-(part.shape[0] // 2), -(part.shape[1] // 2)))
    places = np.argwhere(fits)
    if not len(places):
        return []
    chosen = rng.choice(len(places), min(PLACES, len(places)), replace=False)
    return [(int(a), int(b)) for a, b in places[chosen]]

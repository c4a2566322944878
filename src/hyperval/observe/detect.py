"""Filters, scores and detection curves of one collection; anomalies where no target is looked for.

The statistics of regions make filters in the usable bands, filters make score maps, and from these follow moments, ROC
and areas by the sum of scores, over the objects of the truth and the background.  Areas are also found by unmixing:
endmembers are the target and the background around it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy import ndimage

from hyperval import pixels as px
from hyperval.collection import Detection, DetectionTarget, Unmixing
from hyperval.data import Array, Index, Mask, statistics_of
from hyperval.errors import UsageError, needed, one_of, refusal, refuse
from hyperval.executors import single_blas_thread
from hyperval.imagery.regions import objects, window_of
from hyperval.imagery.truth import TargetMasks, TargetObject, all_pixels, mask_window
from hyperval.model import FEW_PER_BAND, PositiveDefinite, Sources, fully_constrained, own_mean_sampling
from hyperval.model.classification import UnmixedAreas, UnmixedSubject, unmixing_method
from hyperval.observe.open import IMAGE, Place, number_rows, said
from hyperval.paths import Resolve
from hyperval.products import ANOMALIES, Abundance, ExceedanceCurve, ObjectScores, ScoreDistribution, background_of
from hyperval.progress import track, watch_lines

Groups = dict[str, list[TargetObject]]

BACKGROUND = "detector background"
BY_PIXEL = "object-by-pixel"  # objects by their halos, alarms by pixel
MAX_NAMED = 10  # anomalies
_MAX_INFLUENCES = 4000  # pixels from which the sampling error of the mean of all is estimated, to 3 %
_MAX_SCORES = 500  # stored of one population: the exact tail of a curve


def map_name(target: str, detector: str) -> str:
    """Name of the score map of a target; anomalies have one map for all targets."""
    return detector if detector in px.ANOMALY_DETECTORS else f"{target}-{detector}"


def scored_part(target: TargetObject, place: Place) -> TargetObject:
    """The object reduced to the pixels that are scored."""
    if place.target_pixels == "touched" or target.centre_pixel is None:
        return target
    return replace(target, corner=target.centre_pixel, part=np.ones((1, 1), bool), fills=None)


def target_groups(objects: Sequence[TargetObject], target: DetectionTarget, form: str) -> Groups:
    """Objects of the target's material by subject name, in the order of the truth."""
    groups: Groups = {}
    for item in objects:
        if item.material == target.material:
            words = {"name": item.name, "material": item.material, **item.attributes, "target": target.name}
            groups.setdefault(_subject_name(form, words), []).append(item)
    materials = one_of(sorted({o.material for o in objects}), "a truth with targets")
    refuse(not groups, "detection.material", name=target.name, material=target.material, known=materials)
    return groups


# Names in braces are replaced literally: str.format would take widths that fill the memory.
_BRACES = re.compile(r"\{([^{}]*)\}")


def _subject_name(form: str, words: Mapping[str, str]) -> str:
    unknown = [word for word in _BRACES.findall(form) if word not in words]
    refuse(unknown, "detection.group", form=form, word="".join(unknown[:1]), known=", ".join(sorted(words)))
    return _BRACES.sub(lambda match: words[match[1]], form)


@dataclass(frozen=True, eq=False)
class FilterBank:
    """Detectors of all targets, and the background statistics they are made of.

    Attributes
    ----------
    detectors : by the names of the score maps
    forms : the same by the detector's name and the target's spectrum (F,), None for anomalies
    bands : (B,) those that the filters use, F of them
    shrinkage : of the background's covariance, 0 with enough pixels
    background : mean (F,) and covariance that the filters are made of, None where no detector inverts one
    """

    detectors: Mapping[str, px.PixelDetector]
    forms: Mapping[str, tuple[str, Array | None]]
    bands: Mask
    shrinkage: float
    notes: tuple[str, ...]
    background: tuple[Array, PositiveDefinite] | None = None


@dataclass(frozen=True, eq=False)
class Detected:
    """Results of the detectors.

    Attributes
    ----------
    bank : the filters
    score_maps : "TARGET-DETECTOR" -> (lines, samples) score
    outlines : "TARGET-DETECTOR" -> mask of each object that was looked for
    products : scores, roc, abundance, object_scores and exceedance by their keys
    nominal_area_m2 : area of the targets as the truth states it, by the keys of "abundance"
    notes : on the results
    """

    bank: FilterBank
    score_maps: Mapping[str, Array]
    outlines: Mapping[str, Mapping[str, Mask]]
    products: Mapping[str, Mapping[Any, Any]]
    nominal_area_m2: Mapping[tuple[str, str], float]
    notes: tuple[str, ...] = ()


def detect(place: Place, detection: Detection, resolve: Resolve) -> Detected:
    """Score the image with every detector and target, and count detections and false alarms.

    Parameters
    ----------
    place : with the statistics of its regions and of the detectors' background (:data:`BACKGROUND`)

    Raises
    ------
    UsageError : names that do not fit, a singular background.
    InputError : target spectra or truth that are missing.
    """
    bank = _filter_bank(place, detection, _target_spectra(place, detection, resolve))
    scenes = {
        map_name(t.name, name): _image_truth(place, detection, t)
        for t in detection.targets
        for name in detection.detectors
        if bank.detectors[map_name(t.name, name)].image is not None
    }
    maps, notes = _score_maps(place, detection, bank, scenes)
    curves, outlined = _Curves(place, detection, bank), dict[str, list[TargetObject]]()
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        for detector in detection.detectors:
            key = map_name(target.name, detector)
            outlined.setdefault(key, []).extend(o for members in groups.values() for o in members)
            curves.add_target(key, target.name, detector, groups, maps[key])
    for name, scores in maps.items() if not detection.targets else ():
        noise = curves.background_scores(scores, ANOMALIES, name)
        curves.products["scores"][background_of(ANOMALIES), name] = _score_moments(noise.scores)
        curve = curves.products["exceedance"].get((ANOMALIES, name))
        notes.append(_anomaly_note(place, name, scores, curve, noise.scores.size))
    _add_pools(curves.products["roc"], detection)
    notes += [said(rule) for rule in ("halo_pixels", "first_detection") if getattr(detection, rule)]
    notes += [said("incomplete", names=", ".join(curves.incomplete))] if curves.incomplete else []
    areas, nominal = target_areas(place, detection, maps)
    outlines = {key: TargetMasks({t.name: t for t in members}) for key, members in outlined.items()}
    return Detected(bank, maps, outlines, curves.products | {"abundance": areas}, nominal, (*bank.notes, *notes))


def _target_spectra(place: Place, detection: Detection, resolve: Resolve) -> dict[str, Array]:
    """(B,) reflectance of each target."""
    if place.cube.axis.numbered:
        return {t.name: _spectrum_by_number(t, place.cube.bands, resolve) for t in detection.targets}
    sources = Sources(place.cube.axis, {}, resolve)
    return {t.name: sources.spectrum(t.spectrum, t.name).mean for t in detection.targets}


def _spectrum_by_number(target: DetectionTarget, bands: int, resolve: Resolve) -> Array:
    """(B,) spectrum of a target where bands go by number: a text file with a row for each; its last number counts."""
    path = resolve(needed(target.spectrum.file, "detection.by_number", name=target.name))
    values = number_rows(path, "spectrum by band")[0][:, -1]
    refuse(len(values) != bands or not np.isfinite(values).all(), "detection.rows", path, size=len(values), bands=bands)
    return values


def _filter_bank(place: Place, detection: Detection, spectra: Mapping[str, Array]) -> FilterBank:
    """Every detector for every target, by their ``spectra`` (B,) in reflectance."""
    background, shrinkage = place.statistics[BACKGROUND], 0.0
    bands, notes = _usable_bands(place, detection, list(spectra.values()))
    if background.n < FEW_PER_BAND * int(bands.sum()):
        # Few pixels fit in memory; region statistics have no fourth moment.
        pixels = place.cube.spectra(place.pixels_of(*detection.background))[:, bands]
        shrinkage = statistics_of(pixels[np.isfinite(pixels).all(axis=1)]).shrinkage
        background = background.shrunk(shrinkage, bands)
        notes.append(f"{background.n} background pixels are few: covariance shrunk by {shrinkage:.3g}")
    mean, covariance = place.in_reflectance(background)
    for name in detection.undesired:
        place.region(name)  # refuses unknown names
    undesired = np.array([place.in_reflectance(place.statistics[n])[0][bands] for n in detection.undesired])
    forms = {
        map_name(t.name, name): (name, None if name in px.ANOMALY_DETECTORS else spectra[t.name][bands])
        for t in detection.targets
        for name in detection.detectors
    } or {name: (name, None) for name in detection.detectors}  # anomalies need no target
    inverts = not set(detection.detectors) <= set(px.WITHOUT_COVARIANCE)
    with single_blas_thread():  # small matrices: more threads only wait for each other
        inverted = PositiveDefinite(covariance[np.ix_(bands, bands)], None, np.flatnonzero(bands)) if inverts else None
        detectors = {
            key: px.pixel_detector(name, spectrum, mean[bands], inverted, undesired)
            for key, (name, spectrum) in forms.items()
        }
        if inverted is not None:
            notes.append(f"condition number of the background matrix at unit diagonal: {inverted.condition:.3g}")
    inverse = None if inverted is None else (mean[bands], inverted)
    return FilterBank(detectors, forms, bands, shrinkage, tuple(notes), inverse)


def _usable_bands(place: Place, detection: Detection, spectra: Sequence[Array]) -> tuple[Mask, list[str]]:
    """Bands (B,) that detectors use, and notes: how many, and the others with the first rule that excludes them.

    Parameters
    ----------
    spectra : (B,) of the targets, NaN where they are not known
    """
    axis, line, sample = place.cube.axis, place.line, place.statistics[BACKGROUND]
    rules: dict[str, Mask | bool] = {
        "bad in the band list": axis.good | (detection.bands == "all"),
        "in absorption bands": axis.in_windows | (detection.bands != "windows"),
        "not in the target spectra": np.asarray(np.isfinite([np.zeros(len(axis)), *spectra]).all(axis=0)),
        "without a gain of the empirical line": True if line is None else line.usable,
    }
    if detection.least_snr is not None:  # by the bands that are left
        clear = np.logical_and.reduce([np.broadcast_to(accepted, len(axis)) for accepted in rules.values()])
        if clear.sum() >= 3:
            clear &= px.snr_from_moments(sample.mean, sample.covariance, clear) >= detection.least_snr
        rules[f"with an SNR below {detection.least_snr:g} in the background"] = clear
    used, parts, unit = np.ones(len(axis), bool), list[str](), " nm" * (not axis.numbered)
    for reason, accepted in rules.items():
        rejected, used = np.flatnonzero(used & ~np.asarray(accepted)), used & accepted
        if rejected.size:
            runs = np.split(rejected, np.flatnonzero(np.diff(rejected) > 1) + 1)
            ends = [sorted({f"{axis.centre_nm[r[0]]:.4g}", f"{axis.centre_nm[r[-1]]:.4g}"}, key=float) for r in runs]
            parts.append(f"{rejected.size} {reason} ({', '.join('-'.join(e) for e in ends)}{unit})")
    refuse(not used.any(), "detection.bands", rules="; ".join(parts))
    notes = [f"detectors use {int(used.sum())} of {len(axis)} bands"]
    return used, [*notes, f"bands that the detectors do not use: {'; '.join(parts)}"] if parts else notes


def _image_truth(place: Place, detection: Detection, target: DetectionTarget) -> px.ImageTruth:
    """Background and objects of a target, for detectors that learn from them."""
    numbers = np.zeros(place.cube.shape, np.intp)
    groups = target_groups(place.targets, target, detection.group)
    for number, item in enumerate((scored_part(o, place) for members in groups.values() for o in members), start=1):
        numbers[item.window][item.part] = number
    return px.ImageTruth(place.pixels_of(*detection.background), numbers)


def _score_maps(
    place: Place, detection: Detection, bank: FilterBank, scenes: Mapping[str, px.ImageTruth]
) -> tuple[dict[str, Array], list[str]]:
    """Score (lines, samples) by the keys of the bank, and notes on it."""
    cube, local, line = place.cube, detection.local_window, place.line
    whitener = None if bank.background is None else px.whitener_of(*bank.background)
    watch = watch_lines("scores", cube.bytes_per_line, cube.lines)
    common: dict[str, Any] = {"needed": cube.axis.good, "watch": watch}
    if local is None or whitener is None:
        maps = px.score_cube(cube, bank.detectors, line, bank.bands, whitener=whitener, scenes=scenes, **common)
        return maps, []
    window = local.outer_pixels, local.inner_pixels
    surroundings = place.pixels_of(IMAGE if IMAGE in detection.background else px.SCENE)
    maps, count = px.score_cube_locally(cube, bank.forms, whitener, window, surroundings, line, bank.bands, **common)
    return maps, [said("local_window", outer=window[0], inner=window[1], lonely=count)]


class _Curves:
    """Score distributions and curves from score maps, by subject: ``products`` by their names and keys."""

    def __init__(self, place: Place, detection: Detection, bank: FilterBank):
        self.place, self.detection, self.bank = place, detection, bank
        self.alarms = place.pixels_of(*detection.false_alarms)
        self.products: dict[str, dict[Any, Any]] = {k: {} for k in ("scores", "roc", "object_scores", "exceedance")}
        self.incomplete: dict[str, None] = {}  # names of objects that lack the score of a pixel

    def background_scores(self, scores: Array, subject: str, detector: str) -> px.AlarmBlocks:
        """The scores of the background with their places; their exceedance curve is a product."""
        noise = px.AlarmBlocks.from_map(scores, self.alarms, classes=self.place.classes)
        if noise.scores.size >= px.MIN_FOR_A_CURVE:
            self.products["exceedance"][subject, detector] = px.exceedance_curve(noise)
        return noise

    def add_target(self, key: str, target: str, detector: str, groups: Groups, scores: Array) -> None:
        """Scores and curves of every subject of a target by one detector, on the score map of this key."""
        distributions, noise = self.products["scores"], self.background_scores(scores, target, detector)
        background = replace(_score_moments(noise.scores), **self._sampling_errors(key, detector, noise))
        for subject, members in groups.items():
            refuse((subject, detector) in distributions, "detection.subject", "detection.group", subject=subject)
            distributions[background_of(subject), detector] = background
            self._add_subject(subject, detector, members, scores, noise)

    def _sampling_errors(self, key: str, detector: str, noise: px.AlarmBlocks) -> dict[str, Any]:
        """Sampling errors of the background's scores, and bias of their mean for a filter made of the same pixels."""
        place, bank, detection = self.place, self.bank, self.detection
        errors = dict(zip(("mean_error", "sd_error"), noise.moment_errors, strict=True))
        if detector != "cem-correlation" or bank.background is None or bank.shrinkage or detection.local_window:
            return errors
        if not np.array_equal(place.pixels_of(*detection.background), self.alarms):
            return errors
        lines, samples = px.drawn_pixels(self.alarms, _MAX_INFLUENCES, np.random.default_rng(0))
        pixels, usable = place.pixel_values(lines, samples, bank.bands)
        weights, stratum = bank.detectors[key].weights[0], place.classes[lines, samples][usable]
        error, bias = own_mean_sampling(weights, *bank.background, pixels[usable], stratum, noise.scores.size)
        return errors | {"mean_error": error, "mean_bias": bias}

    def _add_subject(
        self, subject: str, detector: str, members: Sequence[TargetObject], scores: Array, noise: px.AlarmBlocks
    ) -> None:
        """Moments of the subject's pixels, and its curves by pixel and by object.

        An object has the greatest score over its pixels and the halo around them.  Without a halo a false alarm is a
        background pixel, and an object that lacks the score of a pixel does not count, as predictions are of whole
        objects.  With one it is a placement of an object's footprint on the background, a maximum over as
        many pixels as on the object; objects of one shape share placements.  Or it is every pixel outside the halos,
        as the MUUFL Gulfport collection is scored (Bullwinkle): that favours detection, a maximum over the halo's
        pixels against single pixels.
        """
        halo, area = self.detection.halo_pixels, self.place.pixel_area_m2
        scored = [scored_part(o, self.place) for o in members]
        pixels = np.concatenate([scores[o.window][o.part] for o in scored])
        refuse(not np.isfinite(pixels).any(), "detection.no_pixel", subject=subject)
        self.products["scores"][subject, detector] = _score_moments(pixels[np.isfinite(pixels)])
        by_object = px.object_scores(scores, scored, halo)
        lacking = [o.name for o in scored if not (halo or np.isfinite(scores[o.window][o.part]).all())]
        greatest = np.where(np.isin(list(by_object), lacking), np.nan, list(by_object.values()))
        self.incomplete |= dict.fromkeys(lacking)
        # The area searched is that of pixels with a score.
        populations = {"pixel": (pixels, noise, noise.scores.size), "object": (greatest, noise, noise.scores.size)}
        if halo:
            off_halo = self.alarms & ~px.mask_with_halo(all_pixels(scored, self.place.cube.shape), halo)
            by_pixel = px.AlarmBlocks.from_map(scores, off_halo, classes=self.place.classes)
            populations["object"] = greatest, *self._footprint_maxima(scores, scored)
            populations[BY_PIXEL] = greatest, by_pixel, by_pixel.scores.size
        else:  # the model has no halo
            self.products["object_scores"][subject, detector] = ObjectScores(greatest, tuple(by_object))
        for name, (values, background, count) in populations.items():
            if not (finite := values[np.isfinite(values)]).size:
                continue
            unit: Literal["pixel", "object"] = "pixel" if name == "pixel" else "object"
            km2 = None if area is None else count * area / 1e6
            curve = px.empirical_roc(finite, background, unit=unit, background_area_km2=km2)
            curve = px.with_areas_and_alarms(curve, finite, background)
            if self.detection.first_detection and name == "object":
                curve = replace(curve, alarms_before_first=px.alarms_before_first(pixels, noise.scores))
            self.products["roc"][subject, detector, name] = curve

    def _footprint_maxima(self, scores: Array, objects: Sequence[TargetObject]) -> tuple[px.AlarmBlocks, int]:
        """Greatest score of every placement of the objects' footprints on the background, and the pixels searched."""
        halo, setting = self.detection.halo_pixels, "detection.halo_pixels"
        shapes = {}  # objects of one shape share placements, the same pixels
        for item in objects:
            _, shape = mask_window(px.mask_with_halo(np.pad(item.part, halo), halo))
            shapes[shape.shape, shape.tobytes()] = shape
            too_large = any(np.greater(shape.shape, scores.shape))
            refuse(too_large, "detection.halo", setting, name=item.name, halo=halo, shape=scores.shape)
        parts = [px.footprint_tiles(scores, shape, ~self.alarms) for shape in shapes.values()]
        n_pixels = sum(lines.size * shape.size for (_, lines, _), shape in zip(parts, shapes.values(), strict=True))
        maxima = np.concatenate([tile.max(axis=1) for tile, _, _ in parts])
        lines, samples = (np.concatenate(part) for part in list(zip(*parts, strict=True))[1:])
        names = ", ".join(item.name for item in objects)
        refuse(maxima.size == 0, "detection.placements", setting, halo=halo, names=names)
        # Blocks as large on the ground as those of the pixels.
        side = px.block_side(int(np.count_nonzero(self.alarms)))
        return px.AlarmBlocks.from_pixels(maxima, lines, samples, side, self.place.classes[lines, samples]), n_pixels


def _add_pools(roc: dict[Any, Any], detection: Detection) -> None:
    """Curves of several subjects counted together."""
    for pool in detection.pools:
        refuse(any(pool.name == subject for subject, _, _ in roc), "pool.name", name=pool.name)
        for detector in detection.detectors:
            if lacking := [s for s in pool.subjects if (s, detector, "pixel") not in roc]:
                raise UsageError(f"pool {pool.name!r}: no curve of {', '.join(lacking)}")
            for unit in ("pixel", "object"):
                if curves := [roc[s, detector, unit] for s in pool.subjects if (s, detector, unit) in roc]:
                    roc[pool.name, detector, unit] = px.pooled_roc(curves)


def _score_moments(values: Array) -> ScoreDistribution:
    sd = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    tail = np.partition(values, values.size - _MAX_SCORES)[-_MAX_SCORES:] if values.size > _MAX_SCORES else values
    return ScoreDistribution(float(np.mean(values)), sd, int(values.size), greatest=np.sort(tail)[::-1])


def _anomaly_note(place: Place, detector: str, scores: Array, curve: ExceedanceCurve | None, n: int) -> str:
    """The strongest groups of touching pixels above the threshold that the background passes at a low rate.

    The rate is the lowest of 1e-4, 1e-3 and 1e-2 that ten background pixels or more exceed: they fix the threshold, and
    belong to the groups themselves where the background is the whole scene.
    """
    level = next((p for p in px.ANOMALY_LEVELS if p * n >= px.LEAST_EXPECTED_ALARMS), None)
    if level is None or curve is None:
        return f"{detector}: {n} background pixels are too few for a threshold of anomalies"
    threshold = float(curve.threshold[px.nearest_point(curve, level)])
    labels, count = objects(np.nan_to_num(scores, nan=-np.inf) > threshold)
    if not count:
        return f"{detector}: no pixel beyond {threshold:.4g}, which {level:g} of the background exceeds"
    sizes, words = np.bincount(labels.ravel()), list[str]()
    peaks = ndimage.maximum_position(scores, labels, np.arange(1, count + 1))
    for line, sample in sorted(peaks, key=lambda position: -scores[position])[:MAX_NAMED]:
        label, size = f"line {line}, sample {sample}", int(sizes[labels[line, sample]])
        if place.cube.transform is not None:
            x, y = place.cube.transform @ (sample + 0.5, line + 0.5)
            label += f" ({x:.2f}, {y:.2f})"
        words.append(f"{label}: {scores[line, sample]:.4g}, {size} pixel{'' if size == 1 else 's'}")
    words += [f"and {count - MAX_NAMED} weaker"] if count > MAX_NAMED else []
    facts = {"count": count, "threshold": threshold, "level": level, "strongest": "; ".join(words)}
    return said("anomalies", detector=detector, **facts)


# Sum of scores or abundances over an object, the pixels summed, the same sum elsewhere on the background, and the area
# [m2] that the object's sum stands for; NaN where sums of several objects do not show the error.
ObjectSum = tuple[float, int, Sequence[float] | Array, float]


def target_areas(
    place: Place, detection: Detection, maps: Mapping[str, Array]
) -> tuple[dict[tuple[str, str], Abundance], dict[tuple[str, str], float]]:
    """Sum of scores over each object times the pixel area, and the area that the truth states [m2].

    By subject and detector, for every check of the campaign.  The uncertainty is the spread of the same sum over
    background that has the object's footprint, or among the objects themselves about what is due to their stated areas
    where that is greater, as where they lie on the most varied ground of a scene.  Both are means over the objects of a
    subject that hold data in all of their pixels; without one the subject is not measured.
    """
    areas: dict[tuple[str, str], Abundance] = {}
    nominal: dict[tuple[str, str], float] = {}
    targets = {t.name: t for t in detection.targets}
    for check in detection.areas:
        sums = _footprint_summer(place, detection, maps[f"{check.target}-{check.detector}"], check.margin_pixels)
        for subject, members in target_groups(place.targets, targets[check.target], detection.group).items():
            sums_by_object = [sums(o) for o in members]
            measured = [total for total in sums_by_object if not math.isnan(total[0])]
            if measured:
                areas[subject, check.detector] = _area_from_sums(place, measured)
            # A truth may say where the objects are and not how large.
            if math.isfinite(area_m2 := float(np.mean([size for *_, size in measured or sums_by_object]))):
                nominal[subject, check.detector] = area_m2
    return areas, nominal


def _area_from_sums(place: Place, objects: Iterable[ObjectSum], nominal: float | None = None) -> Abundance:
    """Mean over objects of their sums, times the pixel area.

    Its error is by the sums on the background, or by those of the objects about what is due to their sizes, whichever
    is greater.

    >>> from types import SimpleNamespace
    >>> place, on_lawn = SimpleNamespace(pixel_area_m2=2.0), [-0.1, 0.0, 0.1]
    >>> def error(*sizes):
    ...     on_gravel = [(total, 9, on_lawn, size) for total, size in zip((1.3, 0.7, 1.0, 1.0), sizes, strict=True)]
    ...     return round(_area_from_sums(place, on_gravel).standard_uncertainty, 3)
    >>> error(2.0, 2.0, 2.0, 2.0), error(5.2, 2.8, 4.0, 4.0)  # sums that go by size, and are half of it
    (0.245, 0.1)
    >>> error(2.0, 2.0, 2.0, math.nan), error(0.0, 0.0, 0.0, 0.0)  # where sizes are not known, the background alone
    (0.1, 0.1)
    """
    totals, pixels, elsewhere, sizes = zip(*objects, strict=True)
    n, size, scale = len(totals), sum(sizes), needed(place.pixel_area_m2, "areas.ground") / len(totals)
    variance = sum(float(np.var(sums, ddof=1)) if len(sums) > 1 else math.nan for sums in elsewhere)
    # About what is due to their sizes: a detector that is off by a factor is not an error of single objects.
    among = n * np.var(totals - np.multiply(sizes, sum(totals) / size), ddof=1) if n > 1 and size > 0 else math.nan
    return Abundance(sum(totals) * scale, math.sqrt(np.fmax(variance, among)) * scale, sum(pixels), nominal)


def _footprint_summer(
    place: Place, detection: Detection, scores: Array, margin: int
) -> Callable[[TargetObject], ObjectSum]:
    """Function that sums a score map over an object with its margin, and over its footprint on the background."""
    targets = all_pixels(place.targets, place.cube.shape)
    # A background of "image" holds the targets too; their sums are not errors.
    excluded = ~(place.pixels_of(*detection.background) & ~place.near_targets)
    background_sums: dict[tuple[tuple[int, ...], bytes], Array] = {}  # by shape of the footprint

    def object_sum(item: TargetObject) -> ObjectSum:
        window = window_of(item.mask, (margin, margin))
        mask = item.mask[window]
        footprint = px.mask_with_halo(mask, margin) & (~targets[window] | mask)  # without other targets
        _, shape = mask_window(footprint)
        key = shape.shape, shape.tobytes()
        if key not in background_sums:
            background_sums[key] = px.footprint_tiles(scores, shape, excluded)[0].sum(axis=1)
        return float(np.sum(scores[window][footprint])), int(footprint.sum()), background_sums[key], item.area_m2

    return object_sum


METHODS = {"equal": "fcls", "background": "fcls-weighted"}
PLACES = 60  # placements on the background, whose sums give the error


class _Footprints(NamedTuple):
    """The footprint of an object: first on the object, then on places of the background.

    Attributes
    ----------
    pixels : (N, F) reflectance of the pixels of all footprints
    place : (N,) footprint that each belongs to
    background : (P, F) mean reflectance around each footprint
    ring, complete : pixels around the object; whether all of the object's hold data
    """

    pixels: Array
    place: Index
    background: Array
    ring: int
    complete: bool


def unmix(place: Place, detection: Detection, task: Unmixing, bands: Mask, resolve: Resolve) -> UnmixedAreas:
    """Area of every target object from the sum of its abundances over the pixels that may hold a part of it.

    The uncertainty is the spread of the same sum over footprints laid at random on the background, which have
    their own surroundings as endmember: it holds the background's spread with its correlation on the ground.

    Raises
    ------
    UsageError : names that do not fit, or a cube without ground size of its pixels.
    InputError : an object without background around it.
    """
    pixel_area, region = needed(place.pixel_area_m2, "areas.ground"), place.pixels_of(task.background)
    covariance = place.in_reflectance(place.statistics[task.background])[1][np.ix_(bands, bands)]
    noise = {METHODS[w]: None if w == "equal" else PositiveDefinite(covariance) for w in task.weights}
    targets = {t.name: t for t in detection.targets}
    sources, rng = Sources(place.cube.axis, {}, resolve), np.random.default_rng(task.seed)
    footprints: dict[str, _Footprints] = {}
    areas: dict[tuple[str, str], Abundance] = {}
    subjects: list[UnmixedSubject] = []
    for item in track(task.targets, "unmixing"):
        target, spectrum = targets[item.target], sources.spectrum(targets[item.target].spectrum, item.target).mean
        # Names of the scenario's populations for the subjects.
        counterpart = target.model_copy(update={"name": item.scenario_target or item.target})
        populations = target_groups(place.targets, counterpart, detection.group)
        groups = target_groups(place.targets, target, detection.group)
        for (subject, members), population in zip(groups.items(), populations, strict=True):
            for o in members:
                refuse(not math.isfinite(o.area_m2), "unmixing.size", "detection.unmixing", subject=subject)
                if o.name not in footprints:
                    footprints[o.name] = _draw_footprints(place, o, region, task, bands, rng)
            members = [o for o in members if footprints[o.name].complete]
            if not members:  # none holds data in all of its pixels
                continue
            valid, nominal = [footprints[o.name] for o in members], float(np.mean([o.area_m2 for o in members]))
            for method, weights in noise.items():
                sums = (_abundance_sum(f, spectrum[bands], weights) for f in valid)
                areas[subject, unmixing_method(method, item.endmembers)] = _area_from_sums(place, sums, nominal)
            subjects.append(
                UnmixedSubject(
                    subject, population, counterpart.name, spectrum, item.relative_uncertainty, item.correlation_nm,
                    item.endmembers, len(members), nominal, int(np.mean([f.ring for f in valid])),
                )
            )  # fmt: skip
    return UnmixedAreas(areas, tuple(subjects), bands, noise, pixel_area)


def _abundance_sum(footprints: _Footprints, spectrum: Array, noise: PositiveDefinite | None) -> ObjectSum:
    """Sum of the abundances of a spectrum on the object, and on each background placement."""
    endmembers = np.stack([np.broadcast_to(spectrum, footprints.background.shape), footprints.background], axis=1)
    abundances = fully_constrained(footprints.pixels, endmembers[footprints.place], noise)[:, 0]
    area, *elsewhere = np.bincount(footprints.place, abundances, minlength=len(footprints.background)).tolist()
    return area, int(np.count_nonzero(footprints.place == 0)), elsewhere, math.nan


def _draw_footprints(
    place: Place, target: TargetObject, region: Mask, task: Unmixing, bands: Mask, rng: np.random.Generator
) -> _Footprints:
    """Pixels of the object and of random placements whose whole footprint lies on the region."""
    footprint, size = np.pad(target.part, task.ring_pixels), target.part.shape
    ring_mask = (ndimage.distance_transform_edt(~footprint) <= task.ring_pixels) & ~footprint
    inner, ring = (np.argwhere(mask) - task.ring_pixels for mask in (footprint, ring_mask))  # from the corner on
    choices = np.argwhere(ndimage.binary_erosion(region, target.part, origin=(-(size[0] // 2), -(size[1] // 2))))
    corners = [np.array(target.corner), *choices[rng.choice(len(choices), min(PLACES, len(choices)), replace=False)]]
    parts: list[Index] = []
    for corner in corners:
        ring_pixels = ring + corner
        ring_pixels = ring_pixels[np.all((ring_pixels >= 0) & (ring_pixels < region.shape), axis=1)]
        parts += [inner + corner, ring_pixels[region[tuple(ring_pixels.T)]]]
    # One read of all pixels, each line once.
    flat = [np.ravel_multi_index(tuple(part.T), region.shape) for part in parts]
    unique, index = np.unique(np.concatenate(flat), return_inverse=True)
    values, usable = place.pixel_values(*np.divmod(unique, region.shape[1]), bands)
    read = [values[k[usable[k]]] for k in np.split(index, np.cumsum([f.size for f in flat])[:-1])]
    if not len(read[1]):
        raise refusal("unmixing.ring", name=target.name, background=task.background, ring_pixels=task.ring_pixels)
    pairs = list(zip(read[::2], read[1::2], strict=True))
    pairs = pairs[:1] + [(x, r) for x, r in pairs[1:] if len(r) and len(x) == len(inner)]
    number = np.repeat(np.arange(len(pairs)), [len(x) for x, _ in pairs])
    means = np.array([r.mean(axis=0) for _, r in pairs])
    return _Footprints(np.concatenate([x for x, _ in pairs]), number, means, len(read[1]), len(read[0]) == len(inner))

"""From a collection to its products: open, measure the pixels of every label in one pass, compensate, detect."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.collection import Classification, CollectionSection, Detection, DetectionTarget
from hyperval.data import ClassStatistics, SampleStatistics
from hyperval.imagery import Cube
from hyperval.observe.detect import BACKGROUND, Detected, Unmixed, detect, painted, scored_pixels, target_groups, unmix
from hyperval.observe.laws import RegionLaws, classification_errors, mean_error, pixel_tails
from hyperval.observe.open import IMAGE, Place, check_line_for_detection, open_place
from hyperval.observe.sites import (
    calibration_covariance,
    empirical_line,
    line_notes,
    observe_radcalnet,
    observe_spectra,
    refuse_saturated,
    rounding_variance,
    spectral_estimate,
    wavelength_notes,
)
from hyperval.pixels import LEAST_DOF, SCENE, EmpiricalLine, Labels, nth_pixels, region_statistics, snr_decorrelated
from hyperval.products import EstimatedPart, ObservedProducts, PixelDistribution, SpectralEstimate
from hyperval.progress import track, watch_lines

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Resolve = Callable[[str], Path]

CIRCULAR = "the empirical line goes through this panel whatever it reflects: no degree of freedom is left"
# At most this many pixels of a region are held in memory for its SNR.
MAX_SNR_PIXELS = 20_000
MAX_SNR_NUMBERS = 2_000_000  # pixels times bands


@dataclass(frozen=True, eq=False)
class Surfaces:
    """What a collection says of its surfaces: it follows from their pixels, whatever is detected among them.

    Attributes
    ----------
    place : the opened collection with its empirical line, None where there is no cube
    masks, sampling, distribution : subject -> its pixels, the error of their mean in the cube's values, their tails
    """

    place: Place | None = None
    masks: Labels = field(default_factory=lambda: Labels.of((0, 0)))
    sampling: Mapping[str, EstimatedPart] = field(default_factory=dict)
    distribution: Mapping[str, PixelDistribution] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Observed:
    """An observation with what only the imagery can give.

    Attributes
    ----------
    observation : the products
    statistics : region -> mean and covariance in reflectance (after the empirical line), for scenarios that
        take measured statistics
    surfaces : what does not follow from the detection
    detected : filters and score maps, None without detection
    unmixed : areas by unmixing with what a prediction of them needs, None where they are not asked for
    """

    observation: ObservedProducts
    statistics: Mapping[str, ClassStatistics] = field(default_factory=dict)
    surfaces: Surfaces = field(default_factory=Surfaces)
    detected: Detected | None = None
    unmixed: Unmixed | None = None

    @property
    def place(self) -> Place | None:
        """The opened collection, None where there is no cube."""
        return self.surfaces.place

    @property
    def elm(self) -> EmpiricalLine | None:
        """The empirical line, None without panels."""
        return None if self.place is None else self.place.line

    def laws(self) -> RegionLaws:
        """The laws of the regions' pixels, fitted when a scenario asks for them."""
        return RegionLaws(self.place, self.statistics)


def observe(
    collection: CollectionSection,
    detection: Detection | None,
    resolve: Resolve,
    *,
    classification: Classification | None = None,
    before: Surfaces | None = None,
    show_progress: bool | None = None,
) -> Observed:
    """Measure what a collection holds.

    Parameters
    ----------
    collection, detection, classification : as in a campaign file; a simulated collection must have been
        written first and stands here as its cube
    resolve : turns a file reference into a path
    before : of the same collection, observed for another detection

    Raises
    ------
    InputError, MissingDataError : files that are missing or corrupt.
    UsageError : names and settings that do not fit.
    """
    if collection.radcalnet is not None:
        return Observed(observe_radcalnet(collection.radcalnet, resolve))
    if collection.spectra:
        return Observed(observe_spectra(collection, resolve))
    before = before or Surfaces()
    place = before.place or open_place(collection, resolve, show_progress=show_progress)
    cube = place.cube
    masks, populations = _labels(place, detection)
    known = {n for n in before.masks if n in masks and np.array_equal(before.masks[n], masks[n])}
    refuse_saturated(collection.empirical_line, masks, place)
    watch = watch_lines("statistics", cube.bytes_per_line, cube.lines, show=show_progress)
    measured = region_statistics(cube, masks, watch=watch)
    sampling = {
        n: before.sampling[n] if n in known else _sampling_error(place, masks[n], measured[n])
        for n in track([*place.regions, *populations], "sampling", show=show_progress)
    }
    place = replace(place, statistics=measured)
    line = place.line or empirical_line(collection.empirical_line, place, sampling, resolve)
    place = replace(place, line=line)
    detected, unmixed = None, None
    if detection is not None:
        if detection.targets:  # anomalies are the same in radiance
            check_line_for_detection(place, collection)
        detected = detect(place, detection, resolve, show_progress=show_progress)
        if detection.unmixing is not None:
            unmixed = unmix(place, detection, detection.unmixing, detected.bank.bands, resolve, show=show_progress)
    products: dict[str, Any] = _spectra(place, collection, sampling, resolve)
    products |= {kind: dict(found) for kind, found in detected.products.items()} if detected else {}
    if unmixed is not None:
        products["abundance"] |= unmixed.areas
    distribution = {name: d for name, d in before.distribution.items() if name in known}
    for name in track([n for n in place.regions if n not in known], "tails", show=show_progress):
        tails = None if place.by_number else pixel_tails(place, masks[name], measured[name])
        distribution |= {} if tails is None else {name: tails}
    snr = {name: snr_decorrelated(_some_pixels(place, name)) for name in collection.snr_regions}
    observation = ObservedProducts(
        axis=cube.axis,
        snr=snr,
        distribution=distribution,
        classification=classification_errors(place, classification) if classification else {},
        notes=_notes(place, detection, detected, masks),
        provenance={"quantity": cube.quantity, "description": cube.description},
        **products,
    )
    classes = _classes(place, detection, detected, distribution)
    return Observed(observation, classes, Surfaces(place, masks, sampling, distribution), detected, unmixed)


def _labels(place: Place, detection: Detection | None) -> tuple[Labels, list[str]]:
    """Every population whose statistics are asked for, as one label image; and the subjects of targets among them."""
    # All pixels of a region count where none would be left.
    members = {n: place.counted(n) if place.counted(n).any() else own for n, own in place.regions.members.items()}
    members[SCENE] = place.in_scene
    populations: dict[str, Mask] = {}
    if detection is not None:
        members[BACKGROUND] = place.background_labels(detection.background)
        populations = dict(_target_pixels(place, detection, taken=set(members)))
    return Labels(place.labels.number, members).with_masks(populations.items()), list(populations)


def _target_pixels(place: Place, detection: Detection, taken: set[str]) -> Iterator[tuple[str, Mask]]:
    """Pixels of every target subject with at least two of them, for its mean spectrum.

    Several spectra may stand for one material; their subjects hold the same pixels, and the first one counts.
    """
    first: dict[str, DetectionTarget] = {}
    for target in detection.targets:
        first.setdefault(target.material, target)
    for target in first.values():
        for subject, members in target_groups(place.targets, target, detection.group).items():
            union = painted((scored_pixels(item, place) for item in members), place.cube.shape)
            if subject not in taken and np.count_nonzero(union) > 1:
                yield subject, union


def _sampling_error(place: Place, region: Mask, sample: SampleStatistics) -> EstimatedPart:
    """The error of a mean, with that of values which are stored as whole steps."""
    sampling, cube = mean_error(place, region, sample), place.cube
    if cube.dtype.kind not in "iu" or sample.n < 2:
        return sampling
    spread = np.sqrt(np.clip(np.diag(sample.covariance), 0.0, None))
    rounding = np.diag(rounding_variance(np.abs(cube.gain), spread))
    return sampling.of_each(lambda c: c + rounding)


def _notes(
    place: Place, detection: Detection | None, detected: Detected | None, masks: Mapping[str, Mask]
) -> tuple[str, ...]:
    """What is to be said of an observation."""
    axis, notes, measured = place.cube.axis, list(place.notes), place.statistics
    if not place.by_number:
        means = [measured[name].mean for name in place.regions or (SCENE,)]
        notes += wavelength_notes(means, axis, reflectance=place.cube.quantity == "reflectance")
    if detection is not None:
        # How the pixels behind filter, false alarms and classes differ, where they do.
        filters, alarms = masks[BACKGROUND], place.background(detection.false_alarms)
        if not np.array_equal(filters, alarms):
            notes.append(
                f"the filters have their statistics from {int(filters.sum())} pixels "
                f"({', '.join(detection.background)}), false alarms are counted on {int(alarms.sum())} "
                f"({', '.join(detection.false_alarms)})"
            )
        if IMAGE in detection.background:
            within = int((filters & place.near_targets).sum())
            notes.append(
                f"{within} pixels of targets and their guard are in the filters' statistics, and in no class's"
            )
    notes += [
        f"warning: region {name!r} is a single pixel: how far pixels differ is not known and in no interval"
        for name in place.regions
        if measured[name].n == 1
    ]
    notes += [] if place.line is None else line_notes(place.line, axis)
    return (*notes, *(detected.notes if detected else ()))


def _spectra(
    place: Place, collection: CollectionSection, sampling: Mapping[str, EstimatedPart], resolve: Resolve
) -> dict[str, dict[str, SpectralEstimate]]:
    """Radiance and reflectance of every subject by its statistics and the error of their mean."""
    cube, stated = place.cube, collection.calibration
    own, reflectance = {}, {}
    for name, error in sampling.items():
        sample, parts = place.statistics[name], dict[str, Array]()
        if stated is not None and cube.quantity == "radiance":
            parts["calibration"] = calibration_covariance(sample.mean, cube.axis, stated, resolve)
        own[name] = _estimate(cube, None, sample, error, parts)
        if place.line is not None and cube.quantity == "radiance":
            reflectance[name] = _reflectance(cube, place.line, name, sample, error)
    return {"radiance": own, "reflectance": reflectance} if cube.quantity == "radiance" else {"reflectance": own}


def _reflectance(
    cube: Cube, line: EmpiricalLine, name: str, sample: SampleStatistics, sampling: EstimatedPart
) -> SpectralEstimate:
    """After the empirical line, whose error is common to all pixels and hangs together between bands.

    A panel of the line is no evidence for it: its reflectance is that of the line through the other panels.  Where
    they fix none, the line goes through the panel whatever it reflects.
    """
    others = line.without(name) if name in line.names else line
    if others is None:
        own = {"empirical line": line.error_covariance(sample.mean, own=name)}
        return _estimate(cube, line, sample, None, own, circular=CIRCULAR)
    parts = {"empirical line": others.error_covariance(sample.mean)}
    return _estimate(cube, others, sample, sampling, parts, others.estimated(sample.mean))


def _estimate(
    cube: Cube,
    line: EmpiricalLine | None,
    sample: SampleStatistics,
    sampling: EstimatedPart | None,
    parts: Mapping[str, Array],
    estimated: tuple[EstimatedPart, ...] = (),
    circular: str = "",
) -> SpectralEstimate:
    """A mean after the line, if any, with the error of its sampling and the other ``parts``."""
    mean, gain = (sample.mean, np.ones(cube.bands)) if line is None else (line.reflectance(sample.mean), line.gain)
    scale = np.outer(gain, gain)
    if sampling is not None and sample.n > 1:
        sampling = sampling.of_each(lambda c: c / scale)
        parts, estimated = {"sampling": sampling.covariance, **parts}, (sampling, *estimated)
    return spectral_estimate(
        mean, parts, pixel_covariance=sample.covariance / scale if sample.n > 1 else None, n=sample.n,
        estimated=estimated, circular=circular,
        rounding=cube.gain**2 / 12.0 / gain**2 if cube.dtype.kind in "iu" else 0.0,
    )  # fmt: skip


def _some_pixels(place: Place, name: str) -> Array:
    """Valid pixels (n, B) of a region, evenly thinned to what memory should hold."""
    region = place.region(name)
    count = int(np.count_nonzero(region))
    step = -(-count // min(MAX_SNR_PIXELS, MAX_SNR_NUMBERS // place.cube.bands))
    lines, samples = nth_pixels(region, np.arange(0, count, step))
    del region  # a byte a pixel
    values, n = np.empty((lines.size, place.cube.bands)), 0
    for part, _ in place.valid_pixels(lines, samples):
        values[n : n + len(part)] = part
        n += len(part)
    return values[:n]


def _classes(
    place: Place,
    detection: Detection | None,
    detected: Detected | None,
    distribution: Mapping[str, PixelDistribution],
) -> dict[str, ClassStatistics]:
    """Statistics of each region in reflectance; none where the image holds radiance without a line."""
    if place.cube.quantity == "radiance" and place.line is None:
        return {}
    # The filter of the model is to be made of the covariance that the filter of the image was made of.
    shrinkage = 0.0 if detected is None else detected.bank.shrinkage
    shrunk = detection.background if detection is not None and shrinkage > 0.0 else ()
    out = {}
    for name in place.regions:
        sample = place.statistics[name]
        mean, covariance = place.in_reflectance(sample.shrunk(shrinkage) if name in shrunk else sample)
        # A band without a gain has no reflectance; the detectors do not use it either.
        known = np.isfinite(mean)
        mean, covariance = np.where(known, mean, 0.0), np.where(np.outer(known, known), covariance, 0.0)
        # Of the surface itself: over all bands noise dilutes what makes false alarms.
        tail = distribution[name].leading_tail_dof if name in distribution else np.inf
        out[name] = ClassStatistics(
            name, place.cube.axis, mean, (covariance + covariance.T) / 2.0, sample.n,
            f"{sample.n} pixels of region {name}", max(tail, LEAST_DOF) if np.isfinite(tail) else None,
        )  # fmt: skip
    return out

"""The empirical pipeline: open, measure, compensate, detect."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from dataclasses import field as attribute
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.collection import Classification, CollectionSection, Detection
from hyperval.data import ClassStatistics, SampleStatistics
from hyperval.observe.detection import (
    BACKGROUND,
    Detected,
    Unmixed,
    detect,
    in_reflectance,
    scored_pixels,
    target_groups,
    unmix,
)
from hyperval.observe.place import IMAGE, Place, check_line_for_detection, open_place
from hyperval.observe.site_spectra import (
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
from hyperval.observe.spread import RegionLaws, classification_errors, mean_error, pixel_distances
from hyperval.pixels import LEAST_DOF, SCENE, EmpiricalLine, Labels, nth_pixels, region_statistics, snr_decorrelated
from hyperval.products import EstimatedPart, ObservedProducts, PixelDistribution, SpectralEstimate
from hyperval.progress import track, watch_lines
from hyperval.spectra.axis import SpectralAxis

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
    place : the opened collection, None where there is no cube
    line : the empirical line, None without panels
    masks, sampling, distribution : subject -> its pixels, the error of their mean in the cube's values, their tails
    """

    place: Place | None = None
    line: EmpiricalLine | None = None
    masks: Labels = attribute(default_factory=lambda: Labels.of((0, 0)))
    sampling: Mapping[str, EstimatedPart] = attribute(default_factory=dict)
    distribution: Mapping[str, PixelDistribution] = attribute(default_factory=dict)


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
    statistics: Mapping[str, ClassStatistics] = attribute(default_factory=dict)
    surfaces: Surfaces = attribute(default_factory=Surfaces)
    detected: Detected | None = None
    unmixed: Unmixed | None = None

    @property
    def place(self) -> Place | None:
        """The opened collection, None where there is no cube."""
        return self.surfaces.place

    @property
    def elm(self) -> EmpiricalLine | None:
        """The empirical line, None without panels."""
        return self.surfaces.line

    def laws(self) -> RegionLaws:
        """The laws of the regions' pixels, fitted when a scenario asks for them."""
        return RegionLaws(self.place, self.elm, self.statistics)


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
    # All pixels of a region count where none would be left.
    members = {n: place.counted(n) if place.counted(n).any() else own for n, own in place.regions.members.items()}
    members[SCENE] = place.in_scene
    populations: dict[str, Mask] = {}
    if detection is not None:
        members[BACKGROUND] = place.background_labels(detection.background)
        populations = dict(_target_pixels(place, detection, taken=set(members)))
    masks = Labels(place.labels.number, members).with_masks(populations.items())
    known = {n for n in before.masks if n in masks and np.array_equal(before.masks[n], masks[n])}
    refuse_saturated(collection.empirical_line, masks, cube)
    watch = watch_lines("statistics", cube.bytes_per_line, cube.lines, show=show_progress)
    measured = region_statistics(cube, masks, watch=watch)
    regions = {name: measured[name] for name in place.regions}
    subjects = regions | {name: measured[name] for name in populations}
    sampling = {
        name: before.sampling[name] if name in known else _with_rounding(place, s, mean_error(place, masks[name], s))
        for name, s in track(list(subjects.items()), "sampling", show=show_progress)
    }
    elm = before.line or empirical_line(collection.empirical_line, measured, sampling, cube, resolve)

    spectra = {name: (sample, sampling[name]) for name, sample in subjects.items()}
    detected, unmixed = None, None
    if detection is not None:
        if detection.targets:  # anomalies are the same in radiance
            check_line_for_detection(place, collection)
        detected = detect(place, detection, measured, elm, resolve, show_progress=show_progress)
        if detection.unmixing is not None:
            bands = detected.bank.bands
            unmixed = unmix(place, detection, measured, elm, bands, resolve, show_progress=show_progress)
    products: dict[str, Any] = _spectra(place, collection, spectra, elm, resolve)
    products |= {kind: dict(found) for kind, found in detected.products.items()} if detected else {}
    if unmixed is not None:
        products["abundance"] |= unmixed.areas
    distances = {
        name: pixel_distances(place, masks[name], measured[name])
        for name in track(sorted(set(regions) - known, key=list(regions).index), "tails", show=show_progress)
        if not place.by_number
    }
    distribution = {name: d for name, d in before.distribution.items() if name in known}
    distribution |= {name: d.distribution() for name, d in distances.items() if d is not None}
    observation = ObservedProducts(
        axis=cube.axis,
        snr={name: snr_decorrelated(_some_pixels(place, name)) for name in collection.snr_regions},
        distribution=distribution,
        classification=classification_errors(place, classification) if classification else {},
        notes=_notes(place, detection, detected, measured, masks, elm),
        provenance={"quantity": cube.quantity, "description": cube.description},
        **products,
    )
    # The filter of the model is to be made of the covariance that the filter of the image was made of.
    if detection is not None and detected is not None and detected.bank.shrinkage > 0.0:
        shrinkage = detected.bank.shrinkage
        regions |= {n: s.shrunk(shrinkage) for n, s in regions.items() if n in detection.background}
    # Of the surface itself: over all bands noise dilutes what makes false alarms.
    tails = {n: d.leading_tail_dof for n, d in distribution.items() if np.isfinite(d.leading_tail_dof)}
    classes = _classes(regions, cube.axis, elm, cube.quantity, tails)
    return Observed(observation, classes, Surfaces(place, elm, masks, sampling, distribution), detected, unmixed)


def _notes(
    place: Place,
    detection: Detection | None,
    detected: Detected | None,
    measured: Mapping[str, SampleStatistics],
    masks: Mapping[str, Mask],
    elm: EmpiricalLine | None,
) -> tuple[str, ...]:
    """What is to be said of an observation."""
    axis, notes = place.cube.axis, list(place.notes)
    if not place.by_number:
        means = [measured[name].mean for name in place.regions or (SCENE,)]
        notes += wavelength_notes(means, axis, reflectance=place.cube.quantity == "reflectance")
    if detection is not None:
        notes += _population_notes(place, detection, masks)
    notes += [
        f"warning: region {name!r} is a single pixel: how far pixels differ is not known and in no interval"
        for name in place.regions
        if measured[name].n == 1
    ]
    notes += [] if elm is None else line_notes(elm, axis)
    return (*notes, *(detected.notes if detected else ()))


def _with_rounding(place: Place, sample: SampleStatistics, sampling: EstimatedPart) -> EstimatedPart:
    """The error of a mean with that of values which are stored as whole steps."""
    cube = place.cube
    if cube.dtype.kind not in "iu" or sample.n < 2:
        return sampling
    spread = np.sqrt(np.clip(np.diag(sample.covariance), 0.0, None))
    rounding = np.diag(rounding_variance(np.abs(cube.gain), spread))
    return sampling.of_each(lambda c: c + rounding)


def _population_notes(place: Place, detection: Detection, masks: Mapping[str, Mask]) -> list[str]:
    """How the pixels behind filter, false alarms and classes differ, where they do."""
    filters, alarms = masks[BACKGROUND], place.background(detection.false_alarms)
    notes = []
    if not np.array_equal(filters, alarms):
        notes.append(
            f"the filters have their statistics from {int(filters.sum())} pixels "
            f"({', '.join(detection.background)}), false alarms are counted on {int(alarms.sum())} "
            f"({', '.join(detection.false_alarms)})"
        )
    if IMAGE in detection.background:
        within = int((filters & place.near_targets).sum())
        notes.append(f"{within} pixels of targets and their guard are in the filters' statistics, and in no class's")
    return notes


def _target_pixels(place: Place, detection: Detection, taken: set[str]) -> Iterator[tuple[str, Mask]]:
    """Pixels of every target subject with at least two of them, for its mean spectrum.

    Several spectra may stand for one material; their subjects hold the same pixels, and the first one counts.
    """
    materials: set[str] = set()
    for target in detection.targets:
        if target.material in materials:
            continue
        materials.add(target.material)
        for subject, members in target_groups(place.targets, target, detection.group).items():
            union = np.zeros(place.cube.shape, bool)
            for item in members:
                (line, sample), part = scored_pixels(item, place)
                union[line : line + part.shape[0], sample : sample + part.shape[1]] |= part
            if subject not in taken and np.count_nonzero(union) > 1:
                yield subject, union


def _spectra(
    place: Place,
    collection: CollectionSection,
    subjects: Mapping[str, tuple[SampleStatistics, EstimatedPart]],
    elm: EmpiricalLine | None,
    resolve: Resolve,
) -> dict[str, Any]:
    """Radiance and reflectance of every subject by its statistics and the error of their mean."""
    cube, stated = place.cube, collection.calibration
    rounding = cube.gain**2 / 12.0 if cube.dtype.kind in "iu" else 0.0
    if cube.quantity != "radiance":
        return {"reflectance": {n: _estimate(s, None, sampling, {}, rounding) for n, (s, sampling) in subjects.items()}}
    radiance, reflectance = {}, {}
    for name, (sample, sampling) in subjects.items():
        parts = {}
        if stated is not None:
            parts["calibration"] = calibration_covariance(sample.mean, cube.axis, stated, resolve)
        radiance[name] = _estimate(sample, None, sampling, parts, rounding)
        if elm is not None:
            reflectance[name] = _reflectance(name, sample, sampling, elm, rounding)
    return {"radiance": radiance, "reflectance": reflectance}


def _reflectance(
    name: str, sample: SampleStatistics, sampling: EstimatedPart, line: EmpiricalLine, rounding: Array | float
) -> SpectralEstimate:
    """After the empirical line, whose error is common to all pixels and hangs together between bands.

    A panel of the line is no evidence for it: its reflectance is that of the line through the other panels.  Where
    they fix none, the line goes through the panel whatever it reflects.
    """
    others = line.without(name) if name in line.names else line
    if others is None:
        own = {"empirical line": line.error_covariance(sample.mean, own=name)}
        return _estimate(sample, line, None, own, rounding, circular=CIRCULAR)
    gains, parts = np.outer(others.gain, others.gain), {"empirical line": others.error_covariance(sample.mean)}
    scaled = sampling.of_each(lambda c: c / gains)
    return _estimate(sample, others, scaled, parts, rounding, others.estimated(sample.mean))


def _estimate(
    sample: SampleStatistics,
    elm: EmpiricalLine | None,
    sampling: EstimatedPart | None,
    parts: Mapping[str, Array],
    rounding: Array | float,
    estimated: tuple[EstimatedPart, ...] = (),
    circular: str = "",
) -> SpectralEstimate:
    """A mean in the cube's own values, or after a line, with the error of its sampling and the other ``parts``."""
    mean, spread = in_reflectance(sample, elm)
    if sampling is not None and sample.n > 1:
        parts, estimated = {"sampling": sampling.covariance, **parts}, (sampling, *estimated)
    return spectral_estimate(
        mean, parts, pixel_covariance=spread if sample.n > 1 else None, n=sample.n, estimated=estimated,
        circular=circular, rounding=rounding if elm is None else rounding / elm.gain**2,
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
    regions: Mapping[str, SampleStatistics],
    axis: SpectralAxis,
    elm: EmpiricalLine | None,
    quantity: str,
    tails: Mapping[str, float],
) -> dict[str, ClassStatistics]:
    """Statistics of each region in reflectance; none where the image holds radiance without a line."""
    if quantity == "radiance" and elm is None:
        return {}
    out = {}
    for name, sample in regions.items():
        mean, covariance = in_reflectance(sample, elm)
        known = np.isfinite(mean)
        if not known.all():
            # A band without a gain has no reflectance; the detectors do not use it either.
            mean = np.where(known, mean, 0.0)
            covariance = np.where(np.outer(known, known), covariance, 0.0)
        tail = max(tails[name], LEAST_DOF) if name in tails else None
        source = f"{sample.n} pixels of region {name}"
        out[name] = ClassStatistics(name, axis, mean, (covariance + covariance.T) / 2.0, sample.n, source, tail)
    return out

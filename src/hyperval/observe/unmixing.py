"""Areas of the target objects by unmixing their pixels: endmembers are the target and the background around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hyperval.collection import Detection, DetectionTarget, UnmixedTarget, Unmixing
from hyperval.errors import InputError, UsageError
from hyperval.imagery.truth import TargetObject
from hyperval.observe.filter_bank import in_reflectance
from hyperval.observe.objects import target_groups
from hyperval.observe.place import Place
from hyperval.prediction.inputs import Sources
from hyperval.prediction.unmixing import UnmixedSubject, labelled
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.filters import PositiveDefinite
from hyperval.processing.sample import SampleStatistics
from hyperval.processing.unmixing import fully_constrained, whitened
from hyperval.products import Abundance
from hyperval.progress import track

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
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
class _Surroundings:
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
    surroundings_of: dict[str, _Surroundings] = {}
    areas: dict[tuple[str, str], Abundance] = {}
    subjects: list[UnmixedSubject] = []
    work = [
        (item, target, *parts) for item, target in chosen for parts in _subjects(place, detection, item, target)
    ]
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
    around: list[_Surroundings], spectrum: Array, noise: PositiveDefinite | None, pixel_area: float, nominal: float
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
) -> _Surroundings:
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
    return _Surroundings(pixels, place_of, np.array([r.mean(axis=0) for _, r in whole]), ring)


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
    values, usable = place.cube.marked_pixels(at)
    reflectance = (values if elm is None else elm.reflectance(values))[:, bands]
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

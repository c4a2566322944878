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
from hyperval.observe.detection import in_reflectance, target_groups
from hyperval.observe.place import Place
from hyperval.prediction.inputs import Sources
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.filters import PositiveDefinite
from hyperval.processing.sample import SampleStatistics
from hyperval.processing.unmixing import fully_constrained
from hyperval.products import Abundance
from hyperval.progress import track

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

METHODS = {"equal": "fcls", "background": "fcls-weighted"}
PLACES = 60  # of the background, at which the same sum is taken for its error


@dataclass(frozen=True, eq=False)
class UnmixedSubject:
    """What a prediction of one subject's area must know.

    Attributes
    ----------
    subject : its name in the products
    population, scenario_target : the population and the target of the scenario that stand for it
    spectrum : (B,) the target's endmember [1]
    relative_uncertainty, correlation_nm : of it, as a picture of the target
    objects : number of objects that the area is the mean of
    nominal_m2 : their area as the truth states it
    ring : pixels behind the local background
    """

    subject: str
    population: str
    scenario_target: str
    spectrum: Array
    relative_uncertainty: float
    correlation_nm: float | None
    objects: int
    nominal_m2: float
    ring: int


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
    """Reflectance (n, F) of an object's pixels and mean (F,) of the background around; the same elsewhere."""

    pixels: Array
    background: Array
    ring: int
    elsewhere: list[tuple[Array, Array]]


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
    region = place.region(task.background) & ~place.near_targets
    covariances: dict[str, Array | None] = {}
    for weights in task.weights:
        _, covariance = in_reflectance(measured[task.background], elm)
        covariances[METHODS[weights]] = None if weights == "equal" else covariance[np.ix_(bands, bands)]
    noise = {name: None if c is None else PositiveDefinite(c) for name, c in covariances.items()}
    chosen = [(item, _named(detection, item.target)) for item in task.targets]
    sources = Sources(place.cube.axis, {}, resolve)
    spectra = {t.name: sources.spectrum(t.spectrum, t.name).mean for _, t in chosen}
    rng = np.random.default_rng(task.seed)
    held: dict[str, _Surroundings] = {}
    areas: dict[tuple[str, str], Abundance] = {}
    subjects: list[UnmixedSubject] = []
    work = [
        (item, target, *found) for item, target in chosen for found in _subjects(place, detection, item, target)
    ]
    for item, target, subject, population, members in track(work, "unmixing", show=show_progress):
        for o in members:
            if o.name not in held:
                held[o.name] = _surroundings(place, o, region, task, elm, bands, rng)
        around = [held[o.name] for o in members]
        nominal = float(np.mean([o.area_m2 for o in members]))
        spectrum = spectra[target.name][bands]
        for method, factor in noise.items():
            areas[subject, method] = _area(around, spectrum, factor, place.pixel_area_m2, nominal)
        subjects.append(
            UnmixedSubject(
                subject, population, item.scenario_target or item.target, spectra[target.name],
                item.relative_uncertainty, item.correlation_nm, len(members), nominal,
                int(np.mean([s.ring for s in around])),
            )
        )  # fmt: skip
    return Unmixed(areas, tuple(subjects), bands, covariances, place.pixel_area_m2)


def _area(
    around: list[_Surroundings], spectrum: Array, noise: PositiveDefinite | None, pixel_area: float, nominal: float
) -> Abundance:
    total, variance, n = 0.0, 0.0, 0
    for s in around:
        total += _sum(s.pixels, spectrum, s.background, noise)
        n += s.pixels.shape[0]
        sums = [_sum(pixels, spectrum, mean, noise) for pixels, mean in s.elsewhere]
        variance += float(np.var(sums, ddof=1)) if len(sums) > 1 else float("nan")
    count = len(around)
    return Abundance(total / count * pixel_area, float(np.sqrt(variance)) / count * pixel_area, n, nominal)


def _sum(pixels: Array, spectrum: Array, background: Array, noise: PositiveDefinite | None) -> float:
    return float(fully_constrained(pixels, np.stack([spectrum, background]), noise)[:, 0].sum())


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
    at = lines + target.corner[0], samples + target.corner[1]
    mean, ring = _ring_mean(place, at, region, task.ring_pixels, elm, bands)
    if mean is None:
        raise InputError(
            f"target {target.name!r} has no pixel of {task.background!r} within {task.ring_pixels} pixels",
            expected="background around every target",
        )
    elsewhere = []
    for line, sample in _free_places(region, lines, samples, rng):
        there = lines + line, samples + sample
        around, _ = _ring_mean(place, there, region, task.ring_pixels, elm, bands)
        pixels = _reflectance(place, there, elm, bands)
        if around is not None and pixels.shape[0] == lines.size:
            elsewhere.append((pixels, around))
    return _Surroundings(_reflectance(place, at, elm, bands), mean, ring, elsewhere)


def _ring_mean(
    place: Place,
    at: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]],
    region: Mask,
    reach: int,
    elm: EmpiricalLine | None,
    bands: Mask,
) -> tuple[Array | None, int]:
    """Mean reflectance (F,) of the region within ``reach`` pixels of some, these left out, and their number."""
    first = np.maximum([at[0].min() - reach, at[1].min() - reach], 0)
    last = np.minimum([at[0].max() + reach + 1, at[1].max() + reach + 1], place.cube.shape)
    own = np.zeros(tuple(last - first), bool)
    own[at[0] - first[0], at[1] - first[1]] = True
    near = ndimage.distance_transform_edt(~own) <= reach
    ring = near & ~own & region[first[0] : last[0], first[1] : last[1]]
    lines, samples = np.nonzero(ring)
    pixels = (
        _reflectance(place, (lines + first[0], samples + first[1]), elm, bands) if lines.size else np.empty((0, 1))
    )
    return (pixels.mean(axis=0), pixels.shape[0]) if pixels.shape[0] else (None, 0)


def _reflectance(
    place: Place,
    at: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]],
    elm: EmpiricalLine | None,
    bands: Mask,
) -> Array:
    """(n, F) reflectance of the valid ones of some pixels."""
    values = place.cube.spectra(at)
    found = (values if elm is None else elm.reflectance(values))[:, bands]
    return np.asarray(found[np.isfinite(found).all(axis=1)])


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
    found = np.argwhere(free)
    if not len(found):
        return []
    chosen = rng.choice(len(found), min(PLACES, len(found)), replace=False)
    return [(int(a), int(b)) for a, b in found[chosen]]

"""Detectors on pixels by name, linear or not; docs/detectors.md has the table of their definitions.

With background mean mu and covariance Sigma, d = target - mu and z = x - mu:

    cem, matched-filter   d^T Sigma^-1 z / (d^T Sigma^-1 d)                    1 on the target
    cem-correlation       t^T R^-1 x / (t^T R^-1 t), R = Sigma + mu mu^T       1 on the target
    smf                   d^T Sigma^-1 z / (d^T Sigma^-1 d)^(1/2)              background of standard deviation 1
    ace                   (d^T Sigma^-1 z)^2 / (d^T Sigma^-1 d z^T Sigma^-1 z) squared cosine in whitened space
    osp                   t^T P x / (t^T P t), P = 1 - U U^+                   1 on the target, 0 on undesired U
    sam                   -arccos(t x / (|t| |x|))                             minus the angle [rad]
    rx                    z^T Sigma^-1 z                                       needs no target

A higher score is always more like a target.  :func:`register_detector` adds one of your own.

Score maps of a stored cube: all detectors and targets in one pass, with gain and empirical line folded in.

Detectors against the mean of each pixel's own surroundings: a moving window, with the global covariance.

The mean of a pixel is that of the background pixels in an outer square around it, less an inner square that keeps
the target out of it.  In coordinates y = W (x - mu), W Sigma W^T = 1, it is a moving average m of y, and with
z = y - m and d = W (t - mu) - m the detectors are those of :mod:`hyperval.pixels.detect`:

    cem, matched-filter   d z / |d|^2
    smf                   d z / |d|
    ace                   (d z)^2 / (|d|^2 |z|^2)
    rx                    |z|^2
    cem-correlation       t R^-1 x / (t R^-1 t), R = Sigma + mu_l mu_l^T inverted by Sherman & Morrison

The image is scored in strips with as much around them as the window reaches, so that memory does not grow with it.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.data import LINEAR_DETECTORS
from hyperval.errors import UsageError
from hyperval.model.filters import LinearFilter, PositiveDefinite, design_filter
from hyperval.pixels.line import EmpiricalLine
from hyperval.pixels.statistics import StoredBlock, Watch, by_segments, stream

if TYPE_CHECKING:
    from hyperval.imagery import Cube

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Quadratic = Literal["distance", "length"]
MOST_VALUES = 50_000_000  # of what detectors see of an image at once: 0.4 GB, twice that while they score it


@dataclass(frozen=True, eq=False)
class PixelDetector:
    """A score made of affine functions of a spectrum and at most one quadratic one.

    Attributes
    ----------
    weights, constants : (K, B) and (K,): y = weights x + constants
    combine : score (N,) from y (K, N) and the quadratic (N,), which is None where none is asked for; None for
        a linear detector, whose score is y[0]
    quadratic : "distance", the squared Mahalanobis distance from the background mean; "length", |x|^2
    condition : condition number of the matrix that was inverted for it, NaN where none was
    by_pixel : ``combine`` tells the score of a pixel from that pixel alone, and is called with a part of the
        image at a time; else once, with all pixels that hold data
    """

    weights: Array
    constants: Array
    combine: Callable[[Array, Array | None], Array] | None = None
    quadratic: Quadratic | None = None
    condition: float = float("nan")
    by_pixel: bool = False

    def score(self, x: npt.ArrayLike, whitener: Whitener | None = None) -> Array:
        """(...) scores of spectra (..., B); ``whitener`` where the quadratic is the distance."""
        spectra = np.asarray(x, dtype=float)
        flat = spectra.reshape(-1, spectra.shape[-1]).T
        y = self.weights @ flat + self.constants[:, None]
        if self.combine is None:
            return np.asarray(y[0].reshape(spectra.shape[:-1]))
        value = None
        if self.quadratic == "length":
            value = np.einsum("ij,ij->j", flat, flat)
        elif self.quadratic == "distance":
            if whitener is None:
                raise UsageError("a detector that measures distance needs the whitener of the background")
            z = whitener.matrix @ (flat - whitener.mean[:, None])
            value = np.einsum("ij,ij->j", z, z)
        return np.asarray(self.combine(y, value).reshape(spectra.shape[:-1]))


@dataclass(frozen=True, eq=False)
class Whitener:
    """W (B, B) with W Sigma W^T = 1, and the mean (B,) of the background."""

    matrix: Array
    mean: Array


def score_cube(
    cube: Cube,
    detectors: Mapping[str, PixelDetector],
    elm: EmpiricalLine | None = None,
    bands: Mask | None = None,
    *,
    whitener: Whitener | None = None,
    needed: Mask | None = None,
    threads: int | None = None,
    block_lines: int | None = None,
    watch: Watch = iter,
) -> dict[str, Array]:
    """Score map (lines, samples) of every detector; no reflectance is written or kept.

    The score is NaN where the pixel holds no data in a needed band, or is itself not finite.

    Parameters
    ----------
    detectors : by name, for spectra of the selected bands
    elm : line over all bands of the cube; None when the detectors work on the cube's own values
    bands : (B,) bands that the detectors use, all by default
    whitener : of the selected bands, needed where a detector measures distance
    needed : (B,) bands that must hold data besides those used, all that are used by default
    threads, block_lines : None chooses them
    watch : wraps the iterator over the parts of the pass, for a progress bar

    Raises
    ------
    UsageError : no detector, one that does not fit the bands, or detectors that see an image at once which is too
        large for that (:data:`MOST_VALUES`).
    """
    used = np.ones(cube.bands, bool) if bands is None else np.asarray(bands, dtype=bool)
    must = used if needed is None else used | needed
    slope, level = stored_to_spectra(cube, elm, used)
    rows, constants, at = _stack(detectors, whitener, slope, level)
    maps = {name: np.full((cube.lines, cube.samples), np.nan) for name in detectors}
    kept = _kept_whole(cube, detectors)  # NaN where there is no data

    def segment(blocks: Iterator[StoredBlock]) -> None:
        for lines, stored, usable in blocks:
            with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
                y = rows @ stored
                y += constants[:, None]
                squares: dict[Quadratic | None, Array | None] = {None: None}
                if at[-1] < len(y):
                    squares["distance"] = _dot(y[at[-1] :], y[at[-1] :])
                if any(d.quadratic == "length" for d in detectors.values()):
                    spectra = stored * slope[:, None] + level[:, None]
                    squares["length"] = _dot(spectra, spectra)
                for (name, detector), a, b in zip(detectors.items(), at, at[1:], strict=False):
                    value = squares[detector.quadratic]
                    if name in kept:
                        score = y[a:b] if value is None else np.vstack([y[a:b], value])
                    else:
                        score = y[a] if detector.combine is None else detector.combine(y[a:b], value)
                        score = np.where(np.isfinite(score), score, np.nan)
                    score = np.where(usable.ravel(), score, np.nan)
                    kept.get(name, maps[name])[..., lines, :] = score.reshape(*score.shape[:-1], *usable.shape)

    for _ in stream(cube, segment, used, must, threads=threads, block_lines=block_lines, watch=watch):
        pass
    for name, values in kept.items():
        known = np.isfinite(values).all(axis=0)
        y, detector = values[:, known], detectors[name]
        assert detector.combine is not None  # noqa: S101 - kept for it
        score = np.asarray(detector.combine(*((y, None) if detector.quadratic is None else (y[:-1], y[-1]))))
        if score.shape != y.shape[1:]:
            raise UsageError(f"the detector {name!r} gives {score.shape} scores for {y.shape[1]} pixels")
        maps[name][known] = np.where(np.isfinite(score), score, np.nan)
    return maps


def _kept_whole(cube: Cube, detectors: Mapping[str, PixelDetector]) -> dict[str, Array]:
    """Room (K, lines, samples) for what each detector that sees the whole image makes of the pixels."""
    whole = {name: d for name, d in detectors.items() if d.combine is not None and not d.by_pixel}
    rows = {name: len(d.weights) + (d.quadratic is not None) for name, d in whole.items()}
    values = sum(rows.values()) * cube.lines * cube.samples
    if values > MOST_VALUES:
        raise UsageError(
            f"the detectors {', '.join(rows)} see the image at once, {values:.2g} values",
            expected=f"at most {MOST_VALUES:.2g} (lines x samples x rows of weights)",
            mend="give PixelDetector(..., by_pixel=True) where a pixel's score follows from that pixel alone, or "
            "fewer rows of weights, or cut the image",
        )
    return {name: np.full((k, cube.lines, cube.samples), np.nan) for name, k in rows.items()}


def stored_to_spectra(cube: Cube, elm: EmpiricalLine | None, used: Mask) -> tuple[Array, Array]:
    """(F,) slope and level that make the detectors' spectra out of stored numbers s: slope s + level."""
    gain, offset = cube.gain[used], cube.offset[used]
    if elm is None:
        return gain, offset
    k, b = elm.gain, elm.offset
    if k.shape != used.shape:
        raise UsageError(f"an empirical line of {k.size} bands for a cube of {used.size}")
    if not np.all(np.isfinite(k[used])):
        raise UsageError(
            f"the empirical line has no gain in {int(np.sum(~np.isfinite(k[used])))} of the detectors' bands",
            mend="leave out the bands where EmpiricalLine.usable is False",
        )
    return gain / k[used], (offset - b[used]) / k[used]


def _stack(
    detectors: Mapping[str, PixelDetector], whitener: Whitener | None, slope: Array, level: Array
) -> tuple[Array, Array, list[int]]:
    """All rows for stored numbers, their constants, and where each detector's rows begin (the whitener's last)."""
    if not detectors:
        raise UsageError("no detector to score with")
    weights = [np.atleast_2d(d.weights) for d in detectors.values()]
    constants = [np.atleast_1d(d.constants) for d in detectors.values()]
    for name, w in zip(detectors, weights, strict=True):
        if w.shape[1] != slope.size:
            raise UsageError(f"detector {name!r} is made for {w.shape[1]} bands, {slope.size} are selected")
    at = np.concatenate([[0], np.cumsum([len(w) for w in weights])]).tolist()
    if any(d.quadratic == "distance" for d in detectors.values()):
        if whitener is None:
            raise UsageError("a detector that measures distance needs the whitener of the background")
        weights.append(whitener.matrix)
        constants.append(-whitener.matrix @ whitener.mean)
    w, c = np.concatenate(weights), np.concatenate(constants)
    # weights (slope s + level) + constant
    return w * slope, c + w @ level, at


LOCAL_DETECTORS = ("cem", "matched-filter", "smf", "ace", "rx", "cem-correlation")
# Fewer pixels make no mean to speak of; the global one stands in.
LEAST_PIXELS = 10
# Values that are held for the lines of a window.
_VALUES_AT_ONCE = 4_000_000
_LINES_AT_ONCE = 8


class LocalWindow(NamedTuple):
    """Sides of the two squares [pixels], odd, the inner one less than the outer."""

    outer: int
    inner: int


def score_cube_locally(
    cube: Cube,
    detectors: Mapping[str, tuple[str, npt.ArrayLike | None]],
    whitener: Whitener,
    window: LocalWindow,
    counted: Mask,
    elm: EmpiricalLine | None = None,
    bands: Mask | None = None,
    *,
    needed: Mask | None = None,
    threads: int | None = None,
    watch: Watch = iter,
) -> tuple[dict[str, Array], int]:
    """Score map of every detector with the mean of each pixel's surroundings; how many pixels had the global mean.

    Parameters
    ----------
    detectors : name of the map -> name of the detector and its target (F,) in the selected bands
    whitener : of the background in the selected bands
    counted : (lines, samples) pixels that may count for a mean; those without data never do
    elm, bands, needed, threads, watch : as for :func:`hyperval.pixels.detect.score_cube`

    Raises
    ------
    UsageError : a detector that has no local form, a target that does not fit, a mask of another shape.
    """
    used = np.ones(cube.bands, bool) if bands is None else np.asarray(bands, dtype=bool)
    must = used if needed is None else used | needed
    if counted.shape != (cube.lines, cube.samples):
        raise UsageError(f"the mask of the surroundings has shape {counted.shape}, the cube {cube.lines, cube.samples}")
    for name, _ in detectors.values():
        if name not in LOCAL_DETECTORS:
            raise UsageError(f"{name!r} has no local form", expected="one of " + ", ".join(LOCAL_DETECTORS))
    slope, level = stored_to_spectra(cube, elm, used)
    spectra = [whitener.mean if target is None else np.asarray(target, dtype=float) for _, target in detectors.values()]
    if any(t.shape != slope.shape for t in spectra):
        raise UsageError(f"a target does not have the {slope.size} bands that are selected")
    targets = [
        (kind, whitener.matrix @ (t - whitener.mean)) for (kind, _), t in zip(detectors.values(), spectra, strict=True)
    ]
    origin = whitener.matrix @ whitener.mean
    # y of a stored pixel, and below it a 1 that counts the pixels of a sum
    rows = np.vstack([whitener.matrix * slope, np.zeros(slope.size)])
    constant = np.append(whitener.matrix @ (level - whitener.mean), 1.0)
    around = window.outer // 2
    width = max(16, _VALUES_AT_ONCE // (window.outer * constant.size) - 2 * around)
    maps = {name: np.full((cube.lines, cube.samples), np.nan) for name in detectors}

    def whitened(first: int, end: int, columns: slice) -> Iterator[tuple[Array, Mask, Mask]]:
        """y (F + 1, w) of each line, which of its pixels have data, and which count; lines outside are empty."""
        size = columns.stop - columns.start
        empty = np.zeros((constant.size, size)), np.zeros(size, bool), np.zeros(size, bool)
        yield from [empty] * max(0, -first)
        for line in range(max(first, 0), min(end, cube.lines), _LINES_AT_ONCE):
            stored, usable = cube.read_stored(line, min(_LINES_AT_ONCE, min(end, cube.lines) - line), must)
            with np.errstate(invalid="ignore", over="ignore"):
                y = rows @ stored[used, :, columns].reshape(slope.size, -1).astype(float)
                y += constant[:, None]
            known = usable[:, columns] & np.isfinite(y).all(axis=0).reshape(-1, size)
            y[:, ~known.ravel()] = 0.0
            y = y.reshape(constant.size, -1, size)
            yield from ((y[:, k], has, has & counted[line + k, columns]) for k, has in enumerate(known))
        yield from [empty] * max(0, end - cube.lines)

    def segment(firsts: range) -> int:
        """Score the lines of a segment in strips of samples; how many pixels lack surroundings."""
        first, end, lonely = firsts[0], min(firsts[-1] + _LINES_AT_ONCE, cube.lines), 0
        for start in range(0, cube.samples, width):
            stop = min(start + width, cube.samples)
            left, right = max(start - around, 0), min(stop + around, cube.samples)
            inner = slice(start - left, stop - left)
            means = moving_means(whitened(first - around, end + around, slice(left, right)), window)
            for line, (y, known, mean, number) in enumerate(means, first):
                has = known[inner]
                lonely += int(np.count_nonzero(has & (number[inner] < LEAST_PIXELS)))
                scores = _scores(targets, y[:, inner], mean[:, inner], origin)
                for name, score in zip(detectors, scores, strict=True):
                    maps[name][line, start:stop] = np.where(has & np.isfinite(score), score, np.nan)
        return lonely

    return maps, sum(by_segments(cube, _LINES_AT_ONCE, segment, threads=threads, watch=watch))


def moving_means(
    lines: Iterable[tuple[Array, Mask, Mask]], window: LocalWindow
) -> Iterator[tuple[Array, Mask, Array, Array]]:
    """y (F, w), pixels with data, means (F, w) of their surroundings and the pixels behind these, line by line.

    The sums of the two squares are differences of cumulative sums, over lines and over samples.

    Parameters
    ----------
    lines : y (F + 1, w) with a last row of 1, pixels with data, and pixels that count; half a window before the first
        line and after the last are not given back
    """
    around, inside = window.outer // 2, window.inner // 2
    held: deque[tuple[Array, Mask]] = deque(maxlen=around + 1)
    summed: deque[Array] = deque(maxlen=window.outer + 1)  # of all lines so far
    for y, known, counts in lines:
        if not summed:
            summed.append(np.zeros_like(y))
        summed.append(summed[-1] + (y if counts.all() else y * counts))
        held.append((y[:-1], known))
        if len(summed) == summed.maxlen:
            total = _along(summed[-1] - summed[0], window.outer)
            total -= _along(summed[around + inside + 1] - summed[around - inside], window.inner)
            number = np.rint(total[-1])
            mean = total[:-1] * np.where(number >= LEAST_PIXELS, 1.0 / np.maximum(number, 1.0), 0.0)
            yield *held[0], mean, number


def _along(values: Array, side: int) -> Array:
    """Sums (F, w) over ``side`` samples around each, cut at the ends."""
    summed = np.cumsum(np.pad(values, ((0, 0), (side // 2 + 1, side // 2))), axis=1)
    return np.asarray(summed[:, side:] - summed[:, :-side])


def _scores(targets: list[tuple[str, Array]], y: Array, m: Array, origin: Array) -> Iterator[Array]:
    """(N,) scores of columns y (F, N) with local means m (F, N), both from the global mean, by (detector, target)."""
    z = y - m
    zz = _dot(z, z)
    for name, target in targets:
        d = target[:, None] - m
        dz, dd = _dot(d, z), _dot(d, d)
        if name == "cem-correlation":
            # All from the origin; R^-1 = 1 - mu mu^T/(1 + mu^2) in whitened coordinates.
            t, mu, x = target + origin, m + origin[:, None], y + origin[:, None]
            size, tmu = 1.0 + _dot(mu, mu), t @ mu
            yield _ratio(t @ x - tmu * _dot(mu, x) / size, float(t @ t) - tmu**2 / size)
        elif name == "rx":
            yield zz
        elif name == "ace":
            yield _ratio(dz**2, dd * zz)
        else:
            yield _ratio(dz, np.sqrt(dd) if name == "smf" else dd)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("fn,fn->n", a, b))


def _ratio(a: Array, b: Array) -> Array:
    return np.divide(a, b, out=np.full_like(a, np.nan), where=b > 0)


ANOMALY_DETECTORS = ("rx",)
WITHOUT_COVARIANCE = ("osp", "sam")
DETECTORS = (*LINEAR_DETECTORS, "osp", "ace", "sam", *ANOMALY_DETECTORS)
# (target (B,), background mean (B,), its covariance, undesired spectra (K, B)) -> detector
DetectorMaker = Callable[[Array, Array, "npt.ArrayLike | PositiveDefinite", Array], PixelDetector]
ADDED_DETECTORS: dict[str, DetectorMaker] = {}
# A direction of the undesired spectra below this part of the greatest adds nothing but rounding.
_RANK = 1e-10


def detector_names() -> tuple[str, ...]:
    """Every detector that a campaign may name, the added ones last."""
    return (*DETECTORS, *ADDED_DETECTORS)


def register_detector(name: str, make: DetectorMaker) -> None:
    """Add a detector: campaigns may name it, and the benchmark gives it rows.

    Parameters
    ----------
    make : builds the detector from target (B,), background mean (B,), covariance and undesired spectra (K, B); its
        ``combine`` sees all pixels of the image at once, as the detectors of SPy do, unless it says ``by_pixel``

    Raises
    ------
    UsageError : a name that is taken, or that cannot name files.
    """
    if not re.fullmatch(r"[a-z0-9][a-z0-9-]*", name):
        raise UsageError(f"detector name {name!r}", expected="small letters, digits and hyphens")
    if name in DETECTORS or ADDED_DETECTORS.get(name, make) is not make:
        raise UsageError(f"there is a detector {name!r} already")
    ADDED_DETECTORS[name] = make


def pixel_detector(
    name: str,
    target: npt.ArrayLike | None,
    mean: npt.ArrayLike,
    covariance: npt.ArrayLike | PositiveDefinite | None,
    undesired: npt.ArrayLike | None = None,
) -> PixelDetector:
    """The detector that ``name`` says, for spectra (..., B).

    Parameters
    ----------
    target : (B,) spectrum that is looked for; not used by "rx"
    mean, covariance : (B,) and (B, B) of the background, the latter as an array or factorised; "osp" and "sam" do
        without the latter
    undesired : (K, B) spectra that "osp" projects away

    Raises
    ------
    UsageError : an unknown name, a singular background, or a target that cannot be told from the background.
    """
    if name not in detector_names():
        raise UsageError(f"unknown detector {name!r}", expected="one of " + ", ".join(detector_names()))
    bands = np.size(mean)
    if name == "rx":
        return PixelDetector(np.empty((0, bands)), np.empty(0), _only_quadratic, "distance", by_pixel=True)
    if target is None:
        raise UsageError(f"the detector {name!r} needs a target spectrum")
    t = np.asarray(target, dtype=float)
    if name == "osp":
        return from_filter(osp_filter(t, undesired))
    if name == "sam":
        if not np.any(t):
            raise UsageError("the target spectrum is zero in every band: it has no direction")
        return PixelDetector((t / np.linalg.norm(t))[None], np.zeros(1), _minus_angle, "length", by_pixel=True)
    if covariance is None:
        raise UsageError(f"the detector {name!r} needs the covariance of the background")
    if name in ADDED_DETECTORS:
        return ADDED_DETECTORS[name](t, np.asarray(mean, dtype=float), covariance, np.asarray(undesired, dtype=float))
    if name in LINEAR_DETECTORS:
        return from_filter(design_filter(name, t, mean, covariance))
    linear = from_filter(design_filter("smf", t, mean, covariance))  # ace = smf^2/(z^T Sigma^-1 z)
    return PixelDetector(linear.weights, linear.constants, _squared_cosine, "distance", linear.condition, True)


def from_filter(linear: LinearFilter) -> PixelDetector:
    """A linear filter as a detector on pixels."""
    return PixelDetector(linear.weights[None], np.array([-linear.offset]), condition=linear.condition)


def osp_filter(target: npt.ArrayLike, undesired: npt.ArrayLike | None) -> LinearFilter:
    """Orthogonal subspace projection: w = P t/(t^T P t) with P = 1 - U U^+, score w x.

    Source: Harsanyi & Chang, IEEE Trans. Geosci. Remote Sens. 32, 779-785, 1994, divided by t^T P t so that the
    score of the target is 1.

    Parameters
    ----------
    undesired : (K, B) spectra to be projected away; ones that depend on each other are allowed

    Raises
    ------
    UsageError : no undesired spectra, or a target that is a mixture of them.
    """
    t = np.asarray(target, dtype=float)
    if undesired is None or np.size(undesired) == 0:
        raise UsageError("osp needs the spectra that it projects away", mend="name regions in detection.undesired")
    u = np.atleast_2d(np.asarray(undesired, dtype=float))
    if u.shape[1] != t.size:
        raise UsageError(f"undesired spectra of {u.shape[1]} bands for a target of {t.size}")
    left, singular, _ = np.linalg.svd(u.T, full_matrices=False)
    left = left[:, singular > _RANK * singular[0]]
    rest = t - left @ (left.T @ t)
    rest -= left @ (left.T @ rest)  # twice is exact to rounding
    if np.linalg.norm(rest) <= _RANK * np.linalg.norm(t):
        raise UsageError("the target spectrum is a mixture of the undesired ones: osp leaves nothing of it")
    return LinearFilter(rest / (rest @ t), 0.0)


def whitener_of(mean: npt.ArrayLike, covariance: npt.ArrayLike | PositiveDefinite) -> Whitener:
    """The whitener of a background; UsageError where its covariance is singular."""
    factor = covariance if isinstance(covariance, PositiveDefinite) else PositiveDefinite(covariance)
    mu = np.asarray(mean, dtype=float)
    return Whitener(factor.whiten(np.eye(mu.size)), mu)


def _only_quadratic(_: Array, value: Array | None) -> Array:
    assert value is not None  # noqa: S101 - asked for
    return value


def _squared_cosine(y: Array, value: Array | None) -> Array:
    assert value is not None  # noqa: S101 - asked for
    return np.asarray(np.divide(y[0] ** 2, value, out=np.full_like(value, np.nan), where=value > 0))


def _minus_angle(y: Array, value: Array | None) -> Array:
    assert value is not None  # noqa: S101 - asked for
    cosine = np.divide(y[0], np.sqrt(value), out=np.full_like(value, np.nan), where=value > 0)
    return np.asarray(-np.arccos(np.clip(cosine, -1.0, 1.0)))

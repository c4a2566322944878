"""Detectors on pixels by name, linear or not; docs/detectors.md has the table of their definitions.

With background mean mu and covariance Sigma, d = target - mu and z = x - mu:

    cem, matched-filter   d^T Sigma^-1 z / (d^T Sigma^-1 d)                    1 on the target
    cem-correlation       t^T R^-1 x / (t^T R^-1 t), R = Sigma + mu mu^T       1 on the target
    smf                   d^T Sigma^-1 z / (d^T Sigma^-1 d)^(1/2)              background of standard deviation 1
    ace                   (d^T Sigma^-1 z)^2 / (d^T Sigma^-1 d z^T Sigma^-1 z) squared cosine in whitened space
    osp                   t^T P x / (t^T P t), P = 1 - U U^+                   1 on the target, 0 on undesired U
    sam                   -arccos(t x / (|t| |x|))                             minus the angle [rad]
    rx                    z^T Sigma^-1 z                                       needs no target

A higher score is always more like a target.  :func:`register_detector` adds one of your own, :func:`register_scores`
and :func:`register_estimator` one that needs the whole image: a function, or an estimator of scikit-learn.

:func:`score_cube` takes all detectors and targets in one pass, with gain and empirical line folded in.
:func:`score_cube_locally` takes the mean from each pixel's surroundings and the covariance from the whole scene: the
background pixels in an outer square around it, less an inner square that excludes the target.  In coordinates
y = W (x - mu), W Sigma W^T = 1, that mean is a moving average m of y, and the detectors are those above of z = y - m
and d = W (t - mu) - m.
"""

from __future__ import annotations

import copy
import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hyperval.data import LINEAR_DETECTORS, Array, Index, Mask
from hyperval.errors import HypervalError, UsageError, needed, refusal, refuse
from hyperval.model.filters import LinearFilter, PositiveDefinite, design_filter
from hyperval.pixels.line import EmpiricalLine
from hyperval.pixels.statistics import StoredBlock, Watch, by_segments, stream_blocks

if TYPE_CHECKING:
    from hyperval.imagery import Cube
MAX_VALUES = 50_000_000  # held at once for detectors that need the whole image: 0.4 GB, twice that while they score it
MIN_PIXELS = 10  # with fewer in the window the global mean is used
_STRIP_VALUES = 1_000_000  # values read at once: a strip of pixels with its margin
_RANK = 1e-10  # undesired directions with singular values below this part of the greatest are rounding


def _ratio(a: Array | float, b: Array | float) -> Array:
    a, b = np.broadcast_arrays(np.asarray(a, dtype=float), b)
    return np.asarray(np.divide(a, b, out=np.full(a.shape, np.nan), where=b > 0))


# The score from the products of d and z in the metric of the detector: d z, d d and z z.
SCORES: Mapping[str, Callable[[Array, Array | float, Array], Array]] = {
    **dict.fromkeys(("cem", "matched-filter", "cem-correlation"), lambda dz, dd, zz: _ratio(dz, dd)),
    "smf": lambda dz, dd, zz: _ratio(dz, np.sqrt(dd)),
    "ace": lambda dz, dd, zz: _ratio(dz**2, dd * zz),
    "sam": lambda dz, dd, zz: -np.arccos(np.clip(_ratio(dz, np.sqrt(dd * zz)), -1.0, 1.0)),
    "rx": lambda dz, dd, zz: zz,
}
LOCAL_DETECTORS = tuple(name for name in SCORES if name != "sam")
ANOMALY_DETECTORS = ("rx",)
WITHOUT_COVARIANCE = ("osp", "sam")
DETECTORS = (*LINEAR_DETECTORS, "osp", "ace", "sam", *ANOMALY_DETECTORS)


@dataclass(frozen=True, eq=False)
class PixelDetector:
    """A score made of affine functions of a spectrum and at most one quadratic one.

    Attributes
    ----------
    weights, constants : (K, B) and (K,): y = weights x + constants
    combine : score (N,) from y (K, N) and the quadratic (N,), which is None where none is asked for; None for
        a linear detector, whose score is y[0]
    quadratic : "distance", the squared Mahalanobis distance from the background mean; "length", |x|^2
    by_pixel : ``combine`` scores each pixel from that pixel alone, and is called with a part of the image at a time;
        else once, with all pixels that hold data
    image : score (lines, samples) from y (lines, samples, K), NaN where there is no data, and the image's truth
    added : name under which it was registered; empty for one of the package
    """

    weights: Array
    constants: Array
    combine: Callable[[Array, Array | None], Array] | None = None
    quadratic: Literal["distance", "length"] | None = None
    by_pixel: bool = False
    image: Callable[[Array, Any], npt.ArrayLike] | None = None
    added: str = ""

    def score(self, x: npt.ArrayLike, whitener: Whitener | None = None) -> Array:
        """(...) scores of spectra (..., B); ``whitener`` where the quadratic is the distance."""
        spectra = np.asarray(x, dtype=float)
        flat = spectra.reshape(-1, spectra.shape[-1]).T
        y = self.weights @ flat + self.constants[:, None]
        quadratic = None
        if self.quadratic is not None:
            z = flat if self.quadratic == "length" else _required_whitener(whitener).whiten(flat)
            quadratic = _column_products(z, z)
        return np.asarray(self.combined_score(y, quadratic).reshape(spectra.shape[:-1]))

    def combined_score(self, y: Array, quadratic: Array | None) -> Array:
        """Score (N,) from y (K, N) and the quadratic (N,), which is None where none is asked for."""
        return y[0] if self.combine is None else self.combine(y, quadratic)


@dataclass(frozen=True, eq=False)
class Whitener:
    """W (B, B) with W Sigma W^T = 1, and the mean (B,) of the background."""

    matrix: Array
    mean: Array

    def whiten(self, x: Array) -> Array:
        """W (x - mean) of spectra (B, ...)."""
        return np.asarray(self.matrix @ (x.T - self.mean).T)


def _required_whitener(whitener: Whitener | None) -> Whitener:
    return needed(whitener, "detector.whitener")


def whitener_of(mean: npt.ArrayLike, covariance: npt.ArrayLike | PositiveDefinite) -> Whitener:
    """The whitener of a background; UsageError where its covariance is singular."""
    factor = covariance if isinstance(covariance, PositiveDefinite) else PositiveDefinite(covariance)
    mu = np.asarray(mean, dtype=float)
    return Whitener(factor.whiten(np.eye(mu.size)), mu)


class AddedDetectorError(UsageError):
    """A detector that was registered fails, or refuses an image; ``detector`` is its name."""

    detector = ""


@contextmanager
def _naming_detector_in_errors(name: str) -> Iterator[None]:
    """Errors raised inside name the registered detector."""
    try:
        yield
    except Exception as error:
        words = error.what if isinstance(error, HypervalError) else f"{type(error).__name__}: {error}"
        refused = AddedDetectorError(f"the detector {name!r} fails: {words}", expected=getattr(error, "expected", None))
        refused.detector = name
        raise refused from error


# (target (B,), background mean (B,), its covariance, undesired spectra (K, B)) -> detector
DetectorMaker = Callable[[Array, Array, "npt.ArrayLike | PositiveDefinite", Array], PixelDetector]
ADDED_DETECTORS: dict[str, DetectorMaker] = {}


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
    refuse(not re.fullmatch(r"[a-z0-9][a-z0-9-]*", name), "detector.name", name=name)
    refuse(name in DETECTORS or ADDED_DETECTORS.get(name, make) is not make, "detector.taken", name=name)
    ADDED_DETECTORS[name] = make


def pixel_detector(
    name: str,
    target: npt.ArrayLike | None,
    mean: npt.ArrayLike,
    covariance: npt.ArrayLike | PositiveDefinite | None,
    undesired: npt.ArrayLike | None = None,
) -> PixelDetector:
    """The detector called ``name``, for spectra (..., B).

    Parameters
    ----------
    target : (B,) spectrum sought; not used by "rx"
    mean, covariance : (B,) and (B, B) of the background, the latter as an array or factorised; not needed by "osp"
        and "sam"
    undesired : (K, B) spectra that "osp" projects away

    Raises
    ------
    UsageError : an unknown name, a singular background, or a target that cannot be told from the background.
    """
    refuse(name not in detector_names(), "detector.unknown", name=name, names=", ".join(detector_names()))
    combine = partial(_score_by_name, name)
    if name == "rx":
        return PixelDetector(np.empty((0, np.size(mean))), np.empty(0), combine, "distance", by_pixel=True)
    t = np.asarray(needed(target, "detector.target", name=name), dtype=float)
    if name == "osp":
        return from_filter(osp_filter(t, undesired))
    if name == "sam":
        refuse(not np.any(t), "target.zero")
        return PixelDetector((t / np.linalg.norm(t))[None], np.zeros(1), combine, "length", by_pixel=True)
    if covariance is None:
        raise refusal("detector.covariance", name=name)
    if name in ADDED_DETECTORS:
        with _naming_detector_in_errors(name):
            statistics = np.asarray(mean, dtype=float), covariance, np.asarray(undesired, dtype=float)
            return replace(ADDED_DETECTORS[name](t, *statistics), added=name)
    linear = from_filter(design_filter("smf" if name == "ace" else name, t, mean, covariance))
    return replace(linear, combine=combine, quadratic="distance", by_pixel=True) if name == "ace" else linear


def _score_by_name(name: str, y: Array, quadratic: Array | None) -> Array:
    """The score by name for a target of unit length, y[0] being d z."""
    assert quadratic is not None  # noqa: S101 - asked for
    return SCORES[name](y[0] if len(y) else quadratic, 1.0, quadratic)


def from_filter(linear: LinearFilter) -> PixelDetector:
    """A linear filter as a detector on pixels."""
    return PixelDetector(linear.weights[None], np.array([-linear.offset]))


def osp_filter(target: npt.ArrayLike, undesired: npt.ArrayLike | None) -> LinearFilter:
    """Orthogonal subspace projection: w = P t/(t^T P t) with P = 1 - U U^+, score w x.

    Source: Harsanyi & Chang, IEEE Trans. Geosci. Remote Sens. 32, 779-785, 1994, divided by t^T P t so that the
    score of the target is 1.

    Parameters
    ----------
    undesired : (K, B) spectra to be projected away; ones that depend on each other are allowed

    Raises
    ------
    UsageError : a target that is a mixture of them.
    """
    t = np.asarray(target, dtype=float)
    u = np.atleast_2d(np.asarray(undesired, dtype=float))
    basis, singular, _ = np.linalg.svd(u.T, full_matrices=False)
    basis = basis[:, singular > _RANK * singular[0]]
    residual = t - basis @ (basis.T @ t)
    residual -= basis @ (basis.T @ residual)  # twice is exact to rounding
    refuse(np.linalg.norm(residual) <= _RANK * np.linalg.norm(t), "target.mixture")
    return LinearFilter(residual / (residual @ t), 0.0)


def score_cube(
    cube: Cube,
    detectors: Mapping[str, PixelDetector],
    elm: EmpiricalLine | None = None,
    bands: Mask | None = None,
    *,
    whitener: Whitener | None = None,
    needed: Mask | None = None,
    scenes: Mapping[str, Any] = MappingProxyType({}),
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
    scenes : of each detector with ``image``, what the truth says (:class:`hyperval.pixels.ImageTruth`)
    watch : wraps the iterator over the parts of the pass, for a progress bar

    Raises
    ------
    UsageError : a detector that does not fit the bands, or detectors that see an image at once which is too large for
        that (:data:`MAX_VALUES`).
    """
    used, required, slope, level = _spectra_of(cube, elm, bands, needed)
    weights = [np.atleast_2d(d.weights) for d in detectors.values()]
    constants = [np.atleast_1d(d.constants) for d in detectors.values()]
    for name, w in zip(detectors, weights, strict=True):
        refuse(w.shape[1] != slope.size, "detector.bands", name=name, shape=w.shape, size=slope.size)
    ends = np.cumsum([0, *map(len, weights)]).tolist()
    quadratics = {d.quadratic for d in detectors.values()}
    if "distance" in quadratics:
        weights.append(_required_whitener(whitener).matrix)
        constants.append(_required_whitener(whitener).whiten(np.zeros(slope.size)))
    matrix = np.concatenate(weights)
    # weights (slope s + level) + constant, of stored numbers s
    rows, constant = matrix * slope, (np.concatenate(constants) + matrix @ level)[:, None]
    maps = {name: np.full((cube.lines, cube.samples), np.nan) for name in detectors}
    image_values = _image_arrays(cube, detectors)  # NaN where there is no data

    def score_segment(blocks: Iterator[StoredBlock]) -> None:
        for lines, stored, usable in blocks:
            with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
                y = rows @ stored
                y += constant
                squares: dict[str | None, Array | None] = {None: None}
                if "distance" in quadratics:
                    squares["distance"] = _column_products(y[ends[-1] :], y[ends[-1] :])
                if "length" in quadratics:
                    spectra = stored * slope[:, None] + level[:, None]
                    squares["length"] = _column_products(spectra, spectra)
                for (name, detector), start, end in zip(detectors.items(), ends, ends[1:], strict=False):
                    quadratic = squares[detector.quadratic]
                    if name in image_values:
                        score = y[start:end] if quadratic is None else np.vstack([y[start:end], quadratic])
                    else:
                        score = _finite(detector.combined_score(y[start:end], quadratic))
                    score = np.where(usable.ravel(), score, np.nan)
                    image_values.get(name, maps[name])[..., lines, :] = score.reshape(*score.shape[:-1], *usable.shape)

    for _ in stream_blocks(cube, score_segment, used, required, watch):
        pass
    for name, values in image_values.items():
        with _naming_detector_in_errors(detectors[name].added or name):
            maps[name] = _image_score(detectors[name], values, scenes.get(name))
    return maps


def _image_score(detector: PixelDetector, values: Array, scene: Any) -> Array:
    """(lines, samples) score of a detector that needs all ``values`` (K, lines, samples) at once."""
    valid, score_map = np.isfinite(values).all(axis=0), np.full(values.shape[1:], np.nan)
    if detector.image is not None:
        score = np.asarray(detector.image(np.moveaxis(values, 0, -1), scene), dtype=float)
        score = score[valid] if score.shape == valid.shape else score
    else:
        y = values[:, valid]
        score = np.asarray(detector.combined_score(*((y, None) if detector.quadratic is None else (y[:-1], y[-1]))))
    refuse(score.shape != (int(valid.sum()),), "detector.scores", shape=score.shape, number=int(valid.sum()))
    refuse(valid.any() and not np.isfinite(score).any(), "detector.scoreless")
    score_map[valid] = _finite(score)
    return score_map


def _image_arrays(cube: Cube, detectors: Mapping[str, PixelDetector]) -> dict[str, Array]:
    """Empty (K, lines, samples) for the y, and the quadratic, of each detector that needs the whole image."""
    chosen = {n: d for n, d in detectors.items() if d.image is not None or (d.combine is not None and not d.by_pixel)}
    rows = {name: len(d.weights) + (d.quadratic is not None) for name, d in chosen.items()}
    values = sum(rows.values()) * cube.lines * cube.samples
    refuse(values > MAX_VALUES, "detector.whole", names=", ".join(rows), values=values, most=MAX_VALUES)
    return {name: np.full((k, cube.lines, cube.samples), np.nan) for name, k in rows.items()}


def _spectra_of(
    cube: Cube, elm: EmpiricalLine | None, bands: Mask | None, needed: Mask | None
) -> tuple[Mask, Mask, Array, Array]:
    """Bands (B,) that are used, and that must hold data; slope and level (F,) from stored numbers to spectra."""
    used = np.ones(cube.bands, bool) if bands is None else np.asarray(bands, dtype=bool)
    required = used if needed is None else used | needed
    gain, offset = cube.gain[used], cube.offset[used]
    if elm is None:
        return used, required, gain, offset
    k, b = elm.gain, elm.offset
    refuse(not np.all(np.isfinite(k[used])), "detector.no_gain", count=int(np.sum(~np.isfinite(k[used]))))
    return used, required, gain / k[used], (offset - b[used]) / k[used]


def score_cube_locally(
    cube: Cube,
    detectors: Mapping[str, tuple[str, Array | None]],
    whitener: Whitener,
    window: tuple[int, int],
    counted: Mask,
    elm: EmpiricalLine | None = None,
    bands: Mask | None = None,
    *,
    needed: Mask | None = None,
    watch: Watch = iter,
) -> tuple[dict[str, Array], int]:
    """Score map of every detector with the mean of each pixel's surroundings; how many pixels had the global mean.

    The image is scored in strips, read with a margin of half the window, so that memory does not grow with the image.

    Parameters
    ----------
    detectors : name of the map -> name of the detector and its target (F,) in the selected bands
    whitener : of the background in the selected bands
    window : sides of the outer and the inner square [pixels], odd
    counted : (lines, samples) pixels that may count for a mean; those without data never do
    elm, bands, needed, watch : as for :func:`score_cube`
    """
    used, required, slope, level = _spectra_of(cube, elm, bands, needed)
    targets = {
        key: (name, whitener.whiten(whitener.mean if target is None else target)[:, None])
        for key, (name, target) in detectors.items()
    }
    origin = (whitener.matrix @ whitener.mean)[:, None]
    # y of a stored pixel, and below it a 1 that counts the pixels of a sum
    rows = np.vstack([whitener.matrix * slope, np.zeros(slope.size)])
    constant = np.append(whitener.whiten(level), 1.0)[:, None, None]
    outer, inner = window
    margin = outer // 2
    width = max(16, _STRIP_VALUES // (2 * outer * len(rows)) - 2 * margin)
    maps = {name: np.full((cube.lines, cube.samples), np.nan) for name in detectors}

    def score_strip(lines: slice, samples: slice) -> int:
        """Score a strip; the number of its pixels that have the global mean."""
        row_range, col_range = (slice(max(s.start - margin, 0), s.stop + margin) for s in (lines, samples))
        core = tuple(slice(s.start - r.start, s.stop - r.start) for s, r in ((lines, row_range), (samples, col_range)))
        stored, usable = cube.read_stored(row_range.start, min(row_range.stop, cube.lines) - row_range.start, required)
        with np.errstate(invalid="ignore", over="ignore"):
            y = np.tensordot(rows, stored[used, :, col_range].astype(float), 1) + constant
        valid = usable[:, col_range] & np.isfinite(y).all(axis=0)
        y[:, ~valid] = 0.0
        masked = y * (valid & counted[row_range, col_range])
        total = _window_sums(masked, outer)[:, *core] - _window_sums(masked, inner)[:, *core]
        count, scored = np.rint(total[-1].ravel()), valid[core]
        mean = total[:-1].reshape(slope.size, -1)
        mean *= np.where(count >= MIN_PIXELS, 1.0 / np.maximum(count, 1.0), 0.0)
        x = y[:-1, *core].reshape(slope.size, -1)
        z = x - mean
        zz = _column_products(z, z)
        for key, (name, target) in targets.items():
            d = target - mean
            dz, dd = _column_products(d, z), _column_products(d, d)
            if name == "cem-correlation":
                dz, dd = _correlation_products(target + origin, mean + origin, x + origin)
            score = _finite(SCORES[name](dz, dd, zz)).reshape(scored.shape)
            maps[key][lines, samples] = np.where(scored, score, np.nan)
        return int(np.count_nonzero(scored.ravel() & (count < MIN_PIXELS)))

    def score_segment(starts: range) -> int:
        """Score the lines of a segment in strips of samples; the number of pixels that have the global mean."""
        strips = [slice(start, min(start + width, cube.samples)) for start in range(0, cube.samples, width)]
        lines = [slice(line, min(line + outer, cube.lines)) for line in starts]
        return sum(score_strip(*part) for part in itertools.product(lines, strips))

    return maps, sum(by_segments(cube, outer, score_segment, watch))


def _window_sums(values: Array, side: int) -> Array:
    """(F, lines, samples) sums over the squares around pixels, cut at the edges."""
    return np.asarray(side**2 * ndimage.uniform_filter(values, (1, side, side), mode="constant"))


def _correlation_products(t: Array, mu: Array, x: Array) -> tuple[Array, Array]:
    """t R^-1 x and t R^-1 t (N,) in whitened coordinates, where R^-1 = 1 - mu mu^T/(1 + mu^2) (Sherman & Morrison)."""
    t_mu, size = _column_products(t, mu), 1.0 + _column_products(mu, mu)
    return _column_products(t, x) - t_mu * _column_products(mu, x) / size, _column_products(t, t) - t_mu**2 / size


def _column_products(a: Array, b: Array) -> Array:
    """(N,) products of columns (F, N), or of one (F, 1) with each."""
    return np.asarray(np.einsum("fn,fn->n", *np.broadcast_arrays(a, b)))


def _finite(score: Array) -> Array:
    return np.where(np.isfinite(score), score, np.nan)


BLOCK = 16  # side of the squares that halve the background [pixels]
MAX_TRAINING_PIXELS = 20_000  # pixels of the background that an estimator is fitted to


class ImageTruth(NamedTuple):
    """What the truth says of an image.

    Attributes
    ----------
    background : (lines, samples) pixels that stand for the background
    objects : (lines, samples) number of the object in a pixel, from 1; 0 where there is none
    """

    background: Mask
    objects: Index


# (image (lines, samples, B), target (B,), what the truth says) -> score (lines, samples)
ImageScore = Callable[[Array, Array, ImageTruth], npt.ArrayLike]


def register_scores(name: str, fit: Callable[[Array, Array], npt.ArrayLike]) -> None:
    """Add a detector that is a function of the whole image.

    Parameters
    ----------
    fit : image (lines, samples, B), NaN where it holds no data, and target (B,) -> score (lines, samples), the higher
        the more like the target; it sees no truth

    Raises
    ------
    UsageError : a name that is taken, or that cannot name files.

    Examples
    --------
    >>> register_scores("first-band", lambda image, target: image[..., 0] / target[0])  # doctest: +SKIP
    """
    register_detector(name, partial(_image_detector, lambda image, target, scene: fit(image, target)))


def register_estimator(name: str, estimator: Any) -> None:
    """Add an estimator with the methods of scikit-learn as a detector.

    With ``score_samples`` (one-class SVM, isolation forest, density) it is fitted to pixels of the background, and what
    is unlike them scores high.  With ``decision_function`` or ``predict_proba`` it is fitted to target and background
    pixels of one half of the objects and of the background's squares, and scores the other half: no pixel is scored by
    what has learned from it or from its object.

    Raises
    ------
    UsageError : a name that is taken, or an estimator with none of these methods.
    """
    scores = any(hasattr(estimator, method) for method in ("score_samples", "decision_function", "predict_proba"))
    refuse(not scores, "detector.estimator", name=type(estimator).__name__)
    register_detector(name, partial(_image_detector, partial(_estimator_scores, estimator)))


def _image_detector(score: ImageScore, target: Array, mean: Array, *_: Any) -> PixelDetector:
    bands = np.eye(mean.size)
    return PixelDetector(bands, np.zeros(mean.size), image=lambda image, scene: score(image, target, scene))


def _estimator_scores(estimator: Any, image: Array, target: Array, scene: ImageTruth) -> Array:
    valid = np.isfinite(image).all(axis=-1)
    scores = np.full(valid.shape, np.nan)
    if hasattr(estimator, "score_samples"):
        training = image[valid & scene.background]
        training = training[:: max(1, len(training) // MAX_TRAINING_PIXELS)]
        scores[valid] = -copy.deepcopy(estimator).fit(training).score_samples(image[valid])
        return scores
    # Alternate squares of the background and alternate whole objects.
    squares = np.sum(np.indices(valid.shape) // BLOCK, axis=0)
    half = np.where(scene.objects > 0, scene.objects, squares) % 2 == 1
    labelled = valid & (scene.background | (scene.objects > 0))
    for part in (half, ~half):
        training, labels = image[labelled & part], scene.objects[labelled & part] > 0
        refuse(labels.all() or not labels.any(), "learning.few")
        fit = copy.deepcopy(estimator).fit(training, labels)
        scored = valid & ~part
        by_margin = hasattr(fit, "decision_function")
        scores[scored] = fit.decision_function(image[scored]) if by_margin else fit.predict_proba(image[scored])[:, 1]
    return scores

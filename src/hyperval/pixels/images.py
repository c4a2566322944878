"""Detectors that see an image whole, as their authors write them: a function, or an estimator of scikit-learn."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.data import Array, Index, Mask
from hyperval.errors import UsageError
from hyperval.pixels.detect import PixelDetector, register_detector

BLOCK = 16  # side of the squares that halve the background [pixels]
MOST_LEARNED = 20_000  # pixels of the background that an estimator is fitted to


class ImageTruth(NamedTuple):
    """What the truth says of an image.

    Attributes
    ----------
    background : (lines, samples) pixels that stand for the background
    objects : (lines, samples) number of the object in a pixel, from 1; 0 where there is none
    """

    background: Mask
    objects: Index

    @property
    def second_half(self) -> Mask:
        """Every other square of the background and every other object, whole."""
        lines, samples = np.indices(self.background.shape) // BLOCK
        return np.where(self.objects > 0, self.objects % 2, (lines + samples) % 2).astype(bool)


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
    register_detector(name, partial(_whole, lambda image, target, scene: fit(image, target)))


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
    if not any(hasattr(estimator, method) for method in ("score_samples", "decision_function", "predict_proba")):
        raise UsageError(
            f"{type(estimator).__name__} scores nothing",
            expected="an estimator with score_samples, decision_function or predict_proba",
        )
    register_detector(name, partial(_whole, partial(_estimated, estimator)))


def _whole(
    score: Callable[[Array, Array, ImageTruth], npt.ArrayLike],
    target: Array,
    mean: Array,
    covariance: Any,
    undesired: Array,
) -> PixelDetector:
    bands = np.eye(mean.size)
    return PixelDetector(bands, np.zeros(mean.size), image=lambda image, scene: score(image, target, scene))


def _estimated(estimator: Any, image: Array, target: Array, scene: ImageTruth) -> Array:
    known = np.isfinite(image).all(axis=-1)
    scores = np.full(known.shape, np.nan)
    if hasattr(estimator, "score_samples"):
        learned = image[known & scene.background]
        learned = learned[:: max(1, len(learned) // MOST_LEARNED)]
        scores[known] = -copy.deepcopy(estimator).fit(learned).score_samples(image[known])
        return scores
    half, labelled = scene.second_half, known & (scene.background | (scene.objects > 0))
    for own in (half, ~half):
        learned, labels = image[labelled & own], scene.objects[labelled & own] > 0
        if labels.all() or not labels.any():
            raise UsageError("too few objects to learn from one half and score the other", expected="two and more")
        fitted = copy.deepcopy(estimator).fit(learned, labels)
        here = known & ~own
        by_margin = hasattr(fitted, "decision_function")
        scores[here] = fitted.decision_function(image[here]) if by_margin else fitted.predict_proba(image[here])[:, 1]
    return scores

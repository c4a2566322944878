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
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.filters import LINEAR_DETECTORS, LinearFilter, PositiveDefinite, design_filter
from hyperval.processing.pixel_scores import PixelDetector, Whitener

Array = npt.NDArray[np.float64]

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
    make : builds the detector from target (B,), background mean (B,), covariance and undesired spectra (K, B)

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
        return PixelDetector(np.empty((0, bands)), np.empty(0), _only_quadratic, "distance")
    if target is None:
        raise UsageError(f"the detector {name!r} needs a target spectrum")
    t = np.asarray(target, dtype=float)
    if name == "osp":
        return from_filter(osp_filter(t, undesired))
    if name == "sam":
        if not np.any(t):
            raise UsageError("the target spectrum is zero in every band: it has no direction")
        return PixelDetector((t / np.linalg.norm(t))[None], np.zeros(1), _minus_angle, "length")
    if covariance is None:
        raise UsageError(f"the detector {name!r} needs the covariance of the background")
    if name in ADDED_DETECTORS:
        return ADDED_DETECTORS[name](
            t, np.asarray(mean, dtype=float), covariance, np.asarray(undesired, dtype=float)
        )
    if name in LINEAR_DETECTORS:
        return from_filter(design_filter(name, t, mean, covariance))
    linear = from_filter(design_filter("smf", t, mean, covariance))  # ace = smf^2/(z^T Sigma^-1 z)
    return PixelDetector(linear.weights, linear.constants, _squared_cosine, "distance", linear.condition)


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

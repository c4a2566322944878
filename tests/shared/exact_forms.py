"""Exact forms written from their definitions, which the faster ones of the package are held against."""

from __future__ import annotations

import numpy as np

from hyperval.model import WHOLE
from hyperval.pixels import area_estimates, counts_of, roc_area
from hyperval.products import AreaEstimate


def roc_points(target, background):
    """Every corner of the empirical ROC: ``pfa``, ``pd`` and the least score declared, +inf at first."""
    t, b = np.sort(np.ravel(target).astype(float)), np.sort(np.ravel(background).astype(float))
    value = np.unique(np.concatenate([t, b]))[::-1]
    pd = (t.size - np.searchsorted(t, value, side="left")) / t.size
    pfa = (b.size - np.searchsorted(b, value, side="left")) / b.size
    return np.concatenate([[0.0], pfa]), np.concatenate([[0.0], pd]), np.concatenate([[np.inf], value])


def auc(target, background):
    """The area under the whole curve by production's counts."""
    return roc_area(counts_of(target, background))


def auc_estimate(target, background) -> AreaEstimate:
    """Production's area of single pixels with its interval."""
    counts = counts_of(target, background)
    return area_estimates(counts, {"auc": WHOLE}, "pixel", 0, np.random.default_rng(0))["auc"]


def sum_to_one_gain(endmembers, noise=None):
    """G (M, B) with a = 1/M + G (x - mean of endmembers): least squares under sum a = 1 alone.

    With the last abundance put in as 1 minus the others, D = rows e_m - e_M (m < M): the others are
    (D C^-1 D^T)^-1 D C^-1 (x - e_M).  Linear in x, so that a covariance goes through it.
    """
    e = np.asarray(endmembers, dtype=float)
    d = e[:-1] - e[-1]
    weighted = d if noise is None else np.stack([noise.solve(row) for row in d])
    others = np.linalg.solve(weighted @ d.T, weighted)
    return np.vstack([others, -others.sum(axis=0)])


def abundance_covariance(endmembers, pixel_covariance, noise=None):
    """Error covariance G Sigma G^T of abundances where no constraint but the sum binds (Settle & Drake 1993)."""
    g = sum_to_one_gain(endmembers, noise)
    return g @ pixel_covariance @ g.T

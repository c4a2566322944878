"""Exact forms written from their definitions, which the faster ones of the package are held against."""

import numpy as np

from hyperval.pixels import rank_counts, roc_area


def roc_points(target, background):
    """Every corner of the empirical ROC: ``pfa``, ``pd`` and the least score declared, +inf at first."""
    t, b = np.sort(np.ravel(target).astype(float)), np.sort(np.ravel(background).astype(float))
    value = np.unique(np.concatenate([t, b]))[::-1]
    pd = (t.size - np.searchsorted(t, value, side="left")) / t.size
    pfa = (b.size - np.searchsorted(b, value, side="left")) / b.size
    return np.concatenate([[0.0], pfa]), np.concatenate([[0.0], pd]), np.concatenate([[np.inf], value])


def auc(target, background):
    """The area under the whole curve by production's counts."""
    return roc_area(rank_counts(target, background))

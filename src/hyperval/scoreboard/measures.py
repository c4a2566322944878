"""Metrics of detection as functions of the shares of the background that outscore the objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.processing.roc_areas import AREAS, LEAST_EXPECTED_ALARMS

Array = npt.NDArray[np.float64]

LOG_AREA = "log_auc@1e-3..1e-1"
PD_OF_FAR = 0.5


@dataclass(frozen=True)
class Measure:
    """One metric.

    Attributes
    ----------
    name, title : in the table, and on the page
    of_look : the part each look has in the metric, from (over, tie); the metric is their mean.  None: the quantile
        of false alarms at P_D = 0.5
    better : whether more or less of it is better
    least_pfa : P_FA that the background must resolve for it; 0: any
    observed : name of the metric in the rows of one observed side
    """

    name: str
    title: str
    of_look: Callable[[Array, Array], Array] | None
    better: Literal["high", "low"]
    least_pfa: float
    observed: str

    def known_from(self, n: int) -> bool:
        """Whether ``n`` background pixels resolve it (10 expected alarms)."""
        return self.least_pfa * n >= LEAST_EXPECTED_ALARMS or self.least_pfa == 0.0


def detected_at(pfa: float) -> Callable[[Array, Array], Array]:
    """1 where the object lies above the threshold that lets at most ``pfa`` of the background through."""
    return lambda over, tie: np.asarray(over + tie <= pfa * (1.0 + 1e-9), dtype=float)


MEASURES: Mapping[str, Measure] = {
    m.name: m
    for m in (
        Measure("auc", "AUC", AREAS["auc"].averaged, "high", 0.0, "auc_measured"),
        Measure(
            LOG_AREA, "log-weighted AUC, P_FA 1e-3 to 1e-1", AREAS[LOG_AREA].averaged, "high", 1e-3,
            "log_auc_measured@1e-3..1e-1",
        ),
        Measure("pd@1e-2", "P_D at P_FA 1e-2", detected_at(1e-2), "high", 1e-2, "pd@1e-2"),
        Measure("pd@1e-3", "P_D at P_FA 1e-3", detected_at(1e-3), "high", 1e-3, "pd@1e-3"),
        Measure("far@pd0.5", "false alarms per km2 at P_D 0.5", None, "low", 0.0, "far_measured@pd0.5"),
    )
}  # fmt: skip


def pfa_at_detection(over: Array, tie: Array, weight: Array, pd: float = PD_OF_FAR) -> Array:
    """(D, R) P_FA at the highest threshold that finds a part ``pd`` of the looks.

    Parameters
    ----------
    over, tie : (P, D, R) shares of the background
    weight : (P, R) how often each look is drawn

    Examples
    --------
    >>> over = np.array([[[0.1]], [[0.01]], [[0.2]]])  # share of the background above each of three objects
    >>> pfa_at_detection(over, np.zeros((3, 1, 1)), np.ones((3, 1))).item()
    0.1
    """
    s = over + tie
    order = np.argsort(s, axis=0, kind="stable")
    drawn = np.take_along_axis(np.broadcast_to(weight[:, None, :], s.shape), order, axis=0).cumsum(axis=0)
    reached = np.argmax(drawn >= pd * drawn[-1] * (1.0 - 1e-9), axis=0)
    return np.asarray(np.take_along_axis(np.take_along_axis(s, order, axis=0), reached[None], axis=0)[0])


def measured(measure: Measure, over: Array, tie: Array, weight: Array) -> Array:
    """(D, R) the metric in draws of looks and background; of false alarms the P_FA, not yet per km2."""
    if measure.of_look is None:
        return pfa_at_detection(over, tie, weight)
    return mean_of(measure.of_look(over, tie), weight)


def mean_of(parts: Array, weight: Array) -> Array:
    """(D, R) weighted mean over looks of their parts (P, D, R), the weights (P, R)."""
    return np.asarray(np.einsum("pdr,pr->dr", parts, weight) / weight.sum(axis=0))


def goodness(measure: Measure, values: Array, n: int) -> Array:
    """The metric so that more is better; of P_FA minus its logarithm, no less than half a pixel of ``n``."""
    if measure.better == "high":
        return values
    return np.asarray(-np.log10(np.maximum(values, 0.5 / n)))

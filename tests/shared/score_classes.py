"""Classes of a background as scores, one evaluation each."""

import numpy as np

from hyperval.model import ClassScores, RocScores, log_false_alarm, thresholds_at


def classes(*rows: tuple[float, ...]) -> ClassScores:
    """One evaluation: (f_m, theta_m, sigma_m) of each class, and its degrees of freedom where it has tails."""
    full = np.array([(*row, np.inf)[:4] for row in rows], dtype=float)
    return ClassScores(*full.T[:, None, :])


def at(x, scores: ClassScores) -> tuple[np.ndarray, ClassScores]:
    """Thresholds and as many rows of one evaluation."""
    x = np.ravel(np.asarray(x, dtype=float))
    return x, scores.rows(np.zeros(x.size, dtype=int))


def log_alarms(x, scores: ClassScores) -> np.ndarray:
    return log_false_alarm(*at(x, scores))[0]


def thresholds(pfa, scores: ClassScores) -> np.ndarray:
    return thresholds_at(np.atleast_2d(np.asarray(pfa, dtype=float)), scores)[0]


def roc_of(means, sds, weights, scores: ClassScores) -> RocScores:
    """One evaluation of target pixels over their fills."""
    rows = [np.atleast_2d(np.asarray(a, dtype=float)) for a in (means, sds, weights)]
    return RocScores(scores, np.zeros(1, dtype=int), *rows)

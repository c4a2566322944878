"""Classes of a background as scores, and the printed procedure for the ROC (3.30)-(3.33) step by step."""

import numpy as np
from scipy.special import ndtr

from hyperval.model import ClassScores, RocScores, class_threshold, log_false_alarm, thresholds_at


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


def printed_procedure(mean: float, sd: float, scores: ClassScores, preset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """P_FA, P_D and threshold by (3.30)-(3.33) step by step: the least P_D over the classes at a preset P_FA."""
    lp = np.log(np.atleast_2d(np.asarray(preset, dtype=float)))
    x_m = np.concatenate(
        [class_threshold(lp, scores, m) for m in range(scores.mean.shape[1]) if scores.fraction[0, m] > 0]
    )
    x = x_m.max(axis=0)  # (3.30)
    pd = ndtr((mean - x_m) / sd).min(axis=0)  # (3.31), (3.32)
    pfa = np.exp(log_alarms(x, scores))  # (3.33)
    order = np.argsort(pfa)
    return pfa[order], pd[order], x[order]


def roc_of(means, sds, weights, scores: ClassScores) -> RocScores:
    """One evaluation of target pixels over their fills."""
    rows = [np.atleast_2d(np.asarray(a, dtype=float)) for a in (means, sds, weights)]
    return RocScores(scores, np.zeros(1, dtype=int), *rows)

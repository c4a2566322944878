"""Predicted against measured error of a Gaussian maximum-likelihood classifier."""

from __future__ import annotations

import numpy as np

from hyperval.compare.rows import RowMaker
from hyperval.products import ClassificationError
from hyperval.results import Result


def compare_classification(
    predicted: ClassificationError | None,
    observed: ClassificationError | None,
    *,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows of one set of classes in one set of features.

    ``error_predicted``, ``error_observed`` with their intervals; ``error_difference`` predicted - observed with the
    interval of Newcombe (1998); ``error_inside_interval`` 1 where that holds 0; ``error_approximation`` and
    ``error_bounds`` from the predicted Bhattacharyya distances (the bounds are the interval, the value their
    geometric mean); ``distance_predicted``, ``distance_observed`` of the two nearest classes.

    Examples
    --------
    >>> limits = {"bound_lower": 0.02, "bound_upper": 0.22}
    >>> predicted = ClassificationError(0.10, 0.09, 0.11, distance=0.8, approximation=0.1, **limits)
    >>> observed = ClassificationError(0.12, 0.10, 0.14, 400, 380.0, distance=0.7)
    >>> rows = compare_classification(predicted, observed, subject="grass / soil", method="2 bands")
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('error_predicted', 0.1), ('error_observed', 0.12), ('error_difference', -0.02), ('error_inside_interval',
    1.0), ('error_approximation', 0.1), ('distance_predicted', 0.8), ('distance_observed', 0.7),
    ('error_bounds', 0.066)]
    """
    make = RowMaker("classification", subject, method)

    def rows(p: ClassificationError, o: ClassificationError) -> list[Result]:
        difference = p.error - o.error
        below = float(np.hypot(p.error - p.lower, o.upper - o.error))
        above = float(np.hypot(p.upper - p.error, o.error - o.lower))
        words = "" if o.effective_n is None else f"{o.effective_n:.0f} of {o.n} pixels count as independent"
        out = [
            make.row("error_predicted", p.error, interval=(p.lower, p.upper), n=p.n),
            make.row("error_observed", o.error, interval=(o.lower, o.upper), n=o.n, reason=words),
            make.row("error_difference", difference, interval=(difference - below, difference + above), n=o.n),
            make.row("error_inside_interval", float(difference - below <= 0.0 <= difference + above), n=o.n),
            make.row("error_approximation", p.approximation),
            make.row("distance_predicted", p.distance),
            make.row("distance_observed", o.distance, n=o.n),
        ]
        if p.bound_lower > 0:
            middle = float(np.sqrt(p.bound_lower * p.bound_upper))
            out.append(make.row("error_bounds", middle, interval=(p.bound_lower, p.bound_upper)))
        return out

    return make.compared(predicted, observed, rows)

"""Target area from the sum of scores against its prediction."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy import stats

from hyperval.compare.rows import RowMaker
from hyperval.metrics import Evidence
from hyperval.processing.difference import difference_ratio, difference_ratio_uncertainty
from hyperval.processing.intervals import Z95
from hyperval.products import Abundance
from hyperval.results import Cause, Result


def compare_abundance(
    predicted: Abundance | None,
    observed: Abundance | None,
    *,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows ``area_predicted``, ``area_observed`` [m2], ``area_ratio`` (observed over predicted),
    ``area_difference_ratio``, ``area_z``, ``area_inside_95``.

    The ratio is (predicted - observed)/observed with the first-order interval of both uncertainties; z is the
    difference over sqrt(u_p^2 + u_o^2).  Where neither side has an uncertainty, z and the verdict are SKIPPED.
    Where both sides estimate a nominal area: ``area_error_predicted`` and ``area_error_observed`` [m2], estimate
    less nominal area, ``area_nominal_ratio`` measured over nominal, and ``area_in_predicted_95``, 1 where the
    measured area lies in the predicted interval.

    Examples
    --------
    >>> predicted, observed = Abundance(4.1, 0.2), Abundance(3.8, 0.3, 20, 4.0)
    >>> rows = compare_abundance(predicted, observed, subject="panel", method="fcls")
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('area_predicted', 4.1), ('area_observed', 3.8), ('area_ratio', 0.927), ('area_difference_ratio', 0.079),
    ('area_error_predicted', 0.1), ('area_error_observed', -0.2), ('area_nominal_ratio', 0.95),
    ('area_in_predicted_95', 1.0), ('area_z', 0.832), ('area_inside_95', 1.0)]
    """
    make = RowMaker("abundance", subject, method)

    def rows(predicted: Abundance, observed: Abundance) -> list[Result]:
        p, o = predicted.area_m2, observed.area_m2
        up, uo = predicted.standard_uncertainty, observed.standard_uncertainty
        # Beside the truth's area the pipeline alone moves the row.
        evidence = None if predicted.modelled else Evidence.PIPELINE
        out = [
            make.row("area_predicted", p, half=Z95 * up, unit="m2", n=predicted.n, evidence=evidence),
            make.row("area_observed", o, half=Z95 * uo, unit="m2", n=observed.n),
        ]
        if p > 0:
            half = Z95 * np.hypot(uo / p, o * up / p**2)
            out.append(make.row("area_ratio", o / p, half=half, n=observed.n, evidence=evidence))
        else:
            out.append(make.skipped(Cause.NOT_POSITIVE, "the predicted area is not positive", "area_ratio"))
        if o > 0:
            half = Z95 * float(difference_ratio_uncertainty(p, o, up, uo))
            ratio = float(difference_ratio(p, o))
            out.append(make.row("area_difference_ratio", ratio, half=half, n=observed.n, evidence=evidence))
        else:
            why = "the observed area is not positive"
            out.append(make.skipped(Cause.NOT_POSITIVE, why, "area_difference_ratio"))
        if observed.nominal_m2 is not None:
            for name, side, spread in (("predicted", predicted, up), ("observed", observed, uo)):
                error = side.area_m2 - observed.nominal_m2
                out.append(make.row(f"area_error_{name}", error, half=Z95 * spread, unit="m2", n=side.n))
            ratio, half = o / observed.nominal_m2, Z95 * uo / observed.nominal_m2
            out.append(make.row("area_nominal_ratio", ratio, half=half, n=observed.n))
            out.append(make.row("area_in_predicted_95", float(abs(p - o) <= Z95 * up), n=observed.n))
        u = float(np.hypot(up, uo))
        if not u > 0:
            why = "neither side states an uncertainty"
            return out + [make.skipped(Cause.NO_UNCERTAINTY, why, m) for m in ("area_z", "area_inside_95")]
        z = (p - o) / u
        return [
            *out,
            make.row("area_z", z, evidence=evidence),
            make.row("area_inside_95", float(abs(z) <= Z95), evidence=evidence),
        ]

    return make.compared(predicted, observed, rows)


def compare_area_errors(
    predicted: Mapping[tuple[str, str], Abundance], observed: Mapping[tuple[str, str], Abundance]
) -> list[Result]:
    """Rows by nominal area and method: ``area_bias_*`` and ``area_rmse_*`` [m2] of both sides over its targets.

    The bias has Student's interval, the root mean square error that of chi-square with as many degrees of freedom
    as targets, as if errors were normal of mean 0.  The predicted mean square is that of predicted biases and
    spreads.

    Examples
    --------
    >>> predicted = {("a", "fcls"): Abundance(1.1, 0.1), ("b", "fcls"): Abundance(1.1, 0.1)}
    >>> observed = {("a", "fcls"): Abundance(1.2, 0.1, 4, 1.0), ("b", "fcls"): Abundance(1.0, 0.1, 4, 1.0)}
    >>> rows = compare_area_errors(predicted, observed)
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('area_bias_observed', 0.1), ('area_bias_predicted', 0.1), ('area_rmse_observed', 0.141),
    ('area_rmse_predicted', 0.141)]
    """
    groups: dict[tuple[str, float], list[tuple[str, str]]] = {}
    for key, area in observed.items():
        if area.nominal_m2 is not None and key in predicted:
            groups.setdefault((key[1], round(area.nominal_m2, 6)), []).append(key)
    rows: list[Result] = []
    for (method, nominal), keys in groups.items():
        if len(keys) < 2:
            continue
        make = RowMaker("abundance", f"all targets of {nominal:g} m2", method)
        error = np.array([observed[k].area_m2 - nominal for k in keys])
        model = np.array([predicted[k].area_m2 - nominal for k in keys])
        spread = np.array([predicted[k].standard_uncertainty for k in keys])
        n = len(keys)
        half = float(stats.t.ppf(0.975, n - 1) * np.std(error, ddof=1) / math.sqrt(n))
        bias, expected = float(error.mean()), float(model.mean())
        limits = Z95 * float(np.sqrt(np.sum(spread**2))) / n
        rmse = float(np.sqrt(np.mean(error**2)))
        low, high = np.sqrt(n / stats.chi2.ppf([0.975, 0.025], n))
        rows += [
            make.row("area_bias_observed", bias, half=half, unit="m2", n=n),
            make.row("area_bias_predicted", expected, half=limits, unit="m2", n=n),
            make.row("area_rmse_observed", rmse, interval=(rmse * low, rmse * high), unit="m2", n=n),
            make.row("area_rmse_predicted", float(np.sqrt(np.mean(model**2 + spread**2))), unit="m2", n=n),
        ]
    return rows

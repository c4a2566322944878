"""Target area from the sum of scores against its prediction."""

from __future__ import annotations

import numpy as np

from hyperval.compare.difference import Z95
from hyperval.compare.rows import RowMaker
from hyperval.products import Abundance
from hyperval.results import Result


def compare_abundance(
    predicted: Abundance | None,
    observed: Abundance | None,
    *,
    campaign: str,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows ``area_predicted``, ``area_observed`` [m2], ``area_ratio`` (observed over predicted),
    ``area_difference_ratio``, ``area_z``, ``area_inside_95``.

    The ratio is (predicted - observed)/observed with the first-order interval of both uncertainties; z is the
    difference over sqrt(u_p^2 + u_o^2).  Where neither side has an uncertainty, z and the verdict are SKIPPED.
    """
    make = RowMaker(campaign, "abundance", subject, method)

    def rows(predicted: Abundance, observed: Abundance) -> list[Result]:
        p, o = predicted.area_m2, observed.area_m2
        up, uo = predicted.standard_uncertainty, observed.standard_uncertainty
        out = [
            make.row("area_predicted", p, interval=(p - Z95 * up, p + Z95 * up), unit="m2", n=predicted.n),
            make.row("area_observed", o, interval=(o - Z95 * uo, o + Z95 * uo), unit="m2", n=observed.n),
        ]
        if p > 0:
            spread = Z95 * np.hypot(uo / p, o * up / p**2)
            out.append(make.row("area_ratio", o / p, interval=(o / p - spread, o / p + spread), n=observed.n))
        else:
            out.append(make.skipped("the predicted area is not positive", "area_ratio"))
        if o > 0:
            half = Z95 * np.hypot(up / o, p * uo / o**2)
            ratio = (p - o) / o
            out.append(
                make.row("area_difference_ratio", ratio, interval=(ratio - half, ratio + half), n=observed.n)
            )
        else:
            out.append(make.skipped("the observed area is not positive", "area_difference_ratio"))
        u = float(np.hypot(up, uo))
        if not u > 0:
            return [
                *out,
                *(make.skipped("neither side states an uncertainty", m) for m in ("area_z", "area_inside_95")),
            ]
        z = (p - o) / u
        return [*out, make.row("area_z", z), make.row("area_inside_95", float(abs(z) <= Z95))]

    return make.compared(predicted, observed, rows)

"""The interactive chart of detector scores: density of each population over the score, a tab for each detector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperval.products import Products, ScoreDistribution
from hyperval.report.charts_base import Chart, Fill, chart_content
from hyperval.report.text_cache import chart_models

Array = npt.NDArray[np.float64]
_MOST = 12  # populations of a detector
_SPAN = 5.0  # standard deviations about the mean, where the density is not stated
_DEEPEST = 1e-8  # part of the greatest density


def scores_chart(sides: Sequence[tuple[str, Products]]) -> Chart | None:
    """Densities of the detectors' scores; None without any.

    A density that the product does not state is that of the normal law with its moments.  Sides after the first are
    dashed.
    """
    detectors = list(dict.fromkeys(detector for _, side in sides for _, detector in side.scores))
    if not detectors:
        return None
    fill = Fill()
    tabs = tuple((detector, _fill_densities(fill, i, sides, detector)) for i, detector in enumerate(detectors))
    names = list(dict.fromkeys(subject for _, side in sides for subject, _ in side.scores))
    return Chart(
        "chart-scores",
        "scores",
        "Scores: probability density of each population and of the background; a click on a name shows or hides it",
        f"Probability density (logarithmic) of the detector's score, a tab for each detector. "
        f"Populations: {', '.join(names[:_MOST])}.",
        chart_content(chart_models("densities", "chart-scores", tabs), fill),
    )


def density_of(score: ScoreDistribution) -> tuple[Array, Array]:
    """Scores (G,) [1] and the probability density (G,) at each [per unit of score].

    Examples
    --------
    >>> score, density = density_of(ScoreDistribution(0.5, 0.1))
    >>> round(float(np.trapezoid(density, score)), 5)
    1.0
    """
    if score.grid is not None and score.density is not None:
        return score.grid, score.density
    z = np.linspace(-_SPAN, _SPAN, 201)
    return score.mean + score.sd * z, np.exp(-0.5 * z**2) / (score.sd * np.sqrt(2.0 * np.pi))


def _fill_densities(
    fill: Fill, tab: int, sides: Sequence[tuple[str, Products]], detector: str
) -> tuple[tuple[str, int, str], ...]:
    """Note the numbers of one detector's curves; label and number of the side, and subject, of each."""
    curves = [
        (label, number, subject, *density_of(score))
        for number, (label, side) in enumerate(sides)
        for subject, score in [(s, v) for (s, d), v in side.scores.items() if d == detector and v.sd > 0][:_MOST]
    ]
    low = min((float(x[0]) for *_, x, _ in curves), default=0.0)
    high = max((float(x[-1]) for *_, x, _ in curves), default=1.0)
    top = max((float(np.nanmax(y)) for *_, y in curves), default=1.0)
    fill.ranges[f"score-{tab}"], fill.ranges[f"density-{tab}"] = (low, high), (top * _DEEPEST, 2.0 * top)
    for place, (*_, x, y) in enumerate(curves):
        fill.add(f"density-{tab}-{place}", {"score": x, "density": np.maximum(y, top * _DEEPEST / 10)})
    return tuple((label, number, subject) for label, number, subject, *_ in curves)

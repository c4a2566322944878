"""The uncertainty budget of the radiance: total by source, a plot for each subject and side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperval.products import Products, SpectralEstimate
from hyperval.report import style
from hyperval.report.plots import Axis, Mark, Part, Plots, View
from hyperval.report.sides import Sides, both_first, of_side
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]
_MOST_SOURCES = 7


def budget_plots(sides: Sides) -> list[Plots]:
    """Relative uncertainty of the radiance by source, stacked to the total."""
    estimates = [of_side(side, "radiance") for side in sides]
    every = both_first(*estimates)
    panels: dict[str, tuple[Products, SpectralEstimate]] = {}
    for subject in [s for s in every if all(s in side for side in estimates)] or every:
        for name, side in (("predicted", sides[0]), ("collected", sides[1])):
            if side is not None and subject in side.radiance and side.radiance[subject].budget:
                panels[f"{subject} ({name})"] = side, side.radiance[subject]
    if not panels:
        return []
    shown = dict(list(panels.items())[: style.MAX_PANELS])
    sources = _ranked_sources([estimate for _, estimate in shown.values()])
    label = style.band_label(next(iter(shown.values()))[0].axis)
    title = "Uncertainty budget of the radiance (height: total; colour: share of the variance)"
    return [Plots(
        "radiance-budget", "radiance", title + style.left_out([list(shown)], list(panels)),
        "Relative standard uncertainty of the radiance against wavelength, stacked by source in proportion to its "
        f"share of the variance. Sources, largest first: {', '.join(sources)}. Panels: {', '.join(shown)}.",
        {name: _stack(side, estimate, sources, label) for name, (side, estimate) in shown.items()},
    )]  # fmt: skip


def _stack(side: Products, estimate: SpectralEstimate, sources: Sequence[str], label: str) -> View:
    w, parts = side.axis.centre_nm, _variance_parts(estimate, sources)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.sqrt(parts.sum(axis=0))
        # Variances add, uncertainties do not: each source takes its share of the variance in the height.
        heights = np.nan_to_num(100.0 * total / np.abs(estimate.mean) * parts / parts.sum(axis=0))
    edges = np.concatenate([np.zeros((1, w.size)), np.cumsum(heights, axis=0)])
    marks = tuple(
        Mark("area", {"x": w, "low": low, "high": high}, source, colour, alpha=1.0)
        for low, high, source, colour in zip(edges[:-1], edges[1:], sources, style.SOURCE_COLOURS, strict=False)
    )
    keep = in_window(w) if in_window(w).any() else np.ones(w.shape, bool)
    limits = style.robust_limits([edges[-1][keep]], zero=True)
    x = Axis(label, ends=(float(w[0]), float(max(w[-1], w[0] + 1.0))))
    return View(x, (Part(Axis("standard uncertainty [% of radiance]", ends=limits), marks),))


def _variance_parts(estimate: SpectralEstimate, sources: Sequence[str]) -> Array:
    """(S, B) variance by source; the last is everything that has no place of its own."""
    parts = [np.asarray(estimate.budget.get(s, np.zeros(estimate.mean.shape)), dtype=float) ** 2 for s in sources]
    if sources[-1] == "other sources":
        named = set(sources[:-1])
        rest = [np.asarray(u, dtype=float) ** 2 for s, u in estimate.budget.items() if s not in named]
        parts[-1] = np.sum(rest, axis=0) if rest else parts[-1]
    return np.stack(parts)


def _ranked_sources(estimates: Sequence[SpectralEstimate]) -> list[str]:
    """Sources by their largest median share of the variance, the small ones taken together."""
    weight: dict[str, float] = {}
    for estimate in estimates:
        squares = {
            s: float(np.nanmedian(np.square(u) / np.square(estimate.mean))) for s, u in estimate.budget.items()
        }
        total = sum(squares.values()) or 1.0
        for source, square in squares.items():
            weight[source] = max(weight.get(source, 0.0), square / total)
    ranked = sorted(weight, key=lambda s: (-weight[s], s))
    if len(ranked) > _MOST_SOURCES:
        ranked = [*ranked[: _MOST_SOURCES - 1], "other sources"]
    return ranked

"""Plots of how pixels spread about the mean of their class: eigenvalues and tails."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hyperval.report.plots import GREY, Axis, Mark, Part, Plots, View, measured_mark, predicted_mark
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.style import DIFFERENCE_COLOUR, MAX_PANELS

_UNITS = {"radiance": "(µW cm⁻² sr⁻¹ nm⁻¹)²", "reflectance": "1"}


def sampled_eigenvalue_plots(spectra: Mapping[tuple[str, str], EigenvalueSpectrum]) -> list[Plots]:
    """Eigenvalues of both sides; below each, predicted over measured with the band that chance alone gives."""
    made = []
    for quantity, unit in _UNITS.items():
        own = {subject: s for (subject, q), s in spectra.items() if q == quantity}
        words, views = [], {}
        for subject, s in own.items():
            inside = int(np.sum((s.measured >= s.lower) & (s.measured <= s.upper)))
            words.append(
                f"{subject}: first eigenvalue predicted {s.expected[0]:.3g}, measured {s.measured[0]:.3g}; "
                f"{inside} of {s.measured.size} inside"
            )
            views[f"{subject} (n = {_count(s.n)})"] = _eigenvalues(s, unit)
        if views:
            made.append(Plots(
                f"{quantity}-eigenvalues", "covariance",
                f"Eigenvalues of the {quantity} covariance (band: 95 % of samples of as many independent "
                "pixels drawn from the prediction)",
                f"Leading eigenvalues of the pixel-to-pixel covariance of the {quantity}, logarithmic, predicted "
                "(hollow circles, with the 95 % band of samples of as many pixels) and measured (squares); below, "
                f"predicted over measured with that band. {'. '.join(words)}.", views,
            ))  # fmt: skip
    return made


def tail_plots(tails: Mapping[str, TailCurve]) -> list[Plots]:
    """Share of pixels beyond a Mahalanobis distance: measured, as predicted, normal, and the t that fits best."""
    views, words = {}, []
    for subject, t in list(tails.items())[:MAX_PANELS]:
        views[f"{subject}: {t.dimension} components, n = {_count(t.n)}"] = _tails(t)
        predicted = "" if t.predicted_dof is None else f", {_dof(t.predicted_dof)} predicted"
        words.append(f"{subject}: {_dof(t.fitted_dof)} measured{predicted}")
    if not views:
        return []
    return [Plots(
        "pixel-tails", "covariance",
        "Tails of the pixels in the leading components (interval: binomial, pixels taken as independent)",
        "Share of a class's pixels beyond a Mahalanobis distance in the leading components, logarithmic: measured "
        f"with its 95 % interval, under the predicted law, the normal law, and the fitted t. {'; '.join(words)}.",
        views,
    )]  # fmt: skip


def _eigenvalues(s: EigenvalueSpectrum, unit: str) -> View:
    number = np.arange(1.0, s.measured.size + 1)
    expected = {"x": number, "y": s.expected, "low": s.lower, "high": s.upper}
    above = (
        predicted_mark("line", expected, "predicted, mean and 95 % of samples", marker="circle"),
        measured_mark("line", {"x": number, "y": s.measured}, marker="square"),
    )
    ratio = {
        "x": number,
        **{k: v / s.measured for k, v in zip(("y", "low", "high"), list(expected.values())[1:], strict=True)},
    }
    below = Mark("line", ratio, colour=DIFFERENCE_COLOUR)
    return View(
        Axis("number of the eigenvalue [1]", ends=(0.0, number[-1] + 1.0)),
        (
            Part(Axis(f"eigenvalue [{unit}]", "log"), above),
            Part(Axis("predicted / measured [1]"), (below,), (("y", 1.0),)),
        ),
    )


def _tails(t: TailCurve) -> View:
    measured = {"x": t.distance, "y": t.measured, "low": t.lower, "high": t.upper}
    predicted = np.full(t.distance.size, np.nan) if t.predicted is None else t.predicted
    marks = (
        measured_mark("line", measured, "measured, with its 95 % interval"),
        predicted_mark("line", {"x": t.distance, "y": predicted}, "predicted law"),
        Mark("line", {"x": t.distance, "y": t.normal}, "normal law", GREY, "dotted"),
        Mark("line", {"x": t.distance, "y": t.fitted}, "fitted t", DIFFERENCE_COLOUR, "dashdot"),
    )
    x = Axis("Mahalanobis distance [1]", ends=(0.0, float(t.distance[-1]) * 1.03))
    return View(x, (Part(Axis("share of pixels farther out [1]", "log", ends=(0.3 / t.n, 1.5)), marks),))


def _count(n: int) -> str:
    return f"{n:,}".replace(",", "\u202f")


def _dof(dof: float) -> str:
    return "normal" if math.isinf(dof) else f"{dof:.3g} degrees of freedom"

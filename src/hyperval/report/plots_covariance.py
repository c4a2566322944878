"""Plots of how pixels spread about the mean of their class: eigenvalues and tails."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hyperval.report.plots import COVERAGE, GREY, Axis, Mark, Part, Plots, View, measured_mark, predicted_mark
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.sides import MOST_EIGENVALUES, Sides, both_first, eigenvalues, of_side
from hyperval.report.style import DIFFERENCE_COLOUR, MAX_PANELS, left_out

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


def eigenvalue_plots(sides: Sides) -> list[Plots]:
    """Eigenvalues of the pixel covariance of the radiance of both sides, where no band of chance is known."""
    spectra = [
        {k: e for k, e in of_side(side, "radiance").items() if e.pixel_covariance is not None} for side in sides
    ]
    every = both_first(*spectra)
    pairs = [subject for subject in every if all(subject in own for own in spectra)]
    views, words = {}, []
    for subject in (every if None in sides else pairs)[:MAX_PANELS]:
        marks, firsts = [], []
        for own, mark, marker in zip(spectra, (predicted_mark, measured_mark), ("circle", "square"), strict=True):
            if subject in own:
                n, values = own[subject].n, eigenvalues(own[subject])
                # Large-sample variance of an eigenvalue of a normal sample covariance: 2 lambda^2 / (n - 1).
                factor = math.exp(COVERAGE * math.sqrt(2.0 / (n - 1))) if n is not None and n > 1 else 1.0
                columns = {"x": np.arange(1.0, values.size + 1), "y": values}
                marks.append(
                    mark("line", columns | {"low": values / factor, "high": values * factor}, marker=marker)
                )
                firsts.append(f"{values[0]:.3g}" if values.size else "none")
        x = Axis("number of the eigenvalue [1]", ends=(0.0, MOST_EIGENVALUES + 1.0))
        views[subject] = View(x, (Part(Axis(f"eigenvalue [{_UNITS['radiance']}]", "log"), tuple(marks)),))
        words.append(f"{subject} {' and '.join(firsts)}")
    if not views:
        return []
    return [Plots(
        "radiance-eigenvalues", "covariance",
        "Eigenvalues of the pixel covariance (band: 95 % sampling interval, pixels taken as independent)"
        + left_out([list(views)], pairs or every),
        f"The largest {MOST_EIGENVALUES} eigenvalues of the pixel-to-pixel covariance of the radiance, on a "
        f"logarithmic scale. Largest: {'; '.join(words)}.", views,
    )]  # fmt: skip


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

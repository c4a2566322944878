"""Error of an empirical line with its correlation between bands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.errors import UsageError
from hyperval.processing.elm import EmpiricalLine, PanelMeasurement
from hyperval.products import EstimatedPart

Array = npt.NDArray[np.float64]
Fit = Callable[[Sequence[PanelMeasurement]], EmpiricalLine]

_STEP = 1e-4  # of the reflectance of a panel, and of its radiance


@dataclass(frozen=True)
class PanelErrors:
    """Error covariances (B, B) of one panel: of its reflectance in the field and of its mean radiance.

    ``sampled``: that of the radiance with what it is known by, where it was estimated from the panel's pixels.
    """

    reflectance: Array
    radiance: Array
    sampled: EstimatedPart | None = None


@dataclass(frozen=True)
class LineError:
    """How the reflectance of a line depends on its panels, band by band, and how their errors hang together.

    Attributes
    ----------
    line : the line
    by_reflectance, by_radiance : for each panel, lines fitted with it a step up and a step down
    steps : (P, 2, B) those steps
    errors : of each panel
    fit, panels : how and through what the line was fitted
    """

    line: EmpiricalLine
    by_reflectance: tuple[tuple[EmpiricalLine, EmpiricalLine], ...]
    by_radiance: tuple[tuple[EmpiricalLine, EmpiricalLine], ...]
    steps: Array
    errors: tuple[PanelErrors, ...]
    fit: Fit
    panels: tuple[PanelMeasurement, ...]

    def without(self, name: str) -> LineError | None:
        """The line through the other panels; None where they fix no line."""
        rest = [i for i, panel in enumerate(self.panels) if panel.name != name]
        try:
            return line_error(self.fit, [self.panels[i] for i in rest], [self.errors[i] for i in rest])
        except UsageError:
            return None

    def covariance(self, radiance: npt.ArrayLike, own: str = "") -> Array:
        """(B, B) error covariance, by its panels, of the reflectance of a mean radiance (B,).

        sum over panels of D C_rho D + E C_L E with D, E = diag of the derivatives of the reflectance.  ``own``
        names the panel whose mean radiance it is: the same pixels then are on both sides, and 1/gain comes on top
        of E, so that a line through two panels gives their reflectances back whatever their radiances.  Panels
        that contradict each other have greater errors than is stated: :func:`contradiction` widens them.
        """
        level = np.asarray(radiance, dtype=float)
        total = np.zeros((level.size, level.size))
        for p, errors in enumerate(self.errors):
            d = self._slope(self.by_reflectance[p], self.steps[p, 0], level)
            e = self._slope(self.by_radiance[p], self.steps[p, 1], level)
            if own == self.line.panels[p]:
                e = e + 1.0 / self.line.gain
            total += errors.reflectance * np.outer(d, d) + errors.radiance * np.outer(e, e)
        return total * contradiction(self.line)

    def estimated(self, radiance: npt.ArrayLike) -> tuple[EstimatedPart, ...]:
        """The parts of :meth:`covariance` that were estimated from the panels' pixels; the rest counts as known."""
        level, widened = np.asarray(radiance, dtype=float), contradiction(self.line)
        parts = []
        for p, errors in enumerate(self.errors):
            if errors.sampled is not None:
                e = self._slope(self.by_radiance[p], self.steps[p, 1], level)
                parts.append(errors.sampled.of_each(partial(np.multiply, widened * np.outer(e, e))))
        return tuple(parts)

    def _slope(self, pair: tuple[EmpiricalLine, EmpiricalLine], step: Array, level: Array) -> Array:
        return (pair[0].reflectance(level) - pair[1].reflectance(level)) / (2.0 * step)


def contradiction(line: EmpiricalLine) -> float:
    """Factor by which the panels' errors are greater than stated: 1 where they lie on one line within these.

    Else the reduced chi-square, median over bands, where chance exceeds it in one line of a hundred.  Source:
    Birge, Phys. Rev. 40, 207-227, 1932; York et al., Am. J. Phys. 72, 367-375, 2004.
    """
    chi2 = line.reduced_chi2[np.isfinite(line.reduced_chi2)]
    freedom = len(line.panels) - line.parameters
    if not chi2.size or freedom < 1:
        return 1.0
    median = float(np.median(chi2))
    return median if median > 2.0 * special.gammaincinv(freedom / 2.0, 0.99) / freedom else 1.0


def line_error(
    fit: Fit, panels: Sequence[PanelMeasurement], errors: Sequence[PanelErrors], line: EmpiricalLine | None = None
) -> LineError:
    """Derivatives of a line by every panel, by central differences: the law of propagation (JCGM 100:2008, 5.2).

    Parameters
    ----------
    fit : the way from panels to the line
    panels, errors : in the same order
    """
    fit_line = line or fit(panels)
    by_reflectance, by_radiance, steps = [], [], []
    for i, p in enumerate(panels):
        h, g = _STEP * np.maximum(p.reflectance, 0.01), _STEP * np.maximum(np.abs(p.radiance), 1e-12)
        steps.append([h, g])
        by_reflectance.append(
            (
                fit(_with(panels, i, replace(p, reflectance=p.reflectance + h))),
                fit(_with(panels, i, replace(p, reflectance=p.reflectance - h))),
            )
        )
        by_radiance.append(
            (
                fit(_with(panels, i, replace(p, radiance=p.radiance + g))),
                fit(_with(panels, i, replace(p, radiance=p.radiance - g))),
            )
        )
    return LineError(
        fit_line, tuple(by_reflectance), tuple(by_radiance), np.array(steps), tuple(errors), fit, tuple(panels)
    )


def _with(panels: Sequence[PanelMeasurement], i: int, panel: PanelMeasurement) -> list[PanelMeasurement]:
    return [panel if j == i else p for j, p in enumerate(panels)]

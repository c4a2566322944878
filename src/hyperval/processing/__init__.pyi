"""ELM, features, detectors and ROC, for statistics and for pixels (3.21-3.33)."""

from .line import EmpiricalLine, LineFit, MeasuredPanel, darkest_pixel_panel, fit_elm, fit_line

__all__ = ["EmpiricalLine", "LineFit", "MeasuredPanel", "darkest_pixel_panel", "fit_elm", "fit_line"]

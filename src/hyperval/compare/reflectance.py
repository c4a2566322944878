"""Reflectance after the empirical line: predicted against collected."""

from __future__ import annotations

from hyperval.compare.spectral import compare_spectra
from hyperval.products import SpectralEstimate
from hyperval.results import Result
from hyperval.spectra.axis import SpectralAxis


def compare_reflectance(
    predicted: SpectralEstimate | None,
    observed: SpectralEstimate | None,
    *,
    campaign: str,
    subject: str,
    method: str,
    axis: SpectralAxis,
) -> list[Result]:
    """Rows of the reflectance [1] of one subject.

    Metrics: :func:`hyperval.compare.spectral.compare_spectra`.

    A side that is None gives one SKIPPED row.
    """
    return compare_spectra(
        predicted, observed, campaign=campaign, product="reflectance", subject=subject, method=method, axis=axis
    )

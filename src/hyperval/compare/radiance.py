"""Radiance: predicted (3.7-3.12 with the sensor) against the mean of a region."""

from __future__ import annotations

from hyperval.compare.spectral import compare_spectra
from hyperval.products import SpectralEstimate
from hyperval.results import Result
from hyperval.spectra.axis import SpectralAxis


def compare_radiance(
    predicted: SpectralEstimate | None,
    observed: SpectralEstimate | None,
    *,
    campaign: str,
    subject: str,
    method: str,
    axis: SpectralAxis,
) -> list[Result]:
    """Rows of the radiance [uW cm-2 sr-1 nm-1] of one subject.

    Metrics: :func:`hyperval.compare.spectral.compare_spectra`.

    A side that is None gives one SKIPPED row.
    """
    return compare_spectra(
        predicted, observed, campaign=campaign, product="radiance", subject=subject, method=method, axis=axis
    )

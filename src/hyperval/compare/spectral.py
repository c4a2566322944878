"""Rows that every spectral product shares: radiance, SNR, reflectance."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hyperval.compare.consistency import (
    chi_square_diagonal,
    chi_square_full,
    chi_square_shape,
    detectable_tilts,
    share_inside,
    spectral_angle_degrees,
    whitening,
    z_scores,
)
from hyperval.compare.difference import (
    comparable_bands,
    median_interval,
    regions,
    size_intervals,
)
from hyperval.compare.rows import RowMaker
from hyperval.compare.wavelengths import wavelength_rows
from hyperval.processing.difference import difference_ratio, difference_ratio_covariance
from hyperval.processing.intervals import Z95
from hyperval.products import SpectralEstimate
from hyperval.results import Cause, Result
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]

# Two measurements never meet to this part of their level.
ROUNDING = 1e-9
# Spectra of files and cubes have 24 bits: a smaller stated uncertainty is none.
NUMERICAL = 6e-8
# Of what a source states of its values: about 95 % of a normal law.
STATED_COVERAGE = 2.0


def compare_spectra(
    predicted: SpectralEstimate | None,
    observed: SpectralEstimate | None,
    *,
    product: str,
    subject: str,
    method: str,
    axis: SpectralAxis,
) -> list[Result]:
    """Rows of one spectrum.

    Per good band: ``difference_ratio`` with its 95 % interval, and ``z``.  Per region R of windows, vnir, swir1,
    swir2, absorption: ``median_difference_ratio_R`` (with interval), ``median_abs_difference_ratio_R`` and
    ``max_abs_difference_ratio_R``.  Over the windows: ``chi2_reduced_diagonal``, ``p_value_diagonal``,
    ``chi2_reduced_full``, ``p_value_full``, ``bias_ratio`` (mean difference ratio), ``chi2_reduced_shape``,
    ``p_value_shape``, ``fraction_inside_95`` (bands with |z| <= 1.96) and ``spectral_angle``; of radiance
    :func:`hyperval.compare.wavelengths.wavelength_rows` where both sides have the absorptions of the atmosphere.
    A region without a comparable band gives SKIPPED rows; one that the sensor does not see gives none.  A measured
    spectrum that is no evidence, since the prediction's own input made it, gives one SKIPPED row.  Where the source
    of the observation states more than its error in the comparison, besides ``fraction_inside_stated`` and
    ``fraction_inside_stated_windows``.
    """
    make = RowMaker(product, subject, method)
    if predicted is not None and observed is not None and observed.circular:
        return [make.skipped(Cause.CIRCULAR, observed.circular)]

    def rows(p: SpectralEstimate, o: SpectralEstimate) -> list[Result]:
        return _rows(make, p, o, axis) + (wavelength_rows(make, p, o, axis) if product == "radiance" else [])

    return make.compared(predicted, observed, rows)


def _rows(
    make: RowMaker, predicted: SpectralEstimate, observed: SpectralEstimate, axis: SpectralAxis
) -> list[Result]:
    usable = comparable_bands(predicted, observed, axis)
    ratio = difference_ratio(predicted.mean, observed.mean)
    ratio_covariance = difference_ratio_covariance(predicted, observed)
    half = Z95 * np.sqrt(np.clip(np.diag(ratio_covariance), 0.0, None))
    half = np.where(half > 0.0, half, np.nan)  # no error is stated: no interval
    difference = predicted.mean - observed.mean
    covariance = predicted.error_covariance + observed.error_covariance
    z = z_scores(difference, covariance)
    n = observed.n
    out: list[Result] = []
    for b in np.flatnonzero(usable):
        at = float(axis.centre_nm[b])
        why = "" if np.isfinite(ratio[b]) else "observed value is not positive"
        out.append(make.row("difference_ratio", ratio[b], half=half[b], band_nm=at, n=n, reason=why))
        if np.isfinite(z[b]):
            out.append(make.row("z", z[b], band_nm=at, n=n))
    if observed.stated is not None:
        for name, bands in (("", usable), ("_windows", usable & regions(axis)["windows"])):
            if bands.any():
                share = fraction_inside_stated(difference[bands], observed.stated[bands])
                out.append(make.row(f"fraction_inside_stated{name}", share, n=int(bands.sum())))
    for name, region in regions(axis).items():
        if not region.any() and name != "windows":
            continue  # the sensor does not see this part of the spectrum: nothing was planned there
        out += _summary(make, name, ratio, ratio_covariance, usable & region & np.isfinite(ratio))
    window = usable & regions(axis)["windows"]
    return out + _consistency(make, predicted, observed, window, axis.centre_nm, (ratio, ratio_covariance))


def fraction_inside_stated(difference: Array, stated: Array) -> float:
    """Share of bands whose difference (B,) is at most twice the standard uncertainty (B,) that a source states."""
    return float(np.mean(np.abs(difference) <= STATED_COVERAGE * stated))


def leading_source(predicted: SpectralEstimate, observed: SpectralEstimate, bands: npt.NDArray[np.bool_]) -> str:
    """In words, the source that holds more than half of the variance of both sides in ``bands``; empty without one.

    It bounds what a test can tell: a mixed pixel whose host varies more than the target shows tests the host.
    """
    parts = [
        (name, float(np.nansum(u[bands] ** 2))) for side in (predicted, observed) for name, u in side.budget.items()
    ]
    total = sum(variance for _, variance in parts)
    if not total > 0.0:
        return ""
    name, most = max(parts, key=lambda part: part[1])
    return f"{100.0 * most / total:.0f} % of the variance: {name}" if most > 0.5 * total else ""


def _summary(
    make: RowMaker, name: str, ratio: Array, covariance: Array, bands: npt.NDArray[np.bool_]
) -> list[Result]:
    metrics = [f"{m}_{name}" for m in ("median_difference_ratio", "median_abs_difference_ratio")]
    metrics.append(f"max_abs_difference_ratio_{name}")
    count = int(bands.sum())
    if count == 0:
        return [make.skipped(Cause.NO_BANDS, f"no comparable band in {name}", metric) for metric in metrics]
    r = ratio[bands]
    here = covariance[np.ix_(bands, bands)]
    middle, largest = size_intervals(r, here)
    return [
        make.row(metrics[0], float(np.median(r)), interval=median_interval(r, here), n=count),
        make.row(metrics[1], float(np.median(np.abs(r))), interval=middle, n=count),
        make.row(metrics[2], float(np.max(np.abs(r))), interval=largest, n=count),
    ]


def _consistency(
    make: RowMaker,
    predicted: SpectralEstimate,
    observed: SpectralEstimate,
    window: npt.NDArray[np.bool_],
    centre_nm: Array,
    relative: tuple[Array, Array],
) -> list[Result]:
    names = (
        "chi2_reduced_diagonal", "p_value_diagonal", "chi2_reduced_full", "p_value_full",
        "bias_ratio", "chi2_reduced_shape", "p_value_shape", "fraction_inside_95", "spectral_angle",
    )  # fmt: skip
    if not window.any():
        return [make.skipped(Cause.NO_BANDS, "no comparable band in windows", name) for name in names]
    p, o = predicted.mean[window], observed.mean[window]
    r, cov = p - o, (predicted.error_covariance + observed.error_covariance)[np.ix_(window, window)]
    parts_here = [part.bands(window) for part in (*predicted.estimated, *observed.estimated)]
    cause = Cause.NONE
    if not np.all(np.diag(cov) > (NUMERICAL * o) ** 2):
        cause, reason = Cause.NO_UNCERTAINTY, "neither side states an uncertainty beyond rounding in some bands"
    elif np.max(np.abs(r)) <= ROUNDING * np.max(np.abs(o)):
        # Such as a panel that an empirical line of two panels goes through.
        reason = "both sides are equal to rounding: one was made from the other, which is no evidence"
        cause = Cause.CIRCULAR
    if cause is not Cause.NONE:
        out = [make.skipped(cause, reason, name) for name in names[:-1]]
    else:
        tested = whitening(cov, parts_here)
        diagonal, full = chi_square_diagonal(r, cov), chi_square_full(r, tested)
        shape = chi_square_shape(r, o, tested)
        tilts = detectable_tilts(o, centre_nm[window], tested)
        inside, limits = share_inside(r, cov)
        bias, bias_sd = _mean_ratio(*relative, window)
        kept = f"{full.dof} of {int(window.sum())} directions kept" if full.dof < window.sum() else ""
        if math.isfinite(full.covariance_dof):
            words = f"covariance known by {full.covariance_dof:.0f} effective degrees of freedom"
            kept = f"{kept}; {words}" if kept else words
        kept = "; ".join(part for part in (kept, leading_source(predicted, observed, window)) if part)
        out = [
            make.row(names[0], diagonal.reduced, n=diagonal.dof),
            make.row(names[1], diagonal.p_value, n=diagonal.dof),
            make.row(names[2], full.reduced, n=full.dof, reason=kept),
            make.row(names[3], full.p_value, n=full.dof, detectable=tilts[0], reason=kept),
            make.row(names[4], bias, half=Z95 * bias_sd, n=full.dof),
            make.row(names[5], shape.reduced, n=shape.dof),
            make.row(names[6], shape.p_value, n=shape.dof, detectable=tilts[1]),
            make.row(names[7], inside, interval=limits, n=int(window.sum())),
        ]
    angle = spectral_angle_degrees(p, o)
    return [*out, make.row(names[8], angle, unit="degree", n=int(window.sum()))]


def _mean_ratio(ratio: Array, covariance: Array, window: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Unweighted mean of the difference ratio and its standard uncertainty.

    The weighted mean by the inverse covariance is left to the test of shape: where errors are strongly correlated
    and the shapes differ it lies outside of all its data (Peelle's puzzle; Chiba & Smith 1991, ANL/NDM-121).
    """
    use = window & np.isfinite(ratio)
    if not use.any():
        return float("nan"), float("nan")
    n = int(use.sum())
    return float(ratio[use].mean()), float(np.sqrt(max(covariance[np.ix_(use, use)].sum(), 0.0)) / n)

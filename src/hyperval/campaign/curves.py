"""Curves that only figures need: eigenvalue spectra with their sampling bands, and tails."""

from __future__ import annotations

import numpy as np

from hyperval.compare.covariance import MOST_EIGENVALUES, sampled
from hyperval.compare.products import SPREAD
from hyperval.processing.covariance_sampling import SamplingBand
from hyperval.processing.intervals import clopper_pearson
from hyperval.processing.tails import exceedance_of_distance
from hyperval.products import Observation, PixelDistribution, Prediction
from hyperval.report.run import EigenvalueSpectrum, TailCurve

MOST_SUBJECTS = 6  # in each quantity; those with the most pixels


def spread_curves(
    prediction: Prediction, observation: Observation
) -> tuple[dict[tuple[str, str], EigenvalueSpectrum], dict[str, TailCurve]]:
    """How the pixels of both sides spread: eigenvalues by (subject, quantity), tails by subject."""
    return eigenvalue_spectra(prediction, observation), tail_curves(prediction, observation)


def eigenvalue_spectra(
    prediction: Prediction, observation: Observation
) -> dict[tuple[str, str], EigenvalueSpectrum]:
    """Eigenvalues of the classes that both sides hold, by (subject, quantity), with the band of chance alone."""
    out = {}
    for quantity in SPREAD:
        left, right = getattr(prediction, quantity), getattr(observation, quantity)
        common = [s for s in right if s in left and right[s].n and right[s].pixel_covariance is not None]
        for subject in sorted(common, key=lambda s: -right[s].n)[:MOST_SUBJECTS]:
            sample = sampled(
                left[subject],
                right[subject],
                observation.axis,
                prediction.distribution.get(subject),
                observation.distribution.get(subject),
                MOST_EIGENVALUES,
            )
            if sample is None or isinstance(sample, str):
                continue
            low, high = SamplingBand.limits(sample.band.eigenvalues)
            out[subject, quantity] = EigenvalueSpectrum(
                sample.measured.eigenvalues, sample.band.eigenvalues.mean(axis=0), low, high, sample.n
            )
    return out


def tail_curves(prediction: Prediction, observation: Observation) -> dict[str, TailCurve]:
    """Tails in the leading components, by subject of the collection."""
    out = {}
    for subject, law in observation.distribution.items():
        known = prediction.distribution.get(subject)
        if law.distance is not None and law.exceedance is not None and law.leading_dimension is not None:
            out[subject] = _curve(law, None if known is None else known.tail_dof)
    return out


def _curve(distribution: PixelDistribution, predicted_dof: float | None) -> TailCurve:
    distance, share = np.asarray(distribution.distance), np.asarray(distribution.exceedance)
    n, dimension = distribution.n or 1, distribution.leading_dimension or 1
    lower, upper = clopper_pearson(share * n, np.full(share.size, n))
    normal = exceedance_of_distance(distance, dimension, np.inf)
    fitted = exceedance_of_distance(distance, dimension, distribution.leading_tail_dof)
    predicted = None if predicted_dof is None else exceedance_of_distance(distance, dimension, predicted_dof)
    return TailCurve(
        np.sqrt(distance), share, lower, upper, predicted, normal, fitted,
        predicted_dof, distribution.leading_tail_dof, dimension, n,
    )  # fmt: skip

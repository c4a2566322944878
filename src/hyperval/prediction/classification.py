"""Predicted error of a Gaussian maximum-likelihood classifier, from the classes' predicted statistics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hyperval.errors import UsageError
from hyperval.prediction.inputs import cut
from hyperval.processing.class_features import class_features, feature_bands
from hyperval.processing.gaussian_classifier import ClassLaw, predicted_error
from hyperval.products import ClassificationError, Prediction
from hyperval.spectra.windows import in_window


class FeatureChoice(Protocol):
    """Bands or components under a name."""

    @property
    def name(self) -> str:
        """Stands in the table as the method."""

    @property
    def bands_nm(self) -> Sequence[float]:
        """Wavelengths of the bands; empty: all."""

    @property
    def pca(self) -> int | None:
        """Principal components; None: bands."""


def predicted_classification(
    prediction: Prediction,
    sets: Sequence[Sequence[str]],
    features: Sequence[FeatureChoice],
    quantity: str,
    seed: int = 0,
) -> dict[tuple[str, str], ClassificationError]:
    """Errors by (classes, features), for pixels as the prediction says they are, tails included.

    The classifier is the same in radiance and in reflectance, as a line through each band leaves it as it is;
    ``quantity`` is that of the image.  Sets with a class that the prediction lacks are left out.

    Raises
    ------
    UsageError : a class without spread, which a Gaussian classifier cannot take.
    """
    axis = prediction.axis
    spectra = getattr(prediction, quantity)
    usable = in_window(axis.centre_nm) & axis.good
    out = {}
    for chosen in sets:
        if not all(name in spectra for name in chosen):
            continue
        for choice in features:
            bands = feature_bands(axis.centre_nm, usable, choice.bands_nm)
            laws = []
            for name in chosen:
                estimate = spectra[name]
                if estimate.pixel_covariance is None or not np.all(np.diag(estimate.pixel_covariance)[bands] > 0):
                    raise UsageError(f"classification: the prediction of {name!r} has no spread in some band")
                known = prediction.distribution.get(name)
                tail = np.inf if known is None else known.tail_dof
                laws.append(ClassLaw(estimate.mean[bands], cut(estimate.pixel_covariance, bands), tail))
            psi = class_features(laws, choice.pca)
            rng = np.random.default_rng([seed, bands.size])
            out[" / ".join(chosen), choice.name] = predicted_error([law.project(psi) for law in laws], rng)
    return out

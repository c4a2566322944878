"""What a classifier sees of a spectrum: bands, or principal components of the classes taken together (3.21)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.features import principal_components
from hyperval.processing.gaussian_classifier import ClassLaw

Array = npt.NDArray[np.float64]


def feature_bands(
    centre_nm: Array, usable: npt.NDArray[np.bool_], wavelengths_nm: Sequence[float]
) -> npt.NDArray[np.intp]:
    """Indices of the usable bands nearest to some wavelengths, or of all usable bands where none is named.

    Raises
    ------
    UsageError : no usable band, or two wavelengths that share the nearest one.
    """
    indices = np.flatnonzero(usable)
    if indices.size == 0:
        raise UsageError("no usable band for classification")
    if not wavelengths_nm:
        return indices
    nearest = indices[np.abs(centre_nm[indices][None, :] - np.asarray(wavelengths_nm)[:, None]).argmin(axis=1)]
    bands, count = np.unique(nearest, return_counts=True)
    if np.any(count > 1):
        raise UsageError(
            f"two wavelengths share the band at {centre_nm[bands[count > 1][0]]:g} nm",
            where="classification.features.bands_nm",
        )
    return bands


def class_features(laws: Sequence[ClassLaw], components: int | None) -> Array:
    """Psi (K, F): the leading components of the mixture of equally likely classes, or the identity.

    The covariance of the mixture is the mean of the classes' covariances and the spread of their means.
    """
    size = laws[0].mean.size
    if components is None:
        return np.eye(size)
    means = np.stack([law.mean for law in laws])
    between = np.cov(means.T, bias=True).reshape(size, size)
    return principal_components(np.mean([law.covariance for law in laws], axis=0) + between, components)

"""Second-order statistics of a surface class: what scene, imagery and simulation exchange."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.scene.components import Components
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ClassStatistics:
    """Mean and covariance of one surface class, in reflectance or in radiance.

    Attributes
    ----------
    name : class name
    axis : the bands
    mean : (B,) mean
    covariance : (B, B) pixel-to-pixel covariance, symmetric, positive semi-definite
    n : number of samples behind it, None when it is a definition rather than an estimate
    source : where the numbers come from, in words
    tail_dof : degrees of freedom of a multivariate t (nu > 2), None for Gaussian
    components : the clusters that the pixels fall into, None where they are one
    """

    name: str
    axis: SpectralAxis
    mean: Array
    covariance: Array
    n: int | None = None
    source: str = ""
    tail_dof: float | None = None
    components: Components | None = None

    def __post_init__(self) -> None:
        mean = np.asarray(self.mean, dtype=float)
        cov = np.asarray(self.covariance, dtype=float)
        bands = len(self.axis)
        if mean.shape != (bands,) or cov.shape != (bands, bands):
            raise UsageError(
                f"class {self.name!r}: mean {mean.shape} and covariance {cov.shape} do not fit {bands} bands"
            )
        if not (np.all(np.isfinite(mean)) and np.all(np.isfinite(cov))):
            raise UsageError(f"class {self.name!r}: mean and covariance must be finite")
        scale = float(np.max(np.abs(cov))) or 1.0
        if float(np.max(np.abs(cov - cov.T))) > 1e-9 * scale:
            raise UsageError(f"class {self.name!r}: the covariance is not symmetric")
        try:  # a Cholesky factor exists when no eigenvalue lies below -1e-9 scale bands: cheaper than they are
            np.linalg.cholesky(cov + 1e-9 * scale * bands * np.eye(bands))
        except np.linalg.LinAlgError:
            raise UsageError(f"class {self.name!r}: the covariance is not positive semi-definite") from None
        if self.tail_dof is not None and not self.tail_dof > 2:
            raise UsageError(f"class {self.name!r}: tail_dof must exceed 2, got {self.tail_dof:g}")
        if self.components is not None and self.components.offsets.shape[1] != bands:
            raise UsageError(f"class {self.name!r}: its components do not fit {bands} bands")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", cov)

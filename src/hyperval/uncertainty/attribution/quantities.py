"""Single numbers of a comparison, for which each input's effect and the change that closes the gap are told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.processing.roc_reading import detection_at
from hyperval.products import Products, SpectralEstimate
from hyperval.spectra.windows import in_window

POINTS = (1e-2, 1e-3)


@dataclass(frozen=True, eq=False)
class Quantity:
    """One number of both sides.

    Attributes
    ----------
    product, subject, method, metric : as in the results table
    observed : what the collection says
    read : the same of a prediction
    """

    product: str
    subject: str
    method: str
    metric: str
    observed: float
    read: Callable[[Products], float]


def quantities(predicted: Products, observed: Products) -> list[Quantity]:
    """Predicted over observed mean in windows of radiance, reflectance and SNR; P_D at P_FA 1e-2 and 1e-3."""
    items: list[Quantity] = []
    for product in ("radiance", "reflectance", "snr", "toa_reflectance"):
        left, right = getattr(predicted, product), getattr(observed, product)
        for subject in right:
            if subject not in left:
                continue
            use = observed.axis.good & in_window(observed.axis.centre_nm)
            use &= np.isfinite(left[subject].mean) & np.isfinite(right[subject].mean)
            if not use.any():
                continue

            level = float(np.mean(right[subject].mean[use]))
            if not level > 0:
                continue

            def ratio(
                p: Products,
                product: str = product,
                subject: str = subject,
                use: npt.NDArray[np.bool_] = use,
                level: float = level,
            ) -> float:
                estimate: SpectralEstimate = getattr(p, product)[subject]
                return float(np.mean(estimate.mean[use])) / level

            items.append(Quantity(product, subject, "", "ratio_windows", 1.0, ratio))
    for key, curve in observed.roc.items():
        there = predicted.roc.get(key)
        if there is None or key[2] != "pixel":
            continue
        for pfa in POINTS:
            if pfa < max(curve.pfa[0], there.pfa[0]):
                continue

            def pd(p: Products, key: tuple[str, str, str] = key, at: float = pfa) -> float:
                return float(detection_at(p.roc[key], at))

            name = f"pd@{pfa:.0e}".replace("e-0", "e-")
            items.append(Quantity("roc", key[0], f"{key[1]}/{key[2]}", name, pd(observed), pd))
    return items

"""Where both radiances have the absorptions of the atmosphere: a shift of wavelengths that levels hardly show."""

from __future__ import annotations

import math

import numpy as np

from hyperval.compare.rows import RowMaker
from hyperval.processing.intervals import Z95
from hyperval.processing.wavelength_check import FEATURES, absorption_centre, centre_uncertainty
from hyperval.products import SpectralEstimate
from hyperval.results import Result
from hyperval.spectra.axis import SpectralAxis


def wavelength_rows(
    make: RowMaker, predicted: SpectralEstimate, observed: SpectralEstimate, axis: SpectralAxis
) -> list[Result]:
    """Rows ``absorption_centre_difference@FEATURE`` [nm], predicted less measured, of what both sides show.

    Both centres come from the same bands in the same way, so that what a band set does to a centre falls out.  The
    interval holds the stated errors of both spectra within the absorption; where none is stated there is none.

    Examples
    --------
    >>> w = np.arange(700.0, 830.0, 2.5)
    >>> def side(centre_nm):
    ...     depth = 0.5 * np.exp(-0.5 * ((w - centre_nm) / 4.0) ** 2)
    ...     return SpectralEstimate(1.0 - depth, 1e-6 * np.eye(w.size))
    >>> make, axis = RowMaker("radiance", "lawn", "sixs"), SpectralAxis(w, np.full(w.size, 5.0))
    >>> [(row.metric, round(row.value, 1)) for row in wavelength_rows(make, side(764.0), side(763.0), axis)]
    [('absorption_centre_difference@oxygen-763', 1.0)]
    """
    rows = []
    use = axis.good & np.isfinite(predicted.mean) & np.isfinite(observed.mean)
    at = np.flatnonzero(use)[np.argsort(axis.centre_nm[use], kind="stable")]
    w = axis.centre_nm[at]
    for feature in FEATURES:
        centres = []
        for side in (predicted, observed):
            y, c = side.mean[at], side.error_covariance[np.ix_(at, at)]
            centre, _ = absorption_centre(w, y, feature)
            centres.append((centre, centre_uncertainty(w, y, c, feature, centre)))
        (p, up), (o, uo) = centres
        if math.isnan(p) or math.isnan(o):
            continue
        half = Z95 * math.hypot(up, uo) or math.nan
        name = f"absorption_centre_difference@{feature.key}"
        rows.append(make.row(name, p - o, half=half, unit="nm", n=observed.n))
    return rows

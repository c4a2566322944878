"""Which bands the detectors use (3.21)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.scenario import Scenario
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.windows import in_window


def detection_bands(scenario: Scenario, axis: SpectralAxis, usable: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Indices of the bands that the detectors use (Psi of unit rows, 3.21).

    ``usable`` (B,) is False where a spectrum or the light is lacking.  Raises UsageError when none is left.
    """
    choice = scenario.processing.bands
    keep = usable.copy()
    if choice.drop_bad:
        keep &= axis.good
    if choice.windows_only:
        keep &= in_window(axis.centre_nm)
    if choice.ranges:
        keep &= np.any([(axis.centre_nm >= a) & (axis.centre_nm <= b) for a, b in choice.ranges], axis=0)
    for name, listed in (("channels", choice.channels), ("bad_channels", choice.bad_channels)):
        if listed and max(listed) >= keep.size:
            raise UsageError(
                f"processing.bands.{name}: band {max(listed)} of {keep.size}",
                expected=f"numbers from 0 to {keep.size - 1}",
            )
        if listed:
            here = np.isin(np.arange(keep.size), listed)
            keep &= here if name == "channels" else ~here
    if not keep.any():
        raise UsageError("no band is left for detection", mend="widen processing: bands")
    return np.flatnonzero(keep)

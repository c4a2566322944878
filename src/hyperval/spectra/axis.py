"""The spectral axis: the bands that every product of one comparison shares."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.units import PLAUSIBLE_NM


@dataclass(frozen=True)
class SpectralAxis:
    """Band centres and widths.

    Attributes
    ----------
    centre_nm : (B,) strictly increasing band centres [nm]
    fwhm_nm : (B,) full widths at half maximum [nm]; positive
    good : (B,) True where the band is usable (bad-band list applied)
    """

    centre_nm: npt.NDArray[np.float64]
    fwhm_nm: npt.NDArray[np.float64]
    good: npt.NDArray[np.bool_] = field(default_factory=lambda: np.ones(0, bool))

    def __post_init__(self) -> None:
        centre = np.asarray(self.centre_nm, dtype=float)
        fwhm = np.broadcast_to(np.asarray(self.fwhm_nm, dtype=float), centre.shape).copy()
        good = np.asarray(self.good, dtype=bool)
        if good.size == 0:  # not given: every band is usable
            good = np.ones(centre.shape, bool)
        if centre.ndim != 1 or centre.size == 0:
            raise UsageError("a spectral axis needs a one-dimensional, non-empty list of band centres")
        if not np.all(np.isfinite(centre)) or not np.all(np.isfinite(fwhm)):
            raise UsageError("band centres and widths must be finite")
        if np.any(np.diff(centre) <= 0):
            at = int(np.flatnonzero(np.diff(centre) <= 0)[0])
            raise UsageError(
                f"band centres must increase: band {at + 2} ({centre[at + 1]:g} nm) "
                f"follows band {at + 1} ({centre[at]:g} nm)"
            )
        if np.any(fwhm <= 0):
            raise UsageError("band widths (FWHM) must be positive")
        if good.shape != centre.shape:
            raise UsageError(f"the bad-band list has {good.size} entries for {centre.size} bands")
        for name, value in (("centre_nm", centre), ("fwhm_nm", fwhm), ("good", good)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return int(self.centre_nm.size)

    @property
    def numbered(self) -> bool:
        """True where numbers of bands stand in place of wavelengths, which are never below 100 nm."""
        return bool(self.centre_nm[0] < PLAUSIBLE_NM[0])

    def select(self, keep: npt.NDArray[Any]) -> SpectralAxis:
        """The axis of the bands that ``keep`` (mask or indices) names."""
        return SpectralAxis(self.centre_nm[keep], self.fwhm_nm[keep], self.good[keep])

    def matches(self, other: SpectralAxis, tolerance_nm: float = 0.05) -> bool:
        """True when both axes have the same band centres to ``tolerance_nm``."""
        return len(self) == len(other) and bool(np.all(np.abs(self.centre_nm - other.centre_nm) <= tolerance_nm))


def fwhm_from_spacing(centre_nm: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Band widths assumed equal to the local band spacing [nm]: for files that list no FWHM."""
    centre = np.asarray(centre_nm, dtype=float)
    if centre.size < 2:
        raise UsageError("a single band needs its FWHM stated: there is no spacing to take it from")
    return np.asarray(np.gradient(centre))

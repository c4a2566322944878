"""What the spectra of a collection say of its wavelengths."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from hyperval.processing.wavelength_check import Shift, wavelength_shifts
from hyperval.spectra.axis import SpectralAxis


def collection_shifts(
    spectra: Iterable[npt.NDArray[np.float64]], axis: SpectralAxis, *, reflectance: bool
) -> list[tuple[Shift, int]]:
    """The median shift of every feature over spectra (B,) of one axis, and how many of them show it.

    The uncertainty is that of where the feature lies, which the spectra share: it is not divided by their number.
    Where it differs between spectra it is the median.
    """
    shifts: dict[str, list[Shift]] = {}
    for spectrum in spectra:
        for shift in wavelength_shifts(spectrum, axis, reflectance=reflectance):
            shifts.setdefault(shift.feature, []).append(shift)
    return [
        (
            Shift(name, *(float(np.median(x)) for x in ([s.nm for s in each], [s.uncertainty_nm for s in each]))),
            len(each),
        )
        for name, each in shifts.items()
    ]


def wavelength_notes(
    spectra: Iterable[npt.NDArray[np.float64]], axis: SpectralAxis, *, reflectance: bool
) -> list[str]:
    """The shifts in words, a warning for each that is certain."""
    shifts = collection_shifts(spectra, axis, reflectance=reflectance)
    if not shifts:
        feature = "an absorption of oxygen or water vapour"
        if reflectance:
            feature = "a red edge of plants or a rest of the oxygen band"
        return [f"the wavelengths could not be checked: no spectrum shows {feature}"]
    parts = [
        f"{s.feature} {s.nm:+.1f} nm (standard uncertainty {s.uncertainty_nm:.1f}, {n} spectra)" for s, n in shifts
    ]
    notes = ["wavelengths as labelled less those of known features: " + "; ".join(parts)]
    notes += [
        f"warning: the {s.feature} lies {abs(s.nm):.1f} nm (standard uncertainty {s.uncertainty_nm:.1f}) "
        f"{'above' if s.nm > 0 else 'below'} its place: the wavelengths of the collection seem to be shifted"
        for s, _ in shifts
        if s.certain
    ]
    return notes

"""What a flight line's header says of its acquisition, in words: SpecTIR (AISA) entries among others.

Such entries have no standard.  They change no number here; they go into the notes of the report.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from hyperval.spectra.axis import SpectralAxis

_CO2_NM = 2010.0  # the carbon dioxide bands that a shift is fitted to lie at about 2000-2070 nm
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def acquisition_notes(
    entries: Mapping[str, str], axis: SpectralAxis, samples: int, stored_bands: int
) -> tuple[str, ...]:
    """Sentences about the acquisition, one for each thing that the header tells; none when it tells nothing.

    Parameters
    ----------
    entries : header entries in lower case, braces taken off (``Cube.extras``)
    axis : the bands, for the size of a spectral shift
    samples, stored_bands : size of the image, against which the detector windows are held
    """
    notes: list[str] = []
    notes += _spectral_shift(entries, axis)
    files = _listed(entries, r"(gain|calibration|\bcal\b|dark).*\bfiles?\b|\bcal(ibration)? file")
    if files:
        notes.append(f"header: calibration from {files}")
    times = _listed(entries, r"gps.*(time|start|stop|end)|^(start|stop) time$|^acquisition (date|time)$")
    if times:
        notes.append(f"header: acquired {times}; the times of the scenario should agree")
    settings = _listed(entries, r"^fps$|^frame ?rate$|^tint[0-9]*$|^binning[0-9]*$")
    if settings:
        notes.append(f"header: {settings} (integration times without a unit; milliseconds are usual)")
    notes += _windows(entries, samples, stored_bands)
    return tuple(notes)


def _spectral_shift(entries: Mapping[str, str], axis: SpectralAxis) -> list[str]:
    notes = []
    for key, text in _matching(entries, r"co2.*shift|shift.*co2"):
        value = _first(text)
        if value is None:
            notes.append(f"warning: header: '{key} = {_short(text)}' is not understood")
            continue
        if value == 0.0:
            notes.append(f"header: {key} is 0")
            continue
        near = int(np.argmin(np.abs(axis.centre_nm - _CO2_NM)))
        size = ""
        if abs(axis.centre_nm[near] - _CO2_NM) < 100.0:
            size = f", {abs(value) / axis.fwhm_nm[near]:.2f} of a band width at {axis.centre_nm[near]:.0f} nm"
        notes.append(
            f"warning: header: CO2 shift {value:g} nm found ('{key}', unit taken as nm{size}): the band centres "
            "may be off by as much where the producer did not correct them; "
            "sensor_operation.wavelength_shift_nm of the scenario can tell what that would do"
        )
    return notes


def _windows(entries: Mapping[str, str], samples: int, stored_bands: int) -> list[str]:
    """Detector windows: himgN are samples, vimgN are bands, both counted from 1."""
    notes = []
    bands = [w for _, text in _matching(entries, r"^vimg[0-9]+$") if (w := _pair(text)) is not None]
    if len(bands) > 1:
        listed = " and ".join(f"{first}-{last}" for first, last in bands)
        last = max(last for _, last in bands)
        if last == stored_bands:
            notes.append(f"header: {len(bands)} detectors, bands {listed} (from 1)")
        else:
            notes.append(f"warning: header: detectors hold bands {listed} (from 1), the cube {stored_bands}")
    across = {w for _, text in _matching(entries, r"^himg[0-9]*$") if (w := _pair(text)) is not None}
    for first, last in sorted(across):
        if last - first + 1 != samples:
            notes.append(
                f"header: {last - first + 1} samples across the track, {samples} in the cube: it was cut or "
                "resampled to a map grid, where one measured pixel may stand several times"
            )
    return notes


def _matching(entries: Mapping[str, str], pattern: str) -> list[tuple[str, str]]:
    return [(key, " ".join(text.split())) for key, text in entries.items() if re.search(pattern, key)]


def _listed(entries: Mapping[str, str], pattern: str) -> str:
    return ", ".join(f"{key} {_short(text)}" for key, text in _matching(entries, pattern) if text)


def _short(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."


def _first(text: str) -> float | None:
    found = _NUMBER.search(text)
    value = float(found.group()) if found else None
    return value if value is not None and np.isfinite(value) else None


def _pair(text: str) -> tuple[int, int] | None:
    found = re.fullmatch(r"\s*([0-9]{1,6})\s*,\s*([0-9]{1,6})\s*", text)
    return (int(found.group(1)), int(found.group(2))) if found else None

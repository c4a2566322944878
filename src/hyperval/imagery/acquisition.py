"""What a flight line's header says of its acquisition, in words: SpecTIR (AISA) entries among others.

Such entries have no standard.  They change no number here; they go into the notes of the report.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, date, datetime

import numpy as np

from hyperval.spectra.axis import SpectralAxis

_CO2_NM = 2010.0  # the carbon dioxide bands that a shift is fitted to lie at about 2000-2070 nm
MINUTES_APART = 10.0  # the sun moves 2.5 degrees in ten minutes
_TIMES = r"gps.*(time|start|stop|end)|^(start|stop) time$|^acquisition (date|time)$"
# Entries of a header and what is said of them; None: where the level and a spectral shift are told.
_SAID: dict[str | None, str] = {
    r"^(sensor|instrument)( (type|name|id|model|serial number))?$|^(sensor|instrument)id$": "{}",
    None: "",
    r"(gain|calibration|\bcal\b|dark|flat).*\bfiles?\b|\bcal(ibration)? file": "calibration from {}",
    _TIMES: "acquired {}; the times of the scenario should agree",
    r"^fps$|^frame ?rate$|^tint[0-9]*$|^binning[0-9]*$": "{} (integration times have no unit; milliseconds are usual)",
}
_NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def acquisition_notes(
    entries: Mapping[str, str],
    axis: SpectralAxis,
    samples: int,
    stored_bands: int,
    lines: int | None = None,
    quantity: str | None = None,
) -> tuple[str, ...]:
    """Sentences about the acquisition, one for each thing that the header tells; none when it tells nothing.

    Parameters
    ----------
    entries : header entries in lower case, braces taken off (``Cube.extras``)
    axis : the bands, for the size of a spectral shift
    samples, stored_bands, lines : size of the image, against which detector windows, times and frame rate are held
    quantity : what the campaign takes the cube for, against which the processing level is held
    """
    notes = []
    for pattern, words in _SAID.items():
        if pattern is None:
            notes += _level(entries, quantity) + _spectral_shift(entries, axis)
        elif listed := ", ".join(f"{key} {_short(text)}" for key, text in _matching(entries, pattern) if text):
            notes.append("header: " + words.format(listed))
    return (*notes, *_frames(entries, lines), *_windows(entries, samples, stored_bands))


def _level(entries: Mapping[str, str], quantity: str | None) -> list[str]:
    """Processing level and data units, and whether they are those of another quantity than the campaign's."""
    listed = _matching(entries, r"^(processing|product) ?level$|^level$|^data ?(units?|type name)$|^z plot titles$")
    notes = [f"header: {key} {_short(text)}" for key, text in listed if text]
    for key, text in listed:
        named = {q for q in ("radiance", "reflectance") if re.search(rf"(?<![a-z]){q}", text.lower())}
        if quantity in ("radiance", "reflectance") and named and quantity not in named:
            notes.append(
                f"warning: header: '{key} = {_short(text)}' speaks of {' and '.join(sorted(named))}, the campaign "
                f"takes the cube for {quantity}"
            )
    return notes


def _frames(entries: Mapping[str, str], lines: int | None) -> list[str]:
    """Frame rate against integration times, and against the times of start and stop."""
    rate = next((v for _, t in _matching(entries, r"^fps$|^frame ?rate$") if (v := _first(t)) is not None), None)
    if rate is None or rate <= 0:
        return []
    notes = []
    frame_ms = 1000.0 / rate
    for key, text in _matching(entries, r"^tint[0-9]*$"):
        if (_first(text) or 0.0) > 1.01 * frame_ms:
            notes.append(
                f"warning: header: {key} {_first(text):g} is longer than a frame at {rate:g} frames per second "
                f"({frame_ms:.4g} ms): it is not in ms, or one of them is wrong"
            )
    ends = [t for end in ("start", "stop|end") for _, t in _matching(entries, rf"^gps ({end}) time$")[:1]]
    clock = [seconds for text in ends if (seconds := _clock(text)) is not None]
    if len(clock) == 2 and lines is not None:
        seconds = (clock[1] - clock[0]) % 86400.0
        if seconds > 0 and abs(lines / rate / seconds - 1.0) > 0.1:
            notes.append(
                f"header: {lines} lines at {rate:g} frames per second take {lines / rate:.4g} s, the GPS times are "
                f"{seconds:.4g} s apart: a part of the line, binned or resampled lines, or a wrong rate"
            )
    return notes


def time_notes(entries: Mapping[str, str], when: datetime, name: str) -> tuple[str, ...]:
    """Warnings where a time of the header is not that of a scenario: another day, or more than ten minutes apart.

    Parameters
    ----------
    when : time of the scenario, with its offset from UTC
    name : of the scenario

    GPS time runs ahead of UTC by less than 20 s, which is left aside; a header in local time is found too.
    """
    utc = when.astimezone(UTC)
    notes = []
    for key, text in _matching(entries, _TIMES):
        day, seconds, stated = _day(text), _clock(text), f"warning: header: '{key} = {_short(text)}' is"
        if day is not None and day != utc.date():
            notes.append(f"{stated} not the day of scenario {name!r}, {utc:%Y-%m-%d}")
        elif seconds is not None:
            of_day = utc.hour * 3600.0 + utc.minute * 60.0 + utc.second
            apart = (seconds - of_day + 43200.0) % 86400.0 - 43200.0
            if abs(apart) > 60.0 * MINUTES_APART:
                side = f"{abs(apart) / 60:.0f} minutes {'after' if apart > 0 else 'before'}"
                scenario = f"the time of scenario {name!r}, {utc:%H:%M:%S} UTC"
                notes.append(f"{stated} {side} {scenario}: local time, or the sun stands elsewhere")
    return tuple(notes)


def _clock(text: str) -> float | None:
    """Seconds since midnight of the first hh:mm or hh:mm:ss in a text."""
    match = re.search(r"(?<![0-9:])([0-9]{1,2}):([0-9]{2})(?::([0-9]{2}(?:\.[0-9]+)?))?", text)
    if match is None:
        return None
    hour, minute, second = int(match.group(1)), int(match.group(2)), float(match.group(3) or 0.0)
    return hour * 3600.0 + minute * 60.0 + second if hour < 24 and minute < 60 and second < 61 else None


def _day(text: str) -> date | None:
    """The first date in the form 2012-09-20 or 2012/09/20; other orders are not clear."""
    match = re.search(r"(?<![0-9])([0-9]{4})[-/]([0-9]{1,2})[-/]([0-9]{1,2})(?![0-9])", text)
    try:
        return date(*(int(g) for g in match.groups())) if match is not None else None
    except ValueError:
        return None


def _spectral_shift(entries: Mapping[str, str], axis: SpectralAxis) -> list[str]:
    notes = []
    for key, text in _matching(entries, r"(co2|wavelength|spectral).*shift|shift.*(co2|wavelength|spectral)"):
        kind = "CO2 shift" if "co2" in key else "wavelength shift"
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
            f"warning: header: {kind} {value:g} nm found ('{key}', unit taken as nm{size}): the band centres "
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


def _short(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."


def _first(text: str) -> float | None:
    match = _NUMBER.search(text)
    value = float(match.group()) if match else None
    return value if value is not None and np.isfinite(value) else None


def _pair(text: str) -> tuple[int, int] | None:
    match = re.fullmatch(r"\s*([0-9]{1,6})\s*,\s*([0-9]{1,6})\s*", text)
    return (int(match.group(1)), int(match.group(2))) if match else None

"""What a flight line's header says of its acquisition, in words: SpecTIR (AISA) entries among others.

Such entries have no standard.  They change no number here; they go into the notes of the report.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, date, datetime

import numpy as np

from hyperval.errors import package_table
from hyperval.spectra.axis import SpectralAxis

_WORDS = "imagery/acquisition.yaml"
_CO2_NM = 2010.0  # the carbon dioxide bands that a shift is fitted to lie at about 2000-2070 nm
MINUTES_APART = 10.0  # the sun moves 2.5 degrees in ten minutes
_LEVELS = r"^(processing|product) ?level$|^level$|^data ?(units?|type name)$|^z plot titles$"
_NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def _said(sentence: str, text: str = "", **values: object) -> str:
    """A sentence, filled."""
    return str(package_table(_WORDS)["sentences"][sentence]).format(text=_short(text), **values)


def _short(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."


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
    for kind in package_table(_WORDS)["listed"]:
        if "says" not in kind:
            notes += _level(entries, quantity) + _spectral_shift(entries, axis)
        elif listed := ", ".join(f"{k} {_short(t)}" for k, t in _matching(entries, kind["keys"]) if t):
            notes.append("header: " + kind["says"].format(listed))
    return (*notes, *_frames(entries, lines), *_windows(entries, samples, stored_bands))


def _level(entries: Mapping[str, str], quantity: str | None) -> list[str]:
    """Processing level and data units, and whether they are those of another quantity than the campaign's."""
    listed = _matching(entries, _LEVELS)
    notes = [f"header: {key} {_short(text)}" for key, text in listed if text]
    for key, text in listed:
        named = {q for q in ("radiance", "reflectance") if re.search(rf"(?<![a-z]){q}", text.lower())}
        if quantity in ("radiance", "reflectance") and named and quantity not in named:
            speaks = " and ".join(sorted(named))
            notes.append(_said("other_level", key=key, text=text, named=speaks, quantity=quantity))
    return notes


def _frames(entries: Mapping[str, str], lines: int | None) -> list[str]:
    """Frame rate against integration times, and against the times of start and stop."""
    rate = next((v for _, t in _matching(entries, r"^fps$|^frame ?rate$") if (v := _first(t)) is not None), 0.0)
    if rate <= 0:
        return []
    frame_ms = 1000.0 / rate
    times = {key: _first(text) or 0.0 for key, text in _matching(entries, r"^tint[0-9]*$")}
    late = {key: tint for key, tint in times.items() if tint > 1.01 * frame_ms}
    notes = [_said("tint", key=key, tint=tint, rate=rate, frame_ms=frame_ms) for key, tint in late.items()]
    ends = [t for end in ("start", "stop|end") for _, t in _matching(entries, rf"^gps ({end}) time$")[:1]]
    clock = [seconds for text in ends if (seconds := _clock(text)) is not None]
    if len(clock) == 2 and lines is not None:
        seconds = (clock[1] - clock[0]) % 86400.0
        if seconds > 0 and abs(lines / rate / seconds - 1.0) > 0.1:
            notes.append(_said("lines", lines=lines, rate=rate, needed=lines / rate, seconds=seconds))
    return notes


def time_notes(entries: Mapping[str, str], when: datetime, name: str) -> tuple[str, ...]:
    """Warnings where a time of the header is not that of a scenario: another day, or more than ten minutes apart.

    Parameters
    ----------
    when : time of the scenario, with its offset from UTC
    name : of the scenario

    GPS time runs ahead of UTC by less than 20 s, which is left aside; a header in local time is found too.
    """
    utc, notes = when.astimezone(UTC), []
    times = next(kind["keys"] for kind in package_table(_WORDS)["listed"] if "times" in kind.get("says", ""))
    for key, text in _matching(entries, times):
        day, seconds, told = _day(text), _clock(text), {"key": key, "name": name, "utc": utc}
        if day is not None and day != utc.date():
            notes.append(_said("day", text, **told))
        elif seconds is not None:
            of_day = utc.hour * 3600.0 + utc.minute * 60.0 + utc.second
            apart = (seconds - of_day + 43200.0) % 86400.0 - 43200.0
            if abs(apart) > 60.0 * MINUTES_APART:
                notes.append(
                    _said("time", text, minutes=abs(apart) / 60, side="after" if apart > 0 else "before", **told)
                )
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
    near = int(np.argmin(np.abs(axis.centre_nm - _CO2_NM)))
    notes = []
    for key, text in _matching(entries, r"(co2|wavelength|spectral).*shift|shift.*(co2|wavelength|spectral)"):
        value, size = _first(text), ""
        if value and abs(axis.centre_nm[near] - _CO2_NM) < 100.0:
            size = _said("size", widths=abs(value) / axis.fwhm_nm[near], nm=axis.centre_nm[near])
        kind = "CO2 shift" if "co2" in key else "wavelength shift"
        sentence = "no_shift" if value is None else "shift" if value else "zero_shift"
        notes.append(_said(sentence, key=key, text=text, kind=kind, value=value, size=size))
    return notes


def _windows(entries: Mapping[str, str], samples: int, stored_bands: int) -> list[str]:
    """Detector windows: himgN are samples, vimgN are bands, both counted from 1."""
    notes = []
    bands = [w for _, text in _matching(entries, r"^vimg[0-9]+$") if (w := _pair(text)) is not None]
    if len(bands) > 1:
        listed = " and ".join(f"{first}-{last}" for first, last in bands)
        sentence = "detectors" if max(last for _, last in bands) == stored_bands else "other_detectors"
        notes.append(_said(sentence, count=len(bands), listed=listed, stored=stored_bands))
    across = {w for _, text in _matching(entries, r"^himg[0-9]*$") if (w := _pair(text)) is not None}
    wide = [last - first + 1 for first, last in sorted(across)]
    return notes + [_said("across", wide=count, samples=samples) for count in wide if count != samples]


def _matching(entries: Mapping[str, str], pattern: str) -> list[tuple[str, str]]:
    return [(key, " ".join(text.split())) for key, text in entries.items() if re.search(pattern, key)]


def _first(text: str) -> float | None:
    match = _NUMBER.search(text)
    value = float(match.group()) if match else None
    return value if value is not None and np.isfinite(value) else None


def _pair(text: str) -> tuple[int, int] | None:
    match = re.fullmatch(r"\s*([0-9]{1,6})\s*,\s*([0-9]{1,6})\s*", text)
    return (int(match.group(1)), int(match.group(2))) if match else None

"""Where a header speaks against the campaign: level of processing, shift of the wavelengths, time of the flight.

Such entries have no standard.  They change no number here; they go into the notes of the report.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, date, datetime

import numpy as np

from hyperval.errors import package_table
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import number_of

_WORDS = "imagery/acquisition.yaml"
_CO2_NM = 2010.0  # the carbon dioxide bands that a shift is fitted to lie at about 2000-2070 nm
MINUTES_APART = 10.0  # the sun moves 2.5 degrees in ten minutes
_LEVELS = r"^(processing|product) ?level$|^level$|^data ?(units?|type name)$|^z plot titles$"
_SHIFTS = r"(co2|wavelength|spectral).*shift|shift.*(co2|wavelength|spectral)"
_TIMES = r"gps.*(time|start|stop|end)|^(start|stop) time$|^acquisition (date|time)$"


def _said(sentence: str, text: str = "", **values: object) -> str:
    """A sentence, filled."""
    text = text if len(text) <= 80 else text[:77] + "..."
    return "warning: header: " + str(package_table(_WORDS)[sentence]).format(text=text, **values)


def acquisition_notes(entries: Mapping[str, str], axis: SpectralAxis, quantity: str) -> tuple[str, ...]:
    """Warnings of a level or a unit that is that of another quantity, and of a shift of the wavelengths.

    Parameters
    ----------
    entries : header entries in lower case, braces taken off (``Cube.extras``)
    axis : the bands, for the size of a shift
    quantity : what the campaign takes the cube for
    """
    notes, near = [], int(np.argmin(np.abs(axis.centre_nm - _CO2_NM)))
    for key, text in _matching(entries, _LEVELS) if quantity in ("radiance", "reflectance") else ():
        named = {q for q in ("radiance", "reflectance") if re.search(rf"(?<![a-z]){q}", text.lower())}
        if named and quantity not in named:
            notes.append(_said("level", text, key=key, named=" and ".join(sorted(named)), quantity=quantity))
    for key, text in _matching(entries, _SHIFTS):
        value, size = number_of(text.removesuffix("nm")), ""
        if abs(axis.centre_nm[near] - _CO2_NM) < 100.0:
            size = f", {abs(value) / axis.fwhm_nm[near]:.2f} of a band width at {axis.centre_nm[near]:.0f} nm"
        if value:
            sentence = "shift" if np.isfinite(value) else "no shift"
            notes.append(
                _said(sentence, text, key=key, kind="CO2" if "co2" in key else "wavelength", nm=value, size=size)
            )
    return tuple(notes)


def time_notes(entries: Mapping[str, str], when: datetime, name: str) -> tuple[str, ...]:
    """Warnings where a time of the header is not that of a scenario: another day, or more than ten minutes apart.

    Parameters
    ----------
    when : time of the scenario, with its offset from UTC
    name : of the scenario

    GPS time runs ahead of UTC by less than 20 s, which is left aside; a header in local time is found too.
    """
    utc, notes = when.astimezone(UTC), []
    for key, text in _matching(entries, _TIMES):
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


def _matching(entries: Mapping[str, str], pattern: str) -> list[tuple[str, str]]:
    return [(key, " ".join(text.split())) for key, text in entries.items() if re.search(pattern, key)]

"""What every reader of spectra hands over; the one place that decides quantity, unit and scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, UsageError, refuse
from hyperval.units import (
    PLAUSIBLE_NM,
    irradiance_to_internal,
    only_wavelength_unit,
    radiance_to_internal,
    wavelength_to_nm,
    wavelength_unit_note,
)

Array = npt.NDArray[np.float64]

MAX_BYTES = 10_000_000
MAX_ROWS = 100_000
PLAUSIBLE_REFLECTANCE = 1.5  # median above this: not a fraction
DELETED = -1e30  # libraries mark deleted channels by -1.23e34
FILLS = (-999.0, -9999.0, -32768.0, -99999.0)  # what others write for it
MAX_JOINS = 4  # backward jumps of the wavelength: more is not a set of detectors


@dataclass(frozen=True, eq=False)
class SpectrumErrors:
    """Errors of a spectrum by kind, as its file states them.

    Attributes
    ----------
    random : (n,) standard uncertainty of what differs from channel to channel
    systematic : (n,) standard uncertainty of what is correlated between channels
    correlation : (n, n) of the systematic part; not to be written to, as spectra of a file share it
    """

    random: Array
    systematic: Array
    correlation: Array

    def covariance(self) -> Array:
        """(n, n) D_r^2 + D_s R D_s."""
        return np.diag(self.random**2) + np.outer(self.systematic, self.systematic) * self.correlation

    def at(self, index: npt.NDArray[np.intp], factor: float = 1.0) -> SpectrumErrors:
        """Of some channels, in another unit."""
        whole = np.array_equal(index, np.arange(self.random.size))  # spectra of a file go on sharing their matrix
        correlation = self.correlation if whole else self.correlation[np.ix_(index, index)]
        return SpectrumErrors(self.random[index] * factor, self.systematic[index] * factor, correlation)


@dataclass(frozen=True, eq=False)
class FieldSpectrum:
    """One spectrum with what the file says of its spread.

    Attributes
    ----------
    name : as in the file, or the file's name
    wavelength_nm : (n,) strictly increasing [nm]
    values : (n,) reflectance as a fraction, radiance in uW cm-2 sr-1 nm-1, irradiance in uW cm-2 nm-1, or as in the
        file
    standard_deviation : (n,) of the replicates behind the mean, in the unit of ``values``; None if unknown
    n : number of replicates, None if unknown
    source : the file
    quantity : "reflectance", "radiance", "irradiance" or "other"
    notes : what was converted, cut or left out
    errors : by kind, where the file states them; None otherwise
    """

    name: str
    wavelength_nm: Array
    values: Array
    standard_deviation: Array | None
    n: int | None
    source: str
    quantity: str = "reflectance"
    notes: tuple[str, ...] = ()
    errors: SpectrumErrors | None = None


@dataclass(frozen=True, eq=False)
class Record(FieldSpectrum):
    """A spectrum as it stands in a file, with the facts that the file states.

    Attributes
    ----------
    quantity : empty where the file states none
    wavelength_unit, unit : of ``wavelength_nm`` and of the values; None where the file states none
    doubt : why the unit of a reflectance must be stated although the file seems to tell it
    """

    standard_deviation: Array | None = None
    n: int | None = None
    source: str = ""
    quantity: str = ""
    wavelength_unit: str | None = None
    unit: str | None = None
    doubt: str | None = None


def reflectance_factor(unit: str) -> float:
    """What multiplies a reflectance in ``unit`` ("fraction", "percent", "scaled:F") to give a fraction."""
    head, _, tail = unit.partition(":")
    try:
        scale = {"fraction": 1.0, "1": 1.0, "percent": 100.0, "%": 100.0}.get(unit) or float(tail)
    except ValueError:
        scale = np.nan
    if (tail and head.strip() != "scaled") or not (np.isfinite(scale) and scale > 0):
        raise UsageError(f"unknown reflectance unit {unit!r}", expected="fraction, percent or scaled:10000")
    return 1.0 / scale


_FACTORS: dict[str, Callable[[str], float]] = {
    "reflectance": reflectance_factor, "radiance": radiance_to_internal, "irradiance": irradiance_to_internal,
}  # fmt: skip


def finished(
    record: Record,
    quantity: str = "reflectance",
    wavelength_unit: str | None = None,
    reflectance_unit: str | None = None,
    unit: str | None = None,
    unit_if_unstated: str | None = None,
) -> FieldSpectrum:
    """A record in the units of the project, wavelengths in order, and what cannot be true refused.

    Parameters
    ----------
    quantity : what is wanted: "reflectance", "radiance", "irradiance" or "other"
    wavelength_unit, reflectance_unit, unit : must agree with the file where it states them
    unit_if_unstated : of a radiance or irradiance, where neither the file nor ``unit`` states one

    Raises
    ------
    InputError : another quantity, or values that cannot be.
    UsageError : a unit that nobody states, or in which the file and its caller disagree.
    """
    where, of_light = record.source, quantity in ("radiance", "irradiance")
    if quantity not in (*_FACTORS, "other"):
        raise UsageError(f"unknown quantity {quantity!r}", expected="reflectance, radiance, irradiance or other")
    panel = "give the reflectance: the spectrum over that of a white panel under the same light"
    mend = panel if quantity == "reflectance" and record.quantity in ("radiance", "irradiance") else None
    other = record.quantity and quantity not in ("other", record.quantity)
    refuse(other, f"the file holds {record.quantity}, not {quantity}", where, mend=mend)
    record, factor = _ordered(_without_gaps(_in_nm(record, wavelength_unit))), 1.0
    if quantity in _FACTORS:
        stated = record.unit if record.unit and ("W " in record.unit) == of_light else None
        given, doubt = unit if of_light else reflectance_unit, record.doubt if quantity == "reflectance" else None
        mend = "state reflectance_unit: fraction (or percent)"
        refuse(doubt and given is None, str(doubt), where, "values in the unit that the file states", mend, UsageError)
        final = _agreed(stated, given, _FACTORS[quantity], quantity, where)
        final = final or (unit_if_unstated if of_light else "fraction")
        refuse(final is None, f"the unit of the {quantity} is not stated", where, mend="state unit:", kind=UsageError)
        factor = _FACTORS[quantity](str(final))
        if not of_light:
            _check_reflectance(record, factor)
    spread = record.standard_deviation
    refuse(spread is not None and np.any(spread < 0), "standard deviations below 0", where)
    return replace(
        _kept(record, np.arange(record.values.size), factor, "" if factor == 1.0 else f"values x {factor:g}"),
        quantity=quantity,
    )


def _agreed(stated: str | None, given: str | None, factor: Callable[[str], float], what: str, where: str) -> str | None:
    """The unit that a file states or its caller gives; UsageError where they are not the same."""
    unlike = stated is not None and given is not None and factor(stated) != factor(given)
    mend = None if what == "wavelengths" else "leave the caller's out"
    said = f"the file states {what} in {stated}, the caller in {given}"
    refuse(unlike, said, where, mend=mend, kind=UsageError)
    return stated or given


def _check_reflectance(record: Record, factor: float) -> None:
    """Refuse marks of missing values, and what is no fraction."""
    marks = np.isin(record.values, FILLS)
    if marks.any():
        mark, mend = record.values[marks][0], "delete these channels, or write NaN in their place"
        what = f"{marks.sum()} channels hold {mark:g}, which marks a missing value and is no reflectance"
        raise InputError(what, where=record.source, mend=mend)
    middle = float(np.median(record.values)) * factor
    name = "scaled:10000" if middle > 150.0 else "percent"
    what = f"half of the reflectances exceed {middle:.4g}: the spectrum looks like {name}"
    mend = f"state reflectance_unit: {name}"
    refuse(middle > PLAUSIBLE_REFLECTANCE, what, record.source, "reflectance as a fraction", mend)


def _in_nm(record: Record, given: str | None) -> Record:
    """The record with wavelengths in nm; a unit that nobody states is noted where only one is possible.

    Raises
    ------
    UsageError : the unit is not stated and not plain from the numbers, or cannot be true.
    """
    values, where, notes = record.wavelength_nm, record.source, record.notes
    unit = _agreed(record.wavelength_unit, given, wavelength_to_nm, "wavelengths", where)
    if unit is None and (unit := only_wavelength_unit(values)) is not None:
        notes = (*notes, wavelength_unit_note(values, unit))
    least, most = values.min(), values.max()
    what = f"the file does not say whether its wavelengths ({least:g} to {most:g}) are in nm or um"
    expected = f"nm, or um (then they are {least * 1e3:g} to {most * 1e3:g} nm)"
    refuse(unit is None, what, where, expected, "state wavelength_unit", UsageError)
    nm = values * wavelength_to_nm(str(unit))
    low, high = PLAUSIBLE_NM
    absurd = not np.all(np.isfinite(nm)) or nm.min() < low or nm.max() > high
    what = f"wavelengths from {least:g} to {most:g} cannot be in {unit}"
    refuse(absurd, what, where, f"{low:g} to {high:g} nm", "correct wavelength_unit (nm or um)", UsageError)
    return replace(record, wavelength_nm=nm, wavelength_unit="nm", notes=notes)


def _without_gaps(record: Record) -> Record:
    """The record without channels that hold no value (NaN, or the mark of a deleted channel)."""
    keep = np.isfinite(record.values) & (record.values > DELETED)
    if record.standard_deviation is not None:
        known = np.isfinite(record.standard_deviation) & (record.standard_deviation > DELETED)
        if known.any():
            keep &= known
        else:  # a column for it, and no number in it
            record = replace(record, standard_deviation=None)
    if keep.all():
        return record
    refuse(keep.sum() < 2, "fewer than two channels hold a value", record.source)
    return _kept(record, np.flatnonzero(keep), note=f"{int((~keep).sum())} channels without a value left out")


def _ordered(record: Record) -> Record:
    """The record in strictly increasing wavelength.

    A file in falling order is turned round.  Where the wavelength jumps back, a new detector begins:
    of the range that both cover, the lower half is taken from the earlier detector, the upper half
    from the later one.
    """
    w, where = record.wavelength_nm, record.source
    refuse(w.size < 2, f"a spectrum of {w.size} channels", where, "at least two")
    step = np.diff(w)
    if np.all(step > 0):
        return record
    if np.all(step < 0):
        return _kept(record, np.arange(w.size)[::-1], note="wavelengths fall in the file: turned round")
    starts = np.flatnonzero(step <= 0) + 1
    parts, cuts = np.split(np.arange(w.size), starts), list[float]()
    what = f"wavelengths jump back {starts.size} times, first to {w[starts[0]]:g} nm"
    expected = "increasing wavelengths, or up to five detectors one after the other"
    refuse(starts.size > MAX_JOINS, what, where, expected)
    for i in range(starts.size):
        before, after = parts[i : i + 2]
        overlap = w[before[0]] < w[after[0]] <= w[before[-1]] < w[after[-1]]
        what = f"wavelengths jump back from {w[before[-1]]:g} to {w[after[0]]:g} nm, but no detectors overlap"
        refuse(not overlap, what, where)
        cuts.append(0.5 * (w[before[-1]] + w[after[0]]))
        parts[i], parts[i + 1] = before[w[before] <= cuts[i]], after[w[after] > cuts[i]]
    joined = ", ".join(f"{c:.1f}" for c in cuts)
    return _kept(record, np.concatenate(parts), note=f"overlapping detectors joined at {joined} nm")


def mean_of(records: list[Record]) -> Record:
    """Mean, standard deviation (n - 1) and number of replicates on one wavelength grid."""
    first = records[0]
    unlike = len(records) < 2 or any(not np.array_equal(r.wavelength_nm, first.wavelength_nm) for r in records)
    refuse(unlike, "a mean needs two or more spectra on the same wavelengths", first.source, kind=UsageError)
    values = np.stack([r.values for r in records])
    spread = values.std(axis=0, ddof=1)
    return replace(
        first, name="mean", values=values.mean(axis=0), standard_deviation=spread, n=len(records), errors=None
    )


def _kept(record: Record, index: npt.NDArray[np.intp], factor: float = 1.0, note: str = "") -> Record:
    """Some channels of a record, its values multiplied."""
    spread, errors = record.standard_deviation, record.errors
    return replace(
        record,
        wavelength_nm=record.wavelength_nm[index],
        values=record.values[index] * factor,
        standard_deviation=None if spread is None else spread[index] * factor,
        notes=(*record.notes, note) if note else record.notes,
        errors=None if errors is None else errors.at(index, factor),
    )

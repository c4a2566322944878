"""What every reader of spectra hands over, and the checks that all of them share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, UsageError
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

    def at(self, index: npt.NDArray[np.intp]) -> SpectrumErrors:
        """Of some channels."""
        return SpectrumErrors(self.random[index], self.systematic[index], self.correlation[np.ix_(index, index)])

    def times(self, factor: float) -> SpectrumErrors:
        """In another unit."""
        return SpectrumErrors(self.random * factor, self.systematic * factor, self.correlation)


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
class Record:
    """A spectrum as it stands in a file; units are None where the file states none.

    ``doubt`` says why the unit of a reflectance must be stated although the file seems to tell it.
    """

    name: str
    wavelength: Array
    values: Array
    where: str
    standard_deviation: Array | None = None
    n: int | None = None
    wavelength_unit: str | None = None
    reflectance_unit: str | None = None
    quantity: str | None = None
    notes: tuple[str, ...] = ()
    unit: str | None = None
    doubt: str | None = None
    errors: SpectrumErrors | None = None


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


@dataclass(frozen=True)
class Asked:
    """What the caller says of a spectrum: the quantity that is wanted, and units that the file may leave open.

    Attributes
    ----------
    quantity : "reflectance", "radiance", "irradiance" or "other"
    wavelength_unit, reflectance_unit, unit : must agree with the file where it states them
    unit_if_unstated : of a radiance or irradiance, where neither the file nor ``unit`` states one
    """

    quantity: str = "reflectance"
    wavelength_unit: str | None = None
    reflectance_unit: str | None = None
    unit: str | None = None
    unit_if_unstated: str | None = None


def finished(record: Record, asked: Asked) -> FieldSpectrum:
    """Convert units, put wavelengths in order, and refuse what cannot be true."""
    quantity = asked.quantity
    if quantity not in ("reflectance", "radiance", "irradiance", "other"):
        raise UsageError(f"unknown quantity {quantity!r}", expected="reflectance, radiance, irradiance or other")
    if record.quantity is not None and quantity not in ("other", record.quantity):
        mend = None
        if quantity == "reflectance" and record.quantity in ("radiance", "irradiance"):
            mend = "give the reflectance: the spectrum over that of a white panel under the same light"
        raise InputError(f"the file holds {record.quantity}, not {quantity}", where=record.where, mend=mend)
    record = ordered(without_gaps(in_nm(record, asked.wavelength_unit)))
    factor = 1.0
    if quantity in ("radiance", "irradiance"):
        to_internal = radiance_to_internal if quantity == "radiance" else irradiance_to_internal
        unit = _agreed(record.unit, asked.unit, to_internal, quantity, record.where) or asked.unit_if_unstated
        if unit is None:
            raise UsageError(f"the unit of the {quantity} is not stated", where=record.where, mend="state unit:")
        factor = to_internal(unit)
    elif quantity == "reflectance":
        given = asked.reflectance_unit
        if record.doubt is not None and given is None:
            raise UsageError(
                record.doubt, where=record.where, expected="values in the unit that the file states",
                mend="state reflectance_unit: fraction (or percent)",
            )  # fmt: skip
        unit = _agreed(record.reflectance_unit, given, reflectance_factor, quantity, record.where)
        factor = reflectance_factor(unit or "fraction")
        _check_reflectance(record, factor)
    spread = record.standard_deviation
    if spread is not None and np.any(spread < 0):
        raise InputError("standard deviations below 0", where=record.where)
    return FieldSpectrum(
        record.name, record.wavelength, record.values * factor, None if spread is None else spread * factor, record.n,
        record.where, quantity, record.notes if factor == 1.0 else (*record.notes, f"values x {factor:g}"),
        None if record.errors is None else record.errors.times(factor),
    )  # fmt: skip


def _agreed(stated: str | None, given: str | None, factor: Callable[[str], float], what: str, where: str) -> str | None:
    """The unit that a file states or its caller gives; UsageError where they are not the same."""
    if stated is not None and given is not None and factor(stated) != factor(given):
        mend = None if what == "wavelengths" else "leave the caller's out"
        raise UsageError(f"the file states {what} in {stated}, the caller in {given}", where=where, mend=mend)
    return stated or given


def _check_reflectance(record: Record, factor: float) -> None:
    """Refuse marks of missing values, and what is no fraction."""
    marks = np.isin(record.values, FILLS)
    if marks.any():
        raise InputError(
            f"{int(marks.sum())} channels hold {record.values[marks][0]:g}, which marks a missing value and is no "
            "reflectance", where=record.where, mend="delete these channels, or write NaN in their place",
        )  # fmt: skip
    middle = float(np.median(record.values)) * factor
    if middle > PLAUSIBLE_REFLECTANCE:
        name = "scaled:10000" if middle > 150.0 else "percent"
        raise InputError(
            f"half of the reflectances exceed {middle:.4g}: the spectrum looks like {name}",
            where=record.where,
            expected="reflectance as a fraction",
            mend=f"state reflectance_unit: {name}",
        )


def in_nm(record: Record, given: str | None) -> Record:
    """The record with wavelengths in nm; a unit that nobody states is noted where only one is possible.

    Raises
    ------
    UsageError : the unit is not stated and not plain from the numbers, or cannot be true.
    """
    values, where = record.wavelength, record.where
    unit = _agreed(record.wavelength_unit, given, wavelength_to_nm, "wavelengths", where)
    if unit is None and (unit := only_wavelength_unit(values)) is not None:
        record = replace(record, notes=(*record.notes, wavelength_unit_note(values, unit)))
    if unit is None:
        raise UsageError(
            f"the file does not say whether its wavelengths ({values.min():g} to {values.max():g}) are in nm or um",
            where=where,
            expected=f"nm, or um (then they are {values.min() * 1e3:g} to {values.max() * 1e3:g} nm)",
            mend="state wavelength_unit",
        )
    nm = values * wavelength_to_nm(unit)
    low, high = PLAUSIBLE_NM
    if not np.all(np.isfinite(nm)) or nm.min() < low or nm.max() > high:
        raise UsageError(
            f"wavelengths from {values.min():g} to {values.max():g} cannot be in {unit}",
            where=where,
            expected=f"{low:g} to {high:g} nm",
            mend="correct wavelength_unit (nm or um)",
        )
    return replace(record, wavelength=nm, wavelength_unit="nm")


def without_gaps(record: Record) -> Record:
    """The record without channels that hold no value (NaN, or the mark of a deleted channel)."""
    keep = np.isfinite(record.values) & (record.values > DELETED)
    if record.standard_deviation is not None:
        known = np.isfinite(record.standard_deviation) & (record.standard_deviation > DELETED)
        if not known.any():  # a column for it, and no number in it
            record = replace(record, standard_deviation=None)
        else:
            keep &= known
    if keep.all():
        return record
    if keep.sum() < 2:
        raise InputError("fewer than two channels hold a value", where=record.where)
    return _kept(record, np.flatnonzero(keep), f"{int((~keep).sum())} channels without a value left out")


def ordered(record: Record) -> Record:
    """The record in strictly increasing wavelength.

    A file in falling order is turned round.  Where the wavelength jumps back, a new detector begins:
    of the range that both cover, the lower half is taken from the earlier detector, the upper half
    from the later one.
    """
    w = record.wavelength
    if w.size < 2:
        raise InputError(f"a spectrum of {w.size} channels", where=record.where, expected="at least two")
    step = np.diff(w)
    if np.all(step > 0):
        return record
    if np.all(step < 0):
        return _kept(record, np.arange(w.size)[::-1], "wavelengths fall in the file: turned round")
    starts = np.flatnonzero(step <= 0) + 1
    parts, cuts = np.split(np.arange(w.size), starts), list[float]()
    if starts.size > MAX_JOINS:
        raise InputError(
            f"wavelengths jump back {starts.size} times, first to {w[starts[0]]:g} nm",
            where=record.where,
            expected="increasing wavelengths, or up to five detectors one after the other",
        )
    for i in range(starts.size):
        before, after = parts[i : i + 2]
        if not (w[before[0]] < w[after[0]] <= w[before[-1]] < w[after[-1]]):
            what = f"wavelengths jump back from {w[before[-1]]:g} to {w[after[0]]:g} nm, but no detectors overlap"
            raise InputError(what, where=record.where)
        cuts.append(0.5 * (w[before[-1]] + w[after[0]]))
        parts[i], parts[i + 1] = before[w[before] <= cuts[i]], after[w[after] > cuts[i]]
    joined = ", ".join(f"{c:.1f}" for c in cuts)
    return _kept(record, np.concatenate(parts), f"overlapping detectors joined at {joined} nm")


def mean_of(records: list[Record]) -> Record:
    """Mean, standard deviation (n - 1) and number of replicates on one wavelength grid."""
    first = records[0]
    if len(records) < 2 or any(not np.array_equal(r.wavelength, first.wavelength) for r in records):
        raise UsageError("a mean needs two or more spectra on the same wavelengths", where=first.where)
    values = np.stack([r.values for r in records])
    return replace(
        first,
        name="mean",
        values=values.mean(axis=0),
        standard_deviation=values.std(axis=0, ddof=1),
        n=len(records),
        errors=None,
    )


def _kept(record: Record, index: npt.NDArray[np.intp], note: str) -> Record:
    spread = record.standard_deviation
    return replace(
        record,
        wavelength=record.wavelength[index],
        values=record.values[index],
        standard_deviation=None if spread is None else spread[index],
        notes=(*record.notes, note),
        errors=None if record.errors is None else record.errors.at(index),
    )

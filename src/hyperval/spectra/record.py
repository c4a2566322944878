"""What every reader of spectra hands over; the one place that decides quantity, unit and scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from hyperval.data import Array, Index
from hyperval.errors import refuse
from hyperval.spectra.axis import wavelengths_in_nm
from hyperval.storage import decoded, number_of
from hyperval.units import to_internal

Rows = Index | slice

MAX_BYTES = 10_000_000
MAX_ROWS = 100_000
PLAUSIBLE_REFLECTANCE = 1.5  # median above this: not a fraction
DELETED = -1e30  # libraries mark deleted channels by -1.23e34
FILLS = (-999.0, -9999.0, -32768.0, -99999.0)  # what others write for it
MAX_JOINS = 4  # backward jumps of the wavelength: more is not a set of detectors
_TEXT = bytes([9, 10, 11, 12, 13, *range(32, 127), *range(128, 256)])  # printable, of any 8-bit code; tabulators, ends


@dataclass(frozen=True)
class SpectraFile:
    """A file of spectra whose format its content tells.

    Attributes
    ----------
    columns, quantity, wavelengths : what the caller says of it
    formats : that are read, for messages
    """

    path: Path
    columns: tuple[str | int, ...] | None = None
    quantity: str = "reflectance"
    wavelengths: Path | str | None = None
    formats: str = ""

    @cached_property
    def raw(self) -> bytes:
        """The whole file (InputError where it is too large, or empty)."""
        size = self.path.stat().st_size
        refuse(size > MAX_BYTES, "record.large", self.path, size=size, most=MAX_BYTES)
        raw = self.path.read_bytes()
        refuse(not raw.strip(), "record.empty", self.path)
        return raw

    @cached_property
    def head(self) -> bytes:
        """The beginning of the file, without a byte-order mark."""
        return self.raw[:4096].lstrip(b"\xef\xbb\xbf")

    @cached_property
    def text(self) -> str:
        """The file as text (InputError where it is none), without the NUL that ViewSpec pads a comment with."""
        raw, plain = self.raw, self.raw.replace(b"\0", b"")
        filled = plain.translate(None, _TEXT) or len(plain) < 0.5 * len(raw)
        refuse(b"\0" in self.head and filled, "record.binary", self.path, known=self.formats)
        return decoded(raw).replace("\0", "")


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

    def at(self, index: Rows, factor: float = 1.0) -> SpectrumErrors:
        """Of some channels, in another unit; of all of them the spectra of a file go on sharing their matrix."""
        correlation = self.correlation if isinstance(index, slice) else self.correlation[np.ix_(index, index)]
        return SpectrumErrors(self.random[index] * factor, self.systematic[index] * factor, correlation)


@dataclass(frozen=True, eq=False)
class FieldSpectrum:
    """One spectrum with what its file says of it: as it stands there, until :func:`finished` has put it in order.

    Attributes
    ----------
    name : as in the file, or the file's name
    wavelength_nm : (n,) strictly increasing [nm]
    values : (n,) reflectance as a fraction, radiance in uW cm-2 sr-1 nm-1, irradiance in uW cm-2 nm-1, or as in the
        file
    standard_deviation : (n,) of the replicates behind the mean, in the unit of ``values``; None if unknown
    n : number of replicates, None if unknown
    source : the file
    quantity : "reflectance", "radiance", "irradiance" or "other"; empty where the file states none
    notes : what was converted, cut or left out
    errors : by kind, where the file states them; None otherwise
    wavelength_unit, unit : of ``wavelength_nm`` and of the values in the file; None where it states none
    doubt : why the unit of a reflectance must be stated although the file seems to tell it
    """

    name: str
    wavelength_nm: Array
    values: Array
    standard_deviation: Array | None = None
    n: int | None = None
    source: str = ""
    quantity: str = ""
    notes: tuple[str, ...] = ()
    errors: SpectrumErrors | None = None
    wavelength_unit: str | None = None
    unit: str | None = None
    doubt: str | None = None


def reflectance_factor(unit: str) -> float:
    """What multiplies a reflectance in ``unit`` ("fraction", "percent", "scaled:F") to give a fraction.

    A remote-sensing reflectance [sr-1] times pi is that of a surface that is as bright from everywhere.

    >>> [round(reflectance_factor(unit), 5) for unit in ("percent", "scaled:10000", "sr-1")]
    [0.01, 0.0001, 3.14159]
    """
    head, _, tail = unit.partition(":")
    scale = {"fraction": 1.0, "1": 1.0, "percent": 100.0, "%": 100.0, "sr-1": 1.0 / np.pi}.get(unit) or number_of(tail)
    wrong = (tail and head.strip() != "scaled") or not (np.isfinite(scale) and scale > 0)
    refuse(wrong, "spectrum.reflectance_unit", unit=unit)
    return 1.0 / scale


def finished(
    record: FieldSpectrum,
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
    refuse(quantity not in ("reflectance", "radiance", "irradiance", "other"), "spectrum.quantity", quantity=quantity)
    other = record.quantity and quantity not in ("other", record.quantity)
    lit = quantity == "reflectance" and record.quantity in ("radiance", "irradiance")
    refuse(other, "spectrum.lit" if lit else "spectrum.other", where, found=record.quantity, wanted=quantity)
    nm, _, notes = wavelengths_in_nm(record.wavelength_nm, record.wavelength_unit, wavelength_unit, where)
    record, factor = replace(record, wavelength_nm=nm, wavelength_unit="nm", notes=(*record.notes, *notes)), 1.0
    record = _ordered(_without_gaps(record))
    if quantity != "other":
        factor_of: Callable[[str], float] = partial(to_internal, quantity=quantity) if of_light else reflectance_factor
        stated = record.unit if record.unit and ("W " in record.unit) == of_light else None
        by_user, doubt = unit if of_light else reflectance_unit, record.doubt if quantity == "reflectance" else None
        refuse(doubt and by_user is None, "spectrum.doubt", where, doubt=doubt)
        unlike = stated and by_user and factor_of(stated) != factor_of(by_user)
        refuse(unlike, "spectrum.units", where, of=quantity, stated=stated, given=by_user)
        final = stated or by_user or (unit_if_unstated if of_light else "fraction")
        refuse(final is None, "spectrum.unit", where, quantity=quantity)
        factor = factor_of(str(final))
        if not of_light:
            _check_reflectance(record, factor)
    spread = record.standard_deviation
    refuse(spread is not None and np.any(spread < 0), "spectrum.spread", where)
    return replace(_kept(record, slice(None), factor, f"values x {factor:g}" * (factor != 1.0)), quantity=quantity)


def _check_reflectance(record: FieldSpectrum, factor: float) -> None:
    """Refuse marks of missing values, and what is no fraction."""
    marks = np.isin(record.values, FILLS)
    refuse(marks.any(), "spectrum.fill", record.source, count=marks.sum(), mark=record.values[marks][:1])
    middle = float(np.median(record.values)) * factor
    name = "scaled:10000" if middle > 150.0 else "percent"
    facts = {"of": record.name, "middle": middle, "name": name}
    refuse(middle > PLAUSIBLE_REFLECTANCE, "spectrum.percent", record.source, **facts)


def _without_gaps(record: FieldSpectrum) -> FieldSpectrum:
    """The record without channels that hold no value (NaN, or the mark of a deleted channel)."""
    keep = np.isfinite(record.values) & (record.values > DELETED)
    if record.standard_deviation is not None:
        valid = np.isfinite(record.standard_deviation) & (record.standard_deviation > DELETED)
        if valid.any():
            keep &= valid
        else:  # a column for it, and no number in it
            record = replace(record, standard_deviation=None)
    if keep.all():
        return record
    refuse(keep.sum() < 2, "spectrum.empty", record.source)
    return _kept(record, np.flatnonzero(keep), note=f"{int((~keep).sum())} channels without a value left out")


def _ordered(record: FieldSpectrum) -> FieldSpectrum:
    """The record in strictly increasing wavelength.

    A file in falling order is turned round.  Where the wavelength jumps back, a new detector begins:
    of the range that both cover, the lower half is taken from the earlier detector, the upper half
    from the later one.
    """
    w, where = record.wavelength_nm, record.source
    refuse(w.size < 2, "spectrum.short", where, count=w.size)
    step = np.diff(w)
    if np.all(step > 0):
        return record
    if np.all(step < 0):
        return _kept(record, np.arange(w.size)[::-1], note="wavelengths fall in the file: turned round")
    starts = np.flatnonzero(step <= 0) + 1
    parts, cuts = np.split(np.arange(w.size), starts), list[float]()
    refuse(starts.size > MAX_JOINS, "spectrum.jumps", where, count=starts.size, first=w[starts[0]])
    for i in range(starts.size):
        before, after = parts[i : i + 2]
        overlap = w[before[0]] < w[after[0]] <= w[before[-1]] < w[after[-1]]
        refuse(not overlap, "spectrum.overlap", where, last=w[before[-1]], first=w[after[0]])
        cuts.append(0.5 * (w[before[-1]] + w[after[0]]))
        parts[i], parts[i + 1] = before[w[before] <= cuts[i]], after[w[after] > cuts[i]]
    joined = ", ".join(f"{c:.1f}" for c in cuts)
    return _kept(record, np.concatenate(parts), note=f"overlapping detectors joined at {joined} nm")


def mean_of(records: list[FieldSpectrum]) -> FieldSpectrum:
    """Mean, standard deviation (n - 1) and number of replicates on one wavelength grid."""
    first = records[0]
    unlike = len(records) < 2 or any(not np.array_equal(r.wavelength_nm, first.wavelength_nm) for r in records)
    refuse(unlike, "spectrum.mean", first.source)
    values = np.stack([r.values for r in records])
    mean, spread = values.mean(axis=0), values.std(axis=0, ddof=1)
    return replace(first, name="mean", values=mean, standard_deviation=spread, n=len(records), errors=None)


def _kept(record: FieldSpectrum, index: Rows, factor: float = 1.0, note: str = "") -> FieldSpectrum:
    """Some channels of a record, its values multiplied."""
    nm, values, spread = record.wavelength_nm[index], record.values[index] * factor, record.standard_deviation
    spread = None if spread is None else spread[index] * factor
    errors, notes = record.errors and record.errors.at(index, factor), (*record.notes, *[note] * bool(note))
    return replace(record, wavelength_nm=nm, values=values, standard_deviation=spread, errors=errors, notes=notes)

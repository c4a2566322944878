"""The table: every metric by name, and the row that a name means."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from functools import cache

from hyperval.errors import UsageError
from hyperval.metrics import detection, other, sensors, spectral
from hyperval.metrics.metric import Metric


def base_name(metric: str) -> str:
    """A metric's name without the point it is taken at."""
    return metric.partition("@")[0]


@cache
def table() -> Mapping[str, Metric]:
    """Every metric by name; plain names before patterns."""
    rows = [*spectral.METRICS, *detection.METRICS, *other.METRICS, *sensors.METRICS]
    rows.sort(key=lambda m: "*" in m.name)
    if len({m.name for m in rows}) != len(rows):
        raise AssertionError("two metrics of one name")
    return {m.name: m for m in rows}


@cache
def metric_of(name: str) -> Metric:
    """The row of a metric; a name with ``*`` or ``?`` of its own gets the first that it could mean.

    Raises
    ------
    UsageError : the table has no such metric.

    Examples
    --------
    >>> metric_of("pd_difference@1e-2").agreement
    0.0
    """
    base, known = base_name(name), table()
    if name.endswith("_fraction") and name not in known:  # of a pooled gate
        return known["*_fraction"]
    if name.endswith("_change") and base != name:  # of a number at a point
        return known["*_change"]
    if base in known:
        return known[base]
    row = next((m for m in known.values() if m.fits(base)), None)
    if row is None and set(base) & set("*?"):
        row = next((m for m in known.values() if fnmatchcase(m.name, base)), None)
    if row is None:
        near = difflib.get_close_matches(base, known, n=1)
        raise UsageError(
            f"{name!r} is not a metric",
            expected="one of those that hyperval metrics lists",
            mend=f"did you mean {near[0]!r}?" if near else "",
        )
    return row


_OF_SPECTRA = ("compare.difference", "compare.consistency", "compare.spectral", "compare.wavelengths")
_SPECTRA = ("radiance", "snr", "reflectance", "toa_reflectance")
_SPREAD = ("covariance", "classification")
_PARTS = ("windows", "vnir", "swir1", "swir2", "absorption")


def foreign(name: str, product: str) -> str:
    """Why a product of a comparison has no metric of that name, in words; empty where it may have.

    A name with ``*`` or ``?`` may mean several and is not looked at.

    Examples
    --------
    >>> foreign("median_difference_ratio_window", "radiance")
    "no part of the spectrum is 'window'; one of windows, vnir, swir1, swir2, absorption"
    """
    base = base_name(name)
    if set(base) & set("*?"):
        return ""
    row = metric_of(name)
    own: tuple[str, ...]
    if row in spectral.METRICS:
        of_spectra = row.function.startswith(_OF_SPECTRA) and not base.startswith("error")
        own = _SPECTRA if of_spectra else _SPREAD
    elif row in detection.METRICS:
        own = ("abundance",) if base.startswith("area") else ("scores", "roc")
    else:
        return ""
    if product not in own:
        return f"{base!r} is a metric of {' or '.join(own)}, not of {product}"
    part = base.removeprefix(row.name.removesuffix("*")) if row.name.endswith("_ratio_*") else _PARTS[0]
    return "" if part in _PARTS else f"no part of the spectrum is {part!r}; one of {', '.join(_PARTS)}"


def explained(names: Iterable[str]) -> list[tuple[str, str]]:
    """(metric, what it is), each once, by name."""
    return [(base, metric_of(base).words) for base in sorted({base_name(name) for name in names})]

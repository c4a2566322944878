"""The only unit conversions of the project.

Internal units: wavelength nm, radiance uW cm-2 sr-1 nm-1, irradiance uW cm-2 nm-1,
reflectance as a fraction 0-1, angles in degrees at the interfaces.
"""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from hyperval.data import Array
from hyperval.errors import needed, package_table

RADIANCE_UNIT = "uW cm-2 sr-1 nm-1"
IRRADIANCE_UNIT = "uW cm-2 nm-1"

# A wavelength outside this range is a sign of the wrong unit [nm].
PLAUSIBLE_NM = (100.0, 100_000.0)

_SYMBOLS, _NAMED = (package_table("units.yaml")[name] for name in ("symbols", "named"))
_SPELLED = {word: symbol for symbol, (*_, words) in _SYMBOLS.items() for word in (symbol, *words.split())}
_WATTS = {"power": 1, "area": -2, "wavelength": -1}
# Quantity -> powers of the kinds of its unit, the power of ten of the internal unit, and what is expected.
_QUANTITIES = {
    "wavelength": ({"wavelength": 1}, -9, "nm, um, angstrom"),
    "radiance": (_WATTS | {"angle": -1}, 7, f"{RADIANCE_UNIT}, W m-2 sr-1 um-1 and others of W, mW, uW or nW"),
    "irradiance": (_WATTS, 7, f"{IRRADIANCE_UNIT}, W m-2 um-1 and others of W, mW, uW or nW"),
}


def to_internal(unit: str, quantity: str) -> float:
    """Factor that turns a ``unit`` of wavelength, radiance or irradiance into that of the project.

    >>> to_internal("um", "wavelength"), to_internal("W m-2 sr-1 um-1", "radiance")
    (1000.0, 0.1)
    >>> [to_internal(unit, "radiance") for unit in ("uW/cm^2*nm*sr", "W/m2 sr-1 um-1", "SRU", "µflick")]
    [1.0, 0.1, 1.0, 0.001]

    >>> to_internal("(microwatts/cm^2)/(nm*sr)", "radiance"), to_internal("W⋅m-2⋅sr-1⋅um-1", "radiance")
    (1.0, 0.1)
    >>> to_internal("percent", "radiance")
    Traceback (most recent call last):
    hyperval.errors.UsageError: unknown radiance unit 'percent'...scale: 0.01
    >>> to_internal("%", "radiance")
    Traceback (most recent call last):
    hyperval.errors.UsageError: unknown radiance unit '%'...scale: 0.01

    Raises
    ------
    UsageError : an unknown unit.
    """
    units = _QUANTITIES[quantity][2] + "; of a reflectance in percent, scale: 0.01" * (unit in ("%", "percent"))
    return needed(_factor(unit, quantity), "unit.unknown", quantity=quantity, unit=unit, known=units)


def only_wavelength_unit(values: npt.ArrayLike) -> str | None:
    """The unit, nm, um or m, in which all of the wavelengths are plausible; None where none is."""
    numbers = np.asarray(values, dtype=float)
    fits = [unit for unit in ("nm", "um", "m") if numbers.size and plausible(numbers * to_internal(unit, "wavelength"))]
    return fits[0] if len(fits) == 1 else None


def plausible(wavelength_nm: Array) -> bool:
    """Whether all wavelengths are in the range of those that anybody measures."""
    low, high = PLAUSIBLE_NM
    return bool(np.all((wavelength_nm >= low) & (wavelength_nm <= high)))


def radiance_per_wavelength(radiance_per_wavenumber: npt.ArrayLike, wavenumber_cm: npt.ArrayLike) -> Array:
    """Radiance per wavelength [uW cm-2 sr-1 nm-1] from W cm-2 sr-1 / cm-1.

    L_lambda = L_nu nu^2 W m-2 sr-1 um-1 with nu in cm-1 (|d nu / d lambda| = nu^2), before any
    band response is applied.
    """
    nu = np.asarray(wavenumber_cm, dtype=float)
    per_wavelength = np.asarray(radiance_per_wavenumber, dtype=float) * nu**2
    return np.asarray(per_wavelength * to_internal("W m-2 sr-1 um-1", "radiance"))


def in_nm(unit: str | None) -> float | None:
    """Nanometres of one of a unit; None where it is none of wavelengths.

    >>> [in_nm(unit) for unit in ("um", "m", "m2", "W")]
    [1000.0, 1000000000.0, None, None]
    """
    return _factor(unit or "", "wavelength")


def wavelength_unit_named(text: str) -> str | None:
    """The only unit of wavelengths among the words of a text; None without one, or with several.

    >>> texts = "nanometers (nm)", "Wavelength, microns", "Wellenlänge in Nanometern", "micrometri", "nm or um", "cm-1"
    >>> [wavelength_unit_named(text) for text in texts]
    ['nm', 'um', 'nm', 'um', None, None]
    """
    plain = re.sub(r"[\[(]\s*[AÅ\u212b]\s*[\])]", " angstrom ", text).translate(_SIGNS).lower()
    plain = re.sub(r"(nano|micro)(met)[a-z]+", r"\1meter", plain)  # in other languages too
    units = {"nm", "um", "angstrom"} & {_SPELLED.get(word) for word in re.findall(r"[a-zåö]+", plain)}
    return units.pop() if len(units) == 1 else None


def is_radiance(unit: str | None) -> bool:
    """Whether a unit is one of spectral radiance.

    >>> is_radiance("W.m-2.sr-1.um-1")
    True
    """
    return _factor(unit or "", "radiance") is not None


def power_unit(unit: str) -> str | None:
    """A unit of spectral radiance or irradiance as the project writes it, such as W m-2 sr-1 um-1; None for another."""
    symbols = {_SYMBOLS[symbol][0]: f"{symbol}{power if power < 0 else ''}" for symbol, power in _parts(unit)}
    is_known = any(_factor(unit, quantity) is not None for quantity in ("radiance", "irradiance"))
    return " ".join(symbols[k] for k in ("power", "area", "angle", "wavelength") if k in symbols) if is_known else None


def _factor(unit: str, quantity: str) -> float | None:
    powers, power_of_unit, _ = _QUANTITIES[quantity]
    parts = _parts(unit)
    kinds = {_SYMBOLS[symbol][0]: power for symbol, power in parts}
    is_length = quantity == "wavelength" and kinds == {"area": 1}  # m or cm alone
    if not (kinds == powers or is_length) or len(parts) != len(powers):
        return None
    return float(f"1e{sum(_SYMBOLS[symbol][1] * power for symbol, power in parts) - power_of_unit}")


def _parts(unit: str) -> list[tuple[str, int]]:
    """Symbols and powers of a unit, none where not readable.

    W/m^2/sr/um, W/(m2 sr um), W/m2 sr um and W m-2 sr-1 um-1 are one: what has no power of its own is divided by.
    """
    text = _NAMED.get(unit.strip().translate(_SIGNS).lower(), unit.strip())
    text = re.sub(r"\b(?:square|sq\.?)\s*([a-z]+)", r"\g<1>2", text, flags=re.IGNORECASE)
    text = re.sub(r"\sper\s", "/", text, flags=re.IGNORECASE)
    text = re.sub(r"^\(([^()]*)\)\s*/", r"\1/", text.replace("**", "^").translate(_SIGNS).replace("^", ""))
    grouped = re.fullmatch(r"[^()]+/\s*\([^()/]*\)", text) is not None  # W/(m2 sr um): all are divided by
    if not grouped and re.search(r"[()]", text):
        return []
    numerator, *divisors = re.sub(r"[()]", " ", text).split("/")
    words = [(word, 1) for word in numerator.split()]
    for divisor in divisors:
        first, *rest = divisor.split() or [""]
        words += [(first, -1), *((word, -1 if grouped or "-" not in word else 1) for word in rest)]
    found = [(re.fullmatch(r"([A-Za-z]+)([+-]?\d)?", word), sign) for word, sign in words]
    parts = [(_SPELLED.get(m[1]) or _SPELLED.get(m[1].lower()), sign * int(m[2] or 1)) for m, sign in found if m]
    symbols = [(symbol, power) for symbol, power in parts if symbol is not None]
    return symbols if len(symbols) == len(words) else []


# Micro, minus and dot have several characters; raised digits are digits.
_SIGNS = str.maketrans({
    "µ": "u", "μ": "u", "−": "-", "–": "-", "⁻": "-", "·": " ", "⋅": " ", ".": " ", "*": " ", "²": "2", "¹": "1",
})  # fmt: skip

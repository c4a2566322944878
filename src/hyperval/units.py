"""The only unit conversions of the project.

Internal units: wavelength nm, radiance uW cm-2 sr-1 nm-1, irradiance uW cm-2 nm-1,
reflectance as a fraction 0-1, angles in degrees at the interfaces.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

RADIANCE_UNIT = "uW cm-2 sr-1 nm-1"
IRRADIANCE_UNIT = "uW cm-2 nm-1"

# A wavelength outside this range is a sign of the wrong unit [nm].
PLAUSIBLE_NM = (100.0, 100_000.0)

_WAVELENGTH_TO_NM = {
    "nm": 1.0, "nanometer": 1.0, "nanometers": 1.0, "nanometre": 1.0, "nanometres": 1.0,
    "um": 1e3, "µm": 1e3, "μm": 1e3, "micron": 1e3, "microns": 1e3,
    "micrometer": 1e3, "micrometers": 1e3, "micrometre": 1e3, "micrometres": 1e3,
    "angstrom": 0.1, "angstroms": 0.1,
}  # fmt: skip

# What one of the named unit is in uW cm-2 sr-1 nm-1.
_RADIANCE_TO_INTERNAL = {
    "uW cm-2 sr-1 nm-1": 1.0,
    "mW cm-2 sr-1 um-1": 1.0,
    "W m-2 sr-1 um-1": 0.1,
    "W m-2 sr-1 nm-1": 100.0,
    "mW m-2 sr-1 nm-1": 0.1,
    "W cm-2 sr-1 nm-1": 1e6,
    "W cm-2 sr-1 um-1": 1e3,
    "mW cm-2 sr-1 nm-1": 1e3,
    "uW cm-2 sr-1 um-1": 1e-3,
    "nW cm-2 sr-1 nm-1": 1e-3,
}

# What one of the named unit is in uW cm-2 nm-1.
_IRRADIANCE_TO_INTERNAL = {
    "uW cm-2 nm-1": 1.0,
    "W m-2 um-1": 0.1,
    "W m-2 nm-1": 100.0,
    "mW m-2 nm-1": 0.1,
    "mW m-2 um-1": 1e-4,
    "uW cm-2 um-1": 1e-3,
    "mW cm-2 nm-1": 1e3,
    "W cm-2 nm-1": 1e6,
}


def wavelength_to_nm(unit: str) -> float:
    """Factor that turns a wavelength in ``unit`` into nm; raises UsageError for an unknown unit."""
    return _factor(_WAVELENGTH_TO_NM, unit.strip().lower(), "wavelength")


def only_wavelength_unit(values: npt.ArrayLike) -> str | None:
    """The unit, nm or um, in which all of the wavelengths are plausible; None where both are, or neither is."""
    numbers = np.asarray(values, dtype=float)
    low, high = PLAUSIBLE_NM
    each = {unit: numbers * _WAVELENGTH_TO_NM[unit] for unit in ("nm", "um") if numbers.size}
    fits = [unit for unit, nm in each.items() if nm.min() >= low and nm.max() <= high]
    return fits[0] if len(fits) == 1 else None


def wavelength_unit_note(values: npt.ArrayLike, unit: str) -> str:
    """What is noted where a file states no unit of its wavelengths and only one is possible."""
    numbers = np.asarray(values, dtype=float)
    return f"the file states no wavelength unit: {numbers.min():g} to {numbers.max():g} can only be {unit}"


def radiance_to_internal(unit: str) -> float:
    """Factor that turns a spectral radiance in ``unit`` into uW cm-2 sr-1 nm-1."""
    return _factor(_RADIANCE_TO_INTERNAL, unit, "radiance")


def irradiance_to_internal(unit: str) -> float:
    """Factor that turns a spectral irradiance in ``unit`` into uW cm-2 nm-1."""
    return _factor(_IRRADIANCE_TO_INTERNAL, unit, "irradiance")


def radiance_per_wavelength(radiance_per_wavenumber: npt.ArrayLike, wavenumber_cm: npt.ArrayLike) -> Array:
    """Radiance per wavelength [uW cm-2 sr-1 nm-1] from W cm-2 sr-1 / cm-1.

    L_lambda = L_nu nu^2 W m-2 sr-1 um-1 with nu in cm-1 (|d nu / d lambda| = nu^2), before any
    band response is applied.
    """
    nu = np.asarray(wavenumber_cm, dtype=float)
    per_wavelength = np.asarray(radiance_per_wavenumber, dtype=float) * nu**2
    return np.asarray(per_wavelength * _RADIANCE_TO_INTERNAL["W m-2 sr-1 um-1"])


def in_nm(unit: str | None) -> float | None:
    """Nanometres of one of a unit; None where it is none of wavelengths."""
    return _known(_WAVELENGTH_TO_NM, (unit or "").strip().lower())


def is_radiance(unit: str | None) -> bool:
    """Whether a unit is one of spectral radiance."""
    return _known(_RADIANCE_TO_INTERNAL, unit or "") is not None


def _known(table: dict[str, float], unit: str) -> float | None:
    wanted = _parts(unit)
    return table.get(unit) or next((factor for name, factor in table.items() if wanted == _parts(name)), None)


def _factor(table: dict[str, float], unit: str, quantity: str) -> float:
    factor = _known(table, unit)
    if factor is None:
        raise UsageError(f"unknown {quantity} unit {unit!r}", expected="one of " + ", ".join(table))
    return factor


def _parts(unit: str) -> frozenset[tuple[str, int]] | None:
    """Names and powers of a unit: W/m^2/sr/um, W/(m2 sr um) and W m-2 sr-1 um-1 are one; None: not readable."""
    text = re.sub(r"\b(?:square|sq\.?)\s*([a-z]+)", r"\g<1>2", unit.strip(), flags=re.IGNORECASE)
    text = re.sub(r"\sper\s", "/", text, flags=re.IGNORECASE)
    text = text.replace("**", "^").translate(_SIGNS).replace("^", "")
    grouped = re.fullmatch(r"[^()/]+/\s*\([^()/]*\)", text) is not None  # W/(m2 sr um): all are divided by
    if not grouped and re.search(r"[()]", text):
        return None
    numerator, *divisors = re.sub(r"[()]", " ", text).split("/")
    products: list[tuple[str, int]] = [(word, 1) for word in numerator.split()]
    for divisor in divisors:
        first, *rest = divisor.split() or [""]
        products += [(first, -1), *((word, -1 if grouped else 1) for word in rest)]
    read = [_named_power(word, sign) for word, sign in products]
    parts = [item for item in read if item is not None]
    return frozenset(parts) if len(parts) == len(read) == len({name for name, _ in parts}) else None


def _named_power(word: str, sign: int) -> tuple[str, int] | None:
    match = re.fullmatch(r"([A-Za-z]+)([+-]?\d)?", word)
    if match is None:
        return None
    name = next((short for short, names in _SPELLINGS if match[1] in names or match[1].lower() in names), match[1])
    return name, sign * int(match[2] or 1)


def _spelled(*pairs: tuple[str, str]) -> Iterable[tuple[str, frozenset[str]]]:
    return tuple((short, frozenset(names.split())) for short, names in pairs)


# Micro, minus and dot have several characters; raised digits are digits.
_SIGNS = str.maketrans({
    "µ": "u", "μ": "u", "−": "-", "–": "-", "⁻": "-", "·": " ", "*": " ", "²": "2", "¹": "1",
})  # fmt: skip

_SPELLINGS = _spelled(
    ("sr", "sr steradian steradians ster str"),
    ("W", "w watt watts"),
    ("mW", "mW milliw milliwatt milliwatts"),
    ("nW", "nW nanowatt nanowatts"),
    ("uW", "uW uw microw microwatt microwatts"),
    ("nm", "nm nanometer nanometers nanometre nanometres"),
    ("um", "um micron microns micrometer micrometers micrometre micrometres"),
    ("cm", "cm centimeter centimeters centimetre centimetres"),
    ("m", "m meter meters metre metres"),
)

"""Unit factors by another route: dimensional arithmetic from the definitions of the prefixes."""

import math
import re
from itertools import product

import numpy as np
import pytest

from hyperval import units
from hyperval.errors import UsageError

PREFIX = {"": 1.0, "m": 1e-3, "u": 1e-6, "c": 1e-2, "n": 1e-9}


def in_si(unit: str) -> float:
    """A unit such as "uW cm-2 sr-1 nm-1" in W, m and sr, from its parts."""
    powers = re.findall(r"([a-z]?)[Wm](-?\d)?(?: |$)", unit)
    return math.prod(PREFIX[prefix] ** int(power or 1) for prefix, power in powers)


POWERS = [f"{w}W {a}-2{sr} {nm}-1" for w, a, sr, nm in product(["", *"mun"], ["m", "cm"], [" sr-1", ""], ["nm", "um"])]


@pytest.mark.parametrize("unit", POWERS)
def test_factors_follow_from_the_prefixes(unit):
    of_radiance = ("radiance", units.RADIANCE_UNIT)
    quantity, own = of_radiance if "sr" in unit else ("irradiance", units.IRRADIANCE_UNIT)
    assert units.to_internal(unit, quantity) == pytest.approx(in_si(unit) / in_si(own), rel=1e-12)


def test_wavelength_factor():
    spelled = {1: ["nm", "Nanometers"], 1000: ["um", "µm", "μm", " Micrometers ", "micron"], 0.1: ["Angstroms"]}
    for factor, names in spelled.items():
        assert {units.to_internal(name, "wavelength") for name in names} == {factor}


@pytest.mark.parametrize("quantity", ["wavelength", "radiance", "irradiance"])
@pytest.mark.parametrize("unit", ["", "furlong", "Unknown", "W"])
def test_unknown_unit_lists_what_is_known(quantity, unit):
    with pytest.raises(UsageError, match="expected: one of") as caught:
        units.to_internal(unit, quantity)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    "unit",
    [
        "W/m^2/sr/um", "W/m2/um/sr", "W/(m2 sr um)", "W/(m^2*sr*µm)", "W m^-2 sr^-1 um^-1", "W·m⁻²·sr⁻¹·μm⁻¹",
        "W m**-2 SR**-1 micron**-1", "W m−2 um-1 sr-1", "watts/meter2/sr/micrometer", "W/sqm/str/um",
        "Watts/(square m * sr * micron)", "watts per square meter per micrometer per steradian",
        "W/sq. m/sr/um", "W/m2 sr um", "W/m^2*um*sr",
    ],
)  # fmt: skip
def test_a_unit_may_be_spelled_in_many_ways(unit):
    assert units.to_internal(unit, "radiance") == units.to_internal("W m-2 sr-1 um-1", "radiance")
    assert units.to_internal("µW/cm²/nm", "irradiance") == 1.0
    assert units.to_internal("microW/cm^2/nm/sr", "radiance") == 1.0


@pytest.mark.parametrize(
    "unit",
    ["W/m2", "W/m2/sr/um/um", "MW/m2/sr/nm", "mw/m2/sr/nm", "W/(m2 sr) um", "W m2 sr um", "/", "()",
     "W m-3 sr-1", "W m-2 sr-1 cm-1", "W nm-2 sr-1 nm-1"],
)  # fmt: skip
def test_a_unit_that_reads_in_two_ways_or_none_is_refused(unit):
    with pytest.raises(UsageError, match="unknown radiance unit"):
        units.to_internal(unit, "radiance")


def test_radiance_per_wavelength_conserves_the_integral():
    # The radiance between two wavenumbers is the same on either axis: 1 W cm-2 sr-1 / cm-1 over
    # 10000-10001 cm-1 is 1 W cm-2 sr-1 = 1e6 uW cm-2 sr-1 over that interval in nm.
    nu = np.linspace(10000.0, 10001.0, 2001)
    wavelength_nm = 1e7 / nu
    per_nm = units.radiance_per_wavelength(np.ones_like(nu), nu)
    assert -np.trapezoid(per_nm, wavelength_nm) == pytest.approx(1e6, rel=1e-6)

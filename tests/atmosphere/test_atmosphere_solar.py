"""Solar spectra."""

import gzip
import importlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from pvlib import solarposition, spectrum

from hyperval.atmosphere import AtmosphericTerms, earth_sun_distance_au, solar, solar_position
from hyperval.errors import InputError, MissingDataError, UsageError
from hyperval.spectra import SpectralAxis

GRID = np.arange(340.0, 2600.1, 2.5)


def test_spectrum_on_the_grid_carries_the_energy_of_its_source():
    nm, e = solar.source_samples("astm-g173")
    fine = np.arange(400.0, 2400.0, 0.05)
    ours = np.interp(fine, GRID, solar.extraterrestrial_irradiance("astm-g173", GRID))
    assert np.trapezoid(ours, fine) == pytest.approx(np.trapezoid(np.interp(fine, nm, e), fine), rel=2e-4)
    # ASTM G173 states 1347.9 W m-2 between 280 and 4000 nm (1 uW cm-2 is 0.01 W m-2).
    assert 0.01 * np.trapezoid(e, nm) == pytest.approx(1347.9, rel=2e-3)
    table = spectrum.get_reference_spectra(standard="ASTM G173-03")["extraterrestrial"]
    np.testing.assert_array_equal(e, table.to_numpy() * 100.0)


@pytest.mark.parametrize(("fwhm_nm", "lines"), [(3.5, 0.02), (5.5, 0.01), (10.0, 0.003)])
def test_bands_see_the_lines_where_the_source_has_them(fwhm_nm, lines):
    # Against plain sums over the source by 0.1 nm; the engine's grid of 2.5 nm alone is up to 4 % off below 460 nm.
    centre = np.arange(400.0, 1000.0, 4.0)
    axis = SpectralAxis(centre, np.full(centre.size, fwhm_nm))
    level, rising, one = solar.extraterrestrial_irradiance("astm-g173", GRID), GRID / 1000.0, np.ones(GRID.size)
    terms = AtmosphericTerms(
        GRID, 0.1 * level, level * rising, level, 0.2 * one, level, rising,
        diffuser_radiance=level, solar_lines=solar.lines_between("astm-g173", GRID),
    )  # fmt: skip
    fine = np.arange(380.0, 1020.0, 0.1)
    x = (fine - centre[:, None]) / (fwhm_nm / 2.3548)
    weight = np.where(np.abs(x) <= 3.0, np.exp(-0.5 * x**2), 0.0)
    sun = weight * np.interp(fine, *solar.source_samples("astm-g173"))
    seen, plain = terms.at_bands(axis), replace(terms, solar_lines=None).at_bands(axis)
    assert seen.diffuser_radiance == pytest.approx(sun.sum(axis=1) / weight.sum(axis=1), rel=3e-3)
    assert seen.direct == pytest.approx((sun * fine / 1000.0).sum(axis=1) / weight.sum(axis=1), rel=3e-3)
    assert seen.path_radiance == pytest.approx(0.1 * seen.diffuser_radiance, rel=1e-12)
    assert seen.solar_lines is None
    for name in ("spherical_albedo", "gas_transmittance"):
        assert np.array_equal(getattr(plain, name), getattr(seen, name))
    assert np.max(np.abs(plain.direct / seen.direct - 1.0)) > lines


def test_shipped_spectrum_has_the_published_energy():
    nm, e = solar.source_samples("tsis-1")
    wide_nm, wide = solar.source_samples("astm-g173")
    assert (nm[0], nm[-1], nm.size) == (350.0, 2500.0, 2151)
    # More than 97 % of 1361 W m-2 lie at 202-2730 nm (Coddington et al. 2021, 2023); 280-350 and 2500-2730 nm
    # from ASTM G173, and 7 W m-2 at 202-280 nm (Gueymard 2004).
    beside = [(wide_nm >= low) & (wide_nm <= high) for low, high in ((280, 350), (2500, 2730))]
    energy = 7.0 + 0.01 * (np.trapezoid(e, nm) + sum(np.trapezoid(wide[at], wide_nm[at]) for at in beside))
    assert 0.97 < energy / 1361.0 < 0.98
    # What ASTM G173 has less below 500 nm and more beyond 1 um: found elsewhere by other means.
    for low, high, expected in ((400, 500, -0.022), (1000, 1750, 0.020)):
        there = np.arange(low, high, 10.0)
        other, shipped = (solar.extraterrestrial_irradiance(name, there) for name in ("astm-g173", "tsis-1"))
        assert np.median(other / shipped) - 1.0 == pytest.approx(expected, abs=0.004)


@pytest.mark.data
def test_shipped_numbers_are_made_from_the_source_and_bands_see_it_through_them(data_dir, monkeypatch):
    source = data_dir("sensors/tsis_f0_0p5.txt")
    monkeypatch.setenv("HYPERVAL_DATA", str(source.parent.parent))
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "validation/atmosphere"))
    script = importlib.import_module("solar_table")
    nm, made = script.made()
    shipped_nm, shipped = solar.source_samples("tsis-1")
    assert np.array_equal(nm, shipped_nm)
    assert shipped * 10.0 == pytest.approx(made, rel=2e-6)
    source_nm, source_e = np.loadtxt(source, unpack=True)
    centre = np.arange(370.0, 2485.0, 1.7)
    for fwhm_nm, worst in ((3.5, 0.002), (5.0, 0.001), (10.0, 0.0003)):
        ours = script.in_bands(lambda x: 10.0 * np.interp(x, shipped_nm, shipped), centre, fwhm_nm)
        theirs = script.in_bands(lambda x: np.interp(x, source_nm, source_e), centre, fwhm_nm)
        assert np.abs(ours / theirs - 1.0).max() <= worst
    tsis = solar.extraterrestrial_irradiance("tsis-1", grid := np.arange(400.0, 2400.0, 20.0))
    for name in ("kurucz", "astm-g173"):  # files agree in unit and size
        ratio = solar.extraterrestrial_irradiance(name, grid) / tsis
        assert np.median(ratio) == pytest.approx(1.0, abs=0.015)
        assert np.all(np.abs(ratio - 1.0) < 0.08)


def test_sun_is_that_of_the_package_that_is_not_imported_for_it():
    import pandas as pd

    for days in range(0, 9000, 1234):
        when = datetime(1999, 3, 4, 5, 6, 7, tzinfo=UTC) + timedelta(days=days, hours=days % 17)
        index = pd.DatetimeIndex([pd.Timestamp(when)])
        frame = solarposition.get_solarposition(index, 43.0, -77.6, method="nrel_numpy")
        assert solar_position(43.0, -77.6, when) == (frame["zenith"].iloc[0], frame["azimuth"].iloc[0])
        assert earth_sun_distance_au(when) == solarposition.nrel_earthsun_distance(index).iloc[0]


def test_what_is_not_at_hand_not_covered_or_damaged_is_said(monkeypatch, tmp_path):
    monkeypatch.delenv("HYPERVAL_DATA", raising=False)
    for name, grid, kind, said in (
        ("kurucz", GRID, MissingDataError, r"kurudz_0\.1nm[\s\S]*HYPERVAL_DATA[\s\S]*tsis-1"),
        ("sunny", GRID, UsageError, "unknown solar spectrum"),
        ("tsis-1", np.array([2720.0, 2730.0]), UsageError, "tsis-1 covers 350-2500 nm"),
    ):
        with pytest.raises(kind, match=said):
            solar.extraterrestrial_irradiance(name, grid)
    (tmp_path / "sensors").mkdir()
    with gzip.open(tmp_path / "sensors/kurudz_0.1nm.dat.gz", "wt") as stream:
        stream.write("# head\n250.0 70\n250.1 seventy\n")
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path))
    with pytest.raises(InputError, match=r"gz:3: not a row"):
        solar.extraterrestrial_irradiance("kurucz", GRID)

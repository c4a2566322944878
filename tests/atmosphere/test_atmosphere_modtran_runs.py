"""Terms of 3.7 from MODTRAN runs over ground of several albedos."""

from __future__ import annotations

import numpy as np
import pytest
from modtran_samples import spectrum, tape7

from hyperval.atmosphere import (
    AtmosphericTerms,
    read_channels,
    read_chn,
    read_modtran_runs,
    read_tape7,
    solve_coefficients,
    terms_from_runs,
)
from hyperval.errors import InputError, UsageError
from hyperval.spectra import SpectralAxis
from hyperval.units import radiance_per_wavelength


def over_uniform_ground(terms, rho):
    return terms.path_radiance + (terms.direct + terms.adjacency) * rho / (1 - terms.spherical_albedo * rho)


def test_coefficients_are_solved_exactly_from_the_closed_form():
    a, b, s, l0 = np.array([40.0, 25.0]), np.array([6.0, 0.4]), np.array([0.21, 0.003]), np.array([2.0, 0.1])
    rho = np.array([[0.5], [0.0], [0.1], [1.0]])
    ground, path = a * rho / (1 - s * rho), l0 + b * rho / (1 - s * rho)
    found = solve_coefficients(rho[:, 0], ground, path)
    np.testing.assert_allclose(found.direct, a, rtol=1e-13)
    np.testing.assert_allclose(found.adjacency, b, rtol=1e-12)
    np.testing.assert_allclose(found.spherical_albedo, s, rtol=1e-11)


def test_where_nothing_is_reflected_the_spherical_albedo_is_that_of_the_neighbours():
    a, s = np.array([40.0, 0.0, 30.0]), np.array([0.2, 0.15, 0.1])
    rho = np.array([[0.0], [0.1], [0.5]])
    ground = a * rho / (1 - s * rho)
    found = solve_coefficients([0.0, 0.1, 0.5], ground, np.zeros((3, 3)))
    np.testing.assert_allclose(found.spherical_albedo, [0.2, 0.15, 0.1])
    assert found.direct[1] == 0.0
    given = solve_coefficients([0.0, 0.1, 0.5], ground, np.zeros((3, 3)), np.array([0.0, 0.12, 0.0]))
    np.testing.assert_allclose(given.spherical_albedo, [0.2, 0.12, 0.1])


@pytest.mark.parametrize(
    "wrong", [[0.0, 0.5], [0.1, 0.5, 1.0], [0.0, 0.5, 0.5], [0.0, 0.0, 0.5], [0.0, 0.5, 1.2], [0.0, -0.1, 0.5, 1.0]]
)
def test_albedos_that_do_not_determine_the_terms_are_refused(wrong):
    with pytest.raises(UsageError, match="albedos"):
        solve_coefficients(wrong, np.ones((len(wrong), 2)), np.ones((len(wrong), 2)))


def test_tape7_runs_give_terms_per_wavelength(tmp_path):
    (tmp_path / "tape7").write_text(tape7((0.0, 0.1, 0.5, 1.0)))
    terms = read_modtran_runs([tmp_path / "tape7"])
    t = spectrum()
    assert np.all(np.diff(terms.wavelength_nm) > 0)
    np.testing.assert_allclose(terms.wavelength_nm, 1e7 / t["nu"][::-1], rtol=2e-6)  # 0.01 cm-1 is printed
    # Five digits are printed; A, B and S inherit them.
    for name, key in (("path_radiance", "path"), ("direct", "direct"), ("adjacency", "adjacency")):
        wanted = radiance_per_wavelength(t[key], t["nu"])[::-1]
        np.testing.assert_allclose(getattr(terms, name), wanted, rtol=2e-4)
    np.testing.assert_allclose(terms.spherical_albedo, t["albedo"][::-1], atol=2e-4)
    np.testing.assert_allclose(terms.ground_irradiance, np.pi * terms.direct / 0.9, rtol=1e-12)
    np.testing.assert_allclose(terms.diffuse_fraction, 0.2, rtol=1e-3)


def test_radiance_per_wavenumber_becomes_radiance_per_wavelength(tmp_path):
    # The same energy in either unit: the integral over the spectrum does not change (W cm-2 sr-1 against uW).
    t = spectrum(4000)
    (tmp_path / "tape7").write_text(tape7((0.0, 0.1, 0.5), terms=t))
    terms = read_modtran_runs([tmp_path / "tape7"])
    per_wavenumber = np.trapezoid(t["direct"], t["nu"]) * 1e6
    assert np.trapezoid(terms.direct, terms.wavelength_nm) == pytest.approx(per_wavenumber, rel=1e-4)


def test_emission_of_the_black_run_belongs_to_the_path(tmp_path):
    (tmp_path / "tape7").write_text(tape7((0.0, 0.1, 0.5), emission=True))
    (tmp_path / "cold").write_text(tape7((0.0, 0.1, 0.5)))
    warm = read_modtran_runs([tmp_path / "tape7"])
    cold = read_modtran_runs([tmp_path / "cold"])
    t = spectrum()
    emitted = radiance_per_wavelength(t["emission"], t["nu"])[::-1]
    np.testing.assert_allclose(warm.path_radiance - cold.path_radiance, emitted, rtol=1e-4)
    np.testing.assert_allclose(warm.direct, cold.direct, rtol=1e-12)


def test_runs_that_do_not_belong_together_are_refused(tmp_path):
    (tmp_path / "tape7").write_text(tape7((0.0, 0.1, 0.5)))
    (tmp_path / "other").write_text(tape7((1.0,), terms=spectrum(61)))
    cases, other = read_tape7(tmp_path / "tape7"), read_tape7(tmp_path / "other")
    with pytest.raises(InputError, match="other wavelengths"):
        terms_from_runs([*cases, *other])
    with pytest.raises(UsageError, match="4 albedos for 3 runs"):
        terms_from_runs(cases, [0.0, 0.1, 0.5, 1.0])
    with pytest.raises(UsageError, match="no MODTRAN output"):
        read_modtran_runs([])


AIRBORNE = [
    f"modtran/modtran6_airborne_lut/AOT550-{aot}_H2OSTR-{water}.chn.gz"
    for aot in ("0.0500", "0.2000")
    for water in ("0.7500", "1.2500", "2.2500")
]


@pytest.mark.data
@pytest.mark.parametrize("relative", [*AIRBORNE, "pasadena/lut_multi/AOT550-0.1000_H2OSTR-1.5000.chn"])
def test_real_runs_are_reproduced_and_agree_with_the_printed_coefficients(data_dir, relative):
    path = data_dir(relative)
    blocks = read_channels(path)
    terms, printed = terms_from_runs(blocks), read_chn(path)
    assert terms.provenance["albedos"] == [0.0, 0.1, 0.5]
    for block, rho in zip(blocks, (0.0, 0.1, 0.5), strict=True):
        # What the ground emits goes down as it gets brighter, which 3.7 does not know: compare without it.
        reflected = block.radiance - block.thermal + blocks[0].thermal
        lit = reflected > 1e-4 * reflected.max()
        np.testing.assert_allclose(over_uniform_ground(terms, rho)[lit], reflected[lit], rtol=1e-4)
    bright = terms.direct > 0.02 * terms.direct.max()
    # The printed coefficients fall short of the radiances by these amounts (see read_chn).
    np.testing.assert_allclose(terms.direct[bright], printed.direct[bright], rtol=0.01)
    hazy = terms.adjacency > 0.02 * terms.adjacency.max()
    np.testing.assert_allclose(terms.adjacency[hazy], printed.adjacency[hazy], rtol=0.1)
    np.testing.assert_allclose(terms.spherical_albedo, printed.spherical_albedo, atol=6e-4)
    assert np.all((terms.diffuse_fraction[bright] >= 0.0) & (terms.diffuse_fraction[bright] < 0.5))


@pytest.mark.data
def test_channels_are_not_averaged_twice(data_dir):
    blocks = read_channels(data_dir(AIRBORNE[0]))
    terms = terms_from_runs(blocks)
    axis = SpectralAxis(terms.wavelength_nm, terms.fwhm_nm)
    np.testing.assert_allclose(terms.at_bands(axis).direct, terms.direct, rtol=1e-12)
    with pytest.raises(UsageError, match="channels that do not suit the band"):
        terms.at_bands(SpectralAxis(terms.wavelength_nm[10:20], np.full(10, 2.0)))


def flat(wavelength_nm, values, fwhm_nm=None):
    return AtmosphericTerms(wavelength_nm, *([values] * 6), fwhm_nm=fwhm_nm)


def test_narrow_channels_serve_as_samples():
    nm = np.arange(400.0, 600.0, 1.0)
    values = np.cos(nm / 15.0)
    axis = SpectralAxis(np.array([500.0]), np.array([10.0]))
    samples = flat(nm, values).at_bands(axis)
    channels = flat(nm, values, np.full(nm.size, 1.0)).at_bands(axis)
    np.testing.assert_array_equal(samples.direct, channels.direct)
    assert abs(channels.direct[0] - np.cos(500.0 / 15.0)) > 0.01  # averaged, not picked

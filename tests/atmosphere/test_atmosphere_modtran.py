"""What MODTRAN wrote, tape7 and channel files: read or refused, the terms of 3.7 from it, and 6S beside it."""

import gzip
import importlib.util
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from modtran_samples import RADIANCE_WIDTHS, ROWS, channels, spectrum, tape7
from stored_cases import CASES

from hyperval import atmosphere as air
from hyperval.atmosphere import AtmosphericTerms, modtran
from hyperval.errors import InputError, UsageError
from hyperval.spectra import SpectralAxis
from hyperval.units import radiance_per_wavelength


def write(tmp_path, text, name="tape7"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_tape7_of_several_cases_with_blank_fields_packed_or_not(tmp_path):
    first, second = air.read_tape7(write(tmp_path, tape7((0.0, 0.5))))
    assert (first.albedo, second.albedo, first.columns["FREQ"][0]) == (0.0, 0.5, 4000.0)
    assert np.all(np.isnan(first.columns["REF_SOL"]))  # blank in the file, not shifted from a neighbour
    assert np.all(first.columns["DEPTH"] == 0.105)
    with gzip.open(tmp_path / "tape7.gz", "wb") as stream:
        stream.write(tape7((0.0, 0.5)).replace("\n", "\r\n").encode())
    np.testing.assert_equal(air.read_tape7(tmp_path / "tape7.gz")[0].columns, first.columns)
    # Without the card the albedo is what the emissivity leaves.
    assert air.read_tape7(write(tmp_path, tape7((0.3,), albedo_stated=False)))[0].albedo == 0.3


def test_channels_are_read_as_they_were_written_whatever_the_ground_and_packed(tmp_path):
    black = air.read_chn(write(tmp_path, channels()))
    _, path, f, a, b, s = np.array(ROWS).T
    wanted = {"path_radiance": path, "direct": f * a, "adjacency": f * b, "ground_irradiance": np.pi * f * a / 0.9}
    for name, values in (wanted | {"spherical_albedo": s}).items():
        np.testing.assert_allclose(getattr(black, name), values, rtol=2e-6)
    bright = air.read_chn(write(tmp_path, channels(rho=0.4), "bright.chn"))
    np.testing.assert_allclose(bright.path_radiance, black.path_radiance, rtol=1e-4)
    with gzip.open(tmp_path / "runs.chn.gz", "wt") as stream:
        stream.write("".join(channels(rho=rho) for rho in (0.5, 0.0, 0.1)))
    assert [round(b.albedo, 4) for b in air.read_channels(tmp_path / "runs.chn.gz")] == [0.5, 0.0, 0.1]
    assert np.array_equal(air.read_chn(tmp_path / "runs.chn.gz").path_radiance, black.path_radiance)
    np.testing.assert_allclose(air.read_modtran_runs([tmp_path / "runs.chn.gz"]).adjacency, f * b, rtol=1e-4)


def harmed(text, place):
    """The text with other columns of a line, or with one text in place of another."""
    if len(place) == 2:
        return text.replace(*place, 1)
    number, start, end, written = place
    lines = text.split("\n")
    lines[number - 1] = lines[number - 1][:start] + written.rjust(end - start) + lines[number - 1][end:]
    return "\n".join(lines)


@pytest.mark.parametrize(("place", "said"), [*CASES["harmed_tape7"], *CASES["harmed_channels"]])
def test_malformed_file_is_refused_with_its_line(tmp_path, place, said):
    read, text = air.read_chn, channels()
    if [place, said] in CASES["harmed_tape7"]:
        read, text = air.read_tape7, tape7((0.0,))
    assert harmed(text, place) != text
    with pytest.raises(InputError, match=said):
        read(write(tmp_path, harmed(text, place)))


def test_files_without_rows_or_cut_short_are_refused(tmp_path):
    for read, text, said in (
        (air.read_tape7, tape7(()) + "\n".join(tape7((0.0,)).split("\n")[:3]) + "\n -9999.\n", "a table without rows"),
        (air.read_tape7, "nothing\n" * 5, "no table"),
        (air.read_chn, channels().rsplit("  CENTER", 1)[0][:-1], r"tape7:6: a line of \d+ characters"),
        (air.read_chn, channels() + channels(ROWS[:2]), r"a table of 2 channels\n  expected: 3, as in"),
    ):
        with pytest.raises(InputError, match=said):
            read(write(tmp_path, text))


@pytest.mark.parametrize("part", ["PTH_THRML", "SURF_EMIS", "SOL_SCAT", "GRND_RFLT"])
def test_total_that_is_not_the_sum_of_its_parts_is_refused(tmp_path, part):
    text = tape7((0.5,), emission=True)
    assert air.read_tape7(write(tmp_path, text))
    start, line = sum(RADIANCE_WIDTHS[: air.RADIANCE_COLUMNS.index(part)]), text.split("\n")[6]
    added = float(line[start : start + 11]) + 5e-4 * float(line[96:107])  # above 9e-5 of the total
    with pytest.raises(InputError, match=r"tape7:7: TOTAL_RAD .* is not the sum"):
        air.read_tape7(write(tmp_path, harmed(text, [7, start, start + 11, f"{added:11.4E}"])))


def test_a_file_that_is_absent_broken_or_too_large_is_refused_before_it_is_read_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(modtran, "MAX_BYTES", 1 << 20)
    with gzip.open(tmp_path / "bomb.gz", "wb") as stream:
        stream.write(b" " * (2 << 20))  # packs to far less than the limit
    (tmp_path / "broken.gz").write_bytes(b"\x1f\x8b\x08rubbish")
    write(tmp_path, tape7((0.0,)) + " " * (1 << 20), "large")
    said = {"large": "larger than 1 MiB", "bomb.gz": "larger than 1 MiB", "broken.gz": "cannot read", "no": "no such"}
    for name, message in said.items():
        with pytest.raises(InputError, match=message):
            air.read_tape7(tmp_path / name)


@pytest.mark.data
@pytest.mark.parametrize(("relative", "rows", "albedo", "first", "column", "value"), CASES["real_tape7"])
def test_real_files(data_dir, relative, rows, albedo, first, column, value):
    (case,) = air.read_tape7(data_dir(f"modtran/{relative}"))
    assert (case.wavelength_nm.size, case.columns["FREQ"][0], case.wavelength_nm[-1]) == (rows, first, 1e7 / first)
    np.testing.assert_equal(case.albedo, albedo)
    assert case.columns[column][0] == pytest.approx(value, rel=1e-12)
    scattered, once = (np.nan_to_num(case.columns[name]) for name in ("SOL_SCAT", "SING_SCAT"))
    assert np.all(scattered >= once)  # it holds the single scattering


@pytest.mark.data
@pytest.mark.parametrize("name", ["tape7-01", "tape7-04", "tape7VISNIR5kmTrop23Vis.gz"])
def test_real_files_of_other_modes_are_refused(data_dir, name):
    with pytest.raises(InputError, match="radiance mode"):
        air.read_tape7(data_dir(f"modtran/modtran4_5/{name}"))


def test_coefficients_are_solved_exactly_from_the_closed_form_or_taken_from_the_neighbours():
    a, b, s, l0 = np.array([40.0, 25.0]), np.array([6.0, 0.4]), np.array([0.21, 0.003]), np.array([2.0, 0.1])
    rho = np.array([[0.5], [0.0], [0.1], [1.0]])
    found = air.solve_coefficients(rho[:, 0], a * rho / (1 - s * rho), l0 + b * rho / (1 - s * rho))
    for values, exact in zip(found, (a, b, s), strict=True):
        np.testing.assert_allclose(values, exact, rtol=1e-11)
    # Where nothing is reflected.
    a, s, rho = np.array([40.0, 0.0, 30.0]), np.array([0.2, 0.15, 0.1]), rho[[1, 2, 0]]
    ground, path = a * rho / (1 - s * rho), np.zeros((3, 3))
    found = air.solve_coefficients(rho[:, 0], ground, path)
    np.testing.assert_allclose(found.spherical_albedo, [0.2, 0.15, 0.1])
    assert found.direct[1] == 0.0
    given = air.solve_coefficients(rho[:, 0], ground, path, np.array([0.0, 0.12, 0.0]))
    np.testing.assert_allclose(given.spherical_albedo, [0.2, 0.12, 0.1])


def test_tape7_runs_give_terms_per_wavelength_and_emission_belongs_to_the_path(tmp_path):
    terms, t = air.read_modtran_runs([write(tmp_path, tape7((0.0, 0.1, 0.5, 1.0)))]), spectrum()
    np.testing.assert_allclose(terms.wavelength_nm, 1e7 / t["nu"][::-1], rtol=2e-6)  # 0.01 cm-1 is printed
    # Five digits are printed; A, B and S inherit them.
    for name, key in (("path_radiance", "path"), ("direct", "direct"), ("adjacency", "adjacency")):
        wanted = radiance_per_wavelength(t[key], t["nu"])[::-1]
        np.testing.assert_allclose(getattr(terms, name), wanted, rtol=2e-4)
    np.testing.assert_allclose(terms.spherical_albedo, t["albedo"][::-1], atol=2e-4)
    np.testing.assert_allclose(terms.ground_irradiance, np.pi * terms.direct / 0.9, rtol=1e-12)
    np.testing.assert_allclose(terms.diffuse_fraction, 0.2, rtol=1e-3)
    # The same energy in either unit: the integral over the spectrum does not change (W cm-2 sr-1 against uW).
    fine = spectrum(2000)
    found = air.read_modtran_runs([write(tmp_path, tape7((0.0, 0.1, 0.5), terms=fine))])
    per_wavenumber = np.trapezoid(fine["direct"], fine["nu"]) * 1e6
    assert np.trapezoid(found.direct, found.wavelength_nm) == pytest.approx(per_wavenumber, rel=1e-4)
    warm = air.read_modtran_runs([write(tmp_path, tape7((0.0, 0.1, 0.5, 1.0), emission=True))])
    emitted = radiance_per_wavelength(t["emission"], t["nu"])[::-1]
    np.testing.assert_allclose(warm.path_radiance - terms.path_radiance, emitted, rtol=1e-4)
    np.testing.assert_allclose(warm.direct, terms.direct, rtol=1e-12)


def test_runs_that_do_not_belong_together_are_refused(tmp_path):
    cases = air.read_tape7(write(tmp_path, tape7((0.0, 0.1, 0.5))))
    other = air.read_tape7(write(tmp_path, tape7((1.0,), terms=spectrum(61))))
    with pytest.raises(InputError, match="other wavelengths"):
        air.terms_from_runs([*cases, *other])
    with pytest.raises(UsageError, match="4 albedos for 3 runs"):
        air.terms_from_runs(cases, [0.0, 0.1, 0.5, 1.0])
    with pytest.raises(UsageError, match="no MODTRAN output"):
        air.read_modtran_runs([])
    for wrong in ([0, 0.5], [0.1, 0.5, 1], [0, 0.5, 0.5], [0, 0, 0.5], [0, 0.5, 1.2], [0, -0.1, 0.5, 1]):
        with pytest.raises(UsageError, match="albedos"):
            air.solve_coefficients(wrong, np.ones((len(wrong), 2)), np.ones((len(wrong), 2)))


AIRBORNE = [
    f"modtran/modtran6_airborne_lut/AOT550-{aot}_H2OSTR-{water}.chn.gz"
    for aot in ("0.0500", "0.2000")
    for water in ("0.7500", "2.2500")
]


@pytest.mark.data
@pytest.mark.parametrize("relative", [*AIRBORNE, "pasadena/lut_multi/AOT550-0.1000_H2OSTR-1.5000.chn"])
def test_real_runs_are_reproduced_and_agree_with_the_printed_coefficients(data_dir, relative):
    path = data_dir(relative)
    blocks = air.read_channels(path)
    terms, printed = air.terms_from_runs(blocks), air.read_chn(path)
    assert terms.provenance["albedos"] == [0.0, 0.1, 0.5]
    for block, rho in zip(blocks, (0.0, 0.1, 0.5), strict=True):
        # What the ground emits goes down as it gets brighter, which 3.7 does not know: compare without it.
        reflected = block.radiance - block.thermal + blocks[0].thermal
        ours = terms.path_radiance + (terms.direct + terms.adjacency) * rho / (1 - terms.spherical_albedo * rho)
        lit = reflected > 1e-4 * reflected.max()
        np.testing.assert_allclose(ours[lit], reflected[lit], rtol=1e-4)
    # The printed coefficients fall short of the radiances by these amounts (see air.read_chn).
    for name, off in (("direct", 0.01), ("adjacency", 0.1)):
        found = getattr(terms, name)
        bright = found > 0.02 * found.max()
        np.testing.assert_allclose(found[bright], getattr(printed, name)[bright], rtol=off)
    np.testing.assert_allclose(terms.spherical_albedo, printed.spherical_albedo, atol=6e-4)
    bright = terms.direct > 0.02 * terms.direct.max()
    assert np.all((terms.diffuse_fraction[bright] >= 0.0) & (terms.diffuse_fraction[bright] < 0.5))
    # Channels are averages already.
    axis = SpectralAxis(terms.wavelength_nm, terms.fwhm_nm)
    np.testing.assert_allclose(terms.at_bands(axis).direct, terms.direct, rtol=1e-12)


def test_channels_are_not_averaged_twice_and_narrow_ones_serve_as_samples():
    nm = np.arange(400.0, 600.0, 1.0)
    values, axis = np.cos(nm / 15.0), SpectralAxis(np.array([500.0]), np.array([10.0]))
    terms = {width: AtmosphericTerms(nm, *([values] * 6), fwhm_nm=np.full(nm.size, width)) for width in (1.0, 5.5, 10)}
    samples = AtmosphericTerms(nm, *([values] * 6)).at_bands(axis).direct
    np.testing.assert_array_equal(terms[1.0].at_bands(axis).direct, samples)
    assert abs(samples[0] - np.cos(500.0 / 15.0)) > 0.01  # averaged, not picked
    assert terms[10].at_bands(axis).direct[0] == np.cos(500.0 / 15.0)
    with pytest.raises(UsageError, match="channels that do not suit the band"):
        terms[5.5].at_bands(axis)


@pytest.mark.data
@pytest.mark.parametrize("relative", CASES["black_channels"])
def test_single_black_runs_and_overlapping_spectrometers(data_dir, relative):
    path = data_dir(relative)
    (block,) = air.read_channels(path)
    terms = air.read_chn(path)
    assert np.all(np.diff(terms.wavelength_nm) >= 0)
    assert block.albedo == 0.0
    np.testing.assert_allclose(terms.path_radiance, block.radiance, rtol=1e-4)
    if "pasadena" in relative:  # 2017-11-08T18:42Z, 52.4 deg from the zenith at 0.9906 au: the sunlight by ASTM G173
        sun = air.extraterrestrial_irradiance("astm-g173", terms.wavelength_nm, 0.9906) * np.cos(np.deg2rad(52.4))
        visible = (terms.wavelength_nm > 450.0) & (terms.wavelength_nm < 1000.0)
        assert np.median((terms.diffuser_radiance / sun * np.pi)[visible]) == pytest.approx(1.0, abs=0.02)


@pytest.fixture(scope="module")
def scripts():
    """The scripts that made the numbers, their errors and the tables of validation/atmosphere/README.md."""
    folder, modules = Path(__file__).parents[2] / "validation/atmosphere", []
    for name in ("modtran_cases", "compare_modtran", "engine_ratio", "fine_structure"):
        spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        modules.append(module)
    return modules[1:]


@pytest.mark.data
@pytest.mark.slow
def test_embedded_engine_keeps_every_criterion_against_modtran_6(data_dir, scripts, terms_of):
    compare, document = scripts[0], Path(__file__).parents[2] / "validation/atmosphere/README.md"
    pairs = [compare.matched(case, terms_of(case.state)) for case in compare.cases(data_dir)]
    found = compare.verdicts(compare.differences(pairs))
    assert (len(pairs), len(found)) == (11, 20)
    for verdict in found:
        assert verdict.limit == (0.10 if "path" in verdict.name else 0.05 if "transm" in verdict.name else 0.02)
        assert abs(verdict.median) <= verdict.limit, verdict.name
    table = document.read_text("utf-8").split("<!-- compare_modtran.py: begin -->")[1].split("compare_modtran.py: end")
    assert table[0].count("| met |") == len(found)


@pytest.mark.data
@pytest.mark.slow
def test_each_flight_is_predicted_from_the_other_and_the_budget_is_what_is_left(
    data_dir, scripts, engine_cache, monkeypatch
):
    """Here and not beside the tests of the ratio: the states are those of the tests above, and computed once."""
    monkeypatch.setenv("HYPERVAL_CACHE", str(engine_cache))
    made, fine = scripts[1:]
    pairs = made.pairs_of(data_dir)
    ratio = made.fitted([p for p in pairs if p.flight == "topoflux"])
    error = made.differences(
        [(p.ours(ratio), p.theirs) for p in pairs if p.flight == "pasadena" and p.case.albedos]  # run with DISORT
    )
    for low, high, limit, least in ((0.85, 1.01, 0.05, 0.99), (0.7, 0.85, 0.05, 0.9), (0.5, 0.7, 0.1, 0.9)):
        here = error.transmitting(low, high)
        assert np.mean(np.abs(error.total[here]) <= limit) >= least
    clear = (error.gas > made.WINDOW) & error.window(500.0, 1700.0)
    assert np.mean(np.abs(error.albedo[clear]) <= 0.1) >= 0.9
    rest, depth = fine.residuals(pairs)[1:]
    for low, high in pairwise(fine.DEPTHS):
        here = np.isfinite(rest) & (depth >= low) & (depth < high)
        budget = np.sqrt(np.mean(fine.RELATIVE**2 + (fine.PER_OPTICAL_DEPTH * depth[here]) ** 2))
        assert 0.4 < np.sqrt(np.mean(rest[here] ** 2)) / budget < 2.0

"""MODTRAN: its output, runs that become terms, and runs of the program itself, which a stand-in replaces."""

import gzip
import importlib.util
import json
import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from modtran_samples import RADIANCE_WIDTHS, ROWS, channels, spectrum, tape7
from processes import awaited, is_at_work
from stored_cases import CASES

from hyperval import atmosphere as air
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, modtran
from hyperval.errors import EngineError, HypervalError, InputError, UsageError
from hyperval.spectra import SpectralAxis
from hyperval.units import radiance_per_wavelength

# What MODTRAN wrote, tape7 and channel files: read or refused, the terms of 3.7 from it, and 6S beside it.


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
    compare, made, fine = scripts
    pairs = made.pairs_of(data_dir)
    ratio = made.fitted([p for p in pairs if p.flight == "topoflux"])
    of_disort = [p for p in pairs if p.flight == "pasadena" and p.case.albedos]
    error = compare.differences([(p.ours(ratio), p.theirs) for p in of_disort])
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


# Input for MODTRAN, what the input of others states, and running the user's own: a stand-in replays output.


STATE = CASES["modtran_state"]


def state(**changes):
    return AtmosphericState(**{**CASES["deck_state"], **changes})


def card(lines, number, version):
    """The fields of one line, numbers where they are numbers."""
    found = {}
    for part in CASES["cards"][number].split(", "):
        name, *places = part.replace("|", "").split()
        start, end = map(int, places[-2:] if version == 5 else places[:2])
        text = lines[number][start:end].strip()
        found[name] = float(text) if text[-1:].isdigit() and text[:1] not in "ag" else text
    return found


def deck(version=5, **changes):
    lines = air.tape5(state(**changes), version).splitlines()[8:16]
    return {name: value for number in range(8) for name, value in card(lines, number, version).items()}


@pytest.mark.parametrize("version", [4, 5])
def test_deck_says_what_the_state_says_column_by_column(version):
    found = deck(version)
    assert 160.0 < found.pop("ANGLE") < 160.02  # 20 degrees at the ground is a little less at the sensor
    # The depth for version 5; for version 4 the range that MODTRAN 6 prints of optical depth 0.1 over 0.35 km.
    assert found.pop("VIS") == (-0.1 if version == 5 else pytest.approx(82.73, rel=0.005))
    assert found == CASES["deck"]
    blank = deck(version, water_vapour_g_cm2=None, ozone_atm_cm=None, aot550=0.0)  # left to the model
    assert (blank["H2OSTR"], blank["O3STR"], blank["IHAZE"], blank["VIS"]) == ("", "", 0, 0.0)
    distance = {"day_of_year": None, "earth_sun_distance_au": 1.0}
    far = deck(version, sensor_altitude_km=99_999.0, ground_altitude_km=4.9, aot550=5.0, **distance)
    assert (far["H1"], far["GNDALT"]) == (99_999.0, 4.9)
    assert air.distance_on_day(int(far["IDAY"])) == pytest.approx(1.0, abs=2e-4)


def test_every_run_of_the_model_and_what_modtran_does_not_have():
    lines = air.tape5(state()).splitlines()
    assert [float(line[73:80]) for line in lines[::8]] == [0.0, 0.1, 0.5]
    assert [int(line) for line in lines[7::8]] == [1, 1, 0]
    for aerosol in ("continental", {"dust": 0.5, "soot": 0.5}):
        with pytest.raises(UsageError, match="aerosol"):
            air.tape5(state(aerosol=aerosol))
    with pytest.raises(UsageError, match="MODTRAN 3"):
        air.tape5(state(), 3)


@pytest.mark.data
@pytest.mark.parametrize(("relative", "at", "values"), CASES["real_decks"])
def test_real_decks_have_the_same_columns(data_dir, relative, at, values):
    path = data_dir(f"modtran/{relative}")
    raw = path.read_bytes()
    lines = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode().splitlines()
    found = {k: v for i in range(7) for k, v in card([lines[n] for n in at], i, 5).items()}
    assert {name: found[name] for name in values} == values
    for name, value in found.items():  # a field cut in the wrong place would hold the ends of two numbers
        assert " " not in str(value), name


def test_json_input_states_the_state(tmp_path):
    (tmp_path / "input.json").write_text(air.modtran6_json(state(view_zenith_deg=0.0)))
    cases = air.read_modtran_json(tmp_path / "input.json")
    told = [(c["NAME"], c["CASE"], air.stated_albedo(c)) for c in cases]
    assert told == [("hyperval", i, a) for i, a in enumerate((0, 0.1, 0.5))]
    found, given = air.stated_fields(cases[0], "input.json"), state(view_zenith_deg=0.0).model_dump()
    assert {name: found[name] for name in found} == {name: given[name] for name in found}
    assert {"model", "aerosol", "aot550", "water_vapour_g_cm2", "solar_zenith_deg", "day_of_year"} <= set(found)


@pytest.mark.data
def test_real_json_input_has_our_keys_and_kinds_and_its_fields_are_read(data_dir):
    template = air.read_modtran_json(data_dir("modtran/modtran6_airborne_lut/modtran_template.json"))[0]
    ours = json.loads(air.modtran6_json(state()))["MODTRAN"][0]["MODTRANINPUT"]
    assert set(ours) == set(template)
    for section in ("RTOPTIONS", "ATMOSPHERE", "GEOMETRY", "SPECTRAL", "FILEOPTIONS"):
        assert set(ours[section]) - {"OBSZEN"} <= set(template[section])
        for name in set(ours[section]) & set(template[section]):
            assert isinstance(ours[section][name], str) == isinstance(template[section][name], str), name
    for name in ("MODTRN", "IEMSCT", "IMULT", "NSTR"):
        assert ours["RTOPTIONS"][name] == template["RTOPTIONS"][name]
    lawn = air.read_modtran_json(data_dir("pasadena/lut_multi/LUT_AOT550-0.1000_H2OSTR-1.5000.json"))
    assert [air.stated_albedo(c) for c in lawn] == [0.0, 0.1, 0.5]
    found = air.stated_fields(lawn[0], "lawn")
    assert (found["aot550"], found["water_vapour_g_cm2"], found["sensor_altitude_km"]) == (0.1, 1.5, 2.3)
    # The run's own tp6 prints a solar zenith angle of 52.5 degrees for it.
    assert found["solar_zenith_deg"] == pytest.approx(52.5, abs=0.15)
    thermal = air.read_modtran_json(data_dir("modtran/wagl_modtran5_6/thermal_channel.json"))
    assert "solar_zenith_deg" not in air.stated_fields(thermal[0], "thermal")


def test_sun_by_place_and_time_counts_longitude_to_the_west():
    geometry = {"IPARM": 11, "PARM1": 34.139247, "PARM2": 118.127521, "IDAY": 312, "GMTIME": 18.708}
    found = air.stated_fields({"GEOMETRY": geometry}, "case")
    place = {"latitude_deg": 34.139247, "longitude_deg": -118.127521, "time_utc": "2018-11-08T18:42:29Z"}
    same = AtmosphericState(**{**STATE, **place}).sun
    np.testing.assert_allclose((found["solar_zenith_deg"], found["solar_azimuth_deg"]), same, atol=0.01)


def test_json_that_is_no_input_is_refused(tmp_path):
    for text, said in (
        ("{", "damaged.*JSON"), ("[]", "no list MODTRAN"), ('{"MODTRAN": []}', "no list MODTRAN"),
        ('{"MODTRAN": [3]}', "case 0: no MODTRANINPUT"),
    ):  # fmt: skip
        (tmp_path / "input.json").write_text(text)
        with pytest.raises(InputError, match=said):
            air.read_modtran_json(tmp_path / "input.json")
    with pytest.raises(InputError, match="wrong kind"):
        air.stated_fields({"GEOMETRY": {"H1ALT": "high"}}, "case")


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Write an executable with the given Python body and configure it."""

    def make(body, version=6):
        path = tmp_path / "bin" / "modtran"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!{sys.executable}\nimport json, os, sys, time\n{body}\n")
        path.chmod(0o755)
        monkeypatch.setenv("HYPERVAL_MODTRAN", str(path))
        monkeypatch.setenv("HYPERVAL_MODTRAN_VERSION", str(version))
        return path

    return make


@pytest.fixture
def terms(tmp_path):
    """Terms of the state by the configured MODTRAN."""
    asked = lambda changes: AtmosphericState(**{**STATE, **changes})  # noqa: E731
    return lambda **changes: air.atmospheric_terms(asked(changes), cache_dir=tmp_path / "cache")


def replay(source, name):
    return f"open({name!r}, 'w').write(open({str(source)!r}).read())"


def test_what_is_configured_is_checked_and_the_message_says_how_to(stand_in, terms, tmp_path, monkeypatch):
    monkeypatch.delenv("HYPERVAL_MODTRAN", raising=False)
    with pytest.raises(EngineError, match="no MODTRAN is configured") as caught:
        terms()
    assert "set HYPERVAL_MODTRAN to your MODTRAN executable" in str(caught.value)
    assert "engine: sixs" in str(caught.value)
    path = stand_in("", version=5)
    assert air.configured_modtran() == air.Modtran(path.resolve(), 5, None)
    (path.parent / "DATA").mkdir()
    assert air.configured_modtran().data == (path.parent / "DATA").resolve()
    for name, value, said in (
        ("_DATA", tmp_path / "no", "not a folder"), ("_VERSION", 7, "HYPERVAL_MODTRAN_VERSION=7"),
        ("", tmp_path / "absent", "not an executable file"),
    ):  # fmt: skip
        monkeypatch.setenv(f"HYPERVAL_MODTRAN{name}", str(value))
        with pytest.raises(EngineError, match=said):
            air.configured_modtran()


@pytest.mark.parametrize(
    ("version", "asks", "leaves"),
    [
        (6, "cases = json.load(open(sys.argv[1]))['MODTRAN']; assert len(cases) == 3", "hyperval.tp7"),
        (5, "assert len(open('tape5').read().splitlines()) == 24 and os.path.isdir('DATA')", "tape7"),
        (4, "assert len(open('tape5').read().splitlines()) == 24", "tape7"),
    ],
)
def test_each_version_gets_its_input_and_is_read_once_and_leaves_nothing_behind(
    stand_in, terms, tmp_path, monkeypatch, version, asks, leaves
):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "scratch").mkdir()
    (tmp_path / "sample").write_text(tape7((0.0, 0.1, 0.5)))
    count = tmp_path / "count"
    counted = f"open({str(count)!r}, 'a').write(os.getcwd() + chr(10))"
    path = stand_in(f"{counted}\n{asks}\n{replay(tmp_path / 'sample', leaves)}", version)
    (path.parent / "DATA").mkdir()
    first, again = terms(), terms()
    np.testing.assert_array_equal(first.ground_irradiance, again.ground_irradiance)
    assert (first.provenance["engine"], first.provenance["state"]["aot550"]) == (f"MODTRAN {version}", 0.05)
    assert np.all(first.direct > 0.0)
    (folder,) = count.read_text().splitlines()
    assert folder.startswith(str(tmp_path / "scratch"))
    assert not os.listdir(tmp_path / "scratch")
    terms(aot550=0.06)
    assert len(count.read_text().splitlines()) == 2


def test_failures_name_the_cause(stand_in, terms, tmp_path):
    (tmp_path / "two").write_text(tape7((0.0, 0.1)))
    for body, said in (
        ("print('licence expired'); sys.exit(3)", "ended with code 3: licence expired"),
        ("print('all well')", r"left none of hyperval\.tp7, hyperval\.chn: all well"),
        ("open('hyperval.tp7', 'w').write('rubbish')", "no table"),
        (replay(tmp_path / "two", "hyperval.tp7"), "3 albedos for 2 runs"),
    ):
        stand_in(body)
        with pytest.raises(HypervalError, match=said):
            terms()
    (tmp_path / "bin" / "modtran").write_bytes(b"not a program\0")
    with pytest.raises(EngineError, match="cannot be started"):
        terms()


def test_one_that_hangs_is_ended_with_its_children(stand_in, tmp_path):
    child = tmp_path / "child"
    # A shell, since it starts at once: what has not begun within the second has no child.
    stand_in("").write_text(f"#!/bin/sh\nsleep 60 &\necho $! > {child}\nwait\n")
    with pytest.raises(EngineError, match="longer than 1 s"):
        air.run_modtran(air.modtran6_json(AtmosphericState(**STATE)), air.configured_modtran(), tmp_path, timeout_s=1.0)
    assert awaited(lambda: not is_at_work(int(child.read_text())))


@pytest.mark.data
def test_replayed_real_runs_give_their_terms(stand_in, terms, tmp_path, data_dir):
    path = data_dir("modtran/modtran6_airborne_lut/AOT550-0.0500_H2OSTR-1.2500.chn.gz")
    (tmp_path / "sample").write_bytes(gzip.decompress(path.read_bytes()))
    # It answers for the state it was computed for, and for no other.
    asked = "case = json.load(open(sys.argv[1]))['MODTRAN'][0]['MODTRANINPUT']\n"
    asked += "assert case['ATMOSPHERE']['H2OSTR'] == 1.25 and case['AEROSOLS']['VIS'] == -0.05\n"
    stand_in(asked + replay(tmp_path / "sample", "hyperval.chn"))
    found, direct = terms(), air.terms_from_runs(air.read_channels(path), [0.0, 0.1, 0.5])
    np.testing.assert_allclose(found.direct, direct.direct, rtol=1e-14)
    for name in ("ground_irradiance", "fwhm_nm"):
        np.testing.assert_array_equal(np.isnan(getattr(found, name)), np.isnan(getattr(direct, name)))
    with pytest.raises(EngineError, match="ended with code 1"):
        terms(aot550=0.2)

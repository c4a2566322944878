"""Look-up tables: interpolation rules, range, error, files."""

from __future__ import annotations

import copy
import json
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr
from test_atmosphere_modtran import ROWS
from test_atmosphere_modtran import made_up as chn

from hyperval.atmosphere import (
    AtmosphericState,
    AtmosphericTable,
    aot550_from_range,
    atmospheric_terms,
    between,
    build_table,
    extraterrestrial_irradiance,
    fraction_below,
    read_channels,
    read_table,
    terms_from_runs,
    write_table,
)
from hyperval.errors import InputError, UsageError
from hyperval.model import Origins, predict
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

NM = np.arange(400.0, 1001.0, 10.0)
STATE = {
    "engine": "table", "table": "table.nc", "model": "midlatitude-summer", "water_vapour_g_cm2": 1.2,
    "ozone_atm_cm": 0.3, "aerosol": "rural", "aot550": 0.1, "ground_altitude_km": 0.35, "sensor_altitude_km": 2.3,
    "solar_zenith_deg": 40.0, "solar_azimuth_deg": 160.0, "day_of_year": 100,
}  # fmt: skip
QUANTITIES = ("path", "direct", "adjacency", "spherical_albedo", "ground", "gas")


def state(**changes):
    return AtmosphericState(**{**STATE, **changes})


FIXED = {
    "model": "midlatitude-summer", "aerosol": "rural", "view_zenith_deg": 0.0, "relative_azimuth_deg": 160.0,
    **{name: STATE[name] for name in (
        "aot550", "water_vapour_g_cm2", "ozone_atm_cm", "ground_altitude_km", "sensor_altitude_km", "solar_zenith_deg",
    )},
}  # fmt: skip


def made_up(axes, law, **fields):
    """A table whose quantities all follow ``law(wavelength, *coordinates)``; a spherical albedo a tenth of it."""
    grid = np.meshgrid(*axes.values(), indexing="ij")
    values = np.broadcast_to(law(NM, *(g[..., None] for g in grid)), (*grid[0].shape, NM.size)).copy()
    quantities = {name: values * (0.1 if name == "spherical_albedo" else 1.0) for name in QUANTITIES}
    fixed = {name: value for name, value in FIXED.items() if name not in axes}
    return AtmosphericTable(NM, {n: np.asarray(v, dtype=float) for n, v in axes.items()}, fixed, quantities, **fields)


def flat(**fields):
    return made_up({"aot550": [0.0, 0.4]}, lambda nm, tau: 0.2 + 0 * nm + 0 * tau, **fields)


def absorption(nm, water):
    """A band model in the square-root regime: T = exp(-k sqrt(w))."""
    return 0.8 * np.exp(-np.exp(-(((nm - 940.0) / 30.0) ** 2)) * np.sqrt(water))


LAWS = {
    "aot550": ([0.0, 0.1, 0.4], lambda nm, tau: 0.1 + tau * (nm / 550.0) ** -1, (0.05, 0.1, 0.33)),
    "water_vapour_g_cm2": ([0.5, 1.0, 2.0, 4.0], absorption, (0.5, 0.7, 3.1)),
    "ozone_atm_cm": ([0.2, 0.5], lambda nm, u: np.exp(-0.3 * u) + 0 * nm, (0.31,)),
    "solar_zenith_deg": ([0, 15, 30, 45, 60], lambda nm, z: 1 - (z / 90) ** 3 + 0 * nm, (37.0,)),
}


@pytest.mark.parametrize("name", LAWS)
def test_an_axis_is_exact_where_its_law_holds(name):
    nodes, law, places = LAWS[name]
    made = made_up({name: nodes}, law)
    for x in places:
        got = made.terms(state(**{name: x})).gas_transmittance
        np.testing.assert_allclose(got, law(NM, x) + 0 * NM, rtol=1e-12)


def test_a_range_is_turned_into_depth_and_altitudes_stay_monotone():
    nodes, law, _ = LAWS["aot550"]
    hazy = state(aot550=None, meteorological_range_km=30.0)
    got = made_up({"aot550": nodes}, law).terms(hazy).gas_transmittance
    np.testing.assert_allclose(got, law(NM, hazy.aerosol_optical_depth), rtol=1e-12)
    steps = made_up({"sensor_altitude_km": [0.5, 1.0, 2.0, 5.0]}, lambda nm, z: np.clip(z / 2, 0.1, 0.5) + 0 * nm)
    values = [steps.terms(state(sensor_altitude_km=z)).gas_transmittance[0] for z in np.linspace(0.5, 5.0, 40)]
    assert np.all(np.diff(values) >= 0.0)  # no overshoot
    assert max(values) == 0.5


def test_nodes_of_several_axes_are_met():
    axes = {"aot550": [0.05, 0.2], "water_vapour_g_cm2": [0.5, 1.5, 3.0], "solar_zenith_deg": [20.0, 40.0, 60.0]}
    values = np.random.default_rng(3).uniform(0.1, 0.9, (2, 3, 3, NM.size))
    made = made_up(axes, lambda nm, *_: 0.5 + 0.0 * nm)
    made = replace(made, quantities={**made.quantities, "gas": values})
    for at in np.ndindex(2, 3, 3):
        there = {name: nodes[i] for (name, nodes), i in zip(axes.items(), at, strict=True)}
        np.testing.assert_allclose(made.terms(state(**there)).gas_transmittance, values[at], rtol=1e-10)


GROUND, SENSOR = 0.35, 2.3
NODES = np.array([0.05, 0.1, 0.2, 0.6])
TILT = np.linspace(0.5, 1.5, 7)  # of extinction over wavelength


def single_scattering(tau, sensor=SENSOR):
    """Beer's law both ways, light scattered into the view, path in proportion to the haze below the sensor."""
    tau = np.asarray(tau, dtype=float)
    d = between.depth_below(tau, GROUND, sensor)[..., None] * TILT
    tau = tau[..., None] * TILT
    ground = 0.9 * np.exp(-0.3 * tau)
    direct = ground * 0.85 * np.exp(-1.1 * d)
    return {
        "path": 0.03 + 0.08 * d, "direct": direct, "adjacency": ground * (0.95 - 0.02 * d) - direct,
        "ground": ground, "spherical_albedo": 0.05 + 0.1 * tau, "gas": np.ones_like(tau), "diffuse": 0.2 * tau,
    }  # fmt: skip


@pytest.mark.parametrize("tau", [0.05, 0.07, 0.15, 0.6])
@pytest.mark.parametrize("sensor", [1.0, SENSOR, 705.0])
def test_single_scattering_is_met_exactly_between_two_amounts_of_aerosol(tau, sensor):
    got = between.between_aerosols(NODES, single_scattering(NODES, sensor), tau, GROUND, sensor)
    for name, value in single_scattering(tau, sensor).items():
        np.testing.assert_allclose(got[name], value, rtol=1e-12, err_msg=name)
    dark = {name: v * (np.arange(7) != 3) for name, v in single_scattering(NODES, sensor).items()}
    for value in between.between_aerosols(NODES, dark, tau, GROUND, sensor).values():  # bands without light stay dark
        assert value[3] == 0.0
        assert np.all(np.isfinite(value))


def test_depth_below_is_that_of_the_profile_and_the_whole_from_space():
    ranges = np.array([60.0, 23.0, 10.0])
    tau = [aot550_from_range(v, GROUND) for v in ranges]
    below = [aot550_from_range(v, GROUND, SENSOR) for v in ranges]
    np.testing.assert_allclose(between.depth_below(tau, GROUND, SENSOR), below, rtol=1e-6)
    np.testing.assert_allclose(between.depth_below(tau, GROUND, 705.0), tau, rtol=1e-9)
    assert between.depth_below([0.0], GROUND, SENSOR) == 0.0
    # Clear air: nearly nothing below an aircraft, which a straight line over the whole depth does not know.
    assert between.depth_below([0.05], GROUND, SENSOR)[0] < 0.2 * 0.05


@pytest.mark.parametrize(
    ("low", "high", "sensor", "parts"),
    [
        (0.1, 0.4, SENSOR, 1.0), (0.1, 0.2, SENSOR, 0.5), (0.1, 0.3, SENSOR, np.log(3) / np.log(4)),
        (0.02, 0.08, 705.0, 1.0), (0.0, 0.04, 705.0, 1.0),  # less haze than 0.01 is none
        (0.1, 0.4, GROUND, 0.0),
    ],
)  # fmt: skip
def test_error_of_the_path_is_none_at_nodes_and_grows_with_their_ratio(low, high, sensor, parts):
    nodes = np.array([low, high])
    error = [between.path_error(nodes, t, GROUND, sensor) for t in np.linspace(low, high, 81)]
    assert error[0] == error[-1] == pytest.approx(0.0, abs=1e-12)
    assert max(error) == pytest.approx(parts * between.PATH_ERROR, rel=1e-3)


def test_the_sun_of_the_state_lights_the_table():
    terms, distance = flat().terms(state()), state().distance_au
    unit = np.cos(np.deg2rad(40.0)) * extraterrestrial_irradiance("tsis-1", NM, distance) / np.pi
    np.testing.assert_allclose(terms.path_radiance, 0.2 * unit, rtol=1e-12)
    np.testing.assert_allclose(terms.ground_irradiance, 0.2 * np.pi * unit, rtol=1e-12)
    got = flat(solar_irradiance=np.full(NM.size, 150.0)).terms(state())
    np.testing.assert_allclose(got.direct, 0.2 * np.cos(np.deg2rad(40.0)) * 150.0 / np.pi / distance**2, rtol=1e-12)
    assert got.provenance["solar_spectrum"] == "of the table"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"aot550": 0.45}, r"aot550 0\.45 lies outside the table"),
        ({"sensor_altitude_km": 3.0}, r"sensor_altitude_km is 3\.0, and the table was computed for 2\.3"),
        ({"model": "tropical"}, "model is 'tropical'"), ({"aerosol": "urban"}, "aerosol is 'urban'"),
        ({"solar_zenith_deg": 41.0}, "solar_zenith_deg is 41"), ({"view_zenith_deg": 10.0}, "view_zenith_deg is 10"),
        ({"water_vapour_g_cm2": None}, "water_vapour_g_cm2 is"),
    ],
)  # fmt: skip
def test_what_the_table_does_not_hold_is_refused(changes, said):
    with pytest.raises(UsageError, match=said):
        flat().terms(state(**changes))


def test_at_nadir_the_azimuth_does_not_matter_and_without_aerosol_its_kind_does_not():
    assert flat().terms(state(solar_azimuth_deg=10.0))
    assert flat().terms(state(aerosol="none", aot550=None))
    slanted = replace(flat(), fixed={**FIXED, "view_zenith_deg": 20.0})
    for sun, view in ((160.0, 0.0), (10.0, 210.0), (350.0, 150.0)):  # 160 degrees between them
        assert slanted.terms(state(view_zenith_deg=20.0, solar_azimuth_deg=sun, view_azimuth_deg=view))
    with pytest.raises(UsageError, match="relative_azimuth_deg"):
        slanted.terms(state(view_zenith_deg=20.0, solar_azimuth_deg=10.0))


def test_error_of_a_node_left_out_is_that_of_the_doubled_step():
    # exp(-x) of all quantities from 0.1 and 0.4 at 0.2.  In closed form: the path is straight over the depth below
    # the sensor, ground and direct (their ratio is 1) are exact, the sum of both is twice the ground: exact too.
    made = made_up({"aot550": [0.1, 0.2, 0.4]}, lambda nm, tau: np.exp(-tau) + 0 * nm)
    error = made.terms(state()).provenance["leave_one_out_error"]["aot550"]
    exact = np.exp(-0.2)
    low, here, high = (x * fraction_below(x, 0.35, 2.3) for x in (0.1, 0.2, 0.4))
    guess = np.exp(-0.1) + (np.exp(-0.4) - np.exp(-0.1)) * (here - low) / (high - low)
    albedo = 0.1 * (np.exp(-0.1) + (np.exp(-0.4) - np.exp(-0.1)) / 3.0)  # straight over the whole depth

    def total(path, albedo):
        return path + 2 * exact * 0.3 / (1 - albedo * 0.3)

    assert error["worst"] == pytest.approx(total(guess, albedo) / total(exact, 0.1 * exact) - 1, abs=1e-6)
    assert flat().terms(state()).provenance["leave_one_out_error"] == {"aot550": None}


def wrong_width(value):
    return np.where(np.arange(NM.size) == 0, value, 10.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"axes": {"aot550": np.array([0.4, 0.1])}}, "increasing"),
        ({"axes": {"visibility": np.array([5.0, 80.0])}}, "no axis 'visibility'"),
        ({"wavelength_nm": NM[::-1]}, "wavelengths do not increase"), ({"wavelength_nm": NM[1:]}, "of shape"),
        ({"fwhm_nm": np.full(3, 10.0)}, "of shape"), ({"fwhm_nm": wrong_width(2e-192)}, "fwhm_nm is 2e-192 at 400 nm"),
        ({"fwhm_nm": wrong_width(np.nan)}, "fwhm_nm is nan"),
        ({"solar_irradiance": wrong_width(0.0)}, "solar_irradiance is 0 at 400 nm"),
        ({"solar_irradiance": wrong_width(1e9)}, r"solar_irradiance is 1e\+09"),
        ({"direct": -1.0}, "negative"), ({"path": np.nan}, "not finite"), ({"spherical_albedo": 1.0}, "reaches 1"),
        ({"gas": None}, "gas is missing"),
    ],
)  # fmt: skip
def test_a_table_that_contradicts_itself_is_refused(change, said):
    ((name, value),) = change.items()
    if name in QUANTITIES:
        held = {n: v for n, v in flat().quantities.items() if n != name}
        change = {"quantities": held if value is None else held | {name: np.full((2, NM.size), value)}}
    with pytest.raises(UsageError, match=said):
        replace(flat(), **change)


def test_netcdf_gives_back_the_table_and_the_same_bytes(tmp_path):
    axes = {"aot550": [0.1, 0.2, 0.4], "water_vapour_g_cm2": [0.5, 2.0]}
    made = made_up(
        axes, lambda nm, tau, water: absorption(nm, water) * np.exp(-tau), fwhm_nm=np.full(NM.size, 10.0),
        solar_irradiance=np.full(NM.size, 150.0), source={"made": "up"},
    )  # fmt: skip
    write_table(made, tmp_path / "a.nc")
    time.sleep(1.1)
    write_table(made, tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["a.nc", "b.nc"]
    found, asked = read_table(tmp_path / "a.nc"), state(aot550=0.3)
    ours, theirs = made.terms(asked), found.terms(asked)
    for name in ("path_radiance", "direct", "adjacency", "spherical_albedo", "ground_irradiance", "gas_transmittance"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
    assert theirs.provenance["leave_one_out_error"] == ours.provenance["leave_one_out_error"]
    assert (found.fixed, found.source["made"], len(found.source["sha256"])) == (made.fixed, "up", 64)
    assert read_table(tmp_path / "a.nc") is found  # kept
    write_table(replace(made, source={"made": "anew"}), tmp_path / "a.nc")
    assert read_table(tmp_path / "a.nc").source["made"] == "anew"


def test_files_that_are_no_table_are_refused(tmp_path, monkeypatch):
    (tmp_path / "text.nc").write_text("no")
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    write_table(flat(), tmp_path / "good.nc")
    with xr.open_dataset(tmp_path / "good.nc", engine="h5netcdf") as data:
        loaded = data.load()
    for name, harm in (
        ("neg.nc", lambda d: d.assign(direct=-d["direct"])), ("axis.nc", lambda d: d.rename({"aot550": "height"})),
        ("json.nc", lambda d: d.assign_attrs(fixed="{")), ("format.nc", lambda d: d.assign_attrs(format="2")),
    ):  # fmt: skip
        harm(loaded).to_netcdf(tmp_path / name, engine="h5netcdf")
    for name, said in (
        ("absent.nc", "no such file"), ("text.nc", "not a table"), ("other.nc", "not a table: lacks path"),
        ("neg.nc", "not a valid table: direct has values"), ("axis.nc", "dimensions"), ("json.nc", "not a table"),
        ("format.nc", "another format"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            read_table(tmp_path / name)
    monkeypatch.setattr("hyperval.atmosphere.table._MAX_VALUES", 100)
    with pytest.raises(InputError, match="732 values"):
        read_table(tmp_path / "good.nc")


def test_a_table_with_a_damaged_block_is_refused(tmp_path):
    """HDF5's own checksum of each block takes the place of one over all of it."""
    made = made_up({"aot550": [0.1, 0.4]}, lambda nm, tau: np.cos(nm) ** 2 + tau)
    write_table(made, tmp_path / "good.nc")
    raw, refused = (tmp_path / "good.nc").read_bytes(), 0
    with h5py.File(tmp_path / "good.nc") as file:
        block = file["gas"].id.get_chunk_info(0)
    for number, at in enumerate(range(block.byte_offset, block.byte_offset + block.size, 37)):
        path = tmp_path / f"{number}.nc"
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 4]) + raw[at + 1 :])
        with pytest.raises(InputError, match="not a table"):
            read_table(path)
        refused += 1
    assert refused > 5


def test_a_scenario_names_its_table_and_has_its_error_in_the_budget(tmp_path):
    level = {"path": 0.02, "direct": 0.7, "adjacency": 0.05, "spherical_albedo": 0.1, "ground": 0.8, "gas": 0.95}
    nm = np.arange(340.0, 2601.0, 2.5)
    held = {name: np.full((2, nm.size), value) for name, value in level.items()}
    made = AtmosphericTable(nm, {"aot550": np.array([0.05, 0.2])}, {"aerosol": "rural"}, held)
    write_table(made, tmp_path / "lut.nc")
    axis = SpectralAxis(np.array([550.0, 1000.0, 1650.0]), np.full(3, 10.0))
    origins = Origins(axis=axis, show_progress=False, resolve=lambda reference: tmp_path / reference)

    def predicted(**changes):
        grey = {"name": "grey", "fraction": 1.0, "spectrum": {"constant": 0.3}, "covariance": {"relative_sd": 0.05}}
        content = {
            "name": "from-a-table", "atmosphere": {**STATE, "table": "lut.nc", "aot550": 0.13, **changes},
            "sensor": "emit", "scene": {"classes": [grey]}, "processing": {"elm": "none", "detectors": []},
        }  # fmt: skip
        return predict(Scenario.model_validate(content), origins)

    found, asked = predicted(), state(table="lut.nc", aot550=0.13)
    terms = atmospheric_terms(asked, resolve=lambda reference: tmp_path / reference).at_bands(axis)
    # 3.7 over uniform ground of 0.3.
    want = terms.path_radiance + (terms.direct + terms.adjacency) * 0.3 / (1 - 0.1 * 0.3)
    np.testing.assert_allclose(found.radiance["grey"].mean, want, rtol=1e-12)
    # The state lies between two nodes, so that the path has an error by interpolation.
    part = found.provenance["atmosphere"]["interpolation_path_relative"]
    assert 0.0 < part <= between.PATH_ERROR
    budget = found.radiance["grey"].budget["interpolation of the table"]
    np.testing.assert_allclose(budget, part * terms.path_radiance, rtol=1e-9)
    # A table that changes is read again.
    write_table(replace(made, quantities={**held, "path": held["path"] * 2}), tmp_path / "lut.nc")
    assert np.all(predicted().radiance["grey"].mean > found.radiance["grey"].mean)
    (tmp_path / "folder").mkdir()
    for changes, kind, said in (
        ({"table": "absent.nc"}, InputError, r"absent\.nc"), ({"aot550": 0.3}, UsageError, "lies outside the table"),
    ):  # fmt: skip
        with pytest.raises(kind, match=said):
            predicted(**changes)
    for wrong in ({"table": None}, {"engine": "sixs"}):
        with pytest.raises(ValueError, match="engine: table needs the field table"):
            state(**wrong)


FOLDER = "modtran/modtran6_airborne_lut"
AIRBORNE = {
    "water_vapour_g_cm2": 1.25, "aot550": 0.2, "ground_altitude_km": 0.401945, "sensor_altitude_km": 2.300449,
    "solar_zenith_deg": None, "solar_azimuth_deg": None, "day_of_year": None, "latitude_deg": 34.45333858,
    "longitude_deg": -118.59692454, "time_utc": "2018-09-11T18:57:00Z",
}  # fmt: skip


GEOMETRY = {"H1ALT": 2.3, "IDAY": 100, "IPARM": 12, "PARM1": 160.0, "PARM2": 40.0}
RUNS = {"MODTRANINPUT": {"ATMOSPHERE": {"MODEL": "ATM_MIDLAT_SUMMER"}, "SURFACE": {"GNDALT": 0.35}}}


def channel_folder(folder, change=lambda case: None):
    """Channel files of two aerosols by two columns of water, which path and transmittance follow."""
    for aot in (0.1, 0.3):
        for water in (1.0, 2.0):
            rows = [
                (nm, path * (1 + aot), sun, direct / (1 + 0.1 * water), diffuse, bounce)
                for nm, path, sun, direct, diffuse, bounce in ROWS
            ]
            text = "".join(chn(rows, albedo) for albedo in (0.0, 0.1, 0.5))
            (folder / f"AOT550-{aot}_H2OSTR-{water}.chn").write_text(text)
    cases = []
    for albedo in (0.0, 0.1, 0.5):
        cases.append(copy.deepcopy(RUNS))
        cases[-1]["MODTRANINPUT"]["GEOMETRY"] = dict(GEOMETRY)
        cases[-1]["MODTRANINPUT"]["SURFACE"]["SURREF"] = albedo
        change(cases[-1]["MODTRANINPUT"])
    (folder / "runs_template.json").write_text(json.dumps({"MODTRAN": cases}))
    return folder


def test_a_folder_of_channel_files_is_a_table(tmp_path):
    made = read_table(channel_folder(tmp_path))
    assert {n: v.tolist() for n, v in made.axes.items()} == {"aot550": [0.1, 0.3], "water_vapour_g_cm2": [1.0, 2.0]}
    assert made.fixed["solar_zenith_deg"] == 40.0
    assert made.source["terms"] == "from the runs"
    assert len(made.source["files"]) == 5
    found = made.quantities["path"][1, 0] / made.quantities["path"][0, 1]
    np.testing.assert_allclose(found, 1.3 / 1.1, rtol=1e-4)  # as the files were made
    found = made.quantities["direct"][0, 1] / made.quantities["direct"][1, 0]
    np.testing.assert_allclose(found, 1.1 / 1.2, rtol=1e-4)
    again = read_table(tmp_path / "runs_template.json")
    np.testing.assert_array_equal(again.quantities["path"], made.quantities["path"])


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda f: (f / "AOT550-0.3_H2OSTR-1.0.chn").unlink(), r"not complete: aot550 0\.3, water_vapour_g_cm2 1"),
        (lambda f: (f / "AOT550-0.5.chn").write_text(chn(ROWS)), "different parts"),
        (lambda f: (f / "AOT550-0.5_WIND-1.0.chn").write_text(chn(ROWS)), "'WIND' is no axis"),
        (lambda f: (f / "AOT550-0.30_H2OSTR-1.0.chn").write_text(chn(ROWS)), "a node twice"),
        (lambda f: (f / "runs_template.json").unlink(), "0 run templates"),
        (lambda f: channel_folder(f, lambda case: case["GEOMETRY"].pop("PARM2")), "PARM2|sun is not stated"),
        (lambda f: (f / "AOT550-0.3_H2OSTR-1.0.chn").write_text(chn(ROWS[:2])), "different channels"),
        (
            lambda f: (f / "AOT550-0.3_H2OSTR-1.0.chn").write_text(chn([(r[0], r[1], 2 * r[2], *r[3:]) for r in ROWS])),
            "different suns",
        ),
        (lambda f: [p.unlink() for p in sorted(f.glob("*.chn"))[1:]], "1 channel files"),
        (
            lambda f: channel_folder(f, lambda case: case["GEOMETRY"].update(H1ALT=1 + case["SURFACE"]["SURREF"])),
            "differ",
        ),
    ],
)
def test_folders_that_are_no_table_are_refused(tmp_path, harm, said):
    harm(channel_folder(tmp_path))
    with pytest.raises(InputError, match=said):
        read_table(tmp_path)


def test_a_slanted_template_is_refused_unless_the_files_are_named_after_the_direction(tmp_path):
    """A run with OBSZEN 140 answered for every view, 0, 8.5 and 40 degrees, with one path."""

    def slanted(case):
        case["GEOMETRY"] |= {"OBSZEN": 140.0, "TRUEAZ": 30.0}

    def terms(**view):
        at = state(table="runs_template.json", aot550=0.2, water_vapour_g_cm2=1.5, ozone_atm_cm=None, **view)
        return atmospheric_terms(at, resolve=lambda reference: tmp_path / reference)

    channel_folder(tmp_path, slanted)
    for view in (0.0, 8.5, 40.0):
        with pytest.raises(InputError, match="slanted line of sight\n  expected: OBSZEN: 180") as refused:
            terms(view_zenith_deg=view)
        assert "_view_zenith_deg-30_relative_azimuth_deg-120.chn" in refused.value.mend
    for file in tmp_path.glob("*.chn"):
        file.rename(tmp_path / f"{file.stem}_view_zenith_deg-40_relative_azimuth_deg-70.chn")
    seen = terms(view_zenith_deg=40.0, view_azimuth_deg=90.0)  # 70 degrees from the sun, whose azimuth is 160
    assert np.all(seen.path_radiance > 0.0)
    for view, said in ((0.0, "view_zenith_deg is 0"), (40.0, "relative_azimuth_deg is 20")):
        with pytest.raises(UsageError, match=said):
            terms(view_zenith_deg=view, view_azimuth_deg=140.0)


@pytest.mark.data
def test_a_folder_of_real_channel_files_is_a_table(data_dir):
    made = read_table(data_dir(f"{FOLDER}/modtran_template.json"))
    assert [v.tolist() for v in made.axes.values()] == [[0.05, 0.2], [0.75, 1.25, 2.25]]
    assert made.fixed["solar_zenith_deg"] == pytest.approx(32.59, abs=0.02)
    assert len(made.source["files"]) == 7
    terms = made.terms(state(**AIRBORNE))
    path = data_dir(f"{FOLDER}/AOT550-0.2000_H2OSTR-1.2500.chn.gz")
    exact = terms_from_runs(read_channels(path))
    for name in ("path_radiance", "direct", "adjacency", "spherical_albedo"):
        # The year of the template is not stated: its sun differs by less than 0.05 degree.
        np.testing.assert_allclose(getattr(terms, name), getattr(exact, name), rtol=1e-3, atol=1e-9)
    # A node between 0.75 and 2.25 from these two alone, in windows (transmittance above 0.85).
    error = made.errors["water_vapour_g_cm2"]
    assert error["rms"] < 0.02
    assert made.errors["aot550"] is None
    assert terms.provenance["leave_one_out_error"] == made.errors
    with pytest.raises(UsageError, match="lies outside the table"):
        made.terms(state(**{**AIRBORNE, "water_vapour_g_cm2": 2.5}))


@pytest.mark.slow
def test_a_table_of_the_embedded_engine_meets_it_at_the_nodes(engine_cache, tmp_path):
    # Without aerosol 6S runs a third as often.
    clear = {"aerosol": "none", "aot550": None}
    base = state(engine="sixs", table=None, **clear)
    axes = {"water_vapour_g_cm2": [0.8, 1.2, 1.8, 2.7]}
    made = build_table(base, axes, cache_dir=engine_cache, show_progress=False)
    write_table(made, tmp_path / "table.nc")
    there = read_table(tmp_path / "table.nc")
    for water in (1.2, 2.7):
        exact = atmospheric_terms(
            state(engine="sixs", table=None, **clear, water_vapour_g_cm2=water), cache_dir=engine_cache
        )
        got = there.terms(state(**clear, water_vapour_g_cm2=water))
        np.testing.assert_allclose(got.direct, exact.direct, rtol=1e-10)
        np.testing.assert_allclose(got.ground_irradiance, exact.ground_irradiance, rtol=1e-10)
        np.testing.assert_allclose(got.diffuse_fraction, exact.diffuse_fraction, rtol=1e-10)
    # Between the nodes: within the stated error, which was found at twice the step.
    exact = atmospheric_terms(state(engine="sixs", table=None, **clear, water_vapour_g_cm2=1.5), cache_dir=engine_cache)
    got = there.terms(state(**clear, water_vapour_g_cm2=1.5))
    seen = exact.gas_transmittance > 0.1
    error = np.abs(got.direct / exact.direct - 1)[seen]
    stated = there.errors["water_vapour_g_cm2"]
    assert error.max() <= stated["worst"]
    assert np.sqrt(np.mean(error**2)) <= stated["rms"]
    assert stated["rms"] < 0.01
    # Another solar spectrum, another day: the table holds neither.
    other = state(engine="sixs", table=None, **clear, water_vapour_g_cm2=1.2, day_of_year=10)
    exact = atmospheric_terms(other, cache_dir=engine_cache)
    got = there.terms(state(**clear, water_vapour_g_cm2=1.2, day_of_year=10))
    np.testing.assert_allclose(got.direct, exact.direct, rtol=1e-10)
    np.testing.assert_allclose(got.diffuser_radiance, exact.diffuser_radiance, rtol=1e-10)


def test_grids_that_cannot_be_built_are_refused():
    base = state(engine="sixs", table=None)
    for axes, said in (
        ({}, "no axis"),
        ({"relative_azimuth_deg": [0.0, 90.0]}, "relative_azimuth_deg"),
        ({"visibility": [5.0, 23.0]}, "visibility"),
        ({"sensor_altitude_km": [0.2, 2.0]}, "no valid state"),
        ({"aot550": np.linspace(0, 1, 200), "water_vapour_g_cm2": np.linspace(0.1, 3, 200)}, "40000 nodes"),
    ):
        with pytest.raises(UsageError, match=said):
            build_table(base, axes)
    with pytest.raises(UsageError, match="engine: sixs, not table"):
        build_table(state(), {"aot550": [0.1, 0.2]})

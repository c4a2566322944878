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
    atmospheric_terms,
    build_table,
    extraterrestrial_irradiance,
    fraction_below,
    read_channels,
    read_table,
    terms_from_runs,
    write_table,
)
from hyperval.atmosphere.table import AXES, QUANTITIES, coordinates, leave_one_out
from hyperval.atmosphere.terms import along
from hyperval.errors import InputError, UsageError

NM = np.arange(400.0, 1001.0, 10.0)
STATE = {
    "engine": "table", "table": "table.nc", "model": "midlatitude-summer", "water_vapour_g_cm2": 1.2,
    "ozone_atm_cm": 0.3, "aerosol": "rural", "aot550": 0.1, "ground_altitude_km": 0.35, "sensor_altitude_km": 2.3,
    "solar_zenith_deg": 40.0, "solar_azimuth_deg": 160.0, "day_of_year": 100,
}  # fmt: skip


def state(**changes):
    return AtmosphericState(**{**STATE, **changes})


def made_up(axes, law, **fields):
    """A table whose quantities all follow ``law(wavelength, **coordinates)``; a spherical albedo a tenth of it."""
    grid = np.meshgrid(*axes.values(), indexing="ij")
    at = {name: g[..., None] for name, g in zip(axes, grid, strict=True)}
    values = np.broadcast_to(law(NM, **at), (*grid[0].shape, NM.size)).copy()
    quantities = {name: values * (0.1 if name == "spherical_albedo" else 1.0) for name in QUANTITIES}
    fixed = {n: v for n, v in coordinates(state()).items() if n not in axes}
    fixed |= {"model": "midlatitude-summer", "aerosol": "rural"}
    return AtmosphericTable(NM, {n: np.asarray(v, dtype=float) for n, v in axes.items()}, fixed, quantities, **fields)


def absorption(nm, water_vapour_g_cm2, **_):
    """A band model in the square-root regime: T = exp(-k sqrt(w))."""
    k = np.exp(-(((nm - 940.0) / 30.0) ** 2))
    return 0.8 * np.exp(-k * np.sqrt(water_vapour_g_cm2))


def test_aerosol_depth_is_linear_and_a_range_is_turned_into_depth():
    table = made_up({"aot550": [0.0, 0.1, 0.4]}, lambda nm, aot550: 0.1 + aot550 * (nm / 550.0) ** -1)
    for depth in (0.05, 0.1, 0.33):
        got = table.terms(state(aot550=depth)).gas_transmittance
        np.testing.assert_allclose(got, 0.1 + depth * (NM / 550.0) ** -1, rtol=1e-12)
    hazy = state(aot550=None, meteorological_range_km=30.0)
    got = table.terms(hazy).gas_transmittance
    np.testing.assert_allclose(got, 0.1 + hazy.aerosol_optical_depth * (NM / 550.0) ** -1, rtol=1e-12)


def test_water_follows_its_square_root_in_the_exponent():
    table = made_up({"water_vapour_g_cm2": [0.5, 1.0, 2.0, 4.0]}, absorption)
    for water in (0.5, 0.7, 3.1):
        got = table.terms(state(water_vapour_g_cm2=water)).gas_transmittance
        np.testing.assert_allclose(got, absorption(NM, water), rtol=1e-12)


def test_ozone_is_linear_in_the_exponent():
    table = made_up({"ozone_atm_cm": [0.2, 0.5]}, lambda nm, ozone_atm_cm: np.exp(-0.3 * ozone_atm_cm) + 0 * nm)
    got = table.terms(state(ozone_atm_cm=0.31)).gas_transmittance
    np.testing.assert_allclose(got, np.exp(-0.3 * 0.31), rtol=1e-12)


def test_angles_follow_a_cubic_and_altitudes_stay_monotone():
    zenith = made_up(
        {"solar_zenith_deg": [0, 15, 30, 45, 60]},
        lambda nm, solar_zenith_deg: 1 - (solar_zenith_deg / 90) ** 3 + 0 * nm,
    )
    got = zenith.terms(state(solar_zenith_deg=37.0)).gas_transmittance
    np.testing.assert_allclose(got, 1 - (37.0 / 90) ** 3, rtol=1e-12)
    levels = np.array([0.5, 1.0, 2.0, 5.0, 10.0])
    steps = np.array([0.1, 0.5, 0.5, 0.6, 0.6])[:, None] * np.ones(NM.size)
    for z in np.linspace(0.5, 10.0, 40):
        value = along(levels, steps, z, AXES["sensor_altitude_km"][0])
        assert np.all((value >= 0.1) & (value <= 0.6))  # no overshoot
    assert along(levels, steps, 1.5, AXES["sensor_altitude_km"][0])[0] == pytest.approx(0.5)


def test_nodes_of_several_axes_are_met():
    axes = {"aot550": [0.05, 0.2], "water_vapour_g_cm2": [0.5, 1.5, 3.0], "solar_zenith_deg": [20.0, 40.0, 60.0]}
    rng = np.random.default_rng(3)
    table = made_up(axes, lambda nm, **_: 0.5 + 0.0 * nm)
    values = rng.uniform(0.1, 0.9, (2, 3, 3, NM.size))
    table = replace(table, quantities={**table.quantities, "gas": values})
    for i, depth in enumerate(axes["aot550"]):
        for j, water in enumerate(axes["water_vapour_g_cm2"]):
            for k, zenith in enumerate(axes["solar_zenith_deg"]):
                got = table.terms(state(aot550=depth, water_vapour_g_cm2=water, solar_zenith_deg=zenith))
                np.testing.assert_allclose(got.gas_transmittance, values[i, j, k], rtol=1e-10)


def test_the_sun_of_the_state_lights_the_table():
    table = made_up({"aot550": [0.0, 0.4]}, lambda nm, aot550: 0.2 + 0 * nm + 0 * aot550)
    terms = table.terms(state())
    asked = state()
    e0 = extraterrestrial_irradiance(asked.solar_spectrum, NM, asked.distance_au)
    np.testing.assert_allclose(terms.path_radiance, 0.2 * np.cos(np.deg2rad(40.0)) * e0 / np.pi, rtol=1e-12)
    np.testing.assert_allclose(terms.ground_irradiance, 0.2 * np.cos(np.deg2rad(40.0)) * e0, rtol=1e-12)
    own = replace(table, solar_irradiance=np.full(NM.size, 150.0))
    got = own.terms(state())
    want = 0.2 * np.cos(np.deg2rad(40.0)) * 150.0 / np.pi / asked.distance_au**2
    np.testing.assert_allclose(got.direct, want, rtol=1e-12)
    assert got.provenance["solar_spectrum"] == "of the table"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"aot550": 0.45}, r"aot550 0\.45 lies outside the table"),
        ({"sensor_altitude_km": 3.0}, r"sensor_altitude_km is 3\.0, and the table was computed for 2\.3"),
        ({"model": "tropical"}, "model is 'tropical'"),
        ({"aerosol": "urban"}, "aerosol is 'urban'"),
        ({"solar_zenith_deg": 41.0}, "solar_zenith_deg is 41"),
        ({"view_zenith_deg": 10.0}, "view_zenith_deg is 10"),
        ({"water_vapour_g_cm2": None}, "water_vapour_g_cm2 is"),
    ],
)
def test_what_the_table_does_not_hold_is_refused(changes, said):
    table = made_up({"aot550": [0.0, 0.4]}, lambda nm, aot550: 0.2 + 0 * nm + 0 * aot550)
    assert table.terms(state())
    with pytest.raises(UsageError, match=said):
        table.terms(state(**changes))


def test_at_nadir_the_azimuth_does_not_matter_and_without_aerosol_its_kind_does_not():
    table = made_up({"aot550": [0.0, 0.4]}, lambda nm, aot550: 0.2 + 0 * nm + 0 * aot550)
    assert table.terms(state(solar_azimuth_deg=10.0))
    assert table.terms(state(aerosol="none", aot550=None))
    slanted = replace(table, fixed={**table.fixed, "view_zenith_deg": 20.0})
    with pytest.raises(UsageError, match="relative_azimuth_deg"):
        slanted.terms(state(view_zenith_deg=20.0, solar_azimuth_deg=10.0))


def test_error_of_a_node_left_out_is_that_of_the_doubled_step():
    # exp(-x) of all quantities from 0.1 and 0.4 at 0.2.  In closed form: the path is straight over the depth below
    # the sensor, ground and direct (their ratio is 1) are exact, the sum of both is twice the ground: exact too.
    table = made_up({"aot550": [0.1, 0.2, 0.4]}, lambda nm, aot550: np.exp(-aot550) + 0 * nm)
    (error,) = leave_one_out(table).values()
    exact = np.exp(-0.2)
    low, here, high = (x * fraction_below(x, 0.35, 2.3) for x in (0.1, 0.2, 0.4))
    guess = np.exp(-0.1) + (np.exp(-0.4) - np.exp(-0.1)) * (here - low) / (high - low)
    albedo = 0.1 * (np.exp(-0.1) + (np.exp(-0.4) - np.exp(-0.1)) / 3.0)  # straight over the whole depth

    def total(path, albedo):
        return path + 2 * exact * 0.3 / (1 - albedo * 0.3)

    assert error["worst"] == pytest.approx(total(guess, albedo) / total(exact, 0.1 * exact) - 1, abs=1e-6)
    assert leave_one_out(made_up({"aot550": [0.1, 0.2]}, lambda nm, aot550: aot550 + 0 * nm)) == {"aot550": None}
    assert table.terms(state()).provenance["leave_one_out_error"]["aot550"] == error


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"axes": {"aot550": np.array([0.4, 0.1])}}, "increasing"),
        ({"axes": {"visibility": np.array([5.0, 80.0])}}, "no axis 'visibility'"),
        ({"wavelength_nm": NM[::-1]}, "wavelengths do not increase"),
        ({"wavelength_nm": NM[1:]}, "of shape"),
    ],
)
def test_a_table_that_contradicts_itself_is_refused(change, said):
    table = made_up({"aot550": [0.1, 0.4]}, lambda nm, aot550: aot550 + 0 * nm)
    with pytest.raises(UsageError, match=said):
        replace(table, **change)
    for name, value, complaint in (
        ("direct", -1.0, "negative"), ("path", np.nan, "not finite"), ("spherical_albedo", 1.0, "reaches 1"),
    ):  # fmt: skip
        harmed = {**table.quantities, name: np.full_like(table.quantities[name], value)}
        with pytest.raises(UsageError, match=complaint):
            replace(table, quantities=harmed)
    with pytest.raises(UsageError, match="gas is missing"):
        replace(table, quantities={k: v for k, v in table.quantities.items() if k != "gas"})


def test_netcdf_gives_back_the_table_and_the_same_bytes(tmp_path):
    axes = {"aot550": [0.1, 0.2, 0.4], "water_vapour_g_cm2": [0.5, 2.0]}
    table = made_up(
        axes,
        lambda nm, aot550, water_vapour_g_cm2: absorption(nm, water_vapour_g_cm2) * np.exp(-aot550),
        fwhm_nm=np.full(NM.size, 10.0),
        solar_irradiance=np.full(NM.size, 150.0),
        source={"made": "up"},
    )
    write_table(table, tmp_path / "a.nc")
    time.sleep(1.1)
    write_table(table, tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["a.nc", "b.nc"]
    found = read_table(tmp_path / "a.nc")
    assert list(found.axes) == list(axes)
    for name in QUANTITIES:
        np.testing.assert_array_equal(found.quantities[name], table.quantities[name])
    assert found.fixed == table.fixed
    assert found.errors == leave_one_out(table)
    assert found.source["made"] == "up"
    assert len(found.source["sha256"]) == 64
    asked = state(aot550=0.3)
    np.testing.assert_array_equal(found.terms(asked).direct, table.terms(asked).direct)
    assert read_table(tmp_path / "a.nc") is found  # kept
    write_table(replace(table, source={"made": "anew"}), tmp_path / "a.nc")
    assert read_table(tmp_path / "a.nc").source["made"] == "anew"


def test_files_that_are_no_table_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_table(tmp_path / "absent.nc")
    (tmp_path / "text.nc").write_text("no")
    with pytest.raises(InputError, match="not a table"):
        read_table(tmp_path / "text.nc")
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="not a table: lacks path"):
        read_table(tmp_path / "other.nc")
    table = made_up({"aot550": [0.1, 0.4]}, lambda nm, aot550: aot550 + 0 * nm)
    write_table(table, tmp_path / "good.nc")
    with xr.open_dataset(tmp_path / "good.nc", engine="h5netcdf") as data:
        loaded = data.load()
    for name, harm, said in (
        ("neg.nc", lambda d: d.assign(direct=-d["direct"]), "not a valid table: direct has values"),
        ("axis.nc", lambda d: d.rename({"aot550": "height"}), "dimensions"),
        ("json.nc", lambda d: d.assign_attrs(fixed="{"), "not a table"),
        ("format.nc", lambda d: d.assign_attrs(format="2"), "another format"),
    ):
        harm(loaded).to_netcdf(tmp_path / name, engine="h5netcdf")
        with pytest.raises(InputError, match=said):
            read_table(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("fwhm_nm", 2e-192, r"fwhm_nm is 2e-192 at 400 nm"), ("fwhm_nm", np.nan, "fwhm_nm is nan"),
        ("solar_irradiance", 0.0, "solar_irradiance is 0 at 400 nm"),
        ("solar_irradiance", 1e9, r"solar_irradiance is 1e\+09"),
    ],
)  # fmt: skip
def test_a_table_with_absurd_widths_or_no_sun_is_refused(tmp_path, name, value, said):
    table = made_up({"aot550": [0.1, 0.4]}, lambda nm, aot550: aot550 + 0 * nm, fwhm_nm=np.full(NM.size, 10.0))
    wrong = np.full(NM.size, 10.0)
    wrong[0] = value
    with pytest.raises(UsageError, match=said):
        replace(table, **{name: wrong})
    with pytest.raises(UsageError, match="of shape"):
        replace(table, **{name: np.full(3, 10.0)})
    write_table(table, tmp_path / "good.nc")
    with xr.open_dataset(tmp_path / "good.nc", engine="h5netcdf") as data:
        loaded = data.load()
    loaded[name] = ("wavelength_nm", wrong)
    loaded.to_netcdf(tmp_path / "wrong.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=f"not a valid table: {said}"):
        read_table(tmp_path / "wrong.nc")


def test_a_table_with_a_damaged_block_is_refused_or_unharmed(tmp_path):
    """HDF5's own checksum of each block takes the place of one over all of it."""
    table = made_up({"aot550": [0.1, 0.4]}, lambda nm, aot550: np.cos(nm) ** 2 + aot550)
    write_table(table, tmp_path / "good.nc")
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


def test_a_table_too_large_is_refused_before_it_is_loaded(tmp_path, monkeypatch):
    table = made_up({"aot550": [0.1, 0.4]}, lambda nm, aot550: aot550 + 0 * nm)
    write_table(table, tmp_path / "table.nc")
    monkeypatch.setattr("hyperval.atmosphere.table._MAX_VALUES", 100)
    with pytest.raises(InputError, match="732 values"):
        read_table(tmp_path / "table.nc")


def test_the_state_names_its_table(tmp_path, monkeypatch):
    table = made_up({"aot550": [0.0, 0.4]}, lambda nm, aot550: 0.2 + 0 * nm + 0 * aot550)
    write_table(table, tmp_path / "table.nc")
    terms = atmospheric_terms(state(), resolve=lambda reference: tmp_path / reference)
    assert terms.provenance["engine"] == "table"
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(atmospheric_terms(state()).direct, terms.direct)
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
    table = read_table(channel_folder(tmp_path))
    assert {n: v.tolist() for n, v in table.axes.items()} == {"aot550": [0.1, 0.3], "water_vapour_g_cm2": [1.0, 2.0]}
    assert table.fixed["solar_zenith_deg"] == 40.0
    assert table.source["terms"] == "from the runs"
    assert len(table.source["files"]) == 5
    found = table.quantities["path"][1, 0] / table.quantities["path"][0, 1]
    np.testing.assert_allclose(found, 1.3 / 1.1, rtol=1e-4)  # as the files were made
    found = table.quantities["direct"][0, 1] / table.quantities["direct"][1, 0]
    np.testing.assert_allclose(found, 1.1 / 1.2, rtol=1e-4)
    again = read_table(tmp_path / "runs_template.json")
    np.testing.assert_array_equal(again.quantities["path"], table.quantities["path"])


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
    table = read_table(data_dir(f"{FOLDER}/modtran_template.json"))
    assert [v.tolist() for v in table.axes.values()] == [[0.05, 0.2], [0.75, 1.25, 2.25]]
    assert table.fixed["solar_zenith_deg"] == pytest.approx(32.59, abs=0.02)
    assert len(table.source["files"]) == 7
    terms = table.terms(state(**AIRBORNE))
    path = data_dir(f"{FOLDER}/AOT550-0.2000_H2OSTR-1.2500.chn.gz")
    exact = terms_from_runs(read_channels(path))
    for name in ("path_radiance", "direct", "adjacency", "spherical_albedo"):
        # The year of the template is not stated: its sun differs by less than 0.05 degree.
        np.testing.assert_allclose(getattr(terms, name), getattr(exact, name), rtol=1e-3, atol=1e-9)
    # A node between 0.75 and 2.25 from these two alone, in windows (transmittance above 0.85).
    error = table.errors["water_vapour_g_cm2"]
    assert error["rms"] < 0.02
    assert table.errors["aot550"] is None
    assert terms.provenance["leave_one_out_error"] == table.errors
    with pytest.raises(UsageError, match="lies outside the table"):
        table.terms(state(**{**AIRBORNE, "water_vapour_g_cm2": 2.5}))


@pytest.mark.data
def test_a_folder_named_as_such_and_one_with_a_hole(data_dir, tmp_path):
    source = data_dir(f"{FOLDER}/modtran_template.json").parent
    names = [p.name for p in source.iterdir() if ".chn" in p.name] + ["modtran_template.json"]
    for name in names:
        (tmp_path / name).symlink_to(source / name)
    assert read_table(tmp_path).axes["aot550"].tolist() == [0.05, 0.2]
    (tmp_path / "AOT550-0.2000_H2OSTR-1.2500.chn.gz").unlink()
    with pytest.raises(InputError, match=r"not complete: aot550 0\.2, water_vapour_g_cm2 1\.25"):
        read_table(tmp_path)
    (tmp_path / "modtran_template.json").unlink()
    (tmp_path / "AOT550-0.2000_H2OSTR-1.2500.chn.gz").symlink_to(source / "AOT550-0.2000_H2OSTR-1.2500.chn.gz")
    with pytest.raises(InputError, match="0 run templates"):
        read_table(tmp_path)
    (tmp_path / "modtran_template.json").write_text(json.dumps({"MODTRAN": [{"MODTRANINPUT": {}}]}))
    with pytest.raises(InputError, match="the sun is not stated"):
        read_table(tmp_path)


@pytest.mark.data
def test_a_real_table_written_as_netcdf_is_the_same(data_dir, tmp_path):
    table = read_table(data_dir(f"{FOLDER}/modtran_template.json"))
    write_table(table, tmp_path / "lut.nc")
    found = read_table(tmp_path / "lut.nc")
    asked = state(**{**AIRBORNE, "aot550": 0.13, "water_vapour_g_cm2": 0.9})
    np.testing.assert_array_equal(found.terms(asked).path_radiance, table.terms(asked).path_radiance)
    np.testing.assert_array_equal(found.fwhm_nm, table.fwhm_nm)


@pytest.mark.slow
def test_a_table_of_the_embedded_engine_meets_it_at_the_nodes(engine_cache, tmp_path):
    # Without aerosol 6S runs a third as often.
    clear = {"aerosol": "none", "aot550": None}
    base = state(engine="sixs", table=None, **clear)
    axes = {"water_vapour_g_cm2": [0.8, 1.2, 1.8, 2.7]}
    table = build_table(base, axes, cache_dir=engine_cache, show_progress=False)
    write_table(table, tmp_path / "table.nc")
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


def test_aerosol_alone_ties_quantities_together():
    assert [name for name, (rule, _) in AXES.items() if rule is None] == ["aot550"]


@pytest.mark.parametrize(("sun", "view", "between"), [(100.0, 30.0, 70.0), (10.0, 350.0, 20.0), (350.0, 10.0, 20.0)])
def test_the_azimuth_of_a_state_is_that_between_sun_and_view(sun, view, between):
    state = AtmosphericState(
        aot550=0.2, sensor_altitude_km=2.0, solar_zenith_deg=30.0, solar_azimuth_deg=sun, day_of_year=100,
        view_zenith_deg=10.0, view_azimuth_deg=view,
    )  # fmt: skip
    assert coordinates(state)["relative_azimuth_deg"] == pytest.approx(between)

"""Between states: rules of interpolation, range, error; tables and their files."""

import copy
import json
import pickle
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr
from modtran_samples import ROWS, channels
from stored_cases import CASES

from hyperval import atmosphere as air
from hyperval.atmosphere import AtmosphericState, AtmosphericTable, AtmosphericTerms, between
from hyperval.errors import InputError, UsageError
from hyperval.model import Origins, predict
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

NM = np.arange(400.0, 1001.0, 10.0)
STATE = CASES["table_state"]
QUANTITIES = ("path", "direct", "adjacency", "spherical_albedo", "ground", "gas")
NOT_FIXED = ("engine", "table", "solar_azimuth_deg", "day_of_year")
FIXED = {"view_zenith_deg": 0.0, "relative_azimuth_deg": 160.0} | {k: STATE[k] for k in STATE if k not in NOT_FIXED}


def state(**changes):
    return AtmosphericState(**{**STATE, **changes})


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
    if name == "aot550":
        hazy = state(aot550=None, meteorological_range_km=30.0)
        got = made.terms(hazy).gas_transmittance
        np.testing.assert_allclose(got, law(NM, hazy.aerosol_optical_depth), rtol=1e-12)


def test_altitudes_stay_monotone_and_nodes_of_several_axes_are_met():
    steps = made_up({"sensor_altitude_km": [0.5, 1.0, 2.0, 5.0]}, lambda nm, z: np.clip(z / 2, 0.1, 0.5) + 0 * nm)
    values = [steps.terms(state(sensor_altitude_km=z)).gas_transmittance[0] for z in np.linspace(0.5, 5.0, 40)]
    assert np.all(np.diff(values) >= 0.0)  # no overshoot
    assert max(values) == 0.5
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


@pytest.mark.parametrize("tau", [0.05, 0.07, 0.6])
@pytest.mark.parametrize("sensor", [1.0, SENSOR, 705.0])
def test_single_scattering_is_met_exactly_between_two_amounts_of_aerosol(tau, sensor):
    got = between.between_aerosols(NODES, single_scattering(NODES, sensor), tau, GROUND, sensor)
    for name, value in single_scattering(tau, sensor).items():
        np.testing.assert_allclose(got[name], value, rtol=1e-12, err_msg=name)
    dark = {name: v * (np.arange(7) != 3) for name, v in single_scattering(NODES, sensor).items()}
    for value in between.between_aerosols(NODES, dark, tau, GROUND, sensor).values():  # bands without light stay dark
        assert value[3] == 0.0
        assert np.all(np.isfinite(value))


@pytest.mark.parametrize(("low", "high", "sensor", "parts"), CASES["path_error"])
def test_error_of_the_path_is_none_at_nodes_and_grows_with_their_ratio(low, high, sensor, parts):
    error = [between.path_error(np.array([low, high]), t, GROUND, sensor) for t in np.linspace(low, high, 81)]
    assert error[0] == error[-1] == pytest.approx(0.0, abs=1e-12)
    assert max(error) == pytest.approx(parts * between.PATH_ERROR, rel=1e-3)


def runs(*transmittances):
    """Terms that are all proportional to one transmittance, but for the albedo."""
    of = [np.broadcast_to(np.asarray(t, float), 3) for t in transmittances]
    return [AtmosphericTerms(np.array([5e2, 6e2, 7e2]), 0.1 * t, t, 0.2 * t, np.full(3, 0.1), 3.0 * t, t) for t in of]


def test_runs_on_a_grid_or_a_star_are_exact_where_their_scales_are_and_travel_to_other_processes():
    truth = lambda w, r: np.exp(-0.3 * np.sqrt(w) - 2.0 / r)  # noqa: E731
    axes = {"water_vapour_g_cm2": np.array([0.5, 1.0, 2.0]), "meteorological_range_km": np.array([5.0, 10.0, 40.0])}
    water, distance = axes.values()
    grid = air.interpolated_terms(axes, runs(*(truth(w, r) for w in water for r in distance)))
    w, r = np.array([0.7, 1.9]), np.array([6.0, 33.0])
    found = pickle.loads(pickle.dumps(grid))({"water_vapour_g_cm2": w, "meteorological_range_km": r})  # noqa: S301
    np.testing.assert_allclose(found.direct[:, 0], truth(w, r), rtol=1e-12)
    np.testing.assert_allclose(found.spherical_albedo, 0.1, rtol=1e-12)
    # On a star changes of several inputs add up, and no corner is needed.
    truth = lambda a, o: np.exp(-0.8 * a - 0.5 * a**2 - 0.4 * o)  # noqa: E731
    axes = {"aot550": np.array([0.1, 0.05, 0.2]), "ozone_atm_cm": np.array([0.3, 0.25])}
    nodes = [truth(*x) for x in ((0.1, 0.3), (0.05, 0.3), (0.2, 0.3), (0.1, 0.25))]
    star = air.interpolated_terms(axes, runs(*nodes), star=True)
    a, o = np.array([0.1, 0.13, 0.25]), np.array([0.3, 0.28, 0.33])  # the last one beyond the nodes
    np.testing.assert_allclose(star({"aot550": a, "ozone_atm_cm": o}).direct[:, 0], truth(a, o), rtol=1e-12)


def test_no_light_stays_none_a_transmittance_at_most_one_and_what_lies_outside_is_refused():
    nodes = {"aot550": np.array([0.0, 0.1, 0.2])}
    made = air.interpolated_terms(nodes, runs([0, 0.5, 0.999], [0, 0.5, 1], [0, 0.5, 1]))
    found = made({"aot550": np.array([0.12, 0.15])})
    assert np.all(found.direct[:, 0] == 0.0)
    assert found.gas_transmittance.max() <= 1.0
    with pytest.raises(UsageError, match=r"atmosphere\.aot550 0\.15 to 0\.25 lies outside the table"):
        made({"aot550": np.array([0.15, 0.25])})


def test_nodes_are_even_in_the_scale_of_their_input_but_for_the_sun():
    np.testing.assert_allclose(air.interpolation_nodes("solar_zenith_deg", 0.0, 80.0, 5), [0.0, 20.0, 40.0, 60.0, 80.0])
    nodes = air.interpolation_nodes("meteorological_range_km", 5.0, 80.0, 6)
    assert np.ptp(np.diff(air.smooth_rule("meteorological_range_km").scale(nodes))) < 1e-9 < np.ptp(np.diff(nodes))


def test_the_sun_of_the_state_lights_the_table():
    terms, distance = flat().terms(state()), state().distance_au
    unit = np.cos(np.deg2rad(40.0)) * air.extraterrestrial_irradiance("tsis-1", NM, distance) / np.pi
    np.testing.assert_allclose(terms.path_radiance, 0.2 * unit, rtol=1e-12)
    np.testing.assert_allclose(terms.ground_irradiance, 0.2 * np.pi * unit, rtol=1e-12)
    got = flat(solar_irradiance=np.full(NM.size, 150.0)).terms(state())
    np.testing.assert_allclose(got.direct, 0.2 * np.cos(np.deg2rad(40.0)) * 150.0 / np.pi / distance**2, rtol=1e-12)
    assert got.provenance["solar_spectrum"] == "of the table"


@pytest.mark.parametrize(("changes", "said"), CASES["outside_table"])
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
    low, here, high = (x * air.fraction_below(x, 0.35, 2.3) for x in (0.1, 0.2, 0.4))
    guess = np.exp(-0.1) + (np.exp(-0.4) - np.exp(-0.1)) * (here - low) / (high - low)
    albedo = 0.1 * (np.exp(-0.1) + (np.exp(-0.4) - np.exp(-0.1)) / 3.0)  # straight over the whole depth
    total = lambda path, albedo: path + 2 * exact * 0.3 / (1 - albedo * 0.3)  # noqa: E731
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
    more = {"fwhm_nm": np.full(NM.size, 10.0), "solar_irradiance": np.full(NM.size, 150.0), "source": {"made": "up"}}
    made = made_up(axes, lambda nm, tau, water: absorption(nm, water) * np.exp(-tau), **more)
    air.write_table(made, tmp_path / "a.nc")
    time.sleep(1.1)
    air.write_table(made, tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["a.nc", "b.nc"]
    found = air.read_table(tmp_path / "a.nc")
    ours, theirs = made.terms(state(aot550=0.3)), found.terms(state(aot550=0.3))
    for name, values in ours.spectra().items():
        np.testing.assert_array_equal(getattr(theirs, name), values)
    assert theirs.provenance["leave_one_out_error"] == ours.provenance["leave_one_out_error"]
    assert (found.fixed, found.source["made"], len(found.source["sha256"])) == (made.fixed, "up", 64)
    assert air.read_table(tmp_path / "a.nc") is found  # kept
    air.write_table(replace(made, source={"made": "anew"}), tmp_path / "a.nc")
    assert air.read_table(tmp_path / "a.nc").source["made"] == "anew"


def test_files_that_are_no_table_are_refused(tmp_path, monkeypatch):
    (tmp_path / "text.nc").write_text("no")
    air.write_table(flat(), tmp_path / "good.nc")
    with xr.open_dataset(tmp_path / "good.nc", engine="h5netcdf") as data:
        loaded = data.load()
    harmed = {
        "neg.nc": (loaded.assign(direct=-loaded["direct"]), "not a valid table: direct has values"),
        "axis.nc": (loaded.rename({"aot550": "height"}), "not a valid table: .*height"),
        "json.nc": (loaded.assign_attrs(fixed="{"), "damaged"),
        "format.nc": (loaded.assign_attrs(format="2"), "another format"),
        "other.nc": (loaded.drop_vars("path"), "not a table: lacks path"),
        "text.nc": (None, "not a table"), "absent.nc": (None, "no such file"),
    }  # fmt: skip
    for name, (data, said) in harmed.items():
        if data is not None:
            data.to_netcdf(tmp_path / name, engine="h5netcdf")
        with pytest.raises(InputError, match=said):
            air.read_table(tmp_path / name)
    # HDF5's own checksum of each block takes the place of one over all of it.
    raw = (tmp_path / "good.nc").read_bytes()
    with h5py.File(tmp_path / "good.nc") as file:
        block = file["gas"].id.get_chunk_info(0)
    for at in np.linspace(block.byte_offset, block.byte_offset + block.size - 1, 6).astype(int):
        (tmp_path / f"{at}.nc").write_bytes(raw[:at] + bytes([raw[at] ^ 4]) + raw[at + 1 :])
        with pytest.raises(InputError, match="damaged"):
            air.read_table(tmp_path / f"{at}.nc")
    monkeypatch.setattr("hyperval.atmosphere.table._MAX_VALUES", 100)
    with pytest.raises(InputError, match="732 values"):
        air.read_table(tmp_path / "good.nc")


def test_a_scenario_names_its_table_and_has_its_error_in_the_budget(tmp_path):
    level = {"path": 0.02, "direct": 0.7, "adjacency": 0.05, "spherical_albedo": 0.1, "ground": 0.8, "gas": 0.95}
    nm = np.arange(340.0, 2601.0, 2.5)
    held = {name: np.full((2, nm.size), value) for name, value in level.items()}
    made = AtmosphericTable(nm, {"aot550": np.array([0.05, 0.2])}, {"aerosol": "rural"}, held)
    air.write_table(made, tmp_path / "lut.nc")
    axis = SpectralAxis(np.array([550.0, 1000.0, 1650.0]), np.full(3, 10.0))
    origins = Origins(axis=axis, resolve=lambda reference: tmp_path / reference)

    def predicted(**changes):
        grey = {"name": "grey", "fraction": 1.0, "spectrum": {"constant": 0.3}, "covariance": {"relative_sd": 0.05}}
        content = {
            "name": "from-a-table", "atmosphere": {**STATE, "table": "lut.nc", "aot550": 0.13, **changes},
            "sensor": "emit", "scene": {"classes": [grey]}, "processing": {"elm": "none", "detectors": []},
        }  # fmt: skip
        return predict(Scenario.model_validate(content), origins)

    found, asked = predicted(), state(table="lut.nc", aot550=0.13)
    terms = air.atmospheric_terms(asked, resolve=lambda reference: tmp_path / reference).at_bands(axis)
    # 3.7 over uniform ground of 0.3.
    want = terms.path_radiance + (terms.direct + terms.adjacency) * 0.3 / (1 - 0.1 * 0.3)
    np.testing.assert_allclose(found.radiance["grey"].mean, want, rtol=1e-12)
    # The state lies between two nodes, so that the path has an error by interpolation.
    part = found.provenance["atmosphere"]["interpolation_path_relative"]
    assert 0.0 < part <= between.PATH_ERROR
    budget = found.radiance["grey"].budget["interpolation of the table"]
    np.testing.assert_allclose(budget, part * terms.path_radiance, rtol=1e-9)
    # A table that changes is read again.
    air.write_table(replace(made, quantities={**held, "path": held["path"] * 2}), tmp_path / "lut.nc")
    assert np.all(predicted().radiance["grey"].mean > found.radiance["grey"].mean)
    with pytest.raises(InputError, match=r"absent\.nc"):
        predicted(table="absent.nc")


GEOMETRY = {"H1ALT": 2.3, "IDAY": 100, "IPARM": 12, "PARM1": 160.0, "PARM2": 40.0}
RUNS = {"MODTRANINPUT": {"ATMOSPHERE": {"MODEL": "ATM_MIDLAT_SUMMER"}, "SURFACE": {"GNDALT": 0.35}}}
HAZY = "AOT550-0.3_H2OSTR-1.0.chn"


def channel_folder(folder, change=lambda case: None):
    """Channel files of two aerosols by two columns of water, which path and transmittance follow."""
    for aot in (0.1, 0.3):
        for water in (1.0, 2.0):
            rows = [(r[0], r[1] * (1 + aot), r[2], r[3] / (1 + 0.1 * water), *r[4:]) for r in ROWS]
            text = "".join(channels(rows, albedo) for albedo in (0.0, 0.1, 0.5))
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
    made = air.read_table(channel_folder(tmp_path))
    assert {n: v.tolist() for n, v in made.axes.items()} == {"aot550": [0.1, 0.3], "water_vapour_g_cm2": [1.0, 2.0]}
    source = made.source
    assert (made.fixed["solar_zenith_deg"], source["terms"], len(source["files"])) == (40.0, "from the runs", 5)
    path, direct = made.quantities["path"], made.quantities["direct"]
    np.testing.assert_allclose(path[1, 0] / path[0, 1], 1.3 / 1.1, rtol=1e-4)  # as the files were made
    np.testing.assert_allclose(direct[0, 1] / direct[1, 0], 1.1 / 1.2, rtol=1e-4)
    np.testing.assert_array_equal(air.read_table(tmp_path / "runs_template.json").quantities["path"], path)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda f: (f / HAZY).unlink(), r"not complete: aot550 0\.3, water_vapour_g_cm2 1"),
        (lambda f: (f / "AOT550-0.5.chn").write_text(channels()), "different parts"),
        (lambda f: (f / "AOT550-0.5_WIND-1.0.chn").write_text(channels()), "'WIND' is not an axis"),
        (lambda f: (f / "AOT550-0.30_H2OSTR-1.0.chn").write_text(channels()), "a node twice"),
        (lambda f: (f / "runs_template.json").unlink(), "0 run templates"),
        (lambda f: channel_folder(f, lambda case: case["GEOMETRY"].pop("PARM2")), "PARM2|sun is not stated"),
        (lambda f: (f / HAZY).write_text(channels(ROWS[:2])), "different channels"),
        (lambda f: (f / HAZY).write_text(channels([(*r[:2], 2 * r[2], *r[3:]) for r in ROWS])), "different suns"),
        (lambda f: [p.unlink() for p in sorted(f.glob("*.chn"))[1:]], "1 channel files"),
        (lambda f: channel_folder(f, lambda c: c["GEOMETRY"].update(H1ALT=1 + c["SURFACE"]["SURREF"])), "differ"),
    ],
)
def test_folders_that_are_no_table_are_refused(tmp_path, harm, said):
    harm(channel_folder(tmp_path))
    with pytest.raises(InputError, match=said):
        air.read_table(tmp_path)


def test_a_slanted_template_is_refused_unless_the_files_are_named_after_the_direction(tmp_path):
    """A run with OBSZEN 140 answered for every view, 0, 8.5 and 40 degrees, with one path."""

    def terms(**view):
        at = state(table="runs_template.json", aot550=0.2, water_vapour_g_cm2=1.5, ozone_atm_cm=None, **view)
        return air.atmospheric_terms(at, resolve=lambda reference: tmp_path / reference)

    channel_folder(tmp_path, lambda case: case["GEOMETRY"].update(OBSZEN=140.0, TRUEAZ=30.0))
    with pytest.raises(InputError, match="slanted line of sight\n  expected: OBSZEN: 180") as refused:
        terms(view_zenith_deg=40.0)
    assert "_view_zenith_deg-30_relative_azimuth_deg-120.chn" in refused.value.mend
    for file in tmp_path.glob("*.chn"):
        file.rename(tmp_path / f"{file.stem}_view_zenith_deg-40_relative_azimuth_deg-70.chn")
    seen = terms(view_zenith_deg=40.0, view_azimuth_deg=90.0)  # 70 degrees from the sun, whose azimuth is 160
    assert np.all(seen.path_radiance > 0.0)
    for view, said in ((0.0, "view_zenith_deg is 0"), (40.0, "relative_azimuth_deg is 20")):
        with pytest.raises(UsageError, match=said):
            terms(view_zenith_deg=view, view_azimuth_deg=140.0)


@pytest.mark.slow
def test_a_table_of_the_embedded_engine_meets_it_at_the_nodes(engine_cache, tmp_path):
    # Without aerosol 6S runs a third as often.
    base = state(engine="sixs", table=None, aerosol="none", aot550=None)
    made = air.build_table(base, {"water_vapour_g_cm2": [0.8, 1.2, 1.8, 2.7]}, cache_dir=engine_cache)
    air.write_table(made, tmp_path / "table.nc")
    there = air.read_table(tmp_path / "table.nc")

    def both(**changes):
        asked = base.model_copy(update=changes)
        return there.terms(asked), air.atmospheric_terms(asked, cache_dir=engine_cache, show_progress=False)

    for changes in ({"water_vapour_g_cm2": 1.2}, {"water_vapour_g_cm2": 2.7, "day_of_year": 10}):
        got, exact = both(**changes)  # also on another day: the table holds no sun
        for name in ("direct", "ground_irradiance", "diffuse_fraction", "diffuser_radiance"):
            np.testing.assert_allclose(getattr(got, name), getattr(exact, name), rtol=1e-10)
    # Between the nodes: within the stated error, which was found at twice the step.
    got, exact = both(water_vapour_g_cm2=1.5)
    error = np.abs(got.direct / exact.direct - 1)[exact.gas_transmittance > 0.1]
    stated = there.errors["water_vapour_g_cm2"]
    assert error.max() <= stated["worst"]
    assert np.sqrt(np.mean(error**2)) <= stated["rms"] < 0.01


def test_grids_that_cannot_be_built_are_refused():
    base = state(engine="sixs", table=None)
    for axes, said in (
        ({}, "no axis"),
        ({"relative_azimuth_deg": [0.0, 90.0]}, "relative_azimuth_deg"),
        ({"sensor_altitude_km": [0.2, 2.0]}, "no valid state"),
        ({"aot550": np.linspace(0, 1, 200), "water_vapour_g_cm2": np.linspace(0.1, 3, 200)}, "40000 nodes"),
    ):
        with pytest.raises(UsageError, match=said):
            air.build_table(base, axes)
    with pytest.raises(UsageError, match="engine: sixs, not table"):
        air.build_table(state(), {"aot550": [0.1, 0.2]})

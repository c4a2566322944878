"""The empirical line of a collection, and the reflectance that is written by it."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from small_world import AXIS, BANDS, FIELD_GAIN, GRID, LINES, SURFACES

from hyperval import cli
from hyperval.collection import CalibrationUncertainty, PathRadiance
from hyperval.compare import compare_spectra
from hyperval.errors import UsageError
from hyperval.imagery import open_cube
from hyperval.observe import NO_DATA, SCALE, calibration_covariance, path_estimate, rounding_variance, write_reflectance
from hyperval.scenario import load_scenario
from hyperval.spectra import SpectralAxis
from small_campaign import stand_in_atmosphere

# The empirical line of a collection: its panels and their errors, what it warns of, what it refuses, sites' lines.


def test_the_line_recovers_gain_offset_and_reflectance(make_radiance):
    made = make_radiance()
    seen = made.world.observe()
    assert seen.place.line.gain == pytest.approx(made.gain, rel=1e-9)
    assert seen.place.line.offset == pytest.approx(made.offset, rel=1e-8)
    pixels = made.reflectance[35:45, 5:25].reshape(-1, BANDS)
    corner, radiance = seen.observation.reflectance["corner"], seen.observation.radiance["corner"]
    assert corner.mean == pytest.approx(pixels.mean(axis=0), rel=1e-9)
    assert corner.pixel_covariance == pytest.approx(np.cov(pixels, rowvar=False), rel=1e-6, abs=1e-14)
    assert radiance.mean == pytest.approx(made.offset + made.gain * pixels.mean(axis=0), rel=1e-12)
    assert "empirical line through white, black: usable in 8 bands" in seen.observation.notes


def test_the_line_s_error_is_part_of_the_reflectance(make_radiance):
    made = make_radiance(relative_noise=0.02)
    seen = made.world.observe()
    corner = seen.observation.reflectance["corner"]
    assert set(corner.budget) == {"sampling", "empirical line"}
    total = np.hypot(corner.budget["sampling"], corner.budget["empirical line"])
    assert corner.standard_uncertainty == pytest.approx(total, rel=1e-12)
    # 16 pixels at 2 %: the gain's relative error is about 0.5 % of the white panel's level.
    gain_error = np.sqrt(seen.place.line.covariance[:, 0, 0])
    assert gain_error == pytest.approx(0.02 * (made.offset + 0.6 * made.gain) / 4 / 0.55, rel=0.6)
    # Eight bands, errors independent between them: |z| above 4 has probability 5e-4 for all together.
    truth = made.reflectance[35:45, 5:25].reshape(-1, BANDS).mean(axis=0)
    assert np.abs((corner.mean - truth) / corner.standard_uncertainty).max() < 4.0
    # It is known by the pixels of the panels; the rest is of their field spectra.
    _, *of_panels = corner.estimated  # the first is of its own pixels
    assert len(of_panels) == len(made.panels)
    sampled = sum(np.diag(part.covariance) for part in of_panels)
    assert np.all((sampled > 0.0) & (sampled <= corner.budget["empirical line"] ** 2 * (1.0 + 1e-9)))


def test_errors_of_a_panel_and_of_the_darkest_pixel_by_hand(make_radiance):
    made = make_radiance()
    white = {**made.panels[0], "relative_uncertainty": 0.02, "correlation_nm": 300}
    dark = {"reflectance": 0.03, "uncertainty": 0.01, "radiance_noise": 0.02}
    made.world.collection["empirical_line"] = {"panels": [white], "darkest_pixel": dark}
    found = made.world.observe().place.line
    assert found.names == ("white", "darkest pixel")
    least = made.offset + made.gain * made.reflectance.reshape(-1, BANDS).min(axis=0)
    assert found.reflectance(least) == pytest.approx(np.full(BANDS, 0.03), abs=1e-9)
    # The panel: 2 % of 0.6 with the stated correlation.  The dark surface: one unknown for all bands, and noise
    # that is each band's own.
    apart = np.abs(AXIS.centre_nm[:, None] - AXIS.centre_nm[None])
    first, second = found.panels
    assert np.diag(first.reflectance_error) == pytest.approx(np.full(BANDS, 0.012**2), rel=1e-9)
    assert np.all(np.diff(first.reflectance_error[0][np.argsort(apart[0])]) < 0)
    assert second.reflectance_error == pytest.approx(np.full((BANDS, BANDS), 0.01**2), rel=1e-12)
    assert second.radiance_error == pytest.approx(np.full(BANDS, 0.02**2), rel=1e-12)


@pytest.mark.parametrize(("length", "divisor"), [(None, None), (1e6, None), (None, "spread")])
def test_a_spread_that_a_file_carries_counts_by_the_number_of_its_readings(make_radiance, length, divisor):
    part = 1.0 if divisor else (2.3060041 / 1.9599640) ** 2 / 9  # Student's t of eight degrees of freedom
    made = make_radiance()
    rows = "".join(f"{w},0.6,0.03,0.05,0.03\n" for w in range(400, 1701))
    heading = "# means of N = 9 readings and their standard deviations\nwavelength_nm,white,white_sd,black,black_sd\n"
    made.world.text("panels.csv", heading + rows)
    for panel in made.panels:
        panel |= {"correlation_nm": length} | ({"divisor": divisor} if divisor else {})
    for panel in made.world.observe().place.line.panels:
        assert np.diag(panel.reflectance_error) == pytest.approx(np.full(BANDS, 0.03**2 * part), rel=1e-6)


def test_replicate_spectra_of_a_panel_widen_the_line(make_radiance):
    """Three readings that differ by 5 %: their standard error by Student's t is that of the panel."""
    made = make_radiance(relative_noise=0.001)
    for i, level in enumerate((0.57, 0.60, 0.63)):
        made.world.library(f"white{i}.csv", white=level)
    before = made.world.observe().observation.reflectance["corner"].budget["empirical line"]
    made.panels[0]["spectrum"] = {"replicates": {"files": "white?.csv", "wavelength_unit": "nm"}}
    assert np.all(made.world.observe().observation.reflectance["corner"].budget["empirical line"] > before)
    made.panels[0]["divisor"] = "spread"
    assert np.diag(made.world.observe().place.line.panels[0].reflectance_error) == pytest.approx(np.full(BANDS, 0.0009))


def test_a_panel_with_a_full_pixel_is_refused_save_in_bad_bands(panels):
    line = panels.collection["empirical_line"]
    line["saturation"] = float(panels.values[0:4, 30:34].max()) - 1e-9
    with pytest.raises(UsageError, match=r"'white' is saturated in 16 of 16 pixels .first: band 1, 450 nm"):
        panels.observe()
    # A stored integer at the end of its type is full too.
    del line["saturation"]
    panels.collection["cube"]["scale"] = 2.5e-4
    numbers = np.rint(panels.values / 2.5e-4)
    numbers[0, 30, 2] = numbers[1, 33, 6] = 65535
    panels.write(numbers, data_type=12)
    with pytest.raises(UsageError, match=r"'white' is saturated in 2 of 16 pixels .first: band 3"):
        panels.observe()
    bad = ~np.isin(np.arange(BANDS), [2, 6])
    panels.write(numbers, data_type=12, axis=type(AXIS)(AXIS.centre_nm, AXIS.fwhm_nm, bad))
    assert panels.observe().place.line is not None


def test_panels_of_a_line_are_no_evidence_for_it(make_radiance):
    made = make_radiance(relative_noise=0.002)
    seen = made.world.observe().observation
    for panel in ("white", "black"):
        own = seen.reflectance[panel]
        (row,) = compare_spectra(own, own, seen.axis, "reflectance")
        assert np.isnan(row.value)
        assert "no degree of freedom" in row.reason
    # Of more than two, each is seen by the line through the others; the last is not what it is taken for.
    world = made.more_panels(1e-3, grey=0.30, light=0.50)
    light = world.observe().observation.reflectance["light"]
    del made.panels[3]
    alone = world.observe().observation.reflectance["light"]
    assert light.circular == ""
    assert light.mean == pytest.approx(alone.mean, rel=1e-9)  # 0.45, as it is no panel of that line
    assert light.mean == pytest.approx(0.45, abs=0.01)
    assert light.error_covariance == pytest.approx(alone.error_covariance, rel=1e-6)


def test_panels_that_contradict_each_other_widen_the_line_and_are_warned_of(make_radiance):
    made = make_radiance(relative_noise=0.002)
    world = made.more_panels(1e-3, grey=0.30, light=0.45)
    for panel in made.panels:
        panel["relative_uncertainty"] = 0.01
    agreeing = world.observe()
    assert not [n for n in agreeing.observation.notes if n.startswith("warning:")]
    world.library("more.csv", grey=0.30, light=0.62)
    apart = world.observe()
    notes = apart.observation.notes
    assert np.abs(apart.place.line.leave_one_out_errors[3] + 0.17) == pytest.approx(np.zeros(BANDS), abs=0.01)
    (told,) = (n for n in notes if "leave-one-panel-out" in n)
    assert "light -0.17 (median over bands, at most -0.17)" in told
    chi2 = np.median(apart.place.line.reduced_chi2)
    assert chi2 > 20
    assert f"empirical line: reduced chi-square of its panels {chi2:.3g} (median over bands)" in notes
    warned = [n for n in notes if n.startswith("warning:")]
    factor = np.sqrt(apart.place.line.birge_factor)
    assert any(f"within their stated errors: they are {factor:.3g} times as great" in n for n in warned)
    assert any("line give light a reflectance that is off by 0.17" in n for n in warned)
    # The line itself hardly turns, so that its width is what differs.
    width, wide = (s.observation.reflectance["corner"].budget["empirical line"] for s in (agreeing, apart))
    assert wide == pytest.approx(width * factor, rel=0.25)


def test_a_line_without_most_of_the_bands_is_warned_of(make_radiance):
    world = make_radiance(relative_noise=0.002).world
    world.library("panels.csv", white=0.6, black=np.where(AXIS.centre_nm < 700, 0.05, 0.55))
    notes = world.observe().observation.notes
    assert any("warning: the empirical line can be used in 4 of 8 good bands only" in n for n in notes)


@pytest.mark.parametrize("spread", [0.0, 0.1, 0.2, 0.35])
def test_rounding_to_whole_steps_leaves_its_error_in_a_mean(spread):
    # Mean over the normal law by quadrature, mean square over 400 places within a step.
    x = (np.arange(400) + 0.5) / 400.0
    z = np.linspace(-6, 6, 4001)
    density = np.exp(-0.5 * z**2)
    error = np.rint(x[:, None] + spread * z) @ (density / density.sum()) - x
    assert rounding_variance(1.0, spread) == pytest.approx(np.mean(error**2), rel=0.02)
    assert rounding_variance(0.5, 0.5 * spread) == pytest.approx(0.25 * rounding_variance(1.0, spread))
    assert rounding_variance(1.0, 1.0) < 1e-17  # noise of a step smooths the rounding away


def test_a_flat_panel_in_whole_numbers_has_the_error_of_its_rounding(make_radiance):
    world = make_radiance().world
    world.write(np.rint(world.values * 10.0), data_type=2)
    world.collection["cube"]["scale"] = 0.1
    found = world.observe()
    radiance, reflectance = found.observation.radiance["white"], found.observation.reflectance["corner"]
    assert radiance.standard_uncertainty == pytest.approx(0.1 / np.sqrt(12.0), rel=0.01)
    assert radiance.rounding == pytest.approx(np.full(BANDS, 0.01 / 12.0))
    assert reflectance.rounding == pytest.approx(0.01 / 12.0 / found.place.line.gain**2)


def test_calibration_with_a_correlation_length_from_a_table_and_band_by_band(tmp_path, make_radiance):
    (tmp_path / "error.txt").write_text("400 0.04\n1000 0.01\n1400 0.01\n")
    level, gap = np.linspace(10.0, 1.0, BANDS), AXIS.centre_nm[:, None] - AXIS.centre_nm
    table = level * np.interp(AXIS.centre_nm, [400, 1000, 1400], [0.04, 0.01, 0.01])  # 1650 nm takes the last value
    for given, expected in (
        ({"relative": 0.03}, np.outer(0.03 * level, 0.03 * level)),
        ({"file": "error.txt", "correlation_nm": 50.0}, np.outer(table, table) * np.exp(-0.5 * (gap / 50.0) ** 2)),
        ({"file": "error.txt", "uncorrelated": 0.02}, np.diag(table**2 + (0.02 * level) ** 2)),
        ({"relative": 0.03, "uncorrelated": 0.01},
         np.outer(0.03 * level, 0.03 * level) + np.diag((0.01 * level) ** 2)),
    ):  # fmt: skip
        found = calibration_covariance(level, AXIS, CalibrationUncertainty(**given), tmp_path.joinpath)
        assert found == pytest.approx(expected)
    made = make_radiance()
    made.world.collection["calibration"] = {"relative": 0.05}
    corner = made.world.observe().observation.radiance["corner"]
    assert corner.budget["calibration"] == pytest.approx(0.05 * corner.mean)
    total = np.hypot(corner.budget["calibration"], corner.budget["sampling"])
    assert corner.standard_uncertainty == pytest.approx(total)


def test_each_site_follows_from_the_others_of_its_flight_line(lines):
    seen = lines.observe().observation
    assert set(seen.reflectance) == set(SURFACES)
    for name, estimate in seen.reflectance.items():
        usable = np.isfinite(estimate.mean)
        assert usable.sum() >= 4  # two sites that reflect alike fix no line
        assert estimate.mean[usable] == pytest.approx(lines.on_bands(name, "field.csv")[usable], rel=1e-9)
        assert (estimate.n, set(estimate.budget)) == (9, {"empirical line"})  # sites share the calibration
    words = "\n".join(seen.notes)
    assert "sand: reflectance by the empirical line through lawn and turf" in words
    assert "lot: no reflectance by other sites of its flight line: no other site is known" in words


@pytest.fixture
def air(tmp_path, monkeypatch) -> tuple[str, PathRadiance]:
    """A scenario with an atmosphere, and the path radiance that it states for flight line a."""
    monkeypatch.setattr("hyperval.model.stated.atmospheric_terms", stand_in_atmosphere)
    text = (Path(__file__).parent / "air.yaml").read_text("utf-8")
    (tmp_path / "air.yaml").write_text(text)
    return text, PathRadiance(scenario="air.yaml", line="a")


def test_path_radiance_is_what_a_scenario_sees_of_black_ground(air, tmp_path):
    text, source = air
    axis = SpectralAxis(np.array([550.0, 850.0, 1240.0]), np.full(3, 5.0))
    estimate = path_estimate(source, axis, tmp_path.joinpath)
    t = stand_in_atmosphere(load_scenario(tmp_path / "air.yaml").atmosphere).at_bands(axis)
    expected = t.path_radiance + 0.25 * t.adjacency / (1.0 - 0.25 * t.spherical_albedo)
    assert estimate.mean == pytest.approx(expected, rel=1e-12)
    assert np.all(estimate.standard_uncertainty >= 0.0499 * t.path_radiance)
    (tmp_path / "air.yaml").write_text(text[: text.index("uncertainty")])
    with pytest.raises(UsageError, match="the scenario states no uncertainty"):
        path_estimate(source, axis, tmp_path.joinpath)


def test_one_other_site_needs_the_path_radiance(lines, air):
    spectra, line = lines.collection["spectra"], lines.collection["empirical_line"]
    del spectra[2:], line["panels"][2:]
    seen = lines.observe().observation
    assert seen.reflectance == {}
    assert any("lawn: no reflectance by other sites" in n and "path_radiance" in n for n in seen.notes)
    path = path_estimate(air[1], seen.axis, lines.resolve)
    line["path_radiance"] = [{"line": "a", "scenario": "air.yaml"}]
    rho = {n: lines.on_bands(n, "field.csv") for n in ("lawn", "turf")}
    a, b = (path.mean + FIELD_GAIN * rho[name] for name in rho)
    spectra.clear()
    for name, level in zip(rho, (a, b), strict=True):
        lines.site(name, level, line="a")
    seen = lines.observe().observation
    lawn = seen.reflectance["lawn"]
    assert lawn.mean == pytest.approx(rho["lawn"], rel=1e-9)
    assert any("lawn: reflectance by the one-point empirical line through turf" in n for n in seen.notes)
    # rho = r (L - P) / (l - P): d rho / d ln r = rho, d rho / d P = r (L - l) / (l - P)^2; a gain g of all sites
    # leaves rho as it is, but for P, which is then P / g.
    by_path = rho["turf"] * (a - b) / (b - path.mean) ** 2
    variance = np.diag(path.error_covariance) + path.mean**2 * (0.05**2 + 0.01**2)
    expected = 0.02**2 * rho["lawn"] ** 2 + by_path**2 * variance
    assert np.diag(lawn.error_covariance) == pytest.approx(expected, rel=1e-5)


# The reflectance cube that observe writes on request: read back, whole or not at all, refused without a line.


OUTSIDE = [12, 17]  # a reflectance beyond what the integers hold
FILL = [25, 30]


@pytest.fixture
def measured(make_radiance):
    """Radiance with a pixel without data, one too bright, a band without a gain and a bad band; its cube and line."""
    made = make_radiance()
    world, values = made.world, made.world.values.copy()
    values[tuple(OUTSIDE)] = made.offset + 4.0 * made.gain
    values[..., 3] = 1.0 + 1e-4 * np.random.default_rng(1).standard_normal(values.shape[:2])  # a dark band
    values[tuple(FILL)] = 0.0
    world.write(values, axis=type(AXIS)(AXIS.centre_nm, AXIS.fwhm_nm, np.arange(BANDS) != 5))
    world.detection = None
    seen = world.observe()
    assert seen.place.line.usable.tolist() == [True, True, True, False, True, True, True, True]
    return made, seen.place.cube, seen.place.line


@pytest.mark.parametrize("form", ["envi", "cog"])
def test_what_is_read_back_is_the_reflectance_to_half_a_step(measured, tmp_path, form):
    made, cube, elm = measured
    path, note = write_reflectance(tmp_path / "out", "r", cube, elm, form)
    found = open_cube(path, quantity="reflectance", check_values=False)
    assert np.array_equal(found.axis.centre_nm, AXIS.centre_nm)
    assert found.axis.fwhm_nm == pytest.approx(AXIS.fwhm_nm, rel=1e-12)
    assert np.flatnonzero(~found.axis.good).tolist() == [3, 5]
    assert (found.transform, found.crs) == (GRID, cube.crs)
    assert found.gain == pytest.approx(1e-4)
    block = found.read(0, LINES)
    assert np.argwhere(~block.valid).tolist() == [OUTSIDE, FILL]
    assert np.isnan(block.values[..., 3]).all()
    assert np.isnan(block.values[tuple(OUTSIDE)]).all()
    assert np.isnan(block.values[tuple(FILL)]).all()
    assert np.abs(block.values - made.reflectance)[block.valid][:, elm.usable].max() <= 0.5 / SCALE * (1 + 1e-9)
    assert "1 bands without a gain; 6 values of good bands beyond 3.2767" in note
    with rasterio.open(path) as dataset:
        assert dataset.nodata == NO_DATA
        if form == "cog":
            assert dataset.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert dataset.units == ("1",) * BANDS
            assert "bad band" in dataset.descriptions[3]
    expected = {"envi": ["r.hdr", "r.img"], "cog": ["r.tif"]}[form]
    assert sorted(p.name for p in path.parent.iterdir()) == expected
    assert path.read_bytes() == write_reflectance(tmp_path / "again", "r", cube, elm, form)[0].read_bytes()


@pytest.mark.parametrize("form", ["envi", "cog"])
def test_a_pass_that_breaks_off_leaves_nothing(measured, tmp_path, monkeypatch, form):
    _, cube, elm = measured
    read, calls = type(cube).read, []

    def failing(self, first, count, *options):
        calls.append(first)
        if first + count >= LINES:
            raise KeyboardInterrupt
        return read(self, first, count, *options)

    monkeypatch.setattr(type(cube), "read", failing)
    with pytest.raises(KeyboardInterrupt):
        write_reflectance(tmp_path / "out", "r", cube, elm, form)
    assert calls
    assert list((tmp_path / "out").iterdir()) == []


def test_a_rotated_grid_keeps_its_own_words(measured, tmp_path):
    _, cube, elm = measured
    header = cube.raster.header.path
    text = header.read_text()
    turned = text.replace("WGS-84, units=Meters", "WGS-84, units=Meters, rotation=12.5")
    assert turned != text
    header.write_text(turned)
    cube = open_cube(cube.raster.path, quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    for form in ("envi", "cog"):
        found = open_cube(write_reflectance(tmp_path / form, "r", cube, elm, form)[0], quantity="reflectance")
        assert found.transform.almost_equals(cube.transform, 1e-6)
        assert found.transform.b != 0


def test_no_line_or_no_radiance_is_refused(measured, world, tmp_path):
    _, cube, elm = measured
    with pytest.raises(UsageError, match="empirical line"):
        write_reflectance(tmp_path, "r", cube, None, "envi")
    path, _ = write_reflectance(tmp_path, "r", cube, elm, "envi")
    with pytest.raises(UsageError, match="needs radiance"):
        write_reflectance(tmp_path, "again", open_cube(path, quantity="reflectance"), elm, "cog")


def test_the_command_writes_it_and_refuses_a_campaign_without_a_line(small, tmp_path, capsys):
    out, other = tmp_path / "out", tmp_path / "other"
    assert cli.run(["-q", "observe", str(small.write()), "-o", str(out), "--write-reflectance", "envi"]) == 0
    assert {p.name for p in (out / "reflectance").iterdir()} == {"reflectance.img", "reflectance.hdr"}
    found = open_cube(out / "reflectance" / "reflectance.img", quantity="reflectance")
    assert 0.0 < np.nanmean(found.read(0, 5).values) < 0.8
    assert "reflectance.img: reflectance by the empirical line" in (out / "report.html").read_text()
    del small.data["collection"]["empirical_line"]
    assert cli.run(["-q", "observe", str(small.write()), "-o", str(other), "--write-reflectance", "cog"]) == 2
    assert "there is no empirical line" in capsys.readouterr().err
    assert not other.exists()


@pytest.mark.parametrize("lost", [[], [7, 31, 37]])
def test_what_a_bad_band_holds_decides_nothing(make_radiance, monkeypatch, lost):
    """Neither numbers of another kind nor pixels without data, where opening does not sample the image."""
    monkeypatch.setattr("hyperval.imagery.description._SEEN_SAMPLES", 8)
    made, good = make_radiance(relative_noise=0.01), np.arange(BANDS) != 3
    world = made.more_panels(0.03, grey=0.33, light=0.40)
    world.collection["empirical_line"]["darkest_pixel"] = {"radiance_noise": 0.3}
    spoilt = world.values * np.where(good, 1.0, np.random.default_rng(1).uniform(0.8, 1.2, (LINES, 40, 1)))
    spoilt[49, 0, 3], spoilt[1, lost, 3] = -50.0, np.nan
    sides, axis = [], SpectralAxis(AXIS.centre_nm, AXIS.fwhm_nm, good)
    for values in (world.values, spoilt):
        world.write(values, axis=axis)
        seen = world.observe()
        spectra, line = seen.observation.radiance | seen.observation.reflectance, seen.place.line
        sides.append([line.birge_factor, seen.place.with_injected_error({"offset": 0.1}).cube.offset[0]])
        sides[-1] += [x for s in spectra.values() for x in (s.n, s.mean[good], s.error_covariance[good][:, good])]
        sides[-1] += [x for s in seen.observation.scores.values() for x in (s.n, s.mean, s.sd)]
    for clean, found in zip(*sides, strict=True):
        assert found == pytest.approx(clean, rel=1e-9)

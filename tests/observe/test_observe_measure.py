"""Means and covariances of regions, the empirical line, calibration error, SNR and collected site spectra."""

from __future__ import annotations

import re

import numpy as np
import pytest
from small_world import AXIS, BANDS, PLANTED, SAMPLES, World

from hyperval.collection import CalibrationUncertainty, CollectionSection
from hyperval.errors import InputError, UsageError
from hyperval.observe import calibration_covariance, detector_covariance, observe, spectral_estimate
from hyperval.pixels import factor_covariance, small_sample_factor
from hyperval.sensor.specification import load_sensor


def test_mean_and_covariance_of_a_region_equal_numpy(world):
    seen = world.observe()
    pixels = world.values[35:45, 5:25].reshape(-1, BANDS)
    corner = seen.observation.reflectance["corner"]
    covariance = np.cov(pixels, rowvar=False)
    assert corner.mean == pytest.approx(pixels.mean(axis=0), rel=1e-12)
    assert corner.pixel_covariance == pytest.approx(covariance, rel=1e-9, abs=1e-16)
    widened = small_sample_factor(200.0) / 200
    assert corner.error_covariance == pytest.approx(covariance * widened, rel=1e-9, abs=1e-18)
    assert set(corner.budget) == {"sampling"}
    assert corner.n == 200
    # Pixels that are independent of each other: n - 1 degrees of freedom behind the error.
    (part,) = corner.estimated
    assert part.dof == pytest.approx(199, rel=0.02)
    # A test widens by these degrees of freedom, and gets the covariance without the widening.
    assert part.model == pytest.approx(covariance / 200, rel=1e-9, abs=1e-18)
    # Four pixels alike are fewer independent ones, behind the error as behind the samples' own covariance.
    world.write(world.values[::2, ::2].repeat(2, axis=0).repeat(2, axis=1))
    (part,) = world.observe().observation.reflectance["corner"].estimated
    assert part.dof == pytest.approx(part.sample_dof)
    assert part.dof < 120
    assert seen.observation.radiance == {}
    handed = seen.statistics["corner"]
    assert (handed.mean, handed.n) == (pytest.approx(pixels.mean(axis=0)), 200)


def test_the_mean_of_fewer_pixels_than_bands_has_an_error_in_every_direction(world):
    world.collection["regions"] = [{"name": "few", "rectangle": [40, 5, 2, 3]}]
    few = world.observe().observation.reflectance["few"]
    expected, dof = factor_covariance(np.cov(world.values[40:42, 5:8].reshape(-1, BANDS), rowvar=False), 6)
    assert few.error_covariance == pytest.approx(expected / 6, rel=1e-9, abs=1e-18)
    assert np.linalg.matrix_rank(few.error_covariance) == BANDS
    (part,) = few.estimated
    assert part.dof == pytest.approx(dof)
    sample = np.cov(world.values[40:42, 5:8].reshape(-1, BANDS), rowvar=False)
    assert part.sample == pytest.approx(sample / 6, rel=1e-9, abs=1e-18)
    assert part.sample_dof == 5


def test_a_region_keeps_clear_of_targets_unless_nothing_is_left(world):
    world.collection["regions"] = [
        {"name": "around", "rectangle": [8, 8, 5, 5]},
        {"name": "on it", "rectangle": [9, 9, 1, 3]},
        {"name": "inside", "rectangle": [10, 9, 1, 3]},
    ]
    reflectance = world.observe().observation.reflectance
    assert reflectance["around"].n == 25 - 5
    assert reflectance["on it"].n == 2  # the corners of the ring are free
    assert reflectance["inside"].n == 3  # all of it is target and ring: taken as drawn
    assert reflectance["inside"].mean[0] == pytest.approx(world.values[10, 9:12, 0].mean())


def test_without_detection_there_are_only_spectra(world):
    world.detection = None
    seen = world.observe()
    assert seen.detected is None
    assert set(seen.observation.reflectance) == {"corner"}
    assert seen.observation.roc == {}
    assert seen.observation.provenance["quantity"] == "reflectance"


def test_a_table_of_bands_stands_for_a_header_without_wavelengths(world):
    world.detection = None
    header = world.folder / "cube.hdr"
    header.write_text(re.sub(r"(wavelength|fwhm|bbl)[a-z ]*= (\{[^}]*\}|.*)\n", "", header.read_text()))
    with pytest.raises(InputError, match=r"collection\.bands"):
        world.observe()
    rows = [f"{1e-3 * c:.4f} {1e-3 * w:.4f}" for c, w in zip(AXIS.centre_nm, AXIS.fwhm_nm, strict=True)]
    world.text("bands.txt", "\n".join(["# centre width", *rows]) + "\n")
    world.collection["bands"] = {"path": "bands.txt", "wavelength_unit": "um", "fwhm_column": 1}
    axis = world.observe().observation.axis
    assert axis.centre_nm == pytest.approx(AXIS.centre_nm)
    assert axis.fwhm_nm == pytest.approx(AXIS.fwhm_nm)


def test_a_single_pixel_has_a_spectrum_without_sampling_error_and_gives_no_spread(make_radiance):
    made = make_radiance()
    made.world.collection["regions"].append({"name": "dot", "rectangle": [4, 7, 1, 1]})
    made.world.collection["calibration"] = {"relative": 0.03}
    seen = made.world.observe()
    dot = seen.observation.radiance["dot"]
    assert dot.mean == pytest.approx(made.world.values[4, 7], rel=1e-12)
    assert (dot.n, set(dot.budget), dot.pixel_covariance) == (1, {"calibration"}, None)
    assert set(seen.observation.reflectance["dot"].budget) == {"empirical line"}
    assert seen.statistics["dot"].n == 1  # a mean; sources of a scenario refuse its spread
    assert "corner" in seen.statistics
    assert any("region 'dot' is a single pixel" in note for note in seen.observation.notes)


def test_the_empirical_line_recovers_gain_offset_and_reflectance(make_radiance):
    made = make_radiance()
    seen = made.world.observe()
    assert seen.elm.gain == pytest.approx(made.gain, rel=1e-9)
    assert seen.elm.offset == pytest.approx(made.offset, rel=1e-8)
    pixels = made.reflectance[35:45, 5:25].reshape(-1, BANDS)
    corner = seen.observation.reflectance["corner"]
    assert corner.mean == pytest.approx(pixels.mean(axis=0), rel=1e-9)
    assert corner.pixel_covariance == pytest.approx(np.cov(pixels, rowvar=False), rel=1e-6, abs=1e-14)
    radiance = seen.observation.radiance["corner"]
    assert radiance.mean == pytest.approx(made.offset + made.gain * pixels.mean(axis=0), rel=1e-12)
    assert "empirical line through white, black: usable in 8 bands" in seen.observation.notes


def test_scores_on_radiance_are_those_of_the_reflectance(make_radiance):
    made = make_radiance()
    scores = made.world.observe().detected.score_maps["paint-cem"]
    target = made.world.on_bands("library.csv", "paint")
    keep = np.ones(scores.shape, bool)
    keep[0:4, 30:34] = keep[0:4, 36:40] = False
    for line, sample in PLANTED:
        for dl, ds in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            keep[line + dl, sample + ds] = False
    pixels = made.reflectance[keep]
    d = target - pixels.mean(axis=0)
    w = np.linalg.solve(np.cov(pixels, rowvar=False), d)
    expected = (made.reflectance - pixels.mean(axis=0)) @ w / (d @ w)
    assert scores == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_the_line_s_error_is_part_of_the_reflectance(make_radiance):
    made = make_radiance(relative_noise=0.02)
    seen = made.world.observe()
    corner = seen.observation.reflectance["corner"]
    assert set(corner.budget) == {"sampling", "empirical line"}
    total = np.hypot(corner.budget["sampling"], corner.budget["empirical line"])
    assert corner.standard_uncertainty == pytest.approx(total, rel=1e-12)
    # 16 pixels at 2 %: the gain's relative error is about 0.5 % of the white panel's level.
    white = made.offset + 0.6 * made.gain
    gain_error = np.sqrt(seen.elm.covariance[:, 0, 0])
    assert gain_error == pytest.approx(0.02 * white / 4 / 0.55, rel=0.6)
    # Eight bands, errors independent between them: |z| above 4 has probability 5e-4 for all together.
    truth = made.reflectance[35:45, 5:25].reshape(-1, BANDS).mean(axis=0)
    assert np.abs((corner.mean - truth) / corner.standard_uncertainty).max() < 4.0


def test_the_line_s_error_is_known_by_the_pixels_of_its_panels(make_radiance):
    made = make_radiance(relative_noise=0.02)
    corner = made.world.observe().observation.reflectance["corner"]
    _, *of_panels = corner.estimated  # the first is of its own pixels
    assert len(of_panels) == len(made.world.collection["empirical_line"]["panels"])
    error = corner.budget["empirical line"] ** 2
    sampled = sum(np.diag(part.covariance) for part in of_panels)
    assert np.all(sampled > 0.0)
    assert np.all(sampled <= error * (1.0 + 1e-9))  # the rest is of the panels' field spectra


def test_a_panel_that_contradicts_the_others_shows_in_the_residuals(make_radiance):
    made = make_radiance(relative_noise=0.002)
    panels = made.world.collection["empirical_line"]["panels"]
    made.world.collection["regions"].append({"name": "grey", "rectangle": [36, 6, 8, 8]})
    panels.append({"region": "grey", "spectrum": {"constant": 0.9}})
    line = made.world.observe().elm
    assert line.names == ("white", "black", "grey")
    assert np.all(line.reduced_chi2 > 100.0)
    assert np.abs(line.leave_one_out[2]) == pytest.approx(
        np.abs(made.reflectance[36:44, 6:14].mean(axis=(0, 1)) - 0.9), abs=0.02
    )


def test_a_stated_panel_uncertainty_widens_the_line(make_radiance):
    made = make_radiance(relative_noise=0.002)
    narrow = made.world.observe().elm
    for panel in made.world.collection["empirical_line"]["panels"]:
        panel["relative_uncertainty"] = 0.02
    wide = made.world.observe().elm
    # 2 % of 0.6 against a contrast of 0.55: 2.2 % of the gain.
    assert np.sqrt(wide.covariance[:, 0, 0]) / wide.gain == pytest.approx(np.hypot(0.012, 0.001) / 0.55, rel=0.1)
    assert np.all(wide.covariance[:, 0, 0] > narrow.covariance[:, 0, 0])


def test_detection_on_radiance_needs_a_line(make_radiance):
    world = make_radiance().world
    del world.collection["empirical_line"]
    with pytest.raises(UsageError, match="detection on radiance needs an empirical line") as caught:
        world.observe()
    assert "add collection.empirical_line with two panels" in str(caught.value)
    world.detection = None
    seen = world.observe()
    assert seen.observation.reflectance == {}
    assert seen.statistics == {}  # no reflectance, no statistics to hand on
    assert set(seen.observation.radiance) == {"corner", "white", "black"}


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda p: p[0].update(region="grey"), UsageError, "empirical line: no region 'grey'"),
        (lambda p: p[1].update(region="white"), UsageError, "the gain is below 5 times"),
        (lambda p: p[0]["spectrum"].update(record="grey"), UsageError, "no record 'grey'"),
        (lambda p: p[0]["spectrum"].update(file="no.csv"), InputError, "no such"),
        (lambda p: p[1].update(spectrum=p[0]["spectrum"]), UsageError, "differ by 0 in reflectance"),
    ],
)
def test_panels_that_cannot_fix_a_line(make_radiance, change, error, message):
    world = make_radiance().world
    change(world.collection["empirical_line"]["panels"])
    with pytest.raises(error, match=message):
        world.observe()


def test_calibration_of_all_bands_together():
    level = np.linspace(10.0, 1.0, BANDS)
    found = calibration_covariance(level, AXIS, CalibrationUncertainty(relative=0.03), lambda r: r)
    assert found == pytest.approx(np.outer(0.03 * level, 0.03 * level))
    assert np.linalg.matrix_rank(found) == 1


def test_calibration_with_a_correlation_length_and_from_a_table(tmp_path):
    path = tmp_path / "error.txt"
    path.write_text("400 0.04\n1000 0.01\n1400 0.01\n")
    given = CalibrationUncertainty(file="error.txt", correlation_nm=50.0)
    found = calibration_covariance(np.full(BANDS, 2.0), AXIS, given, lambda r: tmp_path / r)
    w = AXIS.centre_nm
    relative = np.interp(w, [400, 1000, 1400], [0.04, 0.01, 0.01])  # 1650 nm takes the last value
    gap = w[:, None] - w[None, :]
    assert found == pytest.approx(np.outer(2 * relative, 2 * relative) * np.exp(-0.5 * (gap / 50.0) ** 2))
    assert np.sqrt(found[7, 7]) == pytest.approx(0.02)


def test_errors_stated_band_by_band_are_independent_and_an_uncorrelated_part_adds_to_each(tmp_path):
    (tmp_path / "error.txt").write_text("400 0.04\n1000 0.01\n1400 0.01\n")
    level = np.linspace(10.0, 1.0, BANDS)
    relative = np.interp(AXIS.centre_nm, [400, 1000, 1400], [0.04, 0.01, 0.01])
    by_band = CalibrationUncertainty(file="error.txt", uncorrelated=0.02)
    found = calibration_covariance(level, AXIS, by_band, lambda r: tmp_path / r)
    assert found == pytest.approx(np.diag((relative**2 + 0.02**2) * level**2))
    common = calibration_covariance(level, AXIS, CalibrationUncertainty(relative=0.03, uncorrelated=0.01), lambda r: r)
    assert common[0, 1] == pytest.approx(0.03**2 * level[0] * level[1])
    assert common[0, 0] == pytest.approx((0.03**2 + 0.01**2) * level[0] ** 2)


def test_noise_of_the_detector_goes_with_the_pixels_averaged():
    sensor = load_sensor("aviris-ng")
    level = np.full(BANDS, 5.0)
    one, many = (detector_covariance(level, AXIS, sensor, n) for n in (1, 100))
    assert many * 100 == pytest.approx(one)
    a, b, c = (x[3] for x in sensor.noise(AXIS).measured)
    assert np.sqrt(one[3, 3]) == pytest.approx(abs(a * np.sqrt(b + 5.0) + c))
    with pytest.raises(ValueError, match="each of which states its pixels"):
        CollectionSection(spectra=[{"subject": "a", "path": "a.txt"}], detector="aviris-ng")


def test_calibration_stands_in_the_budget_of_the_radiance(make_radiance):
    made = make_radiance()
    made.world.collection["calibration"] = {"relative": 0.05}
    corner = made.world.observe().observation.radiance["corner"]
    assert corner.budget["calibration"] == pytest.approx(0.05 * corner.mean)
    assert corner.standard_uncertainty == pytest.approx(
        np.hypot(corner.budget["calibration"], corner.budget["sampling"])
    )


def test_parts_of_an_estimate_add_up():
    a, b = np.diag([1.0, 4.0]), np.array([[4.0, 2.0], [2.0, 1.0]])
    estimate = spectral_estimate([1.0, 2.0], {"a": a, "b": b}, n=3)
    assert estimate.error_covariance == pytest.approx(a + b)
    assert estimate.budget["a"] == pytest.approx([1.0, 2.0])
    assert spectral_estimate([1.0, 2.0], {}).standard_uncertainty == pytest.approx([0.0, 0.0])


def test_snr_of_a_region_whose_noise_is_known(make_radiance):
    # Flat panel of 16 x 40 pixels with 1 % noise and no texture: SNR 100 in every band.
    made = make_radiance()
    noise = np.random.default_rng(3).standard_normal((16, SAMPLES, BANDS))
    values = made.world.values.copy()
    values[34:50] = 30.0 * (1.0 + 0.01 * noise)
    made.world.write(values)
    made.world.collection["regions"].append({"name": "flat", "rectangle": [34, 0, 16, SAMPLES]})
    made.world.collection["snr_regions"] = ["flat"]
    found = made.world.observe().observation.snr
    assert set(found) == {"flat"}
    # 637 degrees of freedom: the noise is known to 2.8 %; 12 % is more than 4 sigma for each of 8 bands.
    assert found["flat"].mean == pytest.approx(np.full(BANDS, 100.0), rel=0.12)
    assert found["flat"].n == 640


def test_snr_of_an_unknown_region(world):
    world.collection["snr_regions"] = ["nowhere"]
    with pytest.raises(UsageError, match="no region 'nowhere'"):
        world.observe()


def test_a_large_region_is_thinned_for_its_snr(world, monkeypatch):
    monkeypatch.setattr("hyperval.observe.pipeline.MAX_SNR_PIXELS", 70)
    world.collection["snr_regions"] = ["corner"]
    assert world.observe().observation.snr["corner"].n == 67  # every third of 200


@pytest.fixture
def sites(tmp_path) -> World:
    """Two collected spectra with a band table in um."""
    made = World(tmp_path, np.empty(0))
    radiance = np.linspace(12.0, 1.0, BANDS)
    made.text("bands.txt", "# number centre width\n" + "".join(
        f"{i} {w / 1000:.4f} 0.0058\n" for i, w in enumerate(AXIS.centre_nm)
    ))  # fmt: skip
    made.text("lawn.txt", "".join(f"{w} {v}\n" for w, v in zip(AXIS.centre_nm, radiance, strict=True)))
    made.collection = {
        "spectra": [{"subject": "lawn", "path": "lawn.txt", "pixels": 9}],
        "bands": {"path": "bands.txt", "wavelength_unit": "um", "centre_column": 1, "fwhm_column": 2},
        "calibration": {"relative": 0.02},
    }
    return made


def test_collected_spectra_become_radiance(sites):
    observation = sites.observe().observation
    lawn = observation.radiance["lawn"]
    assert observation.axis.centre_nm == pytest.approx(AXIS.centre_nm)
    assert observation.axis.fwhm_nm == pytest.approx(5.8)
    assert lawn.mean == pytest.approx(np.linspace(12.0, 1.0, BANDS))
    assert lawn.n == 9
    assert lawn.standard_uncertainty == pytest.approx(0.02 * lawn.mean)
    assert lawn.pixel_covariance is None


def test_collected_spectra_in_another_unit(sites):
    sites.collection["spectra"][0]["unit"] = "W m-2 sr-1 um-1"
    assert sites.observe().observation.radiance["lawn"].mean[0] == pytest.approx(1.2)


def test_a_field_spectrometers_radiance_is_averaged_over_the_bands(sites):
    grid = np.arange(400.0, 1701.0, 1.0)
    rows = "".join(f"{w:g}\t{0.1 - 2e-5 * (w - 400):.8f}\n" for w in grid)
    sites.text("lawn.txt", "Wavelength (nm)\tRadiance (W/m^2/sr/nm)\n" + rows)
    observation = sites.observe().observation
    # A straight line keeps its value at the centre of a symmetric band; 1 W m-2 is 100 uW cm-2.
    assert observation.radiance["lawn"].mean == pytest.approx(10.0 - 2e-3 * (AXIS.centre_nm - 400), rel=1e-6)
    assert "lawn: 1301 samples averaged over the 8 bands" in observation.notes
    sites.text("lawn.txt", "Wavelength (nm)\tRadiance (W/m^2/sr/nm)\n" + "".join(rows.splitlines(True)[60:]))
    with pytest.raises(InputError, match=r"lawn\.txt: 1241 wavelengths that are not those of the band table"):
        sites.observe()
    sites.collection["spectra"][0]["unit"] = "uW cm-2 sr-1 nm-1"
    sites.text("lawn.txt", "Wavelength (nm)\tRadiance (W/m^2/sr/nm)\n" + rows)
    with pytest.raises(UsageError, match="the file states radiance in W m-2 sr-1 nm-1"):
        sites.observe()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "lawn.txt",
            "450 1\n550 2\n",
            r"lawn\.txt: 2 wavelengths that are not those of the band table \(8 bands\)",
        ),
        ("lawn.txt", None, "no such"),
        ("bands.txt", None, "no such"),
        ("bands.txt", "1 0.450 0.005\n2 0.55 x\n", r"bands\.txt:2: not a row of numbers"),
        ("bands.txt", "1 0.450 0.005\n2 0.55\n", r"bands\.txt:2: 2 columns"),
        ("bands.txt", "# nothing\n", r"bands\.txt: holds no band"),
        ("bands.txt", "1 0.55 0.005\n2 0.45 0.005\n", r"bands\.txt: not a table of bands: .*increas"),
        ("bands.txt", "1 0.45 0\n2 0.55 0.005\n", r"bands\.txt: not a table of bands"),
        ("bands.txt", "1 nan 0.005\n2 0.55 0.005\n", r"bands\.txt: not a table of bands"),
    ],
)
def test_collected_spectra_with_bad_files(sites, name, content, message):
    (sites.folder / name).unlink()
    if content is not None:
        sites.text(name, content)
    elif name == "bands.txt":
        sites.collection["bands"]["path"] = "gone.txt"
    with pytest.raises(InputError, match=message):
        _checked(sites)


def _checked(world: World):
    """Observe through the check of file references that a campaign makes."""
    from hyperval import datasets

    collection = CollectionSection.model_validate(world.collection)
    return observe(collection, None, lambda r: datasets.resolve(r, world.folder), show_progress=False)


def test_spectra_without_a_band_table_are_refused(sites):
    with pytest.raises(ValueError, match="spectra need 'bands'"):
        CollectionSection.model_validate({k: v for k, v in sites.collection.items() if k != "bands"})


def test_replicate_spectra_of_a_panel_widen_the_empirical_line(make_radiance):
    """Three readings that differ by 5 %: their standard error by Student's t is that of the panel."""
    made = make_radiance(relative_noise=0.001)
    world = made.world
    for i, level in enumerate((0.57, 0.60, 0.63)):
        rows = "".join(f"{w},{level}\n" for w in range(400, 1701))
        world.text(f"white{i}.csv", "wavelength_nm,white\n" + rows)
    before = world.observe().observation.reflectance["corner"].budget["empirical line"]
    panel = world.collection["empirical_line"]["panels"][0]
    assert panel["region"] == "white"
    panel["spectrum"] = {"replicates": {"files": "white?.csv", "wavelength_unit": "nm"}}
    after = world.observe().observation.reflectance["corner"].budget["empirical line"]
    assert np.all(after > before)

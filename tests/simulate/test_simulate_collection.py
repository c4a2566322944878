"""The written collection: same bytes for the same seed, readable by others, its truth in step with its pixels."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import rasterio
import spectral
import yaml
from small_scene import area, scene_data, small_scene

from hyperval.errors import UsageError
from hyperval.imagery import open_cube, read_regions, read_targets
from hyperval.simulate import (
    SimulationInputs,
    SurfaceRenderer,
    detector,
    field_axis,
    lay_out,
    regions,
    simulate,
    simulate_to_folder,
)  # fmt: skip
from hyperval.spectra import read_spectrum
from hyperval.statistics_library import builtin_class
from hyperval.storage import sha256_of


def stored(found) -> np.ndarray:
    """(lines, samples, bands) integers straight from the bytes."""
    return np.fromfile(found.cube, "<i2").reshape(60, 12, 48).transpose(0, 2, 1)


def test_the_same_seed_gives_the_same_bytes_whatever_the_workers(scene, inputs, tmp_path, monkeypatch):
    first = simulate(scene, tmp_path / "a", inputs=inputs)
    again = simulate(scene, tmp_path / "b", inputs=inputs)
    monkeypatch.setattr("hyperval.simulate.collection.WORKERS", 1)
    alone = simulate(scene, tmp_path / "c", inputs=inputs)
    for path in sorted(first.folder.iterdir()):
        for other in (again, alone):
            assert sha256_of(path) == sha256_of(other.folder / path.name), path.name
    another = simulate(small_scene(seed=2), tmp_path / "d", inputs=inputs)
    assert np.mean(stored(first) == stored(another)) < 0.05


def test_spectral_python_and_rasterio_read_the_cube(scene, inputs, tmp_path):
    found = simulate(scene, tmp_path / "a", inputs=inputs)
    values = stored(found)
    image = spectral.open_image(str(found.cube.with_suffix(".hdr")))
    assert image.shape == (60, 48, 12)
    assert np.array_equal(image.open_memmap(interleave="bip"), values)
    assert np.allclose(image.bands.centers, inputs.sensor.axis.centre_nm)
    assert np.allclose(image.bands.bandwidths, inputs.sensor.axis.fwhm_nm)
    assert image.metadata["description"].startswith("SIMULATED")
    assert {int(b) for b in image.metadata["bbl"]} == {1}
    assert {float(g) for g in image.metadata["data gain values"]} == {0.001}
    with rasterio.open(found.cube) as data:
        assert np.array_equal(data.read().transpose(1, 2, 0), values)
        assert data.crs.to_epsg() == 32618
        assert data.transform.to_gdal() == (275400.0, 2.0, 0.0, 4753700.0, 0.0, -2.0)


def test_the_own_readers_take_the_collection_as_it_is(scene, inputs, tmp_path):
    found = simulate(scene, tmp_path / "a", inputs=inputs)
    cube = open_cube(found.cube, quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    assert cube.axis.matches(inputs.sensor.axis)
    lines, samples = np.array([5, 40]), np.array([3, 20])
    assert np.allclose(cube.pixels((lines, samples)), stored(found)[lines, samples] * 1e-3)
    read = read_regions(found.regions, cube.shape, coordinates="pixel")
    masks = {name: region.mask for name, region in read.items()}
    assert set(masks) == {"white", "grass-field", "court"}
    assert masks["white"].sum() == 36
    ground = lay_out(scene)
    for name, mask in regions(scene, ground).items():
        assert np.array_equal(masks[name], mask)
    targets = read_targets(found.targets, (60, 48), pixel_size_m=2.0)
    assert len(targets) == 6
    for target in targets:
        assert target.mask.sum() == 1  # these planks are smaller than a pixel and centred
        assert ground.fill[target.mask] == pytest.approx(0.3, abs=1e-6)


def test_the_list_of_targets_names_the_brightest_pixel(scene, inputs, tmp_path):
    found = simulate(scene, tmp_path / "a", inputs=inputs)
    table = pd.read_csv(found.targets)
    assert set(table["nominal_fill"]) == {0.3}
    fill = np.fromfile(found.fill_map, "<f4").reshape(60, 48)
    assert np.allclose(fill[table["best_line"], table["best_sample"]], table["best_fill"], atol=1e-6)
    assert np.allclose(table["side_m"] ** 2, table["area_m2"], atol=1e-5)
    # The sum of fills times the pixel area is the area of all planks, but for what is under 1e-4 of a pixel.
    assert fill.sum() * 4.0 == pytest.approx(table["area_m2"].sum(), abs=6 * 24 * 1e-4 * 4.0)
    classes = np.fromfile(found.class_map, np.uint8).reshape(60, 48)
    names = json.loads(found.truth.read_text())["surfaces"]
    assert {names[str(v)] for v in np.unique(classes)} == {"grass", "asphalt", "white-panel"}
    assert np.all(classes[30:] == next(int(k) for k, v in names.items() if v == "asphalt"))


def test_regions_have_the_radiance_of_their_mean_reflectance(scene, inputs, tmp_path):
    found = simulate(scene, tmp_path / "a", inputs=inputs)
    cube = stored(found) * 1e-3
    chain = detector(inputs, found.average_reflectance, 1000.0)
    for name, mask in regions(scene, lay_out(scene)).items():
        surface = {"white": "white-panel", "grass-field": "grass", "court": "asphalt"}[name]
        expected = chain.radiance(inputs.classes[surface].mean[None].astype(np.float32))[0]
        pixels = cube[mask]
        # 6 standard errors (12 bands x 3 regions: fails by chance less than once in 10 million).
        assert np.all(np.abs(pixels.mean(axis=0) - expected) < 6 * pixels.std(axis=0) / math.sqrt(mask.sum()))


def test_the_average_is_that_of_the_rendered_scene(scene, inputs, tmp_path):
    renderer = SurfaceRenderer(scene, lay_out(scene), inputs.classes)
    every = np.stack([renderer.lit_reflectance(line) for line in range(60)]).astype(float)
    facts = json.loads(simulate(scene, tmp_path / "a", inputs=inputs).truth.read_text())
    assert np.allclose(facts["average_reflectance"], every.mean(axis=(0, 1)), rtol=1e-9)
    assert facts["negative_reflectance_fraction"] == np.mean(every < 0)
    assert (facts["simulated"], facts["scene"]["seed"], facts["scene"]["mode"]) == (True, 7, "closure")
    assert facts["saturated_fraction"] == 0.0


def test_panel_spectra_are_those_of_the_panels_with_their_scatter(inputs, tmp_path):
    noisy = small_scene(field_spectra={"readings": 25, "relative_noise": 0.02})
    path = simulate(noisy, tmp_path / "a", inputs=inputs).panel_spectra
    table = pd.read_csv(path, comment="#")
    assert read_spectrum(path, wavelength_unit="nm", reflectance_unit="fraction").n == 25
    assert table["wavelength_nm"].iloc[[0, -1]].tolist() == [350.0, 2500.0]
    relative = table["white"] / builtin_class("white-panel", field_axis()).mean - 1.0
    # 5 standard errors of a standard deviation of 2151 values.
    assert relative.std() == pytest.approx(0.02 / 5, rel=5 / math.sqrt(2 * 2151))
    assert (table["white_sd"] / table["white"]).mean() == pytest.approx(0.02, rel=0.02)


def test_radiance_beyond_sixteen_bits_is_refused_and_leaves_no_cube(inputs, tmp_path):
    with pytest.raises(UsageError, match="lower counts_per_radiance"):
        simulate(small_scene(counts_per_radiance=5000.0), tmp_path / "a", inputs=inputs)
    assert not list((tmp_path / "a").glob("*.img"))


def test_a_scene_too_large_is_refused_before_anything_is_made(inputs, tmp_path):
    ground = [area("grass", [0, 20_000], [0, 20_000])]
    huge = small_scene(lines=20_000, samples=20_000, layout=ground, targets=[], regions=[])
    with pytest.raises(UsageError, match="too large"):
        simulate(huge, tmp_path / "a", inputs=inputs)
    assert not (tmp_path / "a").exists()


def test_inputs_on_other_bands_are_refused(inputs, classes):
    g = classes["grass"]
    few = replace(g, axis=g.axis.select(np.arange(3)), mean=g.mean[:3], covariance=g.covariance[:3, :3])
    with pytest.raises(UsageError, match="bands"):
        SimulationInputs(inputs.sensor, inputs.terms, {"grass": few})


def test_a_scene_file_becomes_a_folder_and_never_replaces_anything_else(inputs, tmp_path, monkeypatch):
    monkeypatch.setattr("hyperval.simulate.collection.load_inputs", lambda scene, beside: inputs)
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(scene_data()), encoding="utf-8")
    output = tmp_path / "out"
    assert simulate_to_folder(path, output) == 0
    before = sha256_of(output / "small_rad.img")
    assert simulate_to_folder(path, output) == 0  # an older simulation is replaced
    assert sha256_of(output / "small_rad.img") == before
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").write_text("years of work", encoding="utf-8")
    with pytest.raises(UsageError, match=r"files that no run wrote there: thesis\.txt"):
        simulate_to_folder(path, precious)
    assert (precious / "thesis.txt").read_text() == "years of work"

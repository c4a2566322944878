"""Scene files and the written collection: same bytes for the same seed, readable by others, its truth in step."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from small_scene import CLASSES, INPUTS, SCENE, area, planks, scene_data, small_scene

from hyperval import simulate
from hyperval.errors import UsageError
from hyperval.imagery import read_regions
from hyperval.spectra import read_spectrum
from hyperval.statistics_library import builtin_class
from hyperval.storage import sha256_of

TWIN = Path(__file__).parents[2] / "campaigns" / "share2012-twin"
MISTAKES = yaml.safe_load((Path(__file__).parent / "mistakes.yaml").read_text())


def stored(found) -> np.ndarray:
    """(lines, samples, bands) integers straight from the bytes."""
    return np.fromfile(found["cube"], "<i2").reshape(60, 12, 48).transpose(0, 2, 1)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The small scene as a collection."""
    return simulate.simulate(SCENE, tmp_path_factory.mktemp("small"), inputs=INPUTS)


def test_the_same_seed_gives_the_same_bytes_whatever_the_workers(found, tmp_path, monkeypatch):
    monkeypatch.setattr("hyperval.simulate.collection.WORKERS", 1)
    alone = simulate.simulate(SCENE, tmp_path / "a", inputs=INPUTS)
    for path in sorted(found["folder"].iterdir()):
        assert sha256_of(path) == sha256_of(alone["folder"] / path.name), path.name
    another = simulate.simulate(small_scene(seed=2), tmp_path / "b", inputs=INPUTS)
    assert np.mean(stored(found) == stored(another)) < 0.05


def test_the_list_of_targets_names_the_brightest_pixel(found):
    table = pd.read_csv(found["targets"])
    assert set(table["nominal_fill"]) == {0.3}
    fill = np.fromfile(found["fill_map"], "<f4").reshape(60, 48)
    assert np.allclose(fill[table["best_line"], table["best_sample"]], table["best_fill"], atol=1e-6)
    assert np.allclose(table["side_m"] ** 2, table["area_m2"], atol=1e-5)
    # The sum of fills times the pixel area is the area of all planks, but for what is under 1e-4 of a pixel.
    assert fill.sum() * 4.0 == pytest.approx(table["area_m2"].sum(), abs=6 * 24 * 1e-4 * 4.0)
    classes = np.fromfile(found["class_map"], np.uint8).reshape(60, 48)
    names = json.loads(found["truth"].read_text())["surfaces"]
    assert {names[str(v)] for v in np.unique(classes)} == {"grass", "asphalt", "white-panel"}
    assert np.all(classes[30:] == next(int(k) for k, v in names.items() if v == "asphalt"))


def test_regions_as_written_have_the_radiance_of_their_mean_reflectance(found):
    cube = stored(found) * 1e-3
    chain = simulate.detector(INPUTS, found["average_reflectance"], 1000.0)
    regions = read_regions(found["regions"], (60, 48), coordinates="pixel")
    for name, mask in simulate.regions(SCENE, simulate.lay_out(SCENE)).items():
        assert np.array_equal(regions.pop(name).mask, mask)
        surface = {"white": "white-panel", "grass-field": "grass", "court": "asphalt"}[name]
        expected = chain.radiance(CLASSES[surface].mean[None].astype(np.float32))[0]
        pixels = cube[mask]
        # 6 standard errors (12 bands x 3 regions: fails by chance less than once in 10 million).
        assert np.all(np.abs(pixels.mean(axis=0) - expected) < 6 * pixels.std(axis=0) / math.sqrt(mask.sum()))
    assert not regions


def test_the_average_is_that_of_the_rendered_scene(found):
    renderer = simulate.SurfaceRenderer(SCENE, simulate.lay_out(SCENE), CLASSES)
    every = np.stack([renderer.reflectance(line) for line in range(60)]).astype(float)
    facts = json.loads(found["truth"].read_text())
    assert np.allclose(facts["average_reflectance"], every.mean(axis=(0, 1)), rtol=1e-9)
    assert facts["negative_reflectance_fraction"] == np.mean(every < 0)
    assert (facts["simulated"], facts["scene"]["seed"], facts["saturated_fraction"]) == (True, 7, 0.0)


def test_panel_spectra_are_those_of_the_panels_with_their_scatter(tmp_path):
    noisy = small_scene(field_spectra={"readings": 25, "relative_noise": 0.02})
    path = simulate.simulate(noisy, tmp_path / "a", inputs=INPUTS)["panel_spectra"]
    table = pd.read_csv(path, comment="#")
    assert read_spectrum(path, wavelength_unit="nm", reflectance_unit="fraction").n == 25
    assert table["wavelength_nm"].iloc[[0, -1]].tolist() == [350.0, 2500.0]
    relative = table["white"] / builtin_class("white-panel", simulate.field_axis()).mean - 1.0
    # 5 standard errors of a standard deviation of 2151 values.
    assert relative.std() == pytest.approx(0.02 / 5, rel=5 / math.sqrt(2 * 2151))
    assert (table["white_sd"] / table["white"]).mean() == pytest.approx(0.02, rel=0.02)


def test_radiance_beyond_sixteen_bits_is_refused_and_leaves_no_cube(tmp_path):
    with pytest.raises(UsageError, match="lower counts_per_radiance"):
        simulate.simulate(small_scene(counts_per_radiance=5000.0), tmp_path / "a", inputs=INPUTS)
    assert not list((tmp_path / "a").glob("*.img"))


def test_a_scene_too_large_is_refused_before_anything_is_made(tmp_path):
    ground = [area("grass", [0, 20_000], [0, 20_000])]
    huge = small_scene(lines=20_000, samples=20_000, layout=ground, targets=[], regions=[])
    with pytest.raises(UsageError, match="too large"):
        simulate.simulate(huge, tmp_path / "a", inputs=INPUTS)
    assert not (tmp_path / "a").exists()


def test_averaged_readings_are_refused():
    with pytest.raises(UsageError, match="averaged readings"):
        replace(INPUTS, noise=replace(INPUTS.noise, readings=2.0))


def test_a_scene_file_becomes_a_folder_and_an_older_simulation_is_replaced(found, tmp_path, monkeypatch):
    monkeypatch.setattr("hyperval.simulate.collection.load_inputs", lambda scene, beside: INPUTS)
    (path := tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene_data()), encoding="utf-8")
    for _ in range(2):
        assert simulate.simulate_to_folder(path, tmp_path / "out") == 0
        assert sha256_of(tmp_path / "out" / "small_rad.img") == sha256_of(found["cube"])


def test_the_twin_scenes_are_as_large_as_they_should_be():
    """Their layout is that of every run of their campaigns."""
    for name in ("scene.yaml", "scene-broken.yaml"):
        scene = simulate.load_scene(TWIN / name)
        assert 2 * scene.lines * scene.samples * 360 <= 150e6
        assert all(group.count >= 60 for group in scene.targets)


@pytest.mark.parametrize("case", MISTAKES, ids=[case["words"] for case in MISTAKES])
def test_a_mistake_is_named_with_its_file_and_line(tmp_path, case):
    path = tmp_path / "scene.yaml"
    groups = [planks(**changes) for changes in case.get("planks", [])]
    changes = case["scene"] | ({"targets": groups} if groups else {})
    data = json.loads(json.dumps(scene_data(**changes)))  # no part twice: YAML would make it an anchor
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    with pytest.raises(UsageError, match=case["words"]) as error:
        simulate.regions(scene := simulate.load_scene(path), simulate.lay_out(scene))
    assert ("scene.yaml:" in str(error.value)) == case.get("in_file", True)
    assert error.value.exit_code == 2


def test_a_surface_that_is_none_is_told_before_the_engine_runs(tmp_path, monkeypatch):
    monkeypatch.setattr("hyperval.atmosphere.atmospheric_terms", None)  # would be called
    scene = simulate.load_scene(TWIN / "scene.yaml")
    painted = [scene.layout[0].model_copy(update={"surface": "gras"}), *scene.layout[1:]]
    with pytest.raises(UsageError, match="unknown built-in surface 'gras'"):
        simulate.load_inputs(scene.model_copy(update={"layout": painted}), tmp_path)

"""Fills of pixels by a finer image or by abundances: closed forms, and a scene simulated at a tenth of a pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from scipy.ndimage import gaussian_filter

from hyperval.campaign import job_of, run_campaign, with_fills_of_truth
from hyperval.collection import CollectionSection, Detection
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.model import TargetGeometry, fill_distribution, fills_of_objects, pixel_fills, pixels_of_object
from hyperval.observe import FinerGrid, fills_of, object_of_fills, open_place, registration_shifts, window_fills
from hyperval.scenario import Fill, Scenario
from hyperval.spectra import SIGMA_PER_FWHM

ONE_PLACE = np.zeros((1, 2))


@pytest.mark.parametrize("blur", [0.0, 0.8, (0.5, 1.1)])
def test_cells_that_make_a_rectangle_have_the_fills_of_its_geometry(blur):
    both = blur if isinstance(blur, tuple) else (blur, blur)
    length, width, offset = 1.6, 0.9, np.array([0.23, -0.11])  # pixels; (x, y) from the middle pixel's centre
    geometry = TargetGeometry(length, width, 1.0, 0.0, blur)
    expected = pixel_fills(geometry, offset[None], np.zeros(1))[0]
    half = expected.shape[0] // 2
    grid = FinerGrid(half + 0.5 + offset[1] - length / 2, half + 0.5 + offset[0] - width / 2, length / 16, width / 9)
    fills = window_fills(np.ones((16, 9), bool), grid, (0, 0), expected.shape, both, ONE_PLACE)
    np.testing.assert_allclose(fills[0], expected, atol=1e-9)
    assert fills.sum() == pytest.approx(length * width, rel=1e-6)


def test_pixels_of_a_target_are_those_whose_mean_fill_reaches_the_least():
    """Exactly the least fill belongs to it, the next lower number does not, whatever one drawn place has."""
    least = 0.25
    below = np.nextafter(least, 0.0)
    fills = np.array([[[0.0, 0.5, below], [0.0, least, 1.0]], [[0.0, 0.0, below], [0.0, least, 0.0]]])
    target = object_of_fills("p", "plank", fills, (4, 7), (9, 11), 3.0, least, "there")
    np.testing.assert_array_equal(target.part, [[True, False], [True, True]])
    assert target.corner == (4, 8)
    assert (target.shape, target.area_m2) == ((9, 11), 3.0)
    np.testing.assert_array_equal(target.fills, fills[:, :, 1:])
    assert fills_of({"planks": [target]}) == {"planks": [[1.0, 0.5, 0.25], [0.25, 0.0, 0.0]]}
    with pytest.raises(InputError, match=r"no pixel of 'p' is filled by 0\.9"):
        object_of_fills("p", "plank", fills, (4, 7), (9, 11), 3.0, 0.9, "there")


def scene_of_a_tenth() -> np.ndarray:
    """Two planks that lie aslant, on cells of a tenth of a pixel of a cube of 12 x 10 pixels."""
    y, x = (np.indices((120, 100)) + 0.5) / 10.0
    out = np.zeros((120, 100), np.uint8)
    for value, (cy, cx, angle, a, b) in ((1, (4.2, 3.7, 30.0, 2.6, 0.8)), (2, (8.3, 6.1, -20.0, 1.0, 1.0))):
        c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        along, across = (y - cy) * c + (x - cx) * s, (x - cx) * c - (y - cy) * s
        out[(np.abs(along) < a / 2) & (np.abs(across) < b / 2)] = value
    return out


@pytest.mark.parametrize("fwhm", [0.0, 0.7, 1.2])
def test_a_scene_simulated_at_a_tenth_of_a_pixel_and_aggregated(fwhm: float):
    mask = scene_of_a_tenth() == 1
    # Sampled at centres of cells, kernel and aperture each lack a cell's own width, whose variance is a twelfth.
    sigma = float(np.hypot(10.0 * fwhm * SIGMA_PER_FWHM, np.sqrt(2.0 / 12.0))) if fwhm else 0.0
    blurred = gaussian_filter(mask.astype(float), sigma, truncate=6.0)
    aggregated = blurred.reshape(12, 10, 10, 10).mean(axis=(1, 3))
    fills = window_fills(mask, FinerGrid(0.0, 0.0, 0.1, 0.1), (0, 0), (12, 10), (fwhm, fwhm), ONE_PLACE)[0]
    np.testing.assert_allclose(fills, aggregated, atol=2e-4)


def test_an_error_of_registration_widens_the_response_on_average():
    """A normal displacement averages to a wider Gaussian: variances add."""
    mask, sd, fwhm = scene_of_a_tenth() == 1, 0.3, 0.7
    shifts = registration_shifts(sd, 400)
    np.testing.assert_allclose(shifts.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(shifts.std(axis=0), sd, rtol=1e-12)
    wide = float(np.hypot(fwhm, sd / SIGMA_PER_FWHM))
    grid = FinerGrid(0.0, 0.0, 0.1, 0.1)
    mean = window_fills(mask, grid, (0, 0), (12, 10), (fwhm, fwhm), shifts).mean(axis=0)
    expected = window_fills(mask, grid, (0, 0), (12, 10), (wide, wide), ONE_PLACE)[0]
    np.testing.assert_allclose(mean, expected, atol=0.01)
    assert np.array_equal(registration_shifts(0.0), ONE_PLACE)


def envi(path: Path, values: np.ndarray, entries: str) -> None:
    """BIP of 64-bit numbers, the header under the name of the data file and .hdr: as DIRSIG writes its images."""
    lines, samples, bands = values.shape
    values.astype("<f8").tofile(path)
    path.with_name(path.name + ".hdr").write_text(
        f"ENVI\nsamples = {samples}\nlines = {lines}\nbands = {bands}\nheader offset = 0\n"
        f"file type = ENVI Standard\ndata type = 5\ninterleave = bip\nbyte order = 0\n{entries}"
    )


WAVES = "wavelength units = Micrometers\nwavelength = {0.45, 0.55, 0.65, 0.80, 1.00}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A cube of 12 x 10 pixels on the map with two planks, and its finer map of classes."""
    classes = scene_of_a_tenth()
    with rasterio.open(
        tmp_path / "finer.tif", "w", driver="GTiff", width=100, height=120, count=1, dtype="uint8",
        crs="EPSG:32618", transform=Affine(0.2, 0, 300_000, 0, -0.2, 4_500_000),
    ) as dataset:  # fmt: skip
        dataset.write(classes, 1)
    rng = np.random.default_rng(4)
    values = 0.2 + 0.01 * rng.standard_normal((12, 10, 5))
    position = "map info = {UTM, 1, 1, 300000, 4500000, 2, 2, 18, North, WGS-84, units=Meters}\n"
    envi(tmp_path / "cube.img", values, WAVES + position)
    return tmp_path


def collection(**finer) -> CollectionSection:
    truth = {"image": "finer.tif", "classes": {"plank": 1, "panel": 2}, "psf_fwhm_pixels": 0.7} | finer
    if not {"registration_m", "registration_pixels"} & truth.keys():
        truth["registration_m"] = 0.0
    return CollectionSection.model_validate(
        {"cube": {"path": "cube.img", "quantity": "reflectance"}, "targets": {"finer": truth}}
    )


def test_targets_of_a_finer_map_have_area_pixels_and_fills(folder: Path):
    place = open_place(collection(registration_m=0.4), lambda name: folder / name)
    plank, panel = place.targets
    assert (plank.material, panel.material) == ("plank", "panel")
    cells = [int((scene_of_a_tenth() == value).sum()) for value in (1, 2)]
    assert [t.area_m2 for t in place.targets] == pytest.approx([0.04 * n for n in cells])
    assert plank.fills.mean(axis=0)[plank.part].min() >= 0.02
    assert 4.0 * plank.fills.mean(axis=0).sum() == pytest.approx(plank.area_m2, rel=0.05)
    assert any("registration of 0.2 pixels makes" in note for note in place.notes)
    still = open_place(collection(), lambda name: folder / name).targets[0]
    stated = open_place(collection(corner=[0, 0], times_finer=10), lambda name: folder / name).targets[0]
    np.testing.assert_allclose(stated.fills, still.fills, atol=1e-6)
    picture = collection(classes={"panel": {"band": 1, "above": 1.5}})
    np.testing.assert_array_equal(
        open_place(picture, lambda name: folder / name).targets[0].part.shape,
        open_place(collection(), lambda name: folder / name).targets[1].part.shape,
    )


@pytest.mark.parametrize(
    ("finer", "words"),
    [
        ({"classes": {"plank": 7}}, "no cell of 'plank'"),
        ({"corner": [-4, 0], "times_finer": 10}, "'plank' leaves the image(?s:.*)check where the finer image lies"),
        ({"classes": {"plank": {"band": 3, "above": 1}}}, "no band 3"),
        ({"least_fill": 0.99, "registration_pixels": 2.0}, "no pixel of 'plank' is filled by 0.99"),
    ],
)
def test_finer_images_that_cannot_be_truth(folder: Path, finer: dict, words: str):
    with pytest.raises(InputError, match=words):
        open_place(collection(**finer), lambda name: folder / name)


def test_a_finer_image_that_lies_aslant_or_is_not_finer_is_refused(folder: Path):
    for transform, words in (
        (Affine(0.2, 0.02, 300_000, 0, -0.2, 4_500_000), "does not run along(?s:.*)gdalwarp"),
        (Affine(1.5, 0, 300_000, 0, -1.5, 4_500_000), "at most half a pixel"),
    ):
        with rasterio.open(folder / "finer.tif", "r+") as dataset:
            dataset.transform = transform
        with pytest.raises(InputError, match=words):
            open_place(collection(), lambda name: folder / name)


def scenario(fill: dict) -> Scenario:
    target = {"name": "plank", "host": "court", "spectrum": {"constant": 0.5}, "fill": fill}
    classes = [{"name": "court", "fraction": 1.0, "spectrum": {"constant": 0.2}, "covariance": {"relative_sd": 0.05}}]
    return Scenario.model_validate({"schema": 1, "name": "s", "scene": {"classes": classes, "targets": [target]}})


def test_a_scenario_takes_the_fills_of_the_truth(folder: Path):
    place = open_place(collection(registration_m=0.4), lambda name: folder / name)
    detection = Detection.model_validate(
        {"targets": [{"name": "plank", "material": "plank", "spectrum": {"constant": 0.5}}]}
    )
    (taken,) = with_fills_of_truth([scenario({"truth": True})], place, detection)
    fill = taken.scene.targets[0].fill
    plank = place.targets[0]
    assert fill_distribution(fill).mean == pytest.approx(plank.fills[:, plank.part].mean(), rel=1e-9)
    assert pixels_of_object(fill) == plank.part.sum()
    rows = fills_of_objects(fill)
    assert rows.shape == (len(plank.fills), plank.part.sum())
    assert np.all(np.diff(rows, axis=1) <= 0)
    untouched = scenario({"fixed": 0.4})
    assert with_fills_of_truth([untouched], place, detection) == [untouched]
    with pytest.raises(UsageError, match=r"does not tell the fills(?s:.*)state its fill"):
        with_fills_of_truth([scenario({"truth": True})], None, detection)
    with pytest.raises(UsageError, match="run it within that campaign"):
        fill_distribution(Fill(truth=True))


DIRSIG = """schema: 1
name: dirsig
title: "DIRSIG"
description: "d"
simulated: dirsig
collection:
  cube: {path: scene.img, quantity: radiance, unit: W cm-2 sr-1 um-1}
  regions:
    - {file: truth.img, band: "material*", classes: {grass: 3, asphalt: 12}}
  targets:
    abundances: {image: truth.img, materials: {panel: "*abundance*panel*"}}
    pixel_size_m: 2.0
  empirical_line:
    intercept: false
    panels: [{region: asphalt, spectrum: {constant: 0.1}}]
detection:
  targets: [{name: panel, material: panel, spectrum: {constant: 0.6}}]
  detectors: [matched-filter]
  bands: all
"""


def dirsig(folder: Path, rays: int = 20) -> np.ndarray:
    """A radiance image and its truth in DIRSIG's layout; the abundance of the panel, counted by rays."""
    rng = np.random.default_rng(9)
    material = np.where(np.arange(30)[:, None] < 15, 3.0, 12.0) * np.ones((30, 20))
    abundance = np.zeros((30, 20))
    abundance[5:7, 8:10], abundance[22, 4] = [[0.2, 1.0], [0.5, 0.75]], 0.6
    abundance = np.round(abundance * rays) / rays
    reflectance = np.where(material[..., None] == 3.0, 0.3, 0.1) * (1 + 0.05 * rng.standard_normal((30, 20, 5)))
    reflectance += abundance[..., None] * (0.6 - reflectance)
    envi(folder / "scene.img", reflectance * 8e-3, WAVES)
    names = "band names = {Material Index, Panel Abundance, Abundance - panel 7}\n"
    envi(folder / "truth.img", np.stack([material, np.zeros((30, 20)), abundance], axis=2), names)
    return abundance


def test_a_pair_of_dirsig_is_imagery_and_truth(tmp_path: Path):
    abundance = dirsig(tmp_path)
    (tmp_path / "c.yaml").write_text(DIRSIG)
    place = open_place(job_of(tmp_path / "c.yaml").campaign.collection, lambda name: tmp_path / name)
    assert place.regions["grass"].sum() == 300
    assert [t.area_m2 for t in place.targets] == pytest.approx([4 * 2.45, 4 * 0.6])
    np.testing.assert_allclose(place.targets[0].fills[0], abundance[5:7, 8:10])
    assert place.cube.read(0, 1).values.mean() == pytest.approx(0.3 * 8e-3 * 1e3, rel=0.02)  # uW cm-2 sr-1 nm-1
    warning = "filled in part: was each pixel sampled by one ray"
    assert not any(warning in note for note in place.notes)
    dirsig(tmp_path, rays=1)
    coarse = open_place(job_of(tmp_path / "c.yaml").campaign.collection, lambda name: tmp_path / name)
    assert any(warning in note for note in coarse.notes)
    run = run_campaign(job_of(tmp_path / "c.yaml"), predicts=False, show_progress=False)
    assert run.simulated is True
    assert "the collection is imagery and truth that DIRSIG made" in run.notes
    (scores,) = run.score_maps.values()
    assert scores.values[5, 9] > scores.values[abundance == 0].max()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("grass: 3", "grass: 4"), "no pixel of material 4(?s:.*)one of 3, 12"),
        (('"material*"', '"map*"'), "0 bands are called 'map\\*'(?s:.*)Material Index"),
        (('"*abundance*panel*"', '"Material Index"'), "band 1 holds 3 to 12(?s:.*)0 to 1"),
        (('"*abundance*panel*"', "7"), "no band 7(?s:.*)1 to 3"),
        (('"*abundance*panel*"', '"Panel Abundance"'), "no pixel is filled by 'panel'"),
        (("simulated: dirsig", "simulated: mirage"), "simulated"),
        (("  cube: {path", "  simulate: a.yaml\n  cube: {path"), "dirsig reads DIRSIG's files"),
        (('band: "material*", classes: {grass: 3, asphalt: 12}', "band: 1"), "give classes"),
    ],
)
def test_truth_of_dirsig_that_does_not_fit(tmp_path: Path, change: tuple[str, str], words: str):
    dirsig(tmp_path)
    (tmp_path / "c.yaml").write_text(DIRSIG.replace(*change))
    with pytest.raises(HypervalError, match=words):
        open_place(job_of(tmp_path / "c.yaml").campaign.collection, lambda name: tmp_path / name)

"""Fills of pixels by a finer image or by abundances: closed forms, and a scene simulated at a tenth of a pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from scipy.ndimage import gaussian_filter
from small_world import World

from hyperval import api, cli
from hyperval.campaign import with_fills_of_truth
from hyperval.collection import Detection
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import open_raster
from hyperval.model import TargetGeometry, fill_distribution, pixel_fills, pixels_of_object
from hyperval.observe import FinerGrid, Place, fills_of, object_of_fills, open_place, registration_shifts, window_fills
from hyperval.scenario import Scenario
from hyperval.spectra import SIGMA_PER_FWHM

ONE_PLACE = np.zeros((1, 2))
WHOLE = FinerGrid(0.0, 0.0, 0.1, 0.1), (0, 0), (12, 10)


@pytest.mark.parametrize("blur", [0.0, 0.8, (0.5, 1.1)])
def test_cells_that_make_a_rectangle_have_the_fills_of_its_geometry(blur):
    both = blur if isinstance(blur, tuple) else (blur, blur)
    length, width, offset = 1.6, 0.9, np.array([0.23, -0.11])  # pixels; (x, y) from the middle pixel's centre
    expected = pixel_fills(TargetGeometry(length, width, 1.0, 0.0, blur), offset[None], np.zeros(1))[0]
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
    assert (target.corner, target.shape, target.area_m2) == ((4, 8), (9, 11), 3.0)
    np.testing.assert_array_equal(target.fills, fills[:, :, 1:])
    assert fills_of({"planks": [target]}) == {"planks": [[1.0, 0.5, 0.25], [0.25, 0.0, 0.0]]}


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
    fills = window_fills(mask, *WHOLE, (fwhm, fwhm), ONE_PLACE)[0]
    np.testing.assert_allclose(fills, blurred.reshape(12, 10, 10, 10).mean(axis=(1, 3)), atol=2e-4)


def test_an_error_of_registration_widens_the_response_on_average():
    """A normal displacement averages to a wider Gaussian: variances add."""
    mask, sd, fwhm = scene_of_a_tenth() == 1, 0.3, 0.7
    shifts = registration_shifts(sd, 400)
    np.testing.assert_allclose(shifts.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(shifts.std(axis=0), sd, rtol=1e-12)
    wide = float(np.hypot(fwhm, sd / SIGMA_PER_FWHM))
    mean = window_fills(mask, *WHOLE, (fwhm, fwhm), shifts).mean(axis=0)
    np.testing.assert_allclose(mean, window_fills(mask, *WHOLE, (wide, wide), ONE_PLACE)[0], atol=0.01)
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


def write_finer(folder: Path, classes: np.ndarray) -> None:
    with rasterio.open(
        folder / "finer.tif", "w", driver="GTiff", width=100, height=120, count=1, dtype=classes.dtype,
        crs="EPSG:32618", transform=Affine(0.2, 0, 300_000, 0, -0.2, 4_500_000),
    ) as dataset:  # fmt: skip
        dataset.write(classes, 1)


@pytest.fixture
def finer(tmp_path: Path):
    """Open a cube of 12 x 10 pixels on the map with two planks, by its finer map of classes as stated."""
    write_finer(tmp_path, scene_of_a_tenth())
    position = "map info = {UTM, 1, 1, 300000, 4500000, 2, 2, 18, North, WGS-84, units=Meters}\n"
    noise = np.random.default_rng(4).standard_normal((12, 10, 5))
    envi(tmp_path / "cube.img", 0.2 + 0.01 * noise, WAVES + position)

    def opened(**changes) -> Place:
        truth = {"image": "finer.tif", "classes": {"plank": 1, "panel": 2}, "psf_fwhm_pixels": 0.7} | changes
        if not {"registration_m", "registration_pixels"} & truth.keys():
            truth["registration_m"] = 0.0
        collection = {"cube": {"path": "cube.img", "quantity": "reflectance"}, "targets": {"finer": truth}}
        return World(tmp_path, np.empty(0), collection).place()

    return opened


def test_targets_of_a_finer_map_have_area_pixels_and_fills(finer, tmp_path):
    place = finer(registration_m=0.4)
    plank, panel = place.targets
    assert (plank.material, panel.material) == ("plank", "panel")
    cells = [int((scene_of_a_tenth() == value).sum()) for value in (1, 2)]
    assert [t.area_m2 for t in place.targets] == pytest.approx([0.04 * n for n in cells])
    assert plank.fills.mean(axis=0)[plank.part].min() >= 0.02
    assert 4.0 * plank.fills.mean(axis=0).sum() == pytest.approx(plank.area_m2, rel=0.05)
    assert any("registration of 0.2 pixels makes" in note for note in place.notes)
    still = finer().targets
    np.testing.assert_allclose(finer(corner=[0, 0], times_finer=10).targets[0].fills, still[0].fills, atol=1e-6)
    picture = finer(classes={"panel": {"band": 1, "above": 1.5}}).targets
    np.testing.assert_array_equal(picture[0].part, still[1].part)
    assert len(finer(objects="classes").targets) == 2
    # Cells without a value are none of the class, and take no other cells with them.
    cells = scene_of_a_tenth().astype(np.float32)
    cells[:2] = np.nan
    write_finer(tmp_path, cells)
    np.testing.assert_array_equal(finer(classes={"panel": {"above": 1.5}}).targets[0].part, still[1].part)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"classes": {"plank": 7}}, "no cell of 'plank'"),
        ({"corner": [-4, 0], "times_finer": 10}, "'plank' leaves the image(?s:.*)check where the finer image lies"),
        ({"classes": {"plank": {"band": 3, "above": 1}}}, "no band 3"),
        ({"least_fill": 0.99, "registration_pixels": 2.0}, "no pixel of 'plank' is filled by 0.99"),
        ({"corner": [0, 0]}, "corner and times_finer go together"),
        ({"registration_m": None}, "state the error of registration"),
        ({"registration_m": 1, "registration_pixels": 1}, "give registration_m or registration_pixels"),
        (Affine(0.2, 0.02, 300_000, 0, -0.2, 4_500_000), "does not run along(?s:.*)gdalwarp"),
        (Affine(1.5, 0, 300_000, 0, -1.5, 4_500_000), "at most half a pixel"),
    ],
)
def test_finer_images_that_cannot_be_truth(finer, tmp_path: Path, changes: dict | Affine, words: str):
    if isinstance(changes, Affine):
        with rasterio.open(tmp_path / "finer.tif", "r+") as dataset:
            dataset.transform = changes
        changes = {}
    with pytest.raises((InputError, ValueError), match=words):
        finer(**changes)


def scenario(fill: dict) -> Scenario:
    target = {"name": "plank", "host": "court", "spectrum": {"constant": 0.5}, "fill": fill}
    classes = [{"name": "court", "fraction": 1.0, "spectrum": {"constant": 0.2}, "covariance": {"relative_sd": 0.05}}]
    return Scenario.model_validate({"schema": 1, "name": "s", "scene": {"classes": classes, "targets": [target]}})


def test_a_scenario_takes_the_fills_of_the_truth(finer):
    place = finer(registration_m=0.4)
    detection = Detection.model_validate(
        {"targets": [{"name": "plank", "material": "plank", "spectrum": {"constant": 0.5}}]}
    )
    (taken,) = with_fills_of_truth([scenario({"truth": True})], place, detection)
    plank, fill = place.targets[0], taken.scene.targets[0].fill
    assert fill_distribution(fill).mean == pytest.approx(plank.fills[:, plank.part].mean(), rel=1e-9)
    assert pixels_of_object(fill) == plank.part.sum()
    untouched = scenario({"fixed": 0.4})
    assert with_fills_of_truth([untouched], place, detection) == [untouched]
    with pytest.raises(UsageError, match=r"does not tell the fills(?s:.*)state its fill"):
        with_fills_of_truth([scenario({"truth": True})], None, detection)
    with pytest.raises(UsageError, match="run it within that campaign"):
        fill_distribution(scenario({"truth": True}).scene.targets[0].fill)


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


def dirsig_place(folder: Path, text: str = DIRSIG) -> Place:
    (folder / "c.yaml").write_text(text)
    return open_place(api.load_campaign(folder / "c.yaml").campaign.collection, folder.joinpath)


def test_a_pair_of_dirsig_is_imagery_and_truth(tmp_path: Path):
    abundance = dirsig(tmp_path)
    place = dirsig_place(tmp_path)
    assert place.regions["grass"].sum() == 300
    assert [t.area_m2 for t in place.targets] == pytest.approx([4 * 2.45, 4 * 0.6])
    np.testing.assert_allclose(place.targets[0].fills[0], abundance[5:7, 8:10])
    assert place.cube.read(0, 1).values.mean() == pytest.approx(0.3 * 8e-3 * 1e3, rel=0.02)  # uW cm-2 sr-1 nm-1
    warning = "filled in part: was each pixel sampled by one ray"
    assert not any(warning in note for note in place.notes)
    dirsig(tmp_path, rays=1)
    assert any(warning in note for note in dirsig_place(tmp_path).notes)
    assert cli.run(["-q", "observe", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "out")]) == 0
    assert "the collection is imagery and truth that DIRSIG made" in (tmp_path / "out/report.html").read_text("utf-8")
    scores = open_raster(tmp_path / "out/scores/panel-matched-filter.tif").read_bands(0, 30)[0]
    assert scores[5, 9] > scores[abundance == 0].max()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("grass: 3", "grass: 4", "no pixel of material 4(?s:.*)one of 3, 12"),
        ('"material*"', '"map*"', "0 bands are called 'map\\*'(?s:.*)Material Index"),
        ('"*abundance*panel*"', '"Material Index"', "band 1 holds 3 to 12(?s:.*)0 to 1"),
        ('"*abundance*panel*"', "7", "no band 7(?s:.*)1 to 3"),
        ('"*abundance*panel*"', '"Panel Abundance"', "no pixel is filled by 'panel'"),
        ("simulated: dirsig", "simulated: mirage", "simulated"),
        ("  cube: {path", "  simulate: a.yaml\n  cube: {path", "dirsig reads DIRSIG's files"),
        ('band: "material*", classes: {grass: 3, asphalt: 12}', "band: 1", "give classes"),
        ("{file: truth.img,", "{file: truth.img, name: a,", "classes name the regions of a file"),
    ],
)
def test_truth_of_dirsig_that_does_not_fit(tmp_path: Path, old: str, new: str, words: str):
    dirsig(tmp_path)
    with pytest.raises(HypervalError, match=words):
        dirsig_place(tmp_path, DIRSIG.replace(old, new))

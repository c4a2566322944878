"""Fills of pixels by a finer image or by abundances: closed forms, and a scene simulated at a tenth of a pixel."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_world import DIRSIG, World, dirsig_images, finer_map, scene_of_a_tenth

from hyperval import api, cli
from hyperval.campaign import completed_scenario
from hyperval.collection import Detection
from hyperval.errors import UsageError
from hyperval.imagery import open_raster
from hyperval.model import fill_distribution, object_pixel_count, pixel_fills
from hyperval.observe import FinerGrid, Place, registration_shifts, subject_fills, target_from_fills, window_fills
from hyperval.scenario import Geometry, Scenario, load_scenario
from hyperval.spectra import SIGMA_PER_FWHM

WINDOW = (0, 0), (12, 10)


@pytest.mark.parametrize("blur", [0.0, 0.8, (0.5, 1.1)])
def test_cells_that_make_a_rectangle_have_the_fills_of_its_geometry(blur):
    both = blur if isinstance(blur, tuple) else (blur, blur)
    length, width, offset = 1.6, 0.9, np.array([0.23, -0.11])  # pixels; (x, y) from the middle pixel's centre
    geometry = Geometry(shape="rectangle", length_m=length, width_m=width, gsd_m=1.0, psf_fwhm_pixels=blur)
    expected = pixel_fills(geometry, offset[None], np.zeros(1))[0]
    half = expected.shape[0] // 2
    corner = half + 0.5 + offset[::-1] - np.array([length, width]) / 2
    grid = FinerGrid(np.array(corner), np.array([length / 16, width / 9]), both)
    fills = window_fills(np.ones((16, 9), bool), grid, (0, 0), expected.shape)
    np.testing.assert_allclose(fills[0], expected, atol=1e-9)
    assert fills.sum() == pytest.approx(length * width, rel=1e-6)


def test_pixels_of_a_target_are_those_whose_mean_fill_reaches_the_least():
    """Exactly the least fill belongs to it, the next lower number does not, whatever one drawn place has."""
    least = 0.02
    below = np.nextafter(least, 0.0)
    fills = np.array([[[0.0, 0.04, below], [0.0, least, 1.0]], [[0.0, 0.0, below], [0.0, least, 0.0]]])
    target = target_from_fills("p", "plank", fills, (4, 7), (9, 11), 3.0, "there")
    np.testing.assert_array_equal(target.part, [[True, False], [True, True]])
    assert (target.corner, target.shape, target.area_m2) == ((4, 8), (9, 11), 3.0)
    np.testing.assert_array_equal(target.fills, fills[:, :, 1:])
    assert subject_fills({"planks": [target]}) == {"planks": [[1.0, 0.04, least], [least, 0.0, 0.0]]}


def test_an_error_of_registration_widens_the_response_on_average():
    """A normal displacement averages to a wider Gaussian: variances add."""
    mask, sd, fwhm = scene_of_a_tenth() == 1, 0.3, 0.7
    shifts = registration_shifts(sd, 400)
    np.testing.assert_allclose(shifts.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(shifts.std(axis=0), sd, rtol=1e-12)
    wide = float(np.hypot(fwhm, sd / SIGMA_PER_FWHM))
    moved, still = (FinerGrid(np.zeros(2), np.full(2, 0.1), *of) for of in (((fwhm, fwhm), shifts), ((wide, wide),)))
    mean = window_fills(mask, moved, *WINDOW).mean(axis=0)
    np.testing.assert_allclose(mean, window_fills(mask, still, *WINDOW)[0], atol=0.01)
    assert np.array_equal(registration_shifts(0.0), np.zeros((1, 2)))


def opened(finer: World, **changes) -> Place:
    """The place of the collection with these entries of its finer truth."""
    targets = {"finer": finer.collection["targets"]["finer"] | changes}
    return replace(finer, collection=finer.collection | {"targets": targets}).place()


def test_targets_of_a_finer_map_have_area_pixels_and_fills(finer):
    place = opened(finer, registration_m=0.4)
    plank, panel = place.targets
    assert (plank.material, panel.material) == ("plank", "panel")
    cells = [int((scene_of_a_tenth() == value).sum()) for value in (1, 2)]
    assert [t.area_m2 for t in place.targets] == pytest.approx([0.04 * n for n in cells])
    assert plank.fills.mean(axis=0)[plank.part].min() >= 0.02
    assert 4.0 * plank.fills.mean(axis=0).sum() == pytest.approx(plank.area_m2, rel=0.05)
    assert any("registration of 0.2 pixels makes" in note for note in place.notes)
    still = opened(finer).targets
    np.testing.assert_allclose(opened(finer, corner=[0, 0], times_finer=10).targets[0].fills, still[0].fills, atol=1e-6)
    picture = opened(finer, classes={"panel": {"band": 1, "above": 1.5}}).targets
    np.testing.assert_array_equal(picture[0].part, still[1].part)
    assert len(opened(finer, objects="classes").targets) == 2
    # Cells without a value are none of the class, and take no other cells with them.
    cells = scene_of_a_tenth().astype(np.float32)
    cells[:2] = np.nan
    finer_map(finer.folder, cells)
    np.testing.assert_array_equal(opened(finer, classes={"panel": {"above": 1.5}}).targets[0].part, still[1].part)


def scenario(fill: dict) -> Scenario:
    return load_scenario(Path(__file__).with_name("plank.yaml")).with_values({"scene.targets.plank.fill": fill})


def test_a_scenario_takes_the_fills_of_the_truth(finer):
    place = opened(finer, registration_m=0.4)
    target = {"name": "plank", "material": "plank", "spectrum": {"constant": 0.5}}
    detection = Detection.model_validate({"targets": [target]})
    taken = completed_scenario(scenario({"truth": True}), place, detection)
    plank, fill = place.targets[0], taken.scene.targets[0].fill
    assert fill_distribution(fill).mean == pytest.approx(plank.fills[:, plank.part].mean(), rel=1e-9)
    assert object_pixel_count(fill) == plank.part.sum()
    untouched = scenario({"fixed": 0.4})
    assert completed_scenario(untouched, place, detection) is untouched
    with pytest.raises(UsageError, match=r"does not hold the fill fractions(?s:.*)state its fill"):
        completed_scenario(scenario({"truth": True}), None, detection)
    with pytest.raises(UsageError, match="run it within that campaign"):
        fill_distribution(scenario({"truth": True}).scene.targets[0].fill)


def test_a_pair_of_dirsig_is_imagery_and_truth(dirsig):
    place, folder, abundance = dirsig.place(), dirsig.folder, dirsig.values
    assert place.regions["grass"].sum() == 300
    assert [t.area_m2 for t in place.targets] == pytest.approx([4 * 2.45, 4 * 0.61])
    np.testing.assert_allclose(place.targets[0].fills[0], abundance[5:7, 8:10])
    assert place.cube.read(0, 1).values.mean() == pytest.approx(0.3 * 8e-3 * 1e3, rel=0.02)  # uW cm-2 sr-1 nm-1
    warning = "partly filled: was each pixel sampled by one ray"
    assert not any(warning in note for note in place.notes)
    dirsig_images(folder, rays=1)
    assert any(warning in note for note in dirsig.place().notes)
    assert cli.run(["-q", "observe", str(folder / "c.yaml"), "-o", str(folder / "out")]) == 0
    assert "the collection is imagery and truth that DIRSIG made" in (folder / "out/report.html").read_text("utf-8")
    scores = open_raster(folder / "out/scores/panel-matched-filter.tif").read_bands(0, 30)[0]
    assert scores[5, 9] > scores[abundance == 0].max()
    dirsig.text("c.yaml", DIRSIG.replace("  cube: {path", "  simulate: a.yaml\n  cube: {path"))
    with pytest.raises(UsageError, match="dirsig reads DIRSIG's files"):
        api.load_campaign(folder / "c.yaml")

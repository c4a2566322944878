"""Where classes, planks and regions lie, what contradicts itself, and fills by brute force against quadrature."""

import numpy as np
import pytest
from small_scene import SCENE, area, planks, small_scene

from hyperval.model import pixel_fills
from hyperval.scenario import Geometry
from hyperval.simulate import lay_out, pixel_weights, regions, square_footprint


def test_centred_planks_reach_the_nominal_fill_in_their_own_pixel():
    ground = lay_out(SCENE)
    assert len(ground.planks) == 6
    for plank in ground.planks:
        line, sample = int(plank.centre_line), int(plank.centre_sample)
        assert (plank.centre_line % 1, plank.centre_sample % 1) == (0.5, 0.5)
        assert ground.fill[line, sample] == pytest.approx(0.3, abs=1e-6)
        around = ground.fill[line - 3 : line + 4, sample - 3 : sample + 4]
        assert around.max() == ground.fill[line, sample]
        # The whole area of the plank but for what is under 1e-4 of a pixel.
        assert around.sum() == pytest.approx(plank.side_pixels**2, abs=24 * 1e-4)
        assert np.all((around == 0) | (around >= 1e-4))
    by_side = small_scene(targets=[planks(fill=None, side_m=1.5)])
    assert [p.side_pixels for p in lay_out(by_side).planks] == [0.75] * 6


def test_random_planks_lie_and_turn_at_random_and_stay_apart():
    group = planks(count=600, area={"lines": [5, 295], "samples": [5, 195]}, phase="random", heading_deg="random")
    ground = {"lines": 300, "samples": 200, "layout": [area("asphalt", [0, 300], [0, 200])]}
    found = lay_out(small_scene(**ground, panels=[], regions=[], targets=[group])).planks
    places = np.array([(p.centre_line, p.centre_sample) for p in found])
    # 5 standard errors of the mean of a uniform law.
    assert np.all(np.abs((places % 1).mean(axis=0) - 0.5) < 5 / np.sqrt(12 * 600))
    assert abs(np.mean([p.heading_deg for p in found]) - 45.0) < 5 * 90 / np.sqrt(12 * 600)
    distance = np.abs(places[:, None] - places[None]).max(axis=2) + 1e3 * np.eye(600)
    assert distance.min() >= 7 - 1


def test_later_areas_cover_earlier_ones_and_regions_stay_clear_of_borders_panels_and_planks():
    ground = lay_out(SCENE)
    names = np.array(ground.surfaces)[ground.class_map]
    assert np.all(names[30:] == "asphalt")
    assert np.all(names[10:18, 30:38] == "white-panel")
    assert (names == "grass").sum() == 30 * 48 - 64 == 30 * 48 - ground.on_panel.sum()
    found = regions(SCENE, ground)
    assert list(found) == ["white", "grass-field", "court"]
    assert found["white"].sum() == found["white"][11:17, 31:37].sum() == 36
    for plank in ground.planks:
        line, sample = int(plank.centre_line), int(plank.centre_sample)
        assert not found["court"][line - 3 : line + 4, sample - 3 : sample + 4].any()
    assert np.flatnonzero(found["court"].any(axis=1))[0] == 33
    assert not found["grass-field"][27:].any()
    assert not found["grass-field"][7:21, 27:41].any()
    assert found["grass-field"][0, 0]  # the edge of the image is no border of a class


@pytest.mark.parametrize("fwhm", [0.3, 1.0, 2.5])
def test_weights_of_neighbours_are_fills_of_a_plank_as_large_as_a_pixel(fwhm):
    weights = pixel_weights(fwhm)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.array_equal(weights, weights[::-1])
    _, _, fill = square_footprint(0.5, 0.5, 1.0, 0.0, fwhm)
    assert fill.sum() == pytest.approx(1.0, rel=1e-5)  # a plank's fills add up to its area
    down = fill.sum(axis=1)
    reach = min(down.size, weights.size) // 2
    middle = [values[values.size // 2 - reach :][: 2 * reach + 1] for values in (down, weights)]
    assert np.max(np.abs(middle[0] - middle[1])) < 1e-3


def test_the_model_and_the_simulation_find_the_same_fills():
    """Two routes that share no line: error functions and quadrature there, cells here."""
    rng = np.random.default_rng(11)
    for unturned in (True, True, *[False] * 6):
        side, fwhm, heading = rng.uniform(0.2, 1.8), rng.uniform(0.4, 1.5), rng.uniform(0.0, 90.0) * (not unturned)
        dx, dy = rng.uniform(-0.5, 0.5, 2)
        geometry = Geometry(side_m=side, gsd_m=1.0, heading_deg=heading, psf_fwhm_pixels=fwhm)
        # A heading runs clockwise with lines counted downwards; the model's second axis points up.
        model = pixel_fills(geometry, [[dx, -dy]], [heading])[0][::-1]
        half = model.shape[0] // 2
        line, sample, fill = square_footprint(20.5 + dy, 20.5 + dx, side, heading, fwhm)
        here = np.zeros((41, 41))
        here[line : line + fill.shape[0], sample : sample + fill.shape[1]] = fill
        window = here[20 - half : 21 + half, 20 - half : 21 + half]
        assert np.max(np.abs(window - model)) < 3e-4  # the cells' error on a fill up to 1
        assert model.max() > 0.02

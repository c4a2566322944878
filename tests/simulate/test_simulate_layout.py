"""Where classes, planks and regions lie, what contradicts itself, and fills by brute force against quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from small_scene import area, planks, small_scene

from hyperval.errors import UsageError
from hyperval.model import TargetGeometry, pixel_fills
from hyperval.simulate import centred_fill, lay_out, pixel_weights, regions, side_for_fill, square_footprint

SIGMA_PER_FWHM = 1.0 / (2.0 * math.sqrt(2.0 * math.log(2.0)))


def test_later_areas_cover_earlier_ones(scene):
    ground = lay_out(scene)
    names = np.array(ground.surfaces)[ground.class_map]
    assert (names[:30] == "grass").sum() == 30 * 48 - 64
    assert np.all(names[30:] == "asphalt")
    assert np.all(names[10:18, 30:38] == "white-panel")
    assert ground.on_panel.sum() == 64


def test_centred_planks_reach_the_nominal_fill_in_their_own_pixel(scene):
    ground = lay_out(scene)
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


def test_regions_stay_clear_of_borders_panels_and_planks(scene):
    ground = lay_out(scene)
    found = regions(scene, ground)
    assert list(found) == ["white", "grass-field", "court"]
    assert found["white"].sum() == found["white"][11:17, 31:37].sum() == 36
    for plank in ground.planks:
        line, sample = int(plank.centre_line), int(plank.centre_sample)
        assert not found["court"][line - 3 : line + 4, sample - 3 : sample + 4].any()
    assert np.flatnonzero(found["court"].any(axis=1))[0] == 33
    assert not found["grass-field"][27:].any()
    assert not found["grass-field"][7:21, 27:41].any()
    assert found["grass-field"][0, 0]  # the edge of the image is no border of a class


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"layout": [area("grass", [0, 50], [0, 48])], "targets": [], "regions": []},
         "line 50, sample 0 is covered by no class"),
        ({"targets": [planks(area={"lines": [26, 40], "samples": [4, 25]})]}, "reaches beyond its host"),
        ({"targets": [planks(area={"lines": [46, 60], "samples": [4, 25]})], "psf_fwhm_pixels": 4.0},
         "beyond its host"),
        ({"targets": [planks(fill=None, side_m=10.0)]}, "see each other"),
        ({"targets": [planks(fill=0.7), planks(name="again", fill=0.7)]}, "overlap"),
        ({"regions": [{"name": "court", "surface": "asphalt", "border_pixels": 30}]}, "holds no pixel"),
    ],
)  # fmt: skip
def test_a_layout_that_contradicts_itself_is_refused(changes, words):
    scene = small_scene(**changes)
    with pytest.raises(UsageError, match=words):
        regions(scene, lay_out(scene))


def quadrature_fill(offset: float, side: float, fwhm: float) -> float:
    """One-dimensional fill of a pixel whose centre lies ``offset`` from the middle of a strip, by quadrature."""
    sigma = fwhm * SIGMA_PER_FWHM

    def response(x: float) -> float:
        return float(norm.cdf((x + 0.5) / sigma) - norm.cdf((x - 0.5) / sigma))

    return quad(response, -offset - side / 2, -offset + side / 2, epsabs=1e-12)[0]


@pytest.mark.parametrize("heading", [0.0, 17.0, 45.0, 90.0])
@pytest.mark.parametrize(("line", "sample"), [(10.5, 20.5), (10.13, 20.91)])
def test_the_fills_of_a_plank_add_up_to_its_area(heading, line, sample):
    for side in (0.3, 1.0, 2.4):
        fill = square_footprint(line, sample, side, heading, 1.1).fill
        assert fill.sum() == pytest.approx(side**2, rel=1e-5)
        assert fill.min() >= 0.0
        assert fill.max() <= 1.0 + 1e-9


@pytest.mark.parametrize("fwhm", [0.5, 1.0, 1.8])
@pytest.mark.parametrize("side", [0.25, 0.9, 2.2])
def test_an_unturned_plank_agrees_with_quadrature(fwhm, side):
    found = square_footprint(5.3, 8.8, side, 0.0, fwhm)
    lines, samples = (np.arange(n) + 0.5 for n in found.fill.shape)
    down = np.array([quadrature_fill(y + found.first_line - 5.3, side, fwhm) for y in lines])
    across = np.array([quadrature_fill(x + found.first_sample - 8.8, side, fwhm) for x in samples])
    # 32 cells per pixel: the error of the midpoint rule is of the order 1/32^2, here on a fill up to 1.
    assert np.max(np.abs(found.fill - down[:, None] * across[None, :])) < 1.2e-3


def test_a_finer_grid_comes_closer_to_quadrature():
    exact = quadrature_fill(0.0, 1.0, 1.0) ** 2
    errors = [abs(centred_fill(1.0, 1.0, cells) - exact) for cells in (16, 32, 64)]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]  # the midpoint rule gains a factor of 4 each time
    assert errors[1] < 5e-4


def test_limits_of_small_and_large_planks_and_the_side_of_a_fill():
    assert centred_fill(0.5, 0.01) == pytest.approx(0.25, abs=1e-6)
    assert centred_fill(12.0, 1.0) == pytest.approx(1.0, abs=1e-6)
    for fill in (0.03, 0.4, 0.8):
        assert centred_fill(side_for_fill(fill, 1.0), 1.0) == pytest.approx(fill, abs=1e-9)


@pytest.mark.parametrize("fwhm", [0.3, 1.0, 2.5])
def test_pixel_weights_agree_with_quadrature(fwhm):
    weights = pixel_weights(fwhm)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.array_equal(weights, weights[::-1])
    # Weight k is what a strip one pixel wide and k pixels away contributes.
    exact = [quadrature_fill(i - weights.size // 2, 1.0, fwhm) for i in range(weights.size)]
    assert np.max(np.abs(weights - exact)) < 1e-3


def test_the_model_and_the_simulation_find_the_same_fills():
    """Two routes that share no line: error functions and quadrature there, cells here."""
    rng = np.random.default_rng(11)
    for _ in range(6):
        side, fwhm, heading = rng.uniform(0.2, 1.8), rng.uniform(0.4, 1.5), rng.uniform(0.0, 90.0)
        dx, dy = rng.uniform(-0.5, 0.5, 2)
        geometry = TargetGeometry(side, side, 1.0, heading, fwhm)
        # A heading runs clockwise with lines counted downwards; the model's second axis points up.
        model = pixel_fills(geometry, [[dx, -dy]], [heading])[0][::-1]
        half = model.shape[0] // 2
        found = square_footprint(20.5 + dy, 20.5 + dx, side, heading, fwhm)
        here = np.zeros((41, 41))
        lines, samples = found.fill.shape
        here[found.first_line :, found.first_sample :][:lines, :samples] = found.fill
        window = here[20 - half : 21 + half, 20 - half : 21 + half]
        assert np.max(np.abs(window - model)) < 3e-4  # the cells' error on a fill up to 1
        assert model.max() > 0.02

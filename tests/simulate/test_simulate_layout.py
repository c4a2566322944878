"""Where classes, planks and regions lie, and what contradicts itself."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.simulate.layout import lay_out, regions


def group(**changes):
    return {
        "name": "planks",
        "material": "yellow-paint-plank",
        "host": "asphalt",
        "fill": 0.3,
        "count": 6,
        "area": {"lines": [36, 50], "samples": [4, 25]},
    } | changes


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


def test_a_side_in_metres_is_taken_over_the_pixel_size(make_scene):
    scene = make_scene(targets=[group(fill=None, side_m=1.5)])
    assert [p.side_pixels for p in lay_out(scene).planks] == [0.75] * 6


def test_random_planks_lie_and_turn_at_random_and_stay_apart(make_scene):
    scene = make_scene(
        lines=300,
        samples=200,
        layout=[{"surface": "asphalt", "lines": [0, 300], "samples": [0, 200]}],
        panels=[],
        regions=[],
        targets=[group(count=600, area={"lines": [5, 295], "samples": [5, 195]}, phase="random", heading_deg="random")],
    )
    planks = lay_out(scene).planks
    phase = np.array([(p.centre_line % 1, p.centre_sample % 1) for p in planks])
    heading = np.array([p.heading_deg for p in planks])
    # 5 standard errors of the mean of a uniform law.
    assert np.all(np.abs(phase.mean(axis=0) - 0.5) < 5 / np.sqrt(12 * 600))
    assert abs(heading.mean() - 45.0) < 5 * 90 / np.sqrt(12 * 600)
    places = np.array([(p.centre_line, p.centre_sample) for p in planks])
    distance = np.abs(places[:, None] - places[None]).max(axis=2) + 1e3 * np.eye(600)
    assert distance.min() >= 7 - 1


def test_regions_stay_clear_of_borders_panels_and_planks(scene):
    ground = lay_out(scene)
    found = regions(scene, ground)
    assert list(found) == ["white", "grass-field", "court"]
    assert found["white"].sum() == 36
    assert found["white"][11:17, 31:37].all()
    for plank in ground.planks:
        line, sample = int(plank.centre_line), int(plank.centre_sample)
        assert not found["court"][line - 3 : line + 4, sample - 3 : sample + 4].any()
    assert not found["court"][:33].any()
    assert found["court"][33].any()
    assert not found["grass-field"][27:].any()
    assert not found["grass-field"][7:21, 27:41].any()
    assert found["grass-field"][0, 0]  # the edge of the image is no border of a class


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"layout": [{"surface": "grass", "lines": [0, 50], "samples": [0, 48]}], "targets": [], "regions": []},
         "line 50, sample 0 is covered by no class"),
        ({"targets": [group(area={"lines": [26, 40], "samples": [4, 25]})]}, "reaches beyond its host"),
        ({"targets": [group(area={"lines": [46, 60], "samples": [4, 25]})], "psf_fwhm_pixels": 4.0},
         "beyond its host"),
        ({"targets": [group(fill=None, side_m=10.0)]}, "see each other"),
        ({"targets": [group(fill=0.7), group(name="again", fill=0.7)]}, "overlap"),
        ({"regions": [{"name": "court", "surface": "asphalt", "border_pixels": 30}]}, "holds no pixel"),
    ],
)  # fmt: skip
def test_a_layout_that_contradicts_itself_is_refused(make_scene, changes, words):
    scene = make_scene(**changes)
    with pytest.raises(UsageError, match=words):
        regions(scene, lay_out(scene))

"""Maps of the scores that the model expects: what is said of a pixel, and what it then measures."""

from dataclasses import replace

import numpy as np

from hyperval.campaign import expected_maps, job_of, run_campaign, scene_content
from hyperval.figures import draw_pictures
from small_campaign import PANELS


def test_expected_maps_of_a_closure_campaign(small):
    small.data["comparisons"] = small.data["comparisons"][:1]
    path, seen = small.write(), []
    job = job_of(path)
    run = run_campaign(job, show_progress=False, with_observed=seen.append)
    (score_map,) = run.score_maps.values()
    place, detection = seen[0].place, job.campaign.detection
    whole = slice(None), slice(None)
    expected = score_map.expected.of(whole)

    # The measured mean of each kind of ground and target meets what is expected there, within five standard errors
    # (one false failure in a million) and the hundredth to which the filters of pixels and model agree.
    numbers, contents = scene_content(place, detection, {s for s, *_ in run.prediction.expected_scores})
    names = [next(iter(content.values())) for content in contents]
    assert sorted(names) == sorted(["field", "court", *PANELS, "small-planks", "large-planks"])
    for number in range(len(contents)):
        there = numbers == number
        measured, (value,) = score_map.values[there], np.unique(expected[there])
        error = measured.std(ddof=1) / np.sqrt(there.sum())
        assert abs(measured.mean() - value) < 5.0 * error + 0.01
    # Nothing is said of what is beside the pixel that holds a plank's centre.
    assert np.isnan(expected[numbers == -1]).all()
    assert {names[n] for n in np.unique(numbers[place.region("white-panel")])} == {"white-panel"}
    beside = place.near_targets.copy()
    beside[tuple(np.transpose([t.centre_pixel for t in place.targets]))] = False
    assert (numbers[beside] == -1).all()

    # A pixel of two targets holds an unknown part of each, of three too; one target alone keeps its own.
    first, second, third = (replace(t, part=np.ones((2, 2), bool)) for t in place.targets[:3])
    corner = first.corner[0], first.corner[1]
    second, third = (
        replace(second, corner=(corner[0], corner[1] + 1)),
        replace(third, corner=(corner[0] + 1, corner[1] + 1)),
    )
    crowded = replace(place, targets=[first, second, third], target_pixels="touched")
    numbers, _ = scene_content(crowded, detection.model_copy(update={"group": "{name}"}), {"field"})
    window = numbers[corner[0] : corner[0] + 3, corner[1] : corner[1] + 3]
    np.testing.assert_array_equal(
        window >= 0, [[True, False, True], [True, False, False], [window[2, 0] >= 0, True, True]]
    )
    assert expected_maps(place, detection, {}) == {}
    assert expected_maps(place, detection, {("elsewhere", "yellow", "cem"): 1.0}) == {}

    measured, drawn = draw_pictures(None, run.score_maps, simulated=True)
    assert (measured.name, drawn.name) == ("score-map-1", "score-map-1-expected")
    assert measured.width_px == drawn.width_px
    assert "blank where" in drawn.title

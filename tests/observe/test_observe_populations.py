"""Filter, class and false alarms are of the same pixels, or the notes say how they differ."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.collection import CollectionSection, Detection
from hyperval.errors import UsageError
from hyperval.model import Sources
from hyperval.observe import open_place, pipeline
from hyperval.scenario import CovarianceSource, SpectrumSource, Surface


def populations(world):
    """Pixels behind the class of the whole image, the filter, and the false alarms."""
    place = open_place(CollectionSection.model_validate(world.collection), world.resolve, show_progress=False)
    detection = Detection.model_validate(world.detection)
    seen = world.observe()
    return seen, place, (
        seen.statistics["ground"].n,
        int(place.background(detection.background).sum()),
        next(iter(seen.observation.exceedance.values())).n,
    )  # fmt: skip


@pytest.mark.parametrize("background", [["scene"], ["ground"]])
def test_regions_that_are_left_out_are_left_out_of_every_population(world, background):
    world.collection["regions"] = [
        {"name": "ground", "whole_image": True}, {"name": "bright roof", "rectangle": [40, 30, 3, 3]},
    ]  # fmt: skip
    world.collection["leave_out"] = ["bright roof"]
    world.detection |= {"background": background, "false_alarms": background}
    values = world.values.copy()
    values[40:43, 30:33] = 0.9
    world.write(values)
    seen, place, (of_class, of_filter, of_alarms) = populations(world)
    assert of_class == of_filter == of_alarms == int(np.sum(place.background(["scene"])))
    assert seen.statistics["ground"].mean.max() < 0.5
    assert seen.statistics["bright roof"].n == 9  # what is left out has statistics of its own
    assert not [n for n in seen.observation.notes if "false alarms are counted on" in n]


def test_the_notes_say_how_the_populations_differ(world):
    world.collection["regions"] = [{"name": "ground", "whole_image": True}]
    world.detection |= {"background": ["image"], "false_alarms": ["scene"]}
    seen, place, _ = populations(world)
    near = int(place.near_targets.sum())
    total = int(np.prod(place.cube.shape))
    (note,) = [n for n in seen.observation.notes if "false alarms are counted on" in n]
    assert note.startswith(f"the filters have their statistics from {total} pixels (image)")
    assert f"counted on {total - near} (scene)" in note
    assert any(
        n.startswith(f"{near} pixels of targets and their guard are in the filters'") for n in seen.observation.notes
    )


def test_a_single_pixel_gives_a_mean_and_no_spread(world):
    world.collection["regions"] = [{"name": "dot", "rectangle": [3, 3, 1, 1]}]
    seen = world.observe()
    dot = seen.statistics["dot"]
    assert dot.n == 1
    assert dot.mean == pytest.approx(world.values[3, 3], rel=1e-6)
    sources = Sources(seen.observation.axis, seen.statistics, world.resolve)
    with pytest.raises(UsageError, match="'dot' is a single pixel: the spread of 'court' is not known"):
        sources.surface(Surface(name="court", spectrum=SpectrumSource(measured="dot")))
    stated = Surface(
        name="court", spectrum=SpectrumSource(measured="dot"), covariance=CovarianceSource(relative_sd=0.1)
    )
    found = sources.surface(stated)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(0.1 * found.mean)


def test_another_detection_in_the_same_collection_measures_only_pixels_that_it_changes(make_radiance, monkeypatch):
    world = make_radiance(relative_noise=0.01).world
    collection = CollectionSection.model_validate(world.collection)
    first = world.observe()
    material, spectrum = {"material": "paint"}, world.source("library.csv", "paint")
    world.detection |= {
        "background": ["corner"], "false_alarms": ["corner"], "group": "all",
        "targets": [{"name": "paint", "spectrum": spectrum} | material],
    }  # fmt: skip
    again, detection = world.observe().observation, Detection.model_validate(world.detection)
    measured = []
    whole = pipeline.mean_error
    monkeypatch.setattr(pipeline, "mean_error", lambda *args: measured.append(args[2].n) or whole(*args))
    monkeypatch.setattr(pipeline, "pixel_distances", None)  # of regions, which are the same
    short = pipeline.observe(
        collection, detection, world.resolve, before=first.surfaces, show_progress=False
    ).observation
    assert measured == [5]  # of the one group in place of two: all pixels with paint
    assert short.distribution == again.distribution != {}
    for product in ("radiance", "reflectance"):
        assert list(getattr(short, product)) == list(getattr(again, product))
        for name, estimate in getattr(again, product).items():
            assert np.array_equal(getattr(short, product)[name].mean, estimate.mean, equal_nan=True)
            assert np.array_equal(
                getattr(short, product)[name].error_covariance, estimate.error_covariance, equal_nan=True
            )
    assert short.scores == again.scores
    assert {k: c.pd.tolist() for k, c in short.roc.items()} == {k: c.pd.tolist() for k, c in again.roc.items()}
    assert short.notes == again.notes

"""The real HySU image: scores against plain NumPy, and areas with the campaign's own settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from hyperval import datasets
from hyperval.campaign import job_of
from hyperval.model import Sources
from hyperval.observe import observe

CAMPAIGN = Path(__file__).parents[2] / "campaigns" / "hysu-2018" / "campaign.yaml"
IMAGE = "hysu/published/full/DLR_HySU_HS_full.tif"
FIELD = ("bitumen", "red_metal", "blue_fabric", "red_fabric", "green_fabric")
FABRICS = ("blue_fabric_image", "red_fabric_image", "green_fabric_image")

pytestmark = pytest.mark.data


@pytest.fixture
def campaign(data_dir):
    data_dir(IMAGE)
    return job_of(CAMPAIGN).campaign


def test_scores_of_the_field_spectra_equal_plain_numpy(data_dir, campaign):
    with rasterio.open(data_dir(IMAGE)) as source:
        pixels = np.moveaxis(source.read(), 0, -1).reshape(-1, source.count).astype(np.float64) / 10000.0
        shape = source.shape
    targets = [t for t in campaign.detection.targets if t.name in FIELD]
    detection = campaign.detection.model_copy(
        update={"targets": targets, "background": ["image"], "pools": [], "areas": [], "unmixing": None}
    )
    seen = observe(campaign.collection, detection, datasets.resolve, show_progress=False)
    used = seen.detected.bank.bands
    # The libraries are sampled at the bands of the image: none is lost.
    assert (pixels.shape, int(used.sum())) == ((86 * 123, 135), 135)
    x = pixels[:, used]
    mean = x.mean(axis=0)
    covariance = np.cov(x, rowvar=False)  # every pixel of the image, targets among them
    spectra = Sources(seen.place.cube.axis, {}, datasets.resolve)
    for target in targets:
        d = spectra.spectrum(target.spectrum, target.name).mean[used] - mean
        weights = np.linalg.solve(covariance, d)
        expected = (x - mean) @ weights / (d @ weights)
        found = seen.detected.score_maps[f"{target.name}-cem"]
        assert found.shape == shape
        # Relative to each score; those near 0 are differences of numbers of the size of the scores' spread.
        allowed = 1e-9 * np.maximum(np.abs(expected), expected.std())
        assert np.all(np.abs(found.ravel() - expected) <= allowed), target.name


def test_areas_of_the_fabrics_with_the_campaign_s_own_settings(campaign):
    seen = observe(campaign.collection, campaign.detection, datasets.resolve, show_progress=False)
    assert seen.place.pixel_area_m2 == pytest.approx(0.49)
    for target in FABRICS:
        for side in (3, 2, 1):
            key = (f"{target} {side} m", "cem")
            assert seen.detected.nominal_area_m2[key] == side**2
            assert seen.observation.abundance[key].area_m2 / side**2 == pytest.approx(1.0, abs=0.25), key


def test_an_area_is_the_sum_of_the_scores_on_the_mask(data_dir, campaign):
    seen = observe(campaign.collection, campaign.detection, datasets.resolve, show_progress=False)

    def raster(name):
        # One byte (or two) for each of 86 x 123 pixels, no header bytes.
        raw = data_dir(f"hysu/published/rois/{name}").read_bytes()
        return np.frombuffer(raw, np.uint8).reshape(86, 123)

    here = (raster("blueFabric") > 0) & (raster("targetsSizeROI") == 1)
    scores = seen.detected.score_maps["blue_fabric_image-cem"]
    area = seen.observation.abundance["blue_fabric_image 3 m", "cem"]
    assert area.n == int(here.sum())
    assert area.area_m2 == pytest.approx(scores[here].sum() * 0.49, rel=1e-12)


def test_every_target_of_the_truth_is_scored_by_size(campaign):
    seen = observe(campaign.collection, campaign.detection, datasets.resolve, show_progress=False)
    sides = ("3", "2", "1", "0.5", "0.25")
    names = [t.name for t in campaign.detection.targets]
    expected = {f"{name} {side} m" for name in names for side in sides}
    expected |= {f"all materials {side} m" for side in sides}
    assert {s for s, _, unit in seen.observation.roc if unit == "object"} == expected
    assert seen.observation.roc["all materials 3 m", "cem", "object"].n_target == 5

"""Deliberate defects: each moves an accepted number beyond its tolerance, and the message says which."""

import functools
import importlib
import math
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hyperval import baseline
from hyperval.campaign import load_job, run_campaign
from hyperval.model import FILTERS, LinearFilter, fixed_fill, matched_filter_weights
from hyperval.results import Outcome, Result
from hyperval.sensor import library_names, load_sensor
from small_campaign import SmallCampaign, stand_in_atmosphere

ROOT = Path(__file__).parents[2]
SENSOR = "prospectir-vs"
Patch = pytest.MonkeyPatch


def campaign_numbers(small: SmallCampaign) -> dict[str, Result]:
    """Numbers of the small campaign, whose fills vary from pixel to pixel."""
    for subject in small.scenario["scene"]["targets"][0]["subjects"]:
        mean = subject["fill"].get("fixed", subject["fill"].get("mean"))
        subject["fill"] = {"mean": mean, "sd": 0.02}
    path = small.write()
    return baseline.campaign_metrics(run_campaign(load_job(path)).table)


def sensor_numbers() -> dict[str, Result]:
    return baseline.sensor_metrics(load_sensor(SENSOR), stand_in_atmosphere)


@pytest.fixture(scope="module")
def sound_sensor() -> dict[str, baseline.Accepted]:
    return baseline.accepted_numbers(sensor_numbers(), {})


@pytest.fixture(scope="module")
def sound_campaign(small_collection, tmp_path_factory) -> dict[str, baseline.Accepted]:
    folder = tmp_path_factory.mktemp("sound") / "small"
    shutil.copytree(small_collection, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hyperval.model.stated.atmospheric_terms", stand_in_atmosphere)
        return baseline.accepted_numbers(campaign_numbers(SmallCampaign(folder)), {})


def wrong(accepted: Mapping[str, baseline.Accepted], now: Mapping[str, Result]) -> list[Result]:
    return [d for d in baseline.compare("it", accepted, now) if d.outcome is Outcome.DISAGREES]


def wrapped(name: str, change: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Callable[[Patch], None]:
    """A defect: what goes by this dotted name is handed through ``change``."""

    def inject(patch: Patch) -> None:
        module, _, attribute = name.rpartition(".")
        patch.setattr(name, change(getattr(importlib.import_module(module), attribute)))

    return inject


def result(change: Callable[[Any], Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Changes what a function gives."""
    return lambda right: lambda *a, **k: change(right(*a, **k))


def turned(right: LinearFilter) -> LinearFilter:
    return LinearFilter(-right.weights, -right.offset)


def filter_sign(patch: Patch) -> None:
    """(3.22) with the background minus the target, in the model and on pixels."""
    patch.setitem(FILTERS, "cem", lambda *a: turned(matched_filter_weights(*a)))


def of_cube(**entries: Callable[[Any], Any]) -> Callable[[Patch], None]:
    """Entries of the open image are others."""
    change = result(lambda cube: replace(cube, **{name: new(cube) for name, new in entries.items()}))
    return wrapped("hyperval.imagery.open_cube", change)


CUBE_2_PERCENT = of_cube(gain=lambda cube: 1.02 * cube.gain)
HAZIER = lambda right: lambda s, **k: right(s.model_copy(update={"aot550": 1.25 * s.aot550}), **k)  # noqa: E731
GAIN = wrapped("hyperval.sensor.specification.electrons_per_radiance", result(lambda gain: 1.02 * gain))
RATIO = "median_difference_ratio_windows"
# Each defect, and a number that must be among those that moved.
OF_CAMPAIGN = {
    "sign of the filter (3.22)": (filter_sign, "pd_predicted@1e-2"),
    "radiance of the image 2 % too large": (CUBE_2_PERCENT, RATIO),
    "bands of the image from the other end": (of_cube(stored_band=lambda cube: cube.stored_band[::-1].copy()), RATIO),
    "(3.12) without Var(f)": (
        wrapped("hyperval.model.fill.population_fill", result(lambda fill: fixed_fill(fill.mean))), "pd_predicted@1e-2",
    ),
    "optical depth 0.25 for 0.2": (wrapped("hyperval.model.stated.atmospheric_terms", HAZIER), RATIO),
}  # fmt: skip
OF_SENSOR = {
    "sign of the filter (3.22)": (filter_sign, "pd_at_pfa_0.001"),
    "full width taken as sigma": (wrapped("hyperval.spectra.axis.SIGMA_PER_FWHM", lambda _: 1.0), "reference_radiance"),
    "G of (3.13) 2 % too large": (GAIN, "median_electrons_per_radiance"),
    "(3.19) without its 1/3": (
        wrapped("hyperval.sensor.noise.bit_error_variance", result(lambda variance: 3.0 * variance)),
        "median_bit_error_noise_at_rate_1e-09",
    ),
    "(3.13) of a standard deviation": (wrapped("hyperval.sensor.noise.shot_variance", result(np.sqrt)), "median_snr"),
}  # fmt: skip


def assert_moved(found: list[Result], metric: str) -> None:
    named = [row for row in found if row.metric == metric]
    assert named, f"only {found}"
    assert all(row.reason.startswith(f"{metric} moved from ") and "tolerance" in row.reason for row in named)


@pytest.mark.parametrize("name", OF_CAMPAIGN)
def test_a_defect_moves_a_number_of_the_campaign(name, small, sound_campaign, monkeypatch):
    defect, metric = OF_CAMPAIGN[name]
    defect(monkeypatch)
    assert_moved(wrong(sound_campaign, campaign_numbers(small)), metric)


@pytest.mark.parametrize("name", OF_SENSOR)
def test_a_defect_moves_a_number_of_the_sensor(name, sound_sensor, monkeypatch):
    defect, metric = OF_SENSOR[name]
    defect(monkeypatch)
    assert_moved(wrong(sound_sensor, sensor_numbers()), metric)


def test_without_a_defect_nothing_moves_nor_by_differences_of_the_last_digits(small, sound_campaign, sound_sensor):
    assert wrong(sound_campaign, campaign_numbers(small)) == []
    now = sensor_numbers()
    assert wrong(sound_sensor, now) == []
    assert wrong(sound_sensor, {k: replace(m, value=m.value * (1.0 + 1e-7)) for k, m in now.items()}) == []


def science_changes() -> list[str]:
    """The rows of the changelog's table "Science changes"."""
    text = (ROOT / "CHANGELOG.md").read_text("utf-8").partition("### Science changes")[2]
    return [line for line in text.splitlines() if line.startswith("| 2")]


def baselines() -> list[Path]:
    return sorted((ROOT / baseline.DEFAULT_FOLDER).rglob("*.yaml"))


@functools.cache
def accepted(path: Path) -> baseline.Baseline:
    """What the file holds, read once for all tests."""
    return baseline.load_baseline(path)


def test_every_accepted_number_is_logged():
    logged = science_changes()
    told = {path.name: (str(accepted(path).date), accepted(path).reason) for path in baselines()}
    lacking = {name: words for name, words in told.items() if not any(all(w in e for w in words) for e in logged)}
    assert lacking == {}, "not in CHANGELOG.md under Science changes"


# Their images are not public, or could not be brought to where numbers are accepted.
WITHOUT_IMAGES = {"share2012-avon", "share2012-felt", "share2010-felt", "share2010-felt-chip"}


def test_every_sensor_and_campaign_has_a_baseline_and_no_other():
    assert {p.stem for p in baselines() if p.parent.name == baseline.SENSORS} == set(library_names())
    names = {
        re.search(r"^name: (\S+)$", p.read_text("utf-8"), re.MULTILINE)[1]
        for p in (ROOT / "campaigns").rglob("campaign*.yaml")
    }
    runnable = {n for n in names if n not in WITHOUT_IMAGES and "{" not in n}
    assert {p.stem for p in baselines() if p.parent.name != baseline.SENSORS} == runnable


def test_accepted_numbers_are_numbers():
    held = [(p, k, m) for p in baselines() for k, m in accepted(p).metrics.items()]
    assert held
    assert [(p, k) for p, k, m in held if m.accepted is None and m.outcome != "skipped"] == []
    assert all(math.isfinite(m.width) for _, _, m in held)

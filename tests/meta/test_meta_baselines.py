"""Deliberate defects: each moves an accepted number beyond its tolerance, and the message says which."""

from __future__ import annotations

import functools
import math
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hyperval.baseline import (
    DEFAULT_FOLDER,
    SENSORS,
    Accepted,
    Baseline,
    accepted_of,
    campaign_metrics,
    compare,
    load_baseline,
    sensor_metrics,
)
from hyperval.campaign import job_of, run_campaign
from hyperval.model import FILTERS, LinearFilter, fixed_fill, matched_filter_weights, solved_filter
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
    return campaign_metrics(run_campaign(job_of(path), show_progress=False).table)


def sensor_numbers() -> dict[str, Result]:
    return sensor_metrics(load_sensor(SENSOR), stand_in_atmosphere)


@pytest.fixture(scope="module")
def sound_sensor() -> dict[str, Accepted]:
    return accepted_of(sensor_numbers(), {})


@pytest.fixture(scope="module")
def sound_campaign(small_collection: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Accepted]:
    folder = tmp_path_factory.mktemp("sound") / "small"
    shutil.copytree(small_collection, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hyperval.model.world.atmospheric_terms", stand_in_atmosphere)
        return accepted_of(campaign_numbers(SmallCampaign(folder)), {})


def wrong(accepted: Mapping[str, Accepted], now: Mapping[str, Result]) -> list[Result]:
    return [d for d in compare("it", accepted, now) if d.outcome is Outcome.DISAGREES]


def _turned(right: LinearFilter) -> LinearFilter:
    return LinearFilter(-right.weights, -right.offset, right.condition)


def filter_sign(patch: Patch) -> None:
    """(3.22) with the background minus the target."""

    def turned(detector, *arguments, **named):
        right = solved_filter(detector, *arguments, **named)
        return _turned(right) if detector == "cem" else right

    patch.setattr("hyperval.model.detection.solved_filter", turned)
    patch.setitem(FILTERS, "cem", lambda *a: _turned(matched_filter_weights(*a)))


def width_as_sigma(patch: Patch) -> None:
    """The full width at half maximum of a band taken as its standard deviation."""
    patch.setattr("hyperval.spectra.axis.SIGMA_PER_FWHM", 1.0)


def gain_of_electrons(patch: Patch) -> None:
    """G of (3.13) 2 % too large."""
    from hyperval.sensor import electrons_per_radiance

    patch.setattr(
        "hyperval.sensor.specification.electrons_per_radiance",
        lambda *a, **k: 1.02 * electrons_per_radiance(*a, **k),
    )


def gain_of_image(patch: Patch) -> None:
    """Radiance of the image 2 % too large."""
    from hyperval.imagery import open_cube

    def scaled(*arguments, **named):
        cube = open_cube(*arguments, **named)
        return replace(cube, scaling=cube.scaling._replace(gain=1.02 * cube.scaling.gain))

    patch.setattr("hyperval.observe.open.open_cube", scaled)


def bit_errors_without_factor(patch: Patch) -> None:
    """(3.19) without its 1/3."""
    from hyperval.sensor import bit_error_variance

    patch.setattr("hyperval.sensor.noise.bit_error_variance", lambda *a: 3.0 * bit_error_variance(*a))


def band_order(patch: Patch) -> None:
    """The image's bands from the other end."""
    from hyperval.imagery import open_cube

    def reversed_bands(*arguments, **named):
        cube = open_cube(*arguments, **named)
        return replace(cube, stored_band=cube.stored_band[::-1].copy())

    patch.setattr("hyperval.observe.open.open_cube", reversed_bands)


def no_variance_of_fill(patch: Patch) -> None:
    """(3.12) without its Var(f) term."""
    from hyperval.model import moments

    patch.setattr("hyperval.model.fill.moments", lambda fill, thesis: fixed_fill(moments(fill, thesis).mean))


def deviation_for_variance(patch: Patch) -> None:
    """(3.16) with a standard deviation where the variance belongs."""
    from hyperval.sensor import detector_radiance_variance

    patch.setattr(
        "hyperval.sensor.noise.detector_radiance_variance", lambda *a: np.sqrt(detector_radiance_variance(*a))
    )


def aerosol(patch: Patch) -> None:
    """An aerosol optical depth of 0.25 in place of 0.2."""
    patch.setattr(
        "hyperval.model.world.atmospheric_terms",
        lambda state, **k: stand_in_atmosphere(state.model_copy(update={"aot550": 1.25 * state.aot550})),
    )


# Each with a number that must be among those that moved.
OF_CAMPAIGN: tuple[tuple[Callable[[Patch], None], str], ...] = (
    (filter_sign, "pd_predicted@1e-2"),
    (gain_of_image, "median_difference_ratio_windows"),
    (band_order, "median_difference_ratio_windows"),
    (no_variance_of_fill, "pd_predicted@1e-2"),
    (aerosol, "median_difference_ratio_windows"),
)
OF_SENSOR: tuple[tuple[Callable[[Patch], None], str], ...] = (
    (filter_sign, "pd_at_pfa_0.001"),
    (width_as_sigma, "reference_radiance"),
    (gain_of_electrons, "median_electrons_per_radiance"),
    (gain_of_electrons, "median_snr"),
    (bit_errors_without_factor, "median_bit_error_noise_at_rate_1e-09"),
    (deviation_for_variance, "median_snr"),
)


@pytest.mark.parametrize(("defect", "metric"), OF_CAMPAIGN)
def test_a_defect_moves_a_number_of_the_campaign(defect, metric, small, sound_campaign, monkeypatch):
    defect(monkeypatch)
    assert_moved(wrong(sound_campaign, campaign_numbers(small)), metric)


@pytest.mark.parametrize(("defect", "metric"), OF_SENSOR)
def test_a_defect_moves_a_number_of_the_sensor(defect, metric, sound_sensor, monkeypatch):
    defect(monkeypatch)
    assert_moved(wrong(sound_sensor, sensor_numbers()), metric)


def assert_moved(found: list[Result], metric: str) -> None:
    named = [row for row in found if row.metric == metric]
    assert named, f"only {found}"
    assert all(row.reason.startswith(f"{metric} moved from ") and "tolerance" in row.reason for row in named)


def test_without_a_defect_nothing_moves(small, sound_campaign, sound_sensor):
    assert wrong(sound_campaign, campaign_numbers(small)) == []
    assert wrong(sound_sensor, sensor_numbers()) == []


def test_differences_of_the_last_digits_move_nothing(sound_sensor):
    now = sensor_numbers()
    noisy = {k: replace(m, value=m.value * (1.0 + 1e-7)) for k, m in now.items()}
    assert wrong(sound_sensor, noisy) == []


def science_changes() -> list[str]:
    """The entries of the changelog under "Science changes", each on one line."""
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    sections = re.findall(r"^### Science changes\n(.*?)(?=^##|\Z)", text, re.MULTILINE | re.DOTALL)
    entries = [e for s in sections for e in re.split(r"^- ", s, flags=re.MULTILINE)[1:]]
    return [" ".join(e.split()) for e in entries]


def baselines() -> list[Path]:
    return sorted((ROOT / DEFAULT_FOLDER).rglob("*.yaml"))


@functools.cache
def accepted(path: Path) -> Baseline:
    """What the file holds, read once for all tests."""
    return load_baseline(path)


def test_every_accepted_number_is_logged():
    lacking = []
    for path in baselines():
        baseline = accepted(path)
        if not any(baseline.reason in e and baseline.date in e for e in science_changes()):
            lacking.append(f'{path.name}: "{baseline.date}: {baseline.reason}"')
    assert lacking == [], "not in CHANGELOG.md under Science changes"


def test_every_sensor_and_no_other_has_a_baseline():
    assert {p.stem for p in baselines() if p.parent.name == SENSORS} == set(library_names())


# Their images are not public, or could not be brought to where numbers are accepted.
WITHOUT_IMAGES = {"share2012-avon", "share2012-felt", "share2010-felt", "share2010-felt-chip"}


def test_every_baseline_is_of_a_campaign():
    names = {
        re.search(r"^name: (\S+)$", p.read_text("utf-8"), re.MULTILINE)[1]
        for p in (ROOT / "campaigns").rglob("campaign*.yaml")
    }
    runnable = {n for n in names if n not in WITHOUT_IMAGES and "{" not in n}
    assert {p.stem for p in baselines() if p.parent.name != SENSORS} == runnable


def test_accepted_numbers_are_numbers():
    held = [(p, k, m) for p in baselines() for k, m in accepted(p).metrics.items()]
    assert held
    assert [(p, k) for p, k, m in held if m.accepted is None and m.outcome != "skipped"] == []
    assert all(math.isfinite(m.width) for _, _, m in held)

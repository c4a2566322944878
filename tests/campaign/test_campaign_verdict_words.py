"""One page never contradicts itself, and a criterion that can never be met is named before anything is compared."""

import html
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hyperval import api, cli
from hyperval.results import Cause, Outcome
from small_campaign import CENTRES_NM, data_of, sensor_data, with_stand_in_atmosphere, without_figures, write_yaml

SITES = ("dark", "grey", "light", "bright")
WIDTH_NM = 10.0


class Sites:
    """A campaign of the radiance of four sites: written with any error, and run by the command or the API."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.campaign = data_of("sites")

    def written(self, error: Any, **calibration: float) -> Path:
        """The campaign file; ``error``: relative, of each site and band; ``calibration``: as stated."""
        rows = [f"{i} {nm} {WIDTH_NM}" for i, nm in enumerate(CENTRES_NM)]
        (self.folder / "bands.txt").write_text("\n".join(rows))
        write_yaml(self.folder / "scenario.yaml", data_of("sites_scenario"))
        write_yaml(self.folder / "sensor.yaml", sensor_data())
        self.campaign["collection"]["calibration"] = {"relative": 1e-6, **calibration}
        for name in SITES:  # bands that any radiance gives: the prediction is made in them
            self._spectrum(name, np.ones(len(CENTRES_NM)))
        path = write_yaml(self.folder / "campaign.yaml", self.campaign)
        predicted = api.validate(path).prediction
        for name, off in zip(SITES, np.broadcast_to(error, (len(SITES), len(CENTRES_NM))), strict=True):
            self._spectrum(name, predicted.radiance[name].mean * (1.0 + off))
        return path

    def _spectrum(self, name: str, values: Any) -> None:
        lines = [f"{nm} {value:.9g}" for nm, value in zip(CENTRES_NM, values, strict=True)]
        (self.folder / f"{name}.txt").write_text("\n".join(lines))

    def first_screen(self, path: Path) -> str:
        """The text of the page above its matrix."""
        assert cli.run(["-q", "validate", str(path), "-o", str(self.folder / "out")]) in (0, 1, 5)
        page = (self.folder / "out/report.html").read_text("utf-8").partition("<main>")[2]
        return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", page.partition('class="matrices"')[0])).split())


@pytest.fixture
def sites(tmp_path, monkeypatch) -> Sites:
    with_stand_in_atmosphere(monkeypatch)
    without_figures(monkeypatch)
    return Sites(tmp_path)


def attributed(run: Any) -> dict[str, Any]:
    """Group -> row of its reduced chi-square."""
    return {r.subject: r for r in run.results if r.product == "attribution" and r.metric == "reduced_chi_square"}


def test_a_calibration_that_the_sites_share_is_one_error_and_explains_itself(sites):
    """Four sites, one error in each band: what they share is as large as stated, what differs is nothing."""
    shared = 0.02 * np.random.default_rng(7).standard_normal(len(CENTRES_NM))
    found = attributed(api.validate(sites.written(shared, uncorrelated=0.02)))
    common = found["what all subjects share"]
    # 14 bands in windows: chi-square over its degrees of freedom leaves 0.3 to 2.3 in 1 of 1000 right collections.
    assert 0.3 < common.value < 2.3, common
    assert common.outcome is Outcome.NONE


def test_met_criteria_beside_a_rejected_budget_say_which_to_believe(sites):
    """2 % off, 5 % accepted, 0.1 % stated: criteria met, full tests and attribution far from it."""
    words = sites.first_screen(sites.written(0.02, uncorrelated=0.001))
    assert "4 acceptance criteria are met" in words
    told = re.search(r"The stated uncertainty is too small (.*?) The criteria that are met (.*?)\.", words)
    assert told, words
    assert "differences reach" in told[1]
    assert "say how large the differences are" in told[0]
    times = float(re.search(r"reach ([\d.]+) times", told[1])[1])
    assert times == pytest.approx(0.02 / 0.001, rel=0.1)


def test_a_page_without_a_contradiction_says_nothing_of_it(sites):
    noise = 0.02 * np.random.default_rng(3).standard_normal(len(CENTRES_NM))
    assert "too small" not in sites.first_screen(sites.written(noise, uncorrelated=0.02))


def test_a_budget_far_too_wide_is_a_finding_with_a_word_of_its_own(sites):
    """0.02 % off and 5 % stated: nothing is explained, and the budget does not fit either."""
    path = sites.written(2e-4 * np.random.default_rng(5).standard_normal((4, len(CENTRES_NM))), uncorrelated=0.05)
    found = attributed(api.validate(path))
    assert {found[name].cause for name in SITES} == {Cause.TOO_WIDE}
    assert all("times too wide" in found[name].reason for name in SITES)
    assert "Budget too wide: the stated uncertainty is far larger than the differences" in sites.first_screen(path)


def test_criteria_that_can_never_be_met_are_named_with_what_they_would_take(sites, capsys):
    """A level known to 2 % and accepted within 1 %: the interval is 3.9 times the range, whatever is collected."""
    sites.campaign["comparisons"][0]["within"] = [-0.01, 0.01]
    path = sites.written(0.0, relative=0.02)
    capsys.readouterr()
    assert cli.run(["validate", "--dry-run", str(path)]) == 0
    out, err = capsys.readouterr()
    never = [line for line in out.splitlines() if "can never be met" in line]
    assert [line.split("\t")[3].split()[1] for line in never] == [*SITES]
    for line in never:
        better = re.search(r"calibration known ([\d.]+) times better", line)
        assert better, line
        assert float(better[1]) == pytest.approx(1.96 * 0.02 / 0.01, rel=0.03)
    assert "4 acceptance criteria can never be met" in err
    words = sites.first_screen(path)
    assert "4 of the inconclusive criteria can never be met" in words
    assert "What would decide the 4 inconclusive acceptance criteria level of the radiance, dark (sixs): " in words


def test_a_criterion_that_chance_alone_leaves_open_may_be_met(sites, capsys):
    """0.2 % known, accepted within 1 %, 0.9 % off: inconclusive, and not for want of knowledge."""
    sites.campaign["comparisons"][0]["within"] = [-0.01, 0.01]
    path = sites.written(0.009, relative=0.002)
    rows = [r for r in api.validate(path).results if r.gates]
    assert {r.cause for r in rows} == {Cause.WIDE_INTERVAL}
    capsys.readouterr()
    cli.run(["validate", "--dry-run", str(path)])
    assert "never" not in "".join(capsys.readouterr())

"""The command on the small campaign: rows, the recipe of docs/benchmark.md, SKIPPED, ERROR, bytes."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperval import cli
from hyperval.pixels import DETECTORS, detect
from hyperval.scoreboard import runs as extend
from small_campaign import scene_data

ROOT = Path(__file__).parents[2]
RECIPES = re.findall(r"```python\n# (\w+\.py):.*?\n(.*?)```", (ROOT / "docs" / "benchmark.md").read_text(), re.DOTALL)


@pytest.fixture(autouse=True)
def own_registries(monkeypatch):
    """What a test registers is gone after it."""
    monkeypatch.setattr(detect, "ADDED_DETECTORS", {})
    monkeypatch.setattr(extend, "_LOADED", set())
    monkeypatch.setattr("hyperval.scoreboard.runs.DRAWS", 60)


@pytest.fixture
def no_drawing(monkeypatch):
    monkeypatch.setattr("hyperval.scoreboard.runs.benchmark_figures", lambda done: [])


def rows_of(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def run(*words: object) -> int:
    return cli.run(["-q", "benchmark", *map(str, words)])


def test_every_detector_has_its_rows_and_the_folder_repeats_to_the_byte(small, tmp_path):
    path = small.write()
    one, two = tmp_path / "one", tmp_path / "elsewhere" / "two"
    assert run(path, "-o", one) == run(path, "-o", two) == 0
    rows = rows_of(one)
    assert {r["product"] for r in rows} == {"benchmark"}
    every = {(r["method"], r["metric"]): r for r in rows if r["subject"] == "all objects"}
    for name in DETECTORS:
        for metric in ("auc", "rank_auc", "first_auc", "pd@1e-2", "rank_far@pd0.5"):
            assert every[f"{name}/object", metric]["outcome"] == "none"
        rank = every[f"{name}/object", "rank_auc"]
        assert float(rank["lower"]) <= float(rank["value"]) <= float(rank["upper"])
        assert rank["n"] == "96"
    shared = {every[f"{n}/object", "rank_auc"]["value"] for n in ("cem", "matched-filter", "smf")}
    assert len(shared) == 1
    assert float(every["cem/object", "rank_auc"]["value"]) < float(every["rx/object", "rank_auc"]["value"])
    measured = {(r["subject"], r["method"], r["metric"]) for r in rows}
    assert ("small-planks", "cem/pixel", "pd@1e-2") in measured
    assert ("large-planks", "sam/object", "far@pd0.5") in measured

    for name in ("matched-filter", "ace", "rx"):  # SPy beside ours
        ours, peer = (
            next(r for r in rows if (r["subject"], r["method"], r["metric"]) == ("large-planks", method, "auc"))
            for method in (f"{name}/pixel", f"spy-{name}/pixel")
        )
        assert float(peer["value"]) == pytest.approx(float(ours["value"]), abs=1e-6)
        assert peer["n"] == ours["n"]
        order = next(r for r in rows if (r["method"], r["metric"]) == (f"spy-{name}/pixel", "score_rank_correlation"))
        assert float(order["value"]) > 0.999999

    names = {p.relative_to(one).as_posix() for p in one.rglob("*") if p.is_file()}
    assert {"results.csv", "results.json", "junit.xml", "provenance.json", "report.html"} <= names
    assert {f"figures/small-{k}.svg" for k in ("detectors", "ranks")} <= names
    # provenance.json names the revision of the source, which may change while the tests run
    assert [n for n in names if n != "provenance.json" and (one / n).read_bytes() != (two / n).read_bytes()] == []
    page = (one / "report.html").read_text()
    assert "cem = matched-filter = smf" in page
    assert "SIMULATED" in page


@pytest.mark.slow
def test_the_recipe_of_the_page_adds_its_row(make_small, tmp_path, no_drawing):
    one, other = make_small("one"), make_small("other")
    other.data["name"] = "another"
    other.data["detection"]["detectors"] = ["cem"]
    first, second = one.write(), other.write()
    assert [name for name, _ in RECIPES] == ["mine.py"]
    files = []
    for name, text in RECIPES:
        (tmp_path / name).write_text(text)
        files += ["--extend", tmp_path / name]
    assert run(first, second, *files, "-o", tmp_path / "out") == 0
    rows = {(r["campaign"], r["subject"], r["method"], r["metric"]): r for r in rows_of(tmp_path / "out")}
    for campaign in ("small", "another"):
        added = rows[campaign, "all objects", "plain-difference/object", "auc"]
        assert 0.4 < float(added["value"]) <= 1.0
        rank = rows[campaign, "all objects", "plain-difference/object", "rank_auc"]
        assert float(rank["value"]) > float(rows[campaign, "all objects", "cem/object", "rank_auc"]["value"])
    assert '"mine.py"' in (tmp_path / "out" / "provenance.json").read_text()


def test_what_cannot_run_is_skipped_with_the_reason(small, tmp_path, no_drawing):
    small.data["detection"]["local_window"] = {"outer_pixels": 21, "inner_pixels": 5}
    del small.data["scenarios"], small.data["comparisons"]  # cube, truth and detectors are enough
    np.memmap(small.collection / "small_rad.img", "<i2", "r+")[: 72 * 16] = 0  # a line without data
    small.edit("small_rad.hdr", lambda text: f"{text}data ignore value = 0\n")
    assert run(small.write(), "-o", tmp_path / "out") == 0
    rows = {(r["method"], r["metric"]): r for r in rows_of(tmp_path / "out") if r["subject"] == "all objects"}
    for name in ("osp", "sam"):
        assert rows[f"{name}/object", "rank"]["outcome"] == "skipped"
        assert "local window" in rows[f"{name}/object", "rank"]["reason"]
    assert rows["ace/object", "auc"]["outcome"] == "none"


def test_a_function_an_estimator_and_a_map_made_elsewhere_have_rows_and_what_is_refused_takes_none_with_it(
    small, tmp_path, no_drawing, monkeypatch
):
    (tmp_path / "own.py").write_text(OF_ALL_KINDS)
    monkeypatch.setattr("hyperval.pixels.statistics.BLOCK_PIXELS", 300)  # many blocks, as a long image has
    path = small.write()
    noise = np.random.default_rng(0).normal(size=(scene_data()["lines"], scene_data()["samples"], 1))
    noise[:4] = np.nan
    np.save(tmp_path / "small.npy", noise)
    maps = ["--scores", f"noise={tmp_path}/{{campaign}}.npy", "--scores", f"none={tmp_path}/none.npy"]
    assert run(path, "--extend", tmp_path / "own.py", *maps, "-o", tmp_path / "out") == 0
    rows = {(r["method"], r["metric"]): r for r in rows_of(tmp_path / "out") if r["subject"] == "all objects"}
    for name, words in {"bad": "no such thing here", "short": "scores for", "none": "no such"}.items():
        assert words in rows[f"{name}/object", "rank"]["reason"]
    area = {name: float(rows[f"{name}/object", "auc"]["value"]) for name in ("cem", "mine", "halves", "noise")}
    assert area["mine"] == pytest.approx(area["cem"], abs=1e-9)
    assert 0.4 < area["noise"] < 0.8 < 0.9 < area["halves"]  # the greatest of an object's pixels
    assert "noise has no score for" in rows["cem/object", "rank_auc"]["reason"]
    every = {(r["subject"], r["method"], r["metric"]): r for r in rows_of(tmp_path / "out")}
    assert ("large-planks", "cem/pixel", "predicted_auc") in every
    compared = [key for key in every if key[1].startswith("of-the-image/") and key[2] in ("auc", "pd@1e-2")]
    assert len(compared) >= 6
    for subject, method, metric in compared:
        same = every[subject, method.replace("of-the-image", "cem"), metric]["value"]
        assert float(every[subject, method, metric]["value"]) == pytest.approx(float(same), abs=1e-9), (method, subject)
    monkeypatch.setattr("hyperval.pixels.detect.MAX_VALUES", 1000)
    assert run(path, "--extend", tmp_path / "own.py", "-o", tmp_path / "too-large") == 0
    refused = {r["method"]: r["reason"] for r in rows_of(tmp_path / "too-large") if r["outcome"] == "skipped"}
    assert "need the whole image at once" in refused["of-the-image/object"]


OF_ALL_KINDS = """
import numpy as np
from hyperval.errors import UsageError
from hyperval.pixels import register_detector, register_estimator, register_scores

class Halves:  # learns the mean of the targets, and never scores a pixel that it has learned from
    def fit(self, pixels, labels):
        self.learned = {row.tobytes() for row in pixels}
        self.mean, self.target = pixels[~labels].mean(0), pixels[labels].mean(0)
        self.inverse = np.linalg.inv(np.cov(pixels[~labels].T))
        return self

    def decision_function(self, pixels):
        assert not any(row.tobytes() in self.learned for row in pixels)
        return (pixels - self.mean) @ self.inverse @ (self.target - self.mean)

def bad(*given):
    raise UsageError("no such thing here")

def keep(target, mean, covariance, undesired):  # the filter of the background as a function of the image
    from hyperval.model import design_filter
    from hyperval.pixels import PixelDetector
    weights = design_filter("cem", target, mean, covariance).weights
    return PixelDetector(np.eye(mean.size), np.zeros(mean.size), image=lambda image, scene: image @ weights)

def of_the_image(target, mean, covariance, undesired):
    from hyperval.model import design_filter
    from hyperval.pixels import PixelDetector
    one = design_filter("cem", target, mean, covariance)
    def combine(y, _):
        return (y[0] - y[0].mean()) / y[0].std()  # keeps the order, where it is of the whole image
    return PixelDetector(one.weights[None], np.array([-one.offset]), combine)

register_detector("bad", bad)
register_detector("mine", keep)
register_detector("of-the-image", of_the_image)
register_scores("short", lambda image, target: image[:5, :, 0])
register_estimator("halves", Halves())
"""


def test_a_broken_campaign_is_an_error_row_beside_the_others(make_small, tmp_path, no_drawing):
    good, bad = make_small("good"), make_small("bad")
    bad.data["name"] = "bad"
    (bad.collection / "small_rad.img").unlink()
    assert run(good.write(), bad.write(), "-o", tmp_path / "out") == 3
    rows = rows_of(tmp_path / "out")
    assert [r["outcome"] for r in rows if r["campaign"] == "bad"] == ["error"]
    assert any(r["campaign"] == "small" and r["metric"] == "auc" for r in rows)


def test_where_nothing_could_be_ranked_the_exit_code_is_5_and_the_reason_is_said(no_data, tmp_path, capsys):
    file = ROOT / "campaigns" / "hysu-2018" / "campaign.yaml"
    assert cli.run(["benchmark", str(file), "-o", str(tmp_path / "out")]) == 5
    assert "hysu-2018: skipped: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "code", "words"), yaml.safe_load(Path(__file__).with_name("extensions.yaml").read_text())
)
def test_bad_extensions_are_refused_before_anything_runs(tmp_path, capsys, text, code, words):
    if text is not None:
        (tmp_path / "x.py").write_text(text)
    campaign = ROOT / "campaigns" / "share2012-twin" / "campaign.yaml"
    assert run(campaign, "--extend", tmp_path / "x.py", "-o", tmp_path / "out") == code
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_campaign_named_twice_is_refused(small, tmp_path, capsys):
    path = small.write()
    assert run(path, path, "-o", tmp_path / "out") == 2
    assert "two campaigns are named 'small'" in capsys.readouterr().err

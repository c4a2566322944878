"""The command on the small campaign: rows, the three recipes of docs/benchmark.md, SKIPPED, ERROR, bytes."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from hyperval import cli
from hyperval.processing import detectors
from hyperval.processing.detectors import DETECTORS
from hyperval.scoreboard import engines, extend

ROOT = Path(__file__).parents[2]
RECIPES = re.findall(
    r"```python\n# (\w+\.py):.*?\n(.*?)```", (ROOT / "docs" / "benchmark.md").read_text(), re.DOTALL
)


@pytest.fixture(autouse=True)
def own_registries(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is gone after it."""
    monkeypatch.setattr(detectors, "ADDED_DETECTORS", {})
    monkeypatch.setattr(engines, "ENGINES", dict(engines.ENGINES))
    monkeypatch.setattr("hyperval.scoreboard.variants.ENGINES", engines.ENGINES)
    monkeypatch.setattr(extend, "_LOADED", set())
    monkeypatch.setattr("hyperval.scoreboard.looks.DRAWS", 60)
    monkeypatch.setattr("hyperval.scoreboard.variants.DRAWS", 60)


@pytest.fixture
def no_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyperval.scoreboard.one.draw_benchmark", lambda report: [])


def rows_of(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def run(*words: object) -> int:
    return cli.run(["-q", "benchmark", *map(str, words)])


def test_every_detector_engine_and_formulation_has_its_rows_and_the_folder_repeats_to_the_byte(small, tmp_path):
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
        order = next(
            r for r in rows if (r["method"], r["metric"]) == (f"spy-{name}/pixel", "score_rank_correlation")
        )
        assert float(order["value"]) > 0.999999

    variants = {(r["method"], r["metric"]): r for r in rows if r["subject"] == "all subjects"}
    for label in ("sixs, corrected", "sixs, thesis"):
        assert variants[label, "radiance_median_abs_difference_ratio"]["outcome"] == "none"
        assert variants[label, "pd_inside_interval@1e-2"]["outcome"] == "none"
    assert float(variants["sixs, corrected", "radiance_median_abs_difference_ratio"]["value"]) < 0.02  # closure
    assert variants["modtran, corrected", "agreement"]["reason"] == "HYPERVAL_MODTRAN names no executable"
    names = {p.relative_to(one).as_posix() for p in one.rglob("*") if p.is_file()}
    assert {"results.csv", "results.json", "junit.xml", "provenance.json", "report.html"} <= names
    assert {f"figures/small-{k}.svg" for k in ("detectors", "ranks", "variants")} <= names
    # provenance.json names the revision of the source, which may change while the tests run
    assert [n for n in names if n != "provenance.json" and (one / n).read_bytes() != (two / n).read_bytes()] == []
    page = (one / "report.html").read_text()
    assert "cem = matched-filter = smf" in page
    assert "SIMULATED" in page


@pytest.mark.slow
def test_the_recipes_of_the_page_each_add_their_row(make_small, tmp_path, no_drawing):
    one, other = make_small("one"), make_small("other")
    other.data["name"] = "another"
    other.data["detection"]["detectors"] = ["cem"]
    first, second = one.write(), other.write()
    assert [name for name, _ in RECIPES] == ["mine.py", "brighter.py"]
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
        ratio = "radiance_median_abs_difference_ratio"
        brighter = rows[campaign, "all subjects", "brighter, corrected", ratio]
        assert "path radiance times 1.05" in brighter["reason"]
        assert float(brighter["value"]) > float(rows[campaign, "all subjects", "sixs, corrected", ratio]["value"])
        assert float(rows[campaign, "all subjects", "brighter, corrected", f"{ratio}_change"]["lower"]) > 0
    provenance = (tmp_path / "out" / "provenance.json").read_text()
    assert '"mine.py"' in provenance


def test_what_cannot_run_is_skipped_with_the_reason(small, tmp_path, no_drawing):
    small.data["detection"]["local_window"] = {"outer_pixels": 21, "inner_pixels": 5}
    assert run(small.write(), "-o", tmp_path / "out") == 0
    rows = {(r["method"], r["metric"]): r for r in rows_of(tmp_path / "out") if r["subject"] == "all objects"}
    for name in ("osp", "sam"):
        assert rows[f"{name}/object", "rank"]["outcome"] == "skipped"
        assert "local window" in rows[f"{name}/object", "rank"]["reason"]
    assert rows["ace/object", "auc"]["outcome"] == "none"


@pytest.mark.slow
def test_a_detector_that_the_collection_refuses_leaves_the_campaigns_own(small, tmp_path, no_drawing):
    (tmp_path / "bad.py").write_text(
        "from hyperval.errors import UsageError\n"
        "from hyperval.processing.detectors import register_detector\n"
        "def make(*given):\n    raise UsageError('no such thing here')\n"
        "register_detector('bad', make)\n"
    )
    assert run(small.write(), "--extend", tmp_path / "bad.py", "-o", tmp_path / "out") == 0
    rows = {(r["method"], r["metric"]): r for r in rows_of(tmp_path / "out") if r["subject"] == "all objects"}
    assert "no such thing here" in rows["bad/object", "rank"]["reason"]
    assert rows["cem/object", "auc"]["outcome"] == "none"


def test_a_broken_campaign_is_an_error_row_beside_the_others(make_small, tmp_path, no_drawing):
    good, bad = make_small("good"), make_small("bad")
    bad.data["name"] = "bad"
    (bad.collection / "small_rad.img").unlink()
    assert run(good.write(), bad.write(), "-o", tmp_path / "out") == 3
    rows = rows_of(tmp_path / "out")
    assert [r["outcome"] for r in rows if r["campaign"] == "bad"] == ["error"]
    assert any(r["campaign"] == "small" and r["metric"] == "auc" for r in rows)


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        (None, 3, "no such file"),
        ("raise ValueError('oops')", 2, "ValueError: oops"),
        (
            "from hyperval.processing.detectors import register_detector\nregister_detector('cem', print)",
            2,
            "'cem'",
        ),
        (
            "from hyperval.processing.detectors import register_detector\nregister_detector('A b', print)",
            2,
            "'A b'",
        ),
    ],
    ids=["missing", "fails", "taken", "unfit"],
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

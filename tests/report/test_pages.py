"""What is written: complete, self-contained, honest, and the same bytes twice."""

from __future__ import annotations

import base64
import csv
import dataclasses
import gzip
import hashlib
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import rasterio
from synthetic_run import NASTY, axis, make_run

from hyperval.figures import Drawing
from hyperval.products import ObservedProducts, PredictedProducts
from hyperval.report import (
    MAX_BYTES,
    Injected,
    PowerTable,
    RunReport,
    first_screen,
    index_page,
    report_page,
    write_index,
    write_outputs,
)
from hyperval.results import Outcome, Result, ResultTable, Role

_VOID = {"meta", "img", "br", "link", "input", "hr", "wbr"}  # elements that never have an end tag
SMALL = {"bands": 12, "subjects": ("grass",), "curves": 1, "shape": (12, 12)}


class Page(HTMLParser):
    """Tags, balanced or not, and the text that a reader sees."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.seen, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> ends nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.seen.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.seen).split())


def page_of(**options) -> Page:
    """The page of an invented run without its pictures; ``change``: what is another in it."""
    change = options.pop("change", {})
    return Page(report_page(dataclasses.replace(make_run(curves=1, **options), **change), []))


def written(run, folder):
    folder.mkdir(parents=True)
    write_outputs(run, folder)
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def in_another_process(code: str, *arguments: str, **environment: str) -> str:
    head = "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
    head += "from synthetic_run import make_run\nfrom hyperval.report import write_outputs\n"
    command = [sys.executable, "-c", head + code, str(Path(__file__).parent), *arguments]
    done = subprocess.run(command, check=True, env={**os.environ, **environment}, capture_output=True, text=True)
    return done.stdout


@pytest.fixture(scope="module")
def run():
    return make_run()


@pytest.fixture(scope="module")
def files(run, tmp_path_factory):
    return written(run, tmp_path_factory.mktemp("report") / "run")


@pytest.fixture(scope="module")
def page(files):
    return Page(files["report.html"].decode())


def test_every_file_of_the_contract_is_there(files, run, tmp_path):
    """Score maps keep their values and their place; the summary is what was planned."""
    tables = {"results.csv", "summary.csv", "results.json", "products.nc", "provenance.json", "junit.xml"}
    maps = {"scores/yellow_planks-CEM.tif", "scores/yellow_planks-ACE.tif"}
    pictures = {f"figures/{name}.png" for name in ("scene", "score-map-1", "score-map-2")}
    assert set(files) == tables | maps | pictures | {"report.html"}
    header, *rows = csv.reader(files["summary.csv"].decode().splitlines())
    assert [row[header.index("outcome")] for row in rows] == [str(row.outcome) for row in run.table if row.planned]
    provenance = json.loads(files["provenance.json"])
    assert (provenance["seed"], provenance["inputs"][0]["sha256"]) == (7, "ab" * 32)
    (tmp_path / "map.tif").write_bytes(files["scores/yellow_planks-CEM.tif"])
    with rasterio.open(tmp_path / "map.tif") as read:
        np.testing.assert_array_equal(read.read(1), run.score_maps["yellow planks-CEM"].values.astype(np.float32))
        assert (read.crs.to_epsg(), read.dtypes) == (32618, ("float32",))
        assert tuple(read.transform)[:6] == (0.5, 0, 287000.0, 0, -0.5, 4781000.0)
        assert np.isnan(read.nodata)


@pytest.mark.slow
def test_second_write_gives_the_same_bytes(tmp_path):
    """Nor do time, process, hash seed, import order and the user's matplotlib settings change any file."""
    here = written(make_run(**SMALL), tmp_path / "here")
    (tmp_path / "matplotlibrc").write_text("font.size: 20\nlines.linewidth: 9\n")
    out = tmp_path / "out"
    out.mkdir()
    settings = {"PYTHONHASHSEED": "12345", "MATPLOTLIBRC": str(tmp_path / "matplotlibrc")}
    in_another_process(f"write_outputs(make_run(**{SMALL!r}), Path(sys.argv[2]))", str(out), **settings)
    there = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert [name for name in here if here[name] != there.get(name)] == []
    assert set(here) == set(there)


def test_a_page_needs_no_library_that_draws_for_print(tmp_path):
    """matplotlib takes a second and 60 MB; what it draws is made on demand, by ``hyperval figures``."""
    code = f"write_outputs(make_run(**{SMALL!r}), Path(sys.argv[2]))\n"
    code += "print(*{'matplotlib', 'xarray', 'bokeh'} & set(sys.modules))\n"
    assert in_another_process(code, str(tmp_path)).split() == []


def test_page_loads_nothing_from_elsewhere(page, files):
    assert {tag for tag, _ in page.tags}.isdisjoint({"link", "iframe", "object", "embed", "base", "form"})
    for tag, attributes in page.tags:
        for name in ("src", "srcset", "href", "data", "poster", "action", "background"):
            value = attributes.get(name, "data:")
            assert not re.match(r"(?i)\s*(https?:|//|ftp:|file:|javascript:)", value or ""), (tag, value[:80])
    text = files["report.html"].decode()
    without_scripts = re.sub(r"(?s)<script>.*?</script>", "", text)
    assert "url(" not in without_scripts
    assert "@import" not in without_scripts
    assert "default-src 'none'" in text


def test_page_runs_no_script_but_those_whose_hash_it_states(files):
    text = files["report.html"].decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)[1]
    allowed = re.search(r"script-src ([^;]+)", policy)[1].split()
    run = re.findall(r"(?s)<script>(.*?)</script>", text)
    assert len(run) == 2
    packed = re.findall(r'<script type="text/plain" class="library">(.*?)</script>', text)
    scripts = [*(gzip.decompress(base64.b64decode(part)) for part in packed), *(script.encode() for script in run)]
    digests = [base64.b64encode(hashlib.sha256(script).digest()).decode() for script in scripts]
    assert sorted(allowed) == sorted(f"'sha256-{digest}'" for digest in digests)
    assert sum(map(len, packed)) < 0.45 * sum(map(len, scripts[: len(packed)]))
    held = re.findall(r'(?s)<script type="application/json" class="chart">(.*?)</script>', text)
    charts = [json.loads(chart)["name"] for chart in held]
    assert charts[:3] == ["criteria", "worst", "radiance"]
    assert set(charts) >= {"radiance", "roc", "snr", "reflectance"}  # nothing is planned of the last two
    assert len(text.encode()) < MAX_BYTES


def test_evidence_comes_before_tables_and_reasons_after_assumptions(files):
    text = files["report.html"].decode()
    places = [text.index(part) for part in (
        'class="verdict', 'class="matrix"', 'alt="Picture of the scene', 'alt="Map of the detector score',
        'id="chart-radiance"', 'id="chart-roc"', 'class="rows"', 'id="assumptions"',
        'id="budget"', 'id="provenance"',
    )]  # fmt: skip
    assert places == sorted(places)
    row = Result("i", "reflectance", "grass", "", "p_value_full", 0.0, role=Role.GATE, outcome=Outcome.DISAGREES)
    text = report_page(make_run(subjects=("grass", "lawn"), curves=1, rows=[row]), [])
    assert text.index('id="chart-reflectance"') < text.index('id="chart-radiance"') < text.index('id="chart-snr"')


def test_page_is_balanced_and_every_figure_has_alternative_text(page, files):
    assert page.open == []
    images = [attributes for tag, attributes in page.tags if tag == "img"]
    charts = [attributes for tag, attributes in page.tags if attributes.get("role") == "group"]
    assert len(charts) == 11
    assert len(images) == sum(name.startswith("figures/") for name in files)
    assert all(len(text) > 40 for text in [*(i["alt"] for i in images), *(c["aria-label"] for c in charts)])


def test_every_cell_has_a_letter_and_a_class_and_links_to_its_evidence(page):
    cells = [a["href"] for tag, a in page.tags if tag == "a" and "aria-label" in a]
    ids = {a["id"] for _, a in page.tags if "id" in a}
    assert len(cells) >= 4
    assert {c.removeprefix("#") for c in cells} <= ids
    assert "M met N not met I inconclusive S skipped: not run E error · not planned" in page.text
    classes = " ".join(a.get("class", "") for tag, a in page.tags if tag == "td")
    assert {"agrees", "skipped", "none"} <= set(classes.split())
    assert " M n " in page.text


def test_page_numbers_are_those_of_the_table(page, run):
    assert "0.004 to 0.031" in page.text
    shown = [float(t.replace("−", "-")) for t in re.findall(r"(?<![\w.])−?\d+\.?\d*(?![\w.])", page.text)]
    for row in run.table.gates():
        assert not np.isfinite(row.value) or any(abs(number - row.value) <= 0.005 for number in shown)
    bands = sum(np.isfinite(r.band_nm) for r in run.table)
    assert f"{bands} rows about single bands are in results.csv" in page.text
    assert sum(tag == "tr" for tag, _ in page.tags) < 60


def test_simulated_is_said_everywhere(page, files):
    assert "SIMULATED" in page.text
    assert b"simulated" in files["report.html"].split(b"</title>")[0]
    assert "simulated" not in page_of(simulated=False).text.lower()


def test_names_are_escaped(tmp_path):
    bad = Result(
        "invented", NASTY, NASTY, NASTY, "z", 0.5, NASTY, role=Role.GATE, outcome=Outcome.DISAGREES, reason=NASTY
    )
    nasty = make_run(subjects=(NASTY, "_hidden"), curves=1, rows=[bad], shape=(12, 12))
    nasty = dataclasses.replace(
        nasty, title=NASTY, description=NASTY, notes=(NASTY,), references=(NASTY,),
        provenance={NASTY: NASTY, "inputs": [{"reference": NASTY, "citation": NASTY}]},
        score_maps={f"../{NASTY}": next(iter(nasty.score_maps.values()))},
    )  # fmt: skip
    files = written(nasty, tmp_path / "nasty")
    text = files["report.html"].decode()
    kinds = {"<script>", '<script type="application/json" class="chart">', '<script type="text/plain" class="library">'}
    assert set(re.findall("<script[^>]*>", text)) == kinds
    assert text.count("<script>") == 2
    assert NASTY in Page(text).text
    assert all(".." not in name for name in files)


def test_every_failure_is_on_the_page():
    role = {"role": Role.GATE, "outcome": Outcome.DISAGREES}
    failures = [
        Result("invented", "roc", f"target {i}", "CEM", "pd", 0.25 + i, limit_high=0.5, reason=f"reason {i}", **role)
        for i in range(70)
    ]
    failures += [
        Result("invented", "radiance", "panel", "6S", "z", 3.0, band_nm=400.0 + i, reason=f"band {i}", **role)
        for i in range(30)
    ]
    text = page_of(rows=failures).text
    assert all(row.reason in text and row.subject in text for row in failures)
    assert "Not met." in text


def test_many_skips_are_named_and_do_not_fill_the_page():
    role = {"role": Role.GATE, "outcome": Outcome.SKIPPED, "reason": "too few objects"}
    page = page_of(rows=[Result("invented", "roc", f"target {i}", "CEM", "pd", **role) for i in range(200)])
    assert sum(tag == "tr" for tag, _ in page.tags) < 240  # all but 16 lines of the matrix are folded
    assert all(f"target {i} CEM pd" in page.text for i in range(200))
    assert "201 acceptance criteria were not run" in page.text


def test_disagreements_that_do_not_decide_come_first():
    rows = [
        Result("invented", "roc", f"t{i}", "CEM", "pd_difference", 1.0,
               outcome=Outcome.DISAGREES if i in (50, 70) else Outcome.AGREES) for i in range(90)
    ]  # fmt: skip
    text = page_of(rows=rows).text
    table = text[text.index(" Informational ") :]
    assert table.index(" t50 ") < table.index(" t70 ") < table.index(" t0 ")


def test_the_same_background_of_several_sizes_is_one_row():
    rows = [
        Result("c", "scores", f"felt {size} m background", "cem", "score_sd_ratio", 1.0, outcome=Outcome.AGREES)
        for size in (3, 2, 1)
    ]
    text = page_of(rows=rows).text.replace("\u00a0", " ")
    assert "felt 3 m background and 2 alike" in text
    assert "felt 2 m background" not in text[text.index("Detector scores") :]


def test_pages_of_one_side_do_not_call_themselves_validations():
    rows = ResultTable([Result("s", "roc", "t", "cem/pixel", "pd@1e-2", 0.5)])
    text = Page(report_page(RunReport("s", "S", "", False, rows, kind="Prediction of scenario"), [])).text
    assert not any(word in text for word in ("alidat", "Verdict", "Campaign"))
    assert "One side alone: nothing is compared here." in text


def test_warnings_choices_and_what_a_campaign_can_tell_stand_before_the_matrix():
    """With many subjects the matrix is longer than a screen.  A choice after the data stands after what it was."""
    injected = {"sunlight x 1.05": Injected(), "fill x 0.8": Injected(gates=("scores | all | cem | p",))}
    table = PowerTable(schema=1, campaign="c", version="1", files={}, gates=3, disagreeing=0, errors=injected)
    notes = ["warning: the panels do not lie on one line", "a note", *(f"warning: number {i}" for i in range(3))]
    choices = [("radiance: at most 0.06", "at most 0.05"), ("snr: at most 0.1", "none")]
    text = page_of(change={"chosen_after": choices, "power": table, "notes": notes}).text
    before = text[: text.index("Subject")]
    for words in (
        "Warning: the panels do not lie on one line",
        "1 more warning stands",
        "First: at most 0.05. Now: radiance: at most 0.06.",
        "First: none. Now: snr: at most 0.1.",
        "detect 1 of 2 injected model errors. Undetected: sunlight x 1.05.",
    ):
        assert words in before


def test_falsified_result_turns_the_page(run, page):
    assert run.table.exit_code() == 0
    rows = list(run.table)
    at = next(i for i, r in enumerate(rows) if r.metric.startswith("median_abs") and r.subject == "grass")
    rows[at] = dataclasses.replace(rows[at], value=9.0, outcome=Outcome.DISAGREES)
    after = Page(report_page(dataclasses.replace(run, table=ResultTable(rows)), []))
    told = "Met in part. 1 acceptance criterion was not run (probability of detection: green planks), 5 are met ("
    assert told in page.text
    assert "Not met. 1 acceptance criterion is not met (radiance: grass)" in after.text


def test_nothing_at_all_is_undecided(tmp_path):
    ax = axis(5)
    for number, sides in enumerate(
        [(None, None), (PredictedProducts(ax), ObservedProducts(ax)), (PredictedProducts(ax), None)]
    ):
        files = written(RunReport("empty", "Empty", "", False, ResultTable(), *sides), tmp_path / str(number))
        text = Page(files["report.html"].decode()).text
        assert "nothing is compared here" in text
        assert not any(name.startswith(("figures/", "scores/")) for name in files)


@pytest.mark.parametrize("kept", ["prediction", "observation"])
def test_one_side_alone_is_drawn(kept):
    other = "observation" if kept == "prediction" else "prediction"
    page = page_of(subjects=("grass",), change={other: None, "score_maps": {}, "quicklook": None})
    names = {attributes.get("id") for tag, attributes in page.tags if attributes.get("role") == "group"}
    assert {"chart-radiance-budget", "chart-scores", "chart-abundance"} <= names


def test_what_shows_most_is_embedded_whatever_the_rest_takes():
    """As on the twin's page: sixteen subjects of 360 bands in charts; what does not fit beside them is linked."""
    big = make_run(bands=360, subjects=[f"subject {i}" for i in range(16)], curves=1, shape=(4, 4))
    names = ["score-map-3", "scene", "score-map-2", "score-map-4", "score-map-1-expected", "score-map-1"]
    drawings = [Drawing(n, "scores", n, f"A drawing of {n}.", bytes(200_000), "png") for n in names]
    drawings.append(Drawing("tails", "roc", "tails", "A drawing of tails.", bytes(4_000_000), "png"))
    text = report_page(big, drawings)
    assert len(text.encode()) < MAX_BYTES
    linked = set(re.findall(r'The figure is in <a href="figures/(.+?)\.png"', text))
    assert "tails" in linked
    assert not linked & {"scene", "score-map-1", "score-map-1-expected"}
    assert text.count("<img ") + len(linked) == len(drawings)


def test_time_of_writing_only_when_asked(files, monkeypatch):
    assert b"written 20" not in files["report.html"]
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1348142400")
    assert "written 2012-09-20 12:00 UTC" in page_of().text


def test_an_index_sets_computed_and_simulated_references_apart():
    runs = [
        dataclasses.replace(make_run(curves=1, campaign=name), simulated=name == "twin", computed=name == "network")
        for name in ("flight", "network", "twin")
    ]
    text = Page(index_page(runs, {run.campaign: run.campaign for run in runs})).text
    parts = re.split("Collected imagery|Computed references|Simulated collections", text)
    assert len(parts) == 4
    for name, part in zip(("flight", "network", "twin"), parts[1:], strict=True):
        assert name in part
        assert not any(other in part for other in {"flight", "network", "twin"} - {name})


def test_campaigns_without_their_collection_are_folded_by_what_gets_it():
    run = make_run(curves=1)
    table = ResultTable([dataclasses.replace(r, outcome=Outcome.SKIPPED) for r in run.table])
    runs = [run] + [
        dataclasses.replace(run, campaign=name, table=table, remedy=remedy)
        for name, remedy in (("line 1", "fetch lines"), ("felt", "fetch felts"), ("line 2", "fetch lines"))
    ]
    page = index_page(runs, {r.campaign: r.campaign for r in runs})
    before, after = Page(page).text.split("3 of the 4 campaigns were skipped")
    assert "line 1" not in before
    assert first_screen(list(run.table)).lead in before
    assert re.search("fetch lines\\s+for\\s+line 1\\s*,\\s*line 2\\s+fetch felts\\s+for\\s+felt", after)
    assert 'href="line 2/report.html"' in page
    alone = index_page(runs[1:], {r.campaign: r.campaign for r in runs})
    assert "<details open>" in alone
    assert "Collected imagery" not in Page(alone).text


def test_index_joins_campaigns(run, tmp_path):
    failed = Result(
        "second <b>", "roc", "t", "CEM", "pd", 0.1, role=Role.GATE, outcome=Outcome.DISAGREES, reason="too low"
    )
    second = RunReport("second <b>", "Second", "", False, ResultTable([failed]))
    for one, name in ((run, "invented"), (second, "second_b_")):
        (tmp_path / name).mkdir()
        write_outputs(one, tmp_path / name)
    write_index([run, second], tmp_path)
    page = Page((tmp_path / "report.html").read_text())
    links = [attributes["href"] for tag, attributes in page.tags if tag == "a"]
    pages = list(dict.fromkeys(link.partition("#")[0] for link in links))
    assert pages == ["second_b_/report.html", "invented/report.html"], "collected imagery before simulated"
    assert "Not met." in page.text
    assert "SIMULATED: made by a computer" in page.text
    assert len(json.loads((tmp_path / "results.json").read_text())["rows"]) == len(run.table) + 1
    assert (tmp_path / "junit.xml").read_text().count("<testsuite ") == 2

"""What is written: complete, self-contained, honest, and the same bytes twice."""

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
import xarray as xr
from synthetic_run import NASTY, axis, make_run

from hyperval.figures import Drawing, Print, best_counted, draw_pictures, spectra_figure
from hyperval.products import ObservedProducts, PredictedProducts, RocCurve
from hyperval.report import RunReport, write_index, write_outputs
from hyperval.report import verdict as v
from hyperval.report.html import MAX_BYTES, index_page, report_page, run_drawings
from hyperval.report.run import Injected, PowerTable
from hyperval.results import Outcome, Result, ResultTable, Role

CURVE = RocCurve(*(np.linspace(0.1, 1.0, 4) for _ in range(5)))
# Elements that never have an end tag.
_VOID = {"meta", "img", "br", "link", "input", "hr", "wbr"}


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


def written(run, folder):
    folder.mkdir(parents=True)
    write_outputs(run, folder)
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def run():
    return make_run()


@pytest.fixture(scope="module")
def files(run, tmp_path_factory):
    return written(run, tmp_path_factory.mktemp("report") / "run")


@pytest.fixture(scope="module")
def page(files):
    return Page(files["report.html"].decode())


def test_every_file_of_the_contract_is_there(files):
    expected = {
        "results.csv",
        "summary.csv",
        "results.json",
        "report.html",
        "products.nc",
        "provenance.json",
        "junit.xml",
    }
    expected |= {"scores/yellow_planks-CEM.tif", "scores/yellow_planks-ACE.tif"}
    expected |= {
        f"figures/{name}"
        for name in (
            "scene.png", "score-map-1.png", "score-map-2.png",
        )
    }  # fmt: skip
    assert set(files) == expected


def test_the_summary_is_what_was_planned(files, run):
    header, *rows = csv.reader(files["summary.csv"].decode().splitlines())
    planned = [row for row in run.table if row.planned]
    assert len(rows) == len(planned) < len(run.table)
    at = header.index("outcome")
    assert [row[at] for row in rows] == [str(row.outcome) for row in planned]


SMALL = {"bands": 12, "subjects": ("grass",), "curves": 1, "shape": (12, 12)}


@pytest.mark.slow
def test_second_write_gives_the_same_bytes(tmp_path):
    """Nor do time, process, hash seed, import order and the user's matplotlib settings change any file."""
    here = written(make_run(**SMALL), tmp_path / "here")
    (tmp_path / "matplotlibrc").write_text("font.size: 20\nlines.linewidth: 9\n")
    code = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
        "from synthetic_run import make_run\n"
        "from hyperval.report import write_outputs\n"
        f"write_outputs(make_run(**{SMALL!r}), Path(sys.argv[2]))"
    )
    out = tmp_path / "out"
    out.mkdir()
    environment = {**os.environ, "PYTHONHASHSEED": "12345", "MATPLOTLIBRC": str(tmp_path / "matplotlibrc")}
    subprocess.run([sys.executable, "-c", code, str(Path(__file__).parent), str(out)], check=True, env=environment)
    there = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert [name for name in here if here[name] != there.get(name)] == []
    assert set(here) == set(there)
    assert sum(name.startswith("figures/") for name in here) == 3


def without_scripts(page: str) -> str:
    """A page without the library that draws its charts."""
    return re.sub(r"(?s)<script>.*?</script>", "", page)


def test_page_loads_nothing_from_elsewhere(page, files):
    assert {tag for tag, _ in page.tags}.isdisjoint({"link", "iframe", "object", "embed", "base", "form"})
    for tag, attributes in page.tags:
        for name in ("src", "srcset", "href", "data", "poster", "action", "background"):
            value = attributes.get(name, "data:")
            assert not re.match(r"(?i)\s*(https?:|//|ftp:|file:|javascript:)", value or ""), (tag, value[:80])
    text = files["report.html"].decode()
    assert "url(" not in without_scripts(text)
    assert "@import" not in without_scripts(text)
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
    charts = [json.loads(chart) for chart in held]
    products = ("radiance", "roc", "snr", "reflectance")  # nothing is planned of the last two
    assert [chart["name"] for chart in charts][:3] == ["criteria", "worst", "radiance"]
    assert {chart["name"] for chart in charts} >= set(products)
    assert len(text.encode()) < MAX_BYTES


def test_evidence_comes_before_tables_and_reasons_after_assumptions(files):
    text = files["report.html"].decode()
    places = [text.index(part) for part in (
        'class="verdict', 'class="matrix"', 'alt="Picture of the scene', 'alt="Map of the detector score',
        'id="chart-radiance"', 'id="chart-roc"', 'class="rows"', 'id="assumptions"',
        'id="budget"', 'id="provenance"',
    )]  # fmt: skip
    assert places == sorted(places)


def test_the_chart_of_the_product_that_disagrees_comes_first():
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


def test_simulated_is_said_everywhere(page, files, tmp_path):
    assert "SIMULATED" in page.text
    assert b"simulated" in files["report.html"].split(b"</title>")[0]
    real = Page(report_page(make_run(simulated=False, curves=1), []))
    assert "simulated" not in real.text.lower()
    (tmp_path / "run").mkdir()
    write_outputs(make_run(**SMALL), tmp_path / "run")
    for drawing in run_drawings(tmp_path / "run", Print("svg")):
        assert b"<!-- " in drawing.content  # matplotlib keeps the text of each label as a comment
        assert b"(simulated collection)" in drawing.content


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
    assert set(re.findall("<script[^>]*>", text)) == {
        "<script>",
        '<script type="application/json" class="chart">',
        '<script type="text/plain" class="library">',
    }
    assert text.count("<script>") == 2
    assert NASTY in Page(text).text
    assert all(".." not in name for name in files)


def test_every_failure_is_on_the_page():
    failures = [
        Result("invented", "roc", f"target {i}", "CEM", "pd", 0.25 + i, limit_high=0.5, role=Role.GATE,
               outcome=Outcome.DISAGREES, reason=f"reason {i}") for i in range(70)
    ]  # fmt: skip
    failures += [
        Result("invented", "radiance", "panel", "6S", "z", 3.0, band_nm=400.0 + i, role=Role.GATE,
               outcome=Outcome.DISAGREES, reason=f"band {i}") for i in range(30)
    ]  # fmt: skip
    text = Page(report_page(make_run(rows=failures, curves=1), [])).text
    for row in failures:
        assert row.reason in text
        assert row.subject in text
    assert "Not met." in text


def test_many_skips_are_named_and_do_not_fill_the_page():
    skips = [
        Result(
            "invented",
            "roc",
            f"target {i}",
            "CEM",
            "pd",
            role=Role.GATE,
            outcome=Outcome.SKIPPED,
            reason="too few objects",
        )
        for i in range(200)
    ]
    page = Page(report_page(make_run(rows=skips, curves=1), []))
    assert sum(tag == "tr" for tag, _ in page.tags) < 240  # all but 16 lines of the matrix are folded
    assert all(f"target {i} CEM pd" in page.text for i in range(200))
    assert "201 acceptance criteria were not run" in page.text


def test_disagreements_that_do_not_decide_come_first():
    rows = [
        Result("invented", "roc", f"t{i}", "CEM", "pd_difference", 1.0,
               outcome=Outcome.DISAGREES if i in (50, 70) else Outcome.AGREES) for i in range(90)
    ]  # fmt: skip
    text = Page(report_page(make_run(rows=rows, curves=1), [])).text
    table = text[text.index(" Informational ") :]
    assert table.index(" t50 ") < table.index(" t70 ") < table.index(" t0 ")


def test_every_cell_links_to_its_evidence(page):
    cells = [a["href"] for tag, a in page.tags if tag == "a" and "aria-label" in a]
    ids = {a["id"] for _, a in page.tags if "id" in a}
    assert len(cells) >= 4
    assert {c.removeprefix("#") for c in cells} <= ids


def test_cells_have_a_letter_and_a_class_for_each_outcome(page):
    text = page.text
    assert "M met N not met I inconclusive S skipped: not run E error · not planned" in text
    classes = " ".join(a.get("class", "") for tag, a in page.tags if tag == "td")
    assert {"agrees", "skipped", "none"} <= set(classes.split())
    assert " M n " in text


def test_pages_of_one_side_do_not_call_themselves_validations():
    rows = ResultTable([Result("s", "roc", "t", "cem/pixel", "pd@1e-2", 0.5)])
    run = RunReport("s", "S", "", False, rows, kind="Prediction of scenario")
    text = Page(report_page(run, [])).text
    assert "alidat" not in text
    assert "Verdict" not in text
    assert "Campaign" not in text
    assert "One side alone: nothing is compared here." in text


def test_a_choice_after_the_data_is_printed_after_what_it_was_before():
    choices = [("radiance: at most 0.06", "at most 0.05"), ("snr: at most 0.1", "none")]
    text = Page(report_page(dataclasses.replace(make_run(curves=1), chosen_after=choices), [])).text
    assert "Set after the data were seen. First: at most 0.05. Now: radiance: at most 0.06." in text
    assert "First: none. Now: snr: at most 0.1." in text


def test_warnings_choices_and_what_a_campaign_can_tell_stand_before_the_matrix():
    """With many subjects the matrix is longer than a screen."""
    injected = {"sunlight x 1.05": Injected(), "fill x 0.8": Injected(gates=("scores | all | cem | p",))}
    table = PowerTable(schema=1, campaign="c", version="1", files={}, gates=3, disagreeing=0, errors=injected)
    notes = ["warning: the panels do not lie on one line", "a note", *(f"warning: number {i}" for i in range(3))]
    choices = [("at most 0.06", "at most 0.05")]
    run = dataclasses.replace(make_run(curves=1), chosen_after=choices, power=table, notes=notes)
    text = Page(report_page(run, [])).text
    before = text[: text.index("Subject")]
    assert "Warning: the panels do not lie on one line" in before
    assert "1 more warning stands" in before
    assert "First: at most 0.05" in before
    assert "detect 1 of 2 injected model errors. Undetected: sunlight x 1.05." in before


def test_a_computed_reference_is_no_collected_imagery():
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
    assert v.verdict(run.table)[1] in before
    assert re.search("fetch lines\\s+for\\s+line 1\\s*,\\s*line 2\\s+fetch felts\\s+for\\s+felt", after)
    assert 'href="line 2/report.html"' in page
    alone = index_page(runs[1:], {r.campaign: r.campaign for r in runs})
    assert "<details open>" in alone
    assert "Collected imagery" not in Page(alone).text


def test_falsified_result_turns_the_page(run):
    assert run.table.exit_code() == 0
    rows = list(run.table)
    at = next(i for i, r in enumerate(rows) if r.metric.startswith("median_abs") and r.subject == "grass")
    rows[at] = dataclasses.replace(rows[at], value=9.0, outcome=Outcome.DISAGREES)
    before = Page(report_page(run, []))
    after = Page(report_page(dataclasses.replace(run, table=ResultTable(rows)), []))
    assert (
        "Met in part. 1 acceptance criterion was not run (probability of detection: green planks), 5 are met ("
        in before.text
    )
    assert "Agrees" not in after.text
    assert "Not met. 1 acceptance criterion is not met (radiance: grass)" in after.text


def test_page_numbers_are_those_of_the_table(page, run):
    assert "0.004 to 0.031" in page.text
    for row in run.table.gates():
        if np.isfinite(row.value):
            shown = [float(t.replace("−", "-")) for t in re.findall(r"(?<![\w.])−?\d+\.?\d*(?![\w.])", page.text)]
            assert any(abs(number - row.value) <= 0.005 for number in shown)


def test_per_band_rows_stay_out(page, run):
    bands = sum(np.isfinite(r.band_nm) for r in run.table)
    assert f"{bands} rows about single bands are in results.csv" in page.text
    assert sum(tag == "tr" for tag, _ in page.tags) < 60


def test_nothing_at_all_is_undecided(tmp_path):
    ax = axis(5)
    for number, sides in enumerate(
        [(None, None), (PredictedProducts(ax), ObservedProducts(ax)), (PredictedProducts(ax), None)]
    ):
        empty = RunReport("empty", "Empty", "", False, ResultTable(), *sides)
        files = written(empty, tmp_path / str(number))
        text = Page(files["report.html"].decode()).text
        assert "nothing is compared here" in text
        assert "Agrees" not in text
        assert not any(name.startswith(("figures/", "scores/")) for name in files)


@pytest.mark.parametrize("kept", ["prediction", "observation"])
def test_one_side_alone_is_drawn(kept):
    run = make_run(subjects=("grass",), curves=1)
    other = "observation" if kept == "prediction" else "prediction"
    page = Page(report_page(dataclasses.replace(run, **{other: None}, score_maps={}, quicklook=None), []))
    names = {attributes.get("id") for tag, attributes in page.tags if attributes.get("role") == "group"}
    assert {"chart-radiance-budget", "chart-scores", "chart-abundance"} <= names


def test_what_one_side_alone_holds_gives_way_to_what_can_be_compared():
    run = make_run(subjects=("grass", "lawn"), curves=0, bands=6)
    predicted = dataclasses.replace(run.prediction, snr={"grass": run.prediction.snr["grass"]})
    figure = spectra_figure((predicted, run.observation), "snr")
    assert figure.title.endswith("; 1 of 2 are drawn, all are in products.nc")
    assert "grass" in figure.alt
    assert "lawn" not in figure.alt


def test_pools_of_targets_have_the_first_place_among_too_many_curves():
    curves = {(f"t{i}", "cem", "pixel"): dataclasses.replace(CURVE, n_target=i) for i in range(30)}
    drawn = best_counted(list(curves), curves, 24)
    assert drawn == list(curves)[6:]
    assert best_counted(list(curves)[:5], curves, 24) == list(curves)[:5]


def test_what_shows_most_is_embedded_whatever_the_rest_takes():
    """As on the twin's page: sixteen subjects of 360 bands in charts, and figures that do not fit beside them."""
    big = make_run(bands=360, subjects=[f"subject {i}" for i in range(16)], curves=1, shape=(4, 4))
    names = ["score-map-3", "scene", "score-map-2", "score-map-4", "score-map-1-expected", "score-map-1"]
    drawings = [Drawing(n, "scores", n, f"A drawing of {n}.", bytes(200_000), "png") for n in names]
    text = report_page(big, drawings)
    assert len(text.encode()) < MAX_BYTES
    linked = re.findall(r'The figure is in <a href="figures/(.+?)\.png"', text)
    assert linked
    assert not set(linked) & {"scene", "score-map-1", "score-map-1-expected"}


@pytest.mark.slow
def test_large_run_stays_below_three_megabytes():
    big = make_run(bands=360, subjects=[f"subject {i}" for i in range(12)], curves=4, shape=(300, 300))
    drawings = draw_pictures(big.quicklook, big.score_maps, simulated=True)
    page = report_page(big, drawings)
    assert 1_500_000 < len(page.encode()) < MAX_BYTES
    linked = page.count('The figure is in <a href="figures/')
    assert page.count("<img ") + linked == len(drawings), "those that do not fit are linked"


def test_figures_that_do_not_fit_are_linked():
    drawing = Drawing("score-map-1", "scores", "Map", "A map of scores.", bytes(4_000_000), "png")
    text = report_page(make_run(curves=1), [drawing, dataclasses.replace(drawing, name="tails", section="roc")])
    assert len(text.encode()) < MAX_BYTES
    assert 'href="figures/score-map-1.png"' in text
    assert 'href="figures/tails.png"' in text


def test_score_maps_keep_values_and_place(files, run, tmp_path):
    (tmp_path / "map.tif").write_bytes(files["scores/yellow_planks-CEM.tif"])
    with rasterio.open(tmp_path / "map.tif") as read:
        np.testing.assert_array_equal(read.read(1), run.score_maps["yellow planks-CEM"].values.astype(np.float32))
        assert read.crs.to_epsg() == 32618
        assert tuple(read.transform)[:6] == (0.5, 0, 287000.0, 0, -0.5, 4781000.0)
        assert np.isnan(read.nodata)
        assert read.dtypes == ("float32",)


def test_products_file_holds_both_sides(files, run, tmp_path):
    path = tmp_path / "products.nc"
    path.write_bytes(files["products.nc"])
    for group, side in (("predicted", run.prediction), ("observed", run.observation)):
        with xr.open_dataset(path, group=group, engine="h5netcdf") as data:
            assert list(data["radiance_subject"].values) == list(side.radiance)
            grass = side.radiance["grass"]
            at = list(side.radiance).index("grass")
            np.testing.assert_array_equal(data["radiance"][at], grass.mean)
            np.testing.assert_allclose(data["radiance_error_covariance"][at], grass.error_covariance, rtol=1e-7)
            np.testing.assert_allclose(data["radiance_pixel_covariance"][at], grass.pixel_covariance, rtol=1e-7)
            np.testing.assert_array_equal(data["radiance_uncertainty_from_aerosol"][at], grass.budget["aerosol"])
            assert data["radiance"].attrs["units"] == "uW cm-2 sr-1 nm-1"
            assert all("units" in data[name].attrs for name in data.data_vars)
            key = next(iter(side.roc))
            np.testing.assert_array_equal(data["roc_pd"][0], side.roc[key].pd)
            assert data["roc_subject"].values[0] == key[0]


def test_provenance_is_strict_json(files, run):
    read = json.loads(files["provenance.json"])
    assert read["seed"] == 7
    assert read["inputs"][0]["sha256"] == "ab" * 32


def test_time_of_writing_only_when_asked(files, run, tmp_path, monkeypatch):
    assert b"written 20" not in files["report.html"]
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1348142400")
    small = dataclasses.replace(run, quicklook=None, score_maps={}, prediction=None, observation=None)
    text = Page(written(small, tmp_path / "dated")["report.html"].decode()).text
    assert "written 2012-09-20 12:00 UTC" in text


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


def test_a_page_needs_no_library_that_draws_for_print(tmp_path):
    """matplotlib takes a second and 60 MB; what it draws is made on demand, by ``hyperval figures``."""
    code = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
        "from synthetic_run import make_run\n"
        "from hyperval.report import write_outputs\n"
        f"write_outputs(make_run(**{SMALL!r}), Path(sys.argv[2]))\n"
        "print(*{'matplotlib', 'xarray', 'bokeh'} & set(sys.modules))\n"
    )
    command = [sys.executable, "-c", code, str(Path(__file__).parent), str(tmp_path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout.split() == []

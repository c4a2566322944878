"""Pages of a run, of several, and of two side by side."""

import base64
import dataclasses
import gzip
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import rasterio
from synthetic_run import GATE, NASTY, axis, make_run

from hyperval import cli, report
from hyperval.campaign import PowerTable
from hyperval.errors import InputError
from hyperval.figures import Drawing
from hyperval.products import ObservedProducts, PredictedProducts
from hyperval.results import Outcome, Result, ResultTable, Role, of_campaign, paired
from hyperval.run import SIDES, Run, read_rows, write_table

# What is written: complete, self-contained, honest, and the same bytes twice.


_VOID = {"meta", "img", "br", "link", "input", "hr", "wbr"}  # elements that never have an end tag


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
    return Page(report.report_page(dataclasses.replace(make_run(curves=1, **options), **change), []))


def written(run, folder):
    folder.mkdir(parents=True)
    report.write_outputs(run, folder)
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def row(subject="grass", outcome=Outcome.DISAGREES, **more) -> Result:
    names = {"product": "radiance", "method": "6S", "metric": "bias_ratio", "value": 0.5} | more
    return Result(campaign="invented", subject=subject, **{**GATE, "outcome": outcome}, **names)


@pytest.fixture(scope="module")
def run():
    return make_run()


@pytest.fixture(scope="module")
def files(run, tmp_path_factory):
    return written(run, tmp_path_factory.mktemp("report") / "run")


@pytest.fixture(scope="module")
def text(files):
    return files["report.html"].decode()


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_score_maps_keep_their_values_and_their_place(files, run, tmp_path):
    maps = {"scores/yellow_planks-CEM.tif", "scores/yellow_planks-ACE.tif"}
    assert maps | {f"figures/{name}.png" for name in ("scene", "score-map-1", "score-map-2")} <= set(files)
    (tmp_path / "map.tif").write_bytes(files["scores/yellow_planks-CEM.tif"])
    with rasterio.open(tmp_path / "map.tif") as read:
        np.testing.assert_array_equal(read.read(1), run.score_maps["yellow planks-CEM"].values.astype(np.float32))
        assert (read.crs.to_epsg(), read.dtypes, np.isnan(read.nodata)) == (32618, ("float32",), True)
        assert tuple(read.transform)[:6] == (0.5, 0, 287000.0, 0, -0.5, 4781000.0)


def test_page_loads_nothing_from_elsewhere(page, text):
    assert {tag for tag, _ in page.tags}.isdisjoint({"link", "iframe", "object", "embed", "base", "form"})
    for tag, attributes in page.tags:
        for name in ("src", "srcset", "href", "data", "poster", "action", "background"):
            value = attributes.get(name, "data:")
            assert not re.match(r"(?i)\s*(https?:|//|ftp:|file:|javascript:)", value or ""), (tag, value[:80])
    without_scripts = re.sub(r"(?s)<script>.*?</script>", "", text)
    assert not re.search(r"url\(|@import", without_scripts)
    assert "default-src 'none'" in text


def test_page_runs_no_script_but_those_whose_hash_it_states(text):
    allowed = re.search(r'Content-Security-Policy" content="[^"]*script-src ([^;"]+)', text)[1].split()
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
    assert len(text.encode()) < 3_000_000


def test_evidence_comes_before_tables_and_reasons_after_assumptions(text):
    parts = (
        'class="verdict', 'class="matrix"', 'alt="Scene with its regions', 'alt="Score map yellow',
        'id="chart-radiance"', 'id="chart-roc"', 'class="rows"', 'id="assumptions"', 'id="budget"', 'id="provenance"',
    )  # fmt: skip
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    amiss = report.report_page(make_run(curves=1, rows=[row(product="reflectance", metric="p_value_full")]), [])
    first, second, third = (amiss.index(f'id="chart-{name}"') for name in ("reflectance", "radiance", "snr"))
    assert first < second < third


def test_page_is_balanced_and_every_figure_has_alternative_text(page, files):
    assert page.open == []
    images = [attributes["alt"] for tag, attributes in page.tags if tag == "img"]
    charts = [attributes["aria-label"] for _, attributes in page.tags if attributes.get("role") == "group"]
    assert (len(charts), len(images)) == (11, sum(name.startswith("figures/") for name in files))
    assert all(len(text) > 40 for text in images + charts)


def test_every_cell_has_a_letter_and_a_class_and_links_to_its_evidence(page):
    cells = {a["href"].removeprefix("#") for tag, a in page.tags if tag == "a" and "aria-label" in a}
    assert len(cells) >= 4
    assert cells <= {a["id"] for _, a in page.tags if "id" in a}
    assert "M met N not met I inconclusive S skipped: not run E error · not planned" in page.text
    classes = " ".join(a.get("class", "") for tag, a in page.tags if tag == "td")
    assert {"agrees", "skipped", "none"} <= set(classes.split())
    words = " M n ", "0.004 to 0.031", "80 rows about single bands are in results.csv"
    assert [one for one in words if one not in page.text] == []


def test_names_are_escaped(tmp_path):
    bad = dataclasses.replace(row(NASTY, metric="z", unit=NASTY, reason=NASTY), product=NASTY, method=NASTY)
    nasty = make_run(subjects=(NASTY, "_hidden"), curves=1, rows=[bad], shape=(12, 12))
    said = dict.fromkeys(("title", "description"), NASTY) | dict.fromkeys(("notes", "references"), (NASTY,))
    provenance = {NASTY: NASTY, "inputs": [{"reference": NASTY, "citation": NASTY}]}
    maps = {f"../{NASTY}": next(iter(nasty.score_maps.values()))}
    files = written(dataclasses.replace(nasty, **said, provenance=provenance, score_maps=maps), tmp_path / "nasty")
    text = files["report.html"].decode()
    kinds = {"<script>", '<script type="application/json" class="chart">', '<script type="text/plain" class="library">'}
    assert set(re.findall("<script[^>]*>", text)) == kinds
    assert text.count("<script>") == 2
    assert NASTY in Page(text).text
    assert all(".." not in name for name in files)


def test_every_failure_is_on_the_page_and_many_skips_do_not_fill_it():
    of_curves = {"product": "roc", "method": "CEM", "metric": "pd"}
    failures = [row(f"target {i}", value=0.25 + i, limit_high=0.5, reason=f"why {i}", **of_curves) for i in range(70)]
    failures += [row("panel", metric="z", band_nm=400.0 + i, reason=f"band {i}") for i in range(30)]
    text = page_of(rows=failures).text
    assert [one for made in failures for one in (made.reason, made.subject, "Not met.") if one not in text] == []
    page = page_of(rows=[row(f"target {i}", Outcome.SKIPPED, reason="too few", **of_curves) for i in range(200)])
    assert sum(tag == "tr" for tag, _ in page.tags) < 240  # all but 16 lines of the matrix are folded, under its head
    assert page.text.count("Subject Radiance") == sum(one.get("class") == "matrix" for _, one in page.tags) > 1
    assert all(f"target {i} CEM pd" in page.text for i in range(200))
    assert "201 acceptance criteria were not run" in page.text


def test_disagreements_that_do_not_decide_come_first_and_alike_backgrounds_are_one_row():
    rows = [
        Result("c", "roc", f"t{i}", "CEM", "pd_difference", 1.0,
               outcome=Outcome.DISAGREES if i in (50, 70) else Outcome.AGREES) for i in range(90)
    ]  # fmt: skip
    rows += [
        Result("c", "scores", f"felt {size} m background", "cem", "score_sd_ratio", 1.0, outcome=Outcome.AGREES)
        for size in (3, 2, 1)
    ]
    text = page_of(rows=rows).text.replace("\u00a0", " ")
    table = text[text.index(" Informational ") :]
    assert table.index(" t50 ") < table.index(" t70 ") < table.index(" t0 ")
    assert "felt 3 m background and 2 alike" in text
    assert "felt 2 m background" not in text[text.index("Detector scores") :]


def test_pages_of_one_side_do_not_call_themselves_validations():
    rows = ResultTable([Result("s", "roc", "t", "cem/pixel", "pd@1e-2", 0.5)])
    text = Page(report.report_page(Run(rows, campaign="s", title="S", kind="Prediction of scenario"), [])).text
    assert not re.search("alidat|Verdict|Campaign|simulated", text)
    assert "Prediction or observation only: nothing is compared." in text


def test_warnings_choices_and_what_a_campaign_can_tell_stand_before_the_matrix():
    """With many subjects the matrix is longer than a screen.  A choice after the data stands after what it was."""
    seen = {"sunlight x 1.05": {}, "fill fraction x 0.8": {"gates": ["scores | all | cem | p"]}}
    told = "The criteria detect 1 of 2 injected model errors. Undetected: sunlight x 1.05."
    notes = ["warning: the panels do not lie on one line", "a note", *(f"warning: number {i}" for i in range(3))]
    choices = [("radiance: at most 0.06", "at most 0.05"), ("snr: at most 0.1", "none")]
    facts = {"schema": 1, "campaign": "invented", "version": "1", "files": {}, "gates": 1, "disagreeing": 0}
    power = PowerTable.model_validate({**facts, "errors": seen}), ""
    text = page_of(change={"chosen_after": choices, "power": power, "notes": notes}).text
    before = text[: text.index("Subject")]
    choices = "First: at most 0.05. Now: radiance: at most 0.06.", "First: none. Now: snr: at most 0.1."
    warned = "SIMULATED", "Warning: the panels do not lie on one line", "1 more warning stands"
    assert [words for words in (*warned, *choices, told) if words not in before] == []


def test_nothing_at_all_is_undecided(tmp_path):
    predicted, observed = PredictedProducts(axis(5)), ObservedProducts(axis(5))
    for number, sides in enumerate([(None, None), (predicted, observed), (predicted, None)]):
        given = dict(zip(SIDES, sides, strict=True))
        files = written(Run(ResultTable(), products=given, campaign="empty", title="Empty"), tmp_path / str(number))
        assert "nothing is compared" in Page(files["report.html"].decode()).text
        assert not any(name.startswith(("figures/", "scores/")) for name in files)
    alone = {"products": {"predicted": make_run(curves=1).pair[0]}, "score_maps": {}, "quicklook": None}
    alone = page_of(subjects=("grass",), change=alone)
    names = {attributes.get("id") for _, attributes in alone.tags if attributes.get("role") == "group"}
    assert {"chart-radiance-budget", "chart-scores", "chart-abundance"} <= names


def test_what_shows_most_is_embedded_whatever_the_rest_takes():
    """As on the twin's page: sixteen subjects of 360 bands in charts; what does not fit beside them is linked."""
    big = make_run(bands=360, subjects=[f"subject {i}" for i in range(16)], curves=1, shape=(4, 4))
    names = ["score-map-3", "scene", "score-map-2", "score-map-4", "score-map-1-expected", "score-map-1"]
    drawings = [Drawing(n, "scores", n, f"A drawing of {n}.", bytes(200_000), "png") for n in names]
    drawings.append(Drawing("tails", "roc", "tails", "A drawing of tails.", bytes(4_000_000), "png"))
    text = report.report_page(big, drawings)
    assert len(text.encode()) < 3_000_000
    linked = set(re.findall(r'The figure is in <a href="figures/(.+?)\.png"', text))
    assert linked & {"tails", "scene", "score-map-1", "score-map-1-expected"} == {"tails"}
    assert text.count("<img ") + len(linked) == len(drawings)


def test_time_of_writing_only_when_asked(text, monkeypatch):
    assert "written 20" not in text
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1348142400")
    assert "written 2012-09-20 12:00 UTC" in page_of().text


def test_campaigns_without_their_collection_are_folded_by_what_gets_it():
    run = make_run(curves=1)
    table = ResultTable([dataclasses.replace(r, outcome=Outcome.SKIPPED) for r in run.table])
    runs = [run] + [
        dataclasses.replace(run, campaign=name, table=table, remedy=remedy)
        for name, remedy in (("line 1", "fetch lines"), ("felt", "fetch felts"), ("line 2", "fetch lines"))
    ]
    page = report.index_page(runs, {r.campaign: r.campaign for r in runs})
    before, after = Page(page).text.split("3 of the 4 campaigns were skipped")
    assert "line 1" not in before
    assert report.first_screen(list(run.table)).lead in before
    assert re.search("fetch lines\\s+for\\s+line 1\\s*,\\s*line 2\\s+fetch felts\\s+for\\s+felt", after)
    assert 'href="line 2/report.html"' in page
    alone = report.index_page(runs[1:], {r.campaign: r.campaign for r in runs})
    assert "<details open>" in alone
    assert "Collected imagery" not in Page(alone).text


def test_an_index_joins_campaigns_and_sets_computed_and_simulated_references_apart(run, tmp_path):
    failed = [row(f"{name} background", product="scores") for name in ("felt", "plank")]
    failed += [row(product="snr", outcome=Outcome.SKIPPED)]  # which has no evidence that a link could lead to
    second, network = (Run(ResultTable(of_campaign(failed, n)), campaign=n, title=n) for n in ("second <b>", "network"))
    runs = {"second_b_": second, "network": dataclasses.replace(network, group="Computed references"), "invented": run}
    for name, one in runs.items():
        written(one, tmp_path / name)
    report.write_index(list(runs.values()), tmp_path)
    page = Page((tmp_path / "report.html").read_text())
    links = [attributes["href"].split("#") for tag, attributes in page.tags if tag == "a"]
    assert all(f'id="{place}"' in (tmp_path / file).read_text() for file, *places in links for place in places)
    assert list(dict.fromkeys(file for file, *_ in links)) == [f"{name}/report.html" for name in runs]
    titles = "Collected imagery", "Not met.", "Computed references", "SIMULATED: made by a computer"
    assert [*titles] == sorted(titles, key=page.text.index)
    assert sum(json.loads((tmp_path / "results.json").read_text())["counts"].values()) == len(run.table) + 6
    assert len(list(read_rows(tmp_path))) == len(run.table) + 6
    assert (tmp_path / "junit.xml").read_text().count("<testsuite ") == 3


# Two runs side by side.


def _row(metric="bias_ratio", value=1.0, half=0.1, **more):
    interval = {"lower": value - half, "upper": value + half, "outcome": Outcome.AGREES}
    return Result("c", "radiance", "grass", "sixs", metric, value, role=Role.GATE, **(interval | more))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("pair")
    run = make_run()
    changed = [dataclasses.replace(row, campaign="another") for row in run.table]  # whatever their names
    for i, r in enumerate(changed):
        if r.outcome is Outcome.AGREES:
            changed[i] = dataclasses.replace(r, outcome=Outcome.DISAGREES, value=r.value + 1.0, upper=r.upper + 1.0)
    for name, table in (("a", run.table), ("b", ResultTable(changed))):
        (tmp_path / name).mkdir()
        report.write_outputs(dataclasses.replace(run, table=table), tmp_path / name)
    return tmp_path


def compared(one, other, out) -> str:
    assert cli.run(["-q", "compare", str(one), str(other), "-o", str(out)]) == 0
    return (out / "report.html").read_text("utf-8")


def test_a_stored_table_is_read_back_as_it_was(folders, tmp_path):
    """Also one that repeats the names of the columns in each row: results of earlier days stay comparable."""
    stored = Run.open(folders / "a")
    assert stored.table.frame().equals(make_run().table.frame())
    assert stored.figures
    now = json.loads((folders / "a" / "results.json").read_text())
    rows = [dict(zip(now["columns"], row, strict=True)) for row in now["rows"]]
    (tmp_path / "results.json").write_text(json.dumps({**now, "schema_version": 2, "rows": rows}))
    assert Run.open(tmp_path).table.frame().equals(stored.table.frame())


def test_a_verdict_that_turned_stands_first(folders, tmp_path):
    page = compared(folders / "a", folders / "b", tmp_path / "out")
    changed = page[page.index("Outcomes that changed") : page.index("Values that changed")]
    assert "disagrees" in changed
    assert not re.search(r'(src|href)="https?:|class="chart"', page), "nothing is loaded; the curves are the same"
    assert any(re.search(r"\(met\), B .*\(not met\)", row.reason) for row in read_rows(tmp_path / "out"))


def test_curves_that_moved_stand_in_one_chart(folders, tmp_path):
    run = make_run()
    (tmp_path / "moved").mkdir()
    radiance = {k: dataclasses.replace(e, mean=1.1 * e.mean) for k, e in run.pair[0].radiance.items()}
    table = ResultTable(dataclasses.replace(row, value=row.value * 1.1) for row in run.table)
    moved = {**run.products, "predicted": dataclasses.replace(run.pair[0], radiance=radiance)}
    report.write_outputs(dataclasses.replace(run, products=moved, table=table), tmp_path / "moved")
    page = compared(folders / "a", tmp_path / "moved", tmp_path / "out")
    assert all(words in page for words in ("run B (dashed) and run A", "difference in the windows 10.00%"))  # of A
    assert page.count('id="chart-radiance"') == page.count('id="chart-snr"') == 1


def test_a_run_against_itself_has_no_difference(folders, tmp_path, monkeypatch):
    monkeypatch.setattr("hyperval.report.side_by_side.conclusion", lambda pairs: f"{len(pairs)} in other words")
    page = compared(folders / "a", folders / "a", tmp_path / "same")
    rows = list(read_rows(tmp_path / "same"))
    assert all(r.value == 0 or r.value != r.value for r in rows)
    assert f"{len(rows)} in other words" in page
    assert not re.search("Outcomes that changed|<img", page)
    figures = len(list((folders / "a" / "figures").iterdir()))
    assert f"{figures} of {figures} are the same in both:" in page


def test_a_gate_that_one_run_lacks_is_a_changed_verdict_and_folders_of_one_name_are_told_apart(tmp_path):
    for name, rows in (("old", [_row("bias_ratio"), _row("z")]), ("new", [_row("bias_ratio")])):
        (tmp_path / name / "hysu").mkdir(parents=True)
        write_table(ResultTable(rows), tmp_path / name / "hysu")
    page = compared(tmp_path / "old" / "hysu", tmp_path / "new" / "hysu", tmp_path / "out")
    assert all(words in page for words in ("Outcomes that changed", "old/hysu", "new/hysu"))
    told = [(row.outcome, row.reason) for row in read_rows(tmp_path / "out")]
    assert (told[0][0], told[1]) == (Outcome.NONE, (Outcome.SKIPPED, "only in run A"))


def test_differences_count_in_half_intervals():
    (pair,) = paired(ResultTable([_row(value=1.0)]), ResultTable([_row(value=1.3)]))
    assert (pair.difference, pair.size, pair.verdict_changed) == (pytest.approx(0.3), pytest.approx(3.0), False)
    # Rounding beside an interval of no width is no news.
    (pair,) = paired(ResultTable([_row(half=1e-16)]), ResultTable([_row(value=1.000001, half=1e-16)]))
    assert 0.0 < pair.size < 0.01


@pytest.mark.parametrize("text", ["{}", "[1]", "{", '{"schema_version": 1, "rows": [{"value": 1}]}'])
def test_other_files_are_refused(tmp_path, text, capsys):
    assert cli.run(["compare", str(tmp_path), str(tmp_path), "-o", str(tmp_path / "out")]) == 3
    assert "results.json" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(InputError):
        list(read_rows(tmp_path))

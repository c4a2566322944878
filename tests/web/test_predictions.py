"""Predictions by pages and by the API: what is answered, refused, compared and taken away."""

import io
import re
from html import unescape
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from typer.testing import CliRunner
from web_server import REFUSED

from hyperval.cli import app as command
from hyperval.scenario import Scenario, load_scenario
from hyperval.web import dump, form_data, form_nodes, needs, predefined, view_name, walk
from small_campaign import undrawn

EASY = {"name": "yellow-planks-asphalt"}


def sent_of(text: str) -> list[tuple[str, str]]:
    """What a browser would send of a form, the buttons aside."""
    sent = []
    for inside in re.findall(r"<input ([^>]*)>", text):
        known = dict(re.findall(r'([a-z]+)="([^"]*)"', inside))
        if "name" in known and (known.get("type") not in ("checkbox", "radio") or inside.endswith(" checked")):
            sent.append((known["name"], unescape(known.get("value", ""))))
    for name, options in re.findall(r'<select [^>]*name="([^"]*)"[^>]*>(.*?)</select>', text, re.DOTALL):
        sent += [(name, unescape(value)) for value in re.findall(r"<option selected>([^<]*)", options)]
    return sent


@pytest.mark.parametrize("name", predefined())
def test_form_of_a_scenario_holds_the_scenario(client, server, name):
    page = client.get(f"{server.address}/predict", params={"scenario": name}).text
    given: dict[str, list[str]] = {}
    for key, value in sent_of(page):
        given.setdefault(key, []).append(value)
    sent = Scenario.model_validate({"schema": 1, **form_data(given)})
    assert sent.model_dump() == predefined()[name].model_dump()


def test_form_tells_section_title_unit_limits_and_default():
    sections = form_nodes({"scene": {"classes": [{}]}})
    assert [s.title.partition(",")[0] for s in sections[:5]] == ["Name", "Scene", "Atmosphere", "Sensor", "Processing"]
    nodes = {n.path: n for n in walk(sections)}
    water = nodes["atmosphere.water_vapour_g_cm2"]
    assert (water.title, water.unit, water.limits) == ("water vapour column", "g cm-2", "0.01 to 10")
    assert nodes["formulation"].default == "corrected"
    surface = nodes["scene.classes.0.spectrum.builtin"]
    assert (surface.is_shown, "grey-panel-24" in surface.choices) == (True, True)
    assert not [path for path in nodes if path.endswith((".library", ".measured", ".table", ".replicates", ".records"))]


def test_rest_of_a_form_is_folded_and_opened_by_a_mistake(client, server):
    nodes = {n.path: n for n in walk(form_nodes(dump(load_scenario("yellow-planks-asphalt"))))}
    assert nodes["scene.classes.0.fraction"].is_shown
    assert nodes["scene.classes.0"].is_open
    assert not nodes["scene.classes.0.gain"].is_shown
    assert not nodes["processing.bands"].is_shown, "though it is given"
    assert not nodes["scene.panels.0"].is_open
    told = nodes["scene.targets.0.subjects.1"].summary, nodes["processing.detectors"].limits
    assert told == ("fill fraction 0.05", ""), "boxes to tick are no list to type"
    fields = dict(sent_of(client.get(f"{server.address}/predict", params={"scenario": EASY["name"]}).text))
    sent = {**fields, "scene.classes.0.gain": "-1", "action": "run"}
    text = client.post(f"{server.address}/predict", data=sent, headers={"accept": "text/html"}).text
    folds = text[: text.index('id="f-scene-classes-0-gain"')]
    before, more = folds[: folds.index('id="f-scene-classes-0-fraction"')], '<details class="more"'
    assert folds.count(more) == before.count(more), "before the fold"


def test_source_of_each_value_is_told(client, server):
    url = f"{server.address}/predict"
    fields = dict(sent_of(client.get(url, params={"scenario": EASY["name"]}).text))
    sent = {**fields, "atmosphere.day_of_year": "99", "action": "add:scene.classes"}
    answer, told = client.post(url, data=sent), f"Values are those of {EASY['name']}"
    text, kept = answer.text, answer.headers["cache-control"]
    assert (told in text, kept) == (True, "private"), "else the browser's Back ends in an error"
    for name, is_changed in (("day_of_year", True), ("solar_zenith_deg", False), ("view_zenith_deg", False)):
        field = text[: text.index(f'name="atmosphere.{name}"')]
        assert ("data-changed" in field[field.rindex('<div class="field') :]) == is_changed, name
    assert "12-bit raw data of the AISA Eagle" in client.get(f"{server.address}/sensors/prospectir-vs").text
    numbers = client.get(f"{server.address}/api/v1/sensors/prospectir-vs").json()
    assert all(row["source"] for row in numbers)
    fixed = next(row for row in numbers if row["name"] == "VNIR.fixed_noise_electrons")
    assert (fixed["value"], fixed["unit"]) == ("60", "electrons")


@pytest.mark.parametrize("name", ["yellow-planks-asphalt", "hysu"])
def test_sections_of_a_form_count_what_was_changed(client, server, name):
    url = f"{server.address}/predict"
    fields = sent_of(client.get(url, params={"scenario": name}).text)

    def counts(**changes: str) -> list[str]:
        new = {k.replace("__", "."): v for k, v in changes.items()}
        sent = [*((k, new.get(k, v)) for k, v in fields), ("action", "add:scene.sites")]
        answer = client.post(url, data=sent)
        return re.findall(r'class="changed">(\d+) changed', answer.text)

    assert counts() == []
    changed = counts(scene__targets__0__host="soil", atmosphere__day_of_year="", atmosphere__ground_altitude_km="1")
    day = int(name != "hysu")  # which has no day to be blanked
    assert changed == [str(2 + day), "1", "1", str(1 + day)], "the form, scene, target, atmosphere"


def test_scene_of_a_collection_needs_its_files(client, server, monkeypatch):
    if not needs(predefined()["hysu"]):
        run = client.post(f"{server.address}/api/v1/predictions?wait=60", json={"name": "hysu"}).json()
        assert run["state"] == "finished", run
        assert {"red metal 0.25 m", "bitumen 3 m"} <= {row["subject"] for row in run["summary"]["detection"]}
    monkeypatch.setattr("hyperval.web.forms.missing", lambda name: [name])
    offered = {one["name"]: one["needs"] for one in client.get(f"{server.address}/api/v1/scenarios").json()}
    assert (list(offered), offered["hysu"], offered["panels"]) == ([*predefined()], "hysu", "")
    assert "<code>hyperval data fetch hysu</code>" in client.get(server.address).text
    assert client.post(f"{server.address}/api/v1/predictions", json={"name": "hysu"}).json()["errors"][0] == {
        "field": "scene.targets.0.spectrum.file", "message": "this server lacks the data set hysu"}  # fmt: skip


def test_sensor_file_is_brought_and_used(client, server):
    url = f"{server.address}/api/v1/uploads"
    text = (resources.files("hyperval.sensor") / "library" / "enmap.yaml").read_text()
    assert client.post(url, files=[("sensors", ("草 2.yaml", text))]).json() == {"run": None, "kept": ["草 2.yaml"]}
    assert all("<option>草 2.yaml</option>" in client.get(server.address + at).text for at in ("/predict", "/trade"))
    assert client.get(f"{server.address}/trade/草 2.yaml", params={"sensor": "草 2.yaml"}).text == text
    orders = [{"name": "panels", "settings": {"sensor": name}} for name in ("草 2.yaml", "enmap")]
    mine, library = (client.post(f"{server.address}/api/v1/predictions", json=order).json() for order in orders)
    assert mine["summary"]["snr"] == library["summary"]["snr"]
    assert server.session().post(f"{server.address}/api/v1/predictions", json=orders[0]).status_code == 422
    changed = text.replace("calibration_error_percent", "calibration")
    for name, content, words in (("a.yaml", changed, ""), ("b.yaml", "a: [", ""), ("c.txt", text, "ends with none")):
        answer = client.post(url, files=[("sensors", (name, content))])
        assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "sensors"), name
        assert re.search(words or f"^{name}:(?! {name})", answer.json()["errors"][0]["message"])
        assert str(server.folder) not in answer.text


def test_wrong_value_is_told_at_its_field_and_nothing_runs(client, server):
    before = len(client.get(f"{server.address}/api/v1/runs").json())
    fields = dict(sent_of(client.get(f"{server.address}/predict", params={"scenario": EASY["name"]}).text))
    headers = {"accept": "text/html"}
    for name, value, words in REFUSED["form"]:
        sent = {**fields, name: value, "action": "run"}
        answer = client.post(f"{server.address}/predict", data=sent, headers=headers)
        assert answer.status_code == 422, name
        assert answer.text.count(words) == 1, "at its field"
        assert dict(sent_of(answer.text))["title"] == fields["title"]
    answer = client.post(f"{server.address}/predict", data={**fields, "scene.classes#": "0", "action": "run"})
    assert answer.status_code == 422
    assert "expected 1 or more" in answer.text
    assert len(client.get(f"{server.address}/api/v1/runs").json()) == before


@pytest.mark.slow
def test_scenario_file_of_a_run_gives_the_same_numbers_by_the_command(client, server, tmp_path):
    order = {**EASY, "settings": {"atmosphere.meteorological_range_km": 31.5, "title": "1e5"}}
    run = client.post(f"{server.address}/api/v1/predictions", json=order).json()
    assert run["state"] == "finished", run
    files = f"{server.address}/api/v1/runs/{run['id']}/files"
    (tmp_path / "scenario.yaml").write_bytes(client.get(f"{files}/scenario.yaml").content)
    with pytest.MonkeyPatch.context() as patch:
        undrawn(patch)
        done = CliRunner().invoke(command, ["predict", str(tmp_path / "scenario.yaml"), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0
    assert (tmp_path / "out" / "results.csv").read_bytes() == client.get(f"{files}/results.csv").content
    table = pd.read_csv(io.BytesIO(client.get(f"{files}/results.csv").content))
    for row in run["summary"]["detection"]:
        if row["unit"] == "pixel":
            named = table[(table.subject == row["subject"]) & (table.method == f"{row['detector']}/pixel")]
            value = named[named.metric == f"pd@1e{round(np.log10(row['pfa']))}"]["value"]
            assert row["pd"] == pytest.approx(float(value.iloc[0]), abs=1e-12)
    (tmp_path / "products.nc").write_bytes(client.get(f"{files}/products.nc").content)
    with xr.open_datatree(tmp_path / "products.nc", engine="h5netcdf") as tree:
        assert tree["predicted"]["radiance"].dims == ("radiance_subject", "band")
    assert client.get(f"{files}/report.html").headers["content-type"].startswith("text/html")


@pytest.mark.slow
def test_charts_of_two_runs_have_differences(client, server):
    orders = [{**EASY, "settings": {"atmosphere.meteorological_range_km": km}} for km in (23, 8)]
    runs = [client.post(f"{server.address}/api/v1/predictions", json=order).json()["id"] for order in orders]
    alone = client.get(f"{server.address}/api/v1/runs/{runs[1]}/charts").json()
    assert {"chart-radiance", "chart-snr", "chart-reflectance", "chart-roc"} <= {c["name"] for c in alone}
    # Charts that were kept for other scripts are made again: after an update these could not draw them.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hyperval.web.store._SCRIPTS", "others")
        assert client.get(f"{server.address}/api/v1/runs/{runs[1]}/charts").json() == alone
    kept = server.app.state.runs.place(runs[1])
    assert {view_name("charts"), "charts-others.json"} <= {path.name for path in kept.iterdir()}
    both = client.get(f"{server.address}/api/v1/runs/{runs[1]}/charts", params={"beside": runs[0]}).json()
    radiance = next(c for c in both if c["name"] == "chart-radiance")
    assert "this run / earlier run − 1" in radiance["content"]
    assert "identical" not in radiance["title"]
    assert "Difference" in client.get(f"{server.address}/runs/{runs[1]}", params={"beside": runs[0]}).text


def test_api_needs_four_lines_as_its_page_has_them(server, monkeypatch, capsys):
    undrawn(monkeypatch)
    page = (Path(__file__).resolve().parents[2] / "docs" / "web.md").read_text("utf-8")
    code = page[page.index("    import requests") :].partition("\n\n")[0]
    lines = [line.removeprefix("    ") for line in code.splitlines()]
    assert len(lines) == 4
    exec("\n".join(lines).replace("http://127.0.0.1:8000", server.address), {})  # noqa: S102 - our own page
    assert capsys.readouterr().out.startswith("campaign,product,subject")

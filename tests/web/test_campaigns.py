"""Studies, campaigns and imagery of one's own by the API: what came of them, maps, pixels, progress."""

import base64
import json
import re
import shutil
import threading

import numpy as np
import pytest
import rasterio
from typer.testing import CliRunner
from web_browser import NEEDS_BROWSER, WIDER_THAN_SCREEN, careful_page, picture, serious
from web_server import ORDERED, finished, serve

from hyperval import api, model
from hyperval.cli import app as command
from hyperval.figures import Drawing
from hyperval.run import read_products
from hyperval.web import view_name
from small_campaign import SmallCampaign, scene_data, undrawn, write_yaml


@pytest.fixture(scope="module")
def own(tmp_path_factory, small_collection, atmosphere):
    """A server with a folder of campaigns, one of them the small one."""
    folder = tmp_path_factory.mktemp("own")
    SmallCampaign(shutil.copytree(small_collection, folder / "campaigns" / "small")).write()
    (folder / "campaigns" / "broken").mkdir()
    (folder / "campaigns" / "broken" / "campaign.yaml").write_text("a: [")
    yield from serve(folder / "web", folder / "campaigns", small_collection)


SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"/>'
DRAWINGS = [
    Drawing(name, "scores", name, name, SVG, kind)
    for name, kind in (("scene", "png"), ("scores", "svg"), ("score-map-1", "png"), ("exceedance", "svg"))
]


@pytest.fixture(scope="module")
def run(own):
    client = own.session()
    with pytest.MonkeyPatch.context() as patch:
        undrawn(patch, lambda *_, **__: DRAWINGS)
        told = client.post(f"{own.address}/api/v1/validations", json={"campaign": "small"}).json()
        return client, finished(own, client, told)


def test_campaign_runs_to_the_verdict_of_the_command(own, run, tmp_path):
    client, told = run
    assert {c["name"] for c in client.get(f"{own.address}/api/v1/campaigns").json()} == {"small"}
    rows = api.validate(own.folder.parent / "campaigns" / "small" / "campaign.yaml").results.to_dataframe()
    counts = rows[rows["outcome"] != "none"]["outcome"].value_counts().to_dict()
    assert told["summary"]["counts"] == counts
    assert told["summary"]["status"] in client.get(f"{own.address}/validate").text
    assert client.get(f"{own.address}/runs/{told['id']}/files/report.html").status_code == 200
    shown, folded = client.get(f"{own.address}/runs/{told['id']}").text.split("2 more figures</summary>")
    figures = [re.findall(r'<div class="card (\w+)"><img src="[^"]*/(.+?)"', part) for part in (shown, folded)]
    assert figures[0] == [("png", "scene.png"), ("png", "score-map-1.png")]
    assert sorted(figures[1]) == [("svg", "exceedance.svg"), ("svg", "scores.svg")]


def test_map_holds_the_scores_and_the_curves_read_at_its_threshold(own, run):
    client, told = run
    assert "yellow-cem" in client.get(f"{own.address}/runs/{told['id']}/map").text
    answer = client.get(f"{own.address}/runs/{told['id']}/map.json", params={"name": "yellow-cem"})
    assert answer.status_code == 200, answer.text
    content = answer.json()
    pixels = np.frombuffer(base64.b64decode(content["pixels"]), "<u2").reshape(content["height"], content["width"])
    place = own.app.state.runs.place(told["id"])
    with rasterio.open(place / "results" / "scores" / "yellow-cem.tif") as file:
        scores = file.read(1)
    known = np.isfinite(scores)
    assert pixels.shape == scores.shape == (84, 72)
    restored = (pixels - 1.0) / 65534 * (content["high"] - content["low"]) + content["low"]
    assert np.abs(restored[known] - scores[known]).max() <= (content["high"] - content["low"]) / 65534
    for threshold, count in content["above"]:
        assert np.sum(scores[known].astype(float) >= threshold) == count
    curve = next(c for c in content["curves"] if c["subject"] == "large-planks" and c["unit"] == "pixel")
    at = int(np.searchsorted(curve["pfa"], 1e-2))
    assert 0.0 <= curve["pd"][at] <= 1.0
    assert client.get(f"{own.address}/runs/{told['id']}/map.json", params={"name": "../x"}).status_code == 404


@pytest.mark.slow
@NEEDS_BROWSER
def test_campaign_of_the_folder_is_run_from_its_page_with_live_progress(own, run, browser, monkeypatch):
    observed, compared = threading.Event(), threading.Event()
    monkeypatch.setattr("hyperval.campaign.run.predict", lambda *a, **k: observed.wait(60) and model.predict(*a, **k))
    undrawn(monkeypatch, lambda *_, **__: compared.wait(60) and [])
    context = browser.new_context(base_url=own.address)
    context.set_default_timeout(60_000)
    own.long.gate.clear()
    with careful_page(context, own.address) as page:
        page.goto("/validate")
        page.get_by_role("button", name="Run ").click()
        page.wait_for_selector("#stage:has-text('waiting')")
        own.long.gate.set()
        page.wait_for_selector("#stage:has-text('observe')")
        page.wait_for_function("document.getElementById('done').value > 0")
        observed.set()
        page.wait_for_selector("#stage:has-text('report')")
        compared.set()
        page.wait_for_selector("p.verdict")
        assert page.locator("p.verdict").inner_text() == run[1]["summary"]["verdict"]
        page.get_by_role("link", name="Full report").click()
        page.wait_for_url("**/files/report.html")
        assert page.get_by_text(run[1]["summary"]["verdict"]).count()
        page.goto("/validate")
        assert page.locator("tbody tr").count() == 1, "of this browser"
    context.close()


def place_of(own, told):
    return own.app.state.runs.place(told["id"])


def thresholds_of_targets(page, content, results):
    """P_D and P_FA at every target's score are those of the pixels themselves, counted again on the map's file."""
    with rasterio.open(results / "scores" / "yellow-cem.tif") as file:
        scores = file.read(1).astype(float)
    _, observed = read_products(results).pair
    for number, curve in enumerate(content["curves"]):
        own = curve["target_scores"]
        n = curve["n_target"]
        assert len(own) == n, "these targets are few: all are there"
        if curve["unit"] == "pixel":
            assert observed.scores[curve["subject"], "cem"].n == n
            assert set(own) <= set(scores[np.isfinite(scores)])
        background = np.array(curve["background_scores"])
        assert background.size == 500
        for threshold in own:
            read = "([i, t]) => { const p = curveAt(map.curves[i], t); return [p.pd, p.pfa]; }"
            pd, pfa = page.evaluate(read, [number, threshold])
            assert pd == np.mean(np.array(own) >= threshold)
            above = int(np.sum(background >= threshold))
            if above < 500:
                assert pfa == above / curve["n_background"]


@pytest.mark.slow
@NEEDS_BROWSER
def test_threshold_is_moved_and_a_pixel_clicked_in_a_browser(own, run, browser):
    client, told = run
    context = browser.new_context(base_url=own.address, viewport={"width": 1280, "height": 900})
    context.set_default_timeout(20_000)
    context.add_cookies([{"name": c.name, "value": c.value, "url": own.address} for c in client.cookies])
    url = f"{own.address}/runs/{told['id']}"
    content = client.get(f"{url}/map.json", params={"name": "yellow-cem"}).json()
    with careful_page(context, own.address) as page:
        page.goto(f"{url}/map?name=yellow-cem")
        page.wait_for_selector("#map-words:has-text('P_FA')")
        said = []
        for value in (1000, 600, 0):
            page.locator("#threshold").fill(str(value))
            said.append(page.locator("#map-words").inner_text())
        alarms, pfa, pd = (
            [float(re.search(pattern, words)[1].replace(",", "")) for words in said]
            for pattern in (r"^([\d,]+) pixels?", r"P_FA (?:at \w+ )?([\d.e+-]+)", r"P_D (?:at \w+ )?([\d.]+)")
        )
        assert alarms == sorted(alarms)
        assert "at most" not in "".join(said), "what lies above the first threshold of every curve is counted"
        thresholds_of_targets(page, content, place_of(own, told) / "results")
        assert alarms[-1] == content["known"]
        assert (pfa, pd) == (sorted(pfa), sorted(pd))
        curve = content["curves"][0]
        assert (pfa[-1], pd[-1]) == (pytest.approx(max(curve["pfa"]), abs=0.05), 1.0)
        threshold = float(page.locator("#threshold-value").inner_text())
        assert threshold == pytest.approx(content["above"][-1][0], rel=1e-3, abs=1e-3)
        page.locator("#threshold").fill("800")
        picture(page, "map")
        page.locator("#map-canvas").click(position={"x": 20, "y": 20})
        page.wait_for_selector("#pixel .bk-Column")
        assert page.locator("#line").input_value() == page.locator("#sample").input_value() == "6"
        assert "pixel (6, 6)" in page.locator("#pixel .chart").get_attribute("aria-label")
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert serious(page) == []
        for address in (url, f"{own.address}/validate", f"{own.address}/bring"):
            page.goto(address)
            assert serious(page) == [], address
            page.set_viewport_size({"width": 390, "height": 844})
            assert page.evaluate(WIDER_THAN_SCREEN) <= 1, address
            page.set_viewport_size({"width": 1280, "height": 900})
    context.close()


def test_results_of_the_command_line_below_the_folder_are_seen_by_everybody(own, run):
    _, told = run
    shutil.copytree(place_of(own, told) / "results", own.folder / "by-hand")
    client, api_runs = own.session(), f"{own.address}/api/v1/runs"
    (seen,) = client.get(api_runs).json()
    about = seen["kind"], seen["name"], seen["summary"]["verdict"]
    assert about == ("validation", "small", told["summary"]["verdict"])
    assert told["summary"]["status"] in client.get(f"{own.address}/runs").text
    for part in ("", "/map", "/map.json?name=yellow-cem", "/files/report.html", "/files/results.csv"):
        assert client.get(f"{own.address}/runs/{seen['id']}{part}").status_code == 200, part
    assert client.delete(f"{api_runs}/{seen['id']}").status_code == 409
    shutil.rmtree(own.folder / "by-hand")
    assert client.get(api_runs).json() == []


@pytest.mark.parametrize(("command", "kinds"), ORDERED["written"], ids=str)
def test_results_of_scripts_are_told_by_what_they_hold_and_damaged_ones_not_at_all(own, run, command, kinds):
    """One folder that a script had written below the server's made every list of runs an internal error."""
    group = own.folder / f"group-{len(kinds)}-{len(str(command))}"
    place = shutil.copytree(place_of(own, run[1]) / "results", group / "ŝkript")
    record = json.loads((place / "provenance.json").read_text("utf-8"))
    (place / "provenance.json").write_text(json.dumps(record | {"command": command, "configuration": {"campaign": {}}}))
    shutil.copytree(place, group / ".half-written")
    told = (client := own.session()).get(f"{own.address}/api/v1/runs")
    files = [client.get(f"{own.address}/runs/{one['id']}/files/results.csv").status_code for one in told.json()]
    shutil.rmtree(group)
    assert (told.status_code, files) == (200, [200] * len(kinds))
    assert [one["kind"] for one in told.json()] == kinds
    assert all(one["name"] == "ŝkript" for one in told.json())


def test_maps_and_figures_are_offered_whatever_their_first_letter(own, run):
    """A target of a letter that is none of ASCII has files that begin with an underscore: they were not offered."""
    client, told = run
    results = place_of(own, told) / "results"
    shutil.copy(results / "scores" / "yellow-cem.tif", results / "scores" / "_cker-cem.tif")
    assert "scores/_cker-cem.tif" in client.get(f"{own.address}/api/v1/runs/{told['id']}").json()["files"]
    assert client.get(f"{own.address}/runs/{told['id']}/files/scores/_cker-cem.tif").status_code == 200
    (results / "scores" / "_cker-cem.tif").unlink()


def test_curves_of_a_map_are_those_of_its_target_and_of_no_longer_name(own, run):
    """The map of "large" was shown with the curves of "large-planks"."""
    client, told = run
    scores = place_of(own, told) / "results" / "scores"
    maps = [shutil.copy(scores / "yellow-cem.tif", scores / f"{name}-cem.tif") for name in ("large", "large-planks")]
    url = f"{own.address}/runs/{told['id']}/map.json"
    for name, subjects in (("large", set()), ("large-planks", {"large-planks"})):
        content = client.get(url, params={"name": f"{name}-cem"}).json()
        assert {curve["subject"] for curve in content["curves"]} == subjects
    for path in maps:
        path.unlink()
    own_map = (scores / "yellow-cem.tif").rename(scores / "cem.tif")  # as that of an anomaly detector
    content = client.get(url, params={"name": "cem"}).json()
    own_map.rename(scores / "yellow-cem.tif")
    assert {curve["subject"] for curve in content["curves"]} == {"large-planks", "small-planks"}


def test_pixel_is_shown_beside_the_prediction(own, run):
    client, told = run
    url = f"{own.address}/runs/{told['id']}/pixel.json"
    (chart,) = client.get(url, params={"line": 6, "sample": 6}).json()
    assert "pixel (6, 6)" in chart["alt"]
    assert "field" in chart["subjects"]
    assert client.get(url, params={"line": 6, "sample": 72}).status_code == 409
    assert client.get(url, params={"line": -1, "sample": 0}).status_code == 422
    small = SmallCampaign(own.folder.parent / "campaigns" / "small")
    small.data["collection"]["cube"] |= {"quantity": "counts", "unit": None}
    small.write()
    answer = client.get(url, params={"line": 7, "sample": 7})
    SmallCampaign(small.folder).write()
    small.data["collection"]["cube"]["path"] = "collection/other.img"
    beside = small.write("campaign-other.yaml")  # another campaign of the folder by the same name
    assert client.get(url, params={"line": 8, "sample": 8}).status_code == 200
    beside.unlink()
    assert (answer.status_code, answer.json()["errors"][0]["message"]) == (409, "this run predicted no counts")


@pytest.mark.slow
def test_pixel_of_a_simulated_campaign_is_made_again(own, run):
    """Its collection goes when the campaign has run; the seed gives the same one."""
    client, told = run
    place, folder = own.app.state.runs.place(told["id"]), own.folder.parent / "campaigns" / "small"
    url = f"{own.address}/runs/{told['id']}/pixel.json"
    (before,) = client.get(url, params={"line": 40, "sample": 30}).json()
    (place / view_name("pixel-40-30")).unlink()
    small = SmallCampaign(folder)
    write_yaml(folder / "scene.yaml", scene_data())
    small.data = json.loads(json.dumps(small.data).replace("collection/", "simulated:"))
    small.data["collection"]["simulate"] = "scene.yaml"
    small.write()
    (again,) = client.get(url, params={"line": 40, "sample": 30}).json()
    assert again == before
    assert (place / "collection" / "small_rad.img").is_file()
    SmallCampaign(folder).write()


@pytest.mark.slow
def test_cube_of_the_data_folder_becomes_a_campaign_that_runs_unchanged(own, tmp_path, monkeypatch):
    client = own.session()
    url = f"{own.address}/api/v1/uploads"
    with monkeypatch.context() as patch:
        undrawn(patch)
        run = client.post(url, files={k: (None, v) for k, v in ORDERED["brought"].items()}).json()["run"]
        finished(own, client, run)
    campaign = f"run:{run['id']}"
    with monkeypatch.context() as patch:
        undrawn(patch)
        compared = client.post(f"{own.address}/api/v1/validations", json={"campaign": campaign}).json()
        compared = finished(own, client, compared)
    pixel = client.get(f"{own.address}/runs/{compared['id']}/pixel.json", params={"line": 6, "sample": 6})
    assert pixel.status_code == 200, pixel.text  # it was said that there is no such campaign any more
    section = client.get(f"{own.address}/validate").text.partition(f'value="{campaign}"')[2].partition("</section>")[0]
    assert compared["summary"]["status"] in section
    file = client.get(f"{own.address}/runs/{compared['id']}/files/results.csv")
    assert f'filename="{run["id"]}-results.csv"' in file.headers["content-disposition"]
    text = client.get(f"{own.address}/api/v1/runs/{run['id']}/files/campaign.yaml").content
    (tmp_path / "campaign.yaml").write_bytes(text)
    shutil.copytree(own.app.state.settings.data / "collection", tmp_path / "collection")
    with monkeypatch.context() as patch:
        undrawn(patch)
        words = ["validate", str(tmp_path / "campaign.yaml"), "-o", str(tmp_path / "out")]
        done = CliRunner().invoke(command, words)
    assert done.exit_code in (0, 1), done.output
    _, here = read_products(own.app.state.runs.place(run["id"]) / "results").pair
    predicted, there = read_products(tmp_path / "out").pair
    assert predicted.radiance
    for name, spectrum in here.radiance.items():
        np.testing.assert_array_equal(spectrum.mean, there.radiance[name].mean)
    assert set(here.roc) == set(there.roc)


@pytest.mark.parametrize(
    "name", ["../web/secret", "/etc/passwd", "collection/../../web/secret", "nothing.img", "collection"]
)
def test_no_name_leads_out_of_the_data_folder(own, name):
    client = own.session()
    answer = client.post(f"{own.address}/api/v1/uploads", files={"cube_named": (None, name)})
    assert answer.status_code == 422
    assert "cube_named" in [e["field"] for e in answer.json()["errors"]]
    assert str(own.folder.parent) not in answer.text


def test_study_gives_what_the_api_gives_and_the_value_that_is_needed(own, tmp_path):
    client = own.session()
    told = client.post(f"{own.address}/api/v1/studies", json={"study": ORDERED["study"]}).json()
    told = finished(own, client, told)
    place = own.app.state.runs.place(told["id"])
    shown = [float(r["value"]) for r in told["summary"]["rows"] if r["value"]]
    table = api.open(place / "results").to_dataframe()
    assert table["pd"].iloc[1] > table["pd"].iloc[0]
    assert table["pd"].max() in [pytest.approx(v) for v in shown]
    assert told["done"] == 1.0
    assert "files/scenario.yaml" in client.get(f"{own.address}/runs/{told['id']}").text, "which study.yaml names"


def test_campaign_that_there_is_not_is_refused(own):
    client = own.session()
    for order in [{"campaign": n} for n in ("nothing", "../small", "run:" + 16 * "a", "", "broken")] + [{"more": 1}]:
        answer = client.post(f"{own.address}/api/v1/validations", json={"campaign": "small", **order})
        assert (answer.status_code, [answer.json()["errors"][0]["field"]]) == (422, [*order])
    assert client.delete(f"{own.address}/api/v1/runs/{'a' * 16}").status_code == 404


def test_methods_of_a_path_are_told_whole(own):
    assert own.session().options(f"{own.address}/api/v1/runs/{'a' * 16}").headers["allow"] == "DELETE, GET"

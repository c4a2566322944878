"""The trade desk over HTTP and in a browser."""

import json

import numpy as np
import pytest
from web_browser import NEEDS_BROWSER, careful_page, serious
from web_server import REFUSED

from hyperval import api
from hyperval.study import Trade, complete, next_piece, prepare

ZENITH = "at:atmosphere.solar_zenith_deg"


@pytest.mark.parametrize(("given", "fields"), REFUSED["desk"])
def test_what_is_wrong_is_told_at_its_field(server, client, given, fields):
    told = client.get(f"{server.address}/trade/live", params=given).json()["errors"]
    assert [mistake["field"] for mistake in told] == fields.split()
    shown = client.get(f"{server.address}/trade", params={**given, "side_m": "0.7"})
    assert (shown.status_code, 'name="side_m" value="0.7"' in shown.text) == (422, True)  # what is right stays


def test_what_is_taken_away_gives_the_numbers_of_the_page(server, client, tmp_path, monkeypatch):
    given = {"x_from": "0.01", ZENITH: "50", "background": ["asphalt", "grass"], "wanted": "0.9"}
    told = json.loads(client.get(f"{server.address}/trade/curve", params=given).text.splitlines()[-1])
    assert told["left"] == 0
    notebook = client.get(f"{server.address}/trade/trade.ipynb", params=given).json()
    monkeypatch.chdir(tmp_path)
    room: dict = {}
    for cell in (cell for cell in notebook["cells"] if cell["cell_type"] == "code"):
        exec(cell["source"], room)  # noqa: S102
    text = client.get(f"{server.address}/trade/study.yaml", params=given).text
    assert (tmp_path / "study.yaml").read_text() == text
    assert client.get(f"{server.address}/{text.split()[2].rpartition('=')[2]}").json()["title"] == "StudyFile"
    trade = Trade(x_from=0.01, moved={ZENITH[3:]: 50.0}, background=["asphalt", "grass"])
    trade, now = complete(trade, prepare("yellow-planks-asphalt", trade)), None
    for _ in range(4):
        now = next_piece("yellow-planks-asphalt", trade, now)
    table = api.open(tmp_path / "out").to_dataframe()
    np.testing.assert_allclose(table["pd"], now.values[:, :, 0].ravel(), rtol=1e-9)
    assert all(f" = {v:.4g} for" in w for v, w in zip(table["required-pd"][::33], told["needed"], strict=True))


@NEEDS_BROWSER
@pytest.mark.slow
def test_a_slider_moves_the_curve_of_detection_and_the_study_is_kept(browser, server):
    context = browser.new_context(base_url=server.address, viewport={"width": 1280, "height": 900})
    with careful_page(context, server.address) as page:
        page.goto("/trade?wanted=0.9")
        page.wait_for_selector("#trade[data-ready]")
        before = page.locator("#now").inner_text()
        box = page.locator(".slide input[type=range]").first.bounding_box()
        middle = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + box["width"] / 2, middle)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.8 * box["width"], middle, steps=8)
        page.mouse.up()
        page.wait_for_function("before => at('now').textContent !== before", arg=before)
        page.wait_for_url("**at%3A**")
        page.wait_for_selector("#trade[data-ready]")
        assert " = " in page.locator("#needed").inner_text()
        assert serious(page) == []
        server.long.gate.clear()
        page.get_by_role("button", name="Run with 6S").click()
        page.get_by_role("button", name="Cancel").click()
        server.long.gate.set()
        assert "cancelled" in page.locator("#reason").inner_text()

"""The application in a real browser: what a person does there, by mouse and keyboard, on a desk and on a phone."""

import shutil
from collections.abc import Iterator

import pytest

pytest.importorskip("fastapi", reason="needs the extra web")
sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")

from web_browser import NEEDS_BROWSER, WIDER_THAN_SCREEN, careful_page, picture, serious

from hyperval.campaign import predict_to_folder
from small_campaign import SmallCampaign

pytestmark = [NEEDS_BROWSER, pytest.mark.slow]
PAGES = (
    "/", "/predict", "/predict?scenario=yellow-planks-asphalt", "/trade", "/validate", "/bring", "/runs", "/docs",
    "/sensors", "/sensors/prospectir-vs",
)  # fmt: skip
_LINES_VISIBLE = """() => drawnFigures.get(document.getElementById("chart-roc")).plots
    .flatMap((plot) => plot.renderers).filter((line) => line.tags.length > 0 && line.visible)
    .map((line) => line.tags[0])"""
_OF_RADIANCE = """() => drawnFigures.get(document.getElementById("chart-radiance")).plots
    .map((plot) => plot.renderers.find((line) => line.data_source?.data.y !== undefined).data_source.data.y.length)"""


@pytest.fixture(scope="module")
def context(browser, server) -> Iterator[sync_api.BrowserContext]:
    one = browser.new_context(base_url=server.address, viewport={"width": 1280, "height": 900})
    one.set_default_timeout(20_000)
    yield one
    one.close()


@pytest.fixture
def page(context, server) -> Iterator[sync_api.Page]:
    with careful_page(context, server.address) as one:
        yield one


def predict(page: sync_api.Page, **changes: str) -> None:
    page.goto("/predict?scenario=yellow-planks-asphalt")
    for name, value in changes.items():
        page.locator(f"[name='{name.replace('__', '.')}']").fill(value)
    page.get_by_role("button", name="Run", exact=True).first.click()
    page.wait_for_url("**/runs/*")
    page.wait_for_selector("#charts[data-ready]")


def test_wrong_value_is_marked_at_its_field(page):
    page.goto("/predict?scenario=yellow-planks-asphalt")
    page.locator("[name='atmosphere.water_vapour_g_cm2']").fill("99")
    page.get_by_role("button", name="Run", exact=True).first.click()
    wrong = page.locator("[aria-invalid=true]")
    assert wrong.get_attribute("name") == "atmosphere.water_vapour_g_cm2"
    assert wrong.evaluate("e => e === document.activeElement")
    described = wrong.get_attribute("aria-describedby").split()
    assert "less than or equal to 10" in page.locator(f"#{described[-1]}").inner_text()
    picture(page, "mistake")


def test_no_background_is_caught_and_the_sum_is_shown(page):
    page.goto("/predict?scenario=yellow-planks-asphalt")
    page.locator("[name='scene.classes.0.fraction']").fill("0.5")
    assert page.locator("#total").inner_text() == "0.9"
    assert page.locator("output.changed").inner_text() == "1 changed"
    assert page.locator("summary .changed:visible").all_inner_texts() == ["1 changed", "1 changed"]
    page.get_by_role("button", name="Run", exact=True).first.click()
    assert "sum to 0.9, not 1" in page.locator(".mistake").inner_text()
    page.locator("[name='atmosphere.water_vapour_g_cm2']").fill("99")
    page.get_by_role("button", name="Run", exact=True).first.click()
    field = page.locator("[name='atmosphere.water_vapour_g_cm2']")
    page.locator("details", has=field).last.evaluate("e => { e.open = false; }")
    page.locator("#mistakes a", has_text="water vapour column").click()
    assert field.evaluate("e => e === document.activeElement && e.checkVisibility()")
    field.fill("2")
    for name in ("asphalt", "grass", "soil"):
        page.get_by_role("button", name=f"Remove {name}", exact=True).click()
    page.get_by_role("button", name="Run", exact=True).first.click()
    assert "expected 1 or more" in page.locator(".mistake").inner_text()


def test_classes_are_toggled(page):
    predict(page)
    first = set(page.evaluate(_LINES_VISIBLE))
    assert first == {"yellow plank 0.02", "yellow plank 0.05", "yellow plank 0.1"}
    page.locator("select[data-chart=roc]").select_option("yellow plank 0.05")
    page.wait_for_function(
        "drawnFigures.get(document.getElementById('chart-roc')).chosen.subject === 'yellow plank 0.05'"
    )
    assert page.evaluate(_LINES_VISIBLE) == []
    assert page.evaluate(_OF_RADIANCE) == [360]
    assert not page.evaluate("[...drawnFigures.values()][0].sources.some((s) => 'low' in s.source.data)"), "none stated"


def test_two_runs_are_compared(page):
    predict(page, atmosphere__meteorological_range_km="23")
    predict(page, atmosphere__meteorological_range_km="6")
    page.locator("#beside").select_option(index=1)
    page.get_by_role("button", name="Compare").click()
    page.wait_for_selector("#charts[data-ready]")
    heads = page.locator("#detection th[scope=col]").all_inner_texts()
    assert [h.strip() for h in heads][-2:] == ["Earlier", "Difference"]
    assert page.evaluate(_OF_RADIANCE) == [360, 360], "both runs above, their difference below"
    picture(page, "compared")


def test_cube_is_brought(page, small_collection, tmp_path):
    campaign = SmallCampaign(shutil.copytree(small_collection, tmp_path / "own"))
    page.goto("/bring")
    picture(page, "bring")
    place = campaign.collection
    page.locator("#cube").set_input_files(place / "small_rad.img")
    assert "of at most" in page.locator("#size").inner_text()
    page.locator("#regions").set_input_files(place / "regions.geojson")
    page.locator("#unit").fill("uW cm-2 sr-1 nm-1")
    page.get_by_role("button", name="Upload and run").click()
    assert page.locator(".mistake").all_inner_texts() == ["the ENVI header is needed"]
    assert page.locator("[type=checkbox]:checked").evaluate_all("boxes => boxes.map((box) => box.value)") == [
        "small_rad.img", "regions.geojson"
    ], "what was right is not sent again"  # fmt: skip
    page.locator("#header").set_input_files(place / "small_rad.hdr")
    page.locator("#targets").set_input_files(place / "targets.csv")
    page.locator("#spectra").set_input_files(place / "panel_spectra.csv")
    for field, value in (("name", "mine"), ("time_utc", "2012-09-20T16:31:00Z"), ("altitude_km", "2")):
        page.locator(f"#{field}").fill(value)
    page.locator("#sensor").select_option("prospectir-vs")
    page.get_by_role("button", name="Upload and run").click()
    page.wait_for_selector("#files, #reason", timeout=60_000)
    assert page.locator("#reason").count() == 0, page.locator("#reason").inner_text()
    assert "samples" in page.locator("dl").inner_text()
    page.goto("/bring")
    assert page.get_by_text("Kept: panel_spectra.csv.").count() == 1, "for the scenarios of the session"


def test_what_is_too_large_is_not_sent(page, tmp_path):
    page.goto("/bring")
    (tmp_path / "a.img").write_bytes(b"a" * 70_000_000)
    page.locator("#cube").set_input_files(tmp_path / "a.img")
    assert "too large to send" in page.locator("#size").inner_text()
    assert page.locator("#send").is_disabled()


def test_keyboard_alone(page):
    page.goto("/")
    for _ in range(30):
        page.keyboard.press("Tab")
        if "yellow" in page.evaluate("document.activeElement.textContent"):
            break
    page.keyboard.press("Enter")
    page.wait_for_url("**/predict?scenario=yellow*")
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.value") == "run":
            break
    page.keyboard.press("Enter")
    page.wait_for_selector("#detection")
    assert "/runs/" in page.url


def test_pages_fit_a_phone(page):
    page.set_viewport_size({"width": 390, "height": 844})
    for path in PAGES:
        page.goto(path)
        assert page.evaluate(WIDER_THAN_SCREEN) <= 1, path
        if "yellow" in path:
            picture(page, "phone")
    predict(page)
    assert page.evaluate(WIDER_THAN_SCREEN) <= 1
    assert page.evaluate("labelOf({ label: `${'long '.repeat(9)}[nm]` }, isNarrow())").endswith("\n[nm]"), "not cut"


@pytest.mark.parametrize(("scheme", "pages"), [("light", PAGES), ("dark", PAGES[:3])])
def test_axe_sees_nothing_serious(page, scheme, pages):
    page.emulate_media(color_scheme=scheme)
    predict(page)
    for path in (page.url, *pages):
        page.goto(path)
        assert serious(page) == [], path
    if scheme == "dark":
        picture(page, "dark")


def test_charts_of_a_page_are_all_drawn_and_folded_ones_when_they_are_unfolded(browser, atmosphere, tmp_path):
    """Those that nobody has scrolled to too: the page may be printed."""
    predict_to_folder("panels", tmp_path / "out")
    one = browser.new_context(viewport={"width": 1280, "height": 300})
    one.set_default_timeout(20_000)
    with careful_page(one, tmp_path.as_uri()) as page:
        page.goto((tmp_path / "out" / "report.html").as_uri())
        open_ones, folded = page.locator("figure:not(details *) div.chart"), page.locator("details div.chart")
        assert open_ones.count() >= 2
        assert folded.count() >= 1
        for chart in open_ones.all():
            chart.locator("> *").first.wait_for(state="attached")
        assert folded.locator("> *").count() == 0
        page.get_by_text("Figure: ").last.click()
        folded.last.locator("> *").first.wait_for(state="attached")
    one.close()

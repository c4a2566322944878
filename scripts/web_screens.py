"""Pages of the web application, light and dark, as pictures for docs/web.md.

python scripts/web_screens.py ADDRESS OUT     # of a server that runs: hyperval serve --folder EMPTY

Needs playwright (requirements-dev.lock) and chromium.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from first_screens import small
from playwright.sync_api import Browser, Page, sync_playwright

SCENARIO = "yellow-planks-asphalt"


def opened(browser: Browser, scheme: str, width: int, height: int) -> Page:
    """A page of that size in a session of its own."""
    return browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)


def main() -> None:
    """The form on a telephone, a mistake in it, the run that it makes, and a trade study."""
    address, out = sys.argv[1], Path(sys.argv[2])
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for scheme, ending in (("light", ""), ("dark", "-dark")):
            form = f"{address}/predict?scenario={SCENARIO}"
            phone = opened(browser, scheme, 390, 780)
            phone.goto(form)
            (out / f"web-phone{ending}.png").write_bytes(small(phone.screenshot()))
            page = opened(browser, scheme, 1200, 900)
            page.goto(form)
            page.get_by_label("water vapour column").first.fill("-5")
            page.locator("button.run").last.click()
            page.wait_for_timeout(1500)
            (out / f"web-mistake{ending}.png").write_bytes(small(page.screenshot()))
            page.goto(form)
            page.locator("button.run").last.click()
            page.wait_for_url("**/runs/**")
            page.wait_for_selector("#charts[data-ready]", timeout=300_000)
            (out / f"web-result{ending}.png").write_bytes(small(page.screenshot()))
        page = opened(browser, "light", 1400, 1000)
        page.goto(f"{address}/trade?scenario={SCENARIO}")
        page.wait_for_selector("#trade[data-ready]", timeout=120_000)
        page.wait_for_timeout(2000)
        (out / "screens" / "trade.png").write_bytes(small(page.screenshot()))
        browser.close()


if __name__ == "__main__":
    main()

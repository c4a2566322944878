"""What a reader does with the rendered documentation: follows links, asks five questions, searches, in light and dark.

python scripts/docs_check.py [build/docs] [reports/docs]     # the site of make docs; where screenshots go

Every link to a page of the site leads to a file and an anchor.  Each question is answered from the front page by at
most two clicks.  Exit code 1 where one of this fails.  Needs playwright (requirements-dev.lock) and chromium.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from urllib.parse import unquote, urlsplit

from playwright.sync_api import Page, sync_playwright

# The question as the front page has it; the links that are clicked, by their text; words of the answer.
QUESTIONS = {
    "What failed, and by how much?": (["how to read a verdict", "Not met"], "One of seventeen criteria fails"),
    "Is it the sensor or the atmosphere?": (["attribution"], "points to sensor, light or atmosphere"),
    "How do I run my own cube?": (["a campaign from your own imagery"], "hyperval init --cube"),
    "Which test is this p-value from?": (["which interval, which test", "spectra"], "Hotelling"),
    "How do I add a detector?": (["extending"], "register_detector"),
}
SEARCHES = {"Hotelling": "Which interval, which test", "empirical line": "vocabulary", "FILL_IN": "sensor"}


def broken_links(site: Path) -> list[str]:
    """Links within the site that lead nowhere."""
    pages = {path: path.read_text("utf-8") for path in site.rglob("*.html")}
    anchors = {path: set(re.findall(r'\bid="([^"]+)"', text)) for path, text in pages.items()}
    broken = []
    for path, text in pages.items():
        for link in set(re.findall(r'<(?:a|img)\b[^>]*?\b(?:href|src)="([^"]+)"', text)):
            parts = urlsplit(link)
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            gone = not target.exists() or (parts.fragment and unquote(parts.fragment) not in anchors.get(target, {"*"}))
            if not parts.scheme and gone and anchors.get(target) != {"*"}:
                broken.append(f"{path.relative_to(site)}: {link}")
    return sorted(broken)


def unanswered(page: Page, home: str, out: Path) -> list[str]:
    """Questions whose answer does not stand where the links lead; each is kept as it looks."""
    lost = []
    for number, (question, (clicks, words)) in enumerate(QUESTIONS.items(), 1):
        page.goto(home)
        for step, text in enumerate(clicks):
            row = page.locator(".toc-tree, article") if step else page.locator("tr", has_text=question)
            row.get_by_role("link", name=text, exact=True).first.click()
        page.screenshot(path=out / f"question-{number}.png")
        if words not in page.locator("article").inner_text():
            lost.append(f"{question} {' > '.join(clicks)}: no {words!r}")
    return lost


def fruitless(page: Page, site: Path, out: Path) -> list[str]:
    """Searches that do not find their page."""
    lost = []
    for words, title in SEARCHES.items():
        page.goto(f"{(site / 'search.html').as_uri()}?q={words.replace(' ', '+')}")
        page.wait_for_selector("#search-results li", timeout=10_000)
        page.wait_for_timeout(1000)
        found = page.locator("#search-results").inner_text().lower()
        lost += [] if title.lower() in found else [f"search for {words!r}: no {title!r}"]
    page.screenshot(path=out / "search.png")
    return lost


def main() -> int:
    """Look at everything, and tell."""
    site, out = (Path(word).resolve() for word in (sys.argv[1:] + ["build/docs", "reports/docs"][len(sys.argv) - 1 :]))
    out.mkdir(parents=True, exist_ok=True)
    faults = broken_links(site)
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        home = (site / "index.html").as_uri()
        for scheme in ("dark", "light"):
            page = browser.new_page(viewport={"width": 1440, "height": 900}, color_scheme=scheme)
            page.goto(home)
            page.screenshot(path=out / f"front-{scheme}.png")
        faults += unanswered(page, home, out) + fruitless(page, site, out)
        browser.close()
    print(
        "\n".join(faults) or f"{len(QUESTIONS)} questions answered, {len(SEARCHES)} searches found, links hold: {out}"
    )
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

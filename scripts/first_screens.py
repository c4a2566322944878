"""First screens of finished runs, light and dark, as pictures for the documentation.

python scripts/first_screens.py OUT RUN...              # RUN: folders of results; writes OUT/RUN.png and RUN-dark.png
python scripts/first_screens.py --numbers OUT RUN...    # numbered as docs/reading.md explains: OUT/read-RUN.png
python scripts/first_screens.py --part SELECTOR OUT RUN...   # the first element of the page that the selector names

Needs playwright (requirements-dev.lock) and chromium.
"""

from __future__ import annotations

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

WIDTH, HEIGHT = 1400, 900
COLOURS = 96
# What docs/reading.md explains, in its order: where each stands on the page.
EXPLAINED = (
    ".verdict .status", ".verdict .products", ".columns > section h2", ".columns > div section >> nth=0",
    "h2:text-is('Reason')", "h2:text-is('What to do next')",
)  # fmt: skip
NUMBER = """(found, number) => {
  const at = found.getBoundingClientRect(), badge = document.createElement("b");
  badge.textContent = number;
  badge.style.cssText = "position:absolute;z-index:9;width:28px;height:28px;border-radius:50%;background:#c2410c;" +
    "color:#fff;font:700 18px/28px sans-serif;text-align:center;left:" + Math.max(2, at.left + scrollX - 32) +
    "px;top:" + (at.top + scrollY - 2) + "px";
  document.body.append(badge);
}"""


def small(png: bytes) -> bytes:
    """The picture at three quarters of its size, in few colours."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    picture = picture.resize((picture.width * 3 // 4, picture.height * 3 // 4), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    few = picture.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    few.save(out, format="png", optimize=True)
    return out.getvalue()


def drawn(page: Page, numbers: bool, part: str) -> bytes:
    """The first screen of a page that is open, or one part of it."""
    page.wait_for_timeout(3000)
    if part:
        return page.locator(part).first.screenshot()
    for number, selector in enumerate(EXPLAINED if numbers else (), 1):
        if page.locator(selector).count():
            page.locator(selector).first.evaluate(NUMBER, number)
    return page.screenshot()


def main() -> None:
    """A light and a dark picture of each run that is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--numbers", action="store_true")
    parser.add_argument("--part", default="")
    parser.add_argument("out", type=Path)
    parser.add_argument("runs", type=Path, nargs="+")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for run in asked.runs:
            for scheme, ending in (("light", ""), ("dark", "-dark")):
                page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}, color_scheme=scheme)
                page.goto((run / "report.html").resolve().as_uri())
                content = small(drawn(page, asked.numbers, asked.part))
                name = f"{'read-' * asked.numbers}{run.name}{'-reasons' * bool(asked.part)}{ending}.png"
                (asked.out / name).write_bytes(content)
                print(f"{name}: {len(content) / 1000:.0f} kB")
                page.close()
        browser.close()


if __name__ == "__main__":
    main()

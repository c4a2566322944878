"""Write reports/sample: finished reports that a visitor opens without running anything.

python scripts/sample_reports.py            (make sample-report)

Runs four campaigns, which need their data (HYPERVAL_DATA or hyperval data fetch), and keeps of each the page, the
planned comparisons and the JUnit file.  The same files and versions give the same bytes.  In these pages figures are
pictures, as in print: the library that draws them in the page of a run is not copied into the repository; diagnostics
without limits are left out.
"""

from __future__ import annotations

import base64
import html
import io
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image

from hyperval import cli
from hyperval.report.html import run_drawings

SAMPLE = Path("reports") / "sample"
CAMPAIGNS = ("hysu-2018", "pasadena-2017", "radcalnet-baotou-2018", "share2012-independent")
KEPT = ("report.html", "summary.csv", "junit.xml")
WIDEST, COLOURS = 800, 32  # pixels and colours of a picture
NOT_MET = 1  # a criterion that is not met is a result


def smaller(content: bytes) -> str:
    """A picture as it stands in a page: narrower, of few colours, without loss beyond."""
    out = io.BytesIO()
    image = Image.open(io.BytesIO(content)).convert("RGB")
    image.thumbnail((WIDEST, 3 * WIDEST))
    image.quantize(COLOURS, Image.Quantize.MAXCOVERAGE).convert("RGB").save(out, "webp", lossless=True, method=6)
    return f"data:image/webp;base64,{base64.b64encode(out.getvalue()).decode('ascii')}"


def with_pictures(run: Path) -> str:
    """The page of a run with each of its figures as a picture, without what would draw them and without diagnostics."""
    pictures = {}
    for drawing in run_drawings(run, "png"):
        picture = f'<div class="card"><img src="{smaller(drawing.content)}" alt="{html.escape(drawing.alt)}"></div>'
        pictures.setdefault(drawing.name.removesuffix("-1"), picture)

    def drawn(found: re.Match[str]) -> str:
        return pictures.get(found[1], "<p>hyperval draws this figure in the page of a run.</p>")

    page = (run / "report.html").read_text("utf-8")
    page = re.sub(r'data:image/png;base64,([^"]*)', lambda found: smaller(base64.b64decode(found[1])), page)
    page = re.sub(
        r'(?s)<section><h2>[^<]*</h2>\s*<figure>\s*<div class="chart" id="chart-worst".*?</section>', "", page
    )
    page = re.sub(r'(?s)<div class="chart" id="chart-([^"]*)".*?</noscript>', drawn, page)
    page = re.sub(
        r"(?s)<details><summary>(\d+ diagnostics without limits)</summary>.*?</details>",
        r'<p class="soft">\1 are in the page and in results.csv of a run.</p>', page,
    )  # fmt: skip
    return re.sub(r'(?s)<script type="text/plain" class="library">.*(?=</body>)', "", page)


def main() -> int:
    """Each campaign by itself; what stands in the sample is replaced."""
    os.environ["GIT_DIR"] = os.devnull  # a page cannot name the commit that holds it
    for name in CAMPAIGNS:
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / name
            code = cli.run(["--quiet", "validate", f"campaigns/{name}/campaign.yaml", "-o", str(out)])
            if code > NOT_MET and not (out / KEPT[0]).is_file():
                return code
            shutil.rmtree(SAMPLE / name, ignore_errors=True)
            (SAMPLE / name).mkdir(parents=True)
            (SAMPLE / name / KEPT[0]).write_text(with_pictures(out), "utf-8")
            for kept in KEPT[1:]:
                shutil.copy(out / kept, SAMPLE / name / kept)
        size = sum(path.stat().st_size for path in (SAMPLE / name).iterdir())
        print(f"{name}: {size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())

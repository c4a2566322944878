"""Write docs/reference/metrics.md: every metric of the results table, from the table that comparisons and gates read.

python scripts/metrics_page.py            print it
python scripts/metrics_page.py --write    write it, as the documentation does when it is built
"""

from __future__ import annotations

import sys
from pathlib import Path

from hyperval.metrics import entry, table

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "metrics.md"
HEAD = """# The metrics

Made by `scripts/metrics_page.py` from the table that comparisons, criteria, baselines, reports and the benchmark
read, when the documentation is built; `hyperval metrics` prints the same. `*` stands for what
varies, such as a region of the spectrum. What follows `@` in a row is where the metric was
taken, such as a false-alarm probability.

"Judged as" says how an outcome comes about:

- quantity: met where the whole 95 % interval lies inside the accepted range, not met where it lies outside, else
  inconclusive;
- exact: a number without sampling error, whose value decides;
- test: a p-value. Below its level, which all tests of a campaign of the same level share (Holm), it is not met;
  above it, met where the test had 80 % power against the error that is named, else inconclusive;
- coverage: 1 or 0, inside or outside an interval; 0 is not met, 1 is no agreement of two numbers and inconclusive;
- equivalence: 1 is met, 0 inconclusive, -1 not met;
- statistic: judged by a test of its own, inconclusive under a range.
"""
SECTIONS = (
    ("Spectra, spread and classes", "spectral"),
    ("Scores, detection, false alarms, areas", "detection"),
    ("Attribution, benchmark, studies, accepted numbers", "other"),
    ("Sensor files", "sensors"),
)


def page() -> str:
    """The whole page."""
    lines = [HEAD]
    for title, section in SECTIONS:
        lines += [f"## {title}", ""]
        for metric in table().values():
            lines += entry(metric) if metric.section == section else []
    return "\n".join(lines).rstrip("\n") + "\n"


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        PAGE.parent.mkdir(exist_ok=True)
        PAGE.write_text(page(), "utf-8")
    else:
        print(page(), end="")

"""The page for newcomers is a campaign that runs and passes, as it stands there."""

import re
from pathlib import Path

import pytest

from hyperval.cli import run
from hyperval.results import Outcome
from hyperval.run import Run

PAGE = Path(__file__).parents[2] / "docs" / "first-campaign.md"


@pytest.mark.slow
def test_the_first_campaign_runs_and_passes(tmp_path):
    for name, text in re.findall(r"<!-- file: (\S+) -->\n```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL):
        (tmp_path / name).write_text(text)
    campaign, out = str(tmp_path / "campaign.yaml"), tmp_path / "first"
    assert run(["-q", "validate", "--dry-run", campaign]) == 0
    assert run(["-q", "validate", campaign, "-o", str(out)]) == 0
    table = Run.open(out).table
    passed = table.where(outcome=Outcome.AGREES)
    assert {r.subject for r in passed if r.product == "radiance"} == {"field", "court", "white-panel", "black-panel"}
    # The page closes: seven full tests, each of which has p below 0.002 or above 0.998 once in 250 right models.
    full = {(r.product, r.subject): r.value for r in table if r.metric == "p_value_full"}
    assert set(full) >= {("radiance", "black-panel"), ("reflectance", "field"), ("reflectance", "court")}
    assert all(0.002 < p < 0.998 for p in full.values()), full
    lines = [r for r in table if r.product == "reflectance" and r.subject in ("white-panel", "black-panel")]
    assert len(lines) == 2
    assert all("no degree of freedom" in r.reason for r in lines)  # the line goes through both panels
    assert next(r.value for r in table if r.metric == "pd_inside_interval@1e-2") == 1.0


def test_marks_of_the_file_and_of_the_table_are_the_same():
    text = PAGE.read_text()
    marks = set(re.findall(r"# \(([a-z])\)", text))
    assert marks == set(re.findall(r"^\| ([a-z]) \|", text, re.MULTILINE))

"""A newcomer can get every file that a campaign names."""

from __future__ import annotations

import re
from pathlib import Path

from hyperval.datasets import describe

ROOT = Path(__file__).parents[2]


def test_every_data_reference_of_a_campaign_is_registered():
    unknown = {
        f"{path.relative_to(ROOT)}: {reference}"
        for path in (ROOT / "campaigns").rglob("*.yaml")
        for pair in re.findall(r"""["'](data:[^"']+)["']|(?<!["'])(data:[^\s"',\]}#]+)""", path.read_text("utf-8"))
        for reference in pair
        if reference and describe(reference)["dataset"] is None
    }
    assert unknown == set()

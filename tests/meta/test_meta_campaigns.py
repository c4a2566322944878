"""A newcomer can get every file that a campaign names, and reads in words what its comparisons are of."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hyperval.config import load_yaml
from hyperval.datasets import describe
from hyperval.metrics import plain_words

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


@pytest.mark.parametrize("path", sorted((ROOT / "campaigns").glob("*/campaign*.yaml")), ids=lambda p: p.parent.name)
def test_first_screens_name_no_metric_by_its_identifier(path):
    for item in load_yaml(path)[0]["comparisons"]:
        metric = item["metric"] + "_fraction" * ("fraction_at_least" in item)
        assert "_" not in plain_words(metric, item["product"])

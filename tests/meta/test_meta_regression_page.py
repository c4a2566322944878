"""The examples of docs/regression.md are YAML, and call what there is."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from hyperval.baseline import Accepted, split_key
from hyperval.config import parse_yaml

PAGE = (Path(__file__).parents[2] / "docs" / "regression.md").read_text("utf-8")
EXAMPLES: list[Any] = [
    yaml.safe_load(text) for text in re.findall(r"^```yaml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
]


def texts(node: Any) -> list[str]:
    """Every text of an example."""
    if isinstance(node, dict):
        return [t for value in node.values() for t in texts(value)]
    if isinstance(node, list):
        return [t for value in node for t in texts(value)]
    return [node] if isinstance(node, str) else []


def commands(text: str) -> list[list[str]]:
    return [shlex.split(line)[1:] for line in text.splitlines() if line.strip().startswith("hyperval ")]


def test_both_services_are_there():
    actions, gitlab = EXAMPLES
    steps = actions["jobs"]["check"]["steps"]
    assert all("uses" in step or "run" in step for step in steps)
    assert any(step.get("uses", "").startswith("actions/cache@") for step in steps)
    assert gitlab["hyperval-check"]["artifacts"]["reports"]["junit"] == "check.xml"
    for example in (actions["jobs"]["check"]["env"], gitlab["hyperval-check"]["variables"]):
        assert {"HYPERVAL_DATA", "HYPERVAL_CACHE"} <= set(example)


@pytest.mark.parametrize("example", EXAMPLES)
def test_every_example_checks_and_writes_junit(example):
    (found,) = [c for text in texts(example) for c in commands(text)]
    assert found[0] == "check"
    assert found[found.index("--junit") + 1] == "check.xml"


def test_the_line_of_a_baseline_is_one():
    line = re.search(r'^    (".*\})$', PAGE, re.MULTILINE)[1]
    ((key, entry),) = parse_yaml(line)[0].items()
    assert split_key(key)[0] == "radiance"
    assert Accepted.model_validate(entry).width == 0.002

"""The examples in the docstrings of metrics and intervals are true."""

import doctest
import importlib

import pytest


@pytest.mark.parametrize(
    "name",
    ["compare.spectra", "compare.judge", "model.intervals"],
)
def test_examples(name):
    outcome = doctest.testmod(importlib.import_module(f"hyperval.{name}"))
    assert outcome.attempted > 0
    assert outcome.failed == 0

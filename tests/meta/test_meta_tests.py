"""Tests that cannot fail are found here, and the settings that make pytest strict are held."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

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
    for node in ast.walk(function):
        if isinstance(node, ast.Assert):
            return True
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in {"raises", "warns", "fail"} or name.lstrip("_").startswith("assert"):
                return True
    return False


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


def timed(tree: ast.AST) -> list[int]:
    """Lines of assertions that depend on a clock, themselves or by a name that was set from one."""
    clocks = {"perf_counter", "process_time", "monotonic", "thread_time", "time"}

    def reads_clock(node: ast.AST) -> bool:
        return any(
            isinstance(n, ast.Call)
            and (
                (isinstance(n.func, ast.Attribute) and getattr(n.func.value, "id", "") == "time")
                or isinstance(n.func, ast.Name)
            )
            and getattr(n.func, "attr", getattr(n.func, "id", "")).removesuffix("_ns") in clocks
            for n in ast.walk(node)
        )

    names = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and reads_clock(node.value)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Assert)
        and (reads_clock(node) or any(isinstance(n, ast.Name) and n.id in names for n in ast.walk(node)))
    ]


def parse(text: str) -> ast.FunctionDef:
    (function,) = functions_of(ast.parse(text))
    return function


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("assert f() == 1", True),
        ("with pytest.raises(ValueError): f()", True),
        ("np.testing.assert_allclose(f(), 1)", True),
        ("assert_same(f(), 1)", True),
        ("f() == 1", False),
        ("x.equals(y)", False),
        ("f()", False),
    ],
)
def test_the_check_tells_tests_that_can_fail_from_those_that_cannot(body, expected):
    assert can_fail(parse(f"def test_x():\n    {body}")) is expected


def test_the_check_sees_vacuous_assertions_and_mistyped_marks():
    assert vacuous(parse("def test_x():\n    assert True"))
    assert vacuous(parse("def test_x():\n    assert (f() == 1, 'message')"))
    assert not vacuous(parse("def test_x():\n    assert f()"))
    assert wrong_marks(ast.parse("@pytest.mark.xfail(resaon='x')\ndef test_x(): pass")) == ["xfail(resaon=)"]
    assert wrong_marks(ast.parse("@pytest.mark.xfail(reason='x')\ndef test_x(): pass")) == []


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("begin = time.perf_counter()\nf()\nassert time.perf_counter() - begin < 1", [3]),
        ("took = time.monotonic() - begin\nassert took < 1", [2]),
        ("begin = perf_counter_ns()\nassert f() > begin", [2]),
        ("time.sleep(1)\nassert f()", []),
    ],
)
def test_the_check_sees_assertions_of_time(body, expected):
    assert timed(ast.parse(body)) == expected


def test_no_test_asserts_a_time():
    # A busy machine is no defect of the project; speed is measured in benchmarks/.
    found = {
        str(path.relative_to(ROOT)): lines
        for path in sorted(p for folder in FOLDERS for p in (ROOT / folder).rglob("*.py"))
        if (lines := timed(parsed(path)))
    }
    assert found == {}


def test_every_test_can_fail():
    found = []
    counted = 0
    for path in sorted(p for folder in FOLDERS for p in (ROOT / folder).rglob("test_*.py")):
        tree = parsed(path)
        name = path.relative_to(ROOT)
        for function in functions_of(tree):
            counted += 1
            if not can_fail(function) or vacuous(function):
                found.append(f"{name}:{function.lineno} {function.name}")
        found += [f"{name}: {mark}" for mark in wrong_marks(tree)]
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


def test_a_warning_fails_a_test(pytester):
    pytester.makeini("[pytest]\nfilterwarnings = error\n")
    pytester.makepyfile("import warnings\ndef test_x():\n    warnings.warn('x')\n    assert 1 + 1 == 2\n")
    pytester.runpytest_inprocess().assert_outcomes(failed=1)


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

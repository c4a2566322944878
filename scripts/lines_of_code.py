"""How large the program is, beside what it may take at most (``budgets.toml``).

python scripts/lines_of_code.py                     # lines of code and files of each room, and what else is counted
python scripts/lines_of_code.py FOLDER FOLDER       # rooms of two packages side by side
python scripts/lines_of_code.py --check             # an error where something is over its budget
python scripts/lines_of_code.py --lower             # write today's counts into budgets.toml where they are lower

Lines of code: without blank lines, comments and docstrings.  A budget only falls.  A commit that raises one says in
its message what it lowers instead, a line for each: ``Budget: raises model.lines; lowers study.lines``.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUDGETS = "budgets.toml"
IGNORED = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
    tokenize.ENCODING,
}  # fmt: skip
RAISED = re.compile(r"^Budget: raises (?P<raised>[\w.]+); lowers (?P<lowered>[\w.]+)", re.MULTILINE)
Counts = dict[str, int]


def lines_of(text: str) -> tuple[int, int]:
    """Lines of code, and lines of docstrings."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                documented |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in IGNORED:
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - documented), len(documented)


def rooms(package: Path) -> Counts:
    """Lines and files of each room of a package; modules beside the rooms count as ``root``."""
    counts: Counter[str] = Counter()
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).parts
        room = parts[0] if len(parts) > 1 else "root"
        counts[f"{room}.lines"] += lines_of(path.read_text("utf-8"))[0]
        counts[f"{room}.files"] += 1
    return dict(counts)


def classes(package: Path) -> list[str]:
    """The name of each class of a package, as often as it is defined."""
    trees = (ast.parse(path.read_text("utf-8")) for path in package.rglob("*.py"))
    return [node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]


def inner_imports(tests: Path) -> int:
    """Imports of tests that do not enter by a door: of ``hyperval.room.module``; ``hyperval.room`` is the door."""
    modules = [
        name
        for path in tests.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        for name in (
            [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else [a.name for a in node.names]
            if isinstance(node, ast.Import)
            else []
        )
    ]
    return sum(name.startswith("hyperval.") and name.count(".") > 1 for name in modules)


def measured(root: Path) -> Counts:
    """Everything that has a budget, in the checkout ``root``."""
    package = root / "src" / "hyperval"
    counts = rooms(package)
    names = Counter(classes(package))
    counts["all.lines"] = sum(n for key, n in counts.items() if key.endswith(".lines"))
    counts["all.files"] = sum(n for key, n in counts.items() if key.endswith(".files"))
    counts["all.classes"] = names.total()
    counts["all.class_names_used_twice"] = sum(n > 1 for n in names.values())
    for folder in ("tests", "validation"):
        counts[f"{folder}.lines"] = sum(lines_of(p.read_text("utf-8"))[0] for p in (root / folder).rglob("*.py"))
    counts["tests.inner_imports"] = inner_imports(root / "tests")
    counts["docs.words"] = sum(len(p.read_text("utf-8").split()) for p in (root / "docs").glob("*.md"))
    return counts


def flat(budgets: str) -> Counts:
    """The numbers of a file of budgets by ``room.what``."""
    return {f"{room}.{what}": n for room, whats in tomllib.loads(budgets).items() for what, n in whats.items()}


def raised_unsaid(before: Counts, after: Counts, message: str) -> list[str]:
    """Budgets that a commit raises without naming in its message one that it lowers."""
    lowered = {key for key, n in before.items() if after.get(key, 0) < n}
    said = {m["raised"] for m in RAISED.finditer(message) if m["lowered"] in lowered}
    # A room that is new takes its lines from others: the budget of the whole keeps it honest.
    return sorted(key for key, n in after.items() if key in before and n > before[key] and key not in said)


def git(*arguments: str) -> str:
    """What git prints; nothing where there is no history."""
    answer = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)  # noqa: S603, S607
    return answer.stdout if answer.returncode == 0 else ""


def history() -> list[str]:
    """A line for each commit that raised a budget unsaid, and one for what is not committed yet."""
    problems = []
    for commit in git("log", "--format=%H", "--no-merges", "--", BUDGETS).split():
        before = git("show", f"{commit}^:{BUDGETS}")
        if before:
            after, message = git("show", f"{commit}:{BUDGETS}"), git("log", "-1", "--format=%B", commit)
            problems += [f"{commit[:8]} raises {key}" for key in raised_unsaid(flat(before), flat(after), message)]
    return problems


def over(counts: Counts, budgets: Counts) -> list[str]:
    """What is larger than its budget, or has none."""
    lacking = [f"{key} = {n} has no budget" for key, n in counts.items() if key not in budgets]
    return [f"{key} = {n}, budget {budgets[key]}" for key, n in counts.items() if n > budgets.get(key, n)] + lacking


def check() -> int:
    """Counts against budgets, and budgets against those of earlier commits."""
    problems = over(measured(ROOT), flat((ROOT / BUDGETS).read_text("utf-8"))) + history()
    for problem in problems:
        print(f"over budget: {problem}", file=sys.stderr)
    if problems:
        print(
            "  to fix it: take lines out elsewhere; a commit that raises a budget says in its message\n"
            "  'Budget: raises ROOM.lines; lowers OTHER.lines', and lowers that one",
            file=sys.stderr,
        )
    return 1 if problems else 0


def written(counts: Counts) -> str:
    """The text of ``budgets.toml``."""
    tables: dict[str, dict[str, int]] = {}
    for key, n in counts.items():
        room, _, what = key.partition(".")
        tables.setdefault(room, {})[what] = n
    head = "# The most that each part may take: scripts/lines_of_code.py counts it.  These numbers only fall.\n"
    tail = [
        f"\n[{room}]\n" + "".join(f"{w} = {n}\n" for w, n in whats.items()) for room, whats in sorted(tables.items())
    ]
    return head + "".join(tail)


def lower() -> int:
    """Write what is lower than its budget, and leave out rooms that are gone."""
    path = ROOT / BUDGETS
    budgets = flat(path.read_text("utf-8")) if path.exists() else {}
    path.write_text(written({key: min(n, budgets.get(key, n)) for key, n in measured(ROOT).items()}), "utf-8")
    return 0


def main(arguments: list[str]) -> int:
    """Print the table, or do what is asked for."""
    if arguments == ["--check"]:
        return check()
    if arguments == ["--lower"]:
        return lower()
    counted = [rooms(Path(folder)) for folder in arguments] or [measured(ROOT)]
    for key in sorted({key for counts in counted for key in counts}):
        print(f"{key:32}" + "".join(f"{counts.get(key, 0):9}" for counts in counted))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

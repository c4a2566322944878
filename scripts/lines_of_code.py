"""Lines of code by room, without blank lines, comments and docstrings; and the share of docstrings.

python scripts/lines_of_code.py [FOLDER ...]        # default: src/hyperval; two folders stand side by side
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

IGNORED = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
    tokenize.ENCODING,
}  # fmt: skip


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


def by_room(folder: Path) -> tuple[Counter[str], int, int]:
    """Lines of code of each room below ``folder``, the number of files, and the lines of docstrings."""
    rooms: Counter[str] = Counter()
    files = documented = 0
    for path in sorted(folder.rglob("*.py")):
        code, words = lines_of(path.read_text("utf-8"))
        rooms[path.relative_to(folder).with_suffix("").parts[0]] += code
        files, documented = files + 1, documented + words
    return rooms, files, documented


def main(folders: list[str]) -> int:
    """Print the table; a column for each folder."""
    counted = [by_room(Path(f)) for f in folders or ["src/hyperval"]]
    for room in sorted({room for rooms, _, _ in counted for room in rooms}):
        print(f"{room:24}" + "".join(f"{rooms[room]:9}" for rooms, _, _ in counted))
    print(f"{'all':24}" + "".join(f"{rooms.total():9}" for rooms, _, _ in counted))
    print(f"{'files':24}" + "".join(f"{files:9}" for _, files, _ in counted))
    print(f"{'lines of docstrings':24}" + "".join(f"{words:9}" for _, _, words in counted))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

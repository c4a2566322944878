"""Modules of Python as trees, each parsed once for all tests of a process that look at them."""

import ast
import functools
from pathlib import Path


@functools.cache
def parsed(path: Path) -> ast.Module:
    """The module's tree, which nobody changes."""
    return ast.parse(path.read_text("utf-8"))

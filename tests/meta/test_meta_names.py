"""Identifiers are nouns of what they hold: no participle that needs its author."""

from __future__ import annotations

import io
import tokenize
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "hyperval"
AUTHORS_WORDS = {"found", "held", "told", "asked", "filled", "departed", "remembered"}


def authors_names(text: str) -> set[str]:
    """Names in Python text one of whose parts is such a word."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    names = {t.string for t in tokens if t.type == tokenize.NAME}
    return {n for n in names if AUTHORS_WORDS & set(n.lower().split("_")) or "looked_for" in n}


@pytest.mark.parametrize("path", sorted(SOURCE.rglob("*.py")), ids=lambda p: p.relative_to(SOURCE).as_posix())
def test_names_need_no_author(path):
    assert authors_names(path.read_text("utf-8")) == set()


def test_such_a_name_is_seen():
    assert authors_names("held_before = found(told=1)  # asked") == {"held_before", "found", "told"}

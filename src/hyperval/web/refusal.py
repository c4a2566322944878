"""A request that is refused: what is wrong, at which field, with the status of the answer."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from hyperval.errors import HypervalError

_PATH = re.compile(r"(?<![\w./])(?:/|[A-Za-z]:\\)(?:[^\s:'\",;()<>]+)")
_MOST = 40  # mistakes of one request
_WORDS = {
    "finite_number": "is no finite number",
    "missing": "is missing",
    "extra_forbidden": "is no known field",
}


@dataclass(frozen=True)
class Mistake:
    """One mistake: the dotted path of its field, empty where it concerns the whole, and what is wrong."""

    field: str
    message: str


class Refused(Exception):
    """A request that is not carried out.

    Parameters
    ----------
    status : of the answer
    mistakes : what is wrong, or a sentence
    wait : seconds after which the same request may be tried again
    """

    def __init__(self, status: int, mistakes: Sequence[Mistake] | str, wait: int | None = None):
        self.status, self.wait = status, wait
        self.mistakes = (Mistake("", mistakes),) if isinstance(mistakes, str) else tuple(mistakes)
        super().__init__("; ".join(f"{m.field}: {m.message}" if m.field else m.message for m in self.mistakes))


def to_show(refusal: Refused) -> list[Mistake]:
    """The mistakes that a form is shown again with; a refusal for another reason is raised on."""
    if refusal.status != 422:
        raise refusal
    return list(refusal.mistakes)


def without_paths(text: str) -> str:
    """The text, each absolute path in it cut down to its last name."""
    return _PATH.sub(lambda m: re.split(r"[\\/]", m[0].rstrip("\\/"))[-1] or "a folder", text)


def said(error: HypervalError) -> str:
    """What an error of the package says to someone who does not share its files."""
    parts = [error.what, f"expected: {error.expected}" if error.expected else ""]
    return without_paths("; ".join(part for part in parts if part))


def field_name(location: Sequence[str | int], data: Any, is_missing: bool = True) -> str:
    """The dotted path of a mistake, without the names of tried members of a union, which ``data`` does not hold.

    Parameters
    ----------
    is_missing : whether the last key may be one that ``data`` lacks
    """
    parts: list[str] = []
    at = data
    for number, part in enumerate(location):
        last = number == len(location) - 1
        inside = isinstance(at, list | tuple) and isinstance(part, int) and part < len(at)
        if inside or (isinstance(at, Mapping) and part in at):
            parts.append(str(part))
            at = at[part]
        elif is_missing and isinstance(at, Mapping) and last and isinstance(part, str) and part.isidentifier():
            parts.append(part)
    return ".".join(parts)


def sentence(kind: str, message: str, location: Sequence[str | int]) -> str:
    """A mistake in words."""
    if kind == "too_short" and tuple(location[-1:]) == ("classes",):
        return "no background is chosen: add one at least"
    return _WORDS.get(kind, message.removeprefix("Value error, "))


def mistakes_of(error: ValidationError, data: Any) -> list[Mistake]:
    """Every mistake of ``data`` with its field, each once."""
    listed: dict[Mistake, None] = {}
    for item in error.errors(include_url=False, include_context=False):
        words = sentence(item["type"], item["msg"], item["loc"])
        listed[Mistake(field_name(item["loc"], data)[:200], without_paths(words)[:500])] = None
        if len(listed) >= _MOST:
            break
    return list(listed)

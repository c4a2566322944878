"""Refused requests: what is wrong, at which field, and the status of the response."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, cast

from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse

from hyperval.config import spelled
from hyperval.errors import HypervalError

_PATH = re.compile(r"(?<![\w./])(?:/|[A-Za-z]:\\)(?:[^\s:'\",;()<>]+)")
_MEMBER = re.compile(r"[a-z-]+\[.*|float|int|str|bool")  # of a union, as a mistake is told to be in it
MOST_MISTAKES = 40  # of one request
_WORDS = {
    "finite_number": "is not a finite number",
    "float_parsing": "is not a number, such as 0.5",
    "tuple_type": "is not a list, such as 0.1, 0.6",
    "list_type": "is not a list, such as 450, 700",
    "dict_type": "is not a number, nor one for each name, such as {VNIR: 0.3}",
    "missing": "is missing",
    "extra_forbidden": "is not a known field",
}


@dataclass(frozen=True)
class FieldMistake:
    """One mistake: the dotted path of its field, empty where it concerns the whole, and what is wrong."""

    field: str
    message: str


class Refused(HTTPException):
    """A request that is not carried out.

    Parameters
    ----------
    status : of the answer
    mistakes : what is wrong, or a sentence
    wait : seconds after which the same request may be tried again
    """

    def __init__(self, status: int, mistakes: Sequence[FieldMistake] | str, wait: int | None = None):
        super().__init__(status, headers=None if wait is None else {"retry-after": str(wait)})
        self.mistakes = (FieldMistake("", mistakes),) if isinstance(mistakes, str) else tuple(mistakes)

    def __str__(self) -> str:
        """Every mistake with its field."""
        return "; ".join(f"{m.field}: {m.message}" if m.field else m.message for m in self.mistakes)


def deny(wrong: object, status: int, words: str = "", field: str = "", wait: int | None = None) -> None:
    """Refuse a request where something is wrong, in words, or as the mistakes say that were found.

    >>> deny([], 422), deny("" > "a", 404, "there is no such file")
    (None, None)
    >>> deny([FieldMistake("name", "is missing")], 422)
    Traceback (most recent call last):
    hyperval.web.refusal.Refused: name: is missing
    """
    if wrong:
        raise Refused(status, [FieldMistake(field, words)] if words else cast(Sequence[FieldMistake], wrong), wait)


def problems(status: int, mistakes: Iterable[FieldMistake], headers: Mapping[str, str] | None = None) -> JSONResponse:
    """The answer to a program whose request was refused."""
    headers = {**(headers or {}), **({"connection": "close"} if status == 413 else {})}
    return JSONResponse({"errors": [asdict(mistake) for mistake in mistakes]}, status, headers)


def to_show(refusal: Refused) -> list[FieldMistake]:
    """The mistakes that a form is shown again with; a refusal for another reason is raised on."""
    if refusal.status_code != 422:
        raise refusal
    return list(refusal.mistakes)


def for_pages(text: str) -> str:
    """The text without options of a command, each absolute path in it cut down to its last name."""
    text = re.sub(r" \(--[a-z-]+\)", "", text)
    return _PATH.sub(lambda m: re.split(r"[\\/]", m[0].rstrip("\\/"))[-1] or "a folder", text)


def said(error: HypervalError) -> str:
    """What an error of the package says to someone who does not share its files, and types no options of a command.

    >>> said(HypervalError("collection.cube.unit: of the radiance (--unit)", expected="a unit"))
    'collection.cube.unit: of the radiance; expected: a unit'
    """
    return for_pages(f"{error.what}; expected: {error.expected}" if error.expected else error.what)


def field_name(location: Sequence[str | int], data: Any, is_missing: bool = True) -> str:
    """The dotted path of a mistake, without the names of tried members of a union, which ``data`` does not hold.

    Parameters
    ----------
    is_missing : whether the last key may be one that ``data`` lacks

    >>> data = {"scene": {"classes": [{"name": "grass", "spectrum": {"builtin": 3}}], "fill": 2.0}}
    >>> field_name(("scene", "classes", 0, "spectrum", "str", "builtin"), data), field_name(("scene", "host"), data)
    ('scene.classes.0.spectrum.builtin', 'scene.host')
    >>> field_name(("scene", "fill", "float"), data), field_name(("scene", "host"), data, is_missing=False)
    ('scene.fill', 'scene')
    """
    parts, last = list[str](), str(location[-1] if location else "")
    at: Any = None if isinstance(data, str) else data  # a body that could not be read
    for part in location:
        with suppress(LookupError, TypeError):
            at = at[part]
            parts.append(str(part))
    if is_missing and isinstance(at, Mapping) and last.isidentifier() and parts[-1:] != [last]:
        parts.append(last)
    return ".".join(parts)


def mistake_of(item: Mapping[str, Any], name: str) -> FieldMistake:
    """A mistake that a model found, at the field of a name."""
    kind, words = item["type"], str(item["msg"]).removeprefix("Value error, ")
    if kind == "too_short" and tuple(item["loc"][-1:]) == ("classes",):
        words = "no background is chosen: add at least one"
    elif kind == "string_pattern_mismatch":
        words = spelled(item["ctx"]["pattern"]) or words
    return FieldMistake(name[:200], for_pages(_WORDS.get(kind, words))[:500])


def fitting(items: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """What models found wrong; where something may be one of several, as that which it is nearest to.

    >>> wrong = [{"type": "literal_error", "loc": ("mix", "literal['a']")}]
    >>> wrong += [{"type": "float_type", "loc": ("mix", "function-after[f(), M]", "a")}]
    >>> wrong += [{"type": "missing", "loc": ("mix", "function-after[f(), N]", key)} for key in "bc"]
    >>> [item["loc"][-1] for item in fitting(wrong)]
    ['a']
    """
    members, costs = list[tuple[Any, ...]](), Counter[tuple[Any, ...]]()
    for item in items:
        kind, place = item["type"], tuple(item["loc"])
        number = next((i for i, part in enumerate(place) if _MEMBER.fullmatch(str(part))), -1)
        members.append(place[: number + 1])
        is_of_kind = number < len(place) - 1 or not kind.endswith(("_type", "_parsing", "literal_error"))
        costs[members[-1]] += 9 if not is_of_kind else 2 if kind in ("missing", "extra_forbidden") else 1
    least = {member[:-1]: costs[member] for member in sorted(costs, key=costs.__getitem__, reverse=True)}
    return [i for i, m in zip(items, members, strict=True) if not m or costs[m] == least[m[:-1]]]


def mistakes_of(error: ValidationError, data: Any) -> list[FieldMistake]:
    """Every mistake of ``data`` with its field, each once."""
    every = fitting(error.errors(include_url=False))
    return list(dict.fromkeys(mistake_of(item, field_name(item["loc"], data)) for item in every))[:MOST_MISTAKES]

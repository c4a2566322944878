"""Refused requests: what is wrong, at which field, and the status of the response."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, cast

from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse

from hyperval.config import mistakes_in
from hyperval.errors import HypervalError

_PATH = re.compile(r"(?<![\w./])(?:/|[A-Za-z]:\\)(?:[^\s:'\",;()<>]+)")
MAX_MISTAKES = 40  # of one request


@dataclass(frozen=True)
class FieldMistake:
    """One mistake: the dotted path of its field, empty where it concerns the whole, and what is wrong."""

    field: str
    message: str


class Refusal(HTTPException):
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
    hyperval.web.refusal.Refusal: name: is missing
    """
    if wrong:
        raise Refusal(status, [FieldMistake(field, words)] if words else cast(Sequence[FieldMistake], wrong), wait)


def json_error(status: int, mistakes: Iterable[FieldMistake], headers: Mapping[str, str] | None = None) -> JSONResponse:
    """The answer to a program whose request was refused."""
    headers = {**(headers or {}), **({"connection": "close"} if status == 413 else {})}
    return JSONResponse({"errors": [asdict(mistake) for mistake in mistakes]}, status, headers)


def form_mistakes(refusal: Refusal) -> list[FieldMistake]:
    """The mistakes that a form is shown again with; a refusal for another reason is raised on."""
    if refusal.status_code != 422:
        raise refusal
    return list(refusal.mistakes)


def redact(text: str) -> str:
    """The text without options of a command, each absolute path in it cut down to its last name."""
    text = re.sub(r" \((?:or )?--[a-z-]+\)", "", text)
    return _PATH.sub(lambda m: re.split(r"[\\/]", m[0].rstrip("\\/"))[-1] or "a folder", text)


def error_text(error: HypervalError) -> str:
    """The text of an error for a web page: without paths of the server and options of the command line.

    >>> error_text(HypervalError("collection.cube.unit: of the radiance (--unit)", expected="a unit (or --scale)"))
    'collection.cube.unit: of the radiance; expected: a unit'
    """
    return redact(f"{error.what}; expected: {error.expected}" if error.expected else error.what)


def mistakes_of(items: Sequence[Any]) -> list[FieldMistake]:
    """Mistakes that pydantic finds, each once, with its field."""
    found = (FieldMistake(".".join(map(str, place))[:200], redact(said)[:500]) for place, said in mistakes_in(items))
    return list(dict.fromkeys(found))[:MAX_MISTAKES]

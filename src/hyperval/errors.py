"""The errors a user can meet, each with the exit code of the command-line contract.

Every message says what is wrong, where, what was expected and how to fix it.  The
command line prints the message alone; the Python API raises the exception.
"""

from __future__ import annotations

import difflib
import os
import shlex
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_ROOT = Path(__file__).parent
_CALLS = 4
WARNING = "warning: "  # what a note that warns begins with


class HypervalError(Exception):
    """Base class: something the user can mend."""

    exit_code = 4

    def __init__(self, what: str, *, where: str | None = None, expected: str | None = None, mend: str | None = None):
        self.what, self.where, self.expected, self.mend = what, where, expected, mend
        parts = [f"{where}: {what}" if where else what]
        if expected:
            parts.append(f"expected: {expected}")
        if mend:
            parts.append(f"to fix it: {mend}")
        super().__init__("\n  ".join(parts))


class UsageError(HypervalError):
    """A command, campaign or scenario that is not valid (exit code 2)."""

    exit_code = 2


class InputError(HypervalError):
    """An input file that is missing, corrupt or contradicts its description (exit code 3)."""

    exit_code = 3


class MissingDataError(InputError):
    """A data set that is not at hand; ``mend`` names the command that fetches it (exit code 3)."""


class EngineError(HypervalError):
    """An external engine (6S, MODTRAN) that is missing or failed (exit code 3)."""

    exit_code = 3


@contextmanager
def told_of(whose: str, file: str = "") -> Iterator[None]:
    """Inside, a refusal says whose it is, and in which file where it does not say so itself."""
    try:
        yield
    except UsageError as error:
        where = ": ".join(part for part in (whose, error.where or file) if part)
        raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from error


def refusal(name: str, where: object = None, /, **values: object) -> HypervalError:
    """The error of a name in ``refusals.yaml``: what is wrong, what was expected, how to mend it, filled with values.

    >>> refusal("header.missing", "a.hdr", key="bands").what
    "the key 'bands' is missing"
    """
    words = package_table("refusals.yaml")[name]
    parts = {key: str(words[key]).format(**values) for key in ("expected", "mend") if key in words}
    kind = UsageError if words.get("usage") else EngineError if words.get("engine") else InputError
    return kind(words["what"].format(**values), where=None if where is None else str(where), **parts)


@cache
def package_table(name: str) -> dict[str, Any]:
    """The content of a YAML file of the package, by its path below it."""
    import yaml  # of the few runs that need one

    found: dict[str, Any] = yaml.load((_ROOT / name).read_text("utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # noqa: S506
    return found


def filled_words(table: str, name: str, /, **values: object) -> str:
    """The words of a name in a YAML file of the package, filled with values in braces."""
    return str(package_table(table)[name]).format(**values)


@cache
def worded(table: str, name: str) -> Callable[..., str]:
    """The words of a name in a YAML file of the package, a template to be filled with values.

    >>> worded("compare/words.yaml", "few_pixels.distance")(fewest=4.0, size=6)
    '4 independent pixels for 6 directions'
    """
    from jinja2 import Environment, StrictUndefined  # of the few runs that need it

    environment = Environment(undefined=StrictUndefined)  # noqa: S701 - plain text
    environment.filters["f"] = format
    return environment.from_string(package_table(table)[name]).render


def refuse(wrong: object, name: str, where: object = None, /, **values: object) -> None:
    """Raise the error of a name in ``refusals.yaml`` where something is wrong."""
    if wrong:
        raise refusal(name, where, **values)


def needed(value: T | None, name: str, where: object = None, /, **values: object) -> T:
    """A value; raises the error of a name in ``refusals.yaml`` where it is None."""
    if value is None:
        raise refusal(name, where, **values)
    return value


def as_typed(*words: object) -> str:
    """A command of this program as a user types it: paths with blanks are quoted."""
    return shlex.join(("hyperval", *map(str, words)))


def one_of(names: Iterable[str], otherwise: str = "a name") -> str:
    """What was expected, in words: one of the names, or ``otherwise`` where there is none."""
    listed = ", ".join(names)
    return f"one of {listed}" if listed else otherwise


def nearest(name: str, names: Iterable[str], most: int = 1) -> list[str]:
    """Of names those that are most alike to one, whatever their case; of names that differ in case alone the first.

    >>> nearest("PD_Difference", ["z", "pd_difference"]), nearest("casi-1500", ["CASI-1500", "casi-1500", "hymap"], 3)
    (['pd_difference'], ['CASI-1500'])
    """
    by_lower = {one.lower(): one for one in reversed([*names])}
    return [by_lower[k] for k in difflib.get_close_matches(name.lower(), by_lower, most)]


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """The end of a sentence on an unknown name, where another is much alike."""
    return "".join(f"; did you mean {near!r}?" for near in nearest(name, names))


def reader(function: Callable[P, R]) -> Callable[P, R]:
    """Wrap a function that reads the file named by its first argument.

    Whatever damage raises is an InputError; so is a pipe or device, of which nobody knows whether it ever ends.
    """

    @wraps(function)
    def read(*args: P.args, **options: P.kwargs) -> R:
        named = next(iter((*args, *options.values())), "")
        try:
            path = named if isinstance(named, str | Path) else "."
            if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
                raise InputError("is a pipe, socket or device", where=str(named), expected="a regular file")
            return function(*args, **options)
        except HypervalError:
            raise
        except Exception as error:
            words = str(error).splitlines()[0][:200] if str(error) else "no more is known"
            what = f"damaged, or not of the kind that its name says ({type(error).__name__}: {words})"
            place = f"{str(named)[:300]}:{getattr(error, 'lineno', '')}".rstrip(":")
            raise InputError(what, where=place, mend="correct it there, or copy the file again") from error

    return read


def words_and_code(error: Exception) -> tuple[str, int]:
    """What is said of an error that ended a run, and the exit code; anything but ours is an internal error."""
    if isinstance(error, HypervalError):
        return str(error), error.exit_code
    return internal_error(error), HypervalError.exit_code


def internal_error(error: Exception) -> str:
    """Words for an internal error: what it is, and where it arose, the innermost place first."""
    places = []
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path.is_relative_to(_ROOT):
            places.append(f"{path.relative_to(_ROOT.parent).as_posix()}:{frame.lineno}")
        elif not places:
            places.append(f"{path.name}:{frame.lineno}")
    where = f" (at {', called from '.join(places[:_CALLS])})" if places else ""
    return f"internal error: {type(error).__name__}: {error}{where}"

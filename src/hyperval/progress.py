"""Progress on standard error for anything over two seconds; silent when nobody watches, or a listener is told."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, _GeneratorContextManager, closing, contextmanager, nullcontext
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress

T = TypeVar("T")
_step: ContextVar[str] = ContextVar("step", default="")
_wanted: ContextVar[bool | None] = ContextVar("wanted", default=None)
Parts = Iterator[tuple[range, Any]]  # of a pass over an image: the lines of each, and what they hold
Listener = Callable[[str, int, int | None], None]
_listener: Listener | None = None


def set_listener(listener: Listener | None) -> None:
    """Tell a function of this process what is being done, how many parts of it are, and of how many.

    It is told whether or not bars are drawn; where it is there, they are drawn for a caller alone who asks for them.
    """
    global _listener  # noqa: PLW0603 - one for a process, as its standard error is
    _listener = listener


@contextmanager
def within(variable: ContextVar[T], value: T | None) -> Iterator[None]:
    """A value of a context variable for the block; None: as outside of it."""
    token = variable.set(variable.get() if value is None else value)
    try:
        yield
    finally:
        variable.reset(token)


def step(job: str, number: int, count: int, what: str) -> AbstractContextManager[None]:
    """Bars within the block are labelled as step ``number`` of ``count`` of ``job``."""
    return within(_step, f"{job} {number}/{count} {what}: ")


def bars(show: bool | None) -> _GeneratorContextManager[None]:
    """Whether bars are drawn within the block, or the function that this decorates; None: as outside of it."""
    return within(_wanted, show)


@contextmanager
def working(what: str) -> Iterator[None]:
    """A bar that moves and counts the time while the block works on what has no parts to count."""
    with closing(track(iter([None]), what, columns=("TimeElapsed",))) as whole:
        next(whole)
        yield


def _shown(show: bool | None = None) -> bool:
    show = _wanted.get() if show is None else show
    return _listener is None and sys.stderr.isatty() if show is None else show


def _bar(*columns: str) -> Progress:
    """A bar of the task's name, itself, and columns of these names; what draws it is loaded when somebody watches."""
    from rich import progress
    from rich.console import Console

    parts = [getattr(progress, f"{name}Column")() for name in ("Bar", *columns)]
    words = progress.TextColumn("{task.description}")
    return progress.Progress(words, *parts, console=Console(stderr=True), transient=True)


def track(
    items: Iterable[T], what: str, total: int | None = None, *, show: bool | None = None,
    columns: Sequence[str] = ("MofNComplete", "TaskProgress", "TimeRemaining"), size: Callable[[T], int] = lambda _: 1,
) -> Generator[T, None, None]:  # fmt: skip
    """Yield ``items`` while a progress bar named ``what`` is drawn on standard error, and the listener learns of each.

    ``show`` defaults to what :func:`bars` says, else to whether standard error is a terminal.  The bar is removed when
    done.  ``size`` says how much of the ``total`` an item is.
    """
    if total is None and hasattr(items, "__len__"):
        total = len(items)  # type: ignore[arg-type]
    done, name = 0, _step.get() + what
    with _bar(*columns) if _shown(show) else nullcontext() as bar:
        task: Any = bar and bar.add_task(name, total=total)
        for item in items:
            if _listener is not None:
                _listener(name, done, total)
            yield item
            done += size(item)
            if bar:
                bar.update(task, completed=done)


def watch_lines(what: str, bytes_per_line: int, lines: int) -> Callable[[Parts], Parts]:
    """A wrapper of the parts of a pass over an image: bytes done, rate and time left on standard error."""
    columns, show = ("Download", "TransferSpeed", "TimeRemaining"), _shown()
    return lambda parts: track(
        parts, what, lines * bytes_per_line, show=show, columns=columns, size=lambda part: len(part[0]) * bytes_per_line
    )

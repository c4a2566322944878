"""Progress on standard error for anything over two seconds; silent when nobody watches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

T = TypeVar("T")


def track(items: Iterable[T], what: str, total: int | None = None, *, show: bool | None = None) -> Iterator[T]:
    """Yield ``items`` while a progress bar named ``what`` is drawn on standard error.

    ``show`` defaults to whether standard error is a terminal.  The bar is removed when done.
    """
    if show is None:
        show = sys.stderr.isatty()
    if not show:
        yield from items
        return
    if total is None and hasattr(items, "__len__"):
        total = len(items)  # type: ignore[arg-type]
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        yield from bar.track(items, description=what, total=total)


def watch_lines(
    what: str, bytes_per_line: int, lines: int, *, show: bool | None = None
) -> Callable[[Iterator[tuple[range, Any]]], Iterator[tuple[range, Any]]]:
    """A wrapper of the parts of a pass over an image: bytes done, rate and time left on standard error.

    Each part begins with the range of its lines; ``show`` as for :func:`track`.
    """

    def watched(parts: Iterator[tuple[range, Any]]) -> Iterator[tuple[range, Any]]:
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            DownloadColumn(),
            TransferSpeedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        ) as bar:
            task = bar.add_task(what, total=lines * bytes_per_line)
            for part in parts:
                bar.advance(task, (part[0].stop - part[0].start) * bytes_per_line)
                yield part

    return watched if (sys.stderr.isatty() if show is None else show) else iter

"""Progress on standard error for anything over two seconds; silent when nobody watches."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

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

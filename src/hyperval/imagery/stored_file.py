"""A file that is opened once for many reads, by several threads at stated places."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy.typing as npt

from hyperval.errors import InputError


class OpenedFile:
    """A file that is opened for each read or, inside :meth:`kept_open`, once for all of them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._opened: Any = None
        self._users = 0

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process opens it for itself."""
        return type(self), (self.path,)

    def open(self) -> Any:
        """The opened file."""
        raise NotImplementedError

    @contextmanager
    def kept_open(self) -> Iterator[Any]:
        """The opened file, closed when the last of its users has left."""
        with self._lock:
            if self._opened is None:
                self._opened = self.open()
            self._users += 1
        try:
            yield self._opened
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    self._opened.close()
                    self._opened = None


class StoredFile(OpenedFile):
    """A file that several threads read at stated places."""

    def open(self) -> BinaryIO:
        """The file without a buffer of its own."""
        stream = open(self.path, "rb", buffering=0)  # noqa: SIM115 - closed when its last user leaves
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_SEQUENTIAL)
        return stream

    def fill(self, out: npt.NDArray[Any], offset: int) -> None:
        """Read a contiguous array from a place in the file.

        Raises
        ------
        InputError : the file ends before.
        """
        view = memoryview(out.reshape(-1).view("u1").data)  # contiguous, so this is no copy
        done = 0
        with self.kept_open() as stream:
            while done < len(view):
                step = self._read(stream, view[done:], offset + done)
                if not step:
                    raise InputError("the file became shorter while it was read", where=str(self.path))
                done += step

    def _read(self, stream: BinaryIO, view: memoryview, offset: int) -> int:
        if hasattr(os, "preadv"):
            return os.preadv(stream.fileno(), [view], offset)
        with self._lock:
            stream.seek(offset)
            return stream.readinto(view) or 0  # type: ignore[attr-defined]

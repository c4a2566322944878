"""A file that several threads read at stated places."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy.typing as npt

from hyperval.errors import InputError


class StoredFile:
    """A file, opened for each read or, inside :meth:`kept_open`, once for all of them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._stream: BinaryIO | None = None
        self._users = 0

    def __reduce__(self) -> tuple[type[StoredFile], tuple[Path]]:
        """Another process opens it for itself."""
        return type(self), (self.path,)

    @contextmanager
    def kept_open(self) -> Iterator[BinaryIO]:
        """The open file, closed when the last of its users has left."""
        with self._lock:
            if self._stream is None:
                self._stream = open(self.path, "rb", buffering=0)  # noqa: SIM115 - closed below
                if hasattr(os, "posix_fadvise"):
                    os.posix_fadvise(self._stream.fileno(), 0, 0, os.POSIX_FADV_SEQUENTIAL)
            stream = self._stream
            self._users += 1
        try:
            yield stream
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    stream.close()
                    self._stream = None

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

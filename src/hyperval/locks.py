"""Claims on files by running processes: gone with the process, however it ends."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

try:
    import fcntl
except ImportError:  # no such claims on this system: everything goes on without
    fcntl = None  # type: ignore[assignment]

_QUIET_S = 60.0  # the number of a process on another machine may be that of none here


class Claim:
    """A file that one process claims for itself until it releases it or ends.

    Parameters
    ----------
    path : the file; made where it is not there, with the number of the process in it

    Raises
    ------
    BlockingIOError : another process claims it.
    OSError : it cannot be made.
    """

    def __init__(self, path: Path):
        self.path = path
        while True:
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
            try:
                self._lock()
                if self._is_current():
                    break
            except BaseException:
                os.close(self._handle)
                raise
            os.close(self._handle)  # removed by the one that had it, between opening and claiming
        os.ftruncate(self._handle, 0)
        os.write(self._handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())

    def release(self) -> None:
        """Remove the file where it still is the claimed one, and let go."""
        if self._is_current():
            self.path.unlink(missing_ok=True)
        os.close(self._handle)

    def _lock(self) -> None:
        if fcntl is None:
            return
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:  # a file system without claims
            return

    def _is_current(self) -> bool:
        mine = os.fstat(self._handle)
        try:
            there = os.lstat(self.path)
        except OSError:
            return False
        return (mine.st_dev, mine.st_ino) == (there.st_dev, there.st_ino)


def claimed_by(path: Path) -> str:
    """The words of the process that claims ``path``, empty where they cannot be read."""
    try:
        with open(path, "rb") as stream:
            return stream.read(200).decode("utf-8", "replace").strip()
    except OSError:
        return ""


def is_left(path: Path, process: int) -> bool:
    """Whether a file or folder was left by a process of this machine that ended a while ago."""
    try:
        if time.time() - os.lstat(path).st_mtime < _QUIET_S:
            return False
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:  # it is gone, or the process is another user's
        return False
    return False

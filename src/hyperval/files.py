"""Writing files whole or not at all, and naming what was read."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hyperval.errors import InputError, UsageError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path``; it takes the place of ``path`` when the block ends well."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole, with Unix line ends."""
    with whole_file(path) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


@contextmanager
def whole_folder(path: Path, *, ours: str | None = None) -> Iterator[Path]:
    """Give a temporary folder beside ``path``; its content replaces ``path`` when the block ends well.

    The folder that stood at ``path`` is kept until the new one is complete.

    Parameters
    ----------
    ours : a file that every folder of this kind holds; a folder with other content is never replaced

    Raises
    ------
    UsageError : ``path`` is a file, or a folder that holds something but not ``ours``, or nothing can be written
        there.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise UsageError("is a file", where=str(path), expected="a folder for the results")
    if ours and path.is_dir() and any(path.iterdir()) and not (path / ours).is_file():
        raise UsageError(
            f"holds files but no {ours}, and would be replaced as a whole",
            where=str(path),
            mend="name a new folder, or an empty one",
        )
    temporary = _folder_beside(path)
    try:
        yield temporary
        os.chmod(temporary, 0o777 & ~_umask())
        if path.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{path.name}.old.", dir=path.parent))
            os.replace(path, old / "previous")
            try:
                os.replace(temporary, path)
            except OSError:
                os.replace(old / "previous", path)
                raise
            finally:
                shutil.rmtree(old, ignore_errors=True)
        else:
            os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _folder_beside(path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise UsageError(
            f"no folder can be made here: {error.strerror}", where=str(path), mend="name another folder"
        ) from error


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read: {error.strerror}", where=str(path)) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask

"""Writing files whole or not at all, and naming what was read."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from hyperval.errors import InputError
from hyperval.locks import is_left


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path``; it takes the place of ``path`` when the block ends well.

    What a killed process left of ``path`` is removed first.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{path.name[:60]}.hyperval-"  # the name itself may be as long as a name can be
    left = re.compile(re.escape(prefix) + r"(\d+)-[a-z0-9_]{8}" + re.escape(path.suffix))
    for name in os.listdir(path.parent):
        match = left.fullmatch(name)
        if match and is_left(path.parent / name, int(match[1])):
            (path.parent / name).unlink(missing_ok=True)
    handle, name = tempfile.mkstemp(prefix=f"{prefix}{os.getpid()}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(temporary, 0o666 & ~umask())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole, with Unix line ends."""
    with whole_file(path) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


@contextmanager
def scratch_folder(purpose: str, beside: Path | None = None) -> Iterator[Path]:
    """Give a folder for temporary files, removed at the end; those that killed processes left are removed first.

    Parameters
    ----------
    purpose : one word that stands in its name
    beside : the folder in which it is made, made where it is not there; default: that of temporary files
    """
    place = Path(tempfile.gettempdir()) if beside is None else beside
    place.mkdir(parents=True, exist_ok=True)
    start = f".hyperval-{purpose}-" if beside is not None else f"hyperval-{purpose}-"
    remove_left(place, start)
    with tempfile.TemporaryDirectory(
        prefix=f"{start}{os.getpid()}-", dir=place, ignore_cleanup_errors=True
    ) as folder:
        yield Path(folder)


def remove_left(place: Path, start: str) -> None:
    """Remove the folders in ``place`` that killed processes left: ``start``, their number, eight letters."""
    exact = re.compile(re.escape(start) + r"(\d+)-[a-z0-9_]{8}")
    for name in os.listdir(place):
        match = exact.fullmatch(name)
        if match and is_left(place / name, int(match[1])):
            shutil.rmtree(place / name, ignore_errors=True)


def decoded(raw: bytes) -> str:
    """Text in UTF-8 (with or without mark) or else Latin-1."""
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal; of a folder that of the names and digests of its files."""
    if path.is_dir():
        listed = [f"{p.relative_to(path).as_posix()}\0{sha256_of(p)}\n" for p in files_within(path)]
        return hashlib.sha256("".join(listed).encode()).hexdigest()
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read: {error.strerror}", where=str(path)) from error


def git_blob_of(path: Path) -> str:
    """The id that git gives a file's content, in hexadecimal: SHA-1 of ``blob SIZE`` and a zero byte before it."""
    digest = hashlib.sha1(b"blob %d\0" % path.stat().st_size, usedforsecurity=False)
    with open(path, "rb") as stream:
        while part := stream.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()


def has_digest(path: Path, digest: str) -> bool:
    """Whether a file has the digest ``sha256:HEX`` or ``git-blob:HEX``."""
    kind, _, value = digest.partition(":")
    return (sha256_of(path) if kind == "sha256" else git_blob_of(path)) == value


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    return sum(p.stat().st_size for p in files_within(path)) if path.is_dir() else path.stat().st_size


def installed_file(package: str, *parts: str) -> Path:
    """A file of an installed package, which is not imported for it."""
    spec = find_spec(package)
    assert spec is not None  # noqa: S101
    assert spec.origin is not None  # noqa: S101
    return Path(spec.origin).parent.joinpath(*parts)


def files_within(folder: Path) -> list[Path]:
    """The files below a folder, in the order of their names."""
    return sorted(p for p in folder.rglob("*") if p.is_file())


def umask() -> int:
    """The permissions that this process takes from what it makes."""
    mask = os.umask(0)
    os.umask(mask)
    return mask

"""Files and folders written whole or not at all, claims on them by running processes, and digests of what was read.

An output folder lists the files that a run wrote in ``.hyperval.json``; one that holds anybody else's files is
refused, and one run at a time may write it.  New content is made inside the folder under a name of its own and then
moved over the old, file by file.  The file that makes it a folder of results goes first and comes back last, so that
a change that was cut off is finished by the next run.  Nothing beside the folder is written or removed: neighbours,
mounts, links and the working directory need no care.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import secrets
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from importlib.util import find_spec
from pathlib import Path, PurePosixPath

from hyperval.errors import HypervalError, refusal, refuse

_QUIET_S = 60.0  # the number of a process on another machine may be that of none here


def _claim(path: Path) -> int:
    """An open file that this process claims for itself, however it ends, with its number in it; made where it is not.

    Raises
    ------
    BlockingIOError : another process claims it.
    OSError : it cannot be made.
    """
    import fcntl  # of systems that claim files: the others have no O_NOFOLLOW either

    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise
        except OSError:  # a file system without claims
            pass
        if _is_at(handle, path):
            os.ftruncate(handle, 0)
            os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
            return handle
        os.close(handle)  # removed by the one that had it, between opening and claiming


def _is_at(handle: int, path: Path) -> bool:
    """Whether an open file still is the one of that name."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(handle), os.lstat(path))
    return False


def remove_left(place: Path, start: str, end: str = "") -> None:
    """Remove what killed processes of this machine left in ``place``: ``start``, their number, eight letters, ``end``.

    What ended a moment ago is left: the number of a process on another machine may be that of none here.
    """
    exact = re.compile(re.escape(start) + r"(\d+)-[a-z0-9_]{8}" + re.escape(end))
    for name in os.listdir(place):
        path, match = place / name, exact.fullmatch(name)
        with suppress(PermissionError, FileNotFoundError):  # it is gone, or the process is another user's
            if match is None or time.time() - os.lstat(path).st_mtime < _QUIET_S:
                continue
            try:
                os.kill(int(match[1]), 0)
            except ProcessLookupError:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path``; it takes the place of ``path`` when the block ends well.

    What a killed process left of ``path`` is removed first.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{path.name[:60]}.hyperval-"  # the name itself may be as long as a name can be
    remove_left(path.parent, prefix, path.suffix)
    temporary = path.with_name(f"{prefix}{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    temporary.touch(exist_ok=False)  # with the permissions of any new file, which mkstemp would not give
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole, with Unix line ends."""
    with whole_file(path) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


@contextmanager
def scratch_folder(purpose: str) -> Iterator[Path]:
    """Give a folder for temporary files, removed at the end; those that killed processes left are removed first.

    ``purpose`` : one word that stands in its name
    """
    place, start = Path(tempfile.gettempdir()), f"hyperval-{purpose}-"
    remove_left(place, start)
    with tempfile.TemporaryDirectory(prefix=f"{start}{os.getpid()}-", dir=place, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def decoded(raw: bytes) -> str:
    """Text in UTF-16 or UTF-8, with or without their marks, or else Latin-1.

    >>> [decoded("Größe;1".encode(name)) for name in ("utf-16", "utf-16-be", "utf-8-sig", "latin-1")]
    ['Größe;1', 'Größe;1', 'Größe;1', 'Größe;1']
    >>> decoded("Отражение;1".encode("utf-16")), decoded(b"grass;1 \\0")
    ('Отражение;1', 'grass;1 \\x00')
    """
    # The first zero stands beside a letter of UTF-16, behind a mark perhaps a later one; others follow where a text is
    # filled up.
    zero = raw[: 256 if raw[:1] in b"\xff\xfe" else 8].find(0)
    if zero >= 0 and raw[zero + 1 : zero + 2] != b"\0":
        return raw.decode("utf-16-le" if zero % 2 else "utf-16-be", errors="replace").lstrip("\ufeff")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def stated_time() -> datetime | None:
    """When SOURCE_DATE_EPOCH says that something is made; None when it is not set, or empty.

    An empty one is taken out of the environment: libraries read it as a number, whenever they come to be loaded.
    """
    text = os.environ.get("SOURCE_DATE_EPOCH", "")
    if not text.strip():
        os.environ.pop("SOURCE_DATE_EPOCH", None)
        return None
    refuse(not re.fullmatch("[0-9]{1,11}", text), "results.date", text=text[:100])
    return datetime.fromtimestamp(int(text), UTC)


def number_of(text: str | None) -> float:
    """The number that a text is, NaN where it is none; Python's digit grouping is no number elsewhere."""
    try:
        return float(text) if text is not None and "_" not in text else math.nan
    except ValueError:
        return math.nan


def content_of(path: Path, names: tuple[str, str], *, most: int) -> bytes:
    """What a file holds, at most so many bytes; of what it is said of none and of a larger one, the names.

    >>> content_of(Path("/dev/zero"), ("header.none", "header.large"), most=4)  # a device tells no size
    Traceback (most recent call last):
        ...
    hyperval.errors.InputError: /dev/zero: the header is larger than 4 bytes...
    """
    try:
        with open(path, "rb") as stream:
            is_large = os.fstat(stream.fileno()).st_size > most  # of what is no plain file the size is 0
            content = b"" if is_large else stream.read(most + 1)
    except OSError as error:
        name = names[0] if isinstance(error, FileNotFoundError) else "file.unreadable"
        raise refusal(name, path, why=error.strerror) from error
    refuse(is_large or len(content) > most, names[1], path, most=most)
    return content


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal; of a folder that of the names and digests of its files."""
    if path.is_dir():
        listed = [f"{p.relative_to(path).as_posix()}\0{sha256_of(p)}\n" for p in files_within(path)]
        return hashlib.sha256("".join(listed).encode()).hexdigest()
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise refusal("file.unreadable", path, why=error.strerror) from error


def has_digest(path: Path, digest: str) -> bool:
    """Whether a file has the digest ``sha256:HEX``, or ``git-blob:HEX``, the id that git gives its content."""
    kind, _, value = digest.partition(":")
    if kind == "sha256":
        return sha256_of(path) == value
    whole = hashlib.sha1(b"blob %d\0" % path.stat().st_size, usedforsecurity=False)
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, lambda: whole).hexdigest() == value


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    return sum(p.stat().st_size for p in files_within(path)) if path.is_dir() else path.stat().st_size


def installed_file(package: str, *parts: str) -> Path:
    """A file of an installed package, which is not imported for it."""
    return Path(find_spec(package).origin).parent.joinpath(*parts)  # type: ignore[union-attr, arg-type]


def files_within(folder: Path) -> list[Path]:
    """The files below a folder, in the order of their names."""
    return sorted(p for p in folder.rglob("*") if p.is_file())


LIST = ".hyperval.json"
RECORD = ".hyperval-made-of.json"  # what the results of a campaign were made of
LOCK = ".hyperval.lock"
PARTIAL = ".hyperval-partial"
_NEW = ".hyperval-new-"
_SWAP = ".hyperval-swap"


# Kinds of output folders, in words, and the file without which each is none.
RESULTS, COLLECTION, POWER = "results", "a simulated collection", "power tables"
MARKERS = {RESULTS: "results.json", COLLECTION: "truth.json", POWER: "power.csv"}


class UnplacedResults(HypervalError):
    """Results that are complete and could not be put where they belong; the message names where they are."""


@contextmanager
def whole_folder(path: Path, kind: str = RESULTS, *, beside: Iterable[Path | None] = ()) -> Iterator[Path]:
    """Give an empty folder whose content takes the place of that of ``path`` when the block ends well.

    Whatever happens before, ``path`` keeps what it holds.  A link is followed and stays.  ``beside`` are files
    and folders that are read, None where one is not there: what they hold is not replaced by what is made of it.

    Raises
    ------
    UsageError : ``path`` is a file, holds anything that no run wrote or something else than ``kind``, is written by
        another run at this moment, or cannot be written.
    Unplaced : the new content is complete but could not be put there.
    """
    with _claimed(Path(path)) as place:
        _finish(place)
        held, files = _list(place)  # hidden files stay as they are
        foreign = sorted(_names(place) - files)
        more = f" and {len(foreign) - 3} more" if len(foreign) > 3 else ""
        refuse(foreign, "folder.foreign", place, names=", ".join(foreign[:3]) + more)
        refuse(held not in ("", kind), "folder.kind", place, held=held, kind=kind)
        refuse(any(one and one.resolve().is_relative_to(place) for one in beside), "folder.read", place)
        with _making(place):
            new = Path(tempfile.mkdtemp(prefix=_NEW, dir=place))
        try:
            yield new
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
        try:
            listing = {"schema": 1, "kind": kind, "files": sorted(_names(new))}
            (new / LIST).write_text(json.dumps(listing, indent=1) + "\n", "utf-8")
            os.rename(new, place / _SWAP)
            _finish(place)
        except OSError as error:
            mend = "mend that and run again: the next run into this folder finishes the change"
            if new.exists():
                mend = f"they are complete in {new}: copy them from there before the next run"
            what = f"the results could not be put here: {error.strerror or error}"
            raise UnplacedResults(what, where=str(place), mend=mend) from error


def partial_folder(path: Path) -> Path:
    """Where a run into ``path`` keeps what it finished so far."""
    return Path(path).resolve() / PARTIAL


@contextmanager
def _claimed(path: Path) -> Iterator[Path]:
    """The folder, created where it is missing, and locked for the block."""
    with _making(path):
        place = path.resolve()
        lock = place / LOCK
        refuse(place.exists() and not place.is_dir(), "folder.file", path)
        made = not place.exists()
        place.mkdir(parents=True, exist_ok=True)
        try:
            handle = _claim(lock)
        except BlockingIOError as error:
            owner = "it does not say which"
            with suppress(OSError):
                owner = lock.read_text("utf-8", "replace")[:200].strip() or owner
            raise refusal("folder.claimed", path, owner=owner) from error
    try:
        yield place
    finally:
        if _is_at(handle, lock):
            lock.unlink(missing_ok=True)
        os.close(handle)
        if made:
            with suppress(OSError):  # it is not empty
                place.rmdir()


@contextmanager
def _making(path: Path) -> Iterator[None]:
    """Inside, a folder that cannot be there is the user's to mend."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # RuntimeError: a circle of links
        why = getattr(error, "strerror", None) or str(error)
        raise refusal("folder.none", str(path)[:300], why=why) from error


def _finish(place: Path) -> None:
    """Finish a change that was cut off and remove what a killed run left; the folder is claimed."""
    kind, new = _list(place / _SWAP)
    if kind:
        _swap_content(place, kind, new)
    for stale in (*place.glob(_NEW + "*"), place / _SWAP):
        shutil.rmtree(stale, ignore_errors=True)


def _swap_content(place: Path, kind: str, new: set[str]) -> None:
    """Put the files of the swap folder in the place of the old ones; called again, it goes on where it ended."""
    swap, marker = place / _SWAP, MARKERS[kind]
    if (swap / marker).is_file():
        (place / marker).unlink(missing_ok=True)
    for name in sorted(_list(place)[1] - new):
        (place / name).unlink(missing_ok=True)
        for folder in PurePosixPath(name).parents[:-1]:
            with suppress(OSError):  # others are left in it, or it went before
                (place / folder).rmdir()
    for name in [*sorted(new - {marker}), marker, LIST]:
        if (swap / name).is_file():  # else moved before
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(swap / name, place / name)


def _names(folder: Path) -> set[str]:
    """Files below a folder that are not hidden, and the records of campaigns."""
    entries = (p for p in folder.rglob("*") if p.is_file() or p.is_symlink())
    inner = (p.relative_to(folder) for p in entries)
    shown = (p for p in inner if not any(part.startswith(".") for part in p.parent.parts))
    return {p.as_posix() for p in shown if p.name == RECORD or not p.name.startswith(".")}


def _list(folder: Path) -> tuple[str, set[str]]:
    """Kind and files by the list in a folder; none where there is no list that can be read."""
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        content = json.loads((folder / LIST).read_bytes())
        files = {str(PurePosixPath(name)) for name in content["files"]}
        leaves = any(".." in PurePosixPath(f).parts or f.startswith("/") for f in files)
        if content["schema"] == 1 and content["kind"] in MARKERS and not leaves:
            return str(content["kind"]), files
    return "", set()


def last_line(text: str) -> str:
    """What a program said last, in at most 200 characters."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip()[:200] if lines else "no message"


@cache
def tie() -> tuple[str, ...]:
    """What stands before a command so that the program ends with the process that starts it, killed ones too.

    It asks Linux for that and then becomes the command: nothing runs between fork and exec here.  Nothing where the
    system has no such way: there the program goes on until it is done.
    """
    tie = (shutil.which("setpriv") or "", "--pdeathsig", "KILL", "--")
    try:
        done = subprocess.run([*tie, "true"], capture_output=True, check=False)  # noqa: S603 - a program of the system
    except OSError:
        return ()
    return () if done.returncode else tie  # a small system's own setpriv may not know the option

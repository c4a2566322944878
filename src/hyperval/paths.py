"""Paths, patterns of paths, and the text of files, gzipped or not.

Only regular files below the data root are opened, never a URL or a virtual path.
"""

from __future__ import annotations

import csv
import gzip
import io
import os
import re
import shlex
import stat
import zlib
from collections.abc import Callable, Collection, Iterator
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from hyperval.errors import InputError, package_table, reader, refusal, refuse
from hyperval.storage import decoded

Resolve = Callable[[str], Path]  # the path that a reference of a file leads to
MAX_MATCHES = 1000
MAX_TEXT_BYTES = 32 << 20
_HEAD_BYTES = 1 << 16
DECIMAL_COMMA = re.compile(r"^[-+]?[0-9]+,[0-9]+([eE][-+]?[0-9]+)?$")


def is_pattern(name: str) -> bool:
    """Whether the last part of a path stands for several files: it holds ``*``, ``?`` or ``[``."""
    return any(c in PurePosixPath(name).name for c in "*?[")


def matching(path: Path) -> list[Path]:
    """The files that a path names: itself, or all that match the pattern in its last part, sorted by name.

    A file whose name is the pattern itself comes first.  At most 1001 are listed.
    """
    if path.is_file():
        return [path]
    if not is_pattern(path.name) or not path.parent.is_dir():
        return []
    matches = (p for p in path.parent.iterdir() if fnmatchcase(p.name, path.name) and p.is_file())
    return sorted(matches)[: MAX_MATCHES + 1]


def checked_file(
    path: Path | str, *, root: Path | None = None, what: str = "file", most: int | None = None, folder: bool = False
) -> Path:
    """The path of a regular file, or folder, that lies under ``root``, of at most ``most`` bytes.

    Symbolic links are followed before the check, so a link that leads out of ``root`` is refused.

    Raises
    ------
    UsageError : a URL, a GDAL virtual path, or a path that leaves ``root``.
    InputError : no such file, not a regular file (a folder, pipe or device), or a larger one.
    """
    text = os.fspath(path)
    scheme = re.match(r"^[A-Za-z][A-Za-z0-9+._-]+:", text)
    refuse(scheme or text.startswith("/vsi") or "\0" in text, "path.local", text[:200], what=what)
    try:
        real = Path(text).resolve(strict=True)
        mode = real.stat().st_mode
    except FileNotFoundError:
        raise InputError(f"no such {what}", where=text) from None
    except (OSError, RuntimeError) as error:  # RuntimeError: a circle of links
        raise InputError(f"cannot read: {getattr(error, 'strerror', error)}", where=text) from error
    is_outside = root is not None and not real.is_relative_to(Path(root).resolve())
    refuse(is_outside, "path.root", text, what=what, root=root)
    if not (stat.S_ISDIR(mode) if folder else stat.S_ISREG(mode)):
        kind = "a folder" if stat.S_ISDIR(mode) else "a file" if stat.S_ISREG(mode) else "a pipe, socket or device"
        raise InputError(f"is {kind}, not a {what}", where=text, expected="a folder" if folder else "a regular file")
    refuse(most is not None and real.stat().st_size > most, "path.large", text, most=most, what=what)
    return Path(text)


def refuse_own(path: Path) -> None:
    """Raise InputError for a file of hyperval, with its kind and the command that reads it.

    >>> from tempfile import NamedTemporaryFile
    >>> with NamedTemporaryFile(suffix=".yaml") as file:
    ...     _ = Path(file.name).write_text("name: mine\\ninputs:\\n  fill: {grid: [0.1, 0.2]}\\n")
    ...     refuse_own(Path(file.name))
    Traceback (most recent call last):
    hyperval.errors.InputError: ...: a study of hyperval, neither an image nor spectra
      to fix it: it is read by hyperval study ...
    """
    with open(path, "rb") as stream:
        head = stream.read(_HEAD_BYTES)
    marks = package_table("own_files.yaml")["yaml" if path.suffix.lower() in (".yaml", ".yml") else "others"]
    for mark, (kind, command) in marks.items():
        found = re.search(mark.encode(), head, re.MULTILINE)
        refuse(found, "file.own", path, kind=kind, command=command.format(file=shlex.quote(str(path))))


def checked_folder(path: Path | str) -> Path:
    """The path of a folder that holds all of its files, by the rules of :func:`checked_file`."""
    folder_path = checked_file(path, what="Zarr store", folder=True)
    real = folder_path.resolve()
    refuse(any(not p.resolve().is_relative_to(real) for p in folder_path.rglob("*")), "path.zarr", str(path))
    return folder_path


def checked_store(path: Path | str) -> Path:
    """A file by the rules of :func:`checked_file`, or a Zarr store, which is a folder."""
    return checked_folder(path) if is_store(Path(path)) else checked_file(path)


def is_store(path: Path) -> bool:
    """Whether a path is that of a Zarr store, which is a folder."""
    return path.suffix.lower() == ".zarr" and path.is_dir()


def head_of(path: Path, count: int = 512) -> bytes:
    """The first bytes of a file, unzipped when it is gzipped."""
    try:
        with open(path, "rb") as stream:
            opener = gzip.open if stream.read(2) == b"\x1f\x8b" else open
        with opener(path, "rb") as stream:
            return stream.read(count)
    except FileNotFoundError as error:
        raise InputError("no such file", where=str(path)) from error
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"cannot read: {error}", where=str(path)) from error


@reader
def read_text(path: Path, most: int = MAX_TEXT_BYTES) -> str:
    """Text of a file, gzipped or not, of at most so many bytes."""
    raw = head_of(path, most + 1)
    refuse(len(raw) > most, "xml.large", str(path), value=most >> 20)
    return decoded(raw)


@reader
def read_xml(path: Path, most: int = MAX_TEXT_BYTES) -> ElementTree.Element:
    """The root of an XML file of at most so many bytes.

    Raises
    ------
    InputError : larger, with a DOCTYPE or ENTITY, or no XML.
    """
    text = read_text(path, most)
    refuse(re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE), "xml.entity", str(path))
    try:
        # The document type is refused above, so no entity can be declared.
        return ElementTree.fromstring(re.sub(r"^<\?xml[^>]*\?>", "", text.lstrip()))  # noqa: S314
    except ElementTree.ParseError as error:
        raise InputError(f"not valid XML: {error}", where=f"{path}:{error.position[0]}") from error


@reader
def read_table(path: Path, keys: Collection[str] = ()) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Column names of a CSV file, and its rows with their line numbers; short rows are filled with "".

    Columns are divided by commas, or by semicolons (then a comma may be the decimal sign) or tabs where the first
    line holds no comma.  The ``known`` columns may be written in any case.
    """
    text = read_text(path)
    divider = max("\t;,", key=text.split("\n", 1)[0].count)  # the titles may hold the others
    table = csv_rows(text, path, divider)
    fields = [f.lower() if f.lower() in keys else f for f in map(str.strip, next(table, (1, []))[1])]
    refuse(len(set(fields)) < len(fields), "table.twice", f"{path}:1")
    rows = []
    for number, cells in table:
        refuse(len(cells) > len(fields), "table.cells", f"{path}:{number}", cells=len(cells), columns=len(fields))
        if any(cell.strip() for cell in cells):
            padded = [cell.strip() for cell in cells] + [""] * (len(fields) - len(cells))
            if divider == ";":
                padded = [c.replace(",", ".") if DECIMAL_COMMA.match(c) else c for c in padded]
            rows.append((number, dict(zip(fields, padded, strict=True))))
    return fields, rows


def csv_rows(text: str, path: Path, divider: str) -> Iterator[tuple[int, list[str]]]:
    """The rows of a table and their lines; InputError with the line of what is none, such as an endless cell."""
    table = csv.reader(io.StringIO(text, newline=""), delimiter=divider, skipinitialspace=divider != "\t")
    try:
        yield from ((table.line_num, cells) for cells in table)
    except csv.Error as error:
        raise refusal("table.csv", f"{path}:{table.line_num}", why=error) from error

"""Text files of MODTRAN: opened with a size limit, packed or not, and cut into columns of fixed width."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np

from hyperval.errors import InputError

MAX_BYTES = 256 << 20


def text_lines(path: Path, expected: str) -> list[str]:
    """Lines of a text file, or of a ``.gz`` of one, of at most 256 MiB unpacked.

    Raises
    ------
    InputError : missing, unreadable or too large; ``expected`` says what the file should have been.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"larger than {MAX_BYTES} bytes", where=str(path), expected=expected)
        with gzip.open(path, "rb") if path.suffix == ".gz" else open(path, "rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise InputError("no such file", where=str(path)) from error
    except (OSError, EOFError) as error:
        raise InputError(f"cannot read: {error}", where=str(path)) from error
    if len(raw) > MAX_BYTES:
        raise InputError(f"unpacks to more than {MAX_BYTES} bytes", where=str(path))
    return raw.decode("ascii", "replace").splitlines()


def fixed_columns(line: str, ends: list[int], where: str, *, blank: float | None = None) -> list[float]:
    """The numbers of one row, cut at the given column ends; ``blank`` stands for an empty field.

    Raises
    ------
    InputError : a field that is no finite number, an empty field where ``blank`` is None, or text beyond the
        last column.
    """
    values = []
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        field = line[start:end].strip()
        if not field and blank is not None:
            values.append(blank)
            continue
        try:
            value = float(field)
        except ValueError as error:
            raise InputError(f"{field!r} in columns {start + 1}-{end}", where=where, expected="a number") from error
        if not np.isfinite(value):
            raise InputError(f"a value that is not finite in columns {start + 1}-{end}", where=where)
        values.append(value)
    return values

"""A finished run read back from its folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from hyperval.errors import InputError, UsageError, reader
from hyperval.metrics import Evidence
from hyperval.report.tables import SCHEMA_VERSION
from hyperval.results import Cause, Outcome, Result, ResultTable, Role

MAX_BYTES = 500_000_000
_READABLE = (2, SCHEMA_VERSION)  # the second version repeated the names of the columns in each row
_WORDS = {"inf": math.inf, "-inf": -math.inf}
_NUMBERS = ("value", "band_nm", "lower", "upper", "limit_low", "limit_high", "detectable")
_KNOWN = {f.name for f in fields(Result)}
_TYPES = {"role": Role, "evidence": Evidence, "outcome": Outcome, "cause": Cause}


@dataclass(frozen=True)
class StoredRun:
    """What a folder of results holds.

    Attributes
    ----------
    folder : where it stands
    table : every row
    provenance : of one campaign; empty for the page of several
    figures : name of a file in ``figures/`` -> its path
    """

    folder: Path
    table: ResultTable
    provenance: Mapping[str, Any]
    figures: Mapping[str, Path]


@reader
def read_run(folder: Path) -> StoredRun:
    """Read a folder that ``validate``, ``observe``, ``predict`` or another command wrote.

    Raises
    ------
    InputError : no results.json, or one that is not of this kind.
    """
    folder = Path(folder)
    provenance = folder / "provenance.json"
    figures = sorted((folder / "figures").glob("*.*")) if (folder / "figures").is_dir() else []
    return StoredRun(
        folder,
        read_results(folder / "results.json"),
        _json(provenance) if provenance.is_file() else {},
        {p.name: p for p in figures if p.suffix in (".svg", ".png")},
    )


@reader
def read_results(path: Path) -> ResultTable:
    """The rows of a results.json.

    Raises
    ------
    InputError : no such file, not JSON, or not a results table of this version.
    """
    document = _json(path)
    columns = document.get("columns")
    if (
        document.get("schema_version") not in _READABLE
        or not isinstance(document.get("rows"), list)
        or not isinstance(columns, list)
    ):
        raise InputError(
            "not a results table", where=str(path), expected=f"results.json of schema version {SCHEMA_VERSION}"
        )
    return ResultTable(_row(item, columns, f"{path}, row {i}") for i, item in enumerate(document["rows"], start=1))


def _row(item: Any, columns: list[Any], where: str) -> Result:
    if isinstance(item, list) and len(item) == len(columns):
        item = dict(zip(map(str, columns), item, strict=True))
    if not isinstance(item, dict) or item.keys() != _KNOWN:
        raise InputError("not a row of results", where=where, expected="the columns " + ", ".join(sorted(_KNOWN)))
    values = dict(item)
    try:
        for name in _NUMBERS:
            value = values[name]
            values[name] = math.nan if value is None else float(_WORDS.get(value, value))
        for name, kind in _TYPES.items():
            values[name] = kind(values[name])
        return Result(**values)
    except (TypeError, ValueError, UsageError) as error:
        raise InputError(f"not a row of results: {error}", where=where) from error


def _json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"larger than {MAX_BYTES} bytes", where=str(path))
        content = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise InputError("no such file", where=str(path), mend="name a folder of results") from error
    except OSError as error:
        raise InputError(f"cannot read: {error.strerror}", where=str(path)) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {error}", where=str(path)) from error
    if not isinstance(content, dict):
        raise InputError("not a JSON object", where=str(path))
    return content

"""What a run of a study has finished so far: chunks appended to one file, so that an interrupted run goes on."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.files import write_text

Array = npt.NDArray[np.float64]
_IDENTITY, _VALUES, _REASONS = "study.txt", "values.f64", "reasons.jsonl"


class Store:
    """Rows of numbers in the order of the points, in a folder of its own.

    Parameters
    ----------
    folder : made where it is not there
    identity : what the numbers follow from; rows of another identity are thrown away
    columns : numbers in a row
    chunk : rows that are appended at once; a part of a chunk at the end is thrown away

    Raises
    ------
    UsageError : the folder holds something else.
    """

    def __init__(self, folder: Path, identity: str, columns: int, chunk: int):
        self.folder, self.columns, self.chunk = Path(folder), columns, chunk
        identity_file = self.folder / _IDENTITY
        if self.folder.exists() and any(self.folder.iterdir()) and not identity_file.is_file():
            raise UsageError("holds files that are not of a study's run", where=str(self.folder), mend="remove it")
        if not identity_file.is_file() or identity_file.read_text("utf-8") != identity:
            shutil.rmtree(self.folder, ignore_errors=True)
            self.folder.mkdir(parents=True)
            (self.folder / _VALUES).touch()
            (self.folder / _REASONS).touch()
            write_text(identity_file, identity)
        self.finished = self._whole_chunks()

    @property
    def _row(self) -> int:
        return 8 * self.columns

    def _whole_chunks(self) -> int:
        """Rows of the whole chunks that are there; anything after them is cut off."""
        values, reasons = self.folder / _VALUES, self.folder / _REASONS
        size = values.stat().st_size
        rows = size // self._row // self.chunk * self.chunk
        os.truncate(values, rows * self._row)
        kept = []
        for line in reasons.read_text("utf-8").splitlines():
            try:
                point, _ = json.loads(line)
            except ValueError:
                break
            if point < rows:
                kept.append(line)
        write_text(reasons, "".join(f"{line}\n" for line in kept))
        return int(rows)

    def append(self, values: Array, reasons: Mapping[int, str]) -> None:
        """Add the rows (n, columns) that follow, and the reasons by the number of the point."""
        # Reasons first: rows without their reasons would count as finished.
        with open(self.folder / _REASONS, "a", encoding="utf-8") as stream:
            stream.writelines(
                json.dumps([point, reasons[point]], ensure_ascii=False) + "\n" for point in sorted(reasons)
            )
            stream.flush()
            os.fsync(stream.fileno())
        with open(self.folder / _VALUES, "ab") as stream:
            stream.write(np.ascontiguousarray(values, dtype="<f8").tobytes())
            stream.flush()
            os.fsync(stream.fileno())
        self.finished += len(values)

    def values(self) -> Array:
        """(n, columns) all rows, mapped from the file."""
        if self.finished == 0:
            return np.empty((0, self.columns))
        return np.memmap(self.folder / _VALUES, dtype="<f8", mode="r", shape=(self.finished, self.columns))

    def reasons(self) -> dict[int, str]:
        """Number of the point -> what is to be said of it."""
        lines = (self.folder / _REASONS).read_text("utf-8").splitlines()
        return {int(point): text for point, text in map(json.loads, lines)}

    def remove(self) -> None:
        """Throw everything away."""
        shutil.rmtree(self.folder, ignore_errors=True)

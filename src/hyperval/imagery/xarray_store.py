"""Arrays of a file as an engine of xarray opens it, read by parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from hyperval.errors import InputError
from hyperval.imagery.stored_file import OpenedFile
from hyperval.imagery.stores import Selection


class XarrayStore(OpenedFile):
    """A group of a file as an engine of xarray opens it, values as they are stored."""

    def __init__(self, path: Path, engine: str | None = None, group: str | None = None) -> None:
        super().__init__(path)
        self.engine, self.group = engine, group

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process opens it for itself."""
        return type(self), (self.path, self.engine, self.group)

    def open(self) -> xr.Dataset:
        """The group; InputError when no installed engine opens it."""
        try:
            return xr.open_dataset(
                self.path, engine=self.engine, group=self.group, cache=False, **as_stored(self.engine)
            )
        except Exception as error:  # each engine has errors of its own
            raise InputError(f"no engine of xarray opens it: {error}", where=str(self.path)) from error

    def read(self, name: str, selection: Selection) -> npt.NDArray[Any]:
        """A part of an array."""
        with self.kept_open() as data:
            return np.asarray(data[name][selection].values)

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """Size of the blocks that an array is stored in."""
        with self.kept_open() as data:
            size: tuple[int, ...] | None = data[name].encoding.get("chunksizes")
            return size


def as_stored(engine: str | None) -> dict[str, Any]:
    """Options of xarray that hand out stored values, and let HDF5 files be read that name no dimensions."""
    plain = {"mask_and_scale": False, "decode_times": False}
    return plain | {"phony_dims": "sort"} if engine == "h5netcdf" else plain

"""Arrays with the names of their axes: a group of NetCDF as it is put together, and as it is written.

xarray and pandas, which it brings, take 80 MB; a group is written without them, and becomes a dataset of xarray
where one is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5netcdf
import h5py
import numpy as np

if TYPE_CHECKING:
    import xarray as xr

Entry = tuple[str | tuple[str, ...], Any, Mapping[str, Any]]


@dataclass
class LabelledArrays:
    """Axes, values and attributes by name.

    Attributes
    ----------
    coords : what names the places along an axis
    arrays : everything else
    """

    coords: dict[str, Entry] = field(default_factory=dict)
    arrays: dict[str, Entry] = field(default_factory=dict)

    def __setitem__(self, name: str, entry: Entry) -> None:
        self.arrays[name] = entry

    def to_xarray(self) -> xr.Dataset:
        """As a dataset of xarray."""
        import xarray as xr

        return xr.Dataset(self.arrays, self.coords)


def write_groups(path: Path, groups: Mapping[str, LabelledArrays], attributes: Mapping[str, str]) -> None:
    """Write groups and the attributes of the whole to a new NetCDF-4 file; covariances are packed as float32."""
    with h5netcdf.File(path, "w") as file:
        file.attrs.update(attributes)
        for name, content in groups.items():
            _write(file.create_group(name), content)


def _write(group: Any, content: LabelledArrays) -> None:
    placed: set[str] = set()
    for name, (dims, values, attributes) in (content.coords | content.arrays).items():
        axes = (dims,) if isinstance(dims, str) else tuple(dims)
        array = np.asarray(values)
        for axis, size in zip(axes, array.shape, strict=True):
            if axis not in group.dimensions:
                group.dimensions[axis] = size
        options: dict[str, Any] = {}
        if array.dtype.kind == "O":
            options["dtype"] = h5py.string_dtype()
        elif array.dtype.kind == "f" and name not in content.coords:
            options["fillvalue"] = np.float32(np.nan) if _packed(name) else np.nan
        if _packed(name):
            array = array.astype(np.float32)
            options |= {"compression": "gzip", "compression_opts": 4, "shuffle": True}
        variable = group.create_variable(name, axes, data=array, **{"dtype": array.dtype, **options})
        variable.attrs.update(attributes)
        if name in content.arrays:
            beside = [c for c in content.coords if c not in axes and {*_axes(content.coords[c])} <= {*axes}]
            placed |= {*beside, *axes}
            if beside:
                variable.attrs["coordinates"] = " ".join(beside)
    left = [name for name in content.coords if name not in placed]
    if left:
        group.attrs["coordinates"] = " ".join(left)


def _axes(entry: Entry) -> tuple[str, ...]:
    return (entry[0],) if isinstance(entry[0], str) else tuple(entry[0])


def _packed(name: str) -> bool:
    return name.endswith("_covariance")

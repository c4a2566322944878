"""Where the sun stood, as products in trees of arrays say themselves or in a file of angles beside them."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from hyperval.imagery.array_raster import ArrayRaster
from hyperval.imagery.layouts import Values, layouts, member, tree_of
from hyperval.imagery.stores import Hdf5Store, check_own_values

Array = npt.NDArray[np.float64]
SUN_ZENITH = re.compile(r"(sun|solar)\W+zenith", re.IGNORECASE)
SAMPLED_LINES = 16


def sun_of_product(raster: ArrayRaster) -> float | None:
    """The zenith angle of the sun [degrees] that a product states for the whole image; None without."""
    if not isinstance(raster.store, Hdf5Store):
        return None
    with raster.store.kept_open() as file:
        tree = tree_of(file)
        if tree is None or tree.sun_zenith is None:
            return None
        array = None if "@" in tree.sun_zenith else member(file, tree.sun_zenith)
        if isinstance(array, h5py.Dataset) and array.ndim == 2:
            angles = _some_lines(array, None)
            angles = angles[(angles >= 0.0) & (angles <= 180.0)]
            return float(np.median(angles)) if angles.size else None
        text = Values(file, raster.path).text(tree.sun_zenith)
    try:
        angle = float(text or "nan")
    except ValueError:
        return None
    return angle if 0.0 <= angle <= 180.0 else None


def sun_of_observation(path: Path, shape: tuple[int, int]) -> Array | None:
    """Zenith angles of the sun [degrees] in some lines of a file of angles for an image of ``shape``.

    None where its layout is not known or it is of another size.

    Raises
    ------
    InputError : no HDF5 file, or one whose values lie elsewhere.
    """
    check_own_values(path)
    with Hdf5Store(path).kept_open() as file:
        for layout in layouts().observations:
            if layout.sun_zenith is not None:
                array = member(file, layout.sun_zenith)
                if isinstance(array, h5py.Dataset) and array.shape == shape:
                    return _some_lines(array, None)
            if layout.image is not None and layout.names is not None:
                array, names = member(file, layout.image), member(file, layout.names)
                if isinstance(array, h5py.Dataset) and isinstance(names, h5py.Dataset):
                    words = [_text(name) for name in names[()].ravel()]
                    bands = [i for i, word in enumerate(words) if SUN_ZENITH.search(word)]
                    if len(bands) == 1 and array.shape == (*shape, len(words)):
                        return _some_lines(array, bands[0])
    return None


def _text(name: bytes | str) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)


def _some_lines(array: h5py.Dataset, band: int | None) -> Array:
    lines = np.unique(np.linspace(0, array.shape[0] - 1, SAMPLED_LINES).astype(int))
    rows = [array[int(line)] if band is None else array[int(line), :, band] for line in lines]
    return np.concatenate([np.asarray(row, dtype=np.float64).ravel() for row in rows])

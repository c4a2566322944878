"""Files that belong to a cube: lookup table (GLT), places of its pixels (IGM, LOC), angles (OBS)."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from hyperval.errors import HypervalError
from hyperval.imagery.array_raster import ArrayRaster, Piece, Term
from hyperval.imagery.envi_raster import EnviRaster
from hyperval.imagery.layouts import Values, layouts, member, tree_of
from hyperval.imagery.lookup_table import LookupTable, location_table, open_lookup_table
from hyperval.imagery.rasters import Raster, open_raster
from hyperval.imagery.stores import Hdf5Store, check_own_values
from hyperval.imagery.tiff_raster import TiffRaster
from hyperval.imagery.trees import location_names, lookup_raster

Array = npt.NDArray[np.float64]
_TREES = (".nc", ".nc4", ".h5", ".hdf5", ".he5")

# Parts of names that tell the files of one line apart, such as ang20160217t083024_rdn_v1n2_img and ..._rdn_glt.
_KINDS = re.compile(
    r"^(img|dat|rdn|rad|pol|ref|rfl|refl|radiance|reflectance|ort|raw|data|corr|glt|igm|loc|obs|l[0-4][a-d]?|v[0-9]\w*)$"
)
SUN_ZENITH = re.compile(r"(sun|solar)\W+zenith", re.IGNORECASE)
SAMPLED_LINES = 16


def companion(image: Path, kind: str) -> Path | None:
    """The file of a kind ("glt", "igm", "loc", "obs") beside an image, by the names that producers give; None else.

    Their names are the same but for the words that say what a file is; of several that fit, the one that has the
    image's own such words (``x_rad_glt`` for ``x_rad``), and none where that leaves two.
    """
    own, kinds = _name(image)
    fits = []
    if image.suffix.lower() in _TREES:
        others = [p for p in sorted(image.parent.glob("*" + image.suffix)) if p != image]
        fits = [p for p in others if _name(p)[0] == own and kind in _name(p)[1]]
        return fits[0] if len(fits) == 1 else None
    for header in sorted(image.parent.glob("*.[hH][dD][rR]")):
        data = header.with_suffix("")
        if not data.is_file():
            data = next((p for p in (data.with_suffix(end) for end in (".img", ".dat")) if p.is_file()), data)
        name, words = _name(data)
        if data != image and data.is_file() and kind in words and name == own:
            fits.append(data)
    if len(fits) > 1:
        fits = [p for p in fits if kinds <= _name(p)[1]]
    return fits[0] if len(fits) == 1 else None


def table_of(raster: Raster) -> tuple[LookupTable | None, tuple[str, ...]]:
    """What places the pixels of an image without a map position, and notes: its own table, or one beside it."""
    if raster.transform is not None:
        return None, ()
    shape = (raster.lines, raster.samples)
    if isinstance(raster, ArrayRaster):
        own = lookup_raster(raster)
        if own is not None:
            return open_lookup_table(own, shape), ()
        names = location_names(raster)
        if names is None:
            return None, ()
        pieces = tuple(Piece((Term(name),), "ls", shape, np.dtype(np.float64)) for name in names)
        return location_table(ArrayRaster(raster.path, raster.store, pieces), shape), ()
    if not isinstance(raster, EnviRaster):
        return None, ()
    for kind in ("glt", "igm", "loc"):
        path = companion(raster.path, kind)
        if path is None:
            continue
        try:
            table = open_lookup_table(path, shape) if kind == "glt" else location_table(open_raster(path), shape)
        except HypervalError as error:
            return None, (f"warning: {path.name} lies beside the cube and is left aside: {error.what}",)
        return table, (f"{path.name} lies beside the cube and places its pixels",)
    return None, ()


def sun_zenith_deg(raster: Raster) -> tuple[float, str] | None:
    """Median zenith angle of the sun [degrees] as a product states it, or the observation file (OBS) beside a cube.

    Also the name of the file.  None where there is none of the cube's size, or none of its bands is called so.
    """
    if isinstance(raster, TiffRaster):
        about = raster.description
        stated = about.sun_zenith_deg if about is not None else None
        return None if stated is None else (stated, raster.other_files[0].name)
    own = sun_of_product(raster) if isinstance(raster, ArrayRaster) else None
    if own is not None:
        return own, raster.path.name
    path = companion(raster.path, "obs")
    if path is None:
        return None
    shape = (raster.lines, raster.samples)
    try:
        angles = _zenith_lines(path, shape) if isinstance(raster, EnviRaster) else sun_of_observation(path, shape)
    except HypervalError:
        return None
    if angles is None:
        return None
    zenith = angles[np.isfinite(angles) & (angles >= 0.0) & (angles <= 180.0)]
    return (float(np.median(zenith)), path.name) if zenith.size else None


def _zenith_lines(path: Path, shape: tuple[int, int]) -> Array | None:
    """Zenith angles of the sun in some lines of an ENVI file of observation geometry."""
    angles = open_raster(path)
    names = (angles.header.strings("band names") if angles.header is not None else None) or ()
    bands = [i for i, name in enumerate(names) if SUN_ZENITH.search(name)]
    if len(bands) != 1 or (angles.lines, angles.samples) != shape:
        return None
    lines = np.unique(np.linspace(0, angles.lines - 1, SAMPLED_LINES).astype(int))
    return np.concatenate([angles.read_bands(int(line), 1)[bands[0]].ravel() for line in lines]).astype(float)


def _name(path: Path) -> tuple[tuple[str, ...], set[str]]:
    """The words of a file's name that name the line, and those that say what the file is."""
    words = re.split(r"[_.\-]", path.name.lower())
    return tuple(w for w in words if w and not _KINDS.match(w)), {w for w in words if _KINDS.match(w)}


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

"""Layouts of products as data (``layouts.yaml``): which array of a tree is the image, and what belongs to it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
from pydantic import Field

from hyperval.config import Model, load_model
from hyperval.errors import InputError

Array = npt.NDArray[np.float64]
MAX_BANDS = 20_000
Reference = str | float


class Addend(Model):
    """A second array of the same shape that is added to the first."""

    path: str
    divisor: Reference = 1.0


class ImageArray(Model):
    """An array that holds some bands of the image."""

    path: str
    dimensions: str = Field(pattern="^[lsb]{3}$")
    wavelength: str
    fwhm: str | None = None
    good: str | None = None
    plus: Addend | None = None
    scale: Reference = 1.0
    divisor: Reference = 1.0
    offset: Reference = 0.0
    subtract: Reference = 0.0
    range: tuple[Reference, Reference] | None = None


class Tree(Model):
    """A product whose image lies in a tree of arrays."""

    product: str
    sensor: str
    quantity: str
    unit: str
    arrays: list[ImageArray] = Field(min_length=1)
    wavelength_unit: str
    source: str
    remark: str | None = None
    sorts: bool = False
    ignore: Reference | None = None
    bad_ranges_nm: list[str] = Field(default_factory=list)
    lookup_table: tuple[str, str] | None = None
    location: tuple[str, str] | None = None
    geotransform: str | None = None
    map_info: str | None = None
    crs: str | None = None
    epsg: str | None = None
    corner_pixels: tuple[str, str, str, str] | None = None
    pixel_size: float | None = None
    struct_metadata: str | None = None
    sun_zenith: str | None = None
    entries: dict[str, str] = Field(default_factory=dict)


class Observation(Model):
    """A file of the angles of every pixel beside an image: one array for each, or one whose bands have names."""

    product: str
    sun_zenith: str | None = None
    image: str | None = None
    names: str | None = None
    source: str


class Sidecar(Model):
    """A product of a GeoTIFF with XML beside it."""

    sensor: str
    image: str
    metadata: str
    bands: str
    wavelength: str
    fwhm: str
    gain: str
    offset: str
    wavelength_unit: str
    radiance_unit: str
    level: str
    source: str
    ignore: str | None = None
    fill: float | None = None
    time: str | None = None
    sun_zenith: str | None = None
    sun_elevation: str | None = None


class Layouts(Model):
    """All layouts."""

    trees: list[Tree]
    observations: list[Observation]
    sidecars: list[Sidecar]


@cache
def layouts() -> Layouts:
    """The layouts that come with the package."""
    return load_model(Layouts, Path(__file__).with_name("layouts.yaml"))


def tree_of(file: h5py.File) -> Tree | None:
    """The layout whose images and wavelengths the file holds, None when it is none of them."""
    for tree in layouts().trees:
        if all(_present(file, array.path) and _present(file, array.wavelength) for array in tree.arrays):
            return tree
    return None


def _present(file: h5py.File, reference: str) -> bool:
    """Whether a file has the array or the attribute of a reference."""
    name, at, attribute = reference.partition("@")
    item = member(file, name) if name else file
    return item is not None and attribute in item.attrs if at else isinstance(item, h5py.Dataset)


@dataclass(frozen=True)
class Values:
    """What the references of a layout mean in one opened file."""

    file: h5py.File
    path: Path

    def raw(self, reference: str) -> Any:
        """The content of an array or attribute, None when the file has none."""
        name, at, attribute = reference.partition("@")
        item = member(self.file, name) if name else self.file
        if item is None:
            return None
        if at:
            return item.attrs.get(attribute)
        if not isinstance(item, h5py.Dataset) or item.size > MAX_BANDS * 100:
            return None
        return item[()]

    def text(self, reference: str | None) -> str | None:
        """A text or number as text; None when the file has none."""
        value = None if reference is None else self.raw(reference)
        if isinstance(value, np.ndarray):
            value = value.ravel()[0] if value.size == 1 else " ".join(str(v) for v in value.ravel())
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        return None if value is None or not str(value).strip() else str(value).strip()

    def number(self, reference: Reference) -> float:
        """A number; InputError when the file has none there, or not a finite one."""
        if not isinstance(reference, str):
            return reference
        value = self.raw(reference)
        try:
            number = float(np.asarray(value).ravel()[0])
        except (TypeError, ValueError, IndexError):
            number = np.nan
        if not np.isfinite(number):
            raise InputError(
                f"no number {reference!r}", where=str(self.path), expected="as the product's layout has it"
            )
        return number

    def numbers(self, reference: str, count: int, what: str) -> Array:
        """(count,) numbers; InputError when the file does not have as many."""
        value = self.raw(reference)
        try:
            out = np.asarray(value, dtype=float).ravel()
        except (TypeError, ValueError):
            out = np.zeros(0)
        if value is None or out.size != count:
            raise InputError(
                f"{0 if value is None else out.size} {what} ({reference!r}) for {count} bands", where=str(self.path)
            )
        return out


def member(file: h5py.File, name: str) -> Any:
    """The group or array of a name, in which "*" is the only group of its level; None when there is none."""
    at: Any = file
    for part in name.split("/"):
        if not isinstance(at, h5py.Group):
            return None
        if part == "*":
            groups = [key for key in at if isinstance(at.get(key, getlink=True), h5py.HardLink)]
            if len(groups) != 1:
                return None
            part = groups[0]
        if part not in at or isinstance(at.get(part, getlink=True), h5py.ExternalLink):
            return None
        at = at[part]
    return at


def stated_number(attributes: Mapping[str, Any], names: Sequence[str]) -> float | None:
    """The number in the first of some attributes that holds a single one; None without any."""
    for name in names:
        value = attributes.get(name)
        if value is not None and np.size(value) == 1:
            return float(np.asarray(value).ravel()[0])
    return None


def level_of(texts: Sequence[str | None]) -> str | None:
    """Processing level (L1A, L1B, L1C, L2A ...) that one of the texts names, None when none does."""
    for text in texts:
        level = re.search(r"L[0-4][A-D]", (text or "").upper())
        if level is not None:
            return level.group()
    return None

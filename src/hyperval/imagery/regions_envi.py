"""Regions of ENVI: XML (5.x), ASCII export and classic binary files."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError
from hyperval.imagery.drawing import Drawing, Grid
from hyperval.imagery.georeference import crs_of_wkt
from hyperval.imagery.text_files import read_text, read_xml
from hyperval.paths import checked_file

Array = npt.NDArray[np.float64]
MAX_XML_BYTES = 8 << 20
MAX_BINARY_BYTES = 64 << 20


def _root(path: Path) -> ElementTree.Element:
    """The root of an ENVI 5 ROI file."""
    root = read_xml(path, MAX_XML_BYTES)
    if root.tag != "RegionsOfInterest":
        raise InputError(f"the root element is {root.tag!r}", where=str(path), expected="RegionsOfInterest")
    return root


def xml_drawings(path: Path, grid: Grid) -> dict[str, Drawing]:
    """Drawings by name of an ENVI 5 ROI file.

    ``CoordSysStr`` "none" means continuous pixel coordinates, a WKT means map coordinates, which
    are projected to the cube's system where it differs.

    Raises
    ------
    InputError : larger than 8 MiB, with a DOCTYPE or ENTITY, not such a file, or a region that cannot be placed.
    """
    root = _root(path)
    drawings: dict[str, Drawing] = {}
    for number, region in enumerate(root.iter("Region"), start=1):
        name = region.get("name") or str(number)
        where = f"{path}: region {name!r}"
        if name in drawings:
            raise InputError("the name stands twice", where=where)
        drawing = Drawing(grid.shape)
        for definition in region.iter("GeometryDef"):
            system = " ".join((definition.findtext("CoordSysStr") or "none").split())

            def placed(element: ElementTree.Element, ring: bool, system: str = system, where: str = where) -> Array:
                return _placed(_pairs(element, where), system, grid, where, ring)

            for child in definition:
                if child.tag == "CoordSysStr":
                    continue
                if child.tag in ("Polygon", "MultiPolygon"):
                    for polygon in child.iter("Polygon"):
                        outer = [placed(ring, True) for ring in polygon.findall("Exterior/LinearRing")]
                        inner = [placed(ring, True) for ring in polygon.findall("Interior/LinearRing")]
                        if len(outer) != 1:
                            raise InputError(f"a polygon with {len(outer)} exterior rings", where=where)
                        drawing.add_polygon(outer[0], inner, where=where)
                elif child.tag in ("Point", "MultiPoint"):
                    drawing.add_points(placed(child, False), where=where)
                else:
                    raise InputError(
                        f"geometry {child.tag!r} has no area", where=where, expected="Polygon, Point or MultiPoint"
                    )
        if not any(True for _ in region.iter("GeometryDef")):
            raise InputError(
                "a region without geometry",
                where=where,
                expected="polygons or points; a threshold is not evaluated here",
                mend="turn it into pixels before it is exported, or take it out of the file",
            )
        drawings[name] = drawing
    return drawings


def _dimension(value: str, shape: tuple[int, int], where: str) -> tuple[int, int]:
    """Lines and samples that a region file was made for, which have to be those of the cube."""
    sizes = re.fullmatch(r"([0-9]+)\s*x\s*([0-9]+)", value)
    if sizes is None:
        raise InputError(f"file dimension {value!r}", where=where, expected="samples x lines")
    dimension = int(sizes[2]), int(sizes[1])
    if dimension != shape:
        raise InputError(
            f"the regions were made for {dimension[0]} lines x {dimension[1]} samples",
            where=where,
            expected=f"{shape[0]} lines x {shape[1]} samples, as the cube",
        )
    return dimension


def ascii_drawings(path: Path, shape: tuple[int, int]) -> dict[str, Drawing]:
    """Drawings by name of an ENVI "Output of ROIs" text file, whose pixel numbers X, Y start at 1.

    Raises
    ------
    InputError : the file was made for an image of another size, or its counts do not add up.
    """
    names: list[str] = []
    counts: list[int] = []
    rows: list[tuple[int, int]] = []
    dimension: tuple[int, int] | None = None
    announced: int | None = None
    columns = (1, 2)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        where = f"{path}:{number}"
        text = line.strip()
        if not text:
            continue
        if text.startswith(";"):
            label, _, value = text.lstrip("; ").partition(":")
            label, value = label.strip().lower(), value.strip()
            if label == "file dimension":
                dimension = _dimension(value, shape, where)
            elif label == "number of rois":
                announced = _whole(value, where)
            elif label == "roi name":
                names.append(value)
            elif label == "roi npts":
                counts.append(_whole(value, where))
            elif not value and {"x", "y"} <= set(text.lstrip("; ").lower().split()):
                titles = text.lstrip("; ").lower().split()
                columns = titles.index("x"), titles.index("y")
            elif not value and re.search(r"(?i)\b(map\s?[xy]|lat|lon)\b", text):
                raise InputError(
                    f"no pixel numbers among the columns: {text.lstrip('; ')[:60]!r}",
                    where=where,
                    expected="ID X Y ...",
                    mend="export it again with the pixel location (X, Y)",
                )
            continue
        parts = text.split()
        if len(parts) <= max(columns):
            raise InputError(f"{len(parts)} columns", where=where, expected="ID X Y ...")
        rows.append((_whole(parts[columns[1]], where) - 1, _whole(parts[columns[0]], where) - 1))
    if dimension is None:
        raise InputError("no 'File Dimension' line", where=str(path))
    if len(names) != len(counts) or (announced is not None and announced != len(names)) or sum(counts) != len(rows):
        raise InputError(
            f"{announced} regions announced, {len(names)} named with {sum(counts)} points; {len(rows)} follow",
            where=str(path),
            mend="the file is cut short or was edited: export it again",
        )
    if len(set(names)) < len(names):
        raise InputError("two regions have the same name", where=str(path))
    placed = np.array(rows, dtype=np.int64).reshape(-1, 2)
    drawings, start = {}, 0
    for name, count in zip(names, counts, strict=True):
        part = placed[start : start + count]
        drawings[name] = Drawing(shape)
        drawings[name].add_pixels(part[:, 0], part[:, 1], where=f"{path}: region {name!r}")
        start += count
    return drawings


def binary_drawings(path: Path, shape: tuple[int, int]) -> dict[str, Drawing]:
    """Drawings by name of a classic ENVI ``.roi`` file (big-endian; pixel addresses and polygons from 0).

    Raises
    ------
    InputError : larger than 64 MiB, cut short, made for an image of another size, or with polylines.
    """
    raw, at = checked_file(path, what="region file", most=MAX_BINARY_BYTES).read_bytes(), 4

    def words(count: int, kind: str = "i") -> tuple[int, ...]:
        nonlocal at
        size = 4 * count
        if count < 0 or at + size > len(raw):
            raise InputError("the region file is cut short", where=str(path))
        out = struct.unpack_from(f">{count}{kind}", raw, at)
        at += size
        return out

    drawings: dict[str, Drawing] = {}
    for _ in range(words(1)[0]):
        length = words(2)[1]
        if not 0 <= length <= 4096 or at + length > len(raw):
            raise InputError("a region name of impossible length", where=str(path))
        name = raw[at : at + length].split(b"\0")[0].decode("latin-1").strip()
        at += -(-length // 4) * 4
        table = words(45)
        where = f"{path}: region {name!r}"
        if (table[1], table[0]) != shape:
            raise InputError(f"made for {table[1]} lines x {table[0]} samples", where=where, expected=f"{shape}")
        if table[43]:
            raise InputError("polylines have no area", where=where)
        if name in drawings:
            raise InputError("the name stands twice", where=where)
        drawings[name] = drawing = Drawing(shape)
        if table[44]:
            words(1)
            addresses = np.array(words(table[3]), dtype=np.int64)
            drawing.add_pixels(addresses // shape[1], addresses % shape[1], where=where)
        elif table[3] > 0:
            drawing.stated_pixels = table[3]
        for _ in range(table[42]):
            vertices = words(2)[0]
            ring = np.column_stack([words(vertices, "f"), words(vertices, "f")])
            drawing.add_polygon(ring, where=where)
    return drawings


def _pairs(element: ElementTree.Element, where: str) -> Array:
    text = " ".join(part.text or "" for part in element.iter("Coordinates"))
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        raise InputError("coordinates that are no numbers", where=where) from None
    if values.size == 0 or values.size % 2:
        raise InputError(f"{values.size} coordinates", where=where, expected="pairs x y")
    return values.reshape(-1, 2)


def _placed(points: Array, system: str, grid: Grid, where: str, ring: bool) -> Array:
    if system.lower() == "none":
        return points
    source = crs_of_wkt(system)
    if source is None:
        raise InputError(f"unknown coordinate system {system[:60]!r}", where=where)
    return Grid(grid.shape, grid.transform, grid.crs).placing(source, where)(points, where, ring)


def _whole(text: str, where: str) -> int:
    if not re.fullmatch(r"[0-9]{1,12}", text.strip()):
        raise InputError(f"{text[:40]!r} is not a whole number", where=where)
    return int(text)

"""What lies beside a GeoTIFF: the METADATA.XML of a product by its layout, an item of STAC."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hyperval.errors import refusal, refuse
from hyperval.imagery.description import Description, ListedBands, Scale
from hyperval.imagery.products import ProductLayout, layouts, median_angle
from hyperval.paths import checked_file, read_xml
from hyperval.storage import number_of
from hyperval.units import is_radiance

MAX_XML_BYTES = 64 << 20
MAX_JSON_BYTES = 4 << 20
MAX_ITEMS = 20  # files of JSON that are looked at for one that names the image
NO_MAP = "in scanner geometry: a map position of the file is a fit to its corners and is ignored"
_UNRECTIFIED = "one detector in scanner geometry: the other sees a place some lines apart, as a cube of its own"


def described_beside(image: Path, bands: int, nodata: float | None = None) -> tuple[Description, Path] | None:
    """What the metadata beside a GeoTIFF of ``bands`` bands say of it, and their file; None where there are none.

    ``nodata`` : as the GeoTIFF itself states it, where the metadata do not.

    Raises
    ------
    InputError : metadata that are too large, not understood, or of another number of bands.
    """
    for made, path, fill in _descriptions(image, bands):
        stated = (value for value in (made.ignore_value, nodata, fill) if value is not None)
        return replace(made, ignore_value=next(stated, None)), path
    return None


def _descriptions(image: Path, bands: int) -> Iterator[tuple[Description, Path, float | None]]:
    """What each file beside an image says of it, and the no-data value that its layout has."""
    for sidecar in layouts().sidecars:
        at = image.name.upper().find(sidecar.image.upper())
        for name in (sidecar.metadata, sidecar.metadata.lower(), sidecar.metadata.upper()) if at >= 0 else ():
            path = image.with_name(image.name[:at] + name)
            if path.is_file() and (made := _from_xml(sidecar, checked_file(path), image, bands)) is not None:
                yield made, path, sidecar.fill
    for path, item, asset in _stac_assets(image):
        if (made := _from_asset(item, asset, bands)) is not None:
            yield made, path, None


def image_of(metadata: Path, detector: str | None = None) -> Path:
    """The GeoTIFF that a METADATA.XML belongs to; of level 1B of EnMAP that of ``detector``, VNIR or SWIR.

    The two detectors of level 1B are two cubes: each sees a place some lines before the other, neither is on a map,
    and no shift by whole pixels lays one on the other.

    Raises
    ------
    InputError : no image.
    UsageError : several, and none or another one is named.
    """
    sidecar = next((s for s in layouts().sidecars if metadata.name.upper().endswith(s.metadata.upper())), None)
    if sidecar is None:
        raise refusal("sidecar.unknown", metadata)
    stem = metadata.name[: -len(sidecar.metadata)]
    start = (stem + sidecar.image).upper()
    tiffs = [p for p in sorted(metadata.parent.iterdir()) if p.suffix.upper() in (".TIF", ".TIFF")]
    fits = [p for p in tiffs if p.name.upper().startswith(start)]
    refuse(not fits, "sidecar.no_image", metadata, stem=stem + sidecar.image)
    # The same image may lie there again, cut into tiles for the cloud.
    fits.sort(key=lambda p: not p.stem.upper().endswith("_COG"))
    of_detector = {p.stem[len(start) :].upper().removesuffix("_COG").strip("_"): p for p in fits}
    if detector is None and len(of_detector) == 1:
        return next(iter(of_detector.values()))
    if detector is not None and detector.upper() in of_detector:
        return of_detector[detector.upper()]
    names = ", ".join(p.name for p in of_detector.values())
    raise refusal("sidecar.images", metadata, count=len(of_detector), names=names, detectors=" or ".join(of_detector))


def _from_xml(sidecar: ProductLayout, path: Path, image: Path, bands: int) -> Description | None:
    root = read_xml(path, MAX_XML_BYTES)
    items = root.findall(sidecar.bands)
    if not items:
        return None
    numbers = [_number(item.get("number"), "number of a band", path) for item in items if "number" in item.attrib]
    if numbers:  # of the band in the image, in whatever order the elements stand
        refuse(sorted(numbers) != list(range(1, len(items) + 1)), "sidecar.band_numbers", path, count=len(items))
        items = [item for _, item in sorted(zip(numbers, items, strict=True), key=lambda pair: pair[0])]
    tags = (sidecar.wavelength, sidecar.fwhm, sidecar.gain, sidecar.offset)
    table = np.array([[_number(item.findtext(tag), tag, path) for tag in tags] for item in items])
    detector = re.search(r"_(VNIR|SWIR)", image.name.upper())
    if len(table) != bands:
        if detector is None or len(table) < bands:
            raise refusal("sidecar.bands", path, stated=len(table), bands=bands)
        table = table[:bands] if detector[1] == "VNIR" else table[-bands:]
    wavelength, width, gain, offset = table.T
    levels = [root.findtext(sidecar.level), root.findtext("base/format"), path.name]
    level = next((found[0] for text in levels if (found := re.search(r"L[0-4][A-D]", (text or "").upper()))), None)
    quantity = None if level is None else "reflectance" if level.startswith("L2") else "radiance"
    ignore = root.findtext(sidecar.ignore) if sidecar.ignore is not None else None
    zenith, elevation = _angle(root, sidecar.sun_zenith), _angle(root, sidecar.sun_elevation)
    rectified = level is None or not level.startswith("L1") or level == "L1C"
    when = (root.findtext(sidecar.time) or "").strip() if sidecar.time is not None else ""
    product = f"{sidecar.sensor} {level or 'image'}"
    return Description(
        product=product,
        bands=ListedBands(np.where(wavelength > 0, wavelength, np.nan), width, sidecar.wavelength_unit),
        scale=Scale(gain, offset, f"scale of the {product}"),
        quantity=quantity,
        unit=sidecar.radiance_unit if quantity == "radiance" else "1" if quantity else None,
        ignore_value=_number(ignore, str(sidecar.ignore), path) if ignore else None,
        sensor=sidecar.sensor,
        sun_zenith_deg=90.0 - elevation if zenith is None and elevation is not None else zenith,
        sorts=True,
        entries={"sensor": sidecar.sensor} | ({"acquisition time": when} if when else {}),
        notes=(*([] if rectified else [NO_MAP]), *([_UNRECTIFIED] if detector else [])),
    )


def _angle(root: ElementTree.Element, tag: str | None) -> float | None:
    """An angle between 0 and 180 degrees; None where there is none."""
    text = root.findtext(tag) if tag else None
    return median_angle(np.array(re.findall(r"^\s*[-+]?[0-9]+[.]?[0-9]*", text or ""), dtype=float))


def _number(text: str | None, what: str, path: Path) -> float:
    """The first number of a text, as DESIS lists one for each temperature."""
    number = number_of((text or "").split(",")[0])
    if not np.isfinite(number):
        raise refusal("sidecar.number", path, what=what, text=(text or "")[:40])
    return number


def _stac_assets(image: Path) -> Iterator[tuple[Path, dict[str, Any], dict[str, Any]]]:
    """Items of STAC beside an image whose assets name it: the file, the item, the asset."""
    own = image.with_suffix(".json")
    others = sorted(image.parent.glob("*.json"))[:MAX_ITEMS]
    for path in [own, *(p for p in others if p != own)]:
        if not path.is_file() or path.stat().st_size > MAX_JSON_BYTES:
            continue
        try:
            item = json.loads(checked_file(path, what="STAC item").read_text("utf-8"))
        except (ValueError, RecursionError):
            continue
        assets = item.get("assets") if isinstance(item, dict) and "stac_version" in item else None
        for asset in assets.values() if isinstance(assets, dict) else ():
            href = asset.get("href") if isinstance(asset, dict) else None
            if isinstance(href, str) and href.rsplit("/", 1)[-1] == image.name:
                yield path, item, asset


def _from_asset(item: dict[str, Any], asset: dict[str, Any], bands: int) -> Description | None:
    """What an item says of the bands of an asset (extensions eo and raster, STAC 1.0 and 1.1)."""
    given = item.get("properties")
    properties: dict[str, Any] = given if isinstance(given, dict) else {}
    of_asset = asset.get("bands") or asset.get("eo:bands")
    listed = of_asset or properties.get("bands") or properties.get("eo:bands")
    if not isinstance(listed, list) or len(listed) != bands or not all(isinstance(b, dict) for b in listed):
        return None
    raster = asset.get("raster:bands")
    details = [d if isinstance(d, dict) else {} for d in raster] if isinstance(raster, list) else []
    details = details if len(details) == bands else [{}] * bands

    def column(*names: str, default: float | None = None) -> list[float] | None:
        out = []
        for band, detail in zip(listed, details, strict=True):
            value = next((d[n] for n in names for d in (band, detail) if d.get(n) is not None), default)
            if not isinstance(value, int | float):
                return None
            out.append(float(value))
        return out

    centre = column("eo:center_wavelength", "center_wavelength")
    if centre is None:
        return None
    units = {str(d.get("unit")) for d in (*listed, *details) if d.get("unit")}
    unit = units.pop() if len(units) == 1 else None
    instruments = properties.get("instruments") or [properties.get("platform") or properties.get("constellation") or ""]
    sensor = str(instruments[0]) if isinstance(instruments, list) else str(instruments)
    width = column("eo:full_width_half_max", "full_width_half_max")
    said = f"{asset.get('title', '')} {properties.get('processing:level', '')}".lower()
    quantity = "radiance" if is_radiance(unit) else "reflectance" if "reflectance" in said else None
    gain, offset = column("raster:scale", "scale", default=1.0), column("raster:offset", "offset", default=0.0)
    nodata = {d.get("nodata") for d in (*listed, *details, asset) if isinstance(d.get("nodata"), int | float)}
    return Description(
        product="STAC item",
        bands=ListedBands(np.array(centre), None if width is None else np.array(width), "um"),  # as eo defines it
        scale=Scale(1.0 if gain is None else np.array(gain), np.array(offset or 0.0), "scale of the STAC item"),
        quantity=quantity,
        unit=unit if quantity == "radiance" else None,
        sensor=sensor,
        entries={"sensor": sensor, "acquisition time": str(properties.get("datetime") or "")},
        ignore_value=float(nodata.pop()) if len(nodata) == 1 else None,
    )

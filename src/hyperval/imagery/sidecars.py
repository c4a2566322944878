"""Metadata beside a GeoTIFF: METADATA.XML of EnMAP and DESIS, and items of STAC."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hyperval.errors import InputError, UsageError
from hyperval.imagery.description import Description
from hyperval.imagery.layouts import Sidecar, layouts, level_of
from hyperval.imagery.text_files import read_xml
from hyperval.paths import checked_file
from hyperval.units import radiance_to_internal

MAX_XML_BYTES = 64 << 20
MAX_JSON_BYTES = 4 << 20
_NO_MAP = "in scanner geometry: a map position of the file is a fit to its corners and is left aside"
_UNRECTIFIED = "one detector in scanner geometry: the other sees a place some lines apart, as a cube of its own"
MAX_ITEMS = 20  # files of JSON that are looked at for one that names the image


def described_beside(
    image: Path, bands: int, nodata: float | None = None, root: Path | None = None
) -> tuple[Description, Path] | None:
    """What the metadata beside a GeoTIFF of ``bands`` bands say of it, and their file; None where there are none.

    ``nodata`` : as the GeoTIFF itself states it, where the metadata do not.

    Raises
    ------
    InputError : metadata that are too large, not understood, or of another number of bands.
    """
    for sidecar in layouts().sidecars:
        at = image.name.upper().find(sidecar.image.upper())
        if at < 0:
            continue
        for name in (sidecar.metadata, sidecar.metadata.lower(), sidecar.metadata.upper()):
            candidate = image.with_name(image.name[:at] + name)
            if candidate.is_file():
                made = _from_xml(sidecar, checked_file(candidate, root=root, what="metadata file"), image, bands)
                if made is not None:
                    lacks = made.ignore_value is None and nodata is None
                    return (replace(made, ignore_value=sidecar.fill) if lacks else made), candidate
    return _from_stac(image, bands, root)


def image_of(metadata: Path, detector: str | None = None) -> Path:
    """The GeoTIFF that a METADATA.XML belongs to; of level 1B of EnMAP that of ``detector``, VNIR or SWIR.

    The two detectors of level 1B are two cubes: each sees a place some lines before the other, neither is on a map,
    and no shift by whole pixels lays one on the other.

    Raises
    ------
    InputError : no image.
    UsageError : several, and none or another one is named.
    """
    for sidecar in layouts().sidecars:
        if metadata.name.upper().endswith(sidecar.metadata.upper()):
            stem = metadata.name[: -len(sidecar.metadata)]
            start = (stem + sidecar.image).upper()
            tiffs = [p for p in sorted(metadata.parent.iterdir()) if p.suffix.upper() in (".TIF", ".TIFF")]
            fits = [p for p in tiffs if p.name.upper().startswith(start)]
            if not fits:
                raise InputError(f"no image {stem}{sidecar.image}... beside it", where=str(metadata))
            # The same image may lie there again, cut into tiles for the cloud.
            fits.sort(key=lambda p: not p.stem.upper().endswith("_COG"))
            of_detector = {p.stem[len(start) :].upper().removesuffix("_COG").strip("_"): p for p in fits}
            if detector is not None and detector.upper() in of_detector:
                return of_detector[detector.upper()]
            if detector is not None or len(of_detector) > 1:
                names = ", ".join(p.name for p in of_detector.values())
                raise UsageError(
                    f"{len(of_detector)} images could be meant: {names}",
                    where=str(metadata),
                    expected="variable: " + " or ".join(of_detector),
                    mend="state the detector; those of level 1B see a place some lines apart and are no one cube, "
                    "level 1C has them on one grid",
                )
            return next(iter(of_detector.values()))
    raise InputError("no metadata of a product that is known", where=str(metadata), expected="...-METADATA.XML")


def _from_xml(sidecar: Sidecar, path: Path, image: Path, bands: int) -> Description | None:
    root = read_xml(path, MAX_XML_BYTES)
    items = root.findall(sidecar.bands)
    if not items:
        return None
    tags = (sidecar.wavelength, sidecar.fwhm, sidecar.gain, sidecar.offset)
    table = np.array([[_number(item.findtext(tag), tag, path) for tag in tags] for item in items])
    named = re.search(r"_(VNIR|SWIR)", image.name.upper())
    detector = named[1] if named else None
    if len(table) != bands:
        if detector is None or len(table) < bands:
            raise InputError(
                f"{len(table)} bands in the metadata, {bands} in the image", where=str(path), mend="copy both again"
            )
        table = table[:bands] if detector == "VNIR" else table[-bands:]
    wavelength, width, gain, offset = table.T
    level = level_of([root.findtext(sidecar.level), root.findtext("base/format"), path.name])
    quantity = None if level is None else "reflectance" if level.startswith("L2") else "radiance"
    ignore = root.findtext(sidecar.ignore) if sidecar.ignore is not None else None
    entries = {"sensor": sidecar.sensor}
    zenith = _angle(root, sidecar.sun_zenith)
    if zenith is None and (elevation := _angle(root, sidecar.sun_elevation)) is not None:
        zenith = 90.0 - elevation
    rectified = level is None or not level.startswith("L1") or level == "L1C"
    notes = [] if rectified else [_NO_MAP]
    notes += [_UNRECTIFIED] if detector is not None else []
    when = root.findtext(sidecar.time) if sidecar.time is not None else None
    if when:
        entries["acquisition time"] = when.strip()
    return Description(
        product=f"{sidecar.sensor} {level or 'image'}",
        wavelength=wavelength,
        fwhm=width,
        wavelength_unit=sidecar.wavelength_unit,
        gain=gain,
        offset=offset,
        quantity=quantity,
        unit=sidecar.radiance_unit if quantity == "radiance" else "1" if quantity else None,
        ignore_value=_number(ignore, str(sidecar.ignore), path) if ignore else None,
        sensor=sidecar.sensor,
        rectified=rectified,
        sun_zenith_deg=zenith,
        sorts=True,
        entries=entries,
        notes=tuple(notes),
    )


def _angle(root: ElementTree.Element, tag: str | None) -> float | None:
    """An angle between 0 and 180 degrees; None where there is none."""
    try:
        angle = float((root.findtext(tag) if tag else None) or "nan")
    except ValueError:
        return None
    return angle if 0.0 <= angle <= 180.0 else None


def _number(text: str | None, what: str, path: Path) -> float:
    """The first number of a text, as DESIS lists one for each temperature."""
    try:
        number = float((text or "").split(",")[0])
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"{what}: {(text or '')[:40]!r} is no number", where=str(path))
    return number


def _from_stac(image: Path, bands: int, root: Path | None) -> tuple[Description, Path] | None:
    """What an item of STAC beside the image says of its bands (extensions eo and raster, STAC 1.0 and 1.1)."""
    own = image.with_suffix(".json")
    others = sorted(image.parent.glob("*.json"))[:MAX_ITEMS]
    for path in [own, *(p for p in others if p != own)]:
        if not path.is_file() or path.stat().st_size > MAX_JSON_BYTES:
            continue
        try:
            item = json.loads(checked_file(path, root=root, what="STAC item").read_text("utf-8"))
        except (ValueError, RecursionError):
            continue
        if not isinstance(item, dict) or "stac_version" not in item:
            continue
        assets = item.get("assets")
        for asset in assets.values() if isinstance(assets, dict) else ():
            href = asset.get("href") if isinstance(asset, dict) else None
            if isinstance(href, str) and href.rsplit("/", 1)[-1] == image.name:
                made = _from_asset(item, asset, bands, path)
                if made is not None:
                    return made, path
    return None


def _from_asset(item: dict[str, Any], asset: dict[str, Any], bands: int, path: Path) -> Description | None:
    listed = asset.get("bands") or asset.get("eo:bands")
    if not isinstance(listed, list) or len(listed) != bands or not all(isinstance(b, dict) for b in listed):
        return None
    raster = asset.get("raster:bands")
    details = raster if isinstance(raster, list) and len(raster) == bands else [{}] * bands

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
    given = item.get("properties")
    properties: dict[str, Any] = given if isinstance(given, dict) else {}
    instruments = properties.get("instruments") or [
        properties.get("platform") or properties.get("constellation") or ""
    ]
    width = column("eo:full_width_half_max", "full_width_half_max")
    quantity = _stac_quantity(unit, str(asset.get("title", "")) + " " + str(properties.get("processing:level", "")))
    made = Description(
        product="STAC item",
        wavelength=np.array(centre),
        fwhm=None if width is None else np.array(width),
        wavelength_unit="um",  # as the extension eo defines it
        gain=np.array(column("raster:scale", "scale", default=1.0)),
        offset=np.array(column("raster:offset", "offset", default=0.0)),
        quantity=quantity,
        unit=unit if quantity == "radiance" else None,
        sensor=str(instruments[0]),
        entries={"sensor": str(instruments[0]), "acquisition time": str(properties.get("datetime") or "")},
    )
    nodata = {d.get("nodata") for d in (*listed, *details, asset) if isinstance(d.get("nodata"), int | float)}
    return replace(made, ignore_value=float(nodata.pop())) if len(nodata) == 1 else made


def _stac_quantity(unit: str | None, text: str) -> str | None:
    try:
        radiance_to_internal(unit or "")
        return "radiance"
    except UsageError:
        return "reflectance" if re.search("reflectance", text, re.IGNORECASE) else None

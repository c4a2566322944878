"""Small files in the published layouts of products, attribute by attribute (``product_shells.yaml``)."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from affine import Affine
from rasterio.crs import CRS
from small_files import table, write_raster

LINES, SAMPLES = 12, 9
UTM11 = CRS.from_epsg(32611)
MAP = Affine(4.0, 0.0, 400_000.0, 0.0, -4.0, 3_800_000.0)
SHELLS: dict[str, Any] = table("product_shells")
KINDS = [(product, kind) for product, shell in SHELLS.items() for kind in shell["kinds"]]


def part(product: str, kind: str, name: str) -> dict[str, Any]:
    """A part of a shell, and what of it is of the kind alone; the words of the kind take the place of braces."""
    shell = SHELLS[product]

    def filled(node: Any) -> Any:
        if isinstance(node, dict):
            return {filled(key): filled(value) for key, value in node.items()}
        if isinstance(node, list):
            return [filled(value) for value in node]
        whole = isinstance(node, str) and node.startswith("{") and node[1:-1] in shell["kinds"][kind]
        words = {"kind": kind} | shell["kinds"][kind]
        return words[node[1:-1]] if whole else node.format(**words) if isinstance(node, str) else node

    return filled(shell.get(name, {}) | shell.get(f"{name} of {kind}", {}))


def drawn(bands: int, *, seed=1, low=0.5, high=9.0, type="f4", times=1.0, decimals=None, empty=None, dead=None):
    """(LINES, SAMPLES, bands) numbers, and where they are no data."""
    rng, size = np.random.default_rng(seed), (LINES, SAMPLES, bands)
    values = rng.uniform(low, high, size) * times if type == "f4" else rng.integers(low, high, size)
    values = values.astype(type) if decimals is None else np.round(values * decimals) / decimals
    if dead is not None:
        values[..., dead] = 0
    none = np.zeros(size, bool)
    if empty is not None:
        line, sample, value = empty
        values[line, sample], none[line, sample] = value, True
    return values, none


def arrays_of(product: str, kind: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The arrays of a shell by name, and where they are no data."""
    found = {name: drawn(**how) for name, how in part(product, kind, "drawn").items()}
    if product == "neon" and kind == "radiance":  # the integer and the decimal part in arrays of their own
        values, none = found["image"]
        whole = np.floor(values)
        found |= {"whole": (whole.astype("u1"), none), "part": (np.round((values - whole) * 50_000).astype("u2"), none)}
    row, col = np.mgrid[0:LINES, 0:SAMPLES]
    sun = np.full((LINES, SAMPLES), 41.5)
    shifted = np.zeros((2, 14, 12), np.int32)  # sample and line (from 1) of each cell of a map; moved by (2, 1) cells
    shifted[:, 1 : 1 + LINES, 2 : 2 + SAMPLES] = col + 1, row + 1
    plain = {
        "latitude": (44.0 - 0.0027 * row + 0.0005 * col).astype("f4"),
        "longitude": (10.0 + 0.0037 * col + 0.0004 * row).astype("f4"),
        "sun": sun, "sun with gaps": np.where(row < 2, -9999.0, sun), "sample": shifted[0], "line": shifted[1],
    }  # fmt: skip
    return found | {name: (values, np.zeros(values.shape, bool)) for name, values in plain.items()}


def worded(value: Any) -> Any:
    """A system or a text that is written out."""
    kind, _, rest = value.partition(" ") if isinstance(value, str) else ("", "", "")
    if kind in ("wkt", "esri"):
        return CRS.from_epsg(int(rest)).to_wkt(version="WKT1_ESRI" if kind == "esri" else "WKT2_2019")
    return rest if kind == "text" else value


def put(file: h5py.File, name: str, value: Any, *, order: str = "lsb", dims=(), chunks=None, **attributes) -> None:
    """An array with its attributes; dimensions as NetCDF-4 has them."""
    if isinstance(value, np.ndarray) and value.ndim == 3:
        value = value.transpose([("lsb").index(axis) for axis in order])
    elif not isinstance(value, np.ndarray):
        value = worded(value)
    packing = {"chunks": tuple(chunks), "compression": "gzip"} if chunks else {}
    made = file.create_dataset(name, data=value, **packing)
    for axis, dim in enumerate(dims):
        if dim not in file:
            file.create_dataset(dim, (made.shape[axis],), "f4")
            file[dim].make_scale("This is a netCDF dimension but not a netCDF variable.")
        made.dims[axis].attach_scale(file[dim])
    for key, stated in attributes.items():
        made.attrs[key] = made.dtype.type(stated) if key == "_FillValue" else worded(stated)


def tree(path: Path, product: str, kind: str | None = None, *, chunks=None) -> np.ndarray:
    """Write a product; returns its values (lines, samples, bands) in the units of the program, by wavelength."""
    kind = kind or next(iter(SHELLS[product]["kinds"]))
    arrays = arrays_of(product, kind)
    with h5py.File(path, "w") as file:
        for key, stated in part(product, kind, "attributes").items():
            file.attrs[key] = worded(stated)
        for name, item in part(product, kind, "items").items():
            value = item.pop("value")
            if isinstance(value, str) and value in arrays:
                value = arrays[value][0]
                if value.dtype == np.int32 and item.get("_FillValue"):
                    value = np.where(value > 0, value, item["_FillValue"]).astype("i4")
            more = {"chunks": chunks} if chunks is not None and "order" in item else {}
            put(file, name, value, **(item | more))
        for name, stated in part(product, kind, "groups").items():
            file[name].attrs.update(stated)
    truth = [
        np.where(arrays[name][1], np.nan, gain * arrays[name][0].astype(float) + offset)
        for name, (gain, offset) in part(product, kind, "truth").items()
    ]
    return np.concatenate(truth, axis=2)[..., part(product, kind, "read").get("bands", slice(None))]


def observation(path: Path, product: str, zenith: np.ndarray) -> None:
    """Angles of every pixel beside an image of AVIRIS-3 (arrays of a group) or EMIT (bands with names)."""
    with h5py.File(path, "w") as file:
        if product == "aviris":
            put(file, "observation_parameters/path_length", zenith + 4000)
            put(file, "observation_parameters/to_sun_zenith", zenith)
            return
        put(file, "obs", np.stack([zenith + 4000, zenith], axis=-1), _FillValue=-9999)
        names = np.array(["Path length (in meters)", "To-sun zenith (0 to 90 degrees from zenith)"], object)
        file.create_dataset("sensor_band_parameters/observation_bands", data=names, dtype=h5py.string_dtype())


def enmap(folder: Path, level: str = "L1C", *, sensor: str = "EnMAP") -> tuple[Path, np.ndarray]:
    """EnMAP (or DESIS): GeoTIFF of integers, METADATA.XML with centre, width, gain and offset by band."""
    stored = np.random.default_rng(5).integers(200, 5000, (4, LINES, SAMPLES)).astype(np.int16)
    stored[:, 0, 0] = -32768
    stem, end, names = f"ENMAP01-____{level}-DT0000001867_20220724T104526Z", "TIF", ("bandID", "FWHM", "Gain", "Offset")
    if sensor == "DESIS":
        stem, end, names = f"DESIS-HSI-{level}-DT0483531728", "tif", ("band", "wavelengthWidth", "gain", "offset")
    image = folder / f"{stem}-SPECTRAL_IMAGE.{end}"
    write_raster(image, stored, crs=UTM11, transform=Affine(30.0, 0, 400_000, 0, -30.0, 3_800_000), nodata=-32768)
    gains, offsets = scale_of(level, sensor)
    items = ""
    for i, row in enumerate(zip((423.0, 650.0, 911.6, 902.3), (6.6, 7.0, 9.1, 8.0), gains, offsets, strict=True)):
        tags = ("wavelengthCenterOfBand", *(f"{name}OfBand" for name in names[1:]))
        columns = "".join(f"<{tag}>{value!r}</{tag}>" for tag, value in zip(tags, map(float, row), strict=True))
        items += f'<{names[0]} number="{i + 1}">{columns}</{names[0]}>'
    text = (
        f"<level_X><base><level>{level}</level><temporalCoverage><startTime>2022-07-24T10:45:26Z</startTime>"
        f"</temporalCoverage></base><specific><backgroundValue>-32768</backgroundValue><bandCharacterisation>{items}"
        "</bandCharacterisation></specific></level_X>"
    )
    (folder / f"{stem}-METADATA.{'XML' if sensor == 'EnMAP' else 'xml'}").write_text(text)
    return image, stored


def scale_of(level: str, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Gains and offsets of the four bands as the metadata have them."""
    if level.startswith("L2"):
        return np.full(4, 1e-4), np.zeros(4)
    return np.array([1.2e-4, 1.1e-4, 0.9e-4, 0.5e-4]) * (10 if sensor == "DESIS" else 1), np.array([1e-3, 0, -2e-3, 0])


def enmap_two_detectors(folder: Path) -> dict[str, np.ndarray]:
    """EnMAP level 1B: a GeoTIFF for each detector, on no map, and one METADATA.XML with the bands of both."""
    image, stored = enmap(folder, "L1B")
    out = {"VNIR": stored[:2], "SWIR": stored[2:]}
    for detector, values in out.items():
        write_raster(image.with_name(f"{image.stem}_{detector}.TIF"), values, nodata=-32768)
    image.unlink()
    return out


def stac(folder: Path) -> tuple[Path, np.ndarray]:
    """A radiance GeoTIFF with its STAC item, as Wyvern publishes them: bands by the extensions eo and raster."""
    values = 10 * drawn(3)[0].transpose(2, 0, 1)
    image = folder / "wyvern_dragonette-001_20240501T183000.tiff"
    write_raster(image, values, crs=UTM11, transform=MAP, nodata=-9999.0)
    bands = [
        {"name": f"Band_{nm}", "eo:center_wavelength": nm / 1000, "eo:full_width_half_max": 0.02, "unit": "W/m2/sr/um"}
        for nm in (503, 650, 799)
    ]
    item = {
        "type": "Feature", "stac_version": "1.1.0", "id": image.stem,
        "properties": {"datetime": "2024-05-01T18:30:00Z", "platform": "Dragonette-001", "processing:level": "L1B"},
        "assets": {"Cloud optimized GeoTiff": {"href": f"./{image.name}", "bands": bands, "nodata": -9999.0}},
    }  # fmt: skip
    (folder / f"{image.stem}.json").write_text(json.dumps(item), "utf-8-sig")  # some programs write its mark
    return image, values

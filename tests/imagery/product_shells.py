"""Small files in the published layouts of products, attribute by attribute; the values are drawn.

Sources: the user guides named in ``imagery/layouts.yaml``, and the readers of isofit, SpectralUtil, hytools,
prismaread, enpt and EMIT's own utilities.  No product of a provider is in the project.
"""

from __future__ import annotations

import json
from pathlib import Path

import h5netcdf.legacyapi as netcdf
import h5py
import numpy as np
import rasterio
from affine import Affine
from rasterio.crs import CRS

LINES, SAMPLES = 12, 9
UTM11 = CRS.from_epsg(32611)
MAP = Affine(4.0, 0.0, 400_000.0, 0.0, -4.0, 3_800_000.0)


def radiances(bands: int, seed: int = 1) -> np.ndarray:
    """(LINES, SAMPLES, bands) radiances [uW cm-2 sr-1 nm-1] as float32."""
    return np.random.default_rng(seed).uniform(0.5, 9.0, (LINES, SAMPLES, bands)).astype(np.float32)


def shifted_table(rows: int = 14, cols: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Sample and line (from 1) of each cell of a map grid on which the image lies moved by (2, 1) cells."""
    sample, line = np.zeros((2, rows, cols), np.int32)
    sample[1 : 1 + LINES, 2 : 2 + SAMPLES] = np.arange(1, SAMPLES + 1)
    line[1 : 1 + LINES, 2 : 2 + SAMPLES] = np.arange(1, LINES + 1)[:, None]
    return sample, line


def gdal_text(transform: Affine) -> str:
    return " ".join(f"{v:.10g}" for v in transform.to_gdal())


def put(group, name: str, dims: tuple[str, ...], values, kind: str = "f4", *, fill=None, **more):
    """A NetCDF variable with its attributes; dimensions are made where they lack."""
    values = np.asarray(values)
    for dim, size in zip(dims, values.shape, strict=True):
        if dim not in group.dimensions and (group.parent is None or dim not in group.parent.dimensions):
            group.createDimension(dim, size)
    options = {key: more.pop(key) for key in ("chunksizes", "zlib") if key in more}
    made = group.createVariable(
        name, kind, dims, fill_value=None if fill is None else np.dtype(kind).type(fill), **options
    )
    made[...] = values
    for key, value in more.items():
        made.setncattr(key, value)


def aviris(path: Path, kind: str = "radiance", *, chunks: tuple[int, int, int] | None = None) -> np.ndarray:
    """AVIRIS-3: group radiance or reflectance (wavelength, lines, samples); radiance with its lookup table."""
    values = radiances(6) if kind == "radiance" else radiances(6) / 10.0
    values[3, 4] = -9999.0
    names = ("lines", "samples") if kind == "radiance" else ("northing", "easting")
    with netcdf.Dataset(path, "w") as file:
        file.setncattr("instrument", "AVIRIS-3")
        file.setncattr("time_coverage_start", "2025-08-14T18:02:11Z")
        grid = file.createVariable("transverse_mercator", "S1", ())
        grid.setncattr("spatial_ref", UTM11.to_wkt())
        grid.setncattr("GeoTransform", gdal_text(MAP))
        group, stored = file.createGroup(kind), values.transpose(2, 0, 1)
        unit, packed = "uW nm-1 cm-2 sr-1" if kind == "radiance" else "unitless", chunks is not None
        put(group, kind, ("wavelength", *names), stored, fill=-9999, chunksizes=chunks, zlib=packed, units=unit)
        put(group, "wavelength", ("wavelength",), [400, 500, 600, 700, 1600, 2200], "f8", units="nm")
        put(group, "fwhm", ("wavelength",), [7.4] * 6, "f8", units="nm")
        if kind == "radiance":
            table = file.createGroup("geolocation_lookup_table")
            for name, numbers in zip(("sample", "line"), shifted_table(), strict=True):
                put(table, name, ("northing", "easting"), np.where(numbers > 0, numbers, -9999), "i4", fill=-9999)
    return values


def emit(path: Path, kind: str = "radiance") -> np.ndarray:
    """EMIT: image (downtrack, crosstrack, bands) in the root, bands and location in groups."""
    values = radiances(5) if kind == "radiance" else radiances(5) / 10.0
    values[0, 0] = -9999.0
    degrees = Affine(0.00054, 0, -118.2, 0, -0.00054, 34.2)
    with netcdf.Dataset(path, "w") as file:
        file.setncattr("instrument", "EMIT")
        file.setncattr("time_coverage_start", "2024-05-01T19:11:03+0000")
        file.setncattr("geotransform", np.array(degrees.to_gdal()))
        file.setncattr("spatial_ref", CRS.from_epsg(4326).to_wkt())
        unit = "uW/cm^2/SR/nm" if kind == "radiance" else "unitless"
        put(file, kind, ("downtrack", "crosstrack", "bands"), values, fill=-9999, units=unit)
        bands = file.createGroup("sensor_band_parameters")
        put(bands, "wavelengths", ("bands",), [400.0, 600.0, 900.0, 1400.0, 2200.0], units="nm")
        put(bands, "fwhm", ("bands",), [8.5] * 5, units="nm")
        put(bands, "good_wavelengths", ("bands",), [1.0, 1.0, 1.0, 0.0, 1.0])
        location = file.createGroup("location")
        for name, numbers in zip(("glt_x", "glt_y"), shifted_table(), strict=True):
            put(location, name, ("ortho_y", "ortho_x"), numbers, "i4", fill=0)
    return values


def places(group, dims: tuple[str, str]) -> None:
    """Longitude and latitude of every pixel of a swath."""
    rows, cols = np.mgrid[0:LINES, 0:SAMPLES]
    put(group, "latitude", dims, 44.0 - 0.0027 * rows + 0.0005 * cols)
    put(group, "longitude", dims, 10.0 + 0.0037 * cols + 0.0004 * rows)


def hypso(path: Path) -> np.ndarray:
    """HYPSO L1B: group products with Lt (lines, samples, bands) in W m-2 sr-1 um-1, bands as its attributes."""
    values = radiances(5) * 10.0
    dims = ("lines", "samples")
    with netcdf.Dataset(path, "w") as file:
        file.setncattr("instrument", "HYPSO-1 Hyperspectral Imager")
        bands = {"wavelengths": np.array([400.3, 450.1, 550.2, 650.9, 790.4]), "fwhm": np.array([5.5] * 5)}
        put(file.createGroup("products"), "Lt", (*dims, "bands"), values, units="W/m^2/micrometer/sr", **bands)
        places(file.createGroup("navigation"), dims)
        put(file["navigation"], "solar_zenith", dims, np.full((LINES, SAMPLES), 41.5))
    return values


def oci(path: Path) -> np.ndarray:
    """PACE OCI L2: geophysical_data/rhos (lines, pixels, wavelength_3d), packed, its bands and places in groups."""
    stored = np.random.default_rng(7).integers(-20_000, 20_000, (LINES, SAMPLES, 4)).astype(np.int16)
    stored[1, 2] = -32767
    dims = ("number_of_lines", "pixels_per_line")
    with netcdf.Dataset(path, "w") as file:
        packing = {"fill": -32767, "scale_factor": np.float32(1e-5), "add_offset": np.float32(0.25), "units": "1"}
        put(file.createGroup("geophysical_data"), "rhos", (*dims, "wavelength_3d"), stored, "i2", **packing)
        bands = file.createGroup("sensor_band_parameters")
        put(bands, "wavelength_3d", ("wavelength_3d",), [346.0, 440.0, 665.0, 2131.0], units="nm")
        places(file.createGroup("navigation_data"), dims)
    return np.where(stored == -32767, np.nan, 1e-5 * stored + 0.25)


def observation(path: Path, product: str, zenith: np.ndarray) -> None:
    """Angles of every pixel beside an image of AVIRIS-3 (arrays of a group) or EMIT (bands with names)."""
    with netcdf.Dataset(path, "w") as file:
        if product == "aviris":
            group = file.createGroup("observation_parameters")
            for name, values in (("path_length", zenith + 4000), ("to_sun_zenith", zenith)):
                put(group, name, ("lines", "samples"), values, "f8")
            return
        put(file, "obs", ("downtrack", "crosstrack", "bands"), np.stack([zenith + 4000, zenith], axis=-1), fill=-9999)
        names = file.createGroup("sensor_band_parameters").createVariable("observation_bands", str, ("bands",))
        names[:] = np.array(["Path length (in meters)", "To-sun zenith (0 to 90 degrees from zenith)"])


def neon_reflectance(path: Path) -> np.ndarray:
    """NEON AOP reflectance: SITE/Reflectance, integers over Scale_Factor."""
    stored = np.random.default_rng(2).integers(100, 6000, (LINES, SAMPLES, 4)).astype(np.int16)
    stored[1, 2] = -9999
    with h5py.File(path, "w") as file:
        group = file.create_group("SERC/Reflectance")
        group.attrs["Band_Window_1_Nanometers"] = np.array([1340, 1445])
        group.attrs["Band_Window_2_Nanometers"] = np.array([1790, 1955])
        image = group.create_dataset("Reflectance_Data", data=stored, chunks=(4, 5, 2), compression="gzip")
        image.attrs["Scale_Factor"] = 10000.0
        image.attrs["Data_Ignore_Value"] = -9999.0
        image.attrs["Units"] = "Unitless. Valid range 0-1."
        neon_metadata(group, [450.0, 650.0, 1400.0, 2100.0])
        group.create_dataset("Metadata/Logs/Solar_Zenith_Angle", data=27.5)
    return stored


def neon_radiance(path: Path) -> np.ndarray:
    """NEON AOP radiance: integer and decimal part in arrays of their own."""
    values = np.round(radiances(4) * 50_000) / 50_000
    whole = np.floor(values)
    with h5py.File(path, "w") as file:
        group = file.create_group("SERC/Radiance")
        first = group.create_dataset("RadianceIntegerPart", data=whole.astype(np.uint8))
        first[5, 5] = 255
        first.attrs["Data_Ignore_Value"] = 255.0
        second = group.create_dataset("RadianceDecimalPart", data=np.round((values - whole) * 50_000).astype(np.uint16))
        second.attrs["Scale_Factor"] = 50_000.0
        neon_metadata(group, [450.0, 650.0, 860.0, 2100.0])
    values[5, 5] = np.nan
    return values


def neon_metadata(group: h5py.Group, wavelength: list[float]) -> None:
    bands = group.create_group("Metadata/Spectral_Data")
    bands.create_dataset("Wavelength", data=wavelength).attrs["Units"] = "nanometers"
    bands.create_dataset("FWHM", data=[5.8] * len(wavelength)).attrs["Units"] = "nanometers"
    system = group.create_group("Metadata/Coordinate_System")
    system["Map_Info"] = (
        "UTM,  1.000,  1.000,  368000.000,  4306000.000,  1.0,  1.0,  18,  North,  WGS-84,  units=Meters, 0"
    )
    system["EPSG Code"] = "32618"
    system["Coordinate_System_String"] = CRS.from_epsg(32618).to_wkt(version="WKT1_ESRI")


def prisma(path: Path, level: str = "L1", *, edges: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """PRISMA: VNIR and SWIR cubes (line, band, sample), wavelengths that fall, flags and scales of the root."""
    rng = np.random.default_rng(3)
    vnir = rng.integers(1000, 60_000, (LINES, 4, SAMPLES)).astype(np.uint16)
    swir = rng.integers(1000, 60_000, (LINES, 3, SAMPLES)).astype(np.uint16)
    vnir[:, 3], swir[:, 2] = 0, 0  # bands without a wavelength
    if level == "L1":
        vnir, swir = vnir // 20, swir // 20
    with h5py.File(path, "w") as file:
        fields = file.create_group(f"HDFEOS/SWATHS/PRS_{level}_HCO/Data Fields")
        fields["VNIR_Cube"], fields["SWIR_Cube"] = vnir, swir
        file.attrs["Sun_zenith_angle"] = np.float32(31.25)
        file.attrs["Product_StartTime"] = np.bytes_("2023-06-02T10:09:31.102")
        file.attrs["List_Cw_Vnir"] = np.array([972.7, 650.8, 402.5, 0.0], np.float32)
        file.attrs["List_Fwhm_Vnir"] = np.array([12.0, 10.0, 11.0, 0.0], np.float32)
        file.attrs["List_Cw_Vnir_Flags"] = np.array([1, 1, 1, 0], np.uint8)
        file.attrs["List_Cw_Swir"] = np.array([2496.9, 951.0, 0.0], np.float32)
        file.attrs["List_Fwhm_Swir"] = np.array([9.0, 10.5, 0.0], np.float32)
        file.attrs["List_Cw_Swir_Flags"] = np.array([1, 1, 0], np.uint8)
        if level == "L1":
            for name in ("Vnir", "Swir"):
                file.attrs[f"ScaleFactor_{name}"], file.attrs[f"Offset_{name}"] = np.float32(100.0), np.float32(0.5)
        if level != "L2D":
            place = file.create_group(f"HDFEOS/SWATHS/PRS_{level}_HCO/Geolocation Fields")
            rows, cols = np.mgrid[0:LINES, 0:SAMPLES]
            end = "_VNIR" if level == "L1" else ""
            place["Latitude" + end] = (44.0 - 0.00027 * rows + 0.00005 * cols).astype(np.float32)
            place["Longitude" + end] = (10.0 + 0.00037 * cols + 0.00004 * rows).astype(np.float32)
        if level != "L1":
            for name, low, high in (("Vnir", 0.0, 0.9), ("Swir", 0.01, 0.7)):
                file.attrs[f"L2Scale{name}Min"], file.attrs[f"L2Scale{name}Max"] = np.float32(low), np.float32(high)
            inner = 0 if edges else 1
            file.attrs["Epsg_Code"] = np.uint32(32632)
            west, north = 600_000.0, 4_900_000.0
            file.attrs["Product_ULcorner_easting"], file.attrs["Product_ULcorner_northing"] = west, north
            file.attrs["Product_LRcorner_easting"] = west + 30.0 * (SAMPLES - inner)
            file.attrs["Product_LRcorner_northing"] = north - 30.0 * (LINES - inner)
    return vnir, swir


def tanager(path: Path, kind: str = "toa_radiance", *, ortho: bool = False) -> np.ndarray:
    """Tanager: swath or grid HYP (band, line, sample), bands as attributes of the image."""
    values = radiances(5, seed=4) * 10.0 if kind == "toa_radiance" else radiances(5, seed=4) / 10.0
    values[2, 3] = -9999.0
    root = "GRIDS" if ortho else "SWATHS"
    with h5py.File(path, "w") as file:
        fields = file.create_group(f"HDFEOS/{root}/HYP/Data Fields")
        image = fields.create_dataset(kind, data=values.transpose(2, 0, 1), chunks=(5, 4, 4), compression="gzip")
        image.attrs["wavelengths"] = np.array([400.0, 600.0, 900.0, 1400.0, 2200.0])
        image.attrs["fwhm"] = np.array([5.5] * 5)
        if kind == "surface_reflectance":
            image.attrs["_FillValue"] = np.float32(-9999.0)
            image.attrs["good_wavelengths"] = np.array([1, 1, 1, 0, 1])
        else:  # no fill value: that of the layout
            image.attrs["Unit"] = "uW/(cm^2 sr um)"
        fields["sun_zenith"] = np.where(np.arange(LINES)[:, None] < 2, -9999.0, np.full((LINES, SAMPLES), 33.0))
        if ortho:
            file["HDFEOS/GRIDS/HYP"].attrs["epsg_code"] = 32611
            text = (
                "GROUP=GridStructure\n\tUpperLeftPointMtrs=(400000.000000,3800000.000000)\n"
                f"\tLowerRightMtrs=({400_000 + 30 * SAMPLES}.000000,{3_800_000 - 30 * LINES}.000000)\nEND_GROUP\n"
            )
            file["HDFEOS INFORMATION/StructMetadata.0"] = text
    return values


def enmap(folder: Path, level: str = "L1C", *, sensor: str = "EnMAP") -> tuple[Path, np.ndarray]:
    """EnMAP (or DESIS): GeoTIFF of integers, METADATA.XML with centre, width, gain and offset by band."""
    stored = np.random.default_rng(5).integers(200, 5000, (4, LINES, SAMPLES)).astype(np.int16)
    stored[:, 0, 0] = -32768
    stem = (
        f"ENMAP01-____{level}-DT0000001867_20220724T104526Z" if sensor == "EnMAP" else f"DESIS-HSI-{level}-DT0483531728"
    )
    image = folder / f"{stem}-SPECTRAL_IMAGE.{'TIF' if sensor == 'EnMAP' else 'tif'}"
    with rasterio.open(
        image, "w", driver="GTiff", width=SAMPLES, height=LINES, count=4, dtype="int16", crs=UTM11,
        transform=Affine(30.0, 0, 400_000, 0, -30.0, 3_800_000), nodata=-32768,
    ) as file:  # fmt: skip
        file.write(stored)
    gains, offsets = [1.2e-4, 1.1e-4, 0.9e-4, 0.5e-4], [1e-3, 0.0, -2e-3, 0.0]
    if sensor == "DESIS":
        gains = [10 * g for g in gains]
    if level.startswith("L2"):
        gains, offsets = [1e-4] * 4, [0.0] * 4
    names = (
        ("bandID", "wavelengthCenterOfBand", "FWHMOfBand", "GainOfBand", "OffsetOfBand")
        if sensor == "EnMAP"
        else ("band", "wavelengthCenterOfBand", "wavelengthWidthOfBand", "gainOfBand", "offsetOfBand")
    )
    items = ""
    for i, row in enumerate(zip((423.0, 650.0, 911.6, 902.3), (6.6, 7.0, 9.1, 8.0), gains, offsets, strict=True)):
        items += f'<{names[0]} number="{i + 1}">'
        items += "".join(f"<{tag}>{value!r}</{tag}>" for tag, value in zip(names[1:], row, strict=True))
        items += f"</{names[0]}>"
    text = (
        f"<level_X><base><level>{level}</level><temporalCoverage><startTime>2022-07-24T10:45:26Z</startTime>"
        f"</temporalCoverage></base><specific><backgroundValue>-32768</backgroundValue><bandCharacterisation>{items}"
        "</bandCharacterisation></specific></level_X>"
    )
    (folder / f"{stem}-METADATA.{'XML' if sensor == 'EnMAP' else 'xml'}").write_text(text)
    return image, stored


def enmap_two_detectors(folder: Path) -> dict[str, np.ndarray]:
    """EnMAP level 1B: a GeoTIFF for each detector, on no map, and one METADATA.XML with the bands of both."""
    image, stored = enmap(folder, "L1B")
    out = {"VNIR": stored[:2], "SWIR": stored[2:]}
    for detector, values in out.items():
        with rasterio.open(
            image.with_name(f"{image.stem}_{detector}.TIF"), "w", driver="GTiff", width=SAMPLES, height=LINES,
            count=2, dtype="int16", nodata=-32768,
        ) as file:  # fmt: skip
            file.write(values)
    image.unlink()
    return out


def stac(folder: Path) -> tuple[Path, np.ndarray]:
    """A radiance GeoTIFF with its STAC item, as Wyvern publishes them: bands by the extensions eo and raster."""
    values = radiances(3).transpose(2, 0, 1) * 10.0
    image = folder / "wyvern_dragonette-001_20240501T183000.tiff"
    with rasterio.open(
        image, "w", driver="GTiff", width=SAMPLES, height=LINES, count=3, dtype="float32", crs=UTM11, transform=MAP,
        nodata=-9999.0,
    ) as file:  # fmt: skip
        file.write(values)
    unit = "W/m2/sr/um"
    bands = [
        {"name": f"Band_{nm}", "eo:center_wavelength": nm / 1000, "eo:full_width_half_max": 0.02, "unit": unit}
        for nm in (503, 650, 799)
    ]
    item = {
        "type": "Feature", "stac_version": "1.1.0", "id": image.stem,
        "properties": {"datetime": "2024-05-01T18:30:00Z", "platform": "Dragonette-001", "processing:level": "L1B"},
        "assets": {"Cloud optimized GeoTiff": {"href": f"./{image.name}", "bands": bands, "nodata": -9999.0}},
    }  # fmt: skip
    (folder / f"{image.stem}.json").write_text(json.dumps(item))
    return image, values

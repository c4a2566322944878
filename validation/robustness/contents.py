"""Contents of small valid files in every format that is read."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import product_shells
import rasterio
import scipy.io
import xarray as xr
from small_files import SHAPE, SQUARE, expected, geojson, on_map, polygon, roi_ascii, roi_binary, xml
from small_files import TRANSFORM as MAP
from small_files import UTM18 as UTM

from hyperval.atmosphere import AtmosphericTable, write_table
from hyperval.atmosphere.table import QUANTITIES
from hyperval.imagery import write_cube
from hyperval.products import PredictedProducts, RocCurve, ScoreDistribution, SpectralEstimate
from hyperval.run import write_products
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class, write_statistics_library

NM = np.arange(400.0, 1000.0, 50.0)
RHO = 0.3 + 0.1 * np.sin(NM / 90.0)


def drawn() -> dict[str, tuple[str, bytes]]:
    """File name and content of one region in every format."""
    listed = {
        **json.loads(geojson(polygon(on_map(SQUARE)))),
        "crs": {"type": "name", "properties": {"name": "EPSG:32618"}},
    }
    pixels = "region,row0,col0\n" + "".join(f"grass,{i},{j}\n" for i, j in np.argwhere(expected()))
    return {
        "geojson": ("a.geojson", json.dumps(listed, indent=1).encode()),
        "roi xml": ("a.xml", xml(SQUARE).encode()),
        "roi text": ("a.txt", roi_ascii(expected()).encode()),
        "roi binary": ("a.roi", roi_binary(points=(38, 39, 40), polygons=[SQUARE])),
        "pixel list": ("a.csv", pixels.encode()),
    }


def prediction() -> PredictedProducts:
    """A prediction of two spectra, a curve and scores."""
    grid = np.linspace(-1.0, 2.0, 9)
    pfa = np.array([1e-3, 1e-2, 0.1, 1.0])
    curve = RocCurve(pfa, np.sqrt(pfa), 0.9 * np.sqrt(pfa), np.sqrt(pfa), np.array([3.0, 2.0, 1.0, -9.0]))
    estimate = SpectralEstimate(RHO, np.diag((0.01 * RHO) ** 2))
    return PredictedProducts(
        SpectralAxis(NM, np.full(NM.size, 20.0), np.ones(NM.size, bool)),
        radiance={"grass": estimate},
        reflectance={"grass": estimate},
        scores={("planks", "cem"): ScoreDistribution(1.0, 0.3, None, grid, np.exp(-(grid**2)))},
        roc={("planks", "cem", "pixel"): curve},
    )


def with_text_beside(folder: Path) -> dict[str, dict[str, bytes]]:
    """Images of which a file beside them says what their numbers are; that file comes first."""
    counts = np.random.default_rng(2).integers(100, 9000, (*SHAPE, NM.size)).astype(np.int16)
    axis = SpectralAxis(NM, np.full(NM.size, 20.0))
    write_cube(folder / "f1rdn_img.dat", counts, data_type=2, interleave="bip", axis=axis)
    gain = "".join(f"{300.0 if nm < 700 else 600.0:.1f} {i}\n" for i, nm in enumerate(NM, start=1))
    out = {"aviris gain": {"f1rdn.gain": gain.encode()}}
    out["aviris gain"] |= {name: (folder / name).read_bytes() for name in ("f1rdn_img.dat", "f1rdn_img.hdr")}
    (folder / "stac").mkdir()
    image, _ = product_shells.stac(folder / "stac")
    item = image.with_suffix(".json")
    out["stac item"] = {item.name: item.read_bytes(), image.name: image.read_bytes()}
    # DIRSIG's truth: 64-bit numbers, the header under the whole name, each band with its name.
    material = np.where(np.arange(SHAPE[0])[:, None] < 5, 3.0, 12.0) * np.ones(SHAPE)
    abundance = np.zeros(SHAPE)
    abundance[2:4, 5:7] = 0.75
    header = (
        f"ENVI\nsamples = {SHAPE[1]}\nlines = {SHAPE[0]}\nbands = 2\nheader offset = 0\ndata type = 5\n"
        "interleave = bip\nbyte order = 0\nband names = {Material Index, Abundance - panel 7}\n"
    )
    values = np.stack([material, abundance], axis=2).astype("<f8").tobytes()
    out["dirsig header"] = {"truth.img.hdr": header.encode(), "truth.img": values}
    out["dirsig truth"] = dict(reversed(out["dirsig header"].items()))
    return out


def run_products(folder: Path) -> dict[str, bytes]:
    """The file in which a run keeps its products."""
    write_products(folder, {"predicted": prediction()}, title="t", simulated=True)
    return {"products.nc": (folder / "products.nc").read_bytes()}


def products_of_imagers(folder: Path) -> dict[str, dict[str, bytes]]:
    """Small images in the layouts of their providers; the file that is damaged comes first."""
    kinds = {name: (name, None) for name in ("aviris", "emit", "tanager", "hypso", "oci")}
    kinds |= {f"neon {kind}": ("neon", kind) for kind in ("reflectance", "radiance")}
    kinds |= {f"prisma {kind.lower()}": ("prisma", kind) for kind in ("L1", "L2B", "L2D")}
    out = {}
    for name, (product, kind) in kinds.items():
        path = folder / ("a.he5" if name.startswith("prisma") else "a.nc" if name in ("aviris", "emit") else "a.h5")
        product_shells.tree(path, product, kind)
        out[name] = {path.name: path.read_bytes()}
        path.unlink()
    (folder / "enmap").mkdir()
    image, _ = product_shells.enmap(folder / "enmap")
    files = {path.name: path.read_bytes() for path in (folder / "enmap").iterdir()}
    data = next(name for name in files if name.endswith(".XML"))
    out["enmap metadata"] = {data: files[data], image.name: files[image.name]}
    out["enmap image"] = {image.name: files[image.name], data: files[data]}
    return out


def written(folder: Path) -> dict[str, dict[str, bytes]]:
    """Files that the project's writers or libraries make, by sample."""
    axis = SpectralAxis(NM, np.full(NM.size, 20.0))
    values = np.random.default_rng(1).uniform(0.1, 0.9, (*SHAPE, NM.size)).astype(np.float32)

    def taken(*names: str) -> dict[str, bytes]:
        return {name: (folder / name).read_bytes() for name in names}

    out = {}
    write_cube(folder / "a.img", values, data_type=4, interleave="bil", axis=axis)
    out["envi cube"] = taken("a.img", "a.hdr")
    library = (
        f"ENVI\nsamples = {NM.size}\nlines = 2\nbands = 1\nheader offset = 0\nfile type = ENVI Spectral Library\n"
        "data type = 5\ninterleave = bsq\nbyte order = 0\nwavelength units = nm\n"
        f"wavelength = {{{', '.join(map(str, NM))}}}\nspectra names = {{one, two}}\n"
    )
    out["envi library"] = {"b.sli": np.stack([RHO, RHO / 2]).tobytes(), "b.hdr": library.encode()}
    column, row = np.meshgrid(np.arange(1, 13), np.arange(1, 11))
    cells = np.stack([column, row], axis=-1).astype(np.int32)
    write_cube(folder / "glt.dat", cells, data_type=3, interleave="bip", transform=MAP, crs=UTM)
    out["lookup table"] = taken("glt.dat", "glt.hdr")
    options = {"width": 12, "height": 10, "count": 3, "dtype": "int16", "crs": "EPSG:32618", "transform": MAP}
    with rasterio.open(folder / "a.tif", "w", driver="GTiff", compress="deflate", **options) as dataset:
        dataset.write((values[..., :3].transpose(2, 0, 1) * 1e4).astype(np.int16))
        for band in (1, 2, 3):
            dataset.update_tags(band, wavelength=str(400 + 50 * band), wavelength_units="nm")
    out["geotiff"] = taken("a.tif")
    with rasterio.open(folder / "mask.tif", "w", driver="GTiff", **{**options, "count": 1}) as dataset:
        dataset.write((values[..., :1].transpose(2, 0, 1) > 0.8).astype(np.int16))
    out["region raster"] = taken("mask.tif")
    scipy.io.savemat(folder / "a.mat", {"data": values, "map": values[..., 0] > 0.8}, do_compression=True)
    out["matlab 5"] = taken("a.mat")
    with h5py.File(folder / "b.mat", "w", userblock_size=512) as file:
        file["data"] = values.T
    with open(folder / "b.mat", "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")
    out["matlab 7.3"] = taken("b.mat")
    np.save(folder / "a.npy", values)
    out["numpy"] = taken("a.npy")
    data = xr.Dataset(
        {"radiance": (("y", "x", "wavelength"), values, {"units": "uW cm-2 sr-1 nm-1"})},
        coords={"wavelength": ("wavelength", NM, {"units": "nm"})},
    )
    data.to_netcdf(folder / "a.nc", engine="h5netcdf")
    out["netcdf cube"] = taken("a.nc")
    with h5py.File(folder / "a.h5", "w") as file:
        file["cube"] = values
        file["cube"].attrs["units"] = "uW cm-2 sr-1 nm-1"
        file["wavelength"] = NM
        file["wavelength"].attrs["units"] = "nm"
    out["hdf5 tree"] = taken("a.h5")
    ones = np.full((2, NM.size), 0.2)
    table = AtmosphericTable(
        NM, {"aot550": np.array([0.0, 0.4])}, {"model": "tropical"}, dict.fromkeys(QUANTITIES, ones)
    )
    write_table(table, folder / "table.nc")
    out["table"] = taken("table.nc")
    write_statistics_library(folder / "library.nc", [builtin_class("grass", axis)])
    out["statistics library"] = taken("library.nc")
    return out

"""Small valid files, one or more for every reader, and what must hold for anything that a reader gives back."""

from __future__ import annotations

import gzip
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "imagery"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "shared"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "atmosphere"))

from contents import MAP, NM, SHAPE, UTM, drawn, products_of_imagers, run_products, with_text_beside, written
from modtran_samples import channels, spectrum, tape7
from spectra_shells import RADCALNET, asd, hypernets, specpr

from hyperval.atmosphere import read_channels, read_chn, read_modtran_json, read_table, read_tape7, terms_from_runs
from hyperval.baseline import load_baseline
from hyperval.campaign import read_jobs
from hyperval.collection import AbundanceTruth, BandTableFile, RegionSource
from hyperval.config import load_yaml
from hyperval.envi_header import read_header
from hyperval.imagery import Cube, open_cube, open_lookup_table, read_regions, read_targets
from hyperval.observe import image_targets, material_regions, read_band_table
from hyperval.results import Result
from hyperval.run import read_products, read_rows, results_json
from hyperval.scenario import load_scenario
from hyperval.sensor import load_sensor
from hyperval.simulate.schema import load_scene
from hyperval.spectra import read_records
from hyperval.statistics_library import read_statistics_library
from hyperval.study import load_study

ROOT = Path(__file__).parents[2]
# Texts of spectra that are known to be read.
TEXTS = yaml.safe_load((ROOT / "tests" / "spectra" / "texts.yaml").read_text("utf-8"))["read"]


@dataclass(frozen=True)
class Sample:
    """A valid file and its reader.

    Attributes
    ----------
    name : of the file that is damaged; files of the same start go with it
    files : name -> content
    read : what reads the folder and checks what came back
    share : how many of all mutants it gets, relative to the others
    """

    name: str
    files: dict[str, bytes]
    read: Callable[[Path], Any]
    share: float = 1.0


class ImplausibleError(AssertionError):
    """A reader gave back what cannot be."""


def increasing(values: Any, name: str) -> None:
    """Refuse numbers that do not increase, or are not finite."""
    array = np.asarray(values, dtype=float)
    if array.size == 0 or not np.all(np.isfinite(array)) or np.any(np.diff(array) <= 0):
        raise ImplausibleError(f"{name}: {array[:5]} ...")


def finite(values: Any, name: str) -> None:
    """Refuse numbers that are not finite."""
    if not np.all(np.isfinite(np.asarray(values, dtype=float))):
        raise ImplausibleError(f"{name} is not finite")


def _spectra(path: Path) -> None:
    for found in read_records(path):
        increasing(found.wavelength_nm, "wavelength_nm")
        finite(found.values, "values")
        if found.values.shape != found.wavelength_nm.shape:
            raise ImplausibleError("values and wavelengths differ in number")


def _terms(path: Path) -> None:
    runs = read_channels(path)
    terms = read_chn(path) if len(runs) == 1 else terms_from_runs(runs)
    finite(terms.path_radiance, "path_radiance")


def _table(path: Path) -> None:
    table = read_table(path)
    increasing(table.wavelength_nm, "wavelength_nm")
    for name, values in table.quantities.items():
        finite(values, name)


def _cube(path: Path, quantity: str = "other", axis: str | None = None) -> None:
    cube = open_cube(path, quantity=quantity, axis=axis)
    increasing(cube.axis.centre_nm, "wavelength_nm")
    for block in cube.blocks(2):
        if block.values.shape[1:] != (cube.samples, cube.bands):
            raise ImplausibleError(f"a block of shape {block.values.shape}")


def _truth(path: Path) -> None:
    """Truth of a simulation, in the size of a cube that has nothing else to do with it."""
    size = cast("Cube", SimpleNamespace(lines=SHAPE[0], samples=SHAPE[1], shape=SHAPE, transform=None, crs=None))
    source = RegionSource(file=path.name, band="material*", classes={"grass": 3, "asphalt": 12})
    for region in material_regions(source, size, path).values():
        if region.mask.shape != SHAPE or not region.mask.any():
            raise ImplausibleError(f"region {region.name!r} of shape {region.mask.shape}")
    truth = AbundanceTruth(image=path.name, materials={"panel": "*panel*"})
    for target in image_targets(truth, size, 4.0, lambda name: path)[0]:
        finite(target.area_m2, "area_m2")
        if target.fills is None or target.fills.min() < 0 or target.fills.max() > 1:
            raise ImplausibleError(f"fills of {target.name!r}")


def _regions(path: Path) -> None:
    for region in read_regions(path, SHAPE, transform=MAP, crs=UTM).values():
        if region.mask.shape != SHAPE or not region.mask.any():
            raise ImplausibleError(f"region {region.name!r} of shape {region.mask.shape}")


def _targets(path: Path) -> None:
    for target in read_targets(path, SHAPE, transform=MAP):
        finite(target.area_m2, "area_m2")
        if target.mask.shape != SHAPE:
            raise ImplausibleError("a mask of another shape")


def _library(path: Path) -> None:
    found = read_statistics_library(path, "grass")
    finite(found.mean, "mean")
    finite(found.covariance, "covariance")


def _band_table(path: Path) -> None:
    increasing(read_band_table(path, BandTableFile(path="x", wavelength_unit="nm", fwhm_column=1)).centre_nm, "centre")


def _header(path: Path) -> None:
    header = read_header(path)
    if min(header.lines, header.samples, header.bands) < 1 or header.expected_bytes < 1:
        raise ImplausibleError(f"{header.lines} x {header.samples} x {header.bands}")


def _yaml() -> dict[str, tuple[Path, Callable[[Path], Any], float]]:
    """A committed file of every kind, its reader, and its share."""
    campaign = ROOT / "campaigns" / "share2012-twin"
    return {
        "yaml": (ROOT / "studies" / "tornado.yaml", load_yaml, 0.1),
        "campaign": (campaign / "campaign.yaml", lambda path: [job.campaign for job in read_jobs(path)], 0.06),
        "campaign texts": (ROOT / "campaigns" / "share2012-avon" / "campaign.yaml", read_jobs, 0.06),
        "scenario": (campaign / "scenario.yaml", load_scenario, 0.06),
        "scene": (campaign / "scene.yaml", load_scene, 0.06),
        "sensor": (ROOT / "src" / "hyperval" / "sensor" / "library" / "hydice.yaml", load_sensor, 0.06),
        "study": (ROOT / "studies" / "tornado.yaml", load_study, 0.06),
        "baseline": (ROOT / "validation" / "baselines" / "pasadena-2017.yaml", load_baseline, 0.06),
    }


def samples(folder: Path) -> list[Sample]:
    """Every sample; ``folder`` is where files are made that need writers."""
    out = [
        Sample(f"spectra: text {i}", {"a.txt": text.encode()}, lambda f: _spectra(f / "a.txt"), 0.3)
        for i, text in enumerate(TEXTS)
    ]
    for version, code in ((b"as7", 2), (b"as6", 0), (b"as8", 1)):
        raw = {"a.asd": asd(version=version, code=code)}
        out.append(Sample(f"spectra: asd {code}", raw, lambda f: _spectra(f / "a.asd")))
    for kind, (file, content) in drawn().items():
        out.append(Sample(f"regions: {kind}", {file: content}, lambda f, n=file: _regions(f / n)))
    targets = "name,material,easting,northing,side_m\np1,plank,300010,4699990,1.5\np2,plank,300016,4699986,0.5\n"
    bands = "# centre,fwhm\n" + "".join(f"{nm:g},20\n" for nm in NM)
    three = "".join(channels(rho=rho) for rho in (0.5, 0.0, 0.1))
    deck = {"MODTRAN": [{"MODTRANINPUT": {"ATMOSPHERE": {"MODEL": "ATM_TROPICAL", "H2OSTR": 1.5, "H2OUNIT": "g"},
            "AEROSOLS": {"IHAZE": "AER_RURAL", "VIS": -0.1}, "SURFACE": {"SURREF": 0.1, "GNDALT": 0.3},
            "GEOMETRY": {"H1ALT": 3.0, "IDAY": 100, "IPARM": 12, "PARM1": 30.0, "PARM2": 40.0}}}]}  # fmt: skip
    compared = [Result("c", "radiance", "s", "m", "bias_ratio", value=1.0 + i, reason="r") for i in range(3)]
    packed = gzip.compress(three.encode(), mtime=0)
    out += [
        Sample("targets", {"t.csv": targets.encode()}, lambda f: _targets(f / "t.csv")),
        Sample("band table", {"b.csv": bands.encode()}, lambda f: _band_table(f / "b.csv")),
        Sample("chn", {"a.chn": channels(rho=0.2).encode()}, lambda f: _terms(f / "a.chn")),
        Sample("chn, three runs", {"a.chn.gz": packed}, lambda f: _terms(f / "a.chn.gz")),
        Sample("chn, three runs unpacked", {"a.chn": three.encode()}, lambda f: _terms(f / "a.chn"), 0.5),
        Sample("tape7", {"tape7": tape7([0.0], terms=spectrum(8)).encode()}, lambda f: read_tape7(f / "tape7")),
        Sample(
            "modtran json",
            {"a.json": json.dumps(deck, indent=1).encode()},
            lambda f: read_modtran_json(f / "a.json"),
        ),
        Sample("results", {"results.json": results_json(compared).encode()}, lambda f: list(read_rows(f))),
    ]
    made = written(folder)
    header, cube = made["envi cube"]["a.hdr"], made["envi cube"]["a.img"]
    out += [
        Sample("envi header", {"a.hdr": header}, lambda f: _header(f / "a.hdr")),
        Sample("envi cube: header", {"a.hdr": header, "a.img": cube}, lambda f: _cube(f / "a.img"), 0.5),
        Sample("envi cube: data", {"a.img": cube, "a.hdr": header}, lambda f: _cube(f / "a.img"), 0.3),
        Sample("lookup table", dict(reversed(made["lookup table"].items())),
               lambda f: open_lookup_table(f / "glt.dat", SHAPE), 0.3),
        Sample("envi library: header", dict(reversed(made["envi library"].items())),
               lambda f: _spectra(f / "b.sli")),
        Sample("envi library: data", made["envi library"], lambda f: _spectra(f / "b.sli")),
        Sample("geotiff", made["geotiff"], lambda f: _cube(f / "a.tif"), 0.2),
        Sample("matlab 5", made["matlab 5"], lambda f: _cube(f / "a.mat", "counts", "numbers"), 0.3),
        Sample("matlab 7.3", made["matlab 7.3"], lambda f: _cube(f / "b.mat", "counts", "numbers"), 0.06),
        Sample("numpy", made["numpy"], lambda f: _cube(f / "a.npy", "counts", "numbers"), 0.3),
        Sample("region raster", made["region raster"], lambda f: _regions(f / "mask.tif"), 0.2),
        Sample("netcdf cube", made["netcdf cube"], lambda f: _cube(f / "a.nc"), 0.06),
        Sample("hdf5 tree", made["hdf5 tree"], lambda f: _cube(f / "a.h5"), 0.06),
        Sample("table", made["table"], lambda f: _table(f / "table.nc"), 0.06),
        Sample("statistics library", made["statistics library"], lambda f: _library(f / "library.nc"), 0.06),
    ]  # fmt: skip
    for kind, content in products_of_imagers(folder).items():
        image = next(name for name in content if not name.endswith(".XML"))
        share = 0.3 if kind == "enmap metadata" else 0.03
        holds = "reflectance" if kind in ("neon reflectance", "prisma l2d", "oci") else "radiance"
        out.append(Sample(f"product: {kind}", content, lambda f, n=image, q=holds: _cube(f / n, q), share))
    beside = with_text_beside(folder)
    sequence = {"sequence.nc": hypernets(folder / "sequence.nc").read_bytes()}
    out += [
        Sample("spectra: specpr", {"splib": specpr()}, lambda f: _spectra(f / "splib"), 0.5),
        Sample("spectra: hypernets", sequence, lambda f: _spectra(f / "sequence.nc"), 0.03),
        Sample("aviris gain", beside["aviris gain"], lambda f: _cube(f / "f1rdn_img.dat", "radiance"), 0.5),
        Sample("stac item", beside["stac item"],
               lambda f, n=list(beside["stac item"])[1]: _cube(f / n, "radiance"), 0.3),
        Sample("dirsig header", beside["dirsig header"], lambda f: _truth(f / "truth.img"), 0.5),
        Sample("dirsig truth", beside["dirsig truth"], lambda f: _truth(f / "truth.img"), 0.3),
        Sample("radcalnet", {"a.input": RADCALNET.encode()}, lambda f: _spectra(f / "a.input")),
        Sample("products.nc", run_products(folder), read_products, 0.03),
    ]  # fmt: skip
    for kind, (path, read, share) in _yaml().items():
        content = {"a.yaml": path.read_bytes()}
        out.append(Sample(f"yaml: {kind}", content, lambda f, r=read: r(f / "a.yaml"), share))
    return out

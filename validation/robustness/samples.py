"""Small valid files, one or more for every reader, and what must hold for anything that a reader gives back."""

from __future__ import annotations

import gzip
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
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
    files : name -> content; the first is damaged, the others lie beside it
    read : what reads a file and checks what came back
    share : how many of all mutants it gets, relative to the others
    opened : the file that is read, where it is not the first
    """

    name: str
    files: dict[str, bytes]
    read: Callable[[Path], Any]
    share: float = 1.0
    opened: str = ""

    def read_in(self, folder: Path) -> None:
        """Read the file where it lies."""
        self.read(folder / (self.opened or next(iter(self.files))))


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


def region(name: str, mask: Any) -> None:
    """Refuse a region of another size than the image, or without a pixel."""
    if mask.shape != SHAPE or not mask.any():
        raise ImplausibleError(f"region {name!r} of shape {mask.shape}")


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
    for found in material_regions(source, size, path).values():
        region(found.name, found.mask)
    truth = AbundanceTruth(image=path.name, materials={"panel": "*panel*"})
    for target in image_targets(truth, size, 4.0, lambda name: path)[0]:
        finite(target.area_m2, "area_m2")
        if target.fills is None or target.fills.min() < 0 or target.fills.max() > 1:
            raise ImplausibleError(f"fills of {target.name!r}")


def _regions(path: Path) -> None:
    for found in read_regions(path, SHAPE, transform=MAP, crs=UTM).values():
        region(found.name, found.mask)


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


_radiance, _numbers = partial(_cube, quantity="radiance"), partial(_cube, quantity="counts", axis="numbers")


def _yaml() -> list[Sample]:
    """A committed file of every kind."""
    campaign = ROOT / "campaigns" / "share2012-twin"
    readers: dict[str, tuple[Path, Callable[[Path], Any]]] = {
        "yaml": (ROOT / "studies" / "tornado.yaml", load_yaml),
        "campaign": (campaign / "campaign.yaml", lambda path: [job.campaign for job in read_jobs(path)]),
        "campaign texts": (ROOT / "campaigns" / "share2012-avon" / "campaign.yaml", read_jobs),
        "scenario": (campaign / "scenario.yaml", load_scenario),
        "scene": (campaign / "scene.yaml", load_scene),
        "sensor": (ROOT / "src" / "hyperval" / "sensor" / "library" / "hydice.yaml", load_sensor),
        "study": (ROOT / "studies" / "tornado.yaml", load_study),
        "baseline": (ROOT / "validation" / "baselines" / "pasadena-2017.yaml", load_baseline),
    }
    return [
        Sample(f"yaml: {kind}", {"a.yaml": path.read_bytes()}, read, 0.1 if kind == "yaml" else 0.06)
        for kind, (path, read) in readers.items()
    ]


def samples(folder: Path) -> list[Sample]:
    """Every sample; ``folder`` is where files are made that need writers."""
    out = [Sample(f"spectra: text {i}", {"a.txt": text.encode()}, _spectra, 0.3) for i, text in enumerate(TEXTS)]
    for version, code in ((b"as7", 2), (b"as6", 0), (b"as8", 1)):
        out.append(Sample(f"spectra: asd {code}", {"a.asd": asd(version=version, code=code)}, _spectra))
    out += [Sample(f"regions: {kind}", dict([named]), _regions) for kind, named in drawn().items()]
    targets = "name,material,easting,northing,side_m\np1,plank,300010,4699990,1.5\np2,plank,300016,4699986,0.5\n"
    bands = "# centre,fwhm\n" + "".join(f"{nm:g},20\n" for nm in NM)
    three = "".join(channels(rho=rho) for rho in (0.5, 0.0, 0.1))
    deck = {"MODTRAN": [{"MODTRANINPUT": {"ATMOSPHERE": {"MODEL": "ATM_TROPICAL", "H2OSTR": 1.5, "H2OUNIT": "g"},
            "AEROSOLS": {"IHAZE": "AER_RURAL", "VIS": -0.1}, "SURFACE": {"SURREF": 0.1, "GNDALT": 0.3},
            "GEOMETRY": {"H1ALT": 3.0, "IDAY": 100, "IPARM": 12, "PARM1": 30.0, "PARM2": 40.0}}}]}  # fmt: skip
    compared = [Result("c", "radiance", "s", "m", "bias_ratio", value=1.0 + i, reason="r") for i in range(3)]
    made = written(folder)
    header, library = made["envi cube"]["a.hdr"], made["envi library"]
    headers = {name: dict(reversed(files.items())) for name, files in made.items()}  # the other file first
    out += [
        Sample("targets", {"t.csv": targets.encode()}, _targets),
        Sample("band table", {"b.csv": bands.encode()}, _band_table),
        Sample("chn", {"a.chn": channels(rho=0.2).encode()}, _terms),
        Sample("chn, three runs", {"a.chn.gz": gzip.compress(three.encode(), mtime=0)}, _terms),
        Sample("chn, three runs unpacked", {"a.chn": three.encode()}, _terms, 0.5),
        Sample("tape7", {"tape7": tape7([0.0], terms=spectrum(8)).encode()}, read_tape7),
        Sample("modtran json", {"a.json": json.dumps(deck, indent=1).encode()}, read_modtran_json),
        Sample("results", {"results.json": results_json(compared).encode()}, lambda path: list(read_rows(path.parent))),
        Sample("envi header", {"a.hdr": header}, _header),
        Sample("envi cube: header", headers["envi cube"], _cube, 0.5, "a.img"),
        Sample("envi cube: data", made["envi cube"], _cube, 0.3),
        Sample("lookup table", headers["lookup table"], lambda path: open_lookup_table(path, SHAPE), 0.3, "glt.dat"),
        Sample("envi library: header", headers["envi library"], _spectra, opened="b.sli"),
        Sample("envi library: data", library, _spectra),
        Sample("geotiff", made["geotiff"], _cube, 0.2),
        Sample("matlab 5", made["matlab 5"], _numbers, 0.3),
        Sample("matlab 7.3", made["matlab 7.3"], _numbers, 0.06),
        Sample("numpy", made["numpy"], _numbers, 0.3),
        Sample("region raster", made["region raster"], _regions, 0.2),
        Sample("netcdf cube", made["netcdf cube"], _cube, 0.06),
        Sample("hdf5 tree", made["hdf5 tree"], _cube, 0.06),
        Sample("table", made["table"], _table, 0.06),
        Sample("statistics library", made["statistics library"], _library, 0.06),
    ]
    for kind, content in products_of_imagers(folder).items():
        image = next(name for name in content if not name.endswith(".XML"))
        share = 0.3 if kind == "enmap metadata" else 0.03
        holds = "reflectance" if kind in ("neon reflectance", "prisma l2d", "oci") else "radiance"
        out.append(Sample(f"product: {kind}", content, partial(_cube, quantity=holds), share, image))
    beside = with_text_beside(folder)
    sequence = {"sequence.nc": hypernets(folder / "sequence.nc").read_bytes()}
    return [
        *out,
        Sample("spectra: specpr", {"splib": specpr()}, _spectra, 0.5),
        Sample("spectra: hypernets", sequence, _spectra, 0.03),
        Sample("aviris gain", beside["aviris gain"], _radiance, 0.5, "f1rdn_img.dat"),
        Sample("stac item", beside["stac item"], _radiance, 0.3, list(beside["stac item"])[1]),
        Sample("dirsig header", beside["dirsig header"], _truth, 0.5, "truth.img"),
        Sample("dirsig truth", beside["dirsig truth"], _truth, 0.3),
        Sample("radcalnet", {"a.input": RADCALNET.encode()}, _spectra),
        Sample("products.nc", run_products(folder), lambda path: read_products(path.parent), 0.03),
        *_yaml(),
    ]

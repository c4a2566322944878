"""Public files and what becomes of each: opened with a second reader's numbers, or refused in stated words.

python validation/conformance.py                 # every file at hand: equal, refused as expected, or changed
python validation/conformance.py --renew         # write the numbers of the second readers and the outcomes of today

``conformance.yaml`` names each file with its SHA-256 below the data directory (HYPERVAL_DATA).  Sizes, values at some
pixels and wavelengths of images are those of rasterio (GDAL) or SciPy, or of the header's own text; of spectra they
are those accepted when the file was listed, and under ``second`` those of the program that is named there.  What
opened and is refused now, or gives other numbers, is an error.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hyperval.envi_header import read_header
from hyperval.errors import HypervalError
from hyperval.imagery import crs_of, open_cube, open_raster, read_regions
from hyperval.spectra import read_records

MANIFEST = Path(__file__).with_name("conformance.yaml")
LEVEL = 1e-6  # relative, as single precision and the digits of a text allow
Numbers = dict[str, Any]


def image(path: Path, entry: dict[str, Any]) -> Numbers:
    """Size, wavelengths and values at some pixels, as this package reads them."""
    options = entry.get("options", {})
    raster = open_raster(path, variable=options.get("variable"))
    rows, cols = places(raster.lines, raster.samples)
    out: Numbers = {
        "size": list(raster.size),
        "values": raster.read_pixels(rows, cols)[:, [0, -1]].astype(float).tolist(),
    }
    if raster.description.listed() is not None:
        axis = open_cube(path, quantity="other", sort_bands=True, **options).axis
        out["nm"] = [float(axis.centre_nm[0]), float(axis.centre_nm[-1])]
    if raster.crs is not None:
        out["epsg"] = raster.crs.to_epsg()
    return out


def header(path: Path, entry: dict[str, Any]) -> Numbers:
    """Size, wavelengths and coordinate system of a header whose data file is not at hand."""
    parsed = read_header(path, sidecar=path.name.endswith(".tif.hdr"))
    out: Numbers = {"size": [parsed.lines, parsed.samples, parsed.bands]}
    listed = parsed.numbers("wavelength", parsed.bands)
    crs = crs_of(parsed)
    out |= {} if listed is None else {"nm": [float(listed.min()), float(listed.max())]}
    return out if crs is None else out | {"epsg": crs.to_epsg()}


def places(lines: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Lines and samples of the pixels that are compared: corners and middle."""
    return np.array([0, lines // 2, lines - 1]), np.array([0, samples // 2, samples - 1])


def second_image(path: Path, entry: dict[str, Any]) -> Numbers:
    """The same of another program; keys that it does not know are left out."""
    told: list[str] = []
    if path.suffix == ".mat":
        import scipy.io

        values = scipy.io.loadmat(path)["data"]
    else:
        import rasterio

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with rasterio.open(path.with_suffix("") if path.suffix == ".hdr" else path) as dataset:
                values = dataset.read().transpose(1, 2, 0)
                # An ENVI header says more digits than GDAL, and is taken where there is one.
                for domain, key in (("ENVI", "wavelength"), ("IMAGERY", "CENTRAL_WAVELENGTH_UM")):
                    told += [dataset.tags(band, ns=domain).get(key, "") for band in range(dataset.count + 1)]
    rows, cols = places(*values.shape[:2])
    out: Numbers = {"size": list(values.shape), "values": values[rows, cols][:, [0, -1]].astype(float).tolist()}
    headers = [path.with_suffix(".hdr"), path.with_name(path.name + ".hdr")]
    text = "\n".join(header.read_text("latin-1") for header in headers if header.is_file())
    written = re.findall(r"^\s*wavelength\s*=\s*\{([^}]*)\}", text, re.MULTILINE | re.IGNORECASE)
    listed = np.sort([float(v) for line in written or told for v in line.split(",") if v.strip()])
    if listed.size:
        out["nm"] = [float(v) * (1000.0 if listed[-1] < 100 else 1.0) for v in listed[[0, -1]]]
    return out


def spectra(path: Path, entry: dict[str, Any]) -> Numbers:
    """Number of the spectra of a file, their wavelengths and mean; one of them where a second reader has it."""
    found = read_records(path, **entry.get("options", {}))
    whole = np.concatenate([s.values[np.isfinite(s.values)] for s in found])
    edges = [float(min(s.wavelength_nm[0] for s in found)), float(max(s.wavelength_nm[-1] for s in found))]
    out: Numbers = {"spectra": len(found), "nm": edges, "mean": float(whole.mean())}
    if second := entry.get("second"):
        chosen = next(s for s in found if s.name == second.get("record", s.name))
        columns = {"values": chosen.values, "sd": chosen.standard_deviation}
        interpolated = {
            key: np.interp(second["nm"], chosen.wavelength_nm, v).tolist()
            for key, v in columns.items()
            if v is not None
        }
        out["second"] = {**interpolated, "n": chosen.n}
    return out


def regions(path: Path, entry: dict[str, Any]) -> Numbers:
    """Pixels of the regions of a file."""
    found = read_regions(path, tuple(entry["options"]["shape"]), coordinates=entry["options"].get("coordinates"))
    return {"pixels": {name: region.n for name, region in found.items()}}


READERS: dict[str, Callable[[Path, dict[str, Any]], Numbers]] = {
    "image": image, "header": header, "spectra": spectra, "regions": regions, "none": lambda path, entry: {},
}  # fmt: skip


def equal(accepted: Any, now: Any, level: float = LEVEL) -> bool:
    """Whether two sets of numbers are the same to their ``level``, those that only one has left aside."""
    if isinstance(accepted, dict) and isinstance(now, dict):
        level = accepted.get("level", level)
        return all(equal(accepted[key], now[key], level) for key in accepted.keys() & now.keys())
    if isinstance(accepted, list | float | int):
        return bool(np.shape(accepted) == np.shape(now) and np.allclose(accepted, now, rtol=level, equal_nan=True))
    return bool(accepted == now)


def outcome(path: Path, entry: dict[str, Any]) -> tuple[str, str]:
    """What became of a file: equal, refused, changed; and in words."""
    try:
        now = READERS[entry["reader"]](path, entry)
    except HypervalError as error:
        words = " ".join(str(error).split()).replace(str(path), path.name)
        refused = entry.get("refused")
        fits = refused is not None and refused in words
        return ("refused as expected", "") if fits else ("changed", f"refused: {words[:200]}")
    if "refused" in entry:
        return "opens now", "renew the manifest"
    accepted = {**entry.get("numbers", {}), "second": entry.get("second", {})}
    return ("equal", "") if equal(accepted, now) else ("changed", f"{now} for {accepted}")


def renewed(path: Path, entry: dict[str, Any]) -> dict[str, Any]:
    """The entry with the numbers of the second reader, or with today's refusal."""
    entry = {key: value for key, value in entry.items() if key not in ("numbers", "refused")}
    entry["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    try:
        now = READERS[entry["reader"]](path, entry)
    except HypervalError as error:
        return entry | {"refused": error.what.replace(str(path), path.name)[:120]}
    second = second_image(path, entry) if entry["reader"] == "image" else {}
    if not equal(second, now):
        print(f"{entry['path']}: {now}, the second reader has {second}")
    now.pop("second", None)
    return entry | {"numbers": now | second}


def main() -> int:
    """Report each file at hand; 1 where one is changed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--renew", action="store_true")
    renew = parser.parse_args().renew
    root = Path(os.environ.get("HYPERVAL_DATA", "."))
    manifest = yaml.safe_load(MANIFEST.read_text("utf-8"))
    counts: dict[str, int] = {}
    for i, entry in enumerate(manifest["files"]):
        path = root / entry["path"]
        if not path.is_file():
            state, words = "not at hand", ""
        elif renew:
            manifest["files"][i], state, words = renewed(path, entry), "renewed", ""
        elif hashlib.sha256(path.read_bytes()).hexdigest() != entry["sha256"]:
            state, words = "another file", "its SHA-256 is not that of the manifest"
        else:
            state, words = outcome(path, entry)
        counts[state] = counts.get(state, 0) + 1
        if words:
            print(f"{entry['path']}: {state}: {words}")
    if renew:
        MANIFEST.write_text(yaml.safe_dump(manifest, sort_keys=False, width=160, default_flow_style=None), "utf-8")
    print(", ".join(f"{count} {state}" for state, count in counts.items()))
    return int("changed" in counts)


if __name__ == "__main__":
    sys.exit(main())

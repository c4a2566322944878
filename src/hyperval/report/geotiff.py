"""Score maps as float32 GeoTIFF."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from affine import Affine

from hyperval.report.run import ScoreMap


def write_score_map(path: Path, name: str, score_map: ScoreMap) -> None:
    """Write one map; NaN is nodata; georeferenced where the map knows its transform."""
    import rasterio  # 20 MB, which runs without score maps do not need
    from rasterio.errors import NotGeoreferencedWarning

    values = np.asarray(score_map.values, dtype=np.float32)
    profile = {
        "driver": "GTiff", "height": values.shape[0], "width": values.shape[1], "count": 1, "dtype": "float32",
        "nodata": float("nan"), "compress": "deflate", "predictor": 3,
    }  # fmt: skip
    if score_map.transform is not None:
        profile["transform"] = Affine(*[float(number) for number in list(score_map.transform)[:6]])
    if score_map.crs:
        profile["crs"] = score_map.crs
    with warnings.catch_warnings():
        # A map in image geometry is a legitimate product.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as out:
            out.write(values, 1)
            out.set_band_description(1, f"{name} score [1]")


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """A distinct, harmless file name for each name: letters, digits, dot, minus and underscore."""
    stems: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).lstrip(".")[:100] or "_"
        candidate, number = stem, 2
        while candidate.lower() in taken:
            candidate, number = f"{stem}_{number}", number + 1
        taken.add(candidate.lower())
        stems[name] = candidate
    return stems

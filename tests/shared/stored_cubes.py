"""Cubes as instruments store them: any interleave, type and byte order."""

from pathlib import Path

import numpy as np

from hyperval.imagery import open_cube, write_cube
from hyperval.spectra import SpectralAxis

LINES, SAMPLES, BANDS = 47, 23, 30
TYPES = {"u1": 1, "i2": 2, "i4": 3, "f4": 4, "f8": 5, "u2": 12}


def numbers(seed=0, low=500.0, spread=900.0, noise=6.0):
    """A scene of four smooth spectra and noise, in whole numbers (lines, samples, bands)."""
    rng = np.random.default_rng(seed)
    at = np.linspace(0, 1, BANDS)
    spectra = np.stack([np.sin(np.pi * (k + 1) * at) ** 2 + 0.2 for k in range(4)])
    amounts = rng.gamma(2.0, 0.5, size=(LINES * SAMPLES, 4))
    x = low + spread * amounts @ spectra + noise * rng.normal(size=(LINES * SAMPLES, BANDS))
    return np.rint(x).reshape(LINES, SAMPLES, BANDS)


def stored(folder: Path, x, interleave="bil", dtype="<i2", extra="", **options):
    """The cube of values (lines, samples, bands) that were written as they are."""
    folder.mkdir(exist_ok=True, parents=True)
    axis = SpectralAxis(400.0 + 10.0 * np.arange(x.shape[2]), 10.0)
    order = {"byte order": str(int(dtype[0] == ">"))}
    written = {"interleave": interleave, "data_type": TYPES[dtype[1:]], "extra": order}
    path = write_cube(folder / "cube.img", np.asarray(x).astype(dtype), axis=axis, **written)
    with path.with_suffix(".hdr").open("a") as header:
        header.write(extra)
    return open_cube(path, check_values=False, **{"quantity": "other", **options})

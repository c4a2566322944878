"""Small ENVI files to read and to break."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hyperval.imagery import write_cube
from hyperval.spectra import SpectralAxis

LINES, SAMPLES, BANDS = 6, 5, 4


@pytest.fixture
def axis() -> SpectralAxis:
    return SpectralAxis(np.array([450.0, 550.0, 650.0, 850.0]), np.full(BANDS, 9.5))


@pytest.fixture
def values() -> np.ndarray:
    """Reflectances that int16 x 10000 holds exactly; no pixel is 0 in every band."""
    return np.random.default_rng(11).integers(1, 9000, (LINES, SAMPLES, BANDS)) / 10000.0


@pytest.fixture
def cube_file(tmp_path, axis, values) -> Path:
    """A valid int16 BIL reflectance cube."""
    return write_cube(
        tmp_path / "cube.img", values * 10000.0, data_type=2, axis=axis, extra={"reflectance scale factor": "10000.0"}
    )


@pytest.fixture
def edit(cube_file) -> Callable[..., Path]:
    """Change, drop (None) or add lines of the header of ``cube_file``."""

    def change(**entries: str | None) -> Path:
        header = cube_file.with_suffix(".hdr")
        text = header.read_text()
        for name, value in entries.items():
            key = name.replace("_", " ")
            line = "" if value is None else f"{key} = {value}\n"
            pattern = rf"(?m)^{key} = (\{{[^}}]*\}}|.*)\n"
            text = text.replace(found[0], line) if (found := re.search(pattern, text)) else text + line
        header.write_text(text)
        return cube_file

    return change

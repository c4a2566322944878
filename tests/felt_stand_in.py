"""Stand-in lines for the felt campaigns: the real headers, masks and felt spectra, every pixel simulated.

A line is marked as such in the description of its header.  Ground comes in three surfaces with random pixels each;
a felt is a square of the area that the mask marks, about its middle, through the square of a pixel and a Gaussian of
one pixel.

    PYTHONPATH=tests/shared python tests/felt_stand_in.py DATA OUT    every line below OUT, from files below DATA
"""

import re
import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from hyperval.envi_header import read_header
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class
from small_campaign import data_of

MARK = "Stand-in: simulated pixels under a real header."
FINE = 10  # parts of a pixel, along and across
SURFACES = ("grass", "soil", "asphalt")


LINES: dict[str, dict[str, Any]] = data_of("felt_lines")


@dataclass(frozen=True)
class Departures:
    """How the line departs from what its scenario takes for the mean, drawn as its ``uncertainty`` says."""

    blur: float = 1.0  # FWHM [pixels]
    level: dict[str, float] = field(default_factory=dict)  # of a mask's felts: their reflectance is so many times
    image: float = 0.0  # relative, of the felts in the image
    offset: float = 0.0  # reflectance, of the felts in the image

    @classmethod
    def drawn(cls, name: str, rng: np.random.Generator) -> "Departures":
        """Errors of one level over all bands: the bands of the stated 300 nm are few."""
        return cls(
            max(0.0, 1.0 + 0.3 * rng.standard_normal()),
            {mask: 1.0 + 0.10 * rng.standard_normal() for mask in LINES[name]["felts"]},
            0.04 * rng.standard_normal(),
            0.01 * rng.standard_normal(),
        )


def stand_in(
    name: str, real: Path, data: Path, *, seed: int = 7, every: int = 1, departs: Departures | None = None
) -> None:
    """Write a line below ``data``: header, masks and spectra from ``real``, the cube simulated.

    ``every`` : of so many bands one is kept, in the header too, which a test can afford
    """
    line, departs = LINES[name], departs or Departures()
    for mask, spectrum in line["felts"].items():
        header = Path(mask).with_suffix(".hdr").as_posix() if mask.endswith(".img") else mask + ".hdr"
        for file in (mask, header, spectrum):
            (data / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(real / file, data / file)
    (data / line["header"]).parent.mkdir(parents=True, exist_ok=True)
    text = (real / line["header"]).read_text("latin-1")
    marked, count = re.subn(r"description = \{[^}]*\}", f"description = {{{MARK}}}", text, count=1)
    assert count == 1
    (data / line["header"]).write_text(thinned(marked, every), "latin-1")
    header = read_header(data / line["header"])
    factor = 1000.0 if np.max(header.numbers("wavelength")) < 100 else 1.0
    axis = SpectralAxis(header.numbers("wavelength") * factor, header.numbers("fwhm") * factor)
    rng = np.random.default_rng(seed)
    pixels = ground(rng, header.lines, header.samples, axis)
    for mask, spectrum in line["felts"].items():
        truth = np.fromfile(real / mask, np.uint8).reshape(header.lines, header.samples) > 0
        part = felt_fractions(truth, departs.blur)
        on = part > 0
        share = part[on, None]
        table = np.genfromtxt(real / spectrum, skip_header=3 if "ASCII" in spectrum else 0)
        felt = np.interp(axis.centre_nm / 1000.0, table[:, 0], table[:, 1]) * departs.level.get(mask, 1.0)
        felt = felt * (1.0 + departs.image) + departs.offset
        spread = 1.0 + 0.03 * rng.standard_normal(share.shape)
        noise = 0.001 * rng.standard_normal((share.size, len(axis)))
        pixels[on] = (1.0 - share) * pixels[on] + share * (felt * spread + noise)
    stored = pixels if header.dtype.kind == "f" else np.round(pixels * 10_000.0)
    stored.transpose(0, 2, 1).astype(header.dtype).tofile(data / line["cube"])  # by line


def thinned(header: str, every: int) -> str:
    """A header whose lists of bands keep one of so many, from the first on."""

    def kept(match: re.Match[str]) -> str:
        values = match[2].split(",")[::every]
        return f"{match[1]}{{{','.join(values)}}}"

    if every == 1:
        return header
    header = re.sub(r"(?m)^((?:wavelength|fwhm|bbl|band names) *= *)\{([^}]*)\}", kept, header)
    header = re.sub(r"(?m)^default bands .*\n", "", header)
    return re.sub(r"(?m)^(bands *= *)(\d+)", lambda m: f"{m[1]}{len(range(0, int(m[2]), every))}", header)


def ground(rng: np.random.Generator, lines: int, samples: int, axis: SpectralAxis) -> np.ndarray:
    """(lines, samples, B) grass, and stripes of two other surfaces along the last lines, where no felt lies."""
    kinds = np.zeros((lines, samples), int)
    width = lines // 16
    kinds[lines - 2 * width :] = 1
    kinds[lines - width :] = 2
    out = np.empty((lines, samples, len(axis)))
    for kind, name in enumerate(SURFACES):
        surface = builtin_class(name, axis)
        at = kinds == kind
        root = np.linalg.cholesky(surface.covariance + 1e-12 * np.eye(len(axis)))
        out[at] = surface.mean + rng.standard_normal((int(at.sum()), len(axis))) @ root.T
    return out


def felt_fractions(truth: np.ndarray, blur: float) -> np.ndarray:
    """(lines, samples) part of each pixel that squares fill, one for each patch: of its area, about its middle."""
    labels, count = ndimage.label(truth, np.ones((3, 3)))
    lines, samples = truth.shape
    fine = np.zeros((lines * FINE, samples * FINE), np.float32)
    for number in range(1, count + 1):
        places = np.argwhere(labels == number)
        half = np.sqrt(len(places)) / 2
        first, last = (np.rint((places.mean(axis=0) + 0.5 + reach) * FINE).astype(int) for reach in (-half, half))
        fine[first[0] : last[0], first[1] : last[1]] = 1.0
    blurred = ndimage.gaussian_filter(fine, blur * FINE / 2.354820045)
    part = blurred.reshape(lines, FINE, samples, FINE).mean(axis=(1, 3))
    return np.where(part < 1e-4, 0.0, np.minimum(part, 1.0))


if __name__ == "__main__":
    for every_line in LINES:
        stand_in(every_line, *map(Path, sys.argv[1:3]))

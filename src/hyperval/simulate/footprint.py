"""How much of each pixel's signal comes from a square on the ground, by brute force.

The system response of a pixel is a Gaussian point spread function convolved with the pixel's own
square aperture.  Both are sampled on a grid finer than the pixel and convolved as numbers; no closed
form is used, so that a model which uses one can be tested against these fills.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

SUPERSAMPLING = 32  # fine cells per pixel side
_CUT_SIGMA = 5.0  # the Gaussian beyond holds 6e-7 of its area
_SIDE_STEPS = 60  # halvings of the bracket: beyond float64 resolution


def _line_spread(psf_fwhm_pixels: float, cells: int) -> tuple[Array, int]:
    """One-dimensional system response on fine cells, unit sum, and the reach in cells from its centre."""
    sigma = psf_fwhm_pixels * cells / (2.0 * math.sqrt(2.0 * math.log(2.0)))  # in fine cells
    reach = math.ceil(_CUT_SIGMA * sigma)
    offsets = np.arange(-reach, reach + 1)
    gaussian = np.exp(-0.5 * (offsets / sigma) ** 2) if sigma > 0 else np.ones(1)
    response = np.convolve(gaussian / gaussian.sum(), np.full(cells, 1.0 / cells))
    return response, (response.size - 1) // 2


def pixel_weights(psf_fwhm_pixels: float, cells: int = SUPERSAMPLING) -> Array:
    """Share of a pixel's signal that each of its neighbours along one axis contributes.

    Returns (2 k + 1,) weights of unit sum, symmetric, the pixel itself in the middle.
    """
    response, _ = _line_spread(psf_fwhm_pixels, cells)
    # The response has cells + 2 reach samples about the pixel centre; pad it to an odd number of pixels.
    pixels = 2 * math.ceil((response.size / cells - 1.0) / 2.0) + 1
    pad = (pixels * cells - response.size) // 2
    weights = np.pad(response, (pad, pixels * cells - response.size - pad)).reshape(pixels, cells).sum(axis=1)
    return np.asarray(0.5 * (weights + weights[::-1]))


@dataclass(frozen=True)
class Footprint:
    """The fills of the pixels around one plank.

    Attributes
    ----------
    first_line, first_sample : pixel of ``fill[0, 0]``
    fill : (n, m) share of each pixel's signal that comes from the plank
    """

    first_line: int
    first_sample: int
    fill: Array


def _fine_response(first: int, count: int, psf_fwhm_pixels: float, cells: int) -> Array:
    """(count, count * cells) response of each pixel of a run to the fine cells of the same run."""
    response, _ = _line_spread(psf_fwhm_pixels, cells)
    matrix = np.zeros((count, count * cells))
    for pixel in range(count):
        start = pixel * cells + cells // 2 - response.size // 2
        low, high = max(start, 0), min(start + response.size, count * cells)
        matrix[pixel, low:high] = response[low - start : high - start]
    return matrix


def _coverage(u: Array, half: float, cell: float) -> Array:
    """Share of a cell of width ``cell`` at distance ``u`` from the middle of a strip that the strip covers."""
    outer = np.minimum(u + 0.5 * cell, half)
    inner = np.maximum(u - 0.5 * cell, -half)
    return np.clip((outer - inner) / cell, 0.0, 1.0)


def square_footprint(
    centre_line: float,
    centre_sample: float,
    side_pixels: float,
    heading_deg: float,
    psf_fwhm_pixels: float,
    cells: int = SUPERSAMPLING,
) -> Footprint:
    """Fills of all pixels that see a square plank.

    Parameters
    ----------
    centre_line, centre_sample : continuous position of the centre; (0.5, 0.5) is the middle of the first pixel
    side_pixels : side of the square [pixels]
    heading_deg : turn of the square about its centre [deg]
    psf_fwhm_pixels : full width at half maximum of the Gaussian point spread function [pixels]
    cells : fine cells per pixel side
    """
    _, reach = _line_spread(psf_fwhm_pixels, cells)
    margin = side_pixels / math.sqrt(2.0) + (reach + 1) / cells
    first_line, first_sample = math.floor(centre_line - margin), math.floor(centre_sample - margin)
    lines = math.ceil(centre_line + margin) - first_line
    samples = math.ceil(centre_sample + margin) - first_sample
    y = first_line + (np.arange(lines * cells) + 0.5) / cells - centre_line
    x = first_sample + (np.arange(samples * cells) + 0.5) / cells - centre_sample
    angle = math.radians(heading_deg)
    half, cell = 0.5 * side_pixels, 1.0 / cells
    if math.sin(2.0 * angle) == 0.0:  # along the grid: the cover of a cell is a product
        cover = _coverage(y, half, cell)[:, None] * _coverage(x, half, cell)[None, :]
    else:
        # In the square's own frame a cell is taken as unturned: exact but for cells on an edge, where
        # the errors nearly average out; what is left (1e-3 of the area) is taken out as a whole.
        u = math.cos(angle) * x[None, :] + math.sin(angle) * y[:, None]
        v = -math.sin(angle) * x[None, :] + math.cos(angle) * y[:, None]
        cover = _coverage(u, half, cell) * _coverage(v, half, cell)
        cover *= (side_pixels * cells) ** 2 / cover.sum()
    vertical = _fine_response(first_line, lines, psf_fwhm_pixels, cells)
    across = _fine_response(first_sample, samples, psf_fwhm_pixels, cells)
    return Footprint(first_line, first_sample, vertical @ cover @ across.T)


def centred_fill(side_pixels: float, psf_fwhm_pixels: float, cells: int = SUPERSAMPLING) -> float:
    """Largest fill of an unturned square plank whose centre is a pixel's centre."""
    return float(square_footprint(0.5, 0.5, side_pixels, 0.0, psf_fwhm_pixels, cells).fill.max())


def side_for_fill(fill: float, psf_fwhm_pixels: float, cells: int = SUPERSAMPLING) -> float:
    """Side [pixels] of the square plank that gives ``fill`` when centred on a pixel, by bisection."""
    low, high = 0.0, 1.0
    while centred_fill(high, psf_fwhm_pixels, cells) < fill:
        low, high = high, 2.0 * high
        if high > 64.0:
            raise ValueError(f"no square reaches a fill of {fill:g}")
    for _ in range(_SIDE_STEPS):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if centred_fill(middle, psf_fwhm_pixels, cells) < fill else (low, middle)
    return 0.5 * (low + high)

"""Smooth random fields over the ground: texture, patches of shade, varying mixtures."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage, special

from hyperval.simulate import streams
from hyperval.simulate.footprint import pixel_weights
from hyperval.simulate.schema import Admixture, SceneFile

Field = npt.NDArray[np.float32]

_TEXTURE, _SHADE, _ADMIXTURE = 0, 1, 2


def correlated_field(shape: tuple[int, int], correlation_pixels: float, rng: np.random.Generator) -> Field:
    """Gaussian field, mean 0 and standard deviation 1 over the scene.

    White noise smoothed by a Gaussian of standard deviation s has the correlation exp(-d^2 / 4 s^2), which is
    1/e at d = 2 s: s = correlation_pixels / 2.
    """
    field = rng.standard_normal(shape, dtype=np.float32)
    if correlation_pixels > 0.0:
        field = ndimage.gaussian_filter(field, 0.5 * correlation_pixels, mode="wrap")
    field -= field.mean(dtype=np.float64)
    spread = float(field.std(dtype=np.float64))
    return field / np.float32(spread) if spread > 0.0 else field


def texture_factor(scene: SceneFile) -> Field | None:
    """(lines, samples) factor on the ground reflectance, None without texture; never below 0.1."""
    texture = scene.broken.texture
    if texture is None:
        return None
    rng = streams.generator(scene.seed, streams.FIELDS, _TEXTURE)
    field = correlated_field((scene.lines, scene.samples), texture.correlation_pixels, rng)
    return np.asarray(np.maximum(1.0 + np.float32(texture.relative_sd) * field, np.float32(0.1)))


def illumination(scene: SceneFile, open_sky: npt.NDArray[np.bool_]) -> Field | None:
    """(lines, samples) share of the ground signal left by shade, None without; 1 where ``open_sky``.

    The patches are where a smooth field falls under its own quantile, blurred by the point spread function.
    """
    shade = scene.broken.shade
    if shade is None:
        return None
    rng = streams.generator(scene.seed, streams.FIELDS, _SHADE)
    field = correlated_field((scene.lines, scene.samples), shade.correlation_pixels, rng)
    dark = (field < np.quantile(field, shade.area_fraction)) & ~open_sky
    soft = blur(dark.astype(np.float32), scene.psf_fwhm_pixels)
    light = 1.0 - np.float32(1.0 - shade.illumination) * soft
    return np.where(open_sky, np.float32(1.0), light)


def admixture_share(scene: SceneFile, admixture: Admixture, number: int) -> Field:
    """(lines, samples) share of the admixed surface: beta distributed, correlated as asked."""
    rng = streams.generator(scene.seed, streams.FIELDS, _ADMIXTURE + number)
    field = correlated_field((scene.lines, scene.samples), admixture.correlation_pixels, rng)
    mean = admixture.mean
    total = mean * (1.0 - mean) / admixture.sd**2 - 1.0  # beta parameters from its two moments
    share = special.betaincinv(mean * total, (1.0 - mean) * total, special.ndtr(field.astype(np.float64)))
    return np.asarray(share.astype(np.float32))


def blur(image: Field, psf_fwhm_pixels: float) -> Field:
    """A pixel map as the system response mixes it."""
    weights = pixel_weights(psf_fwhm_pixels).astype(np.float32)
    once = ndimage.correlate1d(image, weights, axis=0, mode="nearest")
    return np.asarray(ndimage.correlate1d(once, weights, axis=1, mode="nearest"))

"""Reflectance of every pixel, drawn line by line from the statistics of its surface; texture and shade."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage, special

from hyperval.data import ClassStatistics, Mask
from hyperval.simulate import schema
from hyperval.simulate.layout import SMALLEST_FILL, GroundLayout, pixel_weights
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
    rng = schema.generator(scene.seed, schema.FIELDS, _TEXTURE)
    field = correlated_field((scene.lines, scene.samples), texture.correlation_pixels, rng)
    return np.asarray(np.maximum(1.0 + np.float32(texture.relative_sd) * field, np.float32(0.1)))


def illumination(scene: SceneFile, open_sky: Mask) -> Field | None:
    """(lines, samples) share of the ground signal left by shade, None without; 1 where ``open_sky``.

    The patches are where a smooth field falls under its own quantile, blurred by the point spread function.
    """
    shade = scene.broken.shade
    if shade is None:
        return None
    rng = schema.generator(scene.seed, schema.FIELDS, _SHADE)
    field = correlated_field((scene.lines, scene.samples), shade.correlation_pixels, rng)
    dark = (field < np.quantile(field, shade.area_fraction)) & ~open_sky
    soft = blur(dark.astype(np.float32), scene.psf_fwhm_pixels)
    light = 1.0 - np.float32(1.0 - shade.illumination) * soft
    return np.where(open_sky, np.float32(1.0), light)


def admixture_share(scene: SceneFile, admixture: Admixture, number: int) -> Field:
    """(lines, samples) share of the admixed surface: beta distributed, correlated as asked."""
    rng = schema.generator(scene.seed, schema.FIELDS, _ADMIXTURE + number)
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


Array = npt.NDArray[np.float32]

_SMALLEST_VARIANCE = 1e-10  # of the mean variance of a band


@dataclass(frozen=True)
class Sampler:
    """Draws spectra of a class: mean + z factor, z standard normal.

    Attributes
    ----------
    mean : (B,); factor : (B, B) with factor^T factor = covariance
    dof : None, or draws are from a multivariate t law of the same mean and covariance
    """

    mean: Array
    factor: Array
    dof: float | None = None

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """(count, B) spectra."""
        z = rng.standard_normal((count, self.mean.size), dtype=np.float32)
        if self.dof is not None:
            # A t vector is a normal one over sqrt(chi2/nu); its covariance is nu/(nu - 2) times larger.
            z *= np.sqrt((self.dof - 2.0) / rng.chisquare(self.dof, count))[:, None].astype(np.float32)
        spectra: Array = z @ self.factor
        spectra += self.mean
        return spectra


def sampler(statistics: ClassStatistics, dof: float | None = None) -> Sampler:
    """Sampler of a class of one law, from the Cholesky factor of its covariance.

    The factor is unique, so that the draws do not depend on the linear algebra library as eigenvectors of
    near-equal eigenvalues would.
    """
    covariance = statistics.covariance
    # A covariance of less than full rank gains a spread that float32 draws hardly resolve.
    least = _SMALLEST_VARIANCE * float(np.trace(covariance)) / len(covariance) * np.eye(len(covariance))
    factor = np.linalg.cholesky(covariance + least).T.astype(np.float32)
    return Sampler(statistics.mean.astype(np.float32), factor, statistics.tail_dof if dof is None else dof)


class SurfaceRenderer:
    """The ground of one scene; ``reflectance(line)`` gives the same spectra however often it is asked.

    Attributes
    ----------
    ground : the layout
    target_spectra : (planks, B) one draw per plank
    """

    def __init__(self, scene: SceneFile, ground: GroundLayout, classes: Mapping[str, ClassStatistics]):
        self.scene, self.ground = scene, ground
        tails = scene.broken.heavy_tails
        covering = list(ground.surfaces)
        covering += [a.surface for a in scene.broken.admixtures if a.surface not in covering]
        self._names = covering
        open_ground = {a.surface for a in scene.layout}
        self._samplers = [
            sampler(classes[name], tails.dof if tails and name in open_ground else None) for name in covering
        ]
        self.bands = int(self._samplers[0].mean.size)
        self._texture = texture_factor(scene)
        self._light = illumination(scene, ndimage.binary_dilation(ground.on_panel, iterations=3))
        self._shares = [admixture_share(scene, a, i) for i, a in enumerate(scene.broken.admixtures)]
        drawn = [np.zeros((0, self.bands), np.float32)]
        for number, group in enumerate(scene.targets):
            rng = schema.generator(scene.seed, schema.TARGET_SPECTRA, number)
            drawn.append(sampler(classes[group.material]).draw(group.count, rng))
        self.target_spectra = np.concatenate(drawn)
        # Of every pixel that sees a plank its line, sample, number of the plank and fill.
        planks, none = ground.planks, np.zeros(0, np.intp)
        self._lines = np.concatenate([none, *(plank.lines for plank in planks)])
        self._samples = np.concatenate([none, *(plank.samples for plank in planks)])
        self._numbers = np.repeat(np.arange(len(planks)), [plank.fills.size for plank in planks])
        self._fills = np.concatenate([none, *(plank.fills for plank in planks)]).astype(np.float32)

    def shares(self, line: int) -> Array:
        """(classes, samples) share of each surface in the pixels of one line, planks apart."""
        class_map, scene = self.ground.class_map, self.scene
        share = np.zeros((len(self._names), scene.samples), np.float32)
        if scene.broken.soft_edges:
            weights = pixel_weights(scene.psf_fwhm_pixels)
            reach = weights.size // 2
            rows = np.clip(np.arange(line - reach, line + reach + 1), 0, scene.lines - 1)
            for index in np.unique(class_map[rows]):
                down = weights @ (class_map[rows] == index)
                share[index] = ndimage.correlate1d(down, weights, mode="nearest")
        else:
            share[class_map[line], np.arange(scene.samples)] = 1.0
        for admixture, field in zip(scene.broken.admixtures, self._shares, strict=True):
            host, other = self._names.index(admixture.host), self._names.index(admixture.surface)
            moved = share[host] * field[line]
            share[host] -= moved
            share[other] += moved
        return share

    def reflectance(self, line: int) -> Array:
        """(samples, B) reflectance of one line: surfaces as drawn, planks blended in by their fill."""
        rng = schema.generator(self.scene.seed, schema.SURFACE, line)
        rho = np.zeros((self.scene.samples, self.bands), np.float32)
        for share, draws in zip(self.shares(line), self._samplers, strict=True):
            at = np.flatnonzero(share > SMALLEST_FILL)
            if at.size == 0:
                continue
            spectra = draws.draw(at.size, rng)
            if not np.all(share[at] == 1.0):
                spectra *= share[at, None]
            rho[at] += spectra
        if self._texture is not None:
            factor = np.where(self.ground.on_panel[line], np.float32(1.0), self._texture[line])
            rho *= factor[:, None]
        at = np.flatnonzero(self._lines == line)
        if at.size:
            samples, fills = self._samples[at], self._fills[at]
            total = np.zeros(self.scene.samples, np.float32)
            np.add.at(total, samples, fills)
            rho *= (1.0 - total)[:, None]
            np.add.at(rho, samples, fills[:, None] * self.target_spectra[self._numbers[at]])
        if self.scene.mode == "broken":
            # Heavy tails reach where no surface can; in closure the model's own law is kept whole.
            np.clip(rho, 0.0, 1.0, out=rho)
        return rho

    def lit_reflectance(self, line: int) -> Array:
        """(samples, B) reflectance times the share of light that reaches the pixel."""
        rho = self.reflectance(line)
        if self._light is not None:
            rho *= self._light[line][:, None]
        return rho

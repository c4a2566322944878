"""The ground of a simulated scene: classes, planks, fills, regions clear of both, and the reflectance of every pixel.

The share of a pixel's signal that comes from a square on the ground is found by brute force: a Gaussian point spread
function convolved with the pixel's own square aperture, both sampled on a grid finer than the pixel.  A model that uses
a closed form can thus be tested against these fills.  Reflectance is drawn from the statistics of its surface, with
texture and shade.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage, optimize, special

from hyperval.data import Array, Index, Mask
from hyperval.errors import refusal, refuse
from hyperval.simulate import schema
from hyperval.simulate.schema import Admixture, Panel, SceneFile, TargetGroup
from hyperval.statistics_library import ClassStatistics

_CELLS = 32  # fine cells per pixel side
_CUT_SIGMA = 5.0  # the Gaussian beyond holds 6e-7 of its area


def _line_spread(psf_fwhm_pixels: float) -> Array:
    """One-dimensional system response on fine cells, of unit sum."""
    sigma = psf_fwhm_pixels * _CELLS / (2.0 * math.sqrt(2.0 * math.log(2.0)))  # in fine cells
    reach = math.ceil(_CUT_SIGMA * sigma)
    offsets = np.arange(-reach, reach + 1)
    gaussian = np.exp(-0.5 * (offsets / sigma) ** 2) if sigma > 0 else np.ones(1)
    return np.convolve(gaussian / gaussian.sum(), np.full(_CELLS, 1.0 / _CELLS))


def pixel_weights(psf_fwhm_pixels: float) -> Array:
    """Share of a pixel's signal that each of its neighbours along one axis contributes.

    Returns (2 k + 1,) weights of unit sum, symmetric, the pixel itself in the middle.
    """
    size = _line_spread(psf_fwhm_pixels).size
    k = math.ceil((size / _CELLS - 1.0) / 2.0)
    middle = _fine_response(2 * k + 1, psf_fwhm_pixels)[k]
    weights = middle.reshape(-1, _CELLS).sum(axis=1)
    return np.asarray(0.5 * (weights + weights[::-1]))


def _fine_response(count: int, psf_fwhm_pixels: float) -> Array:
    """(count, count * cells) response of each pixel of a run to the fine cells of the same run."""
    response = _line_spread(psf_fwhm_pixels)
    start = _CELLS * np.arange(count) + _CELLS // 2 - response.size // 2
    cell = np.arange(count * _CELLS) - start[:, None]
    return np.where((cell >= 0) & (cell < response.size), response[cell.clip(0, response.size - 1)], 0.0)


def _coverage(u: Array, half: float, cell: float) -> Array:
    """Share of a cell of width ``cell`` at distance ``u`` from the middle of a strip that the strip covers."""
    covered = np.minimum(u + 0.5 * cell, half) - np.maximum(u - 0.5 * cell, -half)
    return np.clip(covered / cell, 0.0, 1.0)


def square_footprint(
    centre_line: float, centre_sample: float, side_pixels: float, heading_deg: float, psf_fwhm_pixels: float
) -> tuple[int, int, Array]:
    """Line and sample of the first pixel that sees a square plank, and the fills of those from there on (n, m).

    Parameters
    ----------
    centre_line, centre_sample : continuous position of the centre; (0.5, 0.5) is the middle of the first pixel
    side_pixels : side of the square [pixels]
    heading_deg : turn of the square about its centre [deg]
    psf_fwhm_pixels : full width at half maximum of the Gaussian point spread function [pixels]
    """
    reach = (_line_spread(psf_fwhm_pixels).size - 1) // 2  # from its centre, in cells
    margin = side_pixels / math.sqrt(2.0) + (reach + 1) / _CELLS
    first_line, first_sample = math.floor(centre_line - margin), math.floor(centre_sample - margin)
    lines = math.ceil(centre_line + margin) - first_line
    samples = math.ceil(centre_sample + margin) - first_sample
    y = first_line + (np.arange(lines * _CELLS) + 0.5) / _CELLS - centre_line
    x = first_sample + (np.arange(samples * _CELLS) + 0.5) / _CELLS - centre_sample
    angle = math.radians(heading_deg)
    half, cell = 0.5 * side_pixels, 1.0 / _CELLS
    # In the square's own frame a cell is taken as unturned: exact but for cells on an edge of a turned square,
    # where the errors nearly average out; what is left (1e-3 of the area) is taken out as a whole.
    u = math.cos(angle) * x[None, :] + math.sin(angle) * y[:, None]
    v = -math.sin(angle) * x[None, :] + math.cos(angle) * y[:, None]
    cover = _coverage(u, half, cell) * _coverage(v, half, cell)
    cover *= (side_pixels * _CELLS) ** 2 / max(float(cover.sum()), 1e-300)
    vertical, across = (_fine_response(count, psf_fwhm_pixels) for count in (lines, samples))
    return first_line, first_sample, vertical @ cover @ across.T


def centred_fill(side_pixels: float, psf_fwhm_pixels: float) -> float:
    """Largest fill of an unturned square plank whose centre is a pixel's centre."""
    return float(square_footprint(0.5, 0.5, side_pixels, 0.0, psf_fwhm_pixels)[2].max())


def side_for_fill(fill: float, psf_fwhm_pixels: float) -> float:
    """Side [pixels] of the square plank that gives ``fill`` when centred on a pixel, by bisection.

    >>> [round(centred_fill(side_for_fill(fill, 1.0), 1.0), 9) for fill in (0.03, 0.4, 0.8)]
    [0.03, 0.4, 0.8]
    """
    high = next(side for side in 2.0 ** np.arange(7) if centred_fill(side, psf_fwhm_pixels) >= fill)
    return float(optimize.bisect(lambda side: centred_fill(side, psf_fwhm_pixels) - fill, 0.0, high, xtol=1e-15))


MIN_FILL = 1e-4  # a plank that gives less of a pixel's signal is left out of it


@dataclass(frozen=True)
class Plank:
    """One target object; positions in continuous pixel coordinates, side in pixels.

    ``lines``, ``samples``, ``fills`` : of the pixels that see it
    """

    name: str
    group: TargetGroup
    centre_line: float
    centre_sample: float
    side_pixels: float
    heading_deg: float
    lines: Index
    samples: Index
    fills: Array


@dataclass(frozen=True)
class GroundLayout:
    """The scene on the ground before any spectrum is drawn.

    Attributes
    ----------
    surfaces : names of the classes, in the order of the indices in ``class_map``
    class_map : (lines, samples) uint8
    on_panel : (lines, samples) True where a panel lies
    planks : every target object
    fill : (lines, samples) float32 total share of planks
    """

    surfaces: tuple[str, ...]
    class_map: npt.NDArray[np.uint8]
    on_panel: Mask
    planks: tuple[Plank, ...]
    fill: npt.NDArray[np.float32]


def lay_out(scene: SceneFile) -> GroundLayout:
    """Paint the classes and put the planks in place.

    Raises
    ------
    UsageError : ground that no class covers, a plank off its host class, planks that overlap.
    """
    surfaces = tuple(scene.surfaces())
    bare = 255
    refuse(len(surfaces) > bare, "scene.classes", scene.name, count=len(surfaces), bare=bare)
    class_map = np.full((scene.lines, scene.samples), bare, np.uint8)
    on_panel = np.zeros(class_map.shape, bool)
    for area in (*scene.layout, *scene.panels):
        place = slice(*area.lines), slice(*area.samples)
        class_map[place], on_panel[place] = surfaces.index(area.surface), isinstance(area, Panel)
    if np.any(class_map == bare):
        line, sample = (int(i) for i in np.argwhere(class_map == bare)[0])
        raise refusal("scene.bare", scene.name, line=line, sample=sample)
    planks = tuple(plank for number, group in enumerate(scene.targets) for plank in _place(scene, number, group))
    fill = np.zeros(class_map.shape, np.float32)
    for plank in planks:
        pixels, host = (plank.lines, plank.samples), surfaces.index(plank.group.host)
        in_image = np.all([(index >= 0) & (index < size) for index, size in zip(pixels, fill.shape, strict=True)])
        if not in_image or np.any(class_map[pixels] != host):
            where = {"centre_line": plank.centre_line, "centre_sample": plank.centre_sample}
            raise refusal("scene.host", name=plank.name, host=plank.group.host, **where)
        fill[pixels] += plank.fills.astype(np.float32)
    refuse(fill.size and float(fill.max()) > 1.0 + 1e-5, "scene.overlap", scene.name)
    return GroundLayout(surfaces, class_map, on_panel, planks, fill)


def _place(scene: SceneFile, number: int, group: TargetGroup) -> Iterator[Plank]:
    rng = schema.generator(scene.seed, schema.PLACEMENT, number)
    psf = scene.psf_fwhm_pixels
    side = group.side_m / scene.gsd_m if group.side_m else side_for_fill(group.fill or 0.0, psf)
    step = group.spacing_pixels
    if side > 0.6 * step:
        raise refusal("scene.planks", f"{scene.name}: target group {group.name}", side=side * scene.gsd_m, step=step)
    rows = np.arange(group.area.lines[0], group.area.lines[1] - step + 1, step) + step // 2
    columns = np.arange(group.area.samples[0], group.area.samples[1] - step + 1, step) + step // 2
    places = np.array([(r, c) for r in rows for c in columns])
    places = places[np.sort(rng.permutation(len(places))[: group.count])]
    for index, (row, column) in enumerate(places):
        shift = rng.uniform(-0.5, 0.5, 2) if group.phase == "random" else np.zeros(2)
        heading = float(rng.uniform(0.0, 90.0)) if group.heading_deg == "random" else group.heading_deg
        y, x = row + 0.5 + shift[0], column + 0.5 + shift[1]
        first_line, first_sample, fill = square_footprint(y, x, side, heading, psf)
        lines, samples = np.nonzero(fill >= MIN_FILL)
        pixels = lines + first_line, samples + first_sample, fill[lines, samples]
        yield Plank(f"{group.name}-{index:03d}", group, y, x, side, heading, *pixels)


def regions(scene: SceneFile, ground: GroundLayout) -> dict[str, Mask]:
    """The regions of interest by name: panel interiors first, then classes away from borders, panels and planks.

    Raises
    ------
    UsageError : a region that holds no pixel.
    """
    masks, guard = dict[str, Mask](), scene.target_guard_pixels
    centres = np.zeros(ground.class_map.shape, bool)
    for plank in ground.planks:
        centres[int(plank.centre_line), int(plank.centre_sample)] = True
    clear = (ground.fill == 0.0) & ~ndimage.binary_dilation(centres, np.ones((2 * guard + 1,) * 2, bool))
    for panel in scene.panels:
        masks[panel.name], b = np.zeros(ground.class_map.shape, bool), panel.border_pixels
        inside = (slice(first + b, max(end - b, 0)) for first, end in (panel.lines, panel.samples))
        masks[panel.name][tuple(inside)] = True
    for region in scene.regions:
        surface = (ground.class_map == ground.surfaces.index(region.surface)) & ~ground.on_panel
        square = np.ones((2 * region.border_pixels + 1,) * 2, bool)
        masks[region.name] = ndimage.binary_erosion(surface, square, border_value=1) & clear
    for name, mask in masks.items():
        refuse(not mask.any(), "scene.region", scene.name, name=name)
    return masks


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


def texture_factor(scene: SceneFile, on_panel: Mask) -> Field:
    """(lines, samples) factor on the ground reflectance, never below 0.1; 1 on panels and without texture."""
    texture = scene.broken.texture
    if texture is None:
        return np.broadcast_to(np.float32(1.0), on_panel.shape)
    rng = schema.generator(scene.seed, schema.FIELDS, _TEXTURE)
    field = correlated_field((scene.lines, scene.samples), texture.correlation_pixels, rng)
    factor = np.maximum(1.0 + np.float32(texture.relative_sd) * field, np.float32(0.1))
    return np.where(on_panel, np.float32(1.0), factor)


def illumination(scene: SceneFile, open_sky: Mask) -> Field:
    """(lines, samples) share of the ground signal left by shade; 1 without, and where ``open_sky``.

    The patches are where a smooth field falls under its own quantile, blurred by the point spread function.
    """
    shade = scene.broken.shade
    if shade is None:
        return np.broadcast_to(np.float32(1.0), open_sky.shape)
    rng = schema.generator(scene.seed, schema.FIELDS, _SHADE)
    field = correlated_field((scene.lines, scene.samples), shade.correlation_pixels, rng)
    dark = (field < np.quantile(field, shade.area_fraction)) & ~open_sky
    soft, weights = dark.astype(np.float32), pixel_weights(scene.psf_fwhm_pixels).astype(np.float32)
    for axis in (0, 1):
        soft = ndimage.correlate1d(soft, weights, axis=axis, mode="nearest")
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


_MIN_VARIANCE = 1e-10  # of the mean variance of a band


class Sampler:
    """Draws spectra of a class of one law: mean + z factor, z standard normal.

    The factor (B, B) is Cholesky's: it is unique, so that the draws do not depend on the linear algebra library as
    eigenvectors of near-equal eigenvalues would.

    ``dof`` : of a multivariate t law of the same mean and covariance; None: the class's own
    """

    def __init__(self, statistics: ClassStatistics, dof: float | None = None):
        covariance, self.dof = statistics.covariance, statistics.tail_dof if dof is None else dof
        # A covariance of less than full rank gains a spread that float32 draws hardly resolve.
        least = _MIN_VARIANCE * float(np.trace(covariance)) / len(covariance) * np.eye(len(covariance))
        self.mean: Field = statistics.mean.astype(np.float32)
        self.factor: Field = np.linalg.cholesky(covariance + least).T.astype(np.float32)

    def draw(self, count: int, rng: np.random.Generator) -> Field:
        """(count, B) spectra."""
        z = rng.standard_normal((count, self.mean.size), dtype=np.float32)
        if self.dof is not None:
            # A t vector is a normal one over sqrt(chi2/nu); its covariance is nu/(nu - 2) times larger.
            z *= np.sqrt((self.dof - 2.0) / rng.chisquare(self.dof, count))[:, None].astype(np.float32)
        return np.asarray(z @ self.factor + self.mean)


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
        self._names = list(dict.fromkeys((*ground.surfaces, *(a.surface for a in scene.broken.admixtures))))
        open_ground = {a.surface for a in scene.layout}
        self._samplers = [
            Sampler(classes[name], tails.dof if tails and name in open_ground else None) for name in self._names
        ]
        self.bands = int(self._samplers[0].mean.size)
        self._texture = texture_factor(scene, ground.on_panel)
        self._light = illumination(scene, ndimage.binary_dilation(ground.on_panel, iterations=3))
        self._shares = [admixture_share(scene, a, i) for i, a in enumerate(scene.broken.admixtures)]
        drawn = [np.zeros((0, self.bands), np.float32)]
        for number, group in enumerate(scene.targets):
            rng = schema.generator(scene.seed, schema.TARGET_SPECTRA, number)
            drawn.append(Sampler(classes[group.material]).draw(group.count, rng))
        self.target_spectra = np.concatenate(drawn)
        self._seen = defaultdict[int, list[tuple[Plank, Field]]](list)  # planks with their spectra, by line
        for plank, spectrum in zip(ground.planks, self.target_spectra, strict=True):
            for line in np.unique(plank.lines).tolist():
                self._seen[line].append((plank, spectrum))

    def shares(self, line: int) -> Field:
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

    def reflectance(self, line: int) -> Field:
        """(samples, B) of one line: surfaces as drawn, planks blended in by their fill, times the share of light."""
        rng = schema.generator(self.scene.seed, schema.SURFACE, line)
        rho = np.zeros((self.scene.samples, self.bands), np.float32)
        for share, draws in zip(self.shares(line), self._samplers, strict=True):
            index = np.flatnonzero(share > MIN_FILL)
            rho[index] += draws.draw(index.size, rng) * share[index, None]
        rho *= self._texture[line][:, None]
        rho *= (1.0 - self.ground.fill[line])[:, None]
        for plank, spectrum in self._seen.get(line, ()):
            on_line = plank.lines == line
            rho[plank.samples[on_line]] += plank.fills[on_line, None].astype(np.float32) * spectrum
        if self.scene.mode == "broken":
            # Heavy tails reach where no surface can; in closure the model's own law is kept whole.
            np.clip(rho, 0.0, 1.0, out=rho)
        rho *= self._light[line][:, None]
        return rho

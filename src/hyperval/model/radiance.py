"""From reflectance statistics to radiance statistics at the sensor (3.7-3.12), and back by the empirical line.

Every function takes ``formulation``: "corrected" (default) or "thesis", the form as printed.

===================  =========================================  ==============================
quantity             corrected                                  thesis
===================  =========================================  ==============================
ground term (3.7)    A rho_m / (1 - S rho_ave)                  A rho_m / (1 - S rho_m)
slope D_A (3.11)     A / (1 - S rho_ave)                        A / (1 - S), an albedo-1 run
slope D_B (3.11)     (A S rho_m + B) / (1 - S rho_ave)^2        B / (1 - S)
kappa (3.11)         1 / N_eff                                  1
fill (3.12)          E[f^2], E[(1-f)^2], Var f                  f^2, (1-f)^2, 0
===================  =========================================  ==============================

rho_ave is the scene average over the background classes (3.8).  The empirical line on statistics has no number in the
source: two panels of reflectance 0.1 and 0.6 without noise, k_i = (L_i(high) - L_i(low)) / (rho_high - rho_low),
b_i = L_i(low) - k_i rho_low, rho^ = (L - b) / k, Sigma^_ij = Sigma_L,ij / (k_i k_j).

Arrays of U truths are (U or 1, S, B): truths, subjects, bands; those of one truth alone are (B,), by the same lines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache, partial
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dsfrk, dtfttr, dtrttf
from scipy.special import ndtr, ndtri

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.data import Array, Index, Mask
from hyperval.errors import needed, refuse
from hyperval.model.stated import Law
from hyperval.model.world import World
from hyperval.scenario import DarkestPixel, ElmPanels
from hyperval.sensor.noise import NoiseModel, with_signal


def average_reflectance(fractions: npt.ArrayLike, means: npt.ArrayLike) -> Array:
    """Area-average reflectance rho_ave = sum f_m rho_m (3.8), (..., B) [1].

    Parameters
    ----------
    fractions : (..., M) area fractions, sum 1
    means : (..., M, B) class means [1]
    """
    f = np.asarray(fractions, dtype=float)
    return np.asarray(np.matmul(f[..., None, :], np.asarray(means, dtype=float))[..., 0, :])  # (3.8)


Formulation = Literal["corrected", "thesis"]


def mean_radiance(
    terms: AtmosphericTerms,
    reflectance: npt.ArrayLike,
    average_reflectance: npt.ArrayLike,
    formulation: Formulation = "corrected",
) -> Array:
    """Mean radiance of a class at the sensor (3.7) [uW cm-2 sr-1 nm-1].

    L = L_a + (A rho + B rho_ave) / (1 - S rho_ave).  The printed form runs the engine with the class
    all over the ground, so that its ground term trains light between class and sky: A rho / (1 - S rho).

    Parameters
    ----------
    terms : (B,) each
    reflectance : (..., B) of the viewed pixel [1]
    average_reflectance : (B,) of its surroundings [1]
    """
    rho, rho_ave = np.asarray(reflectance, dtype=float), np.asarray(average_reflectance, dtype=float)
    trapping = 1.0 - terms.spherical_albedo * rho_ave
    path = terms.path_radiance + terms.adjacency * rho_ave / trapping  # L_P of (3.7)
    trap = trapping if formulation == "corrected" else 1.0 - terms.spherical_albedo * rho
    return np.asarray(path + terms.direct * rho / trap)  # (3.7)


def toa_reflectance(radiance: npt.ArrayLike, diffuser_radiance: npt.ArrayLike) -> Array:
    """(..., B) reflectance at the top of the atmosphere of a radiance (3.7), pi L d^2 / (mu0 E0) [1].

    Parameters
    ----------
    radiance : (..., B) L above the atmosphere
    diffuser_radiance : (B,) mu0 E0 / (pi d^2), what a white level diffuser would have there, in the same unit

    Source: Nicodemus et al., NBS Monograph 160, 1977 (reflectance factor of a Lambertian diffuser).

    Examples
    --------
    >>> toa_reflectance([2.0, 1.0], [10.0, 4.0]).tolist()
    [0.2, 0.25]
    """
    return np.asarray(np.asarray(radiance, dtype=float) / np.asarray(diffuser_radiance, dtype=float))


def target_pixel_reflectance(fill: npt.ArrayLike, target: npt.ArrayLike, host: npt.ArrayLike) -> Array:
    """Reflectance of a pixel of which the target fills the part ``fill`` (3.10) [1].

    Parameters
    ----------
    fill : scalar or (...,) fill fraction f [1]
    target, host : (B,) reflectance of target and of the class around it

    Returns
    -------
    (..., B), to be put into :func:`mean_radiance` for (3.9).
    """
    f = np.asarray(fill, dtype=float)[..., None]
    return np.asarray(f * np.asarray(target, dtype=float) + (1.0 - f) * np.asarray(host, dtype=float))  # (3.10)


def illumination_factor(
    terms: AtmosphericTerms, average_reflectance: npt.ArrayLike, beam: float | Array, sky_view: float | Array
) -> Array:
    """Irradiance of a shaded surface over that of open ground (on the ground term of 3.7), (B,) [1].

    phi = (1 - S rho_ave) [(1 - q) beam + q sky_view] + S rho_ave sky_view, with q the diffuse fraction on a black
    ground.  Light reflected by ground and sky is diffuse too, so that the ground term is
    A rho [(1 - q) beam + q sky_view + sky_view S rho_ave / (1 - S rho_ave)].  Obstacles are taken as black.  The
    printed form has no shade: there the factor goes on the reflectance.

    Parameters
    ----------
    beam : part of the sun's beam that reaches the surface: 1 open, 0 in full shade
    sky_view : part of the sky's light that reaches it, 0-1

    Raises
    ------
    UsageError : the atmosphere has no diffuse fraction.
    """
    q = needed(terms.diffuse_fraction, "light.sky")
    back = terms.spherical_albedo * np.asarray(average_reflectance, dtype=float)
    return np.asarray((1.0 - back) * ((1.0 - q) * beam + q * sky_view) + back * sky_view)


def direct_slope(
    terms: AtmosphericTerms, average_reflectance: npt.ArrayLike, formulation: Formulation = "corrected"
) -> Array:
    """D_A of (3.11): change of radiance per change of the pixel's own reflectance, (B,)."""
    albedo = np.asarray(average_reflectance, dtype=float) if formulation == "corrected" else 1.0
    return np.asarray(terms.direct / (1.0 - terms.spherical_albedo * albedo))


def adjacency_slope(
    terms: AtmosphericTerms,
    reflectance: npt.ArrayLike,
    average_reflectance: npt.ArrayLike,
    formulation: Formulation = "corrected",
) -> Array:
    """D_B of (3.11): change of radiance per change of the surroundings' reflectance, (..., B).

    The derivative of (3.7) by rho_ave is (A S rho + B) / (1 - S rho_ave)^2.
    """
    rho, s = np.asarray(reflectance, dtype=float), terms.spherical_albedo
    if formulation == "thesis":
        return np.asarray(terms.adjacency / (1.0 - s) + np.zeros_like(rho))
    trapping = 1.0 - s * np.asarray(average_reflectance, dtype=float)
    return np.asarray((terms.direct * s * rho + terms.adjacency) / trapping**2)


def radiance_covariance(
    terms: AtmosphericTerms,
    reflectance: npt.ArrayLike,
    covariance: npt.ArrayLike,
    average_reflectance: npt.ArrayLike,
    average_covariance: npt.ArrayLike,
    *,
    adjacency_gain: float = 1.0,
    kappa: float = 0.0,
    formulation: Formulation = "corrected",
) -> Array:
    """Pixel-to-pixel covariance of radiance before the sensor (3.11), also (3.12) with that of a target pixel.

    Sigma_L = D_A Sigma D_A + kappa D_B g_B Sigma_ave D_B.  ``covariance`` already holds its own gain
    (:func:`target_pixel_covariance`, or g_B Sigma_m for a background class).

    Parameters
    ----------
    terms : (B,) each
    reflectance, covariance : (B,), (B, B) of the pixel; the reflectance enters D_B alone
    average_reflectance, average_covariance : (B,), (B, B) of the scene
    adjacency_gain : g_B on the adjacency term
    kappa : 1/N_eff, the variance of the neighbourhood average as a part of that of one pixel; the
        printed form has 1, whatever is given here

    Returns
    -------
    (B, B) [(uW cm-2 sr-1 nm-1)^2]
    """
    d_a = direct_slope(terms, average_reflectance, formulation)
    d_b = adjacency_slope(terms, reflectance, average_reflectance, formulation)
    weight = adjacency_gain * (kappa if formulation == "corrected" else 1.0)
    result: Array = np.asarray(covariance, dtype=float) * d_a[:, None]
    result *= d_a
    if weight:
        adjacency_term = np.asarray(average_covariance, dtype=float) * (weight * d_b)[:, None]
        adjacency_term *= d_b
        result += adjacency_term
    return result  # (3.11)


def fill_squares(mean: float, variance: float, fine_texture: float = 0.0) -> tuple[float, float]:
    """Factors on covariances of target and host: E[f^2], E[f] for texture finer than a pixel, E[(1 - f)^2] (3.12)."""
    f2 = mean**2 + variance
    return f2 + fine_texture * (mean - f2), (1.0 - mean) ** 2 + variance


def target_pixel_covariance(
    fill_mean: float,
    fill_variance: float,
    target: npt.ArrayLike,
    target_covariance: npt.ArrayLike,
    host: npt.ArrayLike,
    host_covariance: npt.ArrayLike,
    *,
    target_gain: float = 1.0,
    host_gain: float = 1.0,
    fine_texture: float = 0.0,
) -> Array:
    """Reflectance covariance of pixels partly filled by the target (3.12, extended to random fill).

    E[f^2] g_T Sigma_T + E[(1-f)^2] g_B Sigma_b + Var(f) (rho_T - rho_b)(rho_T - rho_b)^T; the printed
    form is the case Var(f) = 0.  E[f^2] holds for a target that is uniform within a pixel.  Texture finer than its
    part of a pixel averages out over it, to Sigma_T/f: its factor is E[f].

    Parameters
    ----------
    fill_mean, fill_variance : moments of the fill fraction f [1]
    target, host : (B,) means;  target_covariance, host_covariance : (B, B)
    target_gain, host_gain : g_T, g_B
    fine_texture : part of Sigma_T by such texture

    Returns
    -------
    (B, B)
    """
    f2, g2 = fill_squares(fill_mean, fill_variance, fine_texture)
    result = (f2 * target_gain) * np.asarray(target_covariance, float) + (g2 * host_gain) * np.asarray(host_covariance)
    d = np.asarray(target, dtype=float) - np.asarray(host, dtype=float)
    if fill_variance or not np.all(np.isfinite(d)):  # a band without a mean has no covariance either
        result += np.outer(fill_variance * d, d)
    return np.asarray(result)  # (3.12)


@dataclass(frozen=True)
class TwoPanelLine:
    """L = offset + gain rho per band.

    Attributes
    ----------
    gain : (B,) k [uW cm-2 sr-1 nm-1 per unit reflectance]
    offset : (B,) b [uW cm-2 sr-1 nm-1]
    """

    gain: Array
    offset: Array


def two_panel_line(
    radiance_low: npt.ArrayLike,
    radiance_high: npt.ArrayLike,
    reflectance_low: npt.ArrayLike = 0.1,
    reflectance_high: npt.ArrayLike = 0.6,
) -> TwoPanelLine:
    """The line through two panels (before 3.21).

    Parameters
    ----------
    radiance_low, radiance_high : (B,) mean radiance of the panels
    reflectance_low, reflectance_high : scalar or (B,) their reflectances [1]

    Raises
    ------
    UsageError : the panels do not differ in reflectance, or the brighter one is not brighter.
    """
    low, high = np.asarray(radiance_low, dtype=float), np.asarray(radiance_high, dtype=float)
    r_low, r_high = np.asarray(reflectance_low, dtype=float), np.asarray(reflectance_high, dtype=float)
    step = r_high - r_low
    refuse(np.any(step <= 0), "line.order")
    gain = (high - low) / step
    dark = int(np.sum(~(gain > 0)))
    refuse(dark, "line.slope", dark=dark, bands=gain.size)
    return TwoPanelLine(gain, low - r_low * gain)


def retrieved_reflectance(line: TwoPanelLine, radiance: npt.ArrayLike) -> Array:
    """rho^ = (L - b) / k, (..., B) [1] (before 3.21)."""
    return np.asarray((np.asarray(radiance, dtype=float) - line.offset) / line.gain)


def retrieved_covariance(line: TwoPanelLine, covariance: npt.ArrayLike) -> Array:
    """Sigma^_ij = Sigma_L,ij / (k_i k_j), (B, B) [1] (before 3.21); the offset does not enter."""
    slope = 1.0 / line.gain
    return np.asarray(np.asarray(covariance, dtype=float) * slope[:, None] * slope)


def darkest_level(fractions: npt.ArrayLike, means: npt.ArrayLike, sds: npt.ArrayLike, pixels: int) -> Array:
    """Radiance of the darkest of ``pixels`` pixels of the scene, band by band: its median (before 3.21).

    All of n independent pixels exceed x with probability (1 - F(x))^n, F = sum f_m Phi((x - L_m) / sigma_m); the
    median of their least is F(x) = 1 - 2^(-1/n).  Darkest-pixel compensation takes it for the radiance of a dark
    surface.

    Parameters
    ----------
    fractions : (..., M) area fractions, sum 1
    means, sds : (..., M, B) of the classes' radiance

    Returns
    -------
    (..., B)

    Raises
    ------
    UsageError : no pixel.
    """
    f, mu, sd = (np.asarray(a, dtype=float) for a in (fractions, means, sds))
    refuse(pixels < 1, "line.pixels", pixels=pixels)
    f, sd = f[..., None], np.maximum(sd, 1e-300)
    p = -np.expm1(-np.log(2.0) / pixels)
    quantiles = mu + sd * ndtri(p)
    high = np.where(f > 0, quantiles, -np.inf).max(axis=-2)  # where every class is below x with p or more
    low = np.where(f > 0, quantiles, np.inf).min(axis=-2)  # where none is with more than p
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = (f * ndtr((middle[..., None, :] - mu) / sd)).sum(axis=-2) < p
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))


T = TypeVar("T")


def submatrix(covariance: Array, bands: Index) -> Array:
    """The rows and columns ``bands`` of a covariance; the matrix itself where they are all."""
    return covariance if bands.size == covariance.shape[0] else covariance[np.ix_(bands, bands)]


def select_rows(values: Array, index: Index) -> Array:
    """Rows of values (U or 1, ...); a shared row stays."""
    return np.asarray(values[index]) if len(values) > 1 else values


def _rows_of(value: T, arrays: Sequence[str], index: Index) -> T:
    """A dataclass with its ``arrays`` (U or 1, ...) at some truths."""
    changes: dict[str, Any] = {name: select_rows(getattr(value, name), index) for name in arrays}
    return replace(value, **changes)  # type: ignore[type-var]


def truth_row(values: Array, u: int) -> Array:
    """The row of one truth, of values (U or 1, ...)."""
    return np.asarray(values[u if len(values) > 1 else 0])


def stacked_noise(models: Sequence[NoiseModel], bands: int) -> NoiseModel:
    """U noise models as one whose arrays are (U, 1, B), so that levels (U, S, B) go through its formulas.

    Fields that are the same in all stay: numbers, words, arrays that are one object.
    """

    def joined(*values: Any) -> Any:
        first = values[0]
        if isinstance(first, tuple):
            return tuple(joined(*parts) for parts in zip(*values, strict=True))
        if all(v is first or (np.ndim(first) == np.ndim(v) == 0 and v == first) for v in values):
            return first
        return np.stack([np.broadcast_to(v, (bands,)) for v in values])[:, None, :]

    return replace(models[0], **{f.name: joined(*(getattr(m, f.name) for m in models)) for f in fields(NoiseModel)})


def _on_arrays(value: T, change: Callable[[Array], Any]) -> T:
    """A dataclass with every array in it changed, those of the dataclasses and tuples in it too."""
    changes: dict[str, Any] = {}
    for name, part in vars(value).items():
        if isinstance(part, np.ndarray) and part.ndim:
            changes[name] = change(part)
        elif isinstance(part, AtmosphericTerms | NoiseModel):
            changes[name] = _on_arrays(part, change)
        elif isinstance(part, tuple) and part and isinstance(part[0], np.ndarray):
            changes[name] = tuple(map(change, part))
    return replace(value, **changes)  # type: ignore[type-var]


@dataclass(frozen=True)
class Light:
    """Atmosphere, surroundings, sensor and empirical line of U truths.

    Attributes
    ----------
    terms : of the recorded signal, on the bands
    average : (U or 1, 1, B) reflectance of the surroundings
    noise : None without a sensor
    kappa : (U or 1, 1, 1) of (3.11), 1 in the printed form
    formulation : corrected or thesis
    radiant : whether radiance is recorded, and not reflectance itself
    elm : the empirical line or the darkest pixel; None for detection on the recorded signal
    dark : (U or 1, 1, B) radiance of the darkest of the scene's pixels, for darkest-pixel compensation
    panels : (U or 1, 1, B or 1) factors on the true reflectance of the dark and the bright panel of the line
    retrieval : likewise, gain and offset on the retrieved reflectance
    """

    terms: AtmosphericTerms
    average: Array
    noise: NoiseModel | None
    kappa: Array
    formulation: Formulation = "corrected"
    radiant: bool = True
    elm: ElmPanels | DarkestPixel | None = None
    dark: Array | None = None
    panels: tuple[Array | float, Array | float] = (1.0, 1.0)
    retrieval: tuple[Array | float, Array | float] = (1.0, 0.0)

    def on_bands(self, bands: Index) -> Light:
        """This light on some bands alone."""
        return _on_arrays(self, lambda x: x[..., bands] if x.shape[-1] > 1 else x)

    def rows(self, index: Index) -> Light:
        """Those of some truths."""
        return _on_arrays(self, lambda x: select_rows(x, index) if x.ndim == 3 else x)

    def row(self, number: int) -> Light:
        """The light of one truth, its arrays (B,)."""
        return _on_arrays(self, lambda x: truth_row(x, number)[0] if x.ndim == 3 else x)

    def signal(self, reflectance: npt.ArrayLike) -> Array:
        """Mean signal (..., B) of a reflectance (..., B) (3.7)."""
        return mean_radiance(self.terms, np.asarray(reflectance, dtype=float), self.average, self.formulation)

    def shading(self, beam: float | Array, sky_view: float | Array) -> Array:
        """(..., B) light on a target over that in the open (ground term of 3.7); (1,) without shade.

        Raises
        ------
        UsageError : shade in the reflectance domain, or an atmosphere without a diffuse fraction.
        """
        if np.all(np.asarray(beam) == 1.0) and np.all(np.asarray(sky_view) == 1.0):
            return np.ones(1)
        refuse(not self.radiant, "light.shade")
        return illumination_factor(self.terms, self.average, beam, sky_view)

    def surface(self, mean: Array, beam: Array, sky_view: Array) -> tuple[Array, Array, Array]:
        """A shaded surface, and the surface in the open that gives the same signal (ground term of 3.7).

        Parameters
        ----------
        mean : (U or 1, F) its reflectance;  beam, sky_view : (U or 1,) parts of the light in the open that reach it

        Returns
        -------
        (U or 1, 1, F) mean of the equivalent surface, (U or 1, 1, F) reflectance times sky view, which enters D_B of
        (3.11), and (U, 1, F) light over that in the open, (1,) without shade
        """
        target, beam, sky = mean[:, None, :], beam[:, None, None], sky_view[:, None, None]
        factor = self.shading(beam, sky)
        return target * factor, target * sky, factor

    def pixel_covariance(
        self, noise: Array, under_sky: Array, covariance: Array, around: Array, gain: float = 1.0
    ) -> Array:
        """Pixel covariance (B, B) of the signal with sensor noise (3.11, 3.16-3.19), of one truth.

        ``noise`` (B,) : variance not yet in ``covariance``;  ``under_sky`` (B,) : reflectance in D_B;  ``around``
        (B, B) : covariance of the surroundings
        """
        result = radiance_covariance(
            self.terms, under_sky, covariance, self.average, around, adjacency_gain=gain,
            kappa=float(self.kappa.reshape(-1)[0]), formulation=self.formulation,
        )  # fmt: skip
        result.flat[:: noise.size + 1] += noise
        return result

    def noise_variance(self, level: Array) -> Array:
        """Noise variance (..., B) at a signal level (3.16-3.19)."""
        return np.zeros_like(level) if self.noise is None else self.noise.variance(level)

    def direct_slope(self) -> Array:
        """(..., B) change of the signal per change of the pixel's reflectance (D_A of 3.11)."""
        return direct_slope(self.terms, self.average, self.formulation)

    def adjacency_slope(self, reflectance: Array) -> Array:
        """(..., B) change of the signal per change of the surroundings (D_B of 3.11)."""
        return adjacency_slope(self.terms, reflectance, self.average, self.formulation)

    def lit_bands(self) -> Mask:
        """(..., B) True where ground-reflected light reaches the sensor."""
        return np.asarray(self.terms.direct > 1e-9 * self.terms.direct.max(axis=-1, keepdims=True))

    def empirical_line(self) -> TwoPanelLine:
        """The empirical line (before 3.21); gain 1 and offset 0 where detection runs on the signal itself.

        Bands without light have NaN.
        """
        (gain, offset), line = self.retrieval, self._panel_line(*self.panels)
        k = line.gain / gain  # (L - b) / k of the line of the panels is gain rho + offset
        return TwoPanelLine(k, line.offset - k * offset)

    @cached_property
    def library_line(self) -> TwoPanelLine:
        """The line of panels of stated reflectance, from library spectra to the image's units."""
        return self._panel_line(1.0, 1.0)

    def _panel_line(self, dark_panel: float | Array, bright_panel: float | Array) -> TwoPanelLine:
        """The line of panels with these factors on their assumed reflectances."""
        if self.elm is None:
            return TwoPanelLine(np.ones(self.average.shape), np.zeros(self.average.shape))
        bands = self.average.shape[-1]
        low, high = self.elm.reflectances
        dark = self.signal(np.full(bands, low) * dark_panel) if self.dark is None else self.dark
        lit, bright = self.lit_bands(), self.signal(np.full(bands, high) * bright_panel)
        line = two_panel_line(np.where(lit, dark, 0.0), np.where(lit, bright, 1.0), low, high)
        return TwoPanelLine(np.where(lit, line.gain, np.nan), np.where(lit, line.offset, np.nan))


def scene_light(world: World) -> Light:
    """L' = g [p e L_a + q e (A rho + B rho_ave) / (1 - S rho_ave)] + o of all truths, rho_ave by (3.8).

    Factors p of the path, q of the ground, e of the irradiance and the recorded gain g and offset o go into L_a, A, B.

    Raises
    ------
    EngineError : the atmosphere engine failed.
    """
    stated, processing = world.stated, world.stated.scenario.processing
    radiant = stated.scenario.atmosphere is not None

    def factor(name: str) -> Array:
        return np.asarray(world.column(name)[:, None, :])

    terms, means = world.surroundings
    e, g, offset = factor("irradiance"), factor("gain"), factor("offset")
    if radiant:
        ground, white = g * e * factor("ground"), terms.diffuser_radiance
        terms = replace(
            terms,
            path_radiance=g * (e * factor("path") * terms.path_radiance + factor("path_error")) + offset,
            direct=ground * terms.direct,
            adjacency=ground * terms.adjacency,
            spherical_albedo=factor("albedo") * terms.spherical_albedo,
            ground_irradiance=e * terms.ground_irradiance,
            diffuser_radiance=None if white is None else e * white,
        )
    average = average_reflectance(world.fraction, means)[:, None, :]
    if stated.surroundings is not None:
        average = stated.surroundings[None, None, :]
    models, which = world.sensor_noise
    noise = None
    if models:
        noise = _on_arrays(stacked_noise(models, len(stated.axis)), lambda x: x[which] if x.ndim == 3 else x)
        noise, fixed = with_signal(noise, factor("electrons")), noise.fixed_noise * factor("fixed_noise")
        noise = replace(noise, fixed_noise=fixed, gain=g, offset=offset, factor=factor("noise"))
    elm = processing.elm if isinstance(processing.elm, ElmPanels) or (radiant and processing.elm != "none") else None
    light = Light(
        terms, average * factor("surroundings"), noise, world.kappa, stated.scenario.formulation, radiant, elm,
        panels=(factor("dark"), factor("bright")), retrieval=(factor("line_gain"), factor("line_offset")),
    )  # fmt: skip
    if not isinstance(elm, DarkestPixel):
        return light
    classes = Background.from_world(world, np.arange(len(stated.axis)))
    return replace(light, dark=_darkest_radiance(light, classes, elm.darkest_pixel))


def target_light(world: World, light: Light, target: int) -> tuple[Array, Array, Array]:
    """A target under its own light, as :meth:`Light.surface` returns it."""
    number = world.surface_number(world.stated.targets[target].name)
    return light.surface(world.mean[:, number], world.column("beam")[:, target], world.column("sky_view")[:, target])


def _darkest_radiance(light: Light, classes: Background, pixels: int) -> Array:
    """(U or 1, 1, B) radiance of the darkest of so many of the scene's pixels (before 3.21)."""
    level, gain, scene = light.signal(classes.means), classes.gain[:, :, None], classes.scene_variances()[:, None, :]
    noise = np.where(classes.of_pixels[:, None], 0.0, light.noise_variance(level))
    variance = gain * classes.class_variances() * light.direct_slope() ** 2 + noise
    variance = variance + gain * light.kappa * scene * light.adjacency_slope(classes.means) ** 2
    fractions = np.broadcast_to(classes.fraction, variance.shape[:-1])
    return darkest_level(fractions, level, np.sqrt(variance), pixels)[..., None, :]


def cached_matrix(cache: dict[str, tuple[bytes, Array]], name: str, key: bytes, make: Callable[[], Array]) -> Array:
    """A matrix, cached until its key changes."""
    if name not in cache or cache[name][0] != key:
        cache[name] = key, make()
    return cache[name][1]


# Symmetric matrices (F, F) are in LAPACK's rectangular full packed form (transr N, uplo L): vectors of F (F + 1) / 2
# numbers, half the memory at the speed of full matrices, combined element by element.


def pack(matrix: Array) -> Array:
    """(P,) packed form of a symmetric matrix (F, F)."""
    values, _ = dtrttf(matrix.T, uplo="L")  # the transpose of C order is Fortran's, and the matrix is symmetric
    return np.asarray(values)


def unpack(values: Array, size: int) -> Array:
    """(F, F) the full matrix."""
    lower = np.tril(dtfttr(size, values, uplo="L")[0])
    return np.asarray(lower + np.tril(lower, -1).T)


@lru_cache(maxsize=32)
def packed_diagonal(size: int) -> Index:
    """(F,) positions of the diagonal."""
    return np.argsort(pack(np.diag(np.arange(1.0, size + 1.0))), kind="stable")[-size:]


def add_products(values: Array, rows: Array, *, fresh: bool = False) -> Array:
    """The matrix plus r^T r for rows r (K, F), in the memory of ``values``; ``fresh``: r^T r alone."""
    count, size = rows.shape
    keep = 0.0 if fresh else 1.0
    return np.asarray(dsfrk(size, count, 1.0, rows.T, keep, values, uplo="L", overwrite_c=1))


@dataclass(frozen=True, eq=False)
class Background:
    """The classes of U truths, on some bands.

    Attributes
    ----------
    fraction, gain : (U or 1, M) f_m, g_m
    means, between : (U or 1, M, F) rho_m, and their departures from their average
    covariances : M times (F, F);  stretch : (U or 1, M, F or 1) factors on both sides of them
    laws : distributions of the classes;  law_fraction : (U or 1, J) of them
    cache : of results that depend on the covariances alone
    """

    fraction: Array
    gain: Array
    means: Array
    between: Array
    covariances: tuple[Array, ...]
    stretch: Array
    laws: tuple[Law, ...]
    law_fraction: Array
    of_pixels: Mask
    cache: dict[Any, Any]

    @staticmethod
    def from_world(world: World, bands: Index) -> Background:
        """The classes of a world on some bands."""
        stated, classes = world.stated, len(world.stated.classes)

        def on_bands() -> tuple[tuple[Array, ...], tuple[Law, ...], dict[Any, Any]]:
            covariances = tuple(submatrix(stated.surfaces[n].covariance, bands) for n in stated.classes)
            laws = (x._replace(offset=x.offset[bands], covariance=submatrix(x.covariance, bands)) for x in stated.laws)
            return covariances, tuple(laws), {}

        covariances, laws, cache = stated.cached(("background", bands.tobytes()), on_bands)
        means = world.surroundings[1]
        between = means - average_reflectance(world.fraction, means)[:, None, :]
        stretch = world.stretch[:, :classes]
        return Background(
            world.fraction, world.column("class_gain"), world.mean[:, :classes, bands], between[..., bands],
            covariances, stretch[..., bands] if stretch.shape[-1] > 1 else stretch, laws, world.law_fraction,
            stated.of_pixels[:classes], cache,
        )  # fmt: skip

    def rows(self, index: Index) -> Background:
        """Those of some truths."""
        return _rows_of(self, ("fraction", "gain", "means", "between", "stretch", "law_fraction"), index)

    def within_class(self, weights: Array, u: int = 0) -> Array:
        """(P,) within-class covariance, sum over classes of w_m Sigma_m, of one truth, packed; cached."""
        stretch = truth_row(self.stretch, u)
        stack = cached_matrix(self.cache, "stack", b"", lambda: np.array([pack(c) for c in self.covariances]))

        def mixture() -> Array:
            if stretch.shape[1] == 1:
                return np.asarray((weights * stretch[:, 0] ** 2) @ stack)
            terms = zip(weights, stretch, stack, strict=True)
            return np.asarray(sum(w * pack(np.outer(g, g)) * c for w, g, c in terms))

        return cached_matrix(self.cache, "classes", weights.tobytes() + stretch.tobytes(), mixture)

    def packed_covariance(self, u: int = 0) -> Array:
        """(P,) covariance of a pixel drawn from the whole scene, packed; cached.

        Sigma_ave = sum f_m [Sigma_m + (rho_m - rho_ave)(rho_m - rho_ave)^T]: within the classes and between them.
        """
        f, between = (truth_row(x, u) for x in (self.fraction, self.between))

        def mixture_covariance() -> Array:
            return add_products(self.within_class(f, u).copy(), np.sqrt(f)[:, None] * between)  # Sigma_ave of (3.11)

        return cached_matrix(self.cache, "around", self.cache_key(u), mixture_covariance)

    def covariance(self, u: int = 0) -> Array:
        """(F, F) Sigma_ave of (3.11), in full."""
        make = partial(unpack, self.packed_covariance(u), self.means.shape[-1])
        return cached_matrix(self.cache, "covariance", self.cache_key(u), make)

    def cache_key(self, u: int) -> bytes:
        """The inputs of Sigma_ave of one truth, as bytes."""
        return b"".join(truth_row(x, u).tobytes() for x in (self.fraction, self.between, self.stretch))

    def class_variances(self) -> Array:
        """(U or 1, M, F) diagonals of the covariances of the classes."""
        return np.asarray(np.array([np.diag(c) for c in self.covariances]) * self.stretch**2)

    def scene_variances(self) -> Array:
        """(U or 1, F) the diagonal of Sigma_ave."""
        return np.asarray(np.matmul(self.fraction[:, None, :], self.class_variances() + self.between**2)[:, 0])


@dataclass(frozen=True)
class Retrieved:
    """The classes after the empirical line in U truths, on the detectors' bands, (U or 1, ...) each.

    Attributes
    ----------
    light, classes : on these bands
    gain, offset : (U or 1, 1, F) of the empirical line
    slope : (U or 1, F) D_A / k of (3.11)
    adjacency : (U or 1, M, F) D_B / k times the root of g_m kappa, of (3.11)
    means : (U or 1, M, F) retrieved reflectances
    noise : (U or 1, M, F) noise variances of the retrieved reflectances, 0 for classes whose covariance holds them
    held_noise : (U or 1, M, F) noise variances that covariances of pixels of the image already hold, 0 of others
    signatures : target -> (U or 1, F) spectrum that its filter looks for, in the units of the image
    """

    light: Light
    classes: Background
    gain: Array
    offset: Array
    slope: Array
    adjacency: Array
    means: Array
    noise: Array
    held_noise: Array
    signatures: Mapping[str, Array]

    def rows(self, index: Index) -> Retrieved:
        """Those of some truths."""
        rows = _rows_of(self, ("gain", "offset", "slope", "adjacency", "means", "noise", "held_noise"), index)
        signatures = {name: select_rows(x, index) for name, x in self.signatures.items()}
        return replace(rows, light=self.light.rows(index), classes=self.classes.rows(index), signatures=signatures)


def retrieve(full_light: Light, world: World, bands: Index) -> Retrieved:
    """The classes of a world after the empirical line, on some bands (3.7-3.21).

    A covariance measured on the image holds the noise; one measured on predicted pixels gives the same prediction:

    >>> from hyperval import model
    >>> from hyperval.api import load_scenario
    >>> from hyperval.statistics_library import ClassStatistics
    >>> scenario, subjects = load_scenario("yellow-planks-asphalt"), [("whole", 1.0), ("half", 0.5)]
    >>> def with_covariances(of_class, of_target):
    ...     asphalt, *others = scenario.scene.classes
    ...     asphalt = asphalt.model_validate({**asphalt.model_dump(), "covariance": of_class})
    ...     plank = {**scenario.scene.targets[0].model_dump(), "covariance": of_target}
    ...     plank["subjects"] = [{"name": name, "fill": {"fixed": fill}} for name, fill in subjects]
    ...     plank = scenario.scene.targets[0].model_validate(plank)
    ...     update = {"classes": [asphalt, *others], "targets": [plank]}
    ...     return scenario.model_copy(update={"scene": scenario.scene.model_copy(update=update)})
    >>> first = model.predict(with_covariances(None, None))
    >>> pixels = {n: np.nan_to_num(x.pixel_covariance) for n, x in first.reflectance.items()}
    >>> image = {n: ClassStatistics(n, first.axis, np.nan_to_num(first.reflectance[n].mean), pixels[n], 5000)
    ...     for n in ("asphalt", "whole")}
    >>> second = with_covariances({"measured": "asphalt"}, {"measured": "whole"})
    >>> second = model.predict(second, model.Origins(measured=image))
    >>> abs(second.scores["half", "cem"].sd / first.scores["half", "cem"].sd - 1.0) < 1e-3
    True
    >>> bool(np.allclose(np.nan_to_num(second.reflectance["half"].pixel_covariance), pixels["half"], rtol=2e-3))
    True
    """
    light, classes = full_light.on_bands(bands), Background.from_world(world, bands)
    line, level = light.empirical_line(), light.signal(classes.means)
    weight = np.sqrt(classes.gain[:, :, None] * light.kappa)
    adjacency = light.adjacency_slope(classes.means) / line.gain * weight
    slope = np.ascontiguousarray((light.direct_slope() / line.gain)[:, 0])
    signatures = {
        name: retrieved_reflectance(light.library_line, light.signal(signature[None, bands]))[:, 0]
        for name, signature in world.stated.signatures.items()
    }
    means, noise = retrieved_reflectance(line, level), light.noise_variance(level) / line.gain**2
    held = np.where(classes.of_pixels[:, None], noise, 0.0)
    return Retrieved(light, classes, line.gain, line.offset, slope, adjacency, means, noise - held, held, signatures)


def usable_bands(world: World, light: Light) -> Mask:
    """(U or 1, B) bands with light, and with the spectra that the detectors need (3.21)."""
    names = [*world.stated.classes, *world.stated.names["target"]]
    usable = light.lit_bands()[:, 0] & np.isfinite(world.mean[:, [world.surface_number(n) for n in names]]).all(axis=1)
    for spectrum in world.stated.signatures.values():
        usable = usable & np.isfinite(spectrum)
    return usable


@dataclass(frozen=True)
class Material:
    """A target, its host and its light, in U truths.

    Attributes
    ----------
    mean : (U or 1, F) its reflectance
    covariance, stretch : (F, F), and (U or 1, F or 1) factor on both sides of it
    fine_texture : (U or 1,) part of it whose texture is finer than the target's part of a pixel
    host : number of its host's class
    beam, sky : (U or 1,) parts of the light in the open that reach it
    error : (K, F) directions of the error of its spectrum; None where nothing is stated
    of_pixels : its covariance was measured on the image, and holds the sensor's noise
    """

    mean: Array
    covariance: Array
    stretch: Array
    fine_texture: Array
    host: int
    beam: Array
    sky: Array
    error: Array | None = None
    of_pixels: bool = False


def target_pixels(view: Retrieved, material: Material, fills: Array) -> tuple[Array, Array, tuple[Array, Array], Array]:
    """Retrieved pixels of which a target fills K parts f (K,), in U truths (3.7-3.12).

    Returns
    -------
    Retrieved reflectance and its noise variance (U or 1, K, F), less the noise in the covariances; D_B / k times the
    root of g_m kappa (3.11) of a pixel of host, and of one full of target, (U or 1, 1, F) each; light on the target
    over that in the open (U, 1, F), (1,) without shade.
    """
    light, classes, number = view.light, view.classes, material.host
    lit, under_sky, factor = light.surface(material.mean, material.beam, material.sky)
    host = classes.means[:, number : number + 1]
    level = light.signal(target_pixel_reflectance(fills, lit, host))  # (3.9), (3.10)
    means = retrieved_reflectance(TwoPanelLine(view.gain, view.offset), level)
    weight = np.sqrt(classes.gain[:, number, None, None] * light.kappa) / view.gain
    adjacency = light.adjacency_slope(host) * weight, light.adjacency_slope(under_sky) * weight
    held = (1.0 - fills[:, None]) ** 2 * view.held_noise[:, number : number + 1]
    if material.of_pixels:
        part = fills**2 + material.fine_texture[:, None] * (fills - fills**2)
        held = held + part[:, :, None] * light.noise_variance(light.signal(lit)) / view.gain**2
    return means, light.noise_variance(level) / view.gain**2 - held, adjacency, factor

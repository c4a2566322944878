"""Separability of two classes: Bhattacharyya distance, and the error of a Gaussian maximum-likelihood classifier.

The error is that of pixels, or predicted from statistics alone, as FASSP uses 3.26-3.33; the distance bounds it.
Features are bands, or principal components of the mixture of the classes (3.21).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from hyperval.data import Array, Index, Mask, statistics_of
from hyperval.errors import UsageError, refusal, refuse
from hyperval.model.fill import fills_of_objects
from hyperval.model.filters import PositiveDefinite, fully_constrained, principal_components
from hyperval.model.intervals import Z95, clopper_pearson, drawn_factors, student_factor
from hyperval.model.radiance import submatrix
from hyperval.model.stated import Origins, Truth, band_correlation
from hyperval.model.world import World, group_by_files, read_world, with_truths
from hyperval.products import Abundance, ClassificationError, PixelDistribution, PredictedProducts
from hyperval.scenario import Scenario, TargetSubject


def bhattacharyya_distance(
    mean_1: npt.ArrayLike, covariance_1: npt.ArrayLike, mean_2: npt.ArrayLike, covariance_2: npt.ArrayLike
) -> float:
    """Distance of two Gaussian classes in the features of (3.21) [1].

    B = (1/8) d^T C^-1 d + (1/2) ln(|C| / sqrt(|C_1| |C_2|)), C = (C_1 + C_2) / 2 (Fukunaga 1990, section 3.4).

    Parameters
    ----------
    mean_1, mean_2 : (F,);  covariance_1, covariance_2 : (F, F)

    Raises
    ------
    UsageError : a covariance that cannot be inverted.
    """
    c1, c2 = np.asarray(covariance_1, dtype=float), np.asarray(covariance_2, dtype=float)
    d = np.asarray(mean_1, dtype=float) - np.asarray(mean_2, dtype=float)
    middle = PositiveDefinite(0.5 * (c1 + c2))
    logs = [np.linalg.slogdet(c)[1] for c in (middle.matrix, c1, c2)]
    for c in (c1, c2):
        PositiveDefinite(c)  # refuses what has no finite determinant
    return float(0.125 * d @ middle.solve(d) + 0.5 * (logs[0] - 0.5 * (logs[1] + logs[2])))


def classification_error(distance: float) -> tuple[float, float, float]:
    """Error of the best classifier of two Gaussian classes, from their distance B (lineage of 3.31-3.33).

    Returns
    -------
    estimate, lower bound, upper bound [1].  The estimate Phi(-sqrt(2 B)) is exact for equal covariances and equal
    priors; the bounds 1/2 - 1/2 sqrt(1 - exp(-2B)) and exp(-B)/2 hold for any classes that are equally likely.
    """
    b = max(distance, 0.0)  # against rounding
    lower, upper = 0.5 - 0.5 * np.sqrt(-np.expm1(-2.0 * b)), 0.5 * np.exp(-b)
    return float(ndtr(-np.sqrt(2.0 * b))), float(lower), float(upper)


@dataclass(frozen=True, eq=False)
class ClassLaw:
    """Mean (F,) and covariance (F, F) of one class, with the degrees of freedom of its tails (inf: normal)."""

    mean: Array
    covariance: Array
    tail_dof: float = np.inf

    def project(self, psi: Array) -> ClassLaw:
        """The law of the features psi x (3.21); a linear map of a t law is one of the same degrees of freedom."""
        return ClassLaw(psi @ self.mean, psi @ self.covariance @ psi.T, self.tail_dof)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """(n, F) pixels."""
        return self.pixels(self.standard_draw(n, rng))

    def standard_draw(self, n: int, rng: np.random.Generator) -> Array:
        """(n, F) pixels of the law of the same tails with mean 0 and covariance I."""
        z = rng.standard_normal((n, self.mean.size))
        if np.isfinite(self.tail_dof):  # a normal over sqrt(chi2/nu), scaled to the same covariance
            z *= np.sqrt((self.tail_dof - 2.0) / rng.chisquare(self.tail_dof, n))[:, None]
        return z

    def pixels(self, standard: Array) -> Array:
        """(n, F) pixels of :meth:`standard_draw`."""
        return np.asarray(self.mean + standard @ np.linalg.cholesky(self.covariance).T)

    def trained(self, n: float, rng: np.random.Generator) -> ClassLaw:
        """The law as estimated from ``n`` independent training pixels, more than there are features.

        >>> law, rng = ClassLaw(np.zeros(2), np.eye(2)), np.random.default_rng(1)
        >>> each = [law.trained(9.0, rng) for _ in range(4000)]
        >>> bool(np.allclose(np.mean([one.covariance for one in each], axis=0), np.eye(2), atol=0.04))  # unbiased
        True
        >>> [round(float(np.var(numbers)), 2) for numbers in zip(*((k.mean[0], k.covariance[0, 0]) for k in each))]
        [0.11, 0.25]
        >>> 1 / 9, 2 / 8  # of a mean, and of a variance with 8 degrees of freedom
        (0.1111111111111111, 0.25)

        Of heavy tails its variances vary more, here by sqrt((2 + 3 kappa)/n) with kappa = 2/(6 - 4).

        >>> heavy = ClassLaw(np.zeros(2), np.eye(2), 6.0)
        >>> bool(0.18 < np.std([heavy.trained(100.0, rng).covariance[0, 0] for _ in range(1000)]) < 0.26)
        True
        """
        if np.isfinite(self.tail_dof) and n < 5000:  # with fewer pixels, outliers dominate
            drawn = statistics_of(self.draw(round(n), rng))
            return ClassLaw(drawn.mean, drawn.covariance)
        root = np.linalg.cholesky(self.covariance)
        mean = self.mean + root @ rng.standard_normal(self.mean.size) / np.sqrt(n)
        factor = root @ drawn_factors(1, np.full(self.mean.size, n - 1.0), rng)[0]
        return ClassLaw(mean, factor @ factor.T)


def gaussian_classes(laws: Sequence[ClassLaw], pixels: npt.ArrayLike) -> Index:
    """Index (n,) of the class of greatest normal likelihood of each pixel (n, F), all equally likely beforehand.

    ln f = -1/2 (x - m)^T C^-1 (x - m) - 1/2 ln |C| (Fukunaga 1990, section 4.1).

    Raises
    ------
    UsageError : a covariance that cannot be inverted.
    """
    x, likelihoods = np.asarray(pixels, dtype=float), []
    for law in laws:
        z = PositiveDefinite(law.covariance).whiten((x - law.mean).T)
        likelihoods.append(-0.5 * (np.sum(z**2, axis=0) + np.linalg.slogdet(law.covariance)[1]))
    return np.asarray(np.argmax(likelihoods, axis=0))


_TRAININGS, _TESTED = 24, 1000  # drawn training sets of few pixels; pixels of a class that each is tested on


def predicted_error(
    laws: Sequence[ClassLaw], rng: np.random.Generator, draws: int = 20_000, trained: Sequence[float] = ()
) -> ClassificationError:
    """Error of a classifier on pixels drawn from the laws; with distance, estimate and bounds.

    The interval is that of the draws and of the training.

    Parameters
    ----------
    trained : independent pixels of each class that the classifier is trained on; none: it has the true laws

    >>> near, far = ([ClassLaw(np.full(4, mean), np.eye(4)) for mean in (0.0, away)] for away in (0.8, 9.0))
    >>> known, few = (predicted_error(near, np.random.default_rng(1), 5000, n) for n in ((), (9.0, 9.0)))
    >>> [round(e.error, 1) for e in (known, few)], few.upper - few.lower > 0.1, few.distance > known.distance
    ([0.2, 0.3], True, True)
    >>> predicted_error(far, np.random.default_rng(1), 5000, (1.0, 1.0)).lower  # one pixel counts as six
    0.0
    """
    pixels = [law.draw(draws, rng) for law in laws]

    def share(fitted: Sequence[ClassLaw], count: int) -> float:
        """Share of pixels assigned to another class."""
        return float(np.mean([gaussian_classes(fitted, sample[:count]) != i for i, sample in enumerate(pixels)]))

    error, n = share(laws, draws), draws * len(laws)
    lower, upper = clopper_pearson(error * n, n)
    exact = with_distances(ClassificationError(error, float(lower), float(upper), n), laws)
    if not trained:
        return exact
    fewest = laws[0].mean.size + 2.0  # fewer give a singular covariance
    fits = [[law.trained(max(m, fewest), rng) for law, m in zip(laws, trained, strict=True)] for _ in range(_TRAININGS)]
    excess = np.array([share(fitted, _TESTED) for fitted in fits]) - share(laws, _TESTED)
    error, half_width = error + float(excess.mean()), Z95 * float(excess.std(ddof=1))
    ends = max(lower + excess.mean() - half_width, 0.0), min(upper + excess.mean() + half_width, 1.0)
    distance = float(np.mean([with_distances(exact, fitted).distance for fitted in fits]))
    return replace(exact, error=error, lower=float(ends[0]), upper=float(ends[1]), distance=distance)


def measured_error(laws: Sequence[ClassLaw], pixels: Sequence[Array], blocks: Sequence[Index]) -> ClassificationError:
    """Error of the classifier trained on ``laws`` on pixels that are not in the training.

    Errors of neighbours are correlated, so the binomial interval is that of as many independent pixels as give the
    spread of the error from block to block (Kish 1965, section 5.4); without any error all pixels count.  The excess of
    few blocks over independent pixels is widened by (t/1.96)^2 with Satterthwaite's degrees of freedom (JCGM 100:2008,
    G.4).

    Parameters
    ----------
    pixels : by class, (n, F)
    blocks : by class, (n,) the block of the image that each pixel lies in

    >>> rng, block, held = np.random.default_rng(1), np.repeat(np.arange(4), 50), []
    >>> laws = [ClassLaw(np.array([centre]), np.eye(1)) for centre in (0.0, 2.0)]
    >>> for _ in range(400):  # of four blocks, with 0.3 of the variance in common
    ...     shared, own = rng.standard_normal((2, 4, 1)), rng.standard_normal((2, 200, 1))
    ...     seen = [law.mean + 0.3**0.5 * x[block] + 0.7**0.5 * y for law, x, y in zip(laws, shared, own)]
    ...     found = measured_error(laws, seen, [block, block])
    ...     held.append(found.lower < 0.15866 < found.upper)
    >>> float(np.mean(held)) > 0.93
    True
    """
    errors, variances, freedoms, n = [], [], [], sum(map(len, pixels))
    for i, (x, block) in enumerate(zip(pixels, blocks, strict=True)):
        wrong = gaussian_classes(laws, x) != i
        rate = float(np.mean(wrong))
        _, index = np.unique(block, return_inverse=True)
        excess = np.bincount(index, wrong) - rate * np.bincount(index)
        correction = excess.size / (excess.size - 1.0) if excess.size > 1 else 1.0
        between = correction * float(excess @ excess) / wrong.size**2
        errors.append(rate)
        variances.append(max(between, rate * (1.0 - rate) / wrong.size))
        freedoms.append(max(excess.size - 1.0, 1.0))
    error, total, effective = float(np.mean(errors)), float(np.sum(variances)), float(n)
    if total > 0 and 0 < error < 1:
        independent = sum(q * (1.0 - q) / len(x) for q, x in zip(errors, pixels, strict=True))
        student = student_factor(total**2 / np.sum(np.square(variances) / freedoms)) ** 2
        variance = (independent + (total - independent) * student) / len(errors) ** 2
        effective = float(np.clip(error * (1.0 - error) / variance, 1.0, n))
    lower, upper = clopper_pearson(error * effective, effective)
    return with_distances(ClassificationError(error, float(lower), float(upper), n, effective), laws)


def with_distances(error: ClassificationError, laws: Sequence[ClassLaw]) -> ClassificationError:
    """The same with the least distance of two classes, and estimate and bounds of the best error from distances.

    Of M equally likely classes a pair makes up 2/M: the estimate is the sum of (2/M) Phi(-sqrt(2 B)) over pairs
    (Whitsitt & Landgrebe 1977; Kerekes & Landgrebe 1989), the upper bound that of (1/M) exp(-B), the lower bound
    the greatest single one. The bounds hold for normal classes.
    """
    refuse(len(laws) < 2, "features.classes")
    pairs = [bhattacharyya_distance(a.mean, a.covariance, b.mean, b.covariance) for a, b in combinations(laws, 2)]
    weight = 2.0 / len(laws)
    estimates = [classification_error(distance) for distance in pairs]
    return replace(
        error,
        distance=min(pairs),
        approximation=weight * sum(estimate for estimate, _, _ in estimates),
        bound_lower=weight * max(low for _, low, _ in estimates),
        bound_upper=min(weight * sum(high for _, _, high in estimates), 1.0 - 1.0 / len(laws)),
    )


def feature_bands(centre_nm: Array, usable: Mask, wavelengths_nm: Sequence[float]) -> Index:
    """Indices of the usable bands nearest to some wavelengths, or of all usable bands where none is named.

    Raises
    ------
    UsageError : no usable band, or two wavelengths that share the nearest one.
    """
    indices = np.flatnonzero(usable)
    refuse(indices.size == 0, "features.none")
    if not wavelengths_nm:
        return indices
    nearest = indices[np.abs(centre_nm[indices][None, :] - np.asarray(wavelengths_nm)[:, None]).argmin(axis=1)]
    bands, count = np.unique(nearest, return_counts=True)
    if np.any(count > 1):
        raise refusal("features.band", "classification.features.bands_nm", nm=centre_nm[bands[count > 1][0]])
    return bands


def class_features(laws: Sequence[ClassLaw], components: int | None) -> Array:
    """Psi (K, F): the leading components of the mixture of equally likely classes, or the identity.

    The covariance of the mixture is the mean of the classes' covariances and the spread of their means.
    """
    size = laws[0].mean.size
    if components is None:
        return np.eye(size)
    between = np.cov(np.transpose([law.mean for law in laws]), bias=True).reshape(size, size)
    return principal_components(np.mean([law.covariance for law in laws], axis=0) + between, components)


_POOL = 4000  # background and target pixels drawn once and then resampled
_SMALLEST = 1e-10  # of the mean variance, added where a covariance has less than full rank


@dataclass(frozen=True, eq=False)
class UnmixedSubject:
    """Inputs of the prediction of one subject's area.

    Attributes
    ----------
    subject : its name in the products
    population, scenario_target : its population and target in the scenario
    spectrum : (B,) the target's endmember [1]
    relative_uncertainty, correlation_nm : of it, as the spectrum of the target
    endmembers : origin of the spectrum, in the name of the method
    objects : number of objects averaged
    nominal_m2 : their area in the truth
    ring : pixels behind the local background
    """

    subject: str
    population: str
    scenario_target: str
    spectrum: Array
    relative_uncertainty: float
    correlation_nm: float | None
    endmembers: str
    objects: int
    nominal_m2: float
    ring: int


@dataclass(frozen=True, eq=False)
class UnmixedAreas:
    """Areas by (subject, method), and the inputs of the prediction of each subject.

    ``bands`` (B,) were used; ``noise``: method -> (F, F) weights of the fit, None for equal ones.
    """

    areas: Mapping[tuple[str, str], Abundance]
    subjects: tuple[UnmixedSubject, ...]
    bands: Mask
    noise: Mapping[str, PositiveDefinite | None]
    pixel_area_m2: float


def unmixing_method(method: str, endmembers: str) -> str:
    """The method with the origin of its endmembers: "fcls field"."""
    return f"{method} {endmembers}".strip()


def predicted_areas(
    scenario: Scenario, origins: Origins, truth: Truth, prediction: PredictedProducts, unmixed: UnmixedAreas,
    draws: int = 400, seed: int = 0,
) -> dict[tuple[str, str], Abundance]:  # fmt: skip
    """Mean and spread of the area that unmixing would find, by (subject, method).

    A pixel is f t + (1 - f) b (3.10): fills of a whole object from the geometry, background pixels b by the
    laws of the host class as predicted, target pixels t about the endmember, whose error is common to all
    pixels of an object. The background endmember is the mean of as many pixels as lie around the object.
    Background pixels are drawn independently. Subjects that are not in the scenario are left out; so are all
    in a scenario with an atmosphere, where noise would have to be drawn for each fill.

    Parameters
    ----------
    truth : dotted path -> true value; the endmembers stay as stated
    prediction : of the same truth
    """
    if scenario.atmosphere is not None:
        return {}
    world = group_by_files(with_truths(read_world(scenario, origins), [truth]))[0][1]
    index = np.flatnonzero(unmixed.bands)
    populations = {(name, p.name): p for name, p in world.populations[0][0]}
    areas = {}
    for number, item in enumerate(unmixed.subjects):
        population = populations.get((item.scenario_target, item.population))
        if population is None:
            continue
        rng = np.random.default_rng([seed, number])
        pixels, endmembers, absent = _drawn_objects(population, item, prediction, world, index, draws, rng)
        for method, factor in unmixed.noise.items():
            abundance = fully_constrained(pixels, endmembers[:, None], factor)[..., 0]
            area = np.where(absent, 0.0, abundance).sum(axis=1) * unmixed.pixel_area_m2
            spread = float(area.std(ddof=1)) / np.sqrt(item.objects)
            areas[item.subject, unmixing_method(method, item.endmembers)] = Abundance(
                float(area.mean()), float(spread), round((~absent).sum(axis=1).mean()), item.nominal_m2
            )
    return areas


def _drawn_objects(
    population: TargetSubject,
    item: UnmixedSubject,
    prediction: PredictedProducts,
    world: World,
    index: Index,
    draws: int,
    rng: np.random.Generator,
) -> tuple[Array, Array, Mask]:
    """Pixels (draws, n, F) of drawn objects, the endmembers (draws, 2, F) of each, and the mask (draws, n) of absent
    pixels, behind the last of an object that has fewer.
    """
    stated = world.stated
    target = next(t for t in stated.targets if t.name == item.scenario_target)
    number = world.surface_number(target.name)
    moved = world.mean[0, number] - stated.mean[number]  # departure of the true reflectance from the endmember
    host = prediction.reflectance[target.host]
    measured = prediction.distribution.get(target.host, PixelDistribution())
    law = ClassLaw(host.mean[index], _full_rank(submatrix(np.asarray(host.pixel_covariance), index)), measured.tail_dof)
    laws = [
        (part, ClassLaw((host.mean + offset)[index], _full_rank(submatrix(covariance, index)), dof))
        for part, offset, covariance, dof in measured.clusters
    ]
    spectrum = item.spectrum[index]
    spread = ClassLaw(np.zeros(index.size), _full_rank(submatrix(stated.surfaces[target.name].covariance, index)))
    fills = fills_of_objects(population.fill)
    drawn = fills[rng.integers(fills.shape[0], size=draws)]
    f = np.nan_to_num(drawn)[..., None]
    background = _host_pixels(laws or [(1.0, law)], f.shape[:2], rng)
    material = _from_pool(spread, f.shape[:2], rng)
    material += spectrum + moved[index]
    if item.relative_uncertainty > 0:
        sd = item.relative_uncertainty * spectrum
        shape = band_correlation(stated.axis.select(index), item.correlation_nm)
        material += ClassLaw(np.zeros(index.size), _full_rank(np.outer(sd, sd) * shape)).draw(draws, rng)[:, None]
    backgrounds = law.mean + (law.draw(draws, rng) - law.mean) / np.sqrt(max(item.ring, 1))
    endmembers = np.stack([np.broadcast_to(spectrum, backgrounds.shape), backgrounds], axis=1)
    material -= background
    material *= f
    material += background
    return material, endmembers, np.isnan(drawn)


def _host_pixels(laws: Sequence[tuple[float, ClassLaw]], shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """(*shape, F) pixels of a class that is a mixture of laws."""
    if len(laws) == 1:
        return _from_pool(laws[0][1], shape, rng)
    which = rng.choice(len(laws), shape, p=[part for part, _ in laws])
    pixels = np.empty((*shape, laws[0][1].mean.size))
    for k, (_, law) in enumerate(laws):
        selected = which == k
        pixels[selected] = _from_pool(law, (int(selected.sum()),), rng)
    return pixels


def _from_pool(law: ClassLaw, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """(*shape, F) pixels resampled from a pool that is drawn once; unused ones of the pool are not computed."""
    pool, index = law.standard_draw(_POOL, rng), rng.integers(_POOL, size=shape)
    used, position = np.unique(index, return_inverse=True)
    return law.pixels(pool[used])[position.reshape(shape)]


def _full_rank(covariance: Array) -> Array:
    """The covariance with a negligible spread added in every direction, so that it has a Cholesky factor."""
    mean = float(np.trace(covariance)) / covariance.shape[0]
    return np.asarray(covariance + max(_SMALLEST * mean, 1e-18) * np.eye(covariance.shape[0]))


def predicted_classification(
    prediction: PredictedProducts, sets: Sequence[Sequence[str]], features: Sequence[Any], quantity: str,
    seed: int = 0, trained: Mapping[str, float] | None = None,
) -> dict[tuple[str, str], ClassificationError]:  # fmt: skip
    """Errors by (classes, features), for pixels of the predicted distributions, tails included.

    ``features`` have a name, the method in the table, ``bands_nm`` of the bands (empty: all) and ``pca``, the number of
    principal components (None: bands).  The classifier is the same in radiance and in reflectance, as it is invariant
    under a line in each band; ``quantity`` is that of the image.  Sets with a class that the prediction lacks are left
    out.  ``trained`` : independent pixels of each class that the classifier is trained on; None: it has the true laws.

    Raises
    ------
    UsageError : a class without spread in some band.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from hyperval.products import SpectralEstimate
    >>> from hyperval.spectra import SpectralAxis
    >>> axis, one = SpectralAxis(np.arange(1.0, 5.0), 1.0), np.eye(4)  # bands by number, all of which count
    >>> laws = {name: SpectralEstimate(np.full(4, mean), one, one) for name, mean in (("a", 0.0), ("b", 0.8))}
    >>> every = SimpleNamespace(name="all", bands_nm=[], pca=None)
    >>> asked = PredictedProducts(axis, reflectance=laws), [("a", "b")], [every], "counts"
    >>> both = (predicted_classification(*asked, trained=n) for n in (None, {"a": 9.0, "b": 9.0}))
    >>> [round(errors["a / b", "all"].error, 1) for errors in both]
    [0.2, 0.3]
    """
    axis = prediction.axis
    spectra = prediction.radiance if quantity == "radiance" else prediction.reflectance
    usable = axis.clear
    errors = {}
    for chosen in sets:
        if not all(name in spectra for name in chosen):
            continue
        for choice in features:
            bands = feature_bands(axis.centre_nm, usable, choice.bands_nm)
            laws = []
            for name in chosen:
                estimate = spectra[name]
                if estimate.pixel_covariance is None or not np.all(np.diag(estimate.pixel_covariance)[bands] > 0):
                    raise UsageError(f"classification: the prediction of {name!r} has no spread in some band")
                tail = prediction.distribution.get(name, PixelDistribution()).tail_dof
                laws.append(ClassLaw(estimate.mean[bands], submatrix(estimate.pixel_covariance, bands), tail))
            psi = class_features(laws, choice.pca)
            rng = np.random.default_rng([seed, bands.size])
            counts = [] if trained is None else [trained[name] for name in chosen]
            projected = [law.project(psi) for law in laws]
            errors[" / ".join(chosen), choice.name] = predicted_error(projected, rng, trained=counts)
    return errors

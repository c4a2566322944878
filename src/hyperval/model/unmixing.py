"""Predicted areas by unmixing, and predicted errors of a Gaussian maximum-likelihood classifier."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.model.classification import ClassLaw, class_features, feature_bands, predicted_error
from hyperval.model.fill import fills_of_objects
from hyperval.model.filters import PositiveDefinite, fully_constrained
from hyperval.model.surfaces import correlation, cut
from hyperval.model.world import Origins, Truth, World, read, settled, with_truths
from hyperval.products import Abundance, ClassificationError, PixelDistribution, PredictedProducts
from hyperval.scenario import Scenario, Target, TargetSubject
from hyperval.spectra.axis import SpectralAxis, in_window

Array = npt.NDArray[np.float64]

_POOL = 4000  # background and target pixels drawn once and taken from at random
_SMALLEST = 1e-10  # of the mean variance, added where a covariance has less than full rank


@dataclass(frozen=True, eq=False)
class UnmixedSubject:
    """What a prediction of one subject's area must know.

    Attributes
    ----------
    subject : its name in the products
    population, scenario_target : the population and the target of the scenario that stand for it
    spectrum : (B,) the target's endmember [1]
    relative_uncertainty, correlation_nm : of it, as a picture of the target
    endmembers : where the spectrum is from, as the method tells it
    objects : number of objects that the area is the mean of
    nominal_m2 : their area as the truth states it
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


def labelled(method: str, endmembers: str) -> str:
    """The method with the origin of its endmembers: "fcls field"."""
    return f"{method} {endmembers}".strip()


def predicted_areas(
    scenario: Scenario,
    origins: Origins,
    truth: Truth,
    prediction: PredictedProducts,
    subjects: Iterable[UnmixedSubject],
    bands: npt.NDArray[np.bool_],
    covariances: Mapping[str, Array | None],
    pixel_area_m2: float,
    *,
    draws: int = 400,
    seed: int = 0,
) -> dict[tuple[str, str], Abundance]:
    """Mean and spread of the area that unmixing would find, by (subject, method).

    A pixel is f t + (1 - f) b (3.10): fills of a whole object from the geometry, background pixels b by the
    laws of the host class as predicted, target pixels t about the endmember, whose error is common to all
    pixels of an object. The background endmember is the mean of as many pixels as lie around the object.
    Background pixels are drawn independent of each other. Subjects that the scenario does not hold are left
    out; so are all where light is computed (a scenario with an atmosphere), since noise would have to be
    drawn for each fill.

    Parameters
    ----------
    truth : dotted path -> what truly stands there; the endmembers stay what they are
    prediction : of the same truth
    covariances : method -> (F, F) weights of the fit, None for equal ones
    """
    if scenario.atmosphere is not None:
        return {}
    world = settled(with_truths(read(scenario, origins), [truth]))[0][1]
    index = np.flatnonzero(bands)
    noise = {name: None if c is None else PositiveDefinite(c) for name, c in covariances.items()}
    populations = {(t.name, p.name): (t, p) for t in world.targets_at(0) for p in t.populations}
    out = {}
    for number, item in enumerate(subjects):
        population = populations.get((item.scenario_target, item.population))
        if population is None:
            continue
        rng = np.random.default_rng([seed, number])
        pixels, endmembers = _objects(*population, item, prediction, world, index, draws, rng)
        for method, factor in noise.items():
            abundance = fully_constrained(pixels, endmembers[:, None], factor)[..., 0]
            area = abundance.sum(axis=1) * pixel_area_m2
            spread = float(area.std(ddof=1)) / np.sqrt(item.objects)
            out[item.subject, labelled(method, item.endmembers)] = Abundance(
                float(area.mean()), float(spread), pixels.shape[1], item.nominal_m2
            )
    return out


def _objects(
    target: Target,
    population: TargetSubject,
    item: UnmixedSubject,
    prediction: PredictedProducts,
    world: World,
    index: npt.NDArray[np.intp],
    draws: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Pixels (draws, n, F) of drawn objects and the endmembers (draws, 2, F) that each is unmixed with."""
    number, stated = world.surface(target.name), world.stated
    moved = world.mean[0, number] - stated.mean[number]  # what the reflectance truly differs from its endmember
    host = prediction.reflectance[target.host]
    known = prediction.distribution.get(target.host, PixelDistribution())
    law = ClassLaw(host.mean[index], _full_rank(cut(host.pixel_covariance, index)), known.tail_dof)
    laws = [
        (part, ClassLaw((host.mean + offset)[index], _full_rank(cut(covariance, index)), dof))
        for part, offset, covariance, dof in known.clusters
    ]
    spectrum = item.spectrum[index]
    spread = ClassLaw(np.zeros(index.size), _full_rank(cut(stated.surfaces[target.name].covariance, index)))
    fills = fills_of_objects(population.fill)
    f = fills[rng.integers(fills.shape[0], size=draws)][..., None]
    shape = f.shape[:2]
    background = _of_host(laws or [(1.0, law)], shape, rng)
    material = _from_pool(spread, shape, rng)
    material += spectrum + moved[index]
    if item.relative_uncertainty > 0:
        material += _errors(item, stated.axis, index, draws, rng)[:, None]
    around = law.mean + (law.draw(draws, rng) - law.mean) / np.sqrt(max(item.ring, 1))
    endmembers = np.stack([np.broadcast_to(spectrum, around.shape), around], axis=1)
    material -= background
    material *= f
    material += background
    return material, endmembers


def _of_host(laws: Sequence[tuple[float, ClassLaw]], shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """(*shape, F) pixels of a class that is made of some laws."""
    if len(laws) == 1:
        return _from_pool(laws[0][1], shape, rng)
    which = rng.choice(len(laws), shape, p=[part for part, _ in laws])
    out = np.empty((*shape, laws[0][1].mean.size))
    for k, (_, law) in enumerate(laws):
        here = which == k
        out[here] = _from_pool(law, (int(here.sum()),), rng)
    return out


def _from_pool(law: ClassLaw, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """(*shape, F) pixels, each one of a pool that is drawn once; those of the pool that none is are not made."""
    pool, at = law.standard_draw(_POOL, rng), rng.integers(_POOL, size=shape)
    some, place = np.unique(at, return_inverse=True)
    return law.pixels(pool[some])[place.reshape(shape)]


def _errors(
    item: UnmixedSubject, axis: SpectralAxis, index: npt.NDArray[np.intp], draws: int, rng: np.random.Generator
) -> Array:
    """(draws, F) error of the endmember as a picture of the target."""
    sd = item.relative_uncertainty * item.spectrum[index]
    shape = correlation(axis, item.correlation_nm)[np.ix_(index, index)]
    return ClassLaw(np.zeros(index.size), _full_rank(np.outer(sd, sd) * shape)).draw(draws, rng)


def _full_rank(covariance: Array) -> Array:
    """With a spread in every direction, too small to be seen, so that it has a Cholesky factor."""
    mean = float(np.trace(covariance)) / covariance.shape[0]
    return np.asarray(covariance + max(_SMALLEST * mean, 1e-18) * np.eye(covariance.shape[0]))


class FeatureChoice(Protocol):
    """Bands or components under a name."""

    @property
    def name(self) -> str:
        """Stands in the table as the method."""

    @property
    def bands_nm(self) -> Sequence[float]:
        """Wavelengths of the bands; empty: all."""

    @property
    def pca(self) -> int | None:
        """Principal components; None: bands."""


def predicted_classification(
    prediction: PredictedProducts,
    sets: Sequence[Sequence[str]],
    features: Sequence[FeatureChoice],
    quantity: str,
    seed: int = 0,
) -> dict[tuple[str, str], ClassificationError]:
    """Errors by (classes, features), for pixels as the prediction says they are, tails included.

    The classifier is the same in radiance and in reflectance, as a line through each band leaves it as it is;
    ``quantity`` is that of the image.  Sets with a class that the prediction lacks are left out.

    Raises
    ------
    UsageError : a class without spread, which a Gaussian classifier cannot take.
    """
    axis = prediction.axis
    spectra = getattr(prediction, quantity)
    usable = in_window(axis.centre_nm) & axis.good
    out = {}
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
                known = prediction.distribution.get(name)
                tail = np.inf if known is None else known.tail_dof
                laws.append(ClassLaw(estimate.mean[bands], cut(estimate.pixel_covariance, bands), tail))
            psi = class_features(laws, choice.pca)
            rng = np.random.default_rng([seed, bands.size])
            out[" / ".join(chosen), choice.name] = predicted_error([law.project(psi) for law in laws], rng)
    return out

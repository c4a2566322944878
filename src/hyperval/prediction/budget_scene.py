"""Uncertain inputs of the scene: field spectra, fills, area fractions, statistics from finite samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.budget_input import BudgetInput, Given, scalar_input, spectral_input
from hyperval.prediction.departure import Departure, StatisticsDeparture
from hyperval.prediction.field_spectra import spectrum_error_sd
from hyperval.prediction.fills import fill_distribution
from hyperval.prediction.forms import covariance_directions, directions, value_at
from hyperval.scenario_uncertainty import NamedSpread, SampledStatistics, SpectrumUncertainty

Array = npt.NDArray[np.float64]


def field_spectrum_of(subject: str) -> str:
    """Name of the input that is the error of a subject's field spectrum."""
    return f"field spectrum of {subject}"


def scene_inputs(given: Given, shapes: bool = True) -> list[BudgetInput]:
    """Surfaces, then fills and fractions, then what sampling leaves open."""
    u = given.scenario.uncertainty
    found = spectrum_inputs(given) if shapes else []
    found += [_fill(item, given) for item in u.fills]
    found += [_fraction(item, given) for item in u.fractions]
    for sampled in u.sampled_statistics:
        found += _sampled(sampled, given)
    return found


def spectrum_inputs(given: Given) -> list[BudgetInput]:
    """Errors of field spectra, as stated or as replicate spectra say of their own mean."""
    found: list[BudgetInput] = []
    seen: dict[str, int] = {}
    for item in given.scenario.uncertainty.field_spectra:
        seen[item.subject] = seen.get(item.subject, 0) + 1
        found.append(_field_spectrum(item, seen[item.subject], given))
    for name, surface in given.surfaces.items():
        if name not in seen and surface.mean_error is not None:
            found.append(_replicates(name, surface.mean_error))
    return found


def _field_spectrum(item: SpectrumUncertainty, number: int, given: Given) -> BudgetInput:
    surface = given.surfaces[item.subject]
    rows = directions(spectrum_error_sd(item, surface, given.axis), item, given.axis, given.sensor)
    mean = np.nan_to_num(surface.mean)
    relative = np.divide(rows, mean, out=np.zeros_like(rows), where=mean > 0)

    def at(c: Array) -> Departure:
        change = c @ rows if item.distribution != "log-normal" else mean * np.expm1(c @ relative)
        return Departure(spectra={item.subject: np.maximum(change, -mean)})  # no reflectance below 0

    name = field_spectrum_of(item.subject) + ("" if number == 1 else f" ({number})")
    return replace(spectral_input(name, "surface", rows, item, at), subject=item.subject)


def _replicates(name: str, covariance: Array) -> BudgetInput:
    rows = covariance_directions(np.nan_to_num(covariance))

    def at(c: Array) -> Departure:
        return Departure(spectra={name: c @ rows})

    def draw(rng: np.random.Generator) -> Departure:
        return at(rng.standard_normal((rows.shape[0],)))

    words = "as between replicate spectra"
    title, k = field_spectrum_of(name), rows.shape[0]
    return BudgetInput(title, "surface", at, draw, "normal", words, k, subject=name)


def _fill(item: NamedSpread, given: Given) -> BudgetInput:
    fills = {}
    for t in given.scenario.scene.targets:
        for p in t.populations:
            if item.subject in (t.name, p.name):
                fills[p.name] = fill_distribution(p.fill).mean

    def at(z: float) -> Departure:
        moved = {name: float(np.clip(value_at(f, item.absolute, z), 0.0, 1.0)) - f for name, f in fills.items()}
        return Departure(fill=moved)

    return scalar_input(f"fill of {item.subject}", "scene", item.absolute, at)


def _fraction(item: NamedSpread, given: Given) -> BudgetInput:
    classes = given.scenario.scene.classes
    stated = {c.name: c.fraction for c in classes}
    own = stated[item.subject]
    if len(classes) < 2 or own >= 1.0:
        raise UsageError(f"uncertainty: fractions: {item.subject!r} is the only class with an area")

    def at(z: float) -> Departure:
        return Departure(fractions={item.subject: value_at(own, item.absolute, z) - own})

    return scalar_input(f"area fraction of {item.subject}", "scene", item.absolute, at)


def _sampled(item: SampledStatistics, given: Given) -> list[BudgetInput]:
    """Mean and covariance that were estimated from n independent normal samples.

    The mean is normal with covariance S / n.  The truth behind S is an inverse Wishart draw,
    Sigma^-1 ~ W(S^-1 / (n - 1), nu).  With nu = n - B the separation d^T Sigma^-1 d of a matched filter is
    distributed as its pivot says, (n - 1) d^T Sigma^-1 d / d^T S^-1 d ~ chi-square(n - B) (Muirhead, Aspects of
    Multivariate Statistical Theory, 1982, theorem 3.2.12).  Below n = 2 B + 2 the covariance moves by one factor.
    """
    surface = given.surfaces[item.subject]
    n = item.effective_n or surface.n
    if n is None:
        raise UsageError(
            f"uncertainty: sampled_statistics of {item.subject!r}: its source does not say how many samples",
            mend="give effective_n",
        )
    found = []
    covariance, words = surface.covariance, f"sampling of {n:.4g} independent samples"
    if item.mean:
        rows = covariance_directions(covariance / n)

        def mean_at(c: Array) -> Departure:
            return Departure(statistics={item.subject: StatisticsDeparture(c @ rows)})

        def mean_draw(rng: np.random.Generator) -> Departure:
            return mean_at(rng.standard_normal((rows.shape[0],)))

        name = f"sampled mean of {item.subject}"
        if rows.shape[0]:
            found.append(BudgetInput(name, "sampling", mean_at, mean_draw, "normal", words, rows.shape[0]))

    def spread_at(c: Array) -> Departure:
        # The variance of any one score: s^2 of n - 1 degrees of freedom.
        return Departure(
            statistics={item.subject: StatisticsDeparture(factor=float(np.exp(c[0] * np.sqrt(2.0 / (n - 1.0)))))}
        )

    def spread_draw(rng: np.random.Generator) -> Departure:
        return Departure(statistics={item.subject: drawn_covariance(covariance, n, rng)})

    name = f"sampled covariance of {item.subject}"
    found.append(BudgetInput(name, "sampling", spread_at, spread_draw, "inverse Wishart", words))
    return found


def drawn_covariance(covariance: Array, n: float, rng: np.random.Generator) -> StatisticsDeparture:
    """A truth behind a covariance (B, B) that was estimated from ``n`` samples (see :func:`_sampled`)."""
    live = np.diag(covariance) > 0
    bands = int(live.sum())
    nu = round(n - bands)
    if nu < bands + 2:
        return StatisticsDeparture(factor=float((n - 1.0) / rng.chisquare(n - 1.0)))
    sd = np.sqrt(np.diag(covariance)[live])
    root = np.linalg.cholesky(covariance[np.ix_(live, live)] / np.outer(sd, sd) + 1e-12 * np.eye(bands))
    # Bartlett: A A^T ~ W(I, nu) with A lower triangular; Sigma = (n - 1) R A^-T A^-1 R^T has the law asked for.
    a = np.tril(rng.standard_normal((bands, bands)), -1)
    a[np.diag_indices(bands)] = np.sqrt(rng.chisquare(nu - np.arange(bands)))
    half = np.linalg.solve(a, (sd[:, None] * root).T).T  # R A^-T up to the order of factors
    out = np.zeros_like(covariance)
    out[np.ix_(live, live)] = (n - 1.0) * half @ half.T
    return StatisticsDeparture(covariance=out)

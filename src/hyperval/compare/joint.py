"""All subjects of one sensor together: what they have in common over wavelength, and what would decide a criterion.

The difference d(s, q) = ln(predicted / measured) of subject s in a piece q of the spectrum is x(q) + e(s, q): x is
what all share, of the sensor or of the model, and may be anything.  The errors e have the covariance C of all stated
sources at once: one of the model's inputs or of the calibration is the same draw for every subject and piece, one of
the atmosphere for every subject of a day, one of the field readings for every piece of its own subject.  So an input
that is off shows in all pieces together, and x is what it cannot explain.  In the logarithm the size of a relative
error does not depend on the difference itself, which would pull x down (Peelle's puzzle; Chiba & Smith 1991,
ANL/NDM-121).

Errors of smooth sources leave next to nothing between neighbouring pieces, where real spectra differ by some tenths of
a percent.  C alone would read inputs from these; so each e has an error of its own besides, of the standard deviation
t and the correlation exp(-distance / length) over wavelength that the differences between subjects show: their
posterior by the restricted likelihood (Harville, J. Am. Stat. Assoc. 72, 320-338, 1977) with a half-Cauchy prior of t
(Gelman, Bayesian Anal. 1, 515-534, 2006), over which x is averaged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
import scipy

from hyperval.compare.rows import row
from hyperval.compare.spectra import comparable_bands, regions, shares
from hyperval.data import Array, Index, Mask
from hyperval.metrics import Kind, metric_of
from hyperval.model.intervals import Z95
from hyperval.products import Products, SpectralEstimate
from hyperval.results import Result
from hyperval.spectra.axis import in_window

TOGETHER = ALL_SUBJECTS, UNSEEN_SUBJECTS = "all subjects", "unseen subjects"
REGIONS_NM = ((400, 450), (450, 700), (700, 1000), (1200, 1760), (2050, 2400))
# The bands between two of these have one gain of the sensor; every region is made of such pieces.
EDGES_NM = (
    400, 430, *range(450, 690, 30), *range(700, 1000, 30), *range(1000, 1701, 100), 1760, 2050, *range(2200, 2501, 100),
)  # fmt: skip
PIECES_NM = tuple(pairwise(EDGES_NM))
OWN = "field spectrum"  # each subject's own draw
CALIBRATION, REST = "calibration", "noise and the rest"
UNSTATED = "differences that no source states"
_FEWEST_BANDS = 2
_APART = 0.05  # of the brightest: subjects alike tell no gain from an offset
# Standard deviations of what no source states, from what interpolation and rounding of the model leave; the median of
# its prior, as AVIRIS-NG's spectra differ from band to band.
UNSTATED_RATIOS, USUAL_RATIO = np.geomspace(1e-4, 0.1, 13), 0.01
UNSTATED_NM = (1.0, 30.0, 100.0, 300.0)  # how far they are correlated: not at all, to as far as field spectra
_LEAST_LEFT = 0.1  # hardly anybody knows an input ten times better


class InCommon(NamedTuple):
    """What subjects have in common, with what no source states averaged over.

    Attributes
    ----------
    value, covariance : (k,), (k, k)
    weights : (k, N) that make the value of the differences
    errors : (N,) C^-1 times what is left of the differences: errors of one source are its covariance times these
    unstated : standard deviation of what no source states: median and 95 % limits
    """

    value: Array
    covariance: Array
    weights: Array
    errors: Array
    unstated: Array


@dataclass(frozen=True)
class JointDifference:
    """N differences ln(predicted / measured), each a mean over bands of one subject.

    Attributes
    ----------
    subject, piece : (N,) of which subject and which bands it is, as numbers
    difference : (N,)
    inverse_level : (N,) mean of 1 / predicted: the measured noise, which is in the difference, would bias an offset
    bands : (N,) how many there are
    sources : name -> (N, N) error covariance from one source, independent of the others
    """

    subject: Index
    piece: Index
    difference: Array
    inverse_level: Array
    bands: Array
    sources: Mapping[str, Array]

    @cached_property
    def covariance(self) -> Array:
        """(N, N) of all stated sources."""
        return np.asarray(sum(self.sources.values()))

    @cached_property
    def of_piece(self) -> Array:
        """(N, Q) 1 where a difference is of a piece, in the order of their numbers."""
        return np.asarray(self.piece[:, None] == np.unique(self.piece), dtype=float)

    def in_common(self, columns: Array) -> InCommon:
        """Coefficients of ``columns`` (N, k) that all subjects share."""
        fits, middle = [], np.mean(PIECES_NM, axis=1)[self.piece]
        apart = np.where(self.subject[:, None] == self.subject, np.abs(middle[:, None] - middle), np.inf)
        for unstated, length in product(UNSTATED_RATIOS, UNSTATED_NM):
            whole = self.covariance + unstated**2 * np.exp(-apart / length)
            solved = np.linalg.solve(whole, np.column_stack([columns, self.difference]))
            information = columns.T @ solved[:, :-1]
            covariance = np.linalg.inv(information)
            weights = covariance @ solved[:, :-1].T
            value = weights @ self.difference
            errors = solved[:, -1] - solved[:, :-1] @ value
            size = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(information)[1]
            fits.append((value, covariance, weights, errors, -0.5 * (self.difference @ errors + size)))
        values, covariances, weights, errors, evidence = map(np.stack, zip(*fits, strict=True))
        # The prior of the logarithm, in even steps of which the standard deviations are.
        sizes = np.repeat(UNSTATED_RATIOS, len(UNSTATED_NM))
        share = scipy.special.softmax(evidence + np.log(sizes / (1.0 + (sizes / USUAL_RATIO) ** 2)))
        value = share @ values
        spread = np.tensordot(share, covariances, 1) + np.einsum("t,ti,tj->ij", share, values - value, values - value)
        limits = np.interp([0.5, 0.025, 0.975], np.cumsum(share) - 0.5 * share, sizes)
        return InCommon(value, spread, np.tensordot(share, weights, 1), share @ errors, limits)

    def budget(self, found: InCommon, combined: Array) -> dict[str, float]:
        """Standard uncertainty by source of a combination (k,) of what subjects have in common."""
        weights = combined @ found.weights
        parts = {name: float(weights @ c @ weights) for name, c in self.sources.items()}
        parts[UNSTATED] = float(combined @ found.covariance @ combined) - sum(parts.values())
        return {name: math.sqrt(max(part, 0.0)) for name, part in parts.items()}


def joint_difference(
    pairs: Mapping[str, tuple[SpectralEstimate, SpectralEstimate]], use: Mapping[str, Sequence[Mask]]
) -> JointDifference:
    """Of spectra of both sides by subject, in the bands (B,) of every piece that each subject uses."""
    every = [(i, q, at) for i, s in enumerate(pairs) for q, at in enumerate(use[s]) if at.any()]
    subject, piece = (np.array(numbers, dtype=np.intp) for numbers in list(zip(*every, strict=True))[:2])
    count = len(every)
    by_predicted, by_measured, of_sensor = np.zeros((3, count, every[0][2].size))
    difference, noise, relative = np.empty(count), np.zeros((count, count)), np.zeros(())
    for n, (i, _, at) in enumerate(every):
        p, m = list(pairs.values())[i]
        by_predicted[n, at], by_measured[n, at] = 1.0 / p.mean[at] / at.sum(), 1.0 / m.mean[at] / at.sum()
        difference[n] = np.log(p.mean[at] / m.mean[at]).mean()
    directions: dict[tuple[str, str, int], Array] = {}  # source, draw and their number
    for i, (name, (p, m)) in enumerate(pairs.items()):
        own, left = subject == i, np.nan_to_num(m.error_covariance)
        for source, errors in p.errors.items():
            key = source, name if source == OWN else errors.draw, len(errors.rows)
            rows = directions.setdefault(key, np.zeros((len(errors.rows), count)))
            rows[:, own] = np.nan_to_num(errors.rows) @ by_predicted[own].T
        if m.calibration is not None:  # a relative error that all spectra of a sensor share
            level, common = np.where(m.mean > 0.0, m.mean, np.inf), np.nan_to_num(m.calibration)
            of_sensor[own], relative = by_measured[own] * np.nan_to_num(m.mean), common / np.outer(level, level)
            left = left - common
        noise[np.ix_(own, own)] = by_measured[own] @ left @ by_measured[own].T
    sources = {REST: noise}
    for (source, *_), rows in directions.items():
        sources[source] = sources.get(source, 0.0) + rows.T @ rows
    if of_sensor.any():
        sources[CALIBRATION] = of_sensor @ relative @ of_sensor.T
    bands = np.array([float(at.sum()) for *_, at in every])
    return JointDifference(subject, piece, difference, by_predicted.sum(axis=1), bands, sources)


def joint_pieces(predicted: Products, observed: Products) -> JointDifference | None:
    """Differences of the radiance by subject and piece, where two subjects and more show it on both sides."""
    here, axis = observed.radiance, observed.axis
    mixed = {subject for subject, _ in predicted.scores}
    pairs = {s: (p, here[s]) for s, p in predicted.radiance.items() if s in here and s not in mixed and p.errors}
    pieces = [(axis.centre_nm >= low) & (axis.centre_nm < high) & in_window(axis.centre_nm) for low, high in PIECES_NM]
    use: dict[str, list[Mask]] = {}
    for s, pair in pairs.items():
        good = comparable_bands(*pair, axis) & (pair[0].mean > 0) & (pair[1].mean > 0)
        use[s] = [m if np.count_nonzero(m := good & piece) >= _FEWEST_BANDS else m & False for piece in pieces]
    shown = np.sum([[m.any() for m in own] for own in use.values()], axis=0) > 1
    if not np.any(shown):
        return None
    use = {s: [m & some for m, some in zip(own, shown, strict=True)] for s, own in use.items()}
    return joint_difference(pairs, use)


def _regions(joint: JointDifference) -> Iterator[tuple[str, Array, Array]]:
    """Of each region its name, the combination of pieces (Q,) that is its mean, and those (S, N) of each subject."""
    ends = np.array(PIECES_NM)[joint.piece]
    for low, high in REGIONS_NM:
        bands = np.where((ends[:, 0] >= low) & (ends[:, 1] <= high), joint.bands, 0.0)
        if np.any(bands):
            own = bands * (joint.subject == np.unique(joint.subject[bands > 0.0])[:, None])
            pieces = bands @ joint.of_piece
            yield f"{low}-{high}", pieces / pieces.sum(), own / own.sum(axis=1, keepdims=True)


def _left(covariance: Array, difference: Array, column: Array) -> float:
    """Chi-square of what no multiple of a column makes of differences."""
    c = covariance + UNSTATED_RATIOS[0] ** 2 * np.eye(column.size)
    both = np.stack([column, difference])
    (of_column, mixed), (_, whole) = both @ np.linalg.solve(c, both.T)
    return float(whole - mixed**2 / of_column)


def groups(observed: Products, fitted_on: Sequence[str]) -> dict[str, Products]:
    """What is compared jointly: everything; and what budget and settings were not ``fitted_on``, where they were."""
    unseen = {s: m for s, m in observed.radiance.items() if not any(fnmatchcase(s, name) for name in fitted_on)}
    return {ALL_SUBJECTS: observed} | ({UNSEEN_SUBJECTS: replace(observed, radiance=unseen)} if fitted_on else {})


def compare_jointly(predicted: Products, observed: Products) -> list[Result]:
    """Rows of each region: ``joint_difference_ratio@LOW-HIGH``; ``p_value_between``: whether the subjects differ.

    Of each piece of the spectrum ``sensor_gain`` where there is no offset, ``sensor_gain_beside_offset`` and
    ``sensor_offset`` where both are fitted; ``unstated_difference_ratio``: what subjects differ by from piece to piece
    beyond all stated errors.

    Examples
    --------
    >>> from hyperval.data import Errors
    >>> from hyperval.spectra.axis import SpectralAxis
    >>> axis, one = SpectralAxis([410.0, 420.0, 430.0], 10.0), np.ones(3)
    >>> errors = {"aerosol": Errors(0.03 * one[None])}
    >>> sites = {name: SpectralEstimate(1.1 * one, errors["aerosol"].covariance, errors=errors) for name in "ab"}
    >>> seen = {name: SpectralEstimate(one, 0.0001 * np.eye(3)) for name in "ab"}
    >>> level, between, *gains = compare_jointly(Products(axis, radiance=sites), Products(axis, radiance=seen))
    >>> level.metric, round(level.value, 6), round(level.upper - level.value, 3), round(between.value, 6)
    ('joint_difference_ratio@400-450', 0.1, 0.065, 1.0)
    """
    joint = joint_pieces(predicted, observed)
    if joint is None:
        return []
    found, rows = joint.in_common(joint.of_piece), list[Result]()
    for label, pieces, own in _regions(joint):
        budget, d, n = joint.budget(found, pieces), own @ joint.difference, len(own)
        shares = sorted(budget.items(), key=lambda item: -item[1])[:3]
        why = f"with inputs as stated {np.expm1(d.min()):+.1%} to {np.expm1(d.max()):+.1%}; half width by source: "
        why += ", ".join(f"{name} {Z95 * x:.1%}" for name, x in shares)
        value, half = float(pieces @ found.value), Z95 * math.hypot(*budget.values())
        number, *ends = np.expm1([value, value - half, value + half]).tolist()
        rows.append(row(f"joint_difference_ratio@{label}", number, ends, n=n, reason=why))
        levels = np.ones(n), own @ joint.inverse_level
        gain, offset = (_left(own @ joint.covariance @ own.T, d, column) for column in levels)
        why = f"chi-square {gain:.3g} of {n - 1} as a gain, {offset:.3g} as an offset"
        rows.append(row(f"p_value_between@{label}", float(scipy.stats.chi2.sf(gain, n - 1)), n=n, reason=why))
    middle, *ends = found.unstated.tolist()
    rows.append(row("unstated_difference_ratio", middle, ends, n=joint.difference.size, reason=_moved(joint, found)))
    return [*rows, *_sensor_rows(joint, found)]


def _moved(joint: JointDifference, found: InCommon) -> str:
    """How far from what is stated the inputs are, those that are farthest first."""
    sizes = {k: np.linalg.norm(c @ found.errors) / max(np.trace(c), 1e-300) ** 0.5 for k, c in joint.sources.items()}
    first = sorted(joint.sources.keys() - {CALIBRATION, REST}, key=lambda name: (-sizes[name], name))[:4]
    return "inputs in units of their stated uncertainty: " + ", ".join(f"{name} {sizes[name]:.1f}" for name in first)


def _sensor_rows(joint: JointDifference, found: InCommon) -> Iterator[Result]:
    """Gain of the sensor by pieces, and gain and offset together where subjects are not equally bright.

    Its own stated uncertainty, which says what the gain might be, is no error of it here.
    """
    count, numbers = joint.of_piece.sum(axis=0).astype(int), np.unique(joint.piece)
    common = np.exp(joint.difference @ joint.of_piece / count)
    by_level = joint.inverse_level[:, None] * joint.of_piece * common  # 1 / measured without its noise
    dark = np.where(by_level > 0.0, by_level, np.inf).min(axis=0)
    apart = np.flatnonzero(by_level.max(axis=0) * (1.0 - _APART) > dark).tolist()
    both = joint.in_common(np.hstack([joint.of_piece, -by_level[:, apart]]))
    of_calibration = joint.sources.get(CALIBRATION, np.zeros(joint.covariance.shape))
    for name, fit, some in (("sensor_gain", found, range(count.size)), ("sensor_gain_beside_offset", both, apart)):
        halves = Z95 * np.sqrt(np.diag(fit.covariance - fit.weights @ of_calibration @ fit.weights.T))
        for k, q in enumerate(some):
            at, n, (x, half) = sum(PIECES_NM[numbers[q]]) // 2, count[q], (fit.value[q], halves[q])
            yield row(f"{name}@{at}", math.exp(-x), (math.exp(-x - half), math.exp(half - x)), n=int(n))
            if fit is both:
                yield row(f"sensor_offset@{at}", fit.value[count.size + k], half=halves[count.size + k], n=int(n))


def would_decide(item: Result, predicted: Products, observed: Products, fitted_on: Sequence[str] = ()) -> str:
    """What would decide an inconclusive criterion, in words: how well which sources would have to be known, or how many
    more would have to be counted.  The value is taken to stay: a ratio is judged by its logarithm, of the interval on
    the side of the value where an end of the range lies.

    Examples
    --------
    >>> from hyperval.spectra.axis import SpectralAxis
    >>> nothing, limits = Products(SpectralAxis([410.0], 10.0)), {"limit_low": 0.5, "limit_high": 2.0}
    >>> alarms = Result("", "scores", "", "cem", "pfa_ratio@1e-2", 0.26, lower=0.105, upper=0.57, n=4773, **limits)
    >>> would_decide(alarms, nothing, nothing)
    'a count of 6878 in place of 4773; or an interval 1.2 times narrower'
    """
    times, metric = item.shortfall, metric_of(item.metric)
    if metric.kind is Kind.TEST:
        words = f"every stated uncertainty {times:.2g} times smaller, to detect {metric.departure or 'its alternative'}"
        return words if times > 1 else ""
    side = groups(observed, fitted_on).get(item.subject)
    budget, subjects = _of_region(item, predicted, side) if side else (_of_level(item, predicted, observed), 1)
    as_judged = math.log if metric.agreement == 1.0 and item.lower > 0.0 else float
    low, value, high = map(as_judged, (item.lower, item.value, item.upper))
    ends = [as_judged(end) for end in (item.limit_low, item.limit_high) if item.lower < end < item.upper]
    if not ends:
        return ""
    wanted = min((end - value) / ((high if end > value else low) - value) for end in ends)
    if wanted <= 0.0:
        return "another collection: the value is at the limit of its range"
    if not budget:
        more = f"a count of {math.ceil(item.n / wanted**2)} in place of {item.n}; or " if item.n else ""
        return f"{more}an interval {1.0 / wanted:.3g} times narrower"
    same = [p for s, p in getattr(predicted, item.product).items() if side or s == item.subject]
    # Field spectra of several subjects have no one uncertainty.
    scales = {name: (e.size, e.unit) for p in same for name, e in p.errors.items() if not side or name != OWN}
    return deciding(budget, wanted, scales, subjects)


def _of_region(item: Result, predicted: Products, observed: Products) -> tuple[dict[str, float], int]:
    """Standard uncertainty by source of what subjects have in common in a region, and how many they are."""
    joint = joint_pieces(predicted, observed)
    for label, pieces, own in _regions(joint) if joint else ():
        if joint and item.metric == f"joint_difference_ratio@{label}":
            return joint.budget(joint.in_common(joint.of_piece), pieces), len(own)
    return {}, 1


def _of_level(item: Result, predicted: Products, observed: Products) -> dict[str, float]:
    """The same of the level of one spectrum, all of them together 1; none of any other row."""
    left, right = (getattr(side, item.product, {}).get(item.subject) for side in (predicted, observed))
    if not isinstance(left, SpectralEstimate) or not isinstance(right, SpectralEstimate):
        return {}
    parts, use = regions(observed.axis), comparable_bands(left, right, observed.axis) & (right.mean > 0)
    use &= parts.get(item.metric.rpartition("_")[2], parts["windows"])
    return {name: math.sqrt(share) for name, share in shares(left, right, use)} if use.any() else {}


def deciding(
    budget: Mapping[str, float], wanted: float, scales: Mapping[str, tuple[float, str]], subjects: int = 1
) -> str:
    """What makes a half width as small a part ``wanted`` of itself: each source alone, the cheapest pair, or subjects.

    Parameters
    ----------
    budget : standard uncertainty by source
    scales : standard uncertainty of the inputs behind them, with units

    Examples
    --------
    >>> deciding({"aerosol": 0.03, "water": 0.01}, 0.5, {"aerosol": (0.02, ""), "water": (0.5, "g cm-2")})
    'aerosol known to 0.0082 (now 0.02)'
    >>> deciding({"aerosol": 0.03, "water": 0.03}, 0.5, {"aerosol": (0.02, ""), "water": (0.5, "g cm-2")})
    'aerosol known to 0.01 (now 0.02) and water known to 0.25 g cm-2 (now 0.5)'
    """
    total = sum(x**2 for x in budget.values())
    largest = sorted((name for name, x in budget.items() if x > 0.0), key=lambda name: -budget[name])

    def left(names: Sequence[str]) -> float:
        """The part of these sources' uncertainty that may be left of it; 0 where none would do."""
        share = sum(budget[name] ** 2 for name in names)
        return math.sqrt(max(wanted**2 * total - (total - share), 0.0) / share)

    def known(names: Sequence[str]) -> str:
        words, part = [], left(names)
        for name in names:
            size, unit = scales.get(name, (math.nan, ""))
            to = f"to {part * size:.2g} {unit}".rstrip() + f" (now {size:.2g})"
            words.append(f"{name} known " + (to if math.isfinite(size) else f"{1 / part:.2g} times better"))
        return " and ".join(words)

    out = [known([name]) for name in largest if left([name]) > _LEAST_LEFT][:3]
    some = [largest[:k] for k in range(2, len(largest) + 1) if left(largest[:k]) > _LEAST_LEFT]
    out = out or [known(names) for names in some[:1]]
    own = sum(budget.get(name, 0.0) ** 2 for name in (OWN, REST, UNSTATED))
    if subjects > 1 and wanted**2 * total > total - own:
        out.append(f"{math.ceil(subjects * own / (wanted**2 * total - (total - own)))} subjects in place of {subjects}")
    return " or ".join(out) or "more than this collection can provide: every source would need a smaller uncertainty"

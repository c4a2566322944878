"""All subjects of one sensor together: their common difference by region, and what would decide a criterion.

The relative difference of subject s in a region, d(s), is what all share, x, and errors.  An error of the model's
inputs or of the calibration is the same draw for every subject, one of the atmosphere for every subject of a day; of
the field readings and the noise each has its own.  With C their covariance x is the mean of least variance with
weights from 0 to 1; (d - y)^T C^-1 (d - y) about the generalised mean y tells whether the subjects differ by more than
their own errors say.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

from hyperval.compare.rows import Array, Mask, row
from hyperval.compare.spectra import comparable_bands, regions
from hyperval.metrics import Kind, metric_of
from hyperval.model.intervals import Z95
from hyperval.products import Products, SpectralEstimate
from hyperval.results import Result
from hyperval.spectra.axis import in_window

ALL_SUBJECTS, UNSEEN_SUBJECTS = "all subjects", "unseen subjects"
REGIONS_NM = ((400, 450), (450, 700), (700, 1000), (1200, 1760), (2050, 2400))
# Bands that give one number of the sensor's gain.
PIECES_NM = tuple((a, a + 30) for a in range(400, 1000, 30)) + tuple((a, a + 100) for a in range(1000, 2500, 100))
OWN = "field spectrum"  # each subject's own draw
CALIBRATION, REST = "calibration", "noise and the rest"
_FEWEST_BANDS = 3
_APART = 0.05  # of the brightest: subjects alike tell no gain from an offset
FLOOR = 1e-4  # of the radiance: what interpolation and rounding of the model leave between subjects
_LEAST_LEFT = 0.1  # hardly anybody knows an input ten times better


@dataclass(frozen=True)
class JointDifference:
    """Relative difference (predicted - measured) / measured of some subjects in the same bands.

    Attributes
    ----------
    subjects : (S,) names
    difference, level : (S,) means over the bands, and those of the prediction
    sources : name -> (S, S) error covariance from one source, independent of the others
    scales : name -> standard uncertainty of the input behind a source, and its unit
    """

    subjects: tuple[str, ...]
    difference: Array
    level: Array
    sources: Mapping[str, Array]
    scales: Mapping[str, tuple[float, str]]

    @property
    def covariance(self) -> Array:
        """(S, S)."""
        return np.asarray(sum(self.sources.values()))

    @property
    def weights(self) -> Array:
        """(S,) of the mean of least variance whose weights are no less than 0, sum 1.

        Without that bound subjects whose errors are nearly the same are extrapolated from, to far outside of them all
        where anything that no source states makes them differ.
        """
        rows = np.linalg.cholesky(self.covariance).T
        heavy = 1e4 * float(np.abs(rows).max())
        found = scipy.optimize.nnls(np.vstack([rows, heavy * np.ones(len(rows))]), np.eye(len(rows) + 1)[-1])[0]
        return np.asarray(found / found.sum())

    @property
    def value(self) -> float:
        """The mean of least variance, which lies between the subjects' own differences."""
        return float(self.weights @ self.difference)

    @property
    def budget(self) -> dict[str, float]:
        """Standard uncertainty of :attr:`value` by source."""
        return {name: math.sqrt(max(float(self.weights @ c @ self.weights), 0.0)) for name, c in self.sources.items()}

    @property
    def between(self) -> tuple[float, int]:
        """Chi-square of what the subjects differ by about their generalised mean, with its degrees of freedom."""
        solved = np.linalg.solve(self.covariance, np.ones(len(self.subjects)))
        left = self.difference - solved @ self.difference / solved.sum()
        return float(left @ np.linalg.solve(self.covariance, left)), left.size - 1

    @property
    def gain_and_offset(self) -> tuple[Array, Array]:
        """(2,) gain and offset of the sensor that differences not ``relative`` have in common, and their covariance.

        -d = a level + o by generalised least squares, gain 1 + a, where both may be anything: the calibration's own
        uncertainty, which says what they might be, is no error here.
        """
        rows = np.column_stack([self.level, np.ones(self.level.size)])
        solved = np.linalg.solve(self.covariance - self.sources.get(CALIBRATION, np.zeros(())), rows)
        covariance = np.linalg.inv(rows.T @ solved)
        return np.array([1.0, 0.0]) - covariance @ solved.T @ self.difference, covariance


def joint_differences(
    predicted: Products,
    observed: Products,
    regions_nm: Iterable[tuple[int, int]] = REGIONS_NM,
    *,
    relative: bool = True,
) -> Iterator[tuple[tuple[int, int], JointDifference]]:
    """Region [nm] -> radiance of all subjects there, where two and more show it on both sides."""
    here, axis = observed.radiance, observed.axis
    mixed = {subject for subject, _ in predicted.scores}
    pairs = {s: (p, here[s]) for s, p in predicted.radiance.items() if s in here and s not in mixed and p.errors}
    good = {
        s: comparable_bands(*pair, axis) & in_window(axis.centre_nm) & (pair[1].mean > 0) for s, pair in pairs.items()
    }
    for low, high in regions_nm:
        inside = (axis.centre_nm >= low) & (axis.centre_nm < high)
        use = {s: keep & inside for s, keep in good.items() if np.count_nonzero(keep & inside) >= _FEWEST_BANDS}
        if len(use) > 1:
            yield (low, high), joint_difference({s: pairs[s] for s in use}, use, relative=relative)


def joint_difference(
    pairs: Mapping[str, tuple[SpectralEstimate, SpectralEstimate]], use: Mapping[str, Mask], *, relative: bool = True
) -> JointDifference:
    """Of spectra of both sides by subject, in the bands (B,) that each subject uses; not ``relative``: predicted less
    measured, which an offset of the sensor would make alike.
    """
    shared: dict[str, dict[int, tuple[str, Array]]] = {}  # source -> subject -> of which draw, its directions
    own: dict[str, Array] = {}  # source -> (S,) variance of each subject by itself

    def add(source: str, subject: int, variance: float) -> None:
        own.setdefault(source, np.zeros(len(pairs)))[subject] += max(variance, 0.0)

    difference, level = np.empty((2, len(pairs)))
    measured, scales = [], dict[str, tuple[float, str]]()
    weights: list[Array] = []
    for i, (subject, (p, m)) in enumerate(pairs.items()):
        at = use[subject]
        one = np.where(at, 1.0, 0.0) / at.sum()
        of_predicted = np.divide(one, m.mean, out=np.zeros_like(one), where=at) if relative else one
        of_measured = np.divide(of_predicted * p.mean, m.mean, out=np.zeros_like(one), where=at) if relative else one
        weights.append(of_predicted)
        difference[i], level[i] = of_predicted[at] @ (p.mean - m.mean)[at], of_predicted[at] @ p.mean[at]
        for source, errors in p.errors.items():
            directions = np.nan_to_num(errors.rows) @ of_predicted
            scales[source] = (errors.size, errors.unit)
            shared.setdefault(source, {})[i] = (subject if source == OWN else errors.draw), directions
        measured.append((of_measured, m))
    if len(pairs) > 1:
        scales[OWN] = (math.nan, "")  # field spectra of several subjects have no one uncertainty
    sources = {name: _same_draw(rows, len(pairs)) for name, rows in shared.items()}
    if any(m.calibration is not None for _, m in measured):
        sources[CALIBRATION] = _calibration(measured)
    for i, (p, m) in enumerate(pairs.values()):
        of_predicted, of_measured = weights[i], measured[i][0]
        add(REST, i, (FLOOR * float(of_measured @ np.nan_to_num(m.mean))) ** 2)
        add(REST, i, _variance(p.error_covariance, of_predicted) - sum(
            float(np.sum((np.nan_to_num(e.rows) @ of_predicted) ** 2)) for e in p.errors.values()
        ))  # fmt: skip
        left = _variance(m.error_covariance, of_measured) - sources.get(CALIBRATION, np.zeros((i + 1, i + 1)))[i, i]
        parts = {name: float(np.nansum((of_measured * u) ** 2)) for name, u in m.budget.items() if name != CALIBRATION}
        whole = sum(parts.values())
        for name, part in (parts or {REST: 1.0}).items():
            add(name, i, left * part / whole if whole > 0.0 else left / len(parts or [0]))
    sources |= {name: np.diag(values) for name, values in own.items()}
    return JointDifference(tuple(pairs), difference, level, sources, scales)


def _variance(covariance: Array, weights: Array) -> float:
    used = np.flatnonzero(weights)
    return float(weights[used] @ covariance[np.ix_(used, used)] @ weights[used])


def _same_draw(rows: Mapping[int, tuple[str, Array]], count: int) -> Array:
    """(S, S) covariance of what moves subjects of one draw along the same directions."""
    out = np.zeros((count, count))
    for i, (one, a) in rows.items():
        for j, (other, b) in rows.items():
            out[i, j] = float(a @ b) if one == other and a.size == b.size else 0.0
    return out


def _calibration(measured: Sequence[tuple[Array, SpectralEstimate]]) -> Array:
    """(S, S) covariance of a relative error of the calibration, which all spectra of a sensor share."""
    out = np.zeros((len(measured), len(measured)))
    for i, (a, one) in enumerate(measured):
        for j, (b, other) in enumerate(measured):
            if one.calibration is not None and other.calibration is not None:
                used, there = np.flatnonzero(a), np.flatnonzero(b)
                relative = one.calibration[np.ix_(used, there)] / np.outer(one.mean[used], one.mean[there])
                out[i, j] = float((a * one.mean)[used] @ relative @ (b * other.mean)[there])
    return out


def compare_jointly(predicted: Products, observed: Products) -> list[Result]:
    """Rows of each region: ``joint_difference_ratio@LOW-HIGH``; ``p_value_between``: whether the subjects differ.

    Of each piece of the spectrum ``sensor_gain`` where there is no offset, ``sensor_gain_beside_offset`` and
    ``sensor_offset`` where both are fitted.

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
    ('joint_difference_ratio@400-450', 0.1, 0.059, 1.0)
    """
    rows, offsets = list[Result](), dict(joint_differences(predicted, observed, relative=False))
    for (low, high), joint in joint_differences(predicted, observed):
        u, (chi, dof), n = math.hypot(*joint.budget.values()), joint.between, len(joint.subjects)
        shares = sorted(joint.budget.items(), key=lambda item: -item[1])[:3]
        why = "half width by source: " + ", ".join(f"{name} {Z95 * x:.1%}" for name, x in shares)
        rows.append(row(f"joint_difference_ratio@{low}-{high}", joint.value, half=Z95 * u, n=n, reason=why))
        p, offset = float(scipy.stats.chi2.sf(chi, dof)), offsets[low, high].between[0]
        why = f"chi-square {chi:.3g} of {dof} as a gain, {offset:.3g} as an offset"
        rows.append(row(f"p_value_between@{low}-{high}", p, n=n, reason=why))
    for (low, high), joint in joint_differences(predicted, observed, PIECES_NM):
        gain = 1.0 / (1.0 + joint.value)
        half = Z95 * math.hypot(*joint.budget.values()) * gain**2
        rows.append(row(f"sensor_gain@{(low + high) // 2}", gain, half=half, n=len(joint.subjects)))
    for (low, high), joint in joint_differences(predicted, observed, PIECES_NM, relative=False):
        if np.ptp(joint.level) > _APART * joint.level.max():
            values, covariance = joint.gain_and_offset
            halves, at, n = Z95 * np.sqrt(np.diag(covariance)), (low + high) // 2, len(joint.subjects)
            rows.append(row(f"sensor_gain_beside_offset@{at}", values[0], half=halves[0], n=n))
            rows.append(row(f"sensor_offset@{at}", values[1], half=halves[1], n=n))
    return rows


def would_decide(item: Result, predicted: Products, observed: Products) -> str:
    """What would decide an inconclusive criterion, in words: how well which sources would have to be known, or how many
    more would have to be counted.
    """
    times, metric = item.shortfall, metric_of(item.metric)
    if metric.kind is Kind.TEST:
        found = metric.departure or "its alternative"
        return f"every stated uncertainty {times:.2g} times smaller, to detect {found}" if times > 1 else ""
    joint = _behind(item, predicted, observed)
    ends = [end for end in (item.limit_low, item.limit_high) if math.isfinite(end)]
    half = 0.5 * (item.upper - item.lower)
    if not ends or not half > 0.0:
        return ""
    wanted = min(abs(item.value - end) for end in ends) / half  # of the half width that is there
    if wanted <= 0.0:
        return "another collection: the value is at the limit of its range"
    if joint is None:
        more = f"a count of {math.ceil(item.n / wanted**2)} in place of {item.n}; or " if item.n else ""
        return f"{more}an interval {1.0 / wanted:.2g} times narrower"
    return deciding(joint.budget, wanted, joint.scales, len(joint.subjects))


def _behind(item: Result, predicted: Products, observed: Products) -> JointDifference | None:
    """The sources of a level of spectra; None of any other row."""
    if item.subject == ALL_SUBJECTS:
        return next(
            (j for (a, b), j in joint_differences(predicted, observed) if item.metric.endswith(f"@{a}-{b}")), None
        )
    left, right = (getattr(side, item.product, {}).get(item.subject) for side in (predicted, observed))
    if not isinstance(left, SpectralEstimate) or not isinstance(right, SpectralEstimate):
        return None
    parts, comparable = regions(observed.axis), comparable_bands(left, right, observed.axis)
    use = parts.get(item.metric.rpartition("_")[2], parts["windows"]) & comparable
    return joint_difference({item.subject: (left, right)}, {item.subject: use}) if use.any() else None


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
        words = []
        for name in names:
            size, unit = scales.get(name, (math.nan, ""))
            part, unit = left(names), f" {unit}".rstrip()
            to = f"to {part * size:.2g}{unit} (now {size:.2g})"
            words.append(f"{name} known " + (to if math.isfinite(size) else f"{1 / part:.2g} times better"))
        return " and ".join(words)

    out = [known([name]) for name in largest if left([name]) > _LEAST_LEFT][:3]
    pairs = sorted(combinations(largest, 2), key=lambda pair: -left(pair))[:1]
    some = next((largest[:k] for k in range(3, len(largest) + 1) if left(largest[:k]) > _LEAST_LEFT), [])
    out = out or [known(names) for names in (*pairs, some) if names and left(names) > _LEAST_LEFT][:1]
    own = budget.get(OWN, 0.0) ** 2 + budget.get(REST, 0.0) ** 2
    if subjects > 1 and wanted**2 * total > total - own:
        out.append(f"{math.ceil(subjects * own / (wanted**2 * total - (total - own)))} subjects in place of {subjects}")
    return " or ".join(out) or "more than this collection can provide: every source would need a smaller uncertainty"

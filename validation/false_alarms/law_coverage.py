"""How often the interval of predicted over measured P_FA holds the truth, over simulated images.

    python validation/false_alarms/law_coverage.py [IMAGES] [CASE ...]

Each image has 110 x 110 pixels of four bands that are correlated over 1.5 pixels; its false alarms are counted by
blocks, a law is fitted to its own pixels ("same") or to those of another image ("other"), and the law's P_FA is
compared with the measured one at the thresholds of 1e-2 and 1e-3.  Cases: one normal law; one t law of six degrees
of freedom; two clusters, fitted as two; the same two fitted as one t law, of which the truth is what the fit to
484,000 independent pixels gives.  Printed: the share of images whose interval holds the truth, with that of the
measured rate alone and with the law's (a jackknife over parts of the image), and the standard deviation of ln P_FA
by the pixels, true and estimated.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy import ndimage, special

from hyperval import pixels as px
from hyperval.data import Components
from hyperval.model import (
    ClassScores,
    clopper_pearson,
    false_alarm_grid,
    jackknife_directions,
    log_false_alarm,
    thresholds_at,
)
from hyperval.products import ExceedanceCurve

SIDE, BLUR, BANDS, DOF, SHARE = 110, 1.5, 4, 6.0, 0.07
LEVELS = (1e-2, 1e-3)
WEIGHTS = np.array([1.0, 0.5, -0.5, 0.3])
SPREAD, OTHER_SPREAD = np.sqrt([4.0, 1.0, 0.5, 0.2]), np.sqrt([1.0, 2.0, 1.0, 0.3])
AWAY = np.array([2.5, 2.0, -2.0, 1.0])
CASES = {"normal": "normal", "t": "t", "two clusters": "mixture", "two clusters as one t": "t"}
PART = px.compact_parts(*np.divmod(np.arange(SIDE**2), SIDE))
BLOCK = 11  # pixels; of the choice of components, which is not asked for here
Part = tuple[float, np.ndarray, np.ndarray, float]


def field(rng: np.random.Generator, count: int, blur: float) -> np.ndarray:
    """(count, pixels) standard normal fields."""
    x = rng.standard_normal((count, SIDE, SIDE))
    if blur > 0:
        x = 2.0 * np.sqrt(np.pi) * blur * ndimage.gaussian_filter(x, (0.0, blur, blur), mode="wrap")
    return x.reshape(count, -1)


def image(case: str, seed: int, blur: float = BLUR) -> np.ndarray:
    """(pixels, BANDS)."""
    rng = np.random.default_rng(seed)
    x = SPREAD[:, None] * field(rng, BANDS, blur)
    if case == "t":
        u = special.ndtr(field(rng, 1, blur)[0])
        return (x * np.sqrt(DOF / special.chdtri(DOF, 1.0 - u))).T
    if case.startswith("two"):
        cluster = field(rng, 1, 2.0 * blur)[0] > special.ndtri(1.0 - SHARE)
        x = np.where(cluster, AWAY[:, None] + OTHER_SPREAD[:, None] * field(rng, BANDS, blur), x)
    return x.T


def laws(*rows: tuple[float, float, float, float]) -> ClassScores:
    """(fraction, mean, sd, dof) of each law."""
    return ClassScores(*(np.array([column]) for column in zip(*rows, strict=True)))


def truth(case: str) -> ClassScores:
    sd, other = (float(np.sqrt(WEIGHTS**2 @ s**2)) for s in (SPREAD, OTHER_SPREAD))
    if case == "t":
        return laws((1.0, 0.0, sd * np.sqrt(DOF / (DOF - 2.0)), DOF))
    if case == "normal":
        return laws((1.0, 0.0, sd, np.inf))
    return laws((1.0 - SHARE, 0.0, sd, np.inf), (SHARE, float(WEIGHTS @ AWAY), other, np.inf))


def parts_of(
    mean: np.ndarray, covariance: np.ndarray, tails: px.TailFit | None, parts: Components | None
) -> list[Part]:
    """(fraction, mean, covariance, dof) of each law of a class with these moments: one, or those of a mixture."""
    if parts is None:
        scale, dof = (1.0, np.inf) if tails is None else (tails.scale, tails.dof)
        return [(1.0, mean, scale * covariance, dof)]
    each = zip(parts.weights, parts.offsets, parts.covariances, strict=True)
    return [(weight, mean + offset, own, parts.dof) for weight, offset, own in each]


def scored(weights: np.ndarray, offset: float, parts: Iterable[Part]) -> ClassScores:
    """The laws behind a filter."""
    return laws(*((f, float(m @ weights) - offset, float(np.sqrt(weights @ c @ weights)), n) for f, m, c, n in parts))


def of_moments(*known: Any) -> ClassScores:
    return scored(WEIGHTS, 0.0, parts_of(*known))


def fitted(kind: str, pixels: np.ndarray) -> list[ClassScores]:
    """The law of all pixels, then without each part of the image."""
    block = np.arange(len(pixels)) // (BLOCK * SIDE)
    mixture = px.class_mixture(pixels, block, 2, tails=False) if kind == "mixture" else None
    out = []
    moments = [(pixels.mean(axis=0), np.cov(pixels.T)), *px.moments_without_each(pixels, PART)]
    for number, (mean, covariance) in enumerate(moments, -1):
        rest = pixels[number != PART]
        tails = px.fit_leading_tails(rest, mean, covariance) if kind == "t" else None
        components = None if mixture is None else mixture.components_without(pixels, PART, number)
        out.append(of_moments(mean, covariance, tails, components))
    return out


def log_tail(x: np.ndarray, law: ClassScores) -> np.ndarray:
    return log_false_alarm(x, law.rows(np.zeros(x.size, int)))[0]


def curve_of(fits: list[ClassScores]) -> ExceedanceCurve:
    """The law's curve with its limits."""
    pfa = false_alarm_grid(1e-5, 10)[::-1]
    x = thresholds_at(pfa[None], fits[0])[0]
    without = np.array([log_tail(x, f) for f in fits[1:]])
    half = 1.96 * np.sqrt((jackknife_directions(without) ** 2).sum(axis=0))
    return ExceedanceCurve(x, pfa, pfa * np.exp(-half), pfa * np.exp(half), left_out={"image": without})


def study(case: str, images: int) -> None:
    true, every = truth(case), np.ones((SIDE, SIDE), bool)
    goal = true
    if case == "two clusters as one t":
        pooled = np.concatenate([image(case, 9000 + i, 0.0) for i in range(40)])
        mean, covariance = pooled.mean(axis=0), np.cov(pooled.T)
        goal = of_moments(mean, covariance, px.fit_leading_tails(pooled, mean, covariance), None)
    fixed = thresholds_at(np.array([LEVELS]), true)[0]
    hits: dict[tuple[float, str, str], list[bool]] = defaultdict(list)
    values, estimates = [], []
    for seed in range(images):
        pixels = image(case, seed)
        fits = fitted(CASES[case], pixels)
        law = curve_of(fits)
        values.append(log_tail(fixed, fits[0]))
        estimates.append(np.sqrt((jackknife_directions([log_tail(fixed, f) for f in fits[1:]]) ** 2).sum(axis=0)))
        for where, counted in (("same", pixels), ("other", image(case, 100_000 + seed))):
            scores = (counted @ WEIGHTS).reshape(SIDE, SIDE)
            measured = px.exceedance_curve(px.AlarmBlocks.from_map(scores, every))
            shared = px.with_shared_pixels(law, scores, PART.reshape(SIDE, SIDE)) if where == "same" else law
            for name, curve in (
                ("measured rate alone", ExceedanceCurve(law.threshold, *(law.probability,) * 3)),
                ("with the law's", shared),
            ):
                for level in LEVELS:
                    ratio = px.false_alarm_ratio(curve, measured, k := px.nearest_point(measured, level))
                    x = measured.threshold[[k]]
                    right = float(np.exp(log_tail(x, goal) - log_tail(x, true))[0])
                    hits[level, where, name].append(ratio.lower <= right <= ratio.upper)
    for (level, where, name), each in hits.items():
        low, high = clopper_pearson(sum(each), images)
        print(f"{case} | {level:g} | {where} | {name} | {np.mean(each):.3f} ({low:.3f} to {high:.3f})")
    for i, level in enumerate(LEVELS):
        spread, estimate = np.std(np.array(values)[:, i]), np.sqrt(np.mean(np.array(estimates)[:, i] ** 2))
        print(
            f"{case} | {level:g} | sd of ln P_FA of the law: true {spread:.3f}, estimated {estimate:.3f}",
            flush=True,
        )


if __name__ == "__main__":
    for name in sys.argv[2:] or CASES:
        study(name, int(sys.argv[1]) if len(sys.argv) > 1 else 400)

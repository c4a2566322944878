"""How often the intervals of background, curves, areas and eigenvalues hold, on score maps whose truth is known.

Each is simulated twice: from independent pixels, and from a background in clusters of 49 pixels, correlation 0.9;
noise and scores of objects from independent errors, and from errors that columns or objects share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
from counts import Key
from scipy import optimize, stats
from world import AXIS

from hyperval.collection import AreaCheck, Detection
from hyperval.compare import judged_together
from hyperval.imagery import TargetObject, all_pixels
from hyperval.model import AREAS
from hyperval.observe import target_areas
from hyperval.pixels import (
    AlarmBlocks,
    EigenDirections,
    area_estimates,
    band_limits,
    empirical_roc,
    exceedance_curve,
    noise_part,
    rank_counts,
    sampling_band,
)
from hyperval.products import ObjectScores
from hyperval.statistics_library import builtin_class

Array = npt.NDArray[np.float64]
Intervals = Iterator[tuple[str, bool]]

SIDE, TILE, CORRELATION = 210, 7, 0.9  # [pixels]
SEPARATIONS = (1.0, 3.0)  # of targets from the background [its standard deviations]; each world draws one
TARGETS = (25, 80, 300)
LEVELS = (1e-1, 1e-2, 1e-3)
AREA_M2 = 4.0  # of a pixel


def background(rng: np.random.Generator, clustered: bool, side: int = SIDE) -> Array:
    """Standard normal scores (side, side), independent or in square clusters."""
    independent = rng.standard_normal((side, side))
    if not clustered:
        return independent
    count = -(-side // TILE)
    common = rng.standard_normal((count, count)).repeat(TILE, 0).repeat(TILE, 1)[:side, :side]
    return np.asarray(np.sqrt(CORRELATION) * common + np.sqrt(1.0 - CORRELATION) * independent)


def rates(
    scores: Array, levels: tuple[float, ...], tail: Callable[[float], float], words: str = "", classes: object = None
) -> tuple[AlarmBlocks, list[tuple[str, bool]]]:
    """A map's blocks, and whether the intervals of its P_FA at thresholds near some levels hold ``tail`` there."""
    blocks = AlarmBlocks.from_map(scores, np.ones(scores.shape, bool), classes=classes)
    curve, found = exceedance_curve(blocks), []
    for level in levels:
        point = int(np.argmin(np.abs(np.log(np.maximum(curve.probability, 1e-9) / level))))
        if np.isfinite(curve.lower[point]):
            inside = curve.lower[point] <= tail(float(curve.threshold[point])) <= curve.upper[point]
            found.append((f"P_FA near {level:g}{words}", bool(inside)))
    return blocks, found


def detection(rng: np.random.Generator, clustered: bool) -> Intervals:
    """P_D at preset P_FA, P_FA at a threshold and areas, of targets that lie above the background."""
    blocks, found = rates(background(rng, clustered), LEVELS, lambda x: float(stats.norm.sf(x)))
    yield from found
    separation = float(rng.uniform(*SEPARATIONS))
    true_pd, true_areas = stats.norm.sf(stats.norm.isf(LEVELS) - separation), _true_areas(separation)
    for count in TARGETS:
        target = rng.normal(separation, 1.0, count)
        for level, true in zip(LEVELS, true_pd, strict=True):
            rate = empirical_roc(target, blocks, level)
            yield f"P_D at {level:g}, {count} targets", bool(rate.pd_lower[0] <= true <= rate.pd_upper[0])
        counts = rank_counts(target, blocks.scores)
        estimates = area_estimates(counts, AREAS, "object" if count < 50 else "pixel", blocks)
        for name, area in estimates.items():
            yield f"{name}, {count} targets", bool(area.lower <= true_areas[name] <= area.upper)


def _true_areas(separation: float) -> dict[str, float]:
    s = stats.norm.sf(stats.norm.ppf((np.arange(40_000) + 0.5) / 40_000, loc=separation))
    return {name: float(area.weight(s).mean()) for name, area in AREAS.items()}


def areas(rng: np.random.Generator, clustered: bool) -> Intervals:
    """The area of an object as the sum of its scores, beside the area that was put there."""
    side, truth = 120, 2.3
    scores = 0.05 * background(rng, clustered, side)
    corner = int(rng.integers(20, 90)), int(rng.integers(20, 90))
    part = np.ones((3, 3), bool)
    target = TargetObject("t", "paint", 1.0, truth * AREA_M2, (side, side), corner, part)
    share = rng.dirichlet(np.ones(9)).reshape(3, 3)
    scores[corner[0] : corner[0] + 3, corner[1] : corner[1] + 3] += truth * share
    near = all_pixels([target], (side, side))
    place = SimpleNamespace(
        pixel_area_m2=AREA_M2, targets=[target], cube=SimpleNamespace(shape=(side, side)), near_targets=near,
        pixels_of=lambda *names: np.ones((side, side), bool),
    )  # fmt: skip
    asked = Detection.model_validate(
        {"targets": [{"name": "t", "material": "paint", "spectrum": {"constant": 0.5}}],
         "areas": [AreaCheck(target="t", detector="cem", margin_pixels=1).model_dump()]}
    )  # fmt: skip
    ((found,), _) = (list(x.values()) for x in target_areas(place, asked, {"t-cem": scores}))  # type: ignore[arg-type]
    yield "area of an object", bool(abs(found.area_m2 - truth * AREA_M2) <= 1.96 * found.standard_uncertainty)


_COVARIANCE = builtin_class("soil", AXIS).covariance + 1e-8 * np.eye(len(AXIS))
_ROOT = np.linalg.cholesky(_COVARIANCE)
EIGENVALUES = (1, 2, 5, 10)
PIXELS, COLUMNS, OBJECTS = 600, 100, 40


def eigenvalues(rng: np.random.Generator, clustered: bool) -> Intervals:
    """Eigenvalues of a sample beside those drawn from the covariance that it came from."""
    if clustered:
        return
    pixels = rng.standard_normal((PIXELS, len(AXIS))) @ _ROOT.T
    measured = np.linalg.eigvalsh(np.cov(pixels.T))[::-1]
    directions = EigenDirections.from_covariance(_COVARIANCE)
    band = sampling_band(directions, float(PIXELS - 1), max(EIGENVALUES), (1,), rng)
    low, high = band_limits(band.eigenvalues)
    for k in EIGENVALUES:
        yield f"eigenvalue {k}", bool(low[k - 1] <= measured[k - 1] <= high[k - 1])


def noise(rng: np.random.Generator, together: bool) -> Intervals:
    """The noise of a class told from its texture; ``together``: half of it is calibration error of 100 columns."""
    stored = 1e-5 * (1.0 + np.arange(len(AXIS)) % 3)
    shared = 0.5 * stored if together else np.zeros_like(stored)
    pixels = rng.standard_normal((PIXELS, len(AXIS))) @ _ROOT.T * float(rng.uniform(0.8, 1.2))
    pixels += rng.standard_normal(pixels.shape) * np.sqrt(stored - shared)
    pixels += (rng.standard_normal((COLUMNS, len(AXIS))) * np.sqrt(shared))[np.arange(PIXELS) % COLUMNS]
    known = {"calibration": shared, "samples": COLUMNS} if together else {}
    factor, uncertainty = noise_part(np.cov(pixels.T), _COVARIANCE + np.diag(stored), stored, PIXELS - 1.0, **known)
    yield "noise of a class", bool(abs(factor - 1.0) <= 1.96 * uncertainty)


def object_spread(rng: np.random.Generator, together: bool) -> Intervals:
    """The spread of the scores of many objects; ``together``: they share an error as large as each one's own."""
    common = float(together) * np.concatenate([half := rng.standard_normal(100), -half])[:, None]
    predicted = {f"{i}": ObjectScores(common + rng.standard_normal((200, 40))) for i in range(OBJECTS)}
    error = float(together) * rng.standard_normal()
    measured = {name: error + rng.standard_normal(1) for name in predicted}
    *_, spread = judged_together(predicted, measured)
    yield "spread of the scores of objects", bool(spread.lower <= 1.0 <= spread.upper)


LAYOUTS = {
    "halves": lambda line, sample: line < SIDE // 2,
    "stripes": lambda line, sample: line // 10 % 2 == 0,
    "checkerboard": lambda line, sample: (line // 10 + sample // 10) % 2 == 0,
}
APART = 2.5  # one class above the other [standard deviations within a class]
HOT, HEAT = 0.01, 4.0  # share of the tiles that are rare clusters, and how far they lie above the others


def layouts(rng: np.random.Generator, clustered: bool) -> Intervals:
    """P_FA and P_D of a background of two classes in halves, stripes or squares, or with rare hot tiles."""
    grid = np.indices((SIDE, SIDE))
    count = -(-SIDE // TILE)
    hot = (rng.random((count, count)) < HOT).repeat(TILE, 0).repeat(TILE, 1)[:SIDE, :SIDE]
    own = background(rng, clustered)
    cases = [(name, own + APART * at(*grid), at(*grid), 0.5, APART) for name, at in LAYOUTS.items()]
    cases += [] if clustered else [("rare clusters", own + HEAT * hot, None, HOT, HEAT)]
    for name, scores, classes, share, apart in cases:

        def tail(x: float, share: float = share, apart: float = apart) -> float:
            return float((1.0 - share) * stats.norm.sf(x) + share * stats.norm.sf(x - apart))

        blocks, found = rates(scores, LEVELS[1:], tail, f", {name}", classes)
        yield from found
        for level in LEVELS[1:]:
            threshold = optimize.brentq(lambda x, level=level, tail=tail: tail(x) - level, -9.0, 30.0)
            rate = empirical_roc(rng.normal(threshold, 1.0, 100), blocks, level)
            yield f"P_D at {level:g}, {name}", bool(rate.pd_lower[0] <= 0.5 <= rate.pd_upper[0])


KINDS: tuple[Callable[[np.random.Generator, bool], Intervals], ...] = (
    detection, layouts, areas, eigenvalues, noise, object_spread,
)  # fmt: skip


def counted(world: int, seed: int) -> Iterator[tuple[Key, list[float]]]:
    """Every interval of one world: what of, whether the background is in clusters, whether it holds the truth."""
    for number, kind in enumerate(KINDS):
        for clustered, where in enumerate(("independent", "clusters")):
            rng = np.random.default_rng([seed, world, number, clustered])
            for what, inside in kind(rng, bool(clustered)):
                yield ("interval", where, what, "pixels"), [float(inside)]

"""Coverage: how often the 95 % intervals of a comparison hold, over collections whose budgets are known to be true.

    python validation/coverage/study.py [--campaigns 200] [--collections 1000] [--spectra 1000] [--maps 2000]
                                        [--output DIR]

Writes coverage.csv.  The first line is the share of whole campaigns without any error that find a
criterion "not met" (campaigns.py).  Then, for every product, the share of comparisons whose stated interval of
predicted minus measured holds 0, and how often the consistency test rejects true cases and tilted ones.  Worlds
are counted in batches, on every processor; counts of a batch are kept in DIR, so that a run goes on where the last
one ended.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

import campaigns
import intervals
import numpy as np
import numpy.typing as npt
import pandas as pd
from counts import Key, Tally, outcomes
from world import AXIS, HIGH, LOW, PANEL_SIDE, SITE, Collection, collect, engine, scenario, tilt, truth
from world import B as BANDS

import hyperval
from hyperval.compare import compare_products, detection
from hyperval.executors import in_order, worker_count, workers
from hyperval.model import Origins, matched_filter_weights, predict
from hyperval.observe import spectral_estimate
from hyperval.pixels import (
    MeasuredPanel,
    covariance_components,
    empirical_roc,
    fit_elm,
    independent_pixels,
    mean_error_covariance,
    neighbour_shares,
    small_sample_factor,
    snr_decorrelated,
    with_areas_and_alarms,
)
from hyperval.products import EstimatedPart, ObjectScores, ObservedProducts, PredictedProducts
from hyperval.progress import track
from hyperval.results import Result
from hyperval.statistics_library import builtin_class
from hyperval.storage import files_within, sha256_of, write_text

Array = npt.NDArray[np.float64]

ELM_RELATIVE, ELM_NM = 0.01, 500.0  # what the campaign says of its panels
TILT = 0.03
ALPHA = 0.05
FALSE_ALARMS = (1e-2, 1e-3)
METHODS = ("linear", "monte-carlo")
SPECTRA = (("radiance", "field"), ("radiance", "bright"), ("reflectance", "field"), ("snr", "bright"))
BATCH = {"campaigns": 5, "collections": 50, "maps": 50}  # worlds
LOOKED_FOR = builtin_class("yellow-paint-plank", AXIS).mean


@cache
def predictions(samples: int) -> dict[str, PredictedProducts]:
    """What is predicted, by both ways of propagation."""
    return {m: predict(scenario(m, samples), Origins(axis=AXIS, engine=engine), objects=True) for m in METHODS}


def observed(c: Collection) -> ObservedProducts:
    """What a campaign would measure on the pixels of a collection."""
    mean, spread = c.field.reshape(-1, BANDS).mean(axis=0), np.cov(c.field.reshape(-1, BANDS).T)
    sampling = _field_error(c.field, mean, spread)
    bright = c.bright.mean(axis=0)
    n = PANEL_SIDE**2
    by_pixel = np.cov(c.bright.T) / n
    radiance = {
        "field": spectral_estimate(mean, {"sampling": sampling.covariance}, n=SITE**2, estimated=[sampling]),
        "bright": spectral_estimate(bright, {"sampling": by_pixel}, n=n, estimated=[EstimatedPart(by_pixel, n - 1.0)]),
    }
    panels = []
    shape = np.exp(-0.5 * (np.subtract.outer(AXIS.centre_nm, AXIS.centre_nm) / ELM_NM) ** 2)
    for name, rho, pixels in (("low", LOW, c.low), ("high", HIGH, c.high)):
        cov = np.cov(pixels.T) / n
        sd = np.full(BANDS, ELM_RELATIVE * rho)
        panels.append(MeasuredPanel(name, np.full(BANDS, rho), np.outer(sd, sd) * shape, pixels.mean(axis=0), cov, n))
    line = fit_elm(panels)
    k = np.outer(line.gain, line.gain)
    reflectance = {
        "field": spectral_estimate(
            line.reflectance(mean),
            {"sampling": sampling.covariance / k, "empirical line": line.error_covariance(mean)},
            n=SITE**2,
            estimated=[sampling.of_each(lambda covariance: covariance / k)],
        )
    }
    roc, objects = {}, {}
    if c.background.size:
        around = line.reflectance(c.background)
        detector = matched_filter_weights(LOOKED_FOR, around.mean(axis=0), np.cov(around.T))
        scores = [detector.score(x) for x in (line.reflectance(c.targets), around)]
        curve = empirical_roc(*scores)
        roc["plank", "cem", "pixel"] = with_areas_and_alarms(curve, *scores)
        objects["plank", "cem"] = ObjectScores(scores[0], tuple(str(i) for i in range(scores[0].size)))
    snr = {"bright": snr_decorrelated(c.bright)}
    return ObservedProducts(AXIS, radiance, snr, reflectance, roc=roc, object_scores=objects)


def _field_error(field: Array, mean: Array, covariance: Array) -> EstimatedPart:
    """Sampling error of the mean with its degrees of freedom, as the pipeline has it."""
    along = covariance_components(covariance, np.random.default_rng(0))
    inside = np.ones(field.shape[:2], bool)
    reach = min(field.shape[0] - 1, 24)
    shares = neighbour_shares(inside, reach, np.random.default_rng(0))
    independent, of_variance = independent_pixels([(along.scores(field - mean), inside)], shares, inside.size, reach)
    plain, widened = (
        mean_error_covariance(covariance, along, by)
        for by in (independent, independent / small_sample_factor(independent))
    )
    return EstimatedPart(widened, float(np.median(of_variance)) - 1.0, plain)


@dataclass(frozen=True)
class Batch:
    """Worlds ``first`` to ``last`` - 1: campaigns, score maps, or collections, with pixels to detect or without."""

    of: str
    first: int
    last: int
    seed: int
    detection: bool = False
    draws: int = 0
    methods: tuple[str, ...] = METHODS

    def tally(self) -> Tally:
        """Count the worlds of the batch."""
        out: dict[Key, list[tuple[float, int]]] = defaultdict(list)
        for i in range(self.first, self.last):
            for key, values in self._of(i):
                if finite := [
                    v for v in values if np.isfinite(v)
                ]:  # 1 where an interval holds, NaN where there is none
                    out[key].append((sum(finite), len(finite)))
        return dict(out)

    def _of(self, i: int) -> Iterator[tuple[Key, Iterable[float]]]:
        if self.of == "campaigns":
            return campaigns.counted(campaigns.rows_of(i, self.seed))
        return intervals.counted(i, self.seed) if self.of == "maps" else self._of_collection(i)

    def _of_collection(self, i: int) -> Iterator[tuple[Key, Iterable[float]]]:
        p = predictions(self.draws)
        rng = np.random.default_rng([self.seed, i])
        t = truth(rng)
        o = observed(collect(t, rng, detection=self.detection))
        for method in self.methods:
            rows = _compared(p[method], o, method)
            for product, subject in SPECTRA:
                selected = [r for r in rows if (r.product, r.subject) == (product, subject)]
                yield (product, subject, "95 % interval", method), _held(selected, "difference_ratio")
                if product != "snr":
                    yield (product, subject, "full test rejects", method), _rejected(selected)
            if self.detection:
                selected = [r for r in rows if r.product == "roc" and r.method == "cem/pixel"]
                for pfa in FALSE_ALARMS:
                    label = f"@{pfa:.0e}".replace("e-0", "e-")
                    inside = [r.value for r in selected if r.metric == f"pd_inside_interval{label}"]
                    yield ("P_D", "plank", f"95 % interval at {pfa:g}", method), inside
                yield ("AUC", "plank", "95 % interval", method), _held(selected, "auc_difference", "lower")
                together = [r for r in rows if (r.subject, r.metric) == ("plank", "objects_inside_95")]
                inside = [float(i < round(r.value * (r.n or 0))) for r in together for i in range(r.n or 0)]
                yield ("scores", "plank", "object inside its 95 % interval", method), inside
        tilted = observed(collect(t, np.random.default_rng([self.seed, i, 1]), detection=False, extra=tilt(TILT)))
        rows = _compared(p["linear"], tilted, "linear")
        selected = [r for r in rows if (r.product, r.subject) == ("radiance", "bright")]
        yield ("radiance", "bright", f"full test rejects {100 * TILT:g} % tilt", "linear"), _rejected(selected)


def _compared(p: PredictedProducts, o: ObservedProducts, method: str) -> list[Result]:
    # P-values of the objects together are not looked at here; their sets of draws are most of the time.
    with patch.multiple(detection, REPLICATES=500, POWER_DRAWS=20):
        return compare_products(p, o, method=method)


def batches(whole: Batch) -> list[Batch]:
    """Cut many worlds into batches."""
    size = BATCH[whole.of]
    starts = range(whole.first, whole.last, size)
    return [replace(whole, first=i, last=min(i + size, whole.last)) for i in starts]


def _held(rows: list[Result], metric: str, known: str = "value") -> list[float]:
    """Whether 0 lies in the interval of a difference, row by row, where it is known."""
    rows = [r for r in rows if r.metric == metric and np.isfinite(getattr(r, known))]
    return [float(r.lower <= 0.0 <= r.upper) for r in rows]


def _rejected(rows: list[Result]) -> list[float]:
    return [float(r.value < ALPHA) for r in rows if r.metric == "p_value_full"]


def _digest_of_code() -> str:
    folders = Path(hyperval.__file__).parent, Path(__file__).parent
    files = [x for folder in folders for x in files_within(folder) if x.suffix in (".py", ".yaml", ".csv", ".npz")]
    return hashlib.sha256("".join(sha256_of(x) for x in files).encode()).hexdigest()


@dataclass(frozen=True)
class Kept:
    """Counts of batches in files of ``folder``, by the batch and the code that made them."""

    folder: Path
    code: str = field(default_factory=_digest_of_code)

    def tally(self, batch: Batch) -> Tally:
        """Read the counts of a batch, or make and keep them."""
        name = hashlib.sha256(repr((batch, self.code)).encode()).hexdigest()[:16]
        path = self.folder / f"{batch.of}-{batch.first:05d}-{name}.json"
        if not path.exists():
            write_text(path, json.dumps([[*key, worlds] for key, worlds in batch.tally().items()]) + "\n")
        return {tuple(key): worlds for *key, worlds in json.loads(path.read_text())}


def main() -> int:
    """Run the study; 1 where a share is not where it is to lie."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, default=200, help="whole ones, without any error")
    parser.add_argument("--collections", type=int, default=1000, help="with pixels for the detectors")
    parser.add_argument("--spectra", type=int, default=1000, help="collections in all")
    parser.add_argument("--maps", type=int, default=2000)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--output", type=Path, default=Path("reports/coverage"))
    args = parser.parse_args()
    (args.output / "counts").mkdir(parents=True, exist_ok=True)
    kept = Kept(args.output / "counts")
    with_pixels = Batch("collections", 0, args.collections, args.seed, detection=True, draws=args.draws)
    without = Batch("collections", args.collections, args.spectra, args.seed, draws=args.draws)
    maps = Batch("maps", 0, args.maps, args.seed)
    right = Batch("campaigns", 0, args.campaigns, args.seed)
    pieces = [piece for whole in (right, maps, with_pixels, without) for piece in batches(whole)]
    with workers(worker_count(len(pieces))) as where:
        tallies = track(in_order(where, kept.tally, pieces), "batches of worlds", total=len(pieces))
        result = outcomes(tallies)
    for o in result:
        interval = f"{o.share:.3f} ({o.lower:.3f} to {o.upper:.3f})"
        print(f"{o.product:12} {o.subject:11} {o.what:32} {o.method:12} {interval} {o.worlds:5} {o.outcome}")
    table = pd.DataFrame(o._replace(wanted="{:g} to {:g}".format(*o.wanted)) for o in result)
    write_text(args.output / "coverage.csv", table.to_csv(index=False, float_format="%.4f"))
    return 1 if any(o.outcome == "outside" for o in result) else 0


if __name__ == "__main__":
    raise SystemExit(main())

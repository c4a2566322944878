"""Coverage: how often the 95 % intervals of a comparison hold, over collections whose budgets are known to be true.

    python validation/coverage/study.py [--collections 400] [--spectra 1000] [--maps 1000] [--output DIR]

Writes coverage.csv and coverage.json: for every product the share of comparisons whose stated interval of predicted
minus measured holds 0, and how often the consistency test rejects true cases and tilted ones.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from intervals import exact, shares
from world import AXIS, HIGH, LOW, PANEL_SIDE, SITE, Collection, collect, engine, scenario, tilt, truth
from world import B as BANDS

from hyperval.compare import compare_products
from hyperval.files import write_text
from hyperval.observe.uncertainty import spectral_estimate
from hyperval.predict import Origins, predict
from hyperval.processing.elm import PanelMeasurement, fit_elm
from hyperval.processing.elm_error import PanelErrors, line_error
from hyperval.processing.intervals import clopper_pearson
from hyperval.processing.mean_error import (
    components,
    independent_pixels,
    mean_error_covariance,
    small_sample_factor,
)
from hyperval.processing.roc import empirical_roc, with_summary
from hyperval.processing.snr import snr_decorrelated
from hyperval.processing.spatial_correlation import neighbour_shares
from hyperval.products import EstimatedPart, ObjectScores, Observation, Prediction
from hyperval.progress import track
from hyperval.results import Result
from hyperval.scene.builtin import builtin_class

Array = npt.NDArray[np.float64]

ELM_RELATIVE, ELM_NM = 0.01, 500.0  # what the campaign says of its panels
TILT = 0.03
ALPHA = 0.05
FALSE_ALARMS = (1e-2, 1e-3)
METHODS = ("linear", "monte-carlo")
LOOKED_FOR = builtin_class("yellow-paint-plank", AXIS).mean


def predictions(samples: int) -> dict[str, Prediction]:
    """What is predicted, by both ways of propagation."""
    return {m: predict(scenario(m, samples), Origins(axis=AXIS, engine=engine), objects=True) for m in METHODS}


def observed(c: Collection) -> Observation:
    """What a campaign would measure on the pixels of a collection."""
    mean, spread = c.field.reshape(-1, BANDS).mean(axis=0), np.cov(c.field.reshape(-1, BANDS).T)
    sampling = _field_error(c.field, mean, spread)
    bright = c.bright.mean(axis=0)
    n = PANEL_SIDE**2
    by_pixel = np.cov(c.bright.T) / n
    radiance = {
        "field": spectral_estimate(mean, {"sampling": sampling.covariance}, n=SITE**2, estimated=[sampling]),
        "bright": spectral_estimate(
            bright, {"sampling": by_pixel}, n=n, estimated=[EstimatedPart(by_pixel, n - 1.0)]
        ),
    }
    panels, errors = [], []
    shape = np.exp(-0.5 * (np.subtract.outer(AXIS.centre_nm, AXIS.centre_nm) / ELM_NM) ** 2)
    for name, rho, pixels in (("low", LOW, c.low), ("high", HIGH, c.high)):
        cov = np.cov(pixels.T) / n
        sd = np.full(BANDS, ELM_RELATIVE * rho)
        panels.append(PanelMeasurement(name, np.full(BANDS, rho), sd, pixels.mean(axis=0), np.diag(cov), n))
        errors.append(PanelErrors(np.outer(sd, sd) * shape, cov))
    line = fit_elm(panels)
    error = line_error(fit_elm, panels, errors, line)
    k = np.outer(line.gain, line.gain)
    reflectance = {
        "field": spectral_estimate(
            line.reflectance(mean),
            {"sampling": sampling.covariance / k, "empirical line": error.covariance(mean)},
            n=SITE**2,
            estimated=[sampling.of_each(lambda covariance: covariance / k)],
        )
    }
    roc, objects = {}, {}
    if c.background.size:
        scores = [_scores(line.reflectance(x), line.reflectance(c.background)) for x in (c.targets, c.background)]
        curve = empirical_roc(*scores)
        roc["plank", "cem", "pixel"] = with_summary(curve, *scores, draws=200)
        objects["plank", "cem"] = ObjectScores(scores[0], tuple(str(i) for i in range(scores[0].size)))
    snr = {"bright": snr_decorrelated(c.bright)}
    return Observation(AXIS, radiance, snr, reflectance, roc=roc, object_scores=objects)


def _field_error(field: Array, mean: Array, covariance: Array) -> EstimatedPart:
    """Sampling error of the mean with its degrees of freedom, as the pipeline has it."""
    along = components(covariance, np.random.default_rng(0))
    inside = np.ones(field.shape[:2], bool)
    reach = min(field.shape[0] - 1, 24)
    shares = neighbour_shares(inside, reach, np.random.default_rng(0))
    independent, of_variance = independent_pixels(
        [(along.scores(field - mean), inside)], shares, inside.size, reach
    )
    plain, widened = (
        mean_error_covariance(covariance, along, by)
        for by in (independent, independent / small_sample_factor(independent))
    )
    return EstimatedPart(widened, float(np.median(of_variance)) - 1.0, plain)


def _scores(x: Array, background: Array) -> Array:
    """Unit-response matched filter (3.22-3.25) on the spectrum that the library states."""
    mean, covariance = background.mean(axis=0), np.cov(background.T)
    d = LOOKED_FOR - mean
    w = np.linalg.solve(covariance, d)
    return np.asarray((x - mean) @ w / (d @ w))


@dataclass(frozen=True)
class Outcome:
    """Share of comparisons in which something held, with its exact interval as if all were independent.

    ``wanted`` is the range in which the share is to lie.
    """

    product: str
    subject: str
    what: str
    method: str
    share: float
    lower: float
    upper: float
    comparisons: int
    collections: int
    wanted: tuple[float, float]

    @property
    def met(self) -> bool:
        """Whether the exact interval of the share reaches into where it is to lie."""
        return self.upper >= self.wanted[0] and self.lower <= self.wanted[1]


COVERED, REJECTED, FOUND = (0.92, 0.98), (0.03, 0.07), (0.90, 1.0)


def outcomes(
    p: dict[str, Prediction], collections: int, spectra: int, seed: int, show: bool | None
) -> list[Outcome]:
    """Compare ``spectra`` collections, of which the first ``collections`` have pixels for the detectors too."""
    held: dict[tuple[str, str, str, str], list[float]] = {}
    runs: dict[tuple[str, str, str, str], int] = {}

    def note(key: tuple[str, str, str, str], values: Iterable[float]) -> None:
        got = [v for v in values if np.isfinite(v)]
        held.setdefault(key, []).extend(got)
        runs[key] = runs.get(key, 0) + bool(got)

    for i in track(range(spectra), "collections", show=show):
        rng = np.random.default_rng([seed, i])
        t = truth(rng)
        o = observed(collect(t, rng, detection=i < collections))
        for method, prediction in p.items():
            rows = compare_products(prediction, o, campaign="coverage", method=method)
            for product, subject in (
                ("radiance", "field"),
                ("radiance", "bright"),
                ("reflectance", "field"),
                ("snr", "bright"),
            ):
                mine = [r for r in rows if (r.product, r.subject) == (product, subject)]
                note((product, subject, "95 % interval", method), _ratio_held(mine))
                if product != "snr":
                    note((product, subject, "full test rejects", method), _rejected(mine))
            if i < collections:
                mine = [r for r in rows if r.product == "roc" and r.method == "cem/pixel"]
                for pfa in FALSE_ALARMS:
                    label = f"@{pfa:.0e}".replace("e-0", "e-")
                    inside = [r.value for r in mine if r.metric == f"pd_inside_interval{label}"]
                    note(("P_D", "plank", f"95 % interval at {pfa:g}", method), inside)
                note(("AUC", "plank", "95 % interval", method), _area_held(mine))
                inside = [r.value for r in rows if (r.subject, r.metric) == ("plank", "objects_inside_95")]
                note(("scores", "plank", "object inside its 95 % interval", method), inside)
        tilted = observed(collect(t, np.random.default_rng([seed, i, 1]), detection=False, extra=tilt(TILT)))
        rows = compare_products(p["linear"], tilted, campaign="coverage", method="linear")
        mine = [r for r in rows if (r.product, r.subject) == ("radiance", "bright")]
        note(("radiance", "bright", f"full test rejects {100 * TILT:g} % tilt", "linear"), _rejected(mine))
    return [_outcome(key, np.array(values), runs[key]) for key, values in held.items()]


def interval_outcomes(worlds: int, seed: int) -> list[Outcome]:
    """Intervals of the background, of curves, areas and eigenvalues: :mod:`intervals`."""
    out = []
    for (what, clustered), (inside, count) in shares(worlds, seed).items():
        low, high = exact(inside, count)
        kind = "clusters" if clustered else "independent"
        out.append(Outcome("interval", kind, what, "pixels", inside / count, low, high, count, count, COVERED))
    return out


def _ratio_held(rows: list[Result]) -> list[float]:
    """Whether 0 lies in the interval of the difference ratio, band by band."""
    return [
        float(r.lower <= 0.0 <= r.upper) for r in rows if r.metric == "difference_ratio" and np.isfinite(r.value)
    ]


def _rejected(rows: list[Result]) -> list[float]:
    return [float(r.value < ALPHA) for r in rows if r.metric == "p_value_full"]


def _area_held(rows: list[Result]) -> list[float]:
    return [float(r.lower <= 0.0 <= r.upper) for r in rows if r.metric == "auc_difference" and np.isfinite(r.lower)]


def _outcome(key: tuple[str, str, str, str], values: Array, collections: int) -> Outcome:
    count = values.size
    low, high = clopper_pearson(values.sum(), count)
    what = key[2]
    wanted = FOUND if "tilt" in what else REJECTED if "rejects" in what else COVERED
    return Outcome(*key, float(values.mean()), float(low), float(high), count, collections, wanted)


def main() -> int:
    """Run the study; 1 where a share is not where it is to lie."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--collections", type=int, default=400)
    parser.add_argument("--spectra", type=int, default=1000)
    parser.add_argument("--maps", type=int, default=1000)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--output", type=Path, default=Path("reports/coverage"))
    args = parser.parse_args()
    found = interval_outcomes(args.maps, args.seed)
    found += outcomes(predictions(args.draws), args.collections, args.spectra, args.seed, None)
    names = [*asdict(found[0]), "met"]
    lines = [",".join(names)]
    for o in found:
        values = {**asdict(o), "met": o.met, "wanted": f"{o.wanted[0]:g} to {o.wanted[1]:g}"}
        lines.append(",".join(f"{v:.4f}" if isinstance(v, float) else str(v) for v in values.values()))
        verdict = "" if o.met else "NOT MET"
        print(f"{o.product:12} {o.subject:11} {o.what:32} {o.method:12} {o.share:.3f} ({o.collections}) {verdict}")
    args.output.mkdir(parents=True, exist_ok=True)
    write_text(args.output / "coverage.csv", "\n".join(lines) + "\n")
    record = {"seed": args.seed, "draws": args.draws, "outcomes": [{**asdict(o), "met": o.met} for o in found]}
    write_text(args.output / "coverage.json", json.dumps(record, indent=1) + "\n")
    return 0 if all(o.met for o in found) else 1


if __name__ == "__main__":
    raise SystemExit(main())

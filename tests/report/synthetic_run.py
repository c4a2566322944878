"""Invented runs for the tests of the report: shaped like real ones, true of nothing."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import beta, norm

from hyperval import products
from hyperval.results import Outcome, Result, ResultTable, Role
from hyperval.run import Quicklook, Run, ScoreMap
from hyperval.spectra import SpectralAxis

NASTY = "<script>alert('x')</script> & $\\bad$"
GATE = {"role": Role.GATE, "outcome": Outcome.AGREES}


def axis(bands: int = 40) -> SpectralAxis:
    return SpectralAxis(np.linspace(400.0, 2450.0, bands), np.full(bands, 6.0))


def _estimate(w, level, rng, *, relative, n, shift=0.0):
    planck = (w / 500.0) ** -4.0 / (np.exp(2.5 * 1000.0 / w) - 1.0)
    dark = 1.0 - 0.995 * np.exp(-0.5 * ((w[:, None] - [1400.0, 1900.0]) / 60.0) ** 2).sum(axis=1)
    mean = 12.0 * planck / planck.max() * dark * level * (1.0 + shift) * (1.0 + 0.004 * rng.standard_normal(w.size))
    budget = {
        "aerosol": mean * relative * 0.8 * (w / 400.0) ** -0.8,
        "water vapour": mean * relative * (0.1 + 2.0 * np.exp(-0.5 * ((w - 1135) / 30) ** 2)),
        "calibration": mean * relative * 0.5,
    }
    error = sum(np.outer(u, u) for u in budget.values())
    shapes = np.stack([mean * np.cos(k * w / 700.0) for k in range(8)])
    pixel = (shapes.T * (0.03**2 * 0.25 ** np.arange(8))) @ shapes + np.diag((0.002 + 0.004 * mean) ** 2)
    return products.SpectralEstimate(mean, error, pixel, n, budget)


def _roc(separation, n_target, unit, rng):
    pfa = np.logspace(-6, 0, 61)
    exact, low, high = (norm.sf(norm.isf(pfa) - separation + shift) for shift in (0.0, 0.5, -0.5))
    predicted = products.RocCurve(pfa, exact, low, high, norm.isf(pfa), unit)
    scores = rng.standard_normal(n_target) + separation
    hits = np.array([(scores > t).sum() for t in norm.isf(pfa)])
    low = np.nan_to_num(beta.ppf(0.025, hits, n_target - hits + 1), nan=0.0)
    high = np.nan_to_num(beta.ppf(0.975, hits + 1, n_target - hits), nan=1.0)
    measured = products.RocCurve(pfa, hits / n_target, low, high, norm.isf(pfa), unit, n_target, 12203, 0.02)
    return predicted, measured


def make_run(
    *,
    bands: int = 40,
    subjects: Sequence[str] = ("white panel", "grass"),
    curves: int = 3,
    simulated: bool = True,
    shape: tuple[int, int] = (60, 90),
    rows: Sequence[Result] = (),
    campaign: str = "invented",
) -> Run:
    """A whole run; ``rows`` are appended to its table."""
    rng = np.random.default_rng(4)
    ax = axis(bands)
    w = ax.centre_nm
    names = ("radiance", "snr", "reflectance", "scores", "roc", "abundance")
    p, o = ({name: {} for name in names} for _ in range(2))
    table = ResultTable()
    for i, name in enumerate(subjects):
        level = 0.8 / (1 + i)
        p["radiance"][name] = _estimate(w, level, rng, relative=0.03, n=None)
        o["radiance"][name] = _estimate(w, level, rng, relative=0.015, n=150 + 500 * i, shift=0.01 + 0.01 * i)
        for side in (p, o):
            mean = 30 * np.sqrt(side["radiance"][name].mean + 0.01) * (1 + 0.05 * (side is o))
            side["snr"][name] = products.SpectralEstimate(mean, np.diag((0.06 * mean) ** 2), None, 150)
            mean = level * (1 + 0.2 * np.sin(w / 300.0)) + 0.01 * rng.standard_normal(w.size)
            side["reflectance"][name] = products.SpectralEstimate(mean, 0.01**2 * np.eye(w.size), None, 200)
        ratio = p["radiance"][name].mean / o["radiance"][name].mean - 1
        amiss = {} if i % 3 != 1 else {"outcome": Outcome.DISAGREES, "reason": "the budget does not explain it"}
        half = float(np.median(np.abs(ratio)))
        own = campaign, "radiance", name, "6S"
        table += [
            Result(
                *own, "median_abs_difference_ratio_windows", half, lower=0.004, upper=0.031, limit_high=0.06, **GATE
            ),
            Result(*own, "p_value_full", 0.31 / (1 + i), n=bands, limit_low=0.05, **amiss),
            *(Result(*own, "difference_ratio", float(r), band_nm=float(b)) for b, r in zip(w, ratio, strict=True)),
        ]
    targets = [f"plank {i + 1}, fill {1 - 0.08 * i:.2f}" for i in range(curves)]
    for i, name in enumerate(targets):
        key, unit, count = (name, "CEM"), "object" if i % 2 else "pixel", 20 + 3 * i
        p["roc"][*key, unit], o["roc"][*key, unit] = _roc(4.5 - 0.35 * i, count, unit, rng)
        p["scores"][key] = products.ScoreDistribution(1 - 0.08 * i, 0.1)
        o["scores"][key] = products.ScoreDistribution(0.97 - 0.08 * i, 0.12, count)
        p["abundance"][key] = products.Abundance(9.0 / 2**i, 0.4 / 2**i)
        o["abundance"][key] = products.Abundance(8.2 / 2**i, 0.6 / 2**i, 40)
        limits = {"lower": -0.1, "upper": 0.15, "n": count, "limit_high": 0.2}
        table.append(Result(campaign, "roc", *key, "pd_difference@1e-3", 0.02 * i, **limits, **GATE))
    for side, n in ((p, None), (o, 12203)):
        side["scores"]["background", "CEM"] = products.ScoreDistribution(0.0, 0.08, n)
    skipped = {"role": Role.GATE, "outcome": Outcome.SKIPPED, "reason": "no truth: `hyperval data fetch x` brings it"}
    table += [Result(campaign, "roc", "green planks", "ACE", "pd_difference@1e-3", **skipped), *rows]
    lines, samples = shape
    y, x = np.mgrid[:lines, :samples]
    corners = [(int(lines * (0.1 + 0.8 * i / curves)), int(samples * (0.15 + 0.25 * (i % 3)))) for i in range(curves)]
    masks = {
        name: (y >= top) & (y < top + 3) & (x >= left) & (x < left + 5)
        for name, (top, left) in zip(targets, corners, strict=True)
    }
    score = rng.standard_normal(shape) * 0.08 + sum(0.9 * mask for mask in masks.values())
    grey = np.clip(90 + 40 * np.sin(x / 9) + rng.normal(0, 8, shape), 0, 255).astype(np.uint8)
    regions = {"asphalt": (x > samples * 0.6) & (y < lines * 0.4), "grass": (x < samples * 0.4) & (y > lines * 0.6)}
    cube = {"reference": "data:invented/cube.img", "sha256": "ab" * 32, "licence": "CC0"}
    engine = {"notes": ("Thermal emission is left out.",), "provenance": {"engine": "6S"}}
    sides = {"predicted": products.PredictedProducts(ax, **p, **engine), "observed": products.ObservedProducts(ax, **o)}
    return Run(
        table, products=sides, campaign=campaign, title="Planks on a court", simulated=simulated,
        description="Invented spectra in the shape of a small campaign.",
        score_maps={
            "yellow planks-CEM": ScoreMap(score, (0.5, 0, 287000.0, 0, -0.5, 4781000.0), "EPSG:32618", masks, 0.5),
            "yellow planks-ACE": ScoreMap(np.where(score > 1, np.nan, score)),
        },
        quicklook=Quicklook(np.stack([grey] * 3, axis=-1), regions | masks, "640, 550, 460 nm", 0.5),
        provenance={
            "inputs": [cube | {"citation": "Nobody (2012), https://example.org/cube"}], "seed": 7,
            "versions": {"numpy": "2.0"}, "command": "hyperval validate campaign.yaml", "formulation": "corrected",
        },
        notes=("The aerosol is continental.", "The absorption bands are left out of every summary."),
        references=("Kerekes and Baum (2002), IEEE TGRS 40(5).",),
    )  # fmt: skip

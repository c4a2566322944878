"""Invented runs for the tests of the report: shaped like real ones, true of nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyperval.figures import Quicklook, ScoreMap
from hyperval.products import (
    Abundance,
    ObservedProducts,
    PredictedProducts,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.report import RunReport
from hyperval.results import Outcome, Result, ResultTable, Role
from hyperval.spectra import SpectralAxis

NASTY = "<script>alert('x')</script> & $\\bad$"


def axis(bands: int = 40) -> SpectralAxis:
    return SpectralAxis(np.linspace(400.0, 2450.0, bands), np.full(bands, 6.0))


def _sun(w):
    absorbed = 1.0
    for centre, width, depth in (
        (760, 5, 0.6),
        (940, 30, 0.7),
        (1130, 35, 0.8),
        (1400, 50, 0.995),
        (1900, 70, 0.995),
    ):
        absorbed = absorbed * (1 - depth * np.exp(-0.5 * ((w - centre) / width) ** 2))
    planck = (w / 500.0) ** -4.0 / (np.exp(2.5 * 1000.0 / w) - 1.0)
    return 12.0 * planck / planck.max() * absorbed


def _estimate(w, level, rng, *, relative, n, shift=0.0):
    mean = _sun(w) * level * (1.0 + shift) * (1.0 + 0.004 * rng.standard_normal(w.size))
    budget = {
        "aerosol": mean * relative * 0.8 * (w / 400.0) ** -0.8,
        "water vapour": mean * relative * (0.1 + 2.0 * np.exp(-0.5 * ((w - 1135) / 30) ** 2)),
        "calibration": mean * relative * 0.5,
        "field spectrum": mean * relative * 0.3,
    }
    error = sum(np.outer(u, u) for u in budget.values())
    shapes = np.stack([mean * np.cos(k * w / 700.0) for k in range(8)])
    pixel = (shapes.T * (0.03**2 * 0.25 ** np.arange(8))) @ shapes + np.diag((0.002 + 0.004 * mean) ** 2)
    return SpectralEstimate(mean, error, pixel, n, budget)


def _reflectance(w, level, rng, shift=0.0):
    mean = level * (1 + 0.2 * np.sin(w / 300.0)) + shift
    u = 0.01 + 0.3 * np.exp(-0.5 * ((w - 1400) / 40) ** 2) + 0.3 * np.exp(-0.5 * ((w - 1900) / 60) ** 2)
    return SpectralEstimate(mean + u * rng.standard_normal(w.size) * 0.5, np.diag(u**2), None, 200)


def _roc(separation, n_target, n_background, unit, rng):
    from scipy.stats import beta, norm

    pfa = np.logspace(-6, 0, 61)
    exact = norm.sf(norm.isf(pfa) - separation)
    predicted = RocCurve(pfa, exact, norm.sf(norm.isf(pfa) - separation + 0.5),
                         norm.sf(norm.isf(pfa) - separation - 0.5), norm.isf(pfa), unit)  # fmt: skip
    scores = np.sort(rng.standard_normal(n_target) + separation)
    hits = np.array([(scores > t).sum() for t in norm.isf(pfa)])
    low = np.nan_to_num(beta.ppf(0.025, hits, n_target - hits + 1), nan=0.0)
    high = np.nan_to_num(beta.ppf(0.975, hits + 1, n_target - hits), nan=1.0)
    measured = RocCurve(pfa, hits / n_target, low, high, norm.isf(pfa), unit, n_target, n_background, 0.02)
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
) -> RunReport:
    """A whole run; ``rows`` are appended to its table."""
    rng = np.random.default_rng(4)
    ax = axis(bands)
    w = ax.centre_nm
    p: dict = {"radiance": {}, "snr": {}, "reflectance": {}, "scores": {}, "roc": {}, "abundance": {}}
    o: dict = {"radiance": {}, "snr": {}, "reflectance": {}, "scores": {}, "roc": {}, "abundance": {}}
    table = ResultTable()
    for i, name in enumerate(subjects):
        level = 0.8 / (1 + i)
        p["radiance"][name] = _estimate(w, level, rng, relative=0.03, n=None)
        o["radiance"][name] = _estimate(w, level, rng, relative=0.015, n=150 + 500 * i, shift=0.01 + 0.01 * i)
        for side in (p, o):
            mean = 30 * np.sqrt(side["radiance"][name].mean + 0.01) * (1 + 0.05 * (side is o))
            side["snr"][name] = SpectralEstimate(mean, np.diag((0.06 * mean) ** 2), None, 150)
            side["reflectance"][name] = _reflectance(w, level, rng, 0.01 * (side is o))
        ratio = p["radiance"][name].mean / o["radiance"][name].mean - 1
        outcome = Outcome.AGREES if i % 3 != 2 else Outcome.DISAGREES
        table.add(
            Result(campaign, "radiance", name, "6S", "median_abs_difference_ratio_windows",
                   float(np.median(np.abs(ratio))), "1",
                   lower=0.004, upper=0.031, n=bands, limit_high=0.06, role=Role.GATE, outcome=outcome,
                   reason="" if outcome is Outcome.AGREES else "outside the budget of the prediction"),
            Result(campaign, "radiance", name, "6S", "p_value_full", 0.31 / (1 + i), n=bands, limit_low=0.05,
                   outcome=Outcome.NONE if i % 3 != 1 else Outcome.DISAGREES,
                   reason="" if i % 3 != 1 else "the budget does not explain the difference"),
        )  # fmt: skip
        table.add(*(Result(campaign, "radiance", name, "6S", "difference_ratio", float(r), "1", band_nm=float(b))
                    for b, r in zip(w, ratio, strict=True)))  # fmt: skip
    names = [f"plank {i + 1}, fill {1 - 0.08 * i:.2f}" for i in range(curves)]
    for i, name in enumerate(names):
        unit = "object" if i % 2 else "pixel"
        predicted, measured = _roc(4.5 - 0.35 * i, 20 + 3 * i, 12203, unit, rng)
        p["roc"][name, "CEM", unit], o["roc"][name, "CEM", unit] = predicted, measured
        p["scores"][name, "CEM"] = ScoreDistribution(1 - 0.08 * i, 0.1)
        o["scores"][name, "CEM"] = ScoreDistribution(0.97 - 0.08 * i, 0.12, 20 + 3 * i)
        p["abundance"][name, "CEM"] = Abundance(9.0 / 2**i, 0.4 / 2**i)
        o["abundance"][name, "CEM"] = Abundance(8.2 / 2**i, 0.6 / 2**i, 40)
        table.add(Result(campaign, "roc", name, "CEM", "pd_difference@1e-3", 0.02 * i, "1", lower=-0.1,
                         upper=0.15, n=20 + 3 * i, limit_high=0.2, role=Role.GATE,
                         outcome=Outcome.AGREES))  # fmt: skip
    for side in (p, o):
        side["scores"]["background", "CEM"] = ScoreDistribution(0.0, 0.08, 12203 if side is o else None)
    table.add(Result(campaign, "roc", "green planks", "ACE", "pd_difference@1e-3",
                     role=Role.GATE, outcome=Outcome.SKIPPED,
                     reason="no truth: `hyperval data fetch x` brings it"))  # fmt: skip
    table.add(*rows)
    lines, samples = shape
    y, x = np.mgrid[:lines, :samples]
    masks = {}
    for i, name in enumerate(names):
        top, left = int(lines * (0.1 + 0.8 * i / max(len(names), 1))), int(samples * (0.15 + 0.25 * (i % 3)))
        masks[name] = (y >= top) & (y < top + 3) & (x >= left) & (x < left + 5)
    score = rng.standard_normal(shape) * 0.08 + sum(m * (0.9 - 0.05 * i) for i, m in enumerate(masks.values()))
    rgb = np.clip(90 + 40 * np.sin(x / 9)[..., None] * [0.4, 1.0, 0.5] + rng.normal(0, 8, (*shape, 3)), 0, 255)
    regions = {"asphalt": (x > samples * 0.6) & (y < lines * 0.4), "grass": (x < samples * 0.4) & (y > lines * 0.6)}
    return RunReport(
        campaign=campaign,
        title="Planks on a court",
        description="Invented spectra in the shape of a small campaign.",
        simulated=simulated,
        table=table,
        prediction=PredictedProducts(ax, **p, notes=("Thermal emission is left out.",), provenance={"engine": "6S"}),
        observation=ObservedProducts(ax, **o),
        score_maps={
            "yellow planks-CEM": ScoreMap(score, (0.5, 0, 287000.0, 0, -0.5, 4781000.0), "EPSG:32618", masks, 0.5),
            "yellow planks-ACE": ScoreMap(np.where(score > 1, np.nan, score)),
        },
        quicklook=Quicklook(rgb.astype(np.uint8), regions | masks, (640.0, 550.0, 460.0), 0.5),
        provenance={
            "inputs": [
                {"reference": "data:invented/cube.img", "sha256": "ab" * 32, "licence": "CC0",
                 "citation": "Nobody (2012), https://example.org/cube"},
                {"reference": "campaign.yaml", "sha256": "cd" * 32, "licence": "BSD-3-Clause", "citation": ""},
            ],
            "versions": {"numpy": "2.0"}, "command": "hyperval validate campaign.yaml", "seed": 7,
            "formulation": "corrected",
        },
        notes=("The aerosol is continental.", "The absorption bands are left out of every summary."),
        references=("Kerekes and Baum (2002), IEEE TGRS 40(5).",),
    )  # fmt: skip

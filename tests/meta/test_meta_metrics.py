"""The table of metrics: its functions are there, its examples run, its page is current, its evidence is true."""

import doctest
import math
import pkgutil
import re
import runpy
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hyperval
from hyperval import products
from hyperval.cli import app
from hyperval.compare import compare_products, whitening
from hyperval.metrics import Evidence, Kind, Metric, metric_of, table
from hyperval.spectra import SpectralAxis

ROOT = Path(__file__).resolve().parents[2]
METRICS = list(table().values())


def function_of(metric: Metric):
    """What the table names: a module and one of its names."""
    return pkgutil.resolve_name(f"hyperval.{metric.function}")


# Rows that say that something could not be made: they have no number.
MARKS = {"comparison", "benchmark", "rank", "baseline", "runs", "sensor_check"}


def anchors(page: str) -> set[str]:
    """The anchors of a page's headings, as the pages' readers make them."""
    headings = re.findall(r"^#+ (.+)$", (ROOT / page).read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.name)
def test_every_metric_has_its_function_and_a_reference_that_leads_somewhere(metric):
    assert function_of(metric) is not None
    assert metric.words
    assert bool(metric.formula) == (metric.name not in MARKS)
    assert re.search(r"\d{4}|docs/|e-Handbook", metric.reference), "a paper with its year, a standard, or a page"
    for page, anchor in re.findall(r"(docs/[\w-]+\.md)#([\w-]+)", metric.reference):
        assert anchor in anchors(page)
    assert metric.reference.count("docs/") == metric.reference.count(".md#")
    assert all(1 <= int(number) <= 33 for number in re.findall(r"\(3\.(\d+)\)", metric.reference))


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.name)
def test_what_gates_can_be_judged(metric):
    assert metric.low < metric.high
    if metric.kind is Kind.QUANTITY and not math.isnan(metric.agreement):
        assert metric.low <= metric.agreement <= metric.high
    assert (metric.kind is Kind.TEST) or not metric.two_sided
    assert math.isnan(metric.alternative) == (not metric.departure)


@pytest.mark.parametrize("metric", [m for m in METRICS if not math.isnan(m.gives)], ids=lambda m: m.name)
def test_every_example_gives_what_it_says(metric):
    names = {"np": np, "whitening": whitening, metric.function.rpartition(".")[2]: function_of(metric)}
    assert float(eval(metric.example, names)) == pytest.approx(metric.gives, rel=1e-6)  # noqa: S307 - our own table


@pytest.mark.parametrize("metric", [m for m in METRICS if not m.example], ids=lambda m: m.name)
def test_every_other_function_has_an_example(metric):
    """Which runs with those of all docstrings, below."""
    assert function_of(metric).__module__.startswith("hyperval.")
    assert ">>> " in function_of(metric).__doc__


def test_every_example_of_a_docstring_gives_what_it_says(monkeypatch):
    """Those of the API run where a user's files are (tests/test_api.py); doctest itself finds no cached properties."""
    names = [m.name for m in pkgutil.walk_packages(hyperval.__path__, "hyperval.") if m.name != "hyperval.__main__"]
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    modules = [pkgutil.resolve_name(n) for n in names if ".api" not in n]
    for module in modules:
        own = [c for c in vars(module).values() if isinstance(c, type) and c.__module__ == module.__name__]
        cached = [v.func for c in own for v in vars(c).values() if isinstance(v, cached_property)]
        monkeypatch.setattr(module, "__test__", {f.__qualname__: f for f in cached}, raising=False)
    tried = {module.__name__: doctest.testmod(module, optionflags=flags) for module in modules}
    assert (sum(r.attempted for r in tried.values()) > 150, [n for n, r in tried.items() if r.failed]) == (True, [])


def test_every_command_given_as_an_example_is_one_and_has_such_rows():
    accepted = "\n".join(p.read_text("utf-8") for p in (ROOT / "validation" / "baselines").rglob("*.yaml"))
    commands = {m.example: m for m in METRICS if m.example and math.isnan(m.gives)}
    for example in commands:
        name, verb, *rest = example.split()
        assert name == "hyperval"
        assert verb in {command.callback.__name__ for command in app.registered_commands} | {"sensor"}
        assert rest[-1] == "hyperion" or (ROOT / rest[-1]).is_file(), example
    for metric in METRICS:
        if metric.example.startswith("hyperval check") and metric.name not in MARKS:
            assert metric.name.strip("*_") in accepted, metric.name


def test_the_page_has_every_metric():
    page = runpy.run_path(str(ROOT / "scripts" / "metrics_page.py"))["page"]()
    assert sorted(re.findall(r"^### `(.+)`$", page, re.MULTILINE)) == sorted(m.name for m in METRICS)


AXIS = SpectralAxis(np.arange(450.0, 900.0, 25.0), 10.0)
BANDS = len(AXIS)
RNG = np.random.default_rng(8)


def spectrum(noise: float = 0.0, n: int | None = 400) -> products.SpectralEstimate:
    """A tilted spectrum with noise of its own."""
    mean = np.linspace(1.0, 2.0, BANDS) * (1.0 + noise * RNG.standard_normal(BANDS))
    spread = 0.01 * np.exp(-np.abs(np.subtract.outer(np.arange(BANDS), np.arange(BANDS))) / 4.0)
    return products.SpectralEstimate(mean, 1e-4 * np.eye(BANDS), spread + 1e-3 * np.eye(BANDS), n)


def curve(top: float, measured: bool) -> products.RocCurve:
    """A rising curve; a measured one knows its counts."""
    pfa = np.array([1e-4, 1e-3, 1e-2, 1e-1, 1.0])
    pd = np.clip(top * np.array([0.3, 0.5, 0.7, 0.9, 1.0 / top]), 0.0, 1.0)
    if not measured:
        return products.RocCurve(pfa, pd, pd - 0.02, np.minimum(pd + 0.02, 1.0), -pfa, "pixel", preset_pfa=pfa / 2)
    return products.RocCurve(
        pfa, pd, pd - 0.1, np.minimum(pd + 0.1, 1.0), -pfa, "pixel", 40, 100_000,
        alarms=np.round(pfa * 100_000).astype(int), background_area_km2=0.4,
        areas={
            name: products.AreaEstimate(0.8, 0.7, 0.9, "placements")
            for name in ("auc", "partial_auc@0..1e-2", "log_auc@1e-3..1e-1")
        },
        at_detection=(products.AlarmsAtDetection(0.5, -1e-3, 100, 1e-3, 1e-4, 1e-2, 1e-4, 1e-2),),
    )  # fmt: skip


def sides() -> tuple[products.PredictedProducts, products.ObservedProducts]:
    """Every product on both sides, none of them equal."""
    draws = {k: 0.3 * i + 0.1 * RNG.standard_normal((50, 80)) for i, k in enumerate("abc")}
    x = np.linspace(0.0, 4.0, 60)
    fall = np.exp(-x)
    target, mixed, spectra = ("t", "cem"), ("tape", "cem"), ("radiance", "snr", "reflectance", "toa_reflectance")
    predicted = products.PredictedProducts(
        AXIS,
        **{name: {"g": spectrum()} for name in spectra},
        roc={(*target, "pixel"): curve(0.9, False)}, scores={target: products.ScoreDistribution(1.0, 0.2)},
        abundance={
            target: products.Abundance(4.0, 0.2),
            mixed: products.Abundance(4.0, 0.0, modelled=False),
            **{(k, "fcls"): products.Abundance(1.1, 0.1, 4, 1.0) for k in "abc"},
        },
        object_scores={(k, "cem"): products.ObjectScores(values) for k, values in draws.items()},
        exceedance={target: products.ExceedanceCurve(x, fall, fall, fall)},
        distribution={"g": products.PixelDistribution(20.0, math.nan, math.nan, math.nan)},
        classification={
            ("g / h", "f"): products.ClassificationError(0.1, 0.09, 0.11, bound_lower=0.01, bound_upper=0.2)
        },
    )  # fmt: skip
    tails = products.PixelDistribution(
        30.0, 20.0, 60.0, 0.3, 6, 25.0, 18.0, 50.0, 3, n=400, effective_n=np.array([300.0, 320.0])
    )  # fmt: skip
    observed = products.ObservedProducts(
        AXIS,
        **{name: {"g": spectrum(0.02)} for name in spectra[:-1]},
        toa_reflectance={"g": replace(spectrum(0.02), stated=np.full(BANDS, 0.01))},
        roc={(*target, "pixel"): curve(0.8, True)}, scores={target: products.ScoreDistribution(0.9, 0.25, 50)},
        abundance={
            target: products.Abundance(3.8, 0.3, 20),
            mixed: products.Abundance(3.8, 0.3, 20),
            **{(k, "fcls"): products.Abundance(1.0 + 0.1 * i, 0.1, 4, 1.0) for i, k in enumerate("abc")},
        },
        object_scores={
            (k, "cem"): products.ObjectScores(np.array([0.3 * i + 0.05]), (k,)) for i, k in enumerate("abc")
        },
        exceedance={target: products.ExceedanceCurve(x, fall**1.1, fall**1.2, fall, 100_000)},
        distribution={"g": tails},
        classification={("g / h", "f"): products.ClassificationError(0.12, 0.1, 0.14, 400, 380.0)},
    )  # fmt: skip
    return predicted, observed


def brighter(s: products.SpectralEstimate) -> products.SpectralEstimate:
    tilt = np.linspace(1.2, 1.8, BANDS)
    spread = 2.25 * s.pixel_covariance + 0.01 * np.outer(tilt, tilt)
    return replace(s, mean=tilt * s.mean, error_covariance=2.25 * s.error_covariance, pixel_covariance=spread)


# A product whose every number is another: spectra brighter, scores + 1, probabilities and areas changed.
MOVED: dict[type, Callable[[Any], Any]] = {
    products.SpectralEstimate: brighter,
    products.RocCurve: lambda c: replace(c, pd=c.pd**1.5, pd_lower=c.pd_lower**1.5 - 0.01, pd_upper=c.pd_upper**1.5),
    products.ScoreDistribution: lambda s: replace(s, mean=s.mean + 1.0, sd=1.5 * s.sd),
    products.Abundance: lambda a: (
        products.Abundance(1.5 * a.area_m2, 3.0 * a.standard_uncertainty, a.n, a.nominal_m2) if a.modelled else a
    ),
    products.ObjectScores: lambda s: products.ObjectScores(s.values + 1.0),
    products.ExceedanceCurve: lambda c: replace(c, threshold=c.threshold + 1.0),
    products.PixelDistribution: lambda d: replace(d, tail_dof=6.0),
    products.ClassificationError: lambda e: replace(
        e, error=0.3, lower=0.2, upper=0.4, bound_lower=0.05, distance=2.0, approximation=0.3
    ),
}


def moved(predicted: products.PredictedProducts) -> products.PredictedProducts:
    """A prediction of other numbers."""
    held = {f.name: value for f in fields(predicted) if isinstance(value := getattr(predicted, f.name), dict)}
    return replace(predicted, **{n: {k: MOVED[type(v)](v) for k, v in values.items()} for n, values in held.items()})


# 1 or 0 by themselves: that they stay says nothing.  Their values are made of ones that move.
COARSE = {Kind.COVERAGE, Kind.EQUIVALENCE}


def test_a_row_of_the_model_moves_with_the_prediction_and_a_row_of_the_pipeline_does_not():
    predicted, observed = sides()
    before, after = (compare_products(p, observed, equivalence_margin=0.1) for p in (predicted, moved(predicted)))
    key = lambda r: str((r.product, r.subject, r.method, r.metric, r.band_nm))  # noqa: E731
    later = {key(row): row.value for row in after}
    still, restless, names = set(), set(), set()
    for row in (r for r in before if key(r) in later and not math.isnan(r.value)):
        names.add(metric_of(row.metric).name)
        same = row.value == pytest.approx(later[key(row)], rel=1e-9, abs=0.0, nan_ok=True)
        if row.evidence is Evidence.MODEL and same and metric_of(row.metric).kind not in COARSE:
            still.add((row.product, row.subject, row.metric))
        if row.evidence is Evidence.PIPELINE and not same:
            restless.add((row.product, row.subject, row.metric))
    assert not still, "they claim to be evidence of the model and do not move with it"
    assert not restless, "they claim to be checks of the pipeline and move with the prediction"
    assert len(names) > 60
    assert {r.evidence for r in before if r.subject == "tape"} == {Evidence.PIPELINE}

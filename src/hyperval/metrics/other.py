"""Metrics of whole comparisons, attributions, benchmarks, studies and accepted numbers."""

from __future__ import annotations

from hyperval.metrics.metric import Evidence, Kind, Metric, of_unit

_ATTRIBUTION = "uncertainty.attribution.run.attribution_rows"
_TEST = "uncertainty.attribution.ranking.Whitened"
_FREED = "uncertainty.attribution.ranking.explanation"
_WHAT_IF = "uncertainty.attribution.run.WhatIfOutcome"
_RANKS = "scoreboard.ranks.ranked"
_STUDY = "study.page.result_rows"
_EXTREMES = "study.page.extremes"
_WITH_WHAT_IFS = "hyperval validate campaigns/hysu-2018/campaign.yaml"
_CAMPAIGN = "hyperval validate campaigns/share2012-twin/campaign.yaml"
_BENCHMARK = "hyperval benchmark campaigns/hysu-2018/campaign.yaml"
_OF_STUDY = "hyperval study studies/planks.yaml"
_RATIO = of_unit(0.002)
_PIPELINE = Evidence.PIPELINE
_VECTOR = "defined here, docs/attribution.md#what-is-explained"
_COMPONENTS = "Patterson & Thompson, Biometrika 58, 545, 1971; docs/attribution.md#how-inputs-are-ranked"
_MOVES = "defined here, docs/attribution.md#sensitivity-to-the-inputs"
_WHAT_IFS = "defined here, docs/attribution.md#what-ifs"
_DETECTORS = "defined here, docs/benchmark.md#detectors"
_QUESTIONS = "defined here, docs/studies.md#what-is-asked"

METRICS = (
    Metric("comparison", "a whole comparison that could not be made", "compare.products.compare_products", unit="",
           example=_CAMPAIGN,
           reference="defined here, docs/statistics.md#outcomes"),
    Metric("*_fraction", "share of the rows of a pooled gate that meet its limit",
           "processing.intervals.clopper_pearson", "k / n", low=0.0, high=1.0, agreement=1.0,
           interval="exact binomial", tolerance=of_unit(0.02), short="share of the {product} inside its range",
           reference="Clopper & Pearson, Biometrika 26, 404, 1934", example="clopper_pearson(10, 10)[0]",
           gives=0.69150289),
    # Attribution and what-ifs.
    Metric("reduced_chi_square", "squared difference in units of its uncertainty over all products that the "
           "attribution joins, with the model's numerical error added: not the number of a single spectrum",
           _TEST, "r^T C^-1 r / n", low=0.0, agreement=1.0, kind=Kind.STATISTIC,
           short="residuals against their budget", reference=_VECTOR),
    Metric("p_value", "its p-value", _TEST, "P(chi2_n >= r^T C^-1 r)", low=0.0, high=1.0,
           kind=Kind.TEST, tolerance=of_unit(0.05), reference=_VECTOR),
    Metric("p_value_explained", "its p-value with the leading inputs freed", _FREED, low=0.0, high=1.0,
           kind=Kind.TEST, tolerance=of_unit(0.05), formula="P(chi2_n >= r^T (C + tau^2 g g^T)^-1 r)",
           reference=_COMPONENTS),
    Metric("likelihood_gain", "twice the log-likelihood gained by letting one input be less well known",
           _FREED, "sum x/(1 + x) q^2 - ln(1 + x), x = tau^2 s^2", low=0.0, reference=_COMPONENTS),
    Metric("needed_uncertainty",
           "uncertainty that one input would need, in units of its stated one or of a usual step", _FREED,
           "sqrt(1 + tau^2) where stated, else tau", low=0.0, reference=_COMPONENTS),
    Metric("*_change", "change of a number by one input or one run", _ATTRIBUTION, unit="",
           agreement=0.0, example=_CAMPAIGN, formula="x(z = 1) - x(z = 0)", reference=_MOVES),
    Metric("median_*_difference_ratio", "median difference ratio after a what-if", _WHAT_IF, agreement=0.0,
           tolerance=_RATIO, example=_WITH_WHAT_IFS, formula="median_b (p - c) / c", reference=_WHAT_IFS),
    Metric("mean_pd_at_*", "mean difference of detection probability after a what-if", _WHAT_IF, low=-1.0, high=1.0,
           agreement=0.0, example=_WITH_WHAT_IFS, formula="mean (P_p - P_o)", reference=_WHAT_IFS),
    # Benchmark.
    Metric("benchmark", "a campaign of a benchmark that did not run", "scoreboard.one.benchmark_campaign",
           example=_BENCHMARK, reference=_DETECTORS),
    Metric("rank", "detectors that could not be ranked", _RANKS, evidence=_PIPELINE, reference=_DETECTORS),
    Metric("rank_*",
           "rank of a detector by one metric; the interval is the set that the data do not refute at 95 %", _RANKS,
           low=1.0, better="low", interval="bootstrap of objects and blocks", evidence=_PIPELINE,
           formula="1 + detectors that are better", reference=_DETECTORS),
    Metric("first_*", "share of draws in which a detector is first by one metric", _RANKS, low=0.0, high=1.0,
           better="high", evidence=_PIPELINE, formula="share of draws in which none is better",
           reference=_DETECTORS),
    Metric("score_rank_correlation", "Spearman's correlation of a peer's score map with ours",
           "scoreboard.looks.peer_rows", low=-1.0, high=1.0, better="high", evidence=_PIPELINE, example=_BENCHMARK,
           formula="Pearson's correlation of the ranks", reference="Spearman, Am. J. Psychol. 15, 72, 1904"),
    # Studies.
    Metric("least", "least value over the points of a study", _EXTREMES, unit="", formula="min x",
           reference=_QUESTIONS),
    Metric("median", "median value over the points of a study", _EXTREMES, unit="", formula="median x",
           reference=_QUESTIONS),
    Metric("greatest", "greatest value over the points of a study", _EXTREMES, unit="", formula="max x",
           reference=_QUESTIONS),
    Metric("output", "value of an output of a study, the subject, at one point, the method", _STUDY, unit="",
           example=_OF_STUDY, formula="x", reference=_QUESTIONS),
    Metric("knee", "where a curve of a study bends most", "study.page.knee", unit="",
           formula="argmax |v''| / (1 + v'^2)^(3/2)", reference="Satopaa et al., ICDCS Workshops, 166, 2011"),
    Metric("error_at_held_out_states", "relative error of interpolated atmospheric terms at states left out",
           _STUDY, low=0.0, example=_OF_STUDY, formula="max |L / L_engine - 1|, of an output |x - x_engine|",
           reference="defined here, docs/studies.md#how-it-is-evaluated"),
    # Accepted numbers.
    Metric("baseline", "the accepted numbers of a campaign or sensor as a whole", "baseline.check.check",
           kind=Kind.EXACT, example="hyperval check --sensors hyperion",
           reference="defined here, docs/regression.md#what-is-kept"),
)  # fmt: skip

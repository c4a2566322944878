"""Metrics of scores, detection, false alarms and areas."""

from __future__ import annotations

import math

from hyperval.metrics.metric import Evidence, Kind, Metric, Move, of_unit, of_value

_SCORES = "compare.scores.compare_scores"
_OBJECTS = "compare.objects.judged_together"
_ROC = "compare.roc.compare_roc"
_ALARMS = "compare.roc.far_at_detection_rows"
_JOINT = "compare.roc.joint_rows"
_AREAS = "compare.objects.compare_abundance"
_ERRORS = "compare.objects.compare_area_errors"
_PIPELINE = Evidence.PIPELINE
_NEWCOMBE = "Newcombe, Stat. Med. 17, 873, 1998; Zou & Donner, Stat. Med. 27, 1693, 2008"
_DIFFERENCE = "compare.rows.difference_interval"
_AREA_FORMULA = "int P_D dx / int dx, x = P_FA or ln P_FA"
_COUNT: tuple[Move, Move] = ((0.8, "interval"), (0.005, "unit"))
_ALARM_COUNT: tuple[Move, Move] = ((0.8, "interval"), (0.01, "value"))
_PROBABILITY = of_unit(0.005)
_P = of_unit(0.05)
_FLAG = of_unit(0.0)
_AUC = of_unit(0.002)
_AREA = of_value(0.01)
_AFTER = "; after @ the false-alarm probability"
_MID_P = "mid-P binomial, and the threshold's"
_WIDTH = "object scores spread 1.5 times as widely about their medians"
_PER_KM2 = "km-2"
_MODEL = "(3.26)-(3.33), docs/model.md#processing"
_MOMENTS = "NIST/SEMATECH, e-Handbook of Statistical Methods, "
_TOGETHER = "defined here, docs/statistics.md#scores-and-areas"
_JUDGED = "defined here, docs/statistics.md#outcomes"
_CURVES = "defined here, docs/statistics.md#roc"
_TWO_CURVES = "defined here, docs/statistics.md#predicted-against-measured-roc"
_SCHUIRMANN = "Schuirmann, J. Pharmacokinet. Biopharm. 15, 657, 1987"
_BINOMIAL = "Lancaster, J. Am. Stat. Assoc. 56, 223, 1961"
_REGION = "Kerekes, IEEE Geosci. Remote Sens. Lett. 5, 251, 2008"
_DELONG = "DeLong et al., Biometrics 44, 837, 1988"
_UNMIXED = "Heinz & Chang, IEEE Trans. Geosci. Remote Sens. 39, 529, 2001"
_UNMIXING = "defined here, docs/statistics.md#unmixing"
_GUM = "JCGM 100:2008, 5.2"


def _flag(name: str, words: str, function: str, **more: object) -> Metric:
    """1 or 0: inside or outside an interval."""
    return Metric(name, words, function, low=0.0, high=1.0, kind=Kind.COVERAGE, tolerance=_FLAG, **more)  # type: ignore[arg-type]


def _areas(prefix: str, words: str, reference: str) -> tuple[Metric, ...]:
    """Predicted, measured and difference of one kind of area under the ROC."""
    function = "compare.roc.area_rows"
    return (
        Metric(f"{prefix}_predicted", f"{words}, predicted", function, _AREA_FORMULA, low=0.0, high=1.0,
               interval="band of the curve", tolerance=_AUC, reference=reference),
        Metric(f"{prefix}_measured", f"{words}, measured", function, _AREA_FORMULA, low=0.0, high=1.0,
               interval="placements or blocks", tolerance=_AUC, evidence=_PIPELINE, reference=reference),
        Metric(f"{prefix}_difference", f"{words}, predicted − measured", _DIFFERENCE, "p - o", low=-1.0, high=1.0,
               agreement=0.0, interval="Newcombe", tolerance=_AUC, reference=_NEWCOMBE,
               example="difference_interval(0.8, (0.7, 0.9), 0.5, (0.5, 0.5))[1]", gives=0.4),
    )  # fmt: skip


METRICS = (
    Metric("score_mean_predicted", "mean of the predicted detector scores", _SCORES, formula="m_p",
           reference=_MODEL),
    Metric("score_mean_observed", "mean of the measured detector scores", _SCORES, interval="Student",
           evidence=_PIPELINE, formula="m_o", reference=_MOMENTS + "1.3.5.2"),
    Metric("score_mean_difference", "difference of these (predicted − measured less its bias)", _SCORES,
           "m_p - (m_o - bias)", agreement=0.0, interval="Student, of the measured mean",
           reference=_MOMENTS + "1.3.5.2"),
    Metric("score_sd_ratio", "predicted over measured spread of the scores over a population of pixels",
           "compare.scores.sd_ratio_interval", "s_p / s_o", low=0.0, agreement=1.0, interval="chi-square",
           tolerance=of_value(0.01), example="sd_ratio_interval(1.0, 1.0, 101)[0]", gives=0.86152149,
           usual=(0.8, 1.25),
           short="spread of the scores", reference=_MOMENTS + "1.3.5.8"),
    Metric("object_score_measured", "measured score of an object", "compare.objects.compare_object_scores",
           evidence=_PIPELINE, formula="max over the pixels of the object", reference=_TOGETHER),
    Metric("object_score_predicted", "median of its predicted scores", "compare.objects.compare_object_scores",
           interval="draws of the inputs", formula="median of the draws of that greatest score",
           reference=_TOGETHER),
    Metric("object_score_pit",
           "probability that the model gives a lower score than was measured; uniform when the model is right",
           "compare.objects.probability_integral_transform", "(below + 1/2) / (N + 1)", low=0.0, high=1.0,
           kind=Kind.STATISTIC, reference="Rosenblatt, Ann. Math. Stat. 23, 470, 1952",
           example="probability_integral_transform([0.5], [0.0, 1.0])[0]", gives=0.5),
    _flag("object_score_inside_95", "1 when the score of an object lies inside its predicted 95 % interval, else 0",
          "compare.objects.compare_object_scores", formula="[q_0.025 <= s <= q_0.975]", reference=_TOGETHER,
          short="object score inside its interval"),
    Metric("objects_inside_95", "share of the objects whose score lies inside its predicted 95 % interval",
           _OBJECTS, low=0.0, high=1.0, agreement=0.95, interval="exact binomial, independent objects",
           tolerance=of_unit(0.02), formula="k / n", reference=_TOGETHER),
    Metric("objects_inside_95_p_value",
           "probability, were the model right, that as few objects lie inside their 95 % intervals", _OBJECTS,
           low=0.0, high=1.0, kind=Kind.TEST, tolerance=_P, alternative=1.5, departure=_WIDTH,
           formula="P(as few inside) over draws of the model",
           short="number of object scores inside their intervals", reference=_TOGETHER),
    Metric("pit_uniformity_p_value",
           "probability, were the model right, of scores that lie as unevenly in their predicted distributions",
           _OBJECTS, low=0.0, high=1.0, kind=Kind.TEST, tolerance=_P, usual=(0.01, math.inf),
           reference="Massey, J. Am. Stat. Assoc. 46, 68, 1951; docs/statistics.md#scores-and-areas",
           alternative=1.5, departure=_WIDTH,
           formula="P(sup |F_n(u) - u| as large) over draws of the model",
           short="object scores against their distributions"),
    Metric("joint_distance_p_value", "probability, were the model right, of a set of scores as far from its "
           "centre (Mahalanobis distance of the normal scores, correlation of the draws counted), or as near to it",
           _OBJECTS, low=0.0, high=1.0, kind=Kind.TEST, tolerance=_P, alternative=1.5, departure=_WIDTH,
           two_sided=True, formula="P(z^T C^-1 z as large, or as small) over draws of the model",
           short="object scores taken together", reference=_JUDGED),
    Metric("pit_trend_p_value", "probability, were the model right, of scores that rise or fall as much in their "
           "predicted distributions from the weakest expected object to the strongest", _OBJECTS, low=0.0, high=1.0,
           kind=Kind.TEST, tolerance=_P, alternative=1.5,
           departure="scores that drift by 1.5 of their predicted standard deviations from the weakest expected "
           "object to the strongest", formula="P(|trend| as large) over draws of the model",
           short="drift of object scores with size", reference=_JUDGED),
    Metric("pit_trend", "drift of the scores in their predicted distributions from the weakest expected object, "
           "such as the smallest, to the strongest [standard deviations]; 0 when the model is right", _OBJECTS,
           agreement=0.0, interval="draws of the model",
           formula="sum x z / sum x^2, z = Phi^-1(u), x the rank of the expected score", reference=_JUDGED),
    Metric("pit_spread_ratio", "predicted over measured spread of the scores of several objects, each in its own "
           "predicted distribution; above 1 the prediction is too wide", _OBJECTS, low=0.0, agreement=1.0,
           interval="draws of the model", formula="sd(z drawn) / sd(z), z = Phi^-1(u)",
           short="spread of object scores", reference=_TOGETHER),
    Metric("mean", "mean of one side alone", "compare.products.product_rows", unit="", interval="normal",
           formula="m", reference="JCGM 100:2008, 4.2"),
    Metric("sd", "standard deviation of one side alone", "compare.products.product_rows", low=0.0, formula="s",
           reference="JCGM 100:2008, 4.2"),
    Metric("pfa_ratio", "predicted over measured false-alarm probability at one threshold; the number after @ is "
           "the measured one aimed at", "processing.alarm_blocks.false_alarm_ratio", "P_p(x) / P_o(x)", low=0.0,
           agreement=1.0, interval="blocks of the image; parts of it left out of a fitted law",
           tolerance=_ALARM_COUNT, usual=(0.5, 2.0),
           short="false-alarm rate", reference=_TOGETHER),
    Metric("pfa_repeatability", "factor by which the false-alarm probability of one half of the image misses that "
           "of the other, at one threshold; the number after @ is the measured one aimed at",
           "processing.alarm_blocks.exceedance_curve", "median over halves of max(P_1/P_2, P_2/P_1)", low=1.0,
           better="low", tolerance=_ALARM_COUNT, evidence=_PIPELINE, reference=_TOGETHER),
    Metric("anomaly_threshold", "score that a part of the background exceeds, where no target is looked for; "
           "after @ that part", "processing.alarm_blocks.exceedance_curve", low=0.0, tolerance=of_value(0.01),
           evidence=_PIPELINE, formula="(1 - P_FA) quantile of the background's scores", reference=_TOGETHER),
    # ROC.
    Metric("pd", "detection probability of one side alone" + _AFTER, "compare.products.product_rows", low=0.0,
           high=1.0, better="high", interval=_MID_P, tolerance=_PROBABILITY,
           formula="P(score > t), t at the P_FA", reference=_MODEL),
    Metric("pd_predicted", "predicted detection probability" + _AFTER, "processing.roc_model.detection_at",
           low=0.0, high=1.0, interval="draws of the inputs", tolerance=_PROBABILITY,
           formula="sum_k w_k Phi((m_k - t) / s_k) (3.31)", reference=_MODEL),
    Metric("pd_measured", "measured detection probability" + _AFTER, "processing.roc_model.detection_at", low=0.0,
           high=1.0, interval=_MID_P, tolerance=_COUNT, evidence=_PIPELINE,
           formula="k / m above the threshold of the P_FA", reference=_BINOMIAL),
    Metric("pd_difference", "difference of these (predicted − measured)" + _AFTER, _DIFFERENCE, "P_p - P_o",
           low=-1.0, high=1.0, agreement=0.0, interval="Newcombe", tolerance=_COUNT, reference=_NEWCOMBE,
           example="difference_interval(0.8, (0.7, 0.9), 0.5, (0.5, 0.5))[0]", gives=0.2,
           short="probability of detection"),
    _flag("pd_inside_interval",
          "1 when 0 lies in the 95 % interval of the difference of detection probabilities, else " "0" + _AFTER,
          _ROC, formula="[l <= 0 <= u] of the difference", reference=_TWO_CURVES,
          short="probability of detection inside its interval"),
    _flag("pd_inside_measured_interval",
          "1 when the predicted detection probability lies in the measured interval as " "it stands" + _AFTER,
          _ROC, formula="[l_o <= P_p <= u_o]", reference=_TWO_CURVES),
    Metric("pd_predicted_preset", "the predicted one at the preset of (3.30), without (3.33)" + _AFTER, _ROC,
           low=0.0, high=1.0, interval="draws of the inputs", tolerance=_PROBABILITY,
           formula="(3.32) at the threshold of the preset of (3.30)", reference=_MODEL),
    _flag("pd_inside_interval_preset", "pd_inside_interval of that one" + _AFTER, _ROC,
           formula="[l <= 0 <= u] of the difference", reference=_TWO_CURVES),
    Metric("pd_equivalent",
           "1 when the whole interval of the difference lies within the campaign's margin" + _AFTER,
           "compare.roc.equivalent", low=0.0, high=1.0, kind=Kind.EQUIVALENCE, tolerance=_FLAG,
           reference=_SCHUIRMANN,
           example="equivalent((-0.05, 0.08), 0.1)", gives=1.0, formula="[-margin < l and u < margin]"),
    Metric("pd_equivalence", "1 equivalent, -1 different, 0 undecided, by the campaign's margin" + _AFTER,
           "compare.roc.equivalence", low=-1.0, high=1.0, kind=Kind.EQUIVALENCE, tolerance=_PROBABILITY,
           example="equivalence((0.05, 0.2), 0.1)[0]", gives=-1.0, usual=(1.0, math.inf),
           formula="1 within the margin, -1 beyond it, else 0", reference=_SCHUIRMANN),
    *_areas("auc", "area under the ROC curve: mean detection probability over all false-alarm probabilities",
            _DELONG),
    *_areas("partial_auc", "mean detection probability over the range of false-alarm probabilities after @",
            "Dodd & Pepe, Biometrics 59, 614, 2003"),
    *_areas("log_auc", "mean detection probability over the logarithm of the range after @", _CURVES),
    Metric("auc", "area under the ROC curve", "processing.roc.roc_area", low=0.0, high=1.0, better="high",
           interval="bootstrap of objects and blocks", tolerance=_AUC, evidence=_PIPELINE,
           formula="mean_i V_i, V_i the share of background below target i", reference=_DELONG),
    Metric("log_auc", "mean detection probability over the logarithm of a range of false-alarm probabilities",
           "processing.roc.roc_area", low=0.0, high=1.0, better="high",
           interval="bootstrap of objects and blocks", tolerance=_AUC, evidence=_PIPELINE,
           formula="mean of P_D over ln P_FA", reference=_CURVES),
    Metric("far", "false alarms per km² at the detection probability after @",
           "scoreboard.ranks.pfa_at_detection", unit=_PER_KM2, low=0.0, better="low",
           interval="bootstrap of objects and blocks", evidence=_PIPELINE,
           formula="P_FA times background pixels per km2", reference=_CURVES),
    Metric("far_measured", "measured false alarms per km²; after @ the false-alarm or the detection probability",
           "compare.roc.far_row", unit=_PER_KM2, low=0.0, interval="exact binomial", evidence=_PIPELINE,
           formula="alarms / area", reference=_CURVES),
    Metric("far_predicted", "predicted false alarms per km² at the detection probability after @", _ALARMS,
           unit=_PER_KM2, low=0.0, interval="band of the curve", formula="P_FA times background pixels per km2",
           reference=_CURVES),
    Metric("far_difference", "difference of these (predicted − measured)", _ALARMS, unit=_PER_KM2, agreement=0.0,
           interval="Newcombe", reference=_NEWCOMBE, formula="far_p - far_o"),
    Metric("alarms_before_first", "background pixels declared before the first pixel of any object, "
           "by the rule of RIT's self-test", "processing.roc.alarms_before_first", low=0.0, better="low",
           tolerance=_ALARM_COUNT, evidence=_PIPELINE, formula="number of background scores >= max of target",
           reference="Snyder et al., IGARSS 2008, II-915"),
    Metric("joint_pfa", "false-alarm probability of a point, its interval part of a region of 95 %", _JOINT,
           low=0.0, high=1.0, interval="exact binomial, sqrt(0.95)", evidence=_PIPELINE, formula="alarms / n",
           reference=_REGION),
    Metric("joint_pd", "detection probability of a point, its interval part of a region of 95 %", _JOINT, low=0.0,
           high=1.0, interval="exact binomial, sqrt(0.95)", evidence=_PIPELINE, formula="k / m", reference=_REGION),
    _flag("pd_inside_joint_region", "1 where the predicted curve passes through that region" + _AFTER, _JOINT,
           formula="[P_p(P_FA) passes through the rectangle]", reference=_REGION),
    # Areas of targets.
    Metric("area", "area of a target, one side alone", "compare.products.product_rows", unit="m2",
           interval="normal", tolerance=_AREA, formula="sum of abundances times the pixel's area",
           reference=_UNMIXED),
    Metric("area_predicted", "predicted area of a target", _AREAS, unit="m2", interval="normal", tolerance=_AREA,
           formula="sum of abundances times the pixel's area", reference=_UNMIXED),
    Metric("area_observed", "measured area of a target", _AREAS, unit="m2", interval="normal", tolerance=_AREA,
           evidence=_PIPELINE, formula="sum of abundances times the pixel's area", reference=_UNMIXED),
    Metric("area_ratio", "measured over predicted area of a target", _AREAS, "A_o / A_p", agreement=1.0,
           interval="normal, first order", tolerance=_AREA,
           short="target area", reference=_GUM),
    Metric("area_difference_ratio", "(predicted − measured) / measured area", _AREAS, "(A_p - A_o) / A_o",
           agreement=0.0, interval="normal, first order", tolerance=of_unit(0.002), reference=_GUM),
    Metric("area_z", "difference of the areas over its standard uncertainty", _AREAS, "(A_p - A_o) / u",
           agreement=0.0, kind=Kind.STATISTIC, tolerance=of_unit(0.1), reference=_GUM),
    _flag("area_inside_95", "1 when |area_z| <= 1.96", _AREAS, formula="[|A_p - A_o| <= 1.96 u]", reference=_GUM),
    Metric("area_error_predicted", "predicted less true area", _AREAS, unit="m2", agreement=0.0, interval="normal",
           tolerance=_AREA, formula="A_p - A", reference=_UNMIXING),
    Metric("area_error_observed", "measured less true area", _AREAS, unit="m2", agreement=0.0, interval="normal",
           tolerance=_AREA, evidence=_PIPELINE, formula="A_o - A", reference=_UNMIXING),
    Metric("area_nominal_ratio", "measured over true area of a target", _AREAS, "A_o / A", agreement=1.0,
           interval="normal", tolerance=_AREA, evidence=_PIPELINE,
           short="target area against the tape measure", reference=_UNMIXING),
    Metric("area_in_predicted_95", "1 when the measured area lies inside the predicted 95 % interval, else 0",
           _AREAS, low=0.0, high=1.0, kind=Kind.COVERAGE, tolerance=_AREA, formula="[|A_p - A_o| <= 1.96 u_p]",
           reference=_UNMIXING),
    Metric("area_bias_observed", "mean over targets of measured less true area", _ERRORS, unit="m2", agreement=0.0,
           interval="Student", tolerance=_AREA, evidence=_PIPELINE, formula="mean (A_o - A)", reference=_UNMIXING),
    Metric("area_bias_predicted", "mean over targets of predicted less true area", _ERRORS, unit="m2",
           agreement=0.0, interval="normal", tolerance=_AREA, formula="mean (A_p - A)", reference=_UNMIXING),
    Metric("area_rmse_observed", "root mean square over targets of measured less true area", _ERRORS, unit="m2",
           low=0.0, interval="chi-square", tolerance=_AREA, evidence=_PIPELINE, formula="sqrt(mean (A_o - A)^2)",
           reference=_UNMIXING),
    Metric("area_rmse_predicted", "root mean square over targets of predicted less true area", _ERRORS, unit="m2",
           low=0.0, tolerance=_AREA, formula="sqrt(mean ((A_p - A)^2 + u_p^2))", reference=_UNMIXING),
)  # fmt: skip

"""The comparisons that a collection and a model of it usually call for, with the ranges that are usual."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hyperval.products import background_of

# A test asks whether the stated errors explain the difference, and a draft has none that anybody stated.
_OF_BUDGET = "whether the budget explains the difference; it is guessed, and decides once the errors are stated"


def usual_comparisons(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Comparisons for the content of a campaign file, as that file states them.

    Level of the radiance of every surface with a spectrum of its own, of the reflectance of those that are no
    panel of the empirical line, the SNR of its panels, detection and false alarms of its targets.  A class whose
    statistics the image itself gives is no evidence, and not compared.
    """
    collection, scenario = content["collection"], content["scenarios"][0]
    scene = scenario["scene"]
    panels = [panel["name"] for panel in scene.get("panels", [])]
    known = [c["name"] for c in scene["classes"] if "measured" not in c["spectrum"]]
    out: list[dict[str, Any]] = []
    if "atmosphere" in scenario and known + panels:
        out += [
            _entry("radiance", known + panels, "median_difference_ratio_windows", {"within": [-0.1, 0.1]},
                   "5 % of the calibration and 5 % of field spectra, at twice their standard uncertainty"),
            _entry("radiance", known + panels, "p_value_shape", {"at_least": 0.01}, _OF_BUDGET, gate=False),
        ]  # fmt: skip
        if panels and panels == collection.get("snr_regions"):
            out.append(
                _entry("snr", panels, "median_difference_ratio_windows", {"within": [-0.3, 0.3]},
                       "detector figures from a data sheet", gate=False)
            )  # fmt: skip
    if known and ("empirical_line" in collection or collection["cube"]["quantity"] == "reflectance"):
        out += [
            _entry("reflectance", known, "median_difference_ratio_windows", {"within": [-0.1, 0.1]},
                   "5 % of field spectra, at twice their standard uncertainty; panels of the line left out"),
            _entry("reflectance", known, "p_value_full", {"at_least": 0.01}, _OF_BUDGET, gate=False),
        ]  # fmt: skip
    materials = [target["name"] for target in scene.get("targets", [])]
    if materials:
        backgrounds = [background_of(name) for name in materials]
        subjects = [s["name"] for target in scene["targets"] for s in target.get("subjects") or [target]]
        out += [
            _entry("roc", subjects, "pd_difference@1e-2", {"within": [-0.15, 0.15]},
                   "a sixth more or fewer target pixels detected is what a user would not act upon",
                   method="cem/pixel"),
            _entry("scores", backgrounds, "pfa_ratio@1e-2", {"within": [0.5, 2.0]},
                   "false alarms to a factor of two"),
        ]  # fmt: skip
    return out


def _entry(
    product: str, subjects: list[str], metric: str, limit: dict[str, Any], reason: str, **more: Any
) -> dict[str, Any]:
    return {"product": product, "subjects": list(subjects), "metric": metric, **limit, **more, "reason": reason}

"""What the workers do: each function takes plain values and folders, and returns what a list or page says of it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hyperval import api
from hyperval.campaign.forward import predict_to_folder
from hyperval.campaign.observing import observe
from hyperval.campaign.run import validate
from hyperval.config import load_model
from hyperval.processing.roc_reading import detection_at
from hyperval.products import Prediction
from hyperval.report.stored import read_results
from hyperval.report.verdict import verdict
from hyperval.scenario import Scenario
from hyperval.study.run import study_to_folder
from hyperval.web import charts
from hyperval.web.answer import read_answer, write_answer

_PFA = (1e-4, 1e-3, 1e-2)
_MOST_LISTED = 40


def warm() -> None:
    """Load what a first prediction and its charts would wait for."""
    answer = api.predict("yellow-planks-asphalt")
    charts.charts_of({"predicted": answer})


def predict(folder: str) -> dict[str, Any]:
    """Predict the scenario of a folder, and write what pages draw of it."""
    place = Path(folder)
    scenario = load_model(Scenario, place / "scenario.yaml")
    scenario._folder = place
    prediction = api.predict(scenario)
    write_answer(place / "answer.npz", prediction)
    return summary(prediction)


def summary(prediction: Prediction) -> dict[str, Any]:
    """Bands, mean SNR, and P_D at some P_FA with 95 % limits, a row for each curve."""
    rows = []
    for (subject, detector, unit), curve in prediction.roc.items():
        for pfa in _PFA:
            value, low, high = (
                _number(detection_at(curve, pfa, limit)) for limit in (curve.pd, curve.pd_lower, curve.pd_upper)
            )
            rows.append({"subject": subject, "detector": detector, "unit": unit, "pfa": pfa,
                         "pd": value, "lower": low, "upper": high})  # fmt: skip
    snr = [
        {"subject": name, "median": _number(np.nanmedian(e.mean))}
        for name, e in prediction.snr.items()
        if not name.endswith(")")
    ]
    nm = prediction.axis.centre_nm
    return {
        "bands": int(nm.size),
        "range_nm": [float(nm[0]), float(nm[-1])],
        "detection": rows,
        "snr": snr[:_MOST_LISTED],
        "notes": list(prediction.notes),
    }


def _number(value: Any) -> float | None:
    """A number as JSON has it: None where there is none."""
    return float(value) if np.isfinite(value) else None


@lru_cache(maxsize=8)
def _answer(folder: str) -> Prediction:
    return read_answer(Path(folder) / "answer.npz")


def draw(folder: str, earlier: str | None = None) -> None:
    """Write the charts of a prediction, beside those of an earlier one where there is one."""
    sides = {"predicted": _answer(folder)}
    name = "charts.json"
    if earlier is not None:
        sides["earlier"] = _answer(earlier)
        name = f"charts-{Path(earlier).name}.json"
    text = json.dumps(charts.charts_of(sides), separators=(",", ":"))
    part = Path(folder) / f"{name}.part"
    part.write_text(text, "utf-8")
    part.replace(Path(folder) / name)


def files(folder: str) -> None:
    """Write the folder that ``hyperval predict`` writes of the scenario."""
    predict_to_folder(str(Path(folder) / "scenario.yaml"), Path(folder) / "results", show_progress=False)


def study(folder: str) -> dict[str, Any]:
    """Evaluate the study of a folder."""
    study_to_folder(Path(folder) / "study.yaml", Path(folder) / "results", show_progress=False)
    with (Path(folder) / "results" / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = [
            {k: row[k] for k in ("subject", "method", "metric", "value", "unit")}
            for row in csv.DictReader(file)
        ]  # fmt: skip
    return {"rows": rows[:_MOST_LISTED], "left_out": max(0, len(rows) - _MOST_LISTED)}


def campaign(folder: str, path: str) -> dict[str, Any]:
    """Run a campaign into a folder."""
    code = validate([Path(path)], Path(folder) / "results", show_progress=False)
    return _verdicts(Path(folder) / "results") | {"exit_code": code}


def pipeline(folder: str) -> dict[str, Any]:
    """Run the empirical pipeline of the campaign in a folder."""
    observe(Path(folder) / "campaign.yaml", Path(folder) / "results", show_progress=False)
    return _verdicts(Path(folder) / "results")


def _verdicts(results: Path) -> dict[str, Any]:
    rows = list(read_results(results / "results.json"))
    planned = [row for row in rows if row.planned]
    counts: dict[str, int] = {}
    for row in planned:
        counts[str(row.outcome)] = counts.get(str(row.outcome), 0) + 1
    tone, words = verdict(rows) if planned else ("none", "One side alone: nothing is compared.")
    return {"tone": str(tone), "verdict": words, "counts": counts, "rows": len(rows)}


TASKS: Mapping[str, Callable[..., Any]] = {
    "predict": predict, "draw": draw, "files": files, "study": study, "campaign": campaign, "pipeline": pipeline,
}  # fmt: skip

"""Whole verdicts: small simulated campaigns whose model is exactly right, and how many of them find it wrong.

Sizes, layouts, numbers of bands, noise and planks vary from campaign to campaign.  The criteria and their ranges
are those of share2012-twin.  Counted are campaigns with any criterion "not met", and of every interval that a
criterion looks at how often it lies above the truth, and how often below.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from counts import Key
from world import engine  # with the shared parts of the tests on the path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.campaign import load_job, run_campaign
from hyperval.compare import compare_covariance, covariance, detection
from hyperval.config import parse_yaml
from hyperval.metrics import Kind, metric_of
from hyperval.products import background_of
from hyperval.results import Outcome, Result, Role
from hyperval.spectra import in_window
from small_campaign import data_of, write_yaml

TWIN = Path(__file__).parents[2] / "campaigns" / "share2012-twin"
PANELS = ("white-panel", "black-panel")
CLASSES = {"grass": "grass-field", "asphalt": "asphalt-court"}
PLANKS = {"yellow": "asphalt", "green": "grass"}
# Rectangles of the two classes in parts of 24 of the lines and of the samples, the greatest of each class first.
GRASS, ASPHALT = CLASSES
LAYOUTS = {
    "lines": ((GRASS, 0, 12, 0, 24), (ASPHALT, 12, 24, 0, 24)),
    "samples": ((GRASS, 0, 24, 0, 12), (ASPHALT, 0, 24, 12, 24)),
    "unequal": ((GRASS, 0, 8, 0, 24), (ASPHALT, 8, 24, 0, 24)),
    "stripes": ((GRASS, 0, 9, 0, 24), (ASPHALT, 9, 18, 0, 24), (GRASS, 18, 21, 0, 24), (ASPHALT, 21, 24, 0, 24)),
    "quarters": ((GRASS, 0, 12, 0, 12), (ASPHALT, 0, 12, 12, 24), (ASPHALT, 12, 24, 0, 12), (GRASS, 12, 24, 12, 24)),
}
MEANS = "score_mean_difference"
BANDS = (12, 16, 24, 32, 48)


def world(number: int, seed: int) -> dict[str, dict[str, Any]]:
    """The files of one campaign, by name: sensor, scene, scenario, campaign."""
    rng = np.random.default_rng([seed, number])
    usable = np.arange(430.0, 2400.0, 2.0)
    usable = usable[in_window(usable)]
    centres = usable[np.linspace(0, usable.size - 1, int(rng.choice(BANDS))).astype(int)]
    lines, samples = int(rng.integers(72, 121)), int(rng.integers(72, 121))
    areas = [
        (surface, [lines * a // 24, lines * b // 24], [samples * c // 24, samples * d // 24])
        for surface, a, b, c, d in list(LAYOUTS.values())[number % len(LAYOUTS)]
    ]
    noise = float(rng.uniform(0.5, 3.0))
    sensor = data_of("small_sensor")
    sensor["bands"]["table"] = [[float(c), 10.0, 1] for c in centres]
    for row in sensor["measured_noise"]["table"]:
        row[1] *= noise
    sensor["calibration_error_percent"]["value"] = float(rng.uniform(0.05, 0.3))
    where = {name: next((a, b) for surface, a, b in areas if surface == name) for name in CLASSES}
    groups, subjects = [], {}
    for colour, host in PLANKS.items():
        rows, columns = where[host]
        first = rows[0] + (14 if host == "grass" else 2)  # below the panels
        area = {"lines": [first, rows[1]], "samples": [columns[0] + 2, columns[1] - 2]}
        room = ((rows[1] - first) // 6) * ((columns[1] - columns[0] - 4) // 6)
        fill, count = round(float(rng.uniform(0.05, 0.3)), 3), int(min(room, rng.integers(12, 61)))
        groups.append(
            {"name": f"{colour}-plank", "material": f"{colour}-paint-plank", "host": host, "fill": fill,
             "count": count, "area": area, "spacing_pixels": 6}
        )  # fmt: skip
        subjects[colour] = [{"name": f"{colour}-plank", "fill": {"fixed": fill}}]
    grass = where["grass"]
    scene = data_of("small_scene") | {
        "seed": int(rng.integers(1 << 40)), "lines": lines, "samples": samples, "targets": groups,
        "layout": [{"surface": name, "lines": a, "samples": b} for name, a, b in areas],
        "panels": [
            {"name": name, "surface": name, "lines": [grass[0][0] + 2, grass[0][0] + 10],
             "samples": [grass[1][0] + 1 + 8 * i, grass[1][0] + 9 + 8 * i], "border_pixels": 0}
            for i, name in enumerate(PANELS)
        ],
        "regions": [{"name": name, "surface": surface, "border_pixels": 0} for surface, name in CLASSES.items()],
    }  # fmt: skip
    scenario = data_of("small_scenario")
    scenario["processing"]["detectors"] = ["cem", "cem-correlation"]
    scenario["scene"] |= {
        "classes": [
            {"name": region, "fraction": 0.5, "spectrum": {"builtin": surface}} for surface, region in CLASSES.items()
        ],
        "fractions": "measured",
        "panels": [{"name": name, "spectrum": {"builtin": name}} for name in PANELS],
        "targets": [
            {"name": colour, "spectrum": {"builtin": f"{colour}-paint-plank"}, "host": CLASSES[host],
             "subjects": subjects[colour]}
            for colour, host in PLANKS.items()
        ],
    }  # fmt: skip
    return {"sensor": sensor, "scene": scene, "scenario": scenario, "campaign": campaign(groups, centres)}


def campaign(groups: list[dict[str, Any]], centres: np.ndarray) -> dict[str, Any]:
    """The twin's campaign on the files of another collection, with its own subjects."""
    data, _ = parse_yaml((TWIN / "campaign.yaml").read_text())
    data = dict(data)
    collection = data["collection"] = {**data["collection"]}
    del collection["simulate"]
    collection["cube"] = {"path": "collection/small_rad.img", "quantity": "radiance", "unit": "uW cm-2 sr-1 nm-1"}
    collection["regions"] = [{"file": "collection/regions.geojson", "coordinates": "pixel"}]
    collection["targets"] = {**collection["targets"], "csv": "collection/targets.csv"}
    collection["empirical_line"] = {
        "panels": [{"region": name, "spectrum": {"builtin": name}} for name in PANELS]  # read without error
    }
    data["detection"] = {**data["detection"]}
    data["detection"].pop("bands", None)
    nearest = sorted({float(centres[np.argmin(np.abs(centres - nm))]) for nm in (450.0, 560.0, 1650.0)})
    data["classification"] = {
        "classes": list(CLASSES.values()),
        "features": [{"name": "1 band", "bands_nm": nearest[:1]}, {"name": "3 bands", "bands_nm": nearest}],
    }
    names = [g["name"] for g in groups]
    for gate in data["comparisons"]:
        if gate["product"] == "roc":
            gate["subjects"] = names
        if gate["product"] == "scores":
            gate["method"] = "cem"  # the other detector is for its mean alone
    collection["leave_out"] = collection["snr_regions"] = list(PANELS)
    for gate in data["comparisons"]:
        gate["subjects"] = [s for s in gate["subjects"] if not s.startswith("grey")]
    data["comparisons"] = [gate for gate in data["comparisons"] if gate["subjects"]]
    del data["attribution"]
    return {**data, "name": "small", "scenarios": ["scenario.yaml"]}


def terms(state: AtmosphericState) -> AtmosphericTerms:
    """The stand-in without light from the surroundings, since the model is told of classes, not of panels there."""
    found = engine(state)
    none = np.zeros_like(found.adjacency)
    return replace(found, adjacency=none, spherical_albedo=none)


def rows_of(number: int, seed: int) -> list[Result]:
    """Simulate, observe, predict, compare and judge one campaign."""
    from hyperval.simulate import SceneFile, load_inputs, simulate

    files = world(number, seed)
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        for stem, data in files.items():
            write_yaml(folder / f"{stem}.yaml", data)
        scene = SceneFile.model_validate(files["scene"])
        simulate(scene, folder / "collection", inputs=load_inputs(scene, folder, terms))
        stack.enter_context(patch("hyperval.model.stated.atmospheric_terms", lambda state, **_: terms(state)))
        stack.enter_context(patch.multiple(detection, REPLICATES=1000, POWER_DRAWS=20))
        stack.enter_context(patch.object(covariance, "compare_covariance", of_classes))
        report = run_campaign(load_job(folder / "campaign.yaml"))
    return list(report.table)


def of_classes(predicted: Any, observed: Any, subject: str, quantity: str) -> Iterable[Result]:
    """Rows of the covariances of classes: no criterion looks at others, whose draws take half of the time."""
    return compare_covariance(predicted, observed, subject, quantity) if subject in CLASSES.values() else []


def counted(rows: Iterable[Result]) -> Iterator[tuple[Key, list[float]]]:
    """Whether any criterion is not met; the intervals of each metric that lie above their truth, and below it.

    Besides the criteria: the mean score of the background, which has an interval where it is not 0 by construction.
    """
    rows = [r for r in rows if r.role is Role.GATE or (r.metric == MEANS and r.subject.endswith(background_of("")))]
    wrong = any(r.role is Role.GATE and r.outcome in (Outcome.DISAGREES, Outcome.ERROR) for r in rows)
    yield ("campaign", "all", "any criterion not met", "small"), [float(wrong)]
    sides: dict[tuple[str, str], list[tuple[bool, bool]]] = {}
    for row in rows:
        metric = metric_of(row.metric)
        if metric.kind is Kind.QUANTITY and "_abs_" not in row.metric and np.isfinite(row.lower + row.upper):
            side = row.lower > metric.agreement, row.upper < metric.agreement
            sides.setdefault((row.product, row.metric), []).append(side)
    for (product, metric), found in sides.items():
        for side, which in enumerate(("above", "below")):
            yield (product, metric, f"95 % interval {which} its truth", "small"), [float(f[side]) for f in found]

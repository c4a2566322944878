"""Processor time of one prediction, beside a plain writing-down of the same equations in the same run.

    OPENBLAS_NUM_THREADS=1 python benchmarks/predict_speed.py

Cached atmosphere, 360 bands (ProSpecTIR-VS), 5 classes, one sub-pixel target, one detector over the whole ROC.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded
os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

sys.path.insert(0, str(Path(__file__).parents[1] / "validation" / "equations"))
from plain_scene import PlainScene

from hyperval.atmosphere import atmospheric_terms
from hyperval.config import parse_yaml, validate
from hyperval.model import false_alarm_grid, predict
from hyperval.products import PredictedProducts
from hyperval.scenario import Scenario
from hyperval.sensor import load_sensor
from hyperval.statistics_library import builtin_class

TEXT = """
schema: 1
name: speed
atmosphere: {meteorological_range_km: 23, water_vapour_g_cm2: 2.0, ground_altitude_km: 0.17, sensor_altitude_km: 1,
             solar_zenith_deg: 35, solar_azimuth_deg: 180, day_of_year: 210}
sensor: prospectir-vs
scene:
  classes:
    - {name: asphalt, fraction: 0.4, spectrum: {builtin: asphalt}}
    - {name: grass, fraction: 0.3, spectrum: {builtin: grass}}
    - {name: soil, fraction: 0.1, spectrum: {builtin: soil}}
    - {name: wood, fraction: 0.1, spectrum: {builtin: green-paint-plank}}
    - {name: panel, fraction: 0.1, spectrum: {builtin: grey-panel-30}}
  targets:
    - {name: plank, spectrum: {builtin: yellow-paint-plank}, host: asphalt, fill: {fixed: 0.1}}
processing: {detectors: [cem], bands: {drop_bad: false}}
"""
KAPPA = 1e-3


def plainly(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """P_FA and P_D by the corrected equations, one after the other, with diagonal matrices written out."""
    sensor = load_sensor("prospectir-vs")
    assert scenario.atmosphere is not None
    terms = atmospheric_terms(scenario.atmosphere).at_bands(sensor.axis)
    names = {c.name: str(c.spectrum.builtin) for c in scenario.scene.classes} | {"plank": "yellow-paint-plank"}
    surfaces = {name: builtin_class(builtin, sensor.axis) for name, builtin in names.items()}
    fractions = {c.name: c.fraction for c in scenario.scene.classes}
    noise = sensor.noise(sensor.axis)
    plain = PlainScene(terms, noise, surfaces, fractions, "plank", "asphalt", kappa=KAPPA)
    scores = [(f, *plain.scores(plain.classes[name])) for name, f in fractions.items()]
    theta = [(f, mean, np.sqrt(variance)) for f, mean, variance in scores]  # (3.27), (3.29)
    theta_t, variance_t = plain.scores(plain.pixel(0.1))  # (3.26), (3.28)
    pfa = false_alarm_grid()

    def excess(x: float, p: float) -> float:
        return float(np.log(sum(f * norm.sf((x - m) / sd) for f, m, sd in theta)) - np.log(p))  # (3.33)

    ends = min(m - 10 * sd for _, m, sd in theta), max(m + 10 * sd for _, m, sd in theta)
    threshold = np.array([brentq(excess, *ends, args=(p,)) for p in pfa])
    return pfa, norm.cdf((theta_t - threshold) / np.sqrt(variance_t))  # (3.31)


def best_of(run: Callable[[], object], times: int) -> tuple[float, float]:
    """Least and median processor time [s] of some runs, after one that fills the caches."""
    run()
    found = []
    for _ in range(times):
        start = time.process_time()
        run()
        found.append(time.process_time() - start)
    return min(found), float(np.median(found))


def main() -> None:
    """Print both times, their ratio, and how far the two ROC curves are apart."""
    data, lines = parse_yaml(TEXT)
    scenario = validate(Scenario, data, lines, "benchmark")
    ours: PredictedProducts = predict(scenario)
    _, plain = plainly(scenario)
    difference = float(np.abs(ours.roc["plank", "cem", "pixel"].pd - plain).max())
    least, median = best_of(lambda: predict(scenario), 30)
    reference, _ = best_of(lambda: plainly(scenario), 5)
    print(f"bands {len(ours.axis)}, classes {len(scenario.scene.classes)}, processor time, one BLAS thread")
    print(f"predict          {1e3 * least:7.1f} ms least, {1e3 * median:.1f} ms median of 30")
    print(f"plain equations  {1e3 * reference:7.1f} ms least of 5")
    print(f"ratio            {reference / least:7.1f}")
    print(f"greatest difference of P_D between the two: {difference:.1e}")


if __name__ == "__main__":
    main()

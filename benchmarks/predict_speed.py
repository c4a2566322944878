"""Processor time of one prediction, beside a plain writing-down of the same equations in the same run.

    OPENBLAS_NUM_THREADS=1 python benchmarks/predict_speed.py

Cached atmosphere, 360 bands (ProSpecTIR-VS), 5 classes, one sub-pixel target, one detector over the whole ROC.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded
os.environ.setdefault("OMP_NUM_THREADS", "1")

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

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
    axis = sensor.axis
    assert scenario.atmosphere is not None
    t = atmospheric_terms(scenario.atmosphere).at_bands(axis)
    noise = sensor.noise(axis)
    a, b, s, path = t.direct, t.adjacency, t.spherical_albedo, t.path_radiance
    classes = [(c.fraction, builtin_class(str(c.spectrum.builtin), axis)) for c in scenario.scene.classes]
    average = sum(f * c.mean for f, c in classes)  # (3.8)
    spread = sum(f * (c.covariance + np.outer(c.mean - average, c.mean - average)) for f, c in classes)

    def radiance(rho: np.ndarray) -> np.ndarray:
        return path + (a * rho + b * average) / (1 - s * average)  # (3.7)

    low, high = radiance(np.full(len(axis), 0.1)), radiance(np.full(len(axis), 0.6))
    k = (high - low) / 0.5
    offset = low - 0.1 * k

    def seen(rho: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d_a = np.diag(a / (1 - s * average))
        d_b = np.diag((a * s * rho + b) / (1 - s * average) ** 2)
        sigma = d_a @ covariance @ d_a + KAPPA * d_b @ spread @ d_b  # (3.11)
        sigma = sigma + np.diag(noise.variance(radiance(rho)))  # (3.13)-(3.19)
        return (radiance(rho) - offset) / k, np.diag(1 / k) @ sigma @ np.diag(1 / k)

    found = [(f, *seen(c.mean, c.covariance)) for f, c in classes]
    target, host = builtin_class("yellow-paint-plank", axis), classes[0][1]
    rho = 0.1 * target.mean + 0.9 * host.mean  # (3.10)
    mixed = seen(rho, 0.01 * target.covariance + 0.81 * host.covariance)  # (3.12)
    mu = sum(f * m for f, m, _ in found)
    sigma = sum(f * (c + np.outer(m - mu, m - mu)) for f, m, c in found)
    d = target.mean - mu
    w = np.linalg.inv(sigma) @ d / (d @ np.linalg.inv(sigma) @ d)  # (3.22)-(3.25)
    theta = [(f, w @ (m - mu), np.sqrt(w @ c @ w)) for f, m, c in found]  # (3.27), (3.29)
    theta_t, sigma_t = w @ (mixed[0] - mu), np.sqrt(w @ mixed[1] @ w)  # (3.26), (3.28)
    pfa = false_alarm_grid()

    def excess(x: float, p: float) -> float:
        return float(np.log(sum(f * norm.sf((x - m) / sd) for f, m, sd in theta)) - np.log(p))  # (3.33)

    ends = min(m - 10 * sd for _, m, sd in theta), max(m + 10 * sd for _, m, sd in theta)
    threshold = np.array([brentq(excess, *ends, args=(p,)) for p in pfa])
    return pfa, norm.cdf((theta_t - threshold) / sigma_t)  # (3.31)


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

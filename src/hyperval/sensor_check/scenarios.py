"""The standard scenarios run through the forward model with the sensor that is checked."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from hyperval.errors import HypervalError
from hyperval.predict import Origins, predict
from hyperval.processing.roc_reading import detection_at
from hyperval.products import Prediction
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.scene.builtin import builtin_mean
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.ledger import Ledger
from hyperval.sensor_check.noise import Engine
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]

PRODUCT = "scenario"
FALSE_ALARM = 1e-3
# The model's empirical line inverts a linear equation: what is left is rounding.
REFLECTANCE_TOLERANCE = 1e-6


@lru_cache(maxsize=8)
def standard_scenario(name: str) -> Scenario:
    """A built-in scenario, read once."""
    return load_scenario(name)


def run_scenarios(sensor: Sensor, ledger: Ledger, engine: Engine | None = None) -> dict[str, Prediction]:
    """Predict every built-in scenario with ``sensor`` and check what comes out."""
    done: dict[str, Prediction] = {}
    for name in builtin_scenarios():
        scenario = standard_scenario(name)
        try:
            done[name] = predict(scenario, Origins(engine=engine, sensor=sensor, show_progress=False))
        except HypervalError as error:
            ledger.error(PRODUCT, "runs", f"{name}: {error}")
            continue
        _check(scenario, done[name], sensor, ledger)
    return done


def _check(scenario: Scenario, prediction: Prediction, sensor: Sensor, ledger: Ledger) -> None:
    good = prediction.axis.good & in_window(prediction.axis.centre_nm)
    name = scenario.name
    wrong = sum(
        int(np.count_nonzero(~(np.isfinite(e.mean[good]) & (e.mean[good] > 0))))
        for group in (prediction.radiance, prediction.snr)
        for e in group.values()
    )
    ledger.gate(PRODUCT, "values_not_positive", wrong, wrong == 0, at_most=0.0, subject=name,
                reason="radiances or ratios that are not positive in the windows")  # fmt: skip
    c_r = sensor.noise(prediction.axis).calibration_percent / 100.0
    highest = max(float(np.max(e.mean * c_r)) for s, e in prediction.snr.items() if s in prediction.radiance)
    ledger.gate(PRODUCT, "highest_snr_over_cap_of_c_r", highest, highest <= 1.0 + 1e-9, at_most=1.0, subject=name,
                reason="the SNR passes 100 / C_R")  # fmt: skip
    error = _panel_error(scenario, prediction, good)
    ledger.gate(PRODUCT, "panel_reflectance_error", error, error <= REFLECTANCE_TOLERANCE,
                at_most=REFLECTANCE_TOLERANCE, subject=name,
                reason="the empirical line does not give back the panels")  # fmt: skip
    parts = [float(np.max(np.where(prediction.axis.good, p, 0.0))) for p in prediction.full_scale.values()]
    if parts and np.all(np.isfinite(parts)):
        most = max(parts)
        ledger.gate(PRODUCT, "highest_part_of_full_scale", most, most < 1.0, at_most=1.0, subject=name,
                    reason="a surface of the scene saturates")  # fmt: skip
    for (subject, detector, unit), curve in prediction.roc.items():
        if unit != "pixel":
            continue
        step = float(np.min(np.diff(curve.pd)))
        sound = step >= 0.0 and bool(np.all((curve.pd >= 0) & (curve.pd <= 1)))
        what = f"{name}, {subject} {detector}"
        ledger.gate(PRODUCT, "lowest_step_of_roc", step, sound, at_least=0.0, subject=what,
                    reason="the ROC falls or leaves 0 to 1")  # fmt: skip
        ledger.info(PRODUCT, f"pd_at_pfa_{FALSE_ALARM:g}", float(detection_at(curve, FALSE_ALARM)), subject=what)


def _panel_error(scenario: Scenario, products: Prediction, good: npt.NDArray[np.bool_]) -> float:
    worst = 0.0
    for panel in scenario.scene.panels:
        if panel.spectrum.builtin is not None and panel.name in products.reflectance:
            truth = builtin_mean(panel.spectrum.builtin, products.axis)
            worst = max(
                worst, float(np.max(np.abs(products.reflectance[panel.name].mean - truth)[good], initial=0.0))
            )
    return worst

"""Inverse questions: the answer put back gives what was asked; no answer is an answer."""

import numpy as np
import pytest
from scipy.optimize import brentq

from hyperval.model import predict, read
from hyperval.settings import with_settings
from hyperval.study.evaluate import Evaluator
from hyperval.study.plan import _bracket, answers, scan_values
from hyperval.study.schema import Output, Required

FILL = "scene.targets.plank.fill.fixed"
PD = Output(name="pd", kind="pd", subject="plank", pfa=1e-3)
SNR = Output(name="snr", kind="snr", subject="asphalt", band_nm=550)


@pytest.fixture
def evaluator(scenario) -> Evaluator:
    return Evaluator(read(scenario))


def asked(**changes) -> Required:
    given = {"name": "q", "path": FILL, "between": (0.001, 1.0), "spacing": "log", "output": "pd", "equals": 0.9}
    return Required.model_validate({**given, **changes})


def test_required_fill_against_brent_on_predict(scenario, evaluator):
    """The same root by another solver and the plain evaluator."""
    found = answers(evaluator, {"sensor_changes.calibration_error_percent": np.array([1.0])}, asked(), [PD])

    def miss(fill: float) -> float:
        changes = {FILL: fill, "sensor_changes.calibration_error_percent": 1.0}
        curve = predict(with_settings(scenario, changes)).roc["plank", "cem", "pixel"]
        return float(curve.pd[np.argmin(np.abs(curve.pfa - 1e-3))]) - 0.9

    assert found.values[0] == pytest.approx(brentq(miss, 0.001, 1.0, xtol=1e-10), rel=1e-7)
    assert not found.reasons


def test_required_signal_and_the_ratio_there(evaluator):
    """The signal that gives the P_D, and the SNR at that signal: told to be what the outputs say there."""
    question = asked(path="sensor_changes.signal_factor", between=(1e-3, 1e3), equals=0.5, report=["snr"])
    columns = {"sensor_changes.fixed_noise_factor": np.array([5.0, 20.0, 50.0]), FILL: np.full(3, 0.12)}
    found = answers(evaluator, columns, question, [PD, SNR])
    assert np.all(np.diff(found.values) > 0)  # more noise asks for more light
    back, _ = evaluator.values({**columns, "sensor_changes.signal_factor": found.values}, [PD, SNR])
    np.testing.assert_allclose(back[:, 0], 0.5, rtol=1e-7)
    np.testing.assert_allclose(back[:, 1], found.reports[:, 0], rtol=1e-12)


def test_no_solution_has_a_reason(evaluator):
    found = answers(evaluator, {FILL: np.array([0.001])}, asked(path="sensor_changes.signal_factor"), [PD])
    assert np.isnan(found.values[0])
    assert "stays below 0.9" in found.reasons[0]


def test_several_solutions_and_kinks_are_told():
    question = asked(between=(0.0, 1.0), spacing="linear", scan=9, equals=0.0)
    x = scan_values(question)
    at, why = _bracket(x, np.sin(7.0 * x - 1.0), question)
    assert "3 solutions" not in why
    assert "2 solutions" in why
    assert x[at] <= 1.0 / 7.0 <= x[at + 1]
    at, why = _bracket(
        x, np.where(x < 0.2, -1.0, x - 0.5 + 0.6 * (x > 0.9)) + 0.3 * (np.abs(x - 0.25) < 0.01), question
    )
    assert "one solution" in why or at >= 0
    assert _bracket(x, x - 0.5, question) == (3, "")

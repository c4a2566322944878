"""What the model refuses: scenarios by the name of their field and its line, and numbers that are no statistics."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from score_classes import classes, thresholds
from uncertain_scene import ATMOSPHERE, ORIGINS, SCENE, scenario

from hyperval import model
from hyperval.data import Components
from hyperval.errors import InputError, UsageError
from hyperval.scenario import Geometry, SpectrumUncertainty, load_scenario
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import ClassStatistics, builtin_class

CASES = yaml.safe_load(Path(__file__).with_name("refused.yaml").read_text())


@pytest.mark.parametrize("case", CASES, ids=[c["says"] for c in CASES])
def test_a_scenario_that_cannot_be_is_refused(tmp_path, case):
    text, (old, new) = SCENE + (ATMOSPHERE if case.get("light", True) else ""), case.get("change", ("", ""))
    assert old in text
    path = tmp_path / "bad.yaml"
    path.write_text(text.replace(old, new, 1) + case.get("add", ""))
    with pytest.raises((UsageError, InputError), match=case["says"]) as error:
        model.predict(load_scenario(path), ORIGINS)
    assert error.value.exit_code == case.get("exit", 2)
    assert "line" not in case or f"bad.yaml:{case['line']}: " in str(error.value)


def test_no_bands_at_all():
    with pytest.raises(UsageError, match="the scenario has no bands"):
        model.predict(scenario(""))


AXIS = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
MEAN, COVARIANCE = np.array([0.1, 0.2]), np.array([[4e-4, 1e-4], [1e-4, 9e-4]])
ONE = {"side_m": 1.0, "gsd_m": 1.0}
WEIGHTS, OFFSETS, TWO = np.array([0.5, 0.5]), np.zeros((2, 2)), np.stack([COVARIANCE, COVARIANCE])
PANEL = model.SurfaceStatistics("x", AXIS, MEAN, COVARIANCE, 16, "file")
FROM_FILE = SpectrumUncertainty(subject="x", from_file=True, divisor="standard_error")


def of_class(mean: Any = MEAN, covariance: Any = COVARIANCE, **more: Any) -> ClassStatistics:
    return ClassStatistics("grass", AXIS, np.array(mean), np.array(covariance), **more)


def few_pixels() -> Any:
    x = np.random.default_rng(6).standard_normal((6, 12))  # six pixels of twelve bands
    return model.design_filter("cem", x[0] + 1.0, x[1], np.cov(x.T))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: of_class([0.1]), r"class 'grass': mean \(1,\) and covariance \(2, 2\) do not fit 2 bands"),
        (lambda: of_class(covariance=[4e-4, 9e-4]), r"mean \(2,\) and covariance \(2,\) do not fit 2 bands"),
        (lambda: of_class([0.1, np.nan]), "mean and covariance must be finite"),
        (lambda: of_class(covariance=[[4e-4, np.inf], [np.inf, 9e-4]]), "mean and covariance must be finite"),
        (lambda: of_class(covariance=[[4e-4, 1e-4], [2e-4, 9e-4]]), "the covariance is not symmetric"),
        (lambda: of_class(covariance=[[4e-4, 7e-4], [7e-4, 9e-4]]), "is not positive semi-definite"),
        (lambda: of_class(tail_dof=2.0), "tail_dof must exceed 2, got 2"),
        (lambda: of_class(tail_dof=np.nan), "tail_dof must exceed 2, got nan"),
        (lambda: Components(np.array([0.5, 0.6]), OFFSETS, TWO), "sum to 1"),
        (lambda: Components(WEIGHTS, OFFSETS[:1], TWO), "contradict each other"),
        (lambda: Components(WEIGHTS, OFFSETS, -TWO), "not positive semi-definite"),
        (lambda: Components(WEIGHTS, OFFSETS, TWO, 1.5), "exceed 2"),
        (lambda: builtin_class("lawn", AXIS), "unknown built-in surface"),
        (lambda: builtin_class("grey-panel-100", AXIS), "unknown built-in surface"),
        (lambda: model.spectrum_error_rows(FROM_FILE, PANEL), "no standard deviation"),
        (lambda: model.beta_fill(0.0, 0.1), "no fill fraction between 0 and 1 has mean"),
        (lambda: model.beta_fill(0.5, 0.5), "no fill fraction between 0 and 1 has mean"),
        (lambda: model.beta_fill(0.1, 0.31), "no fill fraction between 0 and 1 has mean"),
        (lambda: model.object_fills(Geometry(**ONE | {"side_m": 1000.0}), 1), "64 pixels across"),
        (lambda: model.shared_pixel_fills(Geometry(**ONE, heading_deg="random"), 4, []), "has no heading"),
        (few_pixels, r"rank 5 of 12 bands, condition number"),
        (
            lambda: model.design_filter("cem", MEAN + 1, MEAN, np.diag([1.0, 0])),
            r"1 of 2 bands have no variance .*band 2\)",
        ),
        (
            lambda: model.design_filter("cem", MEAN + 1, MEAN, np.array([[1.0, np.nan], [np.nan, 1.0]])),
            "NaN or infinity",
        ),
        (lambda: model.design_filter("cem", MEAN, MEAN, COVARIANCE), "target"),
        (lambda: model.design_filter("cem", MEAN, MEAN[:-1], COVARIANCE), "do not fit each other"),
        (lambda: model.design_filter("ace", MEAN + 1, MEAN, COVARIANCE), "ace"),
        (lambda: model.two_panel_line([1.0, 1.0], [2.0, 1.0], 0.6, 0.1), "brighter"),
        (lambda: model.two_panel_line([1.0, 1.0], [2.0, 1.0], 0.1, 0.6), "no slope in 1 of 2"),
        (lambda: model.fully_constrained(np.ones(3), np.ones((2, 4))), "same bands"),
        (lambda: model.fully_constrained(np.array([1.0, np.nan]), np.eye(2)), "finite"),
        (lambda: thresholds([1e-3], classes((0.0, 0.0, 1.0))), "no background class"),
    ],
)
def test_numbers_that_cannot_be_are_refused(call, words):
    with pytest.raises(UsageError, match=words):
        call()

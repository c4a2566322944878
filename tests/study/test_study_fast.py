"""The fast evaluator against ``predict``, lever by lever."""

import numpy as np
import pytest

from hyperval.predict import predict
from hyperval.settings import with_settings
from hyperval.study.evaluate import Evaluator, Sky, difference_from_predict, make_ready
from hyperval.study.metrics import of_batch
from hyperval.study.schema import Output

EQUAL = 1e-9  # relative, as stated in docs/studies.md; P_D down to 1e-12


def evaluator_of(scenario) -> Evaluator:
    return Evaluator(make_ready(scenario, Sky()), Sky())


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor_changes.calibration_error_percent": 2.0, "sensor_changes.bits": 10},
        {"sensor_changes.signal_factor": 0.3, "sensor_changes.fixed_noise_factor": 4.0},
        {"sensor_operation.frames_averaged": 4, "sensor_operation.averaged": "before recording"},
        {"sensor_operation.spatial_binning": [2, 3]},
        {"scene.classes.asphalt.gain": 2.0, "scene.classes.grass.tail_dof": 3.0},
        {"scene.classes.asphalt.fraction": 0.2, "scene.classes.grass.fraction": 0.6},
        {"scene.adjacency.effective_neighbours": 3.0},
        {"scene.targets.plank.gain": 3.0, "scene.targets.plank.fill.fixed": 0.4},
        {"scene.targets.plank.illumination.beam": 0.2, "scene.targets.plank.illumination.sky_view": 0.7},
        {"processing.elm.reflectances": [0.05, 0.5], "formulation": "thesis"},
    ],
    ids=lambda c: next(iter(c)),
)
def test_each_lever_gives_what_predict_gives(scenario, changes):
    assert difference_from_predict(evaluator_of(scenario), changes) < EQUAL


@pytest.mark.parametrize("detector", ["cem", "smf", "cem-correlation"])
@pytest.mark.parametrize(
    "fill",
    [
        {"mean": 0.1, "sd": 0.03},
        {"geometry": {"side_m": 0.8, "gsd_m": 1.5, "pixels": "ranked", "n": 3}},
    ],
    ids=["moments", "geometry"],
)
def test_random_fills_and_detectors(scenario, detector, fill):
    inner = with_settings(scenario, {"processing.detectors": [detector], "scene.targets.plank.fill": fill})
    assert difference_from_predict(evaluator_of(inner), {"scene.targets.plank.gain": 2.0}) < EQUAL


def test_reflectance_domain(scenario):
    inner = with_settings(scenario, {"atmosphere": None, "scene.targets.plank.fill.fixed": 0.1})
    assert difference_from_predict(evaluator_of(inner), {"scene.classes.asphalt.gain": 2.0}) < EQUAL


def test_a_wrong_number_shows(scenario, monkeypatch):
    """The comparison with ``predict`` that every run makes can fail."""
    from hyperval.study import filters

    right = filters.Designer.class_scores
    monkeypatch.setattr(
        filters.Designer, "class_scores",
        lambda self, *a: (right(self, *a)[0], right(self, *a)[1] * (1 + 1e-6)),
    )  # fmt: skip
    assert difference_from_predict(evaluator_of(scenario), {"scene.targets.plank.fill.fixed": 0.1}) > EQUAL


def test_points_of_a_batch_do_not_disturb_each_other(scenario):
    rng = np.random.default_rng(3)
    columns = {
        "sensor_changes.calibration_error_percent": rng.uniform(0, 3, 7),
        "scene.targets.plank.fill.fixed": rng.uniform(0.02, 0.3, 7),
        "scene.classes.grass.tail_dof": rng.uniform(3, 30, 7),
    }
    outputs = [Output(name="pd", kind="pd", subject="plank", pfa=1e-4),
               Output(name="snr", kind="snr", subject="asphalt", range_nm=(450, 650))]  # fmt: skip
    together, _ = evaluator_of(scenario).values(columns, outputs)
    for i in range(7):
        alone, _ = evaluator_of(scenario).values({p: c[i : i + 1] for p, c in columns.items()}, outputs)
        np.testing.assert_allclose(together[i], alone[0], rtol=1e-10)


def test_areas_against_quadrature(scenario):
    """AUC in closed form, with Gaussian and t backgrounds, against the area under the finely drawn curve."""
    evaluator = evaluator_of(with_settings(scenario, {"scene.targets.plank.fill": {"mean": 0.03, "sd": 0.01}}))
    batch = evaluator.batch(evaluator.base, {"scene.classes.asphalt.tail_dof": np.array([2.5, 6.0, 40.0])}, 3)
    scores = batch.scores("plank", "cem")
    pfa = np.concatenate([np.geomspace(1e-10, 0.01, 2000, endpoint=False), np.linspace(0.01, 1.0 - 1e-9, 20001)])
    area = np.trapezoid(scores.detection(pfa[None, :]), pfa, axis=1)
    np.testing.assert_allclose(scores.auc(), area, atol=2e-5)


def test_false_alarms_at_a_detection_probability_is_the_inverse(scenario):
    evaluator = evaluator_of(with_settings(scenario, {"scene.targets.plank.fill": {"mean": 0.1, "sd": 0.03}}))
    batch = evaluator.batch(evaluator.base, {"scene.targets.plank.gain": np.array([0.5, 2.0])}, 2)
    ask = Output(name="x", kind="log10-pfa", subject="plank", pd=0.7)
    log_pfa = of_batch(batch, ask, None)
    back = batch.scores("plank", "cem").detection(10.0 ** log_pfa[:, None])
    np.testing.assert_allclose(back[:, 0], 0.7, rtol=1e-9)


def test_slow_scenarios_go_through_predict(scenario):
    inner = with_settings(scenario, {"processing.features": {"pca": 6}})
    evaluator = evaluator_of(inner)
    assert "features" in evaluator.base.slow
    output = Output(name="pd", kind="pd", subject="plank", pfa=1e-3)
    found, _ = evaluator.values({"scene.targets.plank.fill.fixed": np.array([0.1])}, [output])
    curve = predict(with_settings(inner, {"scene.targets.plank.fill.fixed": 0.1})).roc["plank", "cem", "pixel"]
    assert found[0, 0] == pytest.approx(curve.pd[np.argmin(np.abs(curve.pfa - 1e-3))], rel=1e-9)


def test_a_point_that_can_not_be_gets_a_reason(scenario):
    """Fractions that do not sum to 1 at one of four points: that one alone has no value."""
    columns = {"scene.classes.asphalt.fraction": np.array([0.5, 0.5, 0.6, 0.5])}
    output = Output(name="pd", kind="pd", subject="plank", pfa=1e-3)
    found, problems = evaluator_of(scenario).values(columns, [output])
    assert np.isnan(found[:, 0]).tolist() == [False, False, True, False]
    assert list(problems) == [2]
    assert "partition" in problems[2]

"""Columns of numbers against ``predict`` of single scenarios, entry by entry."""

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.model import Evaluation, column_of, detect, predict, read, settled, with_values
from hyperval.settings import setting, with_settings
from hyperval.study.evaluate import Evaluator, of_truths
from hyperval.study.schema import Output

EQUAL = 1e-9  # relative; P_D down to 1e-12
# What an entry stands for where the scenario does not state it.
DEFAULTS = {"calibration_error_percent": 1.0, "bits": 12, "signal_factor": 1.0, "fixed_noise_factor": 1.0,
            "frames_averaged": 1, "averaged": "after recording", "spatial_binning": [1, 1], "tail_dof": 9.0,
            "beam": 1.0, "sky_view": 1.0, "effective_neighbours": 1000.0}  # fmt: skip


def evaluator_of(scenario) -> Evaluator:
    return Evaluator(read(scenario))


def difference_from_predict(scenario, changes) -> float:
    """Greatest relative difference of radiance, SNR and P_D of a batch of three points from single predictions.

    The first point is the scenario as it stands, the others have the changes; what is no number is read anew.
    """
    stated = read(scenario)
    there = {p: DEFAULTS.get(p.rsplit(".", 1)[-1], setting(scenario, p) if has(scenario, p) else None) for p in changes}
    columns = {p: column_of([there[p], v, v]) for p, v in changes.items()}
    worst = 0.0
    for index, part in settled(with_values(stated, columns)):
        e = Evaluation(part)
        each = detect(e, points=range(len(e)))
        for u, point in enumerate(index.tolist()):
            at = there if point == 0 else changes
            prediction = predict(with_settings(scenario, at))
            pairs = [(e.radiance(s)[u], p.mean) for s, p in prediction.radiance.items() if s != "plank"]
            pairs += [(e.snr(s)[u], prediction.snr[s].mean) for s in e.stated.classes if prediction.snr]
            found = each[u].roc
            pairs += [(found[key].pd, curve.pd) for key, curve in prediction.roc.items()]
            for ours, theirs in pairs:
                known = np.isfinite(theirs) & (np.abs(theirs) > 1e-12)
                worst = max(worst, float(np.max(np.abs(ours[known] / theirs[known] - 1.0), initial=0.0)))
    return worst


def has(scenario, path) -> bool:
    try:
        setting(scenario, path)
    except UsageError:
        return False
    return True


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor_changes.calibration_error_percent": 2.0, "sensor_changes.bits": 10},
        {"sensor_changes.signal_factor": 0.3, "sensor_changes.fixed_noise_factor": 4.0},
        {"sensor_operation.frames_averaged": 4, "sensor_operation.averaged": "before recording"},
        {"sensor_operation.spatial_binning": [2, 3]},
        {"scene.classes.asphalt.gain": 2.0, "scene.classes.grass.tail_dof": 3.0},
        {"scene.classes.asphalt.tail_dof": 3.0, "scene.targets.plank.fill.fixed": 0.02},
        {"scene.classes.asphalt.fraction": 0.2, "scene.classes.grass.fraction": 0.6},
        {"scene.adjacency.effective_neighbours": 3.0},
        {"scene.targets.plank.gain": 3.0, "scene.targets.plank.fill.fixed": 0.4},
        {"scene.targets.plank.illumination.beam": 0.2, "scene.targets.plank.illumination.sky_view": 0.7},
        {"processing.elm.reflectances": [0.05, 0.5], "formulation": "thesis"},
    ],
    ids=lambda c: next(iter(c)),
)
def test_each_column_gives_what_predict_gives(scenario, changes):
    assert difference_from_predict(scenario, changes) < EQUAL


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
    assert difference_from_predict(inner, {"scene.targets.plank.gain": 2.0}) < EQUAL


def test_reflectance_domain(scenario):
    inner = with_settings(scenario, {"atmosphere": None, "scene.targets.plank.fill.fixed": 0.1})
    assert difference_from_predict(inner, {"scene.classes.asphalt.gain": 2.0}) < EQUAL


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
    world = read(with_settings(scenario, {"scene.targets.plank.fill": {"mean": 0.03, "sd": 0.01}}))
    e = Evaluation(with_values(world, {"scene.classes.asphalt.tail_dof": np.array([2.5, 6.0, 40.0])}))
    scores = e.scores("plank", "cem")
    pfa = np.concatenate([np.geomspace(1e-10, 0.01, 2000, endpoint=False), np.linspace(0.01, 1.0 - 1e-9, 20001)])
    area = np.trapezoid(scores.detection(pfa[None, :]), pfa, axis=1)
    np.testing.assert_allclose(scores.auc(), area, atol=2e-5)


def test_false_alarms_at_a_detection_probability_is_the_inverse(scenario):
    world = read(with_settings(scenario, {"scene.targets.plank.fill": {"mean": 0.1, "sd": 0.03}}))
    e = Evaluation(with_values(world, {"scene.targets.plank.gain": np.array([0.5, 2.0])}))
    ask = Output(name="x", kind="log10-pfa", subject="plank", pd=0.7)
    log_pfa = of_truths(e, ask, None)
    back = e.scores("plank", "cem").detection(10.0 ** log_pfa[:, None])
    np.testing.assert_allclose(back[:, 0], 0.7, rtol=1e-9)


ALL_OF_A_KIND = {
    "features": {"processing.features": {"pca": 6}},
    "mnf": {"processing.features": {"mnf": 5}},
    "darkest pixel": {"processing.elm": {"darkest_pixel": 10_000}},
    "classes of the filter": {"processing.filter_classes": ["asphalt", "soil"]},
    "ace": {"processing.detectors": ["ace", "cem"], "processing.samples": 400},
}


@pytest.mark.parametrize("settings", ALL_OF_A_KIND.values(), ids=ALL_OF_A_KIND)
def test_what_takes_its_own_matrix_or_draws_in_each_setting(scenario, settings):
    inner = with_settings(scenario, settings)
    fill = "subjects.plank.fill" if "scene.targets.plank.subjects" in settings else "fill"
    changes = {f"scene.targets.plank.{fill}.fixed": 0.1, "scene.classes.asphalt.gain": 2.0,
               "sensor_changes.signal_factor": 0.5}  # fmt: skip
    assert difference_from_predict(inner, changes) < EQUAL


def test_a_point_that_can_not_be_gets_a_reason(scenario):
    """Fractions that do not sum to 1 at one of four points: that one alone has no value."""
    columns = {"scene.classes.asphalt.fraction": np.array([0.5, 0.5, 0.6, 0.5])}
    output = Output(name="pd", kind="pd", subject="plank", pfa=1e-3)
    found, problems = evaluator_of(scenario).values(columns, [output])
    assert np.isnan(found[:, 0]).tolist() == [False, False, True, False]
    assert list(problems) == [2]
    assert "partition" in problems[2]

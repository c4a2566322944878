"""Points: order, any stretch, distributions."""

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from hyperval.errors import UsageError
from hyperval.study.schema import load_study
from hyperval.study.tables import StudyPoints, moved

OUT = "outputs: [{name: pd, kind: pd, subject: plank, pfa: 1.0e-3}]\n"
FILL = "scene.targets.plank.fill.fixed"
RANDOM = f"""
inputs:
  - {{name: fill, path: {FILL}, values: [0.1, 0.2, 0.3]}}
  - {{name: c, path: sensor_changes.calibration_error_percent, random: {{uniform: [0, 4]}}}}
  - {{name: s, path: sensor_changes.signal_factor, random: {{log_uniform: [0.1, 10]}}}}
  - {{name: f, path: sensor_changes.fixed_noise_factor, random: {{normal: [1, 0.5], within: [0.5, 3]}}}}
design: {{count: 512, seed: 4}}
{OUT}"""


def test_any_stretch_is_a_part_of_the_whole(make_study):
    points = StudyPoints(make_study(RANDOM)[0])
    assert len(points) == 3 * 512
    whole = points.stretch(0, len(points))
    for start, stop in ((0, 1), (1, 5), (100, 700), (1535, 1536)):
        part = points.stretch(start, stop)
        for name, column in part.items():
            np.testing.assert_array_equal(column, whole[name][start:stop])


def test_draws_follow_their_distributions(make_study):
    """Sobol points are more even than random ones, of which Kolmogorov's distance has a 5 % limit of 0.06."""
    points = StudyPoints(make_study(RANDOM)[0])
    whole = points.stretch(0, len(points))
    assert kstest(whole["c"][::3] / 4.0, "uniform").statistic < 0.01
    assert kstest((np.log10(whole["s"][::3]) + 1.0) / 2.0, "uniform").statistic < 0.01
    assert kstest(whole["f"][::3], truncnorm(-1.0, 4.0, 1.0, 0.5).cdf).statistic < 0.01


def test_the_seed_decides_the_draws(make_study):
    first = StudyPoints(make_study(RANDOM)[0]).stretch(0, 30)["c"]
    other = StudyPoints(make_study(RANDOM.replace("seed: 4", "seed: 5"))[0]).stretch(0, 30)["c"]
    assert not np.array_equal(first, other)


def test_several_entries_move_together(make_study):
    text = f"""
inputs:
  - name: grass
    moves:
      - {{path: scene.classes.grass.fraction}}
      - {{path: scene.classes.asphalt.fraction, factor: -1, offset: 0.8}}
    values: [0.1, 0.3]
  - {{name: way, moves: [{{path: a.b}}, {{path: c.d}}], values: [[1, x], [2, y]]}}
{OUT}"""
    study, _ = make_study(text)
    columns = moved({i.name: i for i in study.inputs}, StudyPoints(study).stretch(0, 4))
    np.testing.assert_allclose(columns["scene.classes.asphalt.fraction"], [0.7, 0.7, 0.5, 0.5])
    assert columns["a.b"].tolist() == [1, 2, 1, 2]
    assert columns["c.d"].tolist() == ["x", "y", "x", "y"]


def test_one_at_a_time(make_study):
    text = f"""
inputs:
  - {{name: fill, path: {FILL}, values: [0.1, 0.2]}}
  - {{name: c, path: sensor_changes.calibration_error_percent, values: [3]}}
design: {{kind: one-at-a-time}}
{OUT}"""
    points = StudyPoints(make_study(text)[0])
    whole = points.stretch(0, len(points))
    assert whole["fill"].tolist() == [None, 0.1, 0.2, None]
    assert whole["c"].tolist() == [None, None, None, 3.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"inputs: [{{name: a, path: {FILL}}}]\n{OUT}", "exactly one of values, grid, random"),
        (f"inputs: [{{name: a, path: {FILL}, values: [0.1], gird: 1}}]\n{OUT}", "did you mean 'grid'"),
        (f"inputs: [{{name: pd, path: {FILL}, values: [0.1]}}]\n{OUT}", "names stand twice"),
        (f"inputs: [{{name: a, path: {FILL}, random: {{normal: [1, 2]}}}}]\n{OUT}", "within and normal"),
        (
            f"inputs: [{{name: a, path: {FILL}, values: [0.1]}}]\n{OUT}knees: [{{output: pd, along: b}}]",
            "none of a",
        ),
        (f"inputs: [{{name: a, path: pfa, values: [0.1]}}]\n{OUT}", "and not both"),
        (
            f"inputs: [{{name: a, path: x.y, values: [1]}}, {{name: b, path: x.y, values: [1]}}]\n{OUT}",
            "two inputs",
        ),
        (
            f"inputs: [{{name: a, path: x.y, values: [1]}}]\n{OUT}plots: [{{kind: tornado, output: pd}}]",
            "tornado goes",
        ),
    ],
)
def test_mistakes_are_told_with_their_line(make_study, text, message):
    with pytest.raises(UsageError, match=message):
        make_study(text)


def test_more_points_than_anybody_waits_for(make_study, tmp_path):
    grid = "{start: 0, stop: 1, count: 100000}"
    text = "inputs:\n" + "".join(f"  - {{name: a{k}, path: x.y{k}, grid: {grid}}}\n" for k in range(2)) + OUT
    _, path = make_study(text)
    with pytest.raises(UsageError, match="10,000,000,000 points"):
        load_study(path)

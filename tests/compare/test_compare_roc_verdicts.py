"""Three outcomes of a comparison with a margin, and the two readings of (3.32)."""

import numpy as np
import pytest
from scipy.stats import norm

from hyperval.compare import compare_roc, equivalence
from hyperval.model import ClassScores, greatest_class_false_alarm, thresholds_at
from hyperval.products import RocCurve
from hyperval.results import Outcome

PFA = np.geomspace(1e-4, 0.999, 81)


def curve(pd, half=0.0, n=None, preset=None):
    level = np.full(PFA.size, pd)
    return RocCurve(
        PFA, level, level - half, level + half, norm.isf(PFA), "object", n, None if n is None else 100_000, None,
        preset_pfa=preset,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("predicted", "half", "code", "word"),
    [
        (0.62, 0.05, 1.0, "equivalent"),
        (0.66, 0.02, 1.0, "equivalent, though not the same"),
        (0.62, 0.2, 0.0, "undecided"),
        (0.9, 0.2, -1.0, "different"),
        (0.3, 0.2, -1.0, "different"),
    ],
)
def test_equivalent_different_or_undecided(predicted, half, code, word):
    rows = compare_roc(
        curve(predicted),
        curve(0.6, half, 80),
        subject="s",
        method="cem/object",
        equivalence_margin=0.15,
    )
    row = next(r for r in rows if r.metric == "pd_equivalence@1e-2")
    assert row.value == code
    assert row.reason == f"{word} by a margin 0.15"
    equal = next(r for r in rows if r.metric == "pd_equivalent@1e-2")
    assert equal.value == float(code == 1.0)


def test_equivalence_needs_few_doubts_not_few_targets():
    assert equivalence((-0.3, 0.3), 0.1)[1] == "undecided"
    assert equivalence((-0.3, 0.3), 0.4)[1] == "equivalent"
    assert equivalence((0.11, 0.3), 0.1)[1] == "different"


def test_one_target_gives_no_verdict():
    one = RocCurve(PFA, np.ones(81), np.full(81, 0.025), np.ones(81), norm.isf(PFA), "object", 1, 100_000)
    rows = compare_roc(curve(0.9), one, subject="s", method="m", equivalence_margin=0.15)
    assert next(r for r in rows if r.metric == "pd_equivalence@1e-2").outcome is Outcome.SKIPPED


def presets(x: np.ndarray, classes: ClassScores) -> np.ndarray:
    return greatest_class_false_alarm(x, classes.rows(np.zeros(x.size, int)))


def test_both_readings_are_reported_where_they_differ():
    # Two classes; the rarer has the longer tail: its own P_FA is ten times that of the scene.
    classes = ClassScores(*np.array([[[0.9, 0.1]], [[0.0, 0.1]], [[0.1, 0.2]], [[np.inf, np.inf]]]))
    x = thresholds_at(PFA[None], classes)[0]
    pd = norm.sf((x - 0.6) / 0.15)
    swept = RocCurve(PFA, pd, pd, pd, x, "object", preset_pfa=presets(x, classes))
    measured = RocCurve(PFA, pd, pd - 0.05, pd + 0.05, x, "object", 300, 100_000)
    rows = {r.metric: r for r in compare_roc(swept, measured, subject="s", method="m")}
    # By hand: the longest tail is that of the second class, x = 0.1 + 0.2 Phi^-1(1 - P).
    by_hand = norm.sf((0.1 + 0.2 * norm.isf(1e-2) - 0.6) / 0.15)
    assert rows["pd_predicted_preset@1e-2"].value == pytest.approx(by_hand, abs=0.003)
    assert rows["pd_predicted@1e-2"].value > by_hand + 0.05
    assert rows["pd_inside_interval@1e-2"].value == 1.0
    assert rows["pd_inside_interval_preset@1e-2"].value == 0.0
    # With one class both are the same, and one row is enough.
    alone = ClassScores(*np.array([[[1.0]], [[0.0]], [[0.1]], [[np.inf]]]))
    x = thresholds_at(PFA[None], alone)[0]
    single = RocCurve(PFA, pd, pd, pd, x, "object", preset_pfa=presets(x, alone))
    rows = compare_roc(single, measured, subject="s", method="m")
    assert not [r for r in rows if "preset" in r.metric]


def test_a_preset_at_the_end_of_what_is_known_is_reported():
    measured = curve(0.6, 0.05, 300)
    pd = np.linspace(0.2, 0.9, PFA.size)
    for end, there in ((1e-2, True), (0.99e-2, False)):
        known = np.append(
            (PFA * end / PFA[-1])[:-1], end
        )  # the last preset is the one that is asked for, or lies below
        swept = RocCurve(PFA, pd, pd, pd, norm.isf(PFA), "object", preset_pfa=known)
        rows = compare_roc(swept, measured, subject="s", method="m")
        assert any(r.metric == "pd_predicted_preset@1e-2" for r in rows) == there

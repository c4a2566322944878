"""ROC of the model: properties over many backgrounds, limits and the printed procedure."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from score_classes import classes, printed_procedure, roc_of, thresholds

from hyperval.errors import UsageError
from hyperval.model import ClassScores, RocScores, false_alarm_grid


def backgrounds(seed: int) -> ClassScores:
    rng = np.random.default_rng(seed)
    count = rng.integers(1, 6)
    fractions = rng.dirichlet(np.ones(count))
    dof = [np.inf if rng.random() < 0.7 else float(rng.uniform(2.5, 30)) for _ in range(count)]
    return classes(
        *((float(f), float(rng.normal(0, 0.3)), float(rng.uniform(0.01, 0.5)), d)
          for f, d in zip(fractions, dof, strict=True))
    )  # fmt: skip


def curve(target: RocScores, pfa=None) -> np.ndarray:
    return target.detection(np.atleast_2d(false_alarm_grid() if pfa is None else np.asarray(pfa, dtype=float)))[0]


@given(st.integers(0, 100_000), st.floats(-1, 2), st.floats(0.01, 1))
@settings(max_examples=40)
def test_the_printed_procedure_lies_on_the_sweep(seed, mean, sd):
    scores = backgrounds(seed)
    pfa, pd, _ = printed_procedure(mean, sd, scores, np.logspace(-10, -0.5, 60))
    assert curve(roc_of(mean, sd, 1.0, scores), pfa) == pytest.approx(pd, abs=1e-7)


def test_a_target_like_its_background_is_on_the_diagonal():
    assert curve(roc_of(0.2, 0.3, 1.0, classes((1.0, 0.2, 0.3)))) == pytest.approx(false_alarm_grid(), rel=1e-6)


def test_no_background():
    with pytest.raises(UsageError, match="no background class"):
        thresholds([1e-3], classes((0.0, 0.0, 1.0)))

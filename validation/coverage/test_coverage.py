"""A reduced coverage study; ``make coverage`` runs the whole of it.

60 collections, 30 of them with pixels for the detectors.  Limits for a true rate of 95 % or 5 %, for which chance
leaves them less than once in 1,000 runs each (binomial); the seed is fixed, so that a failure is a change of code.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from hyperval.model import clopper_pearson

sys.path.insert(0, str(Path(__file__).parent))

from counts import COVERED, FOUND, outcomes, share_of

import study

# Least number covered of n at 95 %: P(X < 51 of 60) = 7e-4, P(X < 24 of 30) = 6e-4.
LEAST = {60: 51, 30: 24}
# Greatest number rejected of 60 at 5 %: P(X > 9) = 7e-4.
MAX_REJECTED = 9

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found():
    stated = study.Origins(axis=study.AXIS, engine=study.engine)
    linear = study.predict(study.scenario(), stated, objects=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "predictions", lambda draws: {"linear": linear})
        with_pixels = study.Batch("collections", 0, 30, seed=7, detection=True, methods=("linear",))
        without = study.Batch("collections", 30, 60, seed=7, methods=("linear",))
        return outcomes([with_pixels.tally(), without.tally()])


def test_every_product_is_there(found):
    assert {(o.product, o.subject) for o in found} == {
        ("radiance", "field"), ("radiance", "bright"), ("reflectance", "field"), ("snr", "bright"),
        ("P_D", "plank"), ("AUC", "plank"), ("scores", "plank"),
    }  # fmt: skip
    assert all(o.comparisons >= o.worlds > 0 for o in found)


def test_intervals_hold_the_difference(found):
    for o in (o for o in found if o.wanted == COVERED):
        # Bands of a collection move together: their share is judged as if every collection had one band.
        assert o.share >= LEAST[o.worlds] / o.worlds, o


def test_consistency_test_rejects_tilted_collections_and_few_others(found):
    for o in (o for o in found if "rejects" in o.what):
        if o.wanted == FOUND:
            assert o.share > 0.8, o  # P(X <= 48 of 60) = 3e-6 at the 97 % of the whole study
        else:
            assert o.share <= MAX_REJECTED / 60, o


def test_whole_campaigns_without_error_meet_their_criteria_and_stand_first():
    # One in twenty may find its model wrong; these five, one of each layout, do not.
    batch = study.Batch("campaigns", 0, 5, seed=5)
    first, *rest = outcomes([batch.tally()])
    assert (first.what, first.share, first.worlds) == ("any criterion not met", 0.0, 5)
    assert {o.subject for o in rest} >= {"bhattacharyya_covariance_excess", "noise_ratio", "pfa_ratio@1e-2"}


@pytest.mark.parametrize("together", [1, 40])
def test_intervals_that_move_together_count_as_one(together):
    """Bands of a world that all hold or all miss say no more of the share than one of them."""
    share, *limits = share_of([(float(world >= 6) * together, together) for world in range(100)])
    assert share == 0.94
    assert limits == pytest.approx([float(x) for x in clopper_pearson(94, 100)])


def test_every_kind_of_map_has_its_intervals():
    found = set(study.Batch("maps", 0, 1, seed=3).tally())
    assert {"area of an object", "P_D at 0.01, rare clusters", "eigenvalue 1"} <= {what for _, _, what, _ in found}
    assert {where for _, where, _, _ in found} == {"independent", "clusters"}


def test_counts_of_a_batch_are_read_where_they_are_kept(tmp_path, monkeypatch):
    batch, kept = study.Batch("maps", 0, 1, seed=3), study.Kept(tmp_path, "code")
    one = {("interval", "independent", "auc", "pixels"): [(1.0, 1)]}
    monkeypatch.setattr(study.Batch, "tally", lambda self: one)
    first = kept.tally(batch)
    monkeypatch.setattr(study.Batch, "tally", lambda self: pytest.fail("made anew"))
    assert kept.tally(batch) == first
    with pytest.raises(pytest.fail.Exception):
        study.Kept(tmp_path, "other code").tally(batch)

"""Finished chunks are kept, halves are not."""

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.study.tables import PointStore


def test_rows_come_back_with_their_reasons(tmp_path):
    store = PointStore(tmp_path / "s", "a", 2, 3)
    store.append(np.arange(6.0).reshape(3, 2), {1: "why; ä"})
    again = PointStore(tmp_path / "s", "a", 2, 3)
    assert again.finished == 3
    np.testing.assert_array_equal(again.values(), np.arange(6.0).reshape(3, 2))
    assert again.reasons() == {1: "why; ä"}


def test_half_a_chunk_is_cut_off(tmp_path):
    store = PointStore(tmp_path / "s", "a", 2, 3)
    store.append(np.zeros((3, 2)), {})
    with open(tmp_path / "s" / "values.f64", "ab") as stream:
        stream.write(bytes(24))
    with open(tmp_path / "s" / "reasons.jsonl", "a") as stream:
        stream.write('[4, "of a lost chunk"]\n[5, "brok')
    again = PointStore(tmp_path / "s", "a", 2, 3)
    assert again.finished == 3
    assert again.reasons() == {}


def test_another_study_begins_anew(tmp_path):
    PointStore(tmp_path / "s", "a", 1, 2).append(np.ones((2, 1)), {})
    assert PointStore(tmp_path / "s", "b", 1, 2).finished == 0


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="not of a study"):
        PointStore(tmp_path / "s", "a", 1, 2)
    assert (tmp_path / "s" / "thesis.txt").read_text() == "mine"

"""The cache: computed once, never trusted blindly."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from hyperval.atmosphere import cache_folder, cached

INPUTS = {"depth": 0.1, "card": "4\n"}
ARRAYS = {"a": np.arange(3.0), "b": np.ones((2, 2))}


@pytest.fixture
def entry(tmp_path):
    """What is stored, and what asks for it and tells how often it has been computed."""
    calls = []

    def found(inputs=INPUTS):
        arrays = cached(tmp_path, "kind", inputs, lambda: calls.append(1) or ARRAYS)
        np.testing.assert_equal(arrays, ARRAYS)
        return len(calls)

    assert found() == found() == 1
    (path,) = (tmp_path / "kind").iterdir()
    return path, found


def test_any_flipped_byte_of_an_entry_is_seen_or_harmless(entry):
    path, found = entry
    raw = path.read_bytes()
    for at in range(0, len(raw), 3):
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 0x55]) + raw[at + 1 :])
        found()
    assert found() > len(raw) / 6


def test_an_entry_that_is_cut_or_of_other_inputs_is_computed_again(entry):
    path, found = entry
    raw, other = path.read_bytes(), {**INPUTS, "depth": 0.1000001}
    for number, left in enumerate((raw[: len(raw) // 2], b""), 2):
        path.write_bytes(left)
        assert found() == found() == number
    assert found(other) == 4
    first, second = sorted(path.parent.iterdir())
    first.write_bytes(second.read_bytes())  # the right bytes under the wrong name
    assert {found(), found(other)} <= {4, 5}
    assert found() == found(other) == 5


def test_many_writers_leave_one_whole_entry_and_a_folder_that_cannot_be_written_is_no_error(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    for folder in (tmp_path, tmp_path / "file"):
        with ThreadPoolExecutor(8) as pool:
            for arrays in pool.map(lambda _, at: cached(at, "kind", INPUTS, lambda: ARRAYS), range(32), [folder] * 32):
                np.testing.assert_equal(arrays, ARRAYS)
    assert [p.suffix for p in (tmp_path / "kind").iterdir()] == [".npz"]


def test_folder_comes_from_argument_then_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "env"))
    assert (cache_folder(), cache_folder(tmp_path)) == (tmp_path / "env", tmp_path)
    monkeypatch.delenv("HYPERVAL_CACHE")
    assert "hyperval" in str(cache_folder())

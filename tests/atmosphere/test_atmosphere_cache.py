"""The cache: computed once, never trusted blindly."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from hyperval.atmosphere import cache_folder, cached

INPUTS = {"depth": 0.1, "card": "4\n"}


class Counter:
    def __init__(self, arrays=None):
        self.calls = 0
        self.arrays = arrays or {"a": np.arange(3.0)}

    def __call__(self):
        self.calls += 1
        return self.arrays


def test_any_flipped_byte_of_an_entry_is_seen_or_harmless(tmp_path):
    compute = Counter({"a": np.arange(3.0), "b": np.ones((2, 2))})
    cached(tmp_path, "kind", INPUTS, compute)
    (entry,) = (tmp_path / "kind").iterdir()
    raw = entry.read_bytes()
    again = 0
    for at in range(len(raw)):
        entry.write_bytes(raw[:at] + bytes([raw[at] ^ 0x55]) + raw[at + 1 :])
        before = compute.calls
        result = cached(tmp_path, "kind", INPUTS, compute)
        again += compute.calls - before
        assert sorted(result) == ["a", "b"]
        np.testing.assert_array_equal(result["a"], np.arange(3.0))
        np.testing.assert_array_equal(result["b"], np.ones((2, 2)))
    assert again > len(raw) / 2


def test_many_writers_leave_one_whole_entry(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(lambda _: cached(tmp_path, "kind", INPUTS, Counter()), range(32)))
    assert all(np.array_equal(r["a"], np.arange(3.0)) for r in results)
    assert [p.suffix for p in (tmp_path / "kind").iterdir()] == [".npz"]


def test_folder_that_cannot_be_written_is_no_error(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    compute = Counter()
    assert np.array_equal(cached(blocked, "kind", INPUTS, compute)["a"], np.arange(3.0))


def test_folder_comes_from_argument_then_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "env"))
    assert cache_folder() == tmp_path / "env"
    assert cache_folder(tmp_path / "given") == tmp_path / "given"
    monkeypatch.delenv("HYPERVAL_CACHE")
    assert "hyperval" in str(cache_folder())


def test_an_entry_that_is_cut_or_of_other_inputs_is_computed_again(tmp_path):
    compute = Counter()
    for entry in (None, lambda raw: raw[: len(raw) // 2], lambda raw: b""):
        if entry is not None:
            (path,) = (tmp_path / "kind").iterdir()
            path.write_bytes(entry(path.read_bytes()))
        before = compute.calls
        for _ in range(2):  # the second call reads what the first wrote
            np.testing.assert_array_equal(cached(tmp_path, "kind", INPUTS, compute)["a"], np.arange(3.0))
        assert compute.calls == before + 1
    other = {**INPUTS, "depth": 0.1000001}
    cached(tmp_path, "kind", other, compute)
    first, second = sorted((tmp_path / "kind").iterdir())
    first.write_bytes(second.read_bytes())  # the right bytes under the wrong name
    for inputs in (INPUTS, other):
        cached(tmp_path, "kind", inputs, compute)
    assert compute.calls == 5

"""The cache: computed once, never trusted blindly."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from hyperval.atmosphere.cache import cache_folder, cache_key, cached, content_digest

INPUTS = {"depth": 0.1, "card": "4\n"}


class Counter:
    def __init__(self, arrays=None):
        self.calls = 0
        self.arrays = arrays or {"a": np.arange(3.0)}

    def __call__(self):
        self.calls += 1
        return self.arrays


def test_second_call_reads_what_the_first_wrote(tmp_path):
    compute = Counter()
    first = cached(tmp_path, "kind", INPUTS, compute)
    second = cached(tmp_path, "kind", INPUTS, compute)
    assert compute.calls == 1
    np.testing.assert_array_equal(first["a"], second["a"])


def test_key_follows_the_values_not_their_order():
    assert cache_key({"a": 1, "b": 2}) == cache_key({"b": 2, "a": 1})
    assert cache_key(INPUTS) != cache_key({**INPUTS, "depth": 0.1000001})


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


@pytest.mark.parametrize(
    "harm",
    ["truncated", "garbage", "empty", "other inputs", "nan", "an array less", "another shape", "another name"],
)
def test_corrupted_entry_is_computed_again(tmp_path, harm):
    compute = Counter()
    cached(tmp_path, "kind", INPUTS, compute)
    (entry,) = (tmp_path / "kind").iterdir()
    raw = entry.read_bytes()
    if harm == "truncated":
        entry.write_bytes(raw[: len(raw) // 2])
    elif harm == "garbage":
        entry.write_bytes(bytes(range(256)) * 4)
    elif harm == "empty":
        entry.write_bytes(b"")
    elif harm == "other inputs":
        np.savez(entry, inputs=np.array("{}"), content=np.array(content_digest(compute.arrays)), **compute.arrays)
    else:
        held = {
            "nan": {"a": np.full(3, np.nan)},
            "an array less": {},
            "another shape": {"a": np.arange(3.0)[None]},
            "another name": {"b": np.arange(3.0)},
        }[harm]
        content = content_digest(held if harm == "nan" else compute.arrays)
        np.savez(entry, inputs=np.array(json.dumps(INPUTS, sort_keys=True)), content=np.array(content), **held)
    result = cached(tmp_path, "kind", INPUTS, compute)
    assert compute.calls == 2
    np.testing.assert_array_equal(result["a"], np.arange(3.0))
    cached(tmp_path, "kind", INPUTS, compute)
    assert compute.calls == 2  # the entry was mended


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

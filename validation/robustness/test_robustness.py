"""A fixed sample of the damaged files, and that the study sees what it is to see."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from mutants import DAMAGES, mutant
from mutation_study import DEFECTS, READ, REFUSED, batch, outcome, table
from samples import ImplausibleError, Sample, finite, increasing, samples

from hyperval.errors import EngineError, HypervalError, InputError

MUTANTS = 60  # of each sample
OF_LARGE = 20  # of those whose files take long to read


@pytest.fixture(scope="module")
def every(tmp_path_factory: pytest.TempPathFactory) -> list[Sample]:
    return samples(tmp_path_factory.mktemp("made"))


def test_every_sample_is_read_as_it_stands(every: list[Sample], tmp_path: Path):
    assert len(every) > 50
    assert len({sample.name for sample in every}) == len(every)
    for number, sample in enumerate(every):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name, content in sample.files.items():
            (folder / name).write_bytes(content)
        assert outcome(sample, folder) == (READ, ""), sample.name


@pytest.mark.slow
def test_damaged_files_are_read_or_refused_with_one_clear_error(every: list[Sample]):
    bad = {}
    for sample in every:
        found = batch(sample, range(OF_LARGE if sample.share < 0.05 else MUTANTS))
        if found["examples"]:
            bad[sample.name] = found["examples"]
    assert bad == {}


def test_the_same_number_is_the_same_damage():
    content = bytes(range(256)) * 4
    made = [mutant(content, "a", n) for n in range(200)]
    assert made == [mutant(content, "a", n) for n in range(200)]
    assert made != [mutant(content, "b", n) for n in range(200)]
    assert sum(m != content for m in made) > 190
    assert len({d.__name__ for d in DAMAGES}) == 11
    for n in range(200):
        mutant(b"", "empty", n)


def harmful(path: Path) -> None:
    kind = len(path.read_bytes()) % 6
    if kind == 0:
        raise InputError("clear")
    if kind == 1:
        raise KeyError("internal")
    if kind == 2:
        increasing([2.0, 1.0], "values")
    if kind == 3:
        signal.raise_signal(signal.SIGTERM)
    if kind == 4:
        bytearray(4 << 30)
    raise HypervalError("of no kind that a reader may raise")


def test_the_study_sees_crashes_memory_and_wrong_errors_and_goes_on():
    sample = Sample("harmful", {"a": b"abcdefghijkl"}, harmful)
    found = batch(sample, range(40))
    assert sum(found["counts"].values()) == 40
    assert set(found["counts"]) == {REFUSED, "internal error", "implausible", "crash", "out of memory"}
    assert found == batch(sample, range(40))
    assert {what for _, what, _ in found["examples"]} <= set(DEFECTS)
    assert f"| harmful | 40 | 0 | {found['counts'][REFUSED]} |" in table({"harmful": found})


def test_what_takes_too_long_is_ended(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("mutation_study.SECONDS", 1)

    def waits(path: Path) -> None:
        if len(path.read_bytes()) != 3:
            time.sleep(30)

    found = batch(Sample("waits", {"a": b"abc"}, waits), range(2))
    assert found["counts"].get("too long", 0) + found["counts"].get(READ, 0) == 2
    assert found["counts"]["too long"] >= 1


@pytest.mark.parametrize("values", [[], [1.0, 1.0], [2.0, 1.0], [1.0, float("nan")]])
def test_what_a_reader_gives_back_is_looked_at(values: list[float]):
    with pytest.raises(ImplausibleError):
        increasing(values, "wavelength_nm")
    if values and values[-1] != values[-1]:
        with pytest.raises(ImplausibleError):
            finite(values, "values")
    assert EngineError("x").exit_code in (2, 3)

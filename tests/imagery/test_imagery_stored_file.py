"""A file read at stated places, opened once for many reads."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from hyperval.errors import InputError
from hyperval.imagery import envi
from hyperval.imagery.envi import StoredFile


@pytest.fixture
def made(tmp_path):
    path = tmp_path / "numbers.img"
    np.arange(1000, dtype="<i2").tofile(path)
    return StoredFile(path)


def filled(file, first, count):
    out = np.empty(count, "<i2")
    file.fill(out, 2 * first)
    return out


@pytest.fixture(params=["preadv", "seek"])
def way(request, monkeypatch):
    """Either way of reading; systems without ``preadv`` seek first."""
    if request.param == "seek":
        monkeypatch.delattr(envi.os, "preadv", raising=False)
    elif not hasattr(envi.os, "preadv"):
        pytest.skip("this system has no preadv")


@pytest.mark.usefixtures("way")
def test_threads_read_their_own_places(made):
    with made.kept_open(), ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda i: filled(made, 7 * i, 7), range(140)))
    assert np.array_equal(np.concatenate(found), np.arange(980))


def test_it_is_open_while_somebody_reads(made):
    with made.kept_open() as outer:
        with made.kept_open() as inner:
            assert inner is outer
        filled(made, 0, 3)
        assert not outer.closed
    assert outer.closed
    assert np.array_equal(filled(made, 5, 3), [5, 6, 7])  # opened again


def test_it_is_closed_after_an_error(made):
    with pytest.raises(KeyError), made.kept_open() as stream:
        raise KeyError("x")
    assert stream.closed


@pytest.mark.usefixtures("way")
def test_a_file_that_ends_before_is_an_error(made):
    with pytest.raises(InputError, match="became shorter while it was read"):
        filled(made, 990, 20)


def test_another_process_opens_it_for_itself(made):
    with made.kept_open():
        other = pickle.loads(pickle.dumps(made))  # noqa: S301 - made here
        assert np.array_equal(filled(other, 1, 2), [1, 2])
    assert np.array_equal(filled(other, 1, 2), [1, 2])

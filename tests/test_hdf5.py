"""Files that the HDF5 library does not return from are refused before the library opens them for good."""

import os
import signal
import struct
from pathlib import Path

import h5py
import pytest

from hyperval import api, hdf5
from hyperval.atmosphere import read_table
from hyperval.errors import InputError
from hyperval.hdf5 import check_hdf5, trial
from hyperval.imagery import open_cube, open_raster
from hyperval.run import write_table
from hyperval.spectra import read_records
from hyperval.statistics_library import read_statistics_library

HEAP_HEADER, OBJECT_SIZE = 16, 8  # bytes before the first object of a global heap, and before its size
LOOPING, REFUSED = 2**64 - 16, 2**64 - 1  # the next text begins where this one begins; one beyond the file


def damaged(path: Path, *sizes: int) -> Path:
    """A file with two texts of variable length, each in a heap of its own; the first heaps say other sizes of them."""
    with h5py.File(path, "w") as file:
        file.attrs["title"] = "a" * 40
        file.create_dataset("b", data=1.0).attrs["history"] = "b" * 5000
    check_hdf5(path)
    raw = bytearray(path.read_bytes())
    heaps = [i for i in range(len(raw)) if raw.startswith(b"GCOL", i)]
    for heap, size in zip(heaps, sizes, strict=False):
        struct.pack_into("<Q", raw, heap + HEAP_HEADER + OBJECT_SIZE, size)
    path.write_bytes(raw + b"\0" * len(sizes))
    return path


@pytest.mark.parametrize("before", [(), (REFUSED,)])  # a part that the library refuses hides no other
def test_a_file_that_the_library_follows_for_ever_is_refused(before, tmp_path, monkeypatch):
    monkeypatch.setattr(hdf5, "CPU_SECONDS", 1)
    check_hdf5(damaged(tmp_path / "a.h5", *before))
    looping = damaged(tmp_path / "a.h5", *before, LOOPING)
    with pytest.raises(InputError, match="does not return within 1 s") as caught:
        open_cube(looping, quantity="other")
    assert str(looping) in str(caught.value)
    # Once is enough for a file as it stands.
    monkeypatch.setattr(hdf5, "trial", lambda function: pytest.fail("tried again"))
    with pytest.raises(InputError, match="does not return"):
        check_hdf5(looping)


@pytest.mark.parametrize(
    "read",
    [
        lambda path: open_cube(path, quantity="other"),
        lambda path: open_cube(path, quantity="other", variable="a"),
        lambda path: open_cube(path, quantity="other", engine="h5netcdf"),
        open_raster,
        read_table,
        lambda path: read_statistics_library(path, "grass"),
        read_records,  # of HYPERNETS
        lambda path: api.open(path.parent).to_xarray(),
    ],
)
def test_every_reader_of_hdf5_asks_first(read, tmp_path, monkeypatch):
    path = tmp_path / "products.nc"
    with h5py.File(path, "w") as file:
        file["a"] = 1.0
        file.attrs["processor_name"] = "hypernets_processor"
    write_table([], tmp_path)
    monkeypatch.setattr(hdf5, "_trial", lambda *file: f"fails on {Path(file[0]).name}")
    with pytest.raises(InputError, match=r"the HDF5 library fails on products\.nc"):
        read(path)


def test_a_crash_and_all_memory_are_refused_and_other_errors_left_to_the_reader(tmp_path):
    assert trial(lambda: os.kill(os.getpid(), signal.SIGSEGV)) == "crashes (signal 11)"
    assert trial(lambda: bytearray(hdf5.MEMORY_BYTES * 2) and None) == "asks for more than 1024 MiB"
    assert trial(lambda: open("/nowhere").close()) == ""
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(InputError, match="damaged"):
        read_table(tmp_path / "a.h5")

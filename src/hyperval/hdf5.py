"""NetCDF-4 files by their variables, and a trial that tells whether a library comes back from a damaged file.

The trial is a process with limits of time and memory, as no check made beforehand finds these files: 9 of 10,200
damaged HDF5 files hang HDF5 2.0, and of 2,000 MATLAB structs 2 crash SciPy and 7 take all memory
(``validation/robustness``).  A list of variable-length text that leads back into itself is followed for ever inside
one call, which no signal, thread or exception ends.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from hyperval.errors import refuse

CPU_SECONDS = 3  # of one file; products of hundreds of arrays take hundredths of a second
ENOUGH_SECONDS = 1.0  # after which the rest of a tree of many thousands is taken on trust
MEMORY_BYTES = 1 << 30  # beyond what this process has
SMALL_BYTES = 1 << 20  # arrays up to this size are read whole; of larger ones the list of their blocks


def check_hdf5(path: Path | str) -> None:
    """Raise InputError where the HDF5 library does not come back from a file, crashes or takes all memory.

    Nothing is said of files that the library itself refuses, or on systems that cannot fork.
    """
    if os.path.exists(path):  # else the reader has words for it
        status = os.stat(path)
        reason = _trial(str(path), status.st_mtime_ns, status.st_size)
        refuse(reason, "hdf5.damaged", path, reason=reason)


@lru_cache(maxsize=256)
def _trial(path: str, changed_ns: int, size: int) -> str:
    """What the library does that it must not, empty where it comes back; once for a file as it stands."""
    import h5py  # before the fork: the limits are for the file

    if not hasattr(os, "fork") or not h5py.is_hdf5(path):
        return ""  # by its first bytes, which the library looks at before anything else
    return trial(lambda: _walk(h5py, path))


def trial(function: Callable[[], None]) -> str:
    """What a function does that it must not, called in a process of its own; any other error is as good as none."""
    # A process with threads: the child calls this function alone, and ends without cleaning up.
    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
        child = os.fork()
    if child == 0:
        code = 0
        try:
            _limit_this_process()
            function()
        except MemoryError:
            code = 1
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return f"does not return within {CPU_SECONDS} s"
    return f"asks for more than {MEMORY_BYTES >> 20} MiB" if code > 0 else f"crashes (signal {-code})" if code else ""


def _limit_this_process() -> None:
    import resource

    gc.disable()  # what the parent holds is not for the child to close
    faulthandler.disable()  # a crash is an answer here
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    limits = {resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: CPU_SECONDS}
    with suppress(FileNotFoundError):  # on systems without it
        present = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        limits[resource.RLIMIT_AS] = present + MEMORY_BYTES
    for kind, limit in limits.items():
        with suppress(ValueError):  # where the system's own limit is lower still
            resource.setrlimit(kind, (limit, limit))


def _walk(h5py: Any, path: str) -> None:
    """Meet every object of a file, its attributes, and its arrays so far as they are small."""

    def look(_: str, item: Any) -> bool | None:
        parts: list[Callable[[], object]] = [partial(item.attrs.__getitem__, name) for name in item.attrs]
        if isinstance(item, h5py.Dataset):
            small = item.size is not None and item.size * item.dtype.itemsize <= SMALL_BYTES
            parts.append(lambda: item[()] if small else item.chunks and item.id.get_num_chunks())
        for read in parts:
            try:
                read()
            except MemoryError:
                raise
            except Exception:  # noqa: S112 - the reader meets it too, and has words for it: it does not hide the next
                continue
        return True if time.process_time() > ENOUGH_SECONDS else None  # whatever is returned ends the walk

    with h5py.File(path, "r") as file:
        if not look("/", file):
            file.visititems(look)


@contextmanager
def opened_netcdf(
    path: Path, what: str, axes_of: Mapping[str, str], most: Mapping[str, int], may_lack: Sequence[str] = ()
) -> Iterator[Any]:
    """A NetCDF-4 file that holds variables of some axes, for a reader that refuses what a library stumbles over.

    Parameters
    ----------
    what : the file is to be
    axes_of : variable -> its axes in words; each has one length, also under another name that ends in _2
    most : greatest length of an axis
    may_lack : variables that need not be there
    """
    import h5py
    import xarray as xr  # 80 MB with pandas, which most runs do not need

    check_hdf5(path)
    refuse(not h5py.is_hdf5(path), "netcdf.unreadable", path, what=what)
    with warnings.catch_warnings(action="ignore"):  # of a dimension that stands twice
        data = xr.open_dataset(path, engine="h5netcdf", decode_times=False)
    with data:
        lacking = ", ".join(name for name in axes_of if name not in data.variables and name not in may_lack)
        refuse(lacking, "netcdf.lacking", path, what=what, names=lacking)
        sizes: dict[str, int] = {}
        for name in (name for name in axes_of if name in data.variables):
            shape, axes = data[name].shape, axes_of[name].replace("_2", "").split()
            fits = len(shape) == len(axes) and all(
                sizes.setdefault(axis, size) == size and 0 < size <= most[axis]
                for axis, size in zip(axes, shape, strict=True)
            )
            refuse(not fits, "netcdf.shape", path, what=what, name=name, shape=shape, axes=axes, most=most)
        yield data

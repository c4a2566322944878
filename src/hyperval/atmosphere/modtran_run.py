"""The user's own MODTRAN: started in a folder of its own for the runs that give the terms of a state.

``HYPERVAL_MODTRAN`` names the executable, ``HYPERVAL_MODTRAN_VERSION`` says 4, 5 or 6 (default 6), and
``HYPERVAL_MODTRAN_DATA`` the DATA folder of versions 4 and 5 (default: beside the executable).
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.apart import ending_with_this_process, is_no_program
from hyperval.atmosphere.cache import Arrays, cached
from hyperval.atmosphere.modtran_solve import read_modtran_runs
from hyperval.atmosphere.modtran_write import (
    ALBEDO_FILE,
    SOLVING_ALBEDOS,
    Run,
    albedo_curves,
    modtran6_json,
    tape5,
    uniform_runs,
)
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import EngineError
from hyperval.files import scratch_folder, sha256_of
from hyperval.progress import track

EXECUTABLE, VERSION, DATA = "HYPERVAL_MODTRAN", "HYPERVAL_MODTRAN_VERSION", "HYPERVAL_MODTRAN_DATA"
TIMEOUT_S = 3600.0
_NAME = "hyperval"
_MESSAGE_BYTES = 4000
_HOW = f"set {EXECUTABLE} to your MODTRAN executable (and {VERSION} to 4, 5 or 6), or choose engine: sixs or table"
_SCHEME = 1  # raise when the numbers in the cache change their meaning


@dataclass(frozen=True)
class Modtran:
    """An installed MODTRAN: its executable, version 4, 5 or 6, and for 4 and 5 its DATA folder."""

    executable: Path
    version: int
    data: Path | None


def configured_modtran() -> Modtran:
    """The MODTRAN that the environment names.

    Raises
    ------
    EngineError : none is named, it cannot be executed, or the version is unknown; the message says how to mend it.
    """
    named = os.environ.get(EXECUTABLE, "").strip()
    if not named:
        raise EngineError("no MODTRAN is configured", expected=f"{EXECUTABLE} in the environment", mend=_HOW)
    program = shutil.which(named)
    if program is None:
        raise EngineError("not an executable file", where=f"{EXECUTABLE}={named}", mend=_HOW)
    version = os.environ.get(VERSION, "6").strip()
    if version not in ("4", "5", "6"):
        raise EngineError(f"{VERSION}={version}", expected="4, 5 or 6", mend=_HOW)
    executable = Path(program).resolve()
    data = os.environ.get(DATA, "").strip()
    folder = Path(data) if data else executable.parent / "DATA"
    if not folder.is_dir():
        if data:
            raise EngineError("not a folder", where=f"{DATA}={data}", expected="the DATA folder of MODTRAN")
        folder = None  # type: ignore[assignment]
    return Modtran(executable, int(version), folder.resolve() if folder else None)


def run_modtran(
    state: AtmosphericState, runs: Sequence[Run], modtran: Modtran, folder: Path, timeout_s: float = TIMEOUT_S
) -> list[Path]:
    """Start MODTRAN on the runs in ``folder`` and return its output files: a ``.tp7``, ``tape7`` or ``.chn``.

    Raises
    ------
    EngineError : it cannot be started, takes longer than ``timeout_s``, fails, or leaves no output.
    UsageError : a state that MODTRAN cannot be told.
    """
    command = [str(modtran.executable)]
    if modtran.version == 6:
        (folder / f"{_NAME}.json").write_text(modtran6_json(state, runs, _NAME), encoding="utf-8")
        command.append(f"{_NAME}.json")
        candidates = [f"{_NAME}.tp7", f"{_NAME}.chn"]
    else:
        (folder / "tape5").write_text(tape5(state, runs, modtran.version), encoding="ascii")
        candidates = ["tape7", "tape5.tp7"]
        if modtran.data is not None:
            (folder / "DATA").symlink_to(modtran.data)
    curves = albedo_curves(runs)
    if curves:
        (folder / ALBEDO_FILE).write_text(curves, encoding="ascii")
    _start(command, folder, timeout_s)
    for name in candidates:
        if (folder / name).is_file():
            return [folder / name]
    raise EngineError(
        f"MODTRAN left none of {', '.join(candidates)}: {_last_words(folder)}",
        where=str(modtran.executable),
        mend=f"check that {VERSION} is right (now {modtran.version}) and that MODTRAN runs by itself",
    )


def modtran_terms(state: AtmosphericState, folder: Path, show_progress: bool | None = None) -> AtmosphericTerms:
    """The terms of a state by the configured MODTRAN: runs over ground of 0, 0.1 and 0.5, solved and cached.

    Raises
    ------
    EngineError : no MODTRAN, or it failed.
    InputError : its output cannot be read.
    """
    modtran = configured_modtran()
    runs = uniform_runs(SOLVING_ALBEDOS)
    deck = modtran6_json(state, runs, _NAME) if modtran.version == 6 else tape5(state, runs, modtran.version)
    inputs = {
        "scheme": _SCHEME,
        "binary": _fingerprint(str(modtran.executable), modtran.executable.stat().st_mtime_ns),
        "version": modtran.version,
        "deck": deck,
    }

    def compute() -> Arrays:
        with scratch_folder("modtran") as scratch:
            for _ in track([0], f"MODTRAN {modtran.version}", total=1, show=show_progress):
                outputs = run_modtran(state, runs, modtran, Path(scratch))
            return _stored(read_modtran_runs(outputs, [run.albedo for run in runs]))

    return _restored(cached(folder, "modtran", inputs, compute), state, modtran)


_NAMES = [f.name for f in fields(AtmosphericTerms) if f.name not in ("provenance", "solar_lines")]


def _stored(terms: AtmosphericTerms) -> Arrays:
    """Arrays for the cache, which takes no NaN: irradiance that cannot be told is stored as -1."""
    values = {name: getattr(terms, name) for name in _NAMES if getattr(terms, name) is not None}
    return {name: np.nan_to_num(array, nan=-1.0) for name, array in values.items()}


def _restored(stored: Arrays, state: AtmosphericState, modtran: Modtran) -> AtmosphericTerms:
    values: dict[str, Any] = dict(stored)
    irradiance = values["ground_irradiance"]
    values["ground_irradiance"] = np.where(irradiance < 0.0, np.nan, irradiance)
    return AtmosphericTerms(
        **values,
        provenance={
            "engine": f"MODTRAN {modtran.version}",
            "executable_sha256": _fingerprint(str(modtran.executable), modtran.executable.stat().st_mtime_ns),
            "albedos": list(SOLVING_ALBEDOS),
            "solar_spectrum": "of the MODTRAN run",
            "emission": "of the black run, part of the path radiance",
            "state": state.model_dump(mode="json"),
        },
    )


@lru_cache(maxsize=4)
def _fingerprint(executable: str, changed_ns: int) -> str:
    return sha256_of(Path(executable))


def _start(command: list[str], folder: Path, timeout_s: float) -> None:
    """Run the command in ``folder``; what it says goes to a file, and its children end with it."""
    with open(folder / "messages.txt", "wb") as messages:
        try:
            process = subprocess.Popen(  # noqa: S603
                ending_with_this_process(command), cwd=folder, stdin=subprocess.DEVNULL, stdout=messages,
                stderr=messages, start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise EngineError(
                f"MODTRAN cannot be started: {error.strerror}", where=command[0], mend=_HOW
            ) from error
        try:
            code = process.wait(timeout=timeout_s)
        except subprocess.TimeoutExpired as error:
            raise EngineError(f"MODTRAN ran longer than {timeout_s:g} s", where=command[0]) from error
        finally:
            if process.poll() is None:
                with contextlib.suppress(OSError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    if is_no_program(code):
        raise EngineError(f"MODTRAN cannot be started: {_last_words(folder)}", where=command[0], mend=_HOW)
    if code != 0:
        raise EngineError(
            f"MODTRAN ended with code {code}: {_last_words(folder)}",
            where=command[0],
            mend="run it by itself to see that licence and data are in place",
        )


def _last_words(folder: Path) -> str:
    with open(folder / "messages.txt", "rb") as messages:
        messages.seek(0, os.SEEK_END)
        messages.seek(max(messages.tell() - _MESSAGE_BYTES, 0))
        text = messages.read().decode("utf-8", "replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "no message"

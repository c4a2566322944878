"""What every engine needs: a program that ends with the process that starts it, and a cache of what it computed.

The cache is of arrays on disk: safe for parallel processes, deaf to corrupted entries.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import platformdirs

from hyperval.errors import EngineError
from hyperval.storage import ending_with_this_process, is_no_program, last_line, whole_file

Array = npt.NDArray[np.float64]
Arrays = dict[str, Array]


def run_program(
    command: Sequence[str],
    name: str,
    mend: str,
    *,
    timeout_s: float,
    text: str = "",
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """What a program says that is given ``text`` to read; it and its children end with this process and its patience.

    Parameters
    ----------
    command : the program and its arguments
    name, mend : what messages call it, and what they advise where it cannot be started
    timeout_s : how long it may take [s]
    folder : its working directory
    environment : its variables; None: those of this process

    Raises
    ------
    EngineError : it cannot be started, or takes longer.
    """
    try:
        process = subprocess.Popen(  # noqa: S603
            ending_with_this_process(command), cwd=folder, env=environment, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace", start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise EngineError(f"{name} cannot be started: {error.strerror}", where=command[0], mend=mend) from error
    with process:
        try:
            said, complaint = process.communicate(text, timeout_s)
        except subprocess.TimeoutExpired as error:
            raise EngineError(f"{name} ran longer than {timeout_s:g} s", where=command[0]) from error
        finally:
            if process.poll() is None:
                with contextlib.suppress(OSError):
                    os.killpg(process.pid, signal.SIGKILL)
    if is_no_program(process.returncode):
        raise EngineError(f"{name} cannot be started: {last_line(complaint)}", where=command[0], mend=mend)
    return subprocess.CompletedProcess(command, process.returncode, said, complaint)


def cache_folder(given: Path | None = None) -> Path:
    """The folder given, or HYPERVAL_CACHE, or the user's cache folder."""
    if given is not None:
        return Path(given)
    from_environment = os.environ.get("HYPERVAL_CACHE")
    return Path(from_environment or platformdirs.user_cache_dir("hyperval"))


def cached(folder: Path, kind: str, inputs: Mapping[str, Any], compute: Callable[[], Arrays]) -> Arrays:
    """The arrays stored for ``inputs``, computed and stored first where there are none.

    An entry that cannot be read, belongs to other inputs or holds other content than was written counts as none.
    A cache that cannot be written (a read-only home) is no error: the result is computed every time.
    """
    about = json.dumps(inputs, sort_keys=True, allow_nan=False)
    path = folder / kind / f"{hashlib.sha256(about.encode()).hexdigest()[:40]}.npz"
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as entry:
            stored = {n: np.asarray(entry[n], dtype=float) for n in entry.files if n not in ("inputs", "content")}
            if str(entry["inputs"]) == about and str(entry["content"]) == content_digest(stored):
                return stored
    except Exception:  # noqa: S110 - whatever a damaged archive raises: what it holds is computed again
        pass
    arrays = compute()
    with contextlib.suppress(OSError), whole_file(path) as temporary, open(temporary, "wb") as written:
        np.savez(written, inputs=np.array(about), content=np.array(content_digest(arrays)), **arrays)  # type: ignore[arg-type]
    return arrays


def content_digest(arrays: Mapping[str, Array]) -> str:
    """SHA-256 over names, shapes and values of arrays."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name], dtype="<f8")
        digest.update(f"{name}{np.shape(arrays[name])}\n".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()

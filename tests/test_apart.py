"""A function in a process of its own: results, errors and ends come back; nothing stays behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hyperval.apart import call_apart

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system cannot copy a process")

PROGRAM = """
import os, sys
from pathlib import Path
from hyperval.apart import call_apart
from hyperval.errors import InputError

def work():
    {work}

assert "numpy" not in sys.modules
try:
    print("returned", call_apart(work, Path(sys.argv[1])), os.getpid() == me)
except Exception as error:
    print("raised", type(error).__name__, error, getattr(error, "where", None), *getattr(error, "__notes__", ()))
print("left", os.listdir(sys.argv[1]), "numpy" in sys.modules)
""".replace("assert", "me = os.getpid()\nassert", 1)


@pytest.mark.parametrize(
    ("work", "words"),
    [
        ("import numpy; return numpy.arange(3).sum().item() + (os.getpid() != me)", ["returned 4 True"]),
        ("raise InputError('no such band', where='a.hdr')", ["raised InputError", "no such band a.hdr"]),
        ("return 1 // 0", ["raised ZeroDivisionError", "in work"]),
        ("os.kill(os.getpid(), 9)", ["raised ProcessLostError", "was ended (-9)", "more memory"]),
    ],
)
def test_what_is_returned_raised_or_ended(tmp_path: Path, work: str, words: list[str]):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(work=work), str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert all(word in done.stdout for word in [*words, "left [] False"]), done.stdout + done.stderr


def test_an_interrupt_ends_both(tmp_path: Path):
    # What a shell starts in the background ignores interrupts.
    listening = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    text = listening + PROGRAM.format(work="import time; print(os.getpid(), flush=True); time.sleep(60)")
    with subprocess.Popen(
        [sys.executable, "-c", text, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        child = int(process.stdout.readline())
        process.send_signal(signal.SIGINT)
        assert process.wait(20) != 0
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


def test_what_measures_and_what_writes_load_no_more_than_they_need():
    """pandas and xarray take 80 MB, SciPy's statistics 25: a quantile of theirs would bring them all back."""
    large = {"pandas", "xarray", "scipy.stats", "matplotlib", "bokeh", "pvlib"}
    for modules, more in (
        ("hyperval.observe.pipeline, hyperval.campaign.one, hyperval.campaign.pictures", set()),
        ("hyperval.report.outputs, hyperval.report.html, hyperval.report.netcdf", {"matplotlib", "bokeh"}),
    ):
        program = f"import sys, {modules}; print(*sorted({large - more} & set(sys.modules)))"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert done.stdout.split() == []


def test_a_process_that_has_numpy_calls_here(tmp_path: Path):
    assert "numpy" in sys.modules
    assert call_apart(os.getpid, tmp_path) == os.getpid()

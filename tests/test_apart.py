"""A function in a process of its own: results, errors and ends come back; nothing stays behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from processes import awaited, is_at_work

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


def test_an_interrupt_before_the_wait_ends_both(tmp_path: Path):
    """One that came while the copy was being made was raised where nobody ended the copy."""
    early = (
        "import os, signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\nfork = os.fork\n"
        "def interrupted_fork():\n    child = fork()\n    if child:\n        print(child, flush=True)\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n    return child\nos.fork = interrupted_fork\n"
    )
    text = early + PROGRAM.format(work="import time; time.sleep(60)")
    done = subprocess.run([sys.executable, "-c", text, str(tmp_path)], capture_output=True, text=True, timeout=30)
    assert done.returncode != 0
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout.split()[0]), 0)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux ends a process with its parent")
def test_a_killed_process_takes_the_other_along(tmp_path: Path):
    """The copy went on to the end of an observation that nobody waited for."""
    work = "import time; print(os.getpid(), flush=True); time.sleep(60)"
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(work=work), str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        child = int(process.stdout.readline())
        process.kill()
        assert process.stdout.read() == ""  # the end of the pipe: nobody writes into it any more
    assert awaited(lambda: not is_at_work(child))


def test_what_measures_and_what_writes_load_no_more_than_they_need():
    """pandas and xarray take 80 MB, SciPy's statistics 25, its optimisers 13 to 21: one quantile brings them."""
    large = {"pandas", "xarray", "scipy.stats", "scipy.optimize", "matplotlib", "bokeh", "pvlib"}
    for modules in (
        "hyperval.observe.pipeline, hyperval.campaign.one, hyperval.campaign.pictures",
        "hyperval.campaign.forward, hyperval.report.outputs, hyperval.report.html, hyperval.report.netcdf",
    ):
        program = f"import sys, {modules}; print(*sorted({large} & set(sys.modules)))"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert done.stdout.split() == []


def test_a_process_that_has_numpy_calls_here(tmp_path: Path):
    assert "numpy" in sys.modules
    assert call_apart(os.getpid, tmp_path) == os.getpid()


@pytest.mark.slow
def test_observing_a_wide_image_of_many_bands_stays_below_its_memory(tmp_path: Path):
    """Libraries take 131 MiB; two threads 40 of arrays of a few lines (in float64), one row of blocks of bands 8.

    None of it grows with the lines, so that 64 stand for the 7134 of 10 GB (measured there: docs/formats.md).
    When lines of all bands were kept in memory and SciPy's optimisers loaded at once it was 250 MB.
    """
    bands, lines, samples = 284, 64, 1234
    with h5py.File(tmp_path / "AV3_RDN.nc", "w") as file:
        group = file.create_group("radiance")
        image = group.create_dataset("radiance", (bands, lines, samples), "f4", chunks=(24, 64, 309), fillvalue=2.0)
        group["wavelength"], group["fwhm"] = np.linspace(380, 2500, bands), np.full(bands, 7.5)
        image[:, :32] = np.random.default_rng(0).normal(4, 0.5, (bands, 32, samples)).astype(np.float32)
    (tmp_path / "campaign.yaml").write_text(
        "schema: 1\nname: wide\ntitle: t\ndescription: d\n"
        "collection:\n  cube: {path: AV3_RDN.nc, quantity: radiance}\n"
        "  regions: [{name: first, rectangle: [0, 0, 32, 200]}]\n  snr_regions: [first]\n"
    )
    program = (
        "import resource\nfrom pathlib import Path\nimport hyperval.campaign.observing as observing\n"
        "apart = observing.call_apart\n"
        "def measured(function, scratch):\n"
        "    out = apart(function, scratch)\n"
        "    print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
        "    return out\n"
        "observing.call_apart = measured\n"
        "observing.observe(Path('campaign.yaml'), Path('out'), show_progress=False)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert int(done.stdout.split()[-1]) < 195_312  # kB: 200 MB

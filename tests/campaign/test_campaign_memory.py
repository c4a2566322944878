"""What ``hyperval observe`` loads, and how much memory it takes of an image that has many times as much."""

import os
import subprocess
import sys

import h5py
import numpy as np
import pytest


def test_what_measures_and_what_writes_load_no_more_than_they_need():
    """pandas and xarray take 80 MB, SciPy's statistics 25, its optimisers 13 to 21: one quantile brings them."""
    large = {"pandas", "xarray", "scipy.stats", "scipy.optimize", "matplotlib", "bokeh", "pvlib"}
    for names in ("observe, validate, expected_maps", "predict_to_folder"):
        program = f"import sys; from hyperval.campaign import {names}; print(*sorted({large} & set(sys.modules)))"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert done.stdout.split() == []


@pytest.mark.slow
def test_observing_a_wide_image_of_many_bands_stays_below_its_memory(tmp_path):
    """Libraries take 122 MiB, those of the page 26 more; arrays of a few lines and of one part of a window 38.

    None of it grows with the lines, so that 64 stand for the 7134 of 10 GB (measured there: docs/formats.md).
    The image of 7134 lines has 10 GB.
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
        "import re, sys\nfrom hyperval import cli\n"
        "code = cli.run(['-q', 'observe', 'campaign.yaml', '-o', 'out'])\n"
        # Not of getrusage: a process inherits the peak of the one that started it.
        "print(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])\nsys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert int(done.stdout.split()[-1]) < 195_313  # kB: 200 MB, the libraries of the page included

"""Greatest memory of ``hyperval observe`` on a shell of AVIRIS-3's size.

    python benchmarks/observe_memory.py [--lines 7134] [--folder DIR]

The shell has the layout of the product, 284 bands and 1234 samples in blocks of 24 x 64 x 309.  What is not written
takes no room on disk: 7134 lines stand for 10 GB of radiance.  Three regions, one of them the whole image.
What is told is the greatest resident memory of the process, with the pages of files that it shares with others.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

BANDS, SAMPLES, LIMIT_MB = 284, 1234, 200.0
CAMPAIGN = """schema: 1
name: shell
title: Memory of a large cube
description: A sparse file in the layout of AVIRIS-3.
collection:
  cube: {{path: AV3_RDN.nc, quantity: radiance}}
  regions:
    - {{name: first, rectangle: [0, 0, 32, 200]}}
    - {{name: other, rectangle: [{middle}, 100, 32, 400]}}
    - {{name: all, whole_image: true}}
  snr_regions: [first]
"""


def write_shell(folder, lines):
    """The file and a campaign that observes it; its first 32 lines hold noise, the others the fill of the array."""
    with h5py.File(folder / "AV3_RDN.nc", "w") as file:
        group = file.create_group("radiance")
        shape, blocks = (BANDS, lines, SAMPLES), (24, 64, 309)
        image = group.create_dataset("radiance", shape, "f4", chunks=blocks, fillvalue=2.0)
        group["wavelength"], group["fwhm"] = np.linspace(380, 2500, BANDS), np.full(BANDS, 7.5)
        image[:, :32] = np.random.default_rng(0).normal(4, 0.5, (BANDS, 32, SAMPLES)).astype(np.float32)
    (folder / "campaign.yaml").write_text(CAMPAIGN.format(middle=lines // 2))


def peak_of(folder):
    """Greatest resident memory of the command [MB]."""
    command = [sys.executable, "-m", "hyperval", "observe", "campaign.yaml", "-o", "observed"]
    with subprocess.Popen(command, cwd=folder, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}) as run:  # noqa: S603 - ourselves
        _, status, usage = os.wait4(run.pid, 0)
        run.returncode = os.waitstatus_to_exitcode(status)
    if run.returncode:
        raise SystemExit(f"observe ended with {run.returncode}")
    return usage.ru_maxrss * 1024 / 1e6


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lines", type=int, default=7134)
    parser.add_argument("--folder", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.folder) as name:
        write_shell(Path(name), args.lines)
        peak = peak_of(Path(name))
    size = BANDS * args.lines * SAMPLES * 4 / 1e9
    print(f"a cube of {size:.1f} GB; observe takes {peak:.0f} MB")
    met = peak < LIMIT_MB
    print(f"below {LIMIT_MB:.0f} MB: {'yes' if met else 'no'}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())

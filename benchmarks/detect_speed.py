"""Radiance cube on disk to score map, against a floor, SPy and a one-shot script, in one run.

    python benchmarks/detect_speed.py [--lines 2000] [--long-lines 4400] [--folder DIR]

Everybody does the same: mean and covariance of all pixels, empirical line, matched filter, score map.  Ours folds
the line into the filter; the others look for the target's radiance, which is the same filter.  The file is in the
page cache.  They take turns, so that a slower minute of the machine is a slower minute for all; a ratio is the
median of those of the rounds, with their range.  The floor is what no arrangement can avoid: the symmetric rank-k
update of all pixels in float32 on every core, from memory, and one pass that reads, converts and multiplies by one
vector.  Peak memory is that of a fresh process.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

SAMPLES, BANDS = 320, 360
SCALE = 0.001
TARGETS = {"time": 1.5, "memory_mb": 150.0, "spy": 8.0, "one_shot": 1.5}


def wavelengths():
    return np.linspace(400.0, 2450.0, BANDS)


def target_reflectance():
    return 0.25 + 0.2 * np.sin(wavelengths() / 150.0)


def gain_and_offset():
    """A stated empirical line, L = offset + gain rho."""
    nm = wavelengths()
    return 12.0 * np.exp(-(((nm - 550) / 900) ** 2)) + 0.3, 1.5 * (400 / nm) ** 3


def write_cube(path, lines, seed=1):
    """A BIL cube of six smooth materials and noise, int16."""
    rng = np.random.default_rng(seed)
    nm = wavelengths()
    shapes = ((500, 200), (900, 300), (1600, 400), (2200, 200), (700, 40), (1200, 100))
    spectra = np.stack([np.exp(-0.5 * ((nm - c) / w) ** 2) for c, w in shapes]).astype(np.float32)
    gain, offset = (a.astype(np.float32) for a in gain_and_offset())
    with open(path, "wb") as out:
        for first in range(0, lines, 40):
            n = min(40, lines - first)
            amounts = rng.gamma(3.0, 0.05, size=(n * SAMPLES, 6)).astype(np.float32)
            x = (offset + gain * (0.05 + amounts @ spectra)) / SCALE
            x += rng.standard_normal(x.shape, np.float32) * (4 + 0.003 * x)
            x.reshape(n, SAMPLES, BANDS).transpose(0, 2, 1).round().clip(0, 32000).astype("<i2").tofile(out)
    Path(f"{path}.hdr").write_text(
        f"ENVI\nsamples = {SAMPLES}\nlines = {lines}\nbands = {BANDS}\nheader offset = 0\n"
        "file type = ENVI Standard\ndata type = 2\ninterleave = bil\nbyte order = 0\n"
        "wavelength units = Nanometers\nwavelength = {" + ", ".join(f"{w:.3f}" for w in wavelengths()) + "}\n"
    )


def ours(path, detectors=("cem",), targets=1):
    """(lines, samples) score by the package, from the path."""
    from hyperval.executors import single_blas_thread
    from hyperval.imagery import open_cube
    from hyperval.model import PositiveDefinite
    from hyperval.pixels import MeasuredPanel, fit_elm, pixel_detector, region_statistics, score_cube, whitener_of

    cube = open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=SCALE)
    found = region_statistics(cube)["scene"]
    gain, offset = gain_and_offset()
    exact = np.zeros(BANDS)
    levels = [MeasuredPanel(str(rho), exact + rho, exact, offset + gain * rho, exact) for rho in (0.0, 1.0)]
    elm = fit_elm(levels)
    with single_blas_thread():  # as the pipeline does
        mean = elm.reflectance(found.mean)
        inverted = PositiveDefinite(found.covariance / np.outer(gain, gain))
        made = {
            f"{i}-{name}": pixel_detector(name, target_reflectance() * (1 + 0.02 * i), mean, inverted)
            for i in range(targets)
            for name in detectors
        }
        whitener = whitener_of(mean, inverted) if {"ace", "rx"} & set(detectors) else None
    return next(iter(score_cube(cube, made, elm, whitener=whitener).values()))


def target_radiance():
    gain, offset = gain_and_offset()
    return offset + gain * target_reflectance()


def spy(path):
    import spectral

    data = spectral.open_image(f"{path}.hdr").load()
    return spectral.matched_filter(data, target_radiance() / SCALE)


def one_shot(path, lines):
    """What a careful user writes: all in memory, float32, BLAS threads as they are."""
    x = np.fromfile(path, "<i2").reshape(lines, BANDS, SAMPLES)
    x = np.ascontiguousarray(x.transpose(0, 2, 1), np.float32).reshape(-1, BANDS)
    mean = x.mean(axis=0, dtype=np.float64)
    x -= mean.astype(np.float32)
    covariance = (x.T @ x).astype(np.float64) / (len(x) - 1)
    d = target_radiance() / SCALE - mean
    w = np.linalg.solve(covariance, d)
    return (x @ (w / (d @ w)).astype(np.float32)).reshape(lines, SAMPLES)


def floor(path, lines, cores):
    """The rank-k update of every pixel on every core, and one fused scoring pass."""
    from hyperval.executors import single_blas_thread

    step = 8
    blocks = -(-lines // step)

    def gram(k):
        x = np.full((BANDS, step * SAMPLES), 1.5, np.float32)
        total, product = np.zeros((BANDS, BANDS)), np.empty((BANDS, BANDS), np.float32)
        for _ in range(k, blocks, cores):
            np.matmul(x, x.T, out=product)
            np.add(total, product, out=total)

    def score(k):
        raw, x = np.empty((step, BANDS, SAMPLES), "<i2"), np.empty((BANDS, step, SAMPLES), np.float32)
        w = np.ones((1, BANDS), np.float32)
        with open(path, "rb", buffering=0) as stream:
            for block in range(k, lines // step, cores):
                stream.seek(block * raw.nbytes)
                stream.readinto(raw)
                np.copyto(x, raw.transpose(1, 0, 2))
                w @ x.reshape(BANDS, -1)

    with single_blas_thread(), ThreadPoolExecutor(cores) as pool:
        list(pool.map(gram, range(cores)))
        list(pool.map(score, range(cores)))


def in_turn(works, rounds):
    """Seconds (rounds,) of each, and what it returned the last time."""
    took, made = {name: [] for name in works}, {}
    for _ in range(rounds):
        for name, work in works.items():
            start = time.perf_counter()
            made[name] = work()
            took[name].append(time.perf_counter() - start)
    return {name: np.array(t) for name, t in took.items()}, made


def show(took, base):
    """Print seconds and ratios to ``base``, whose medians are returned."""
    ratios = {name: t / took[base] for name, t in took.items()}
    for name, r in ratios.items():
        print(f"{name:20s} {took[name].min():6.2f} s  {np.median(r):6.2f} x {base} ({r.min():.2f} to {r.max():.2f})")
    return {name: float(np.median(r)) for name, r in ratios.items()}


def peak_memory_mb(path, *options):
    """Peak resident memory of a fresh process that makes the score map."""
    done = subprocess.run(  # noqa: S603 - this file itself
        [sys.executable, __file__, "--alone", str(path), *options], check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout)["peak_mb"]


def alone(path):
    ours(path)
    status = Path("/proc/self/status").read_text()
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    print(json.dumps({"peak_mb": int(peak.split()[1]) / 1024}))


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--lines", type=int, default=2000)
    arguments.add_argument("--long-lines", type=int, default=4400, help="10900 for 2.5 GB")
    arguments.add_argument("--rounds", type=int, default=9)
    arguments.add_argument("--folder", help="where the cubes are written; default: a temporary folder")
    arguments.add_argument("--alone", help=argparse.SUPPRESS)
    options = arguments.parse_args()
    if options.alone:
        alone(options.alone)
        return
    from hyperval.executors import available_cores

    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = Path(folder) / "cube.img"
        write_cube(path, options.lines)
        cores = min(2, available_cores())
        close, _ = in_turn(
            {"floor": lambda: floor(path, options.lines, cores), "ours": lambda: ours(path)},
            options.rounds,
        )
        peers, scores = in_turn(
            {
                "ours": lambda: ours(path),
                "ours, 15 detectors": lambda: ours(path, ("cem", "cem-correlation", "smf"), 5),
                "one-shot NumPy": lambda: one_shot(path, options.lines),
                "SPy": lambda: spy(path),
            },
            max(1, options.rounds // 3),
        )
        to_floor = show(close, "floor")
        to_ours = show(peers, "ours")
        exact = scores["ours"]
        for name in ("one-shot NumPy", "SPy"):
            worst = float(np.abs(scores[name] - exact).max() / exact.std())
            print(f"greatest difference from ours, {name}: {worst:.1e} standard deviations of the score")
        short = peak_memory_mb(path)
        path.unlink()
        long = Path(folder) / "long.img"
        write_cube(long, options.long_lines)
        size, peak = long.stat().st_size / 1e9, peak_memory_mb(long)
    print(f"peak memory {short:.0f} MB; with a cube of {size:.2f} GB {peak:.0f} MB")
    found = {
        f"ours at most {TARGETS['time']} x floor": to_floor["ours"] <= TARGETS["time"],
        f"SPy at least {TARGETS['spy']} x ours": to_ours["SPy"] >= TARGETS["spy"],
        f"one-shot at least {TARGETS['one_shot']} x ours": to_ours["one-shot NumPy"] >= TARGETS["one_shot"],
        f"peak memory at most {TARGETS['memory_mb']:.0f} MB": peak <= TARGETS["memory_mb"],
    }
    for name, met in found.items():
        print(("met     " if met else "NOT MET ") + name)


if __name__ == "__main__":
    main()

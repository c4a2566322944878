"""Evaluations of a study in a second, beside a plain loop over ``predict``, on one worker and on two.

    OPENBLAS_NUM_THREADS=1 python benchmarks/study_speed.py

The scenario of predict_speed.py: 360 bands (ProSpecTIR-VS), 5 classes, cached atmosphere.  An evaluation is the
radiance of every class and target, the SNR of every class, and the ROC at 181 false-alarm probabilities.
Every point of a design differs from all others in everything that the design moves.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded
os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from predict_speed import TEXT

from hyperval.atmosphere.between import interpolation_nodes
from hyperval.config import parse_yaml, validate
from hyperval.executors import Parcel, in_order, opened, parcel, workers
from hyperval.model import Origins, World, evaluations, false_alarm_grid, predict, read_world, with_values
from hyperval.scenario import Scenario
from hyperval.settings import with_settings

RANGE, FILL = "atmosphere.meteorological_range_km", "scene.targets.plank.fill.fixed"
ERROR, SIGNAL = "sensor_changes.calibration_error_percent", "sensor_changes.signal_factor"
GRASS, ASPHALT = "scene.classes.grass.fraction", "scene.classes.asphalt.fraction"
BATCH, LOOP = 512, 24
Columns = Mapping[str, np.ndarray]


def designs(count: int) -> dict[str, Columns]:
    """What moves in each design."""
    rng = np.random.default_rng(1)
    grass = rng.uniform(0.1, 0.6, count)
    fill = rng.uniform(0.01, 0.5, count)
    sensor = {ERROR: rng.uniform(0.0, 5.0, count), SIGNAL: rng.uniform(0.5, 2.0, count)}
    return {
        "fill": {FILL: fill},
        "sensor, fill": {**sensor, FILL: fill},
        "atmosphere, sensor, fill": {RANGE: rng.uniform(5.0, 50.0, count), **sensor, FILL: fill},
        "area fractions, fill": {GRASS: grass, ASPHALT: 0.7 - grass, FILL: fill},
    }


def full(piece: tuple[Parcel, Columns]) -> tuple[float, float]:
    """Evaluate some points in full; a number that follows from all of them, and the processor time [s]."""
    start = time.process_time()
    world, columns = opened(piece[0]), piece[1]
    total, names = 0.0, world.stated.classes
    for _, e in evaluations(with_values(world, columns)):
        total += sum(float(e.radiance(s).sum()) for s in (*names, "plank"))
        total += sum(float(e.snr(s).sum()) for s in names)
        total += float(e.scores("plank", "cem").detection(false_alarm_grid()[None, :]).sum())
    return total, time.process_time() - start


def parts(columns: Columns) -> list[Columns]:
    """The design in batches."""
    size = len(next(iter(columns.values())))
    return [{p: c[k : k + BATCH] for p, c in columns.items()} for k in range(0, size, BATCH)]


def rate(world: World, columns: Columns, processes: int) -> tuple[float, float]:
    """Evaluations in a second of wall time; and by the processor time of all pieces, as if every worker had a
    processor of its own.
    """
    size = len(next(iter(columns.values())))
    with workers(processes) as where, parcel(where, world) as packed:
        pieces = [(packed, part) for part in parts(columns)]
        list(in_order(where, full, pieces[: 2 * processes]))  # processes start, memory is touched
        start = time.perf_counter()
        busy = sum(used for _, used in in_order(where, full, pieces))
        wall = time.perf_counter() - start
    return size / wall, processes * size / busy


def loop_rate(scenario: Scenario, columns: Columns) -> float:
    """Evaluations in a second of processor time by a plain loop over predict, atmospheres known beforehand."""
    points = [{p: float(c[i]) for p, c in columns.items() if p != RANGE} for i in range(LOOP)]
    predict(with_settings(scenario, points[0]))
    start = time.process_time()
    for point in points:
        predict(with_settings(scenario, point))
    return LOOP / (time.process_time() - start)


def main() -> None:
    """Print rates, the ratio to a plain loop, and the scaling from one worker to two."""
    data, lines = parse_yaml(TEXT)
    scenario = validate(Scenario, data, lines, "benchmark")
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 8192
    still = read_world(scenario, Origins())
    nodes = {RANGE.split(".")[1]: tuple(interpolation_nodes("meteorological_range_km", 5.0, 50.0, 7).tolist())}
    hazy = read_world(scenario, Origins(), nodes=nodes)
    hazy.stated.atmosphere.prepare([])
    print("evaluations a second; 360 bands, 5 classes, radiance, SNR, ROC of 181 points; one BLAS thread a worker")
    head = ("predict", "1, cpu", "ratio", "2, cpu", "scaling", "1, wall", "2, wall")
    print(f"{'design':26s}" + "".join(f"{h:>9s}" for h in head))
    for name, columns in designs(count).items():
        world = hazy if RANGE in columns else still
        plain = loop_rate(scenario, columns)
        wall, cpu = rate(world, columns, 1)
        both, both_cpu = rate(world, columns, 2)
        numbers = f"{plain:9.1f}{cpu:9.0f}{cpu / plain:9.1f}{both_cpu:9.0f}{both_cpu / cpu:9.2f}{wall:9.0f}{both:9.0f}"
        print(f"{name:26s}{numbers}", flush=True)


if __name__ == "__main__":
    main()

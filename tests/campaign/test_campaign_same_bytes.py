"""The same campaigns give the same bytes, whoever computes them: processes, threads, blocks of lines."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hyperval
from small_campaign import SmallCampaign, files_of

# Read again by every process that the run starts.
SCRIPT = """
import os, sys
from small_campaign import stand_in_atmosphere
import hyperval.atmosphere, hyperval.imagery.cube, hyperval.model.stated, hyperval.pixels.statistics
from hyperval import cli

hyperval.atmosphere.atmospheric_terms = hyperval.model.stated.atmospheric_terms = stand_in_atmosphere
if "CORES" in os.environ:
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(os.environ["CORES"])])
if "LINES" in os.environ:
    hyperval.pixels.statistics.BLOCK_PIXELS = 72 * int(os.environ["LINES"])
    hyperval.imagery.cube.BLOCK_BYTES = 72 * 16 * 8 * int(os.environ["LINES"])
if __name__ == "__main__":
    sys.exit(cli.run(sys.argv[1:]))
"""
AS_IT_IS = {"HYPERVAL_WORKERS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def run(tmp_path: Path, name: str, paths: list[Path], **environment: str) -> dict[str, bytes]:
    (tmp_path / "script.py").write_text(SCRIPT)
    tests = Path(__file__).parents[1]
    places = [str(Path(hyperval.__file__).parents[1]), str(tests), str(tests / "shared")]
    inherited = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    command = [sys.executable, str(tmp_path / "script.py"), "-q", "validate", *map(str, paths), "-o", name]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, check=False,
        env={**inherited, "PYTHONPATH": os.pathsep.join(places), **AS_IT_IS, **environment},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()
    return files_of(tmp_path / name)


@pytest.mark.slow
def test_results_pages_figures_and_products_do_not_depend_on_who_computes_them(small_collection, tmp_path):
    paths = []
    for name in ("one", "two"):
        shutil.copytree(small_collection, tmp_path / name)
        campaign = SmallCampaign(tmp_path / name)
        campaign.data["name"] = name
        campaign.data["detection"]["targets"][0]["name"] = "yellow"
        paths.append(campaign.write())
    first = run(tmp_path, "first", paths, CORES="1")
    assert {"results.csv", "report.html", "one/products.nc", "two/report.html", "one/results.csv"} <= set(first)
    assert sum(name.endswith(".png") for name in first) >= 4
    threads = {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    other = run(tmp_path, "other", paths, HYPERVAL_WORKERS="2", LINES="5", **threads)
    assert sorted(other) == sorted(first)
    assert [path for path in first if other[path] != first[path]] == []

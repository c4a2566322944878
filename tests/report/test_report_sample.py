"""The committed sample of a run is of this version: its columns, its rows, its outcomes and its numbers."""

import csv
import math
from pathlib import Path

import yaml

from hyperval.results import COLUMNS

ROOT = Path(__file__).parents[2]
NAME = "pasadena-2017"


def test_the_sample_has_the_accepted_numbers():
    """Every accepted comparison of the campaign stands in the sample with its outcome and its value."""
    with (ROOT / "reports" / "sample" / NAME / "summary.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    found = {" | ".join(r[k] for k in ("product", "subject", "method", "metric")): r for r in rows}
    accepted = yaml.safe_load((ROOT / "validation" / "baselines" / f"{NAME}.yaml").read_text())["metrics"]
    planned = {key: item for key, item in accepted.items() if item.get("outcome") not in (None, "none")}
    assert len(planned) > 20
    assert {key: found[key]["outcome"] for key in planned} == {key: item["outcome"] for key, item in planned.items()}
    for key, item in planned.items():
        value = float(found[key]["value"])
        room = item["tolerance"] * (abs(item["accepted"]) if item["of"] == "value" else item.get("half_width", 1.0))
        assert math.isclose(value, item["accepted"], rel_tol=1e-5, abs_tol=room), key


def test_the_sample_gates_as_the_table_does():
    text = (ROOT / "reports" / "sample" / NAME / "junit.xml").read_text()
    with (ROOT / "reports" / "sample" / NAME / "summary.csv").open(newline="") as stream:
        gates = [r for r in csv.DictReader(stream) if r["role"] == "gate"]
    assert text.count("<testcase") == len(gates)
    assert text.count("<failure") == sum(r["outcome"] == "disagrees" for r in gates)

"""What the HySU campaign assumes of its field spectra and places, against the data it is taken from."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from hyperval.scenario import load_scenario

SCENARIO = Path(__file__).parents[2] / "campaigns" / "hysu-2018" / "scenario.yaml"
READINGS, INDEX = "hysu/field_measurements_svc_raw.csv", "hysu/field_measurements_svc_index.csv"
MATERIALS = ("bitumen", "red metal", "blue fabric", "red fabric", "green fabric")

pytestmark = pytest.mark.data


def readings(data_dir):
    """Material -> (n, 97) reflectance of its single readings at 420 to 900 nm."""
    with data_dir(INDEX).open() as file:
        groups = {row["meas_id"]: row["classification"].split(",") for row in csv.DictReader(file)}
    with data_dir(READINGS).open() as file:
        rows = list(csv.reader(file))
    head, values = rows[0], np.array([[float(x or "nan") for x in row] for row in rows[1:]])
    wavelength = values[:, next(i for i, name in enumerate(head) if "wavelength" in name)]
    grid = np.arange(420.0, 901.0, 5.0)
    found = {}
    for material in MATERIALS:
        spectra = []
        for column, name in enumerate(head):
            number = re.search(r"(\d+)$", name)
            if number is None or "wavelength" in name or material not in groups.get(str(int(number[1])), ()):
                continue
            held = np.isfinite(values[:, column]) & (wavelength > 400) & (wavelength < 950)
            order = np.argsort(wavelength[held])
            spectra.append(np.interp(grid, wavelength[held][order], values[held, column][order]))
        found[material] = np.array(spectra)
    return found


def test_errors_of_the_field_spectra_are_the_scatter_of_their_readings(data_dir):
    level, shape, freedom = 0.0, 0.0, 0
    for spectra in readings(data_dir).values():
        mean = spectra.mean(axis=0)
        scale = spectra @ mean / (mean @ mean)
        rest = spectra / (scale[:, None] * mean) - 1.0
        freedom += len(spectra) - 1
        level += np.sum((scale - scale.mean()) ** 2)
        shape += np.mean(rest**2, axis=1).sum()
    assert freedom == 14  # 19 readings of five materials
    stated = [e for e in load_scenario(SCENARIO).uncertainty.field_spectra if e.subject == "blue_fabric"]
    assert stated[0].relative == pytest.approx(np.sqrt(level / freedom), abs=0.002)
    assert stated[2].relative == pytest.approx(np.sqrt(shape / freedom), abs=0.003)

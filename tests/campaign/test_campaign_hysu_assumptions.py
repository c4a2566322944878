"""What the HySU campaign assumes of its field spectra and places, against the data it is taken from."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hyperval.scenario import load_scenario

SCENARIO = Path(__file__).parents[2] / "campaigns" / "hysu-2018" / "scenario.yaml"
READINGS, INDEX = "hysu/field_measurements_svc_raw.csv", "hysu/field_measurements_svc_index.csv"
MATERIALS = ("bitumen", "red metal", "blue fabric", "red fabric", "green fabric")

pytestmark = pytest.mark.data


def readings(data_dir):
    """Material -> (n, 97) reflectance of its single readings at 420 to 900 nm."""
    index = pd.read_csv(data_dir(INDEX)).set_index("meas_id")["classification"].fillna("").str.split(",")
    table = pd.read_csv(data_dir(READINGS))
    table = table.set_index(next(name for name in table if "wavelength" in name)).sort_index().loc[400.5:949.5]
    found = {material: [] for material in MATERIALS}
    for name, values in table.filter(regex=r"\d$").items():
        known = values.dropna()
        for material in set(index.get(int(re.search(r"\d+$", name)[0]), ())) & set(MATERIALS):
            found[material].append(np.interp(np.arange(420.0, 901.0, 5.0), known.index, known))
    return {material: np.array(spectra) for material, spectra in found.items()}


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

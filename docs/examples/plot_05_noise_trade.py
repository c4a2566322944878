"""
What does a calibration error cost?
===================================

A study moves inputs of a scenario and evaluates the model at every point of the grid.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from hyperval.api import study

STUDY = """
schema: 1
name: calibration
title: Detection against calibration error
scenario: yellow-planks-asphalt
inputs:
  - {name: error, label: relative calibration error, unit: "%", path: sensor_changes.calibration_error_percent,
     values: [0, 1, 2, 3, 5, 8]}
  - {name: fill, label: fill of the plank, path: scene.targets.yellow plank.subjects.2.fill.fixed,
     values: [0.05, 0.07, 0.1]}
outputs:
  - {name: pd, label: P_D at P_FA 1e-3, kind: pd, subject: yellow plank 0.1, pfa: 1e-3}
"""

with TemporaryDirectory() as folder:
    path = Path(folder) / "study.yaml"
    path.write_text(STUDY)
    table = study(path, show_progress=False).to_dataframe()

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
table.pivot_table(index="error", columns="fill", values="pd").plot(ax=axes, marker="o")
axes.set(xlabel="relative calibration error [%]", ylabel="P_D at P_FA 1e-3")

# %%
# The table behind it.
table.head()

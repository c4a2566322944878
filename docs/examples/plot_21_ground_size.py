"""
From how high is my target still found?
=======================================

A spectrum and a sensor of one's own: P_D of a plate over the ground size of a pixel, which grows with the height.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from hyperval.api import load_scenario, predict

plate = {"name": "plate", "fill": {"geometry": {"side_m": 0.4, "gsd_m": 1.0}}}
scenario = load_scenario("yellow-planks-asphalt").with_values({
    "sensor": str(Path("my-sensor.yaml").resolve()),
    "scene.targets.yellow plank.spectrum": {"file": str(Path("my-paint.csv").resolve())},
    "scene.targets.yellow plank.subjects": [plate],
    "uncertainty.field_spectra": [{"subject": "yellow plank", "relative": 0.1}],
})  # fmt: skip
sizes = [0.6, 0.9, 1.2, 1.6, 2.0]  # ground size of a pixel [m] of 1 mrad
fill = "scene.targets.yellow plank.subjects.plate.fill.geometry.gsd_m"
heights = [scenario.with_values({fill: gsd, "atmosphere.sensor_altitude_km": 0.17 + gsd}) for gsd in sizes]
found = [predict(scenario).pd("plate", pfa=1e-3) for scenario in heights]

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.plot(sizes, [p.value for p in found], "o-")
axes.fill_between(sizes, [p.lower for p in found], [p.upper for p in found], alpha=0.2)
axes.set(xlabel="ground size of a pixel [m]", ylabel="P_D at P_FA 1e-3", ylim=(0, 1))

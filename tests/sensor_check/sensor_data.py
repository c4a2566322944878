"""A sensor that passes every check, in the form of its file; tests change what they are about."""

import copy
from pathlib import Path
from typing import Any

import yaml

from hyperval.sensor import Sensor, SensorSpecification

SHEET = "data sheet"
Q = {"source": SHEET}


def good_sensor() -> dict[str, Any]:
    """One arm of 60 bands."""
    data = yaml.safe_load(Path(__file__).with_name("good.yaml").read_text("utf-8"))
    return {**data, "bands": {"table": [[430.0 + 8 * i, 9.0, 1] for i in range(60)], **Q}}


def measured_sensor(c: float = 0.0) -> dict[str, Any]:
    """The same bands with measured noise, full scale stated."""
    data = good_sensor()
    del data["arms"], data["published_snr"]
    rows = [[nm, 0.01, 0.16, c] for nm in (425.0, 910.0)]
    data["measured_noise"] = {"table": rows, "saturation_radiance": {"value": 40, **Q}, **Q}
    return data


def changed(data: dict[str, Any], **entries: Any) -> dict[str, Any]:
    """A copy with some entries replaced; ``arm_NAME`` changes the first arm."""
    out = copy.deepcopy(data)
    for key, value in entries.items():
        if key.startswith("arm_"):
            out["arms"][0][key.removeprefix("arm_")] = value
        else:
            out[key] = value
    return out


def sensor_of(data: dict[str, Any]) -> Sensor:
    """The sensor of such a file."""
    return Sensor(SensorSpecification.model_validate(data))

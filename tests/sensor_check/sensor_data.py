"""A sensor that passes every check, in the form of its file; tests change what they are about."""

from __future__ import annotations

import copy
from typing import Any

from hyperval.sensor import Sensor, SensorSpecification

SHEET = "data sheet"


def good_sensor() -> dict[str, Any]:
    """One arm of 60 bands; every number is from a data sheet, so that nothing is varied."""
    q = {"source": SHEET}
    table = [[425, 0.35], [550, 0.5], [700, 0.5], [910, 0.25]]
    return {
        "schema": 1,
        "name": "good",
        "title": "A sensor for tests",
        "source": SHEET,
        "bands": {"table": [[430.0 + 8 * i, 9.0, 1] for i in range(60)], "source": SHEET},
        "arms": [
            {
                "name": "VNIR",
                "range_nm": [425, 910],
                "throughput": {"convention": "value", "cm2_sr": 3.9e-7, "source": SHEET},
                "optical_transmittance": {"value": 0.5, **q},
                "quantum_efficiency": {"table": table, **q},
                "degradation": {"value": 1.0, **q},
                "integration_time_s": {"value": 0.004, **q},
                "fixed_noise_electrons": {"value": 40, **q},
                "bits": 12,
                "bits_source": SHEET,
                "full_well_electrons": {"value": 350000, **q},
                "bit_error_rate": {"value": 0.0, **q},
            }
        ],
        "calibration_error_percent": {"value": 0.5, **q},
        "published_snr": [{"table": [[550, 300]], "radiance": {"value": 10, **q}, **q}],
    }


def measured_sensor() -> dict[str, Any]:
    """The same bands with measured noise, full scale stated."""
    data = good_sensor()
    del data["arms"], data["published_snr"]
    rows = [[425.0, 0.01, 0.16, 0.0], [910.0, 0.01, 0.16, 0.0]]
    data["measured_noise"] = {"table": rows, "saturation_radiance": {"value": 40, "source": SHEET}, "source": SHEET}
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

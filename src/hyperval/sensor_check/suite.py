"""The acceptance suite: every check of a sensor file, in the order in which they build on each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hyperval.products import Prediction
from hyperval.results import ResultTable
from hyperval.sensor.specification import Sensor, load_sensor
from hyperval.sensor_check.bands import check_bands, check_throughput
from hyperval.sensor_check.ledger import Ledger
from hyperval.sensor_check.noise import Engine, SnrPoint, check_noise, check_published
from hyperval.sensor_check.scenarios import run_scenarios
from hyperval.sensor_check.sensitivity import Probe, Swing, sensitivities


@dataclass(frozen=True)
class SensorCheck:
    """What the suite found of one sensor.

    Attributes
    ----------
    sensor, table : the sensor, and one row for every check
    points : published ratios with the computed ones
    predictions : scenario -> products with this sensor
    swings, probe, vary : effect of the assumed numbers, the detection watched, and the part they are varied by
    usable : False where bands or throughput are so wrong that nothing else was computed
    """

    sensor: Sensor
    table: ResultTable
    points: list[SnrPoint] = field(default_factory=list)
    predictions: Mapping[str, Prediction] = field(default_factory=dict)
    swings: list[Swing] = field(default_factory=list)
    probe: Probe | None = None
    vary: float = 0.2
    usable: bool = True

    @property
    def exit_code(self) -> int:
        """Exit code of the contract."""
        return self.table.exit_code()


def check_sensor(
    sensor: Sensor | str | Path,
    *,
    vary: float = 0.2,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> SensorCheck:
    """Run the acceptance suite on a sensor of the library, a sensor file, or a sensor.

    Parameters
    ----------
    sensor : name, path, or the sensor itself
    vary : part by which each assumed number is lowered and raised [1]
    engine : stands in for the atmosphere engine

    Raises
    ------
    UsageError : no such sensor, or a file that is not valid or still has values to be filled in.
    InputError : no such file.
    """
    spec = sensor if isinstance(sensor, Sensor) else load_sensor(sensor)
    ledger = Ledger(spec.name, spec.specification.known_discrepancies)
    axis = check_bands(spec, ledger)
    usable = axis is not None and check_throughput(spec, axis, ledger)
    if axis is None or not usable:
        if axis is None:
            ledger.skipped("throughput", "sensor_check", "the bands are in no order")
        for product in ("noise", "saturation", "monotone", "published_snr", "scenario", "sensitivity"):
            ledger.skipped(product, "sensor_check", "bands or throughput fail: nothing can be computed from them")
        return SensorCheck(spec, ledger.table, vary=vary, usable=False)
    check_noise(spec, axis, ledger)
    points = check_published(spec, axis, ledger, engine)
    predictions = run_scenarios(spec, ledger, engine)
    swings, probe = sensitivities(spec, predictions, ledger, vary=vary, engine=engine, show_progress=show_progress)
    ledger.close()
    return SensorCheck(spec, ledger.table, points, predictions, swings, probe, vary)

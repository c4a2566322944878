"""What the simulation shares with the model: class statistics, atmosphere, sensor numbers. Nothing derived."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hyperval import datasets
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.data import ClassStatistics
from hyperval.errors import UsageError
from hyperval.sensor import NoiseModel, load_sensor
from hyperval.simulate.schema import SceneFile
from hyperval.spectra.axis import SpectralAxis
from hyperval.statistics_library import builtin_class

Engine = Callable[[AtmosphericState], AtmosphericTerms]


@dataclass(frozen=True)
class SimulationInputs:
    """Everything a scene needs besides its own file; ``terms`` are averaged over the sensor's bands.

    Raises
    ------
    UsageError : terms or classes on other bands, or a sensor whose noise is not drawn here.
    """

    sensor: str
    axis: SpectralAxis
    noise: NoiseModel
    terms: AtmosphericTerms
    classes: Mapping[str, ClassStatistics]

    def __post_init__(self) -> None:
        if not np.allclose(self.terms.wavelength_nm, self.axis.centre_nm, atol=1e-6):
            raise UsageError("the atmospheric terms do not stand on the sensor's bands")
        for name, statistics in self.classes.items():
            if not statistics.axis.matches(self.axis):
                raise UsageError(f"the class {name!r} does not stand on the sensor's bands")
        n = self.noise
        if np.ndim(n.bits) or np.ndim(n.bit_error_rate):
            raise UsageError(f"sensor {self.sensor!r}: arms that differ in bits or bit error rate cannot be simulated")
        if (n.readings, n.digital_readings, n.calibration_readings) != (1.0, 1.0, 1.0):
            raise UsageError(f"sensor {self.sensor!r}: averaged readings (co-adds, bins) cannot be simulated")


def load_inputs(scene: SceneFile, beside: Path, engine: Engine | None = None) -> SimulationInputs:
    """Everything a scene needs; a sensor file is looked for ``beside`` the scene file.

    ``engine`` : stands for that of the scene's atmosphere

    Raises
    ------
    UsageError : an unknown sensor, surface or key of the atmosphere.
    InputError, EngineError : a missing file or engine.
    """
    from hyperval.atmosphere import atmospheric_terms  # loads the engines, which a test with its own terms spares

    path = beside / scene.sensor
    sensor = load_sensor(str(path) if path.is_file() else scene.sensor)
    # Before the engine, which may take a minute: a name that no surface has is told at once.
    classes = {name: builtin_class(name, sensor.axis) for name in scene.materials()}
    engine = engine or partial(atmospheric_terms, resolve=partial(datasets.resolve, base=beside))
    terms = engine(scene.atmosphere).at_bands(sensor.axis)
    return SimulationInputs(sensor.name, sensor.axis, sensor.noise(), terms, classes)

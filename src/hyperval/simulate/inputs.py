"""What the simulation shares with the model: class statistics, atmosphere, sensor numbers. Nothing derived."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval import datasets
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.data import ClassStatistics
from hyperval.errors import UsageError
from hyperval.sensor.specification import load_sensor
from hyperval.simulate.schema import SceneFile
from hyperval.spectra.axis import SpectralAxis
from hyperval.statistics_library import builtin_class

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SensorNumbers:
    """The numbers of a sensor specification that the simulated detector needs.

    Attributes
    ----------
    name : of the sensor
    axis : the bands
    electrons_per_radiance : (B,) G [electrons per uW cm-2 sr-1 nm-1]
    fixed_noise_electrons : (B,) signal-independent noise, standard deviation [electrons]
    noise_factor : g_d, multiplies the detector noise [1]
    relative_calibration : (B,) standard deviation of the relative error of a pixel's calibration [1]
    lsb_radiance : (B,) radiance of one digital number; 0: no quantisation [uW cm-2 sr-1 nm-1]
    bits : length of a digital number
    bit_error_rate : probability that one bit is wrong
    measured : None, or (a, b, c) each (B,): noise |a sqrt(b + L) + c| in place of electrons
    """

    name: str
    axis: SpectralAxis
    electrons_per_radiance: Array
    fixed_noise_electrons: Array
    noise_factor: float
    relative_calibration: Array
    lsb_radiance: Array
    bits: int
    bit_error_rate: float
    measured: tuple[Array, Array, Array] | None = None


@dataclass(frozen=True)
class SimulationInputs:
    """Everything a scene needs besides its own file; ``terms`` are averaged over the sensor's bands."""

    sensor: SensorNumbers
    terms: AtmosphericTerms
    classes: Mapping[str, ClassStatistics]

    def __post_init__(self) -> None:
        axis = self.sensor.axis
        if not np.allclose(self.terms.wavelength_nm, axis.centre_nm, atol=1e-6):
            raise UsageError("the atmospheric terms do not stand on the sensor's bands")
        for name, statistics in self.classes.items():
            if not statistics.axis.matches(axis):
                raise UsageError(f"the class {name!r} does not stand on the sensor's bands")


def sensor_numbers(name: str) -> SensorNumbers:
    """The numbers of a sensor of the library or of a sensor file.

    Raises
    ------
    UsageError, InputError : as :func:`hyperval.sensor.load_sensor`.
    """
    sensor = load_sensor(name)
    noise = sensor.noise()
    if np.ndim(noise.bits) or np.ndim(noise.bit_error_rate):
        raise UsageError(f"sensor {name!r}: arms that differ in bits or bit error rate cannot be simulated")
    if (noise.readings, noise.digital_readings, noise.calibration_readings) != (1.0, 1.0, 1.0):
        raise UsageError(f"sensor {name!r}: averaged readings (co-adds, bins) cannot be simulated")
    # An error rate per word is spread over the bits of the word.
    per_bit = float(noise.bit_error_rate) / (int(noise.bits) if noise.bit_error_per == "word" else 1)
    return SensorNumbers(
        name=sensor.name,
        axis=sensor.axis,
        electrons_per_radiance=noise.electrons_per_radiance,
        fixed_noise_electrons=noise.fixed_noise,
        noise_factor=noise.detector_gain,
        relative_calibration=noise.calibration_percent / 100.0,
        lsb_radiance=noise.lsb_electrons / noise.electrons_per_radiance,
        bits=int(noise.bits),
        bit_error_rate=per_bit,
        measured=noise.measured,
    )


def load_inputs(scene: SceneFile, beside: Path) -> SimulationInputs:
    """Everything a scene needs; a sensor file is looked for ``beside`` the scene file.

    Raises
    ------
    UsageError : an unknown sensor, surface or key of the atmosphere.
    InputError, EngineError : a missing file or engine.
    """
    from hyperval.atmosphere import atmospheric_terms  # loads the engines, which a test with its own terms spares

    path = beside / scene.sensor
    sensor = sensor_numbers(str(path) if path.is_file() else scene.sensor)
    # Before the engine, which may take a minute: a name that no surface has is told at once.
    classes = {name: builtin_class(name, sensor.axis) for name in scene.materials()}
    resolve = partial(datasets.resolve, base=beside)
    terms = atmospheric_terms(scene.atmosphere, resolve=resolve).at_bands(sensor.axis)
    return SimulationInputs(sensor, terms, classes)

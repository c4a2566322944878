"""How much each assumed number moves the SNR and the probability of detection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hyperval.predict import Origins, predict
from hyperval.processing.roc_reading import detection_at
from hyperval.products import Prediction
from hyperval.progress import track
from hyperval.scenario import Scenario
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.ledger import Ledger
from hyperval.sensor_check.noise import MIDDLE, Engine, sunlit_radiance
from hyperval.sensor_check.numbers import Number, numbers, scaled
from hyperval.sensor_check.scenarios import FALSE_ALARM, standard_scenario
from hyperval.spectra.windows import in_window

PRODUCT = "sensitivity"


@dataclass(frozen=True)
class Swing:
    """What a number does when it is lowered and raised.

    Attributes
    ----------
    number : of the file
    snr : relative change of the SNR, lowered and raised: of the band it moves most [1]
    detection : change of P_D, lowered and raised [1]
    """

    number: Number
    snr: tuple[float, float]
    detection: tuple[float, float]


@dataclass(frozen=True)
class Probe:
    """The detection whose P_D is watched: the one of the scenarios nearest 0.5, which moves most."""

    scenario: str
    key: tuple[str, str, str]
    value: float


def telling_probe(predictions: Mapping[str, Prediction]) -> Probe | None:
    """The subject and detector whose P_D lies nearest 0.5; None where nothing is detected."""
    probes = [
        Probe(name, key, float(detection_at(curve, FALSE_ALARM)))
        for name, prediction in predictions.items()
        for key, curve in prediction.roc.items()
        if key[2] == "pixel"
    ]
    return min(probes, key=lambda p: abs(p.value - 0.5), default=None)


def sensitivities(
    sensor: Sensor,
    predictions: Mapping[str, Prediction],
    ledger: Ledger,
    *,
    vary: float = 0.2,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> tuple[list[Swing], Probe | None]:
    """Lower and raise each assumed number by the part ``vary``; the swings, largest of the SNR first."""
    assumed = [n for n in numbers(sensor.specification) if n.assumed and n.varies]
    probe = telling_probe(predictions)
    scenario = standard_scenario(probe.scenario) if probe is not None else None
    swings = []
    for number in track(assumed, "assumed numbers", show=show_progress):
        sides = []
        for factor in (1.0 - vary, 1.0 + vary):
            other = Sensor(scaled(sensor.specification, {number.name: factor}))
            sides.append((_snr_change(sensor, other), _detection_change(other, scenario, probe, engine)))
        (low, low_pd), (high, high_pd) = sides
        swings.append(Swing(number, (low, high), (low_pd, high_pd)))
    swings.sort(key=lambda s: -max(abs(v) for v in s.snr))
    for swing in swings:
        for sign, snr, detection in zip("-+", swing.snr, swing.detection, strict=True):
            subject = f"{swing.number.name} {sign}{100 * vary:g} %"
            ledger.info(PRODUCT, "relative_change_of_snr", snr, subject=subject, reason=swing.number.source)
            if probe is not None:
                words = f"{probe.key[0]} by {probe.key[1]} at P_FA 0.001, where P_D is {probe.value:.3f}"
                ledger.info(PRODUCT, "change_of_pd", detection, subject=subject, reason=words)
    return swings, probe


def _snr_change(sensor: Sensor, other: Sensor) -> float:
    """Relative change of the SNR with C_R at ground of 0.25, in the good band of the windows it moves most."""
    axis = sensor.axis
    use = axis.good & in_window(axis.centre_nm)
    use = use if use.any() else axis.good
    level = sunlit_radiance(axis, MIDDLE)
    change = (other.noise().snr(level) / sensor.noise().snr(level) - 1.0)[use]
    return float(change[int(np.argmax(np.abs(change)))])


def _detection_change(
    other: Sensor, scenario: Scenario | None, probe: Probe | None, engine: Engine | None
) -> float:
    if probe is None or scenario is None:
        return 0.0
    prediction = predict(scenario, Origins(sensor=other, engine=engine, show_progress=False))
    return float(detection_at(prediction.roc[probe.key], FALSE_ALARM)) - probe.value

"""One run of the twin with a seed of its own: simulate, observe, predict, compare, through the public functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from hyperval.campaign import Campaign, job_of
from hyperval.compare import compare_products
from hyperval.datasets import SIMULATED
from hyperval.model import Origins, predict
from hyperval.observe import observe
from hyperval.results import ResultTable, of_campaign
from hyperval.scenario import load_scenario
from hyperval.simulate import SceneFile, SimulationInputs, load_inputs, load_scene, simulate

TWIN = Path(__file__).parents[2] / "campaigns" / "share2012-twin"
FILLS = (
    "yellow-fill-0.030", "yellow-fill-0.045", "yellow-fill-0.060", "yellow-fill-0.080", "yellow-fill-0.120",
    "green-fill-0.100", "green-fill-0.150", "green-fill-0.200", "green-fill-0.280", "green-fill-0.400",
)  # fmt: skip
FIELDS = ("grass-field", "asphalt-court")
PANELS = ("white-panel", "black-panel", "grey-panel-18", "grey-panel-35")


@dataclass(frozen=True)
class Level:
    """Predicted and measured P_D of one fill at one false-alarm probability, and whether they agree."""

    subject: str
    predicted: float
    measured: float
    lower: float
    upper: float

    @property
    def inside(self) -> bool:
        """The predicted P_D lies inside the measured 95 % interval."""
        return self.lower <= self.predicted <= self.upper


@cache
def shared_inputs(scene_file: str) -> tuple[SceneFile, SimulationInputs]:
    """A scene of the twin and what every seed of it shares: surfaces, sensor, atmosphere."""
    scene = load_scene(TWIN / scene_file)
    return scene, load_inputs(scene, TWIN)


def run_twin(campaign_file: str, seed: int, folder: Path, *, covariances: bool = True) -> ResultTable:
    """All comparisons of the twin whose scene is drawn with ``seed``; the detector is CEM alone.

    Covariances take half the time, of which draws of the predicted ones are the most.
    """
    campaign: Campaign = job_of(TWIN / campaign_file).campaign
    assert campaign.collection.simulate is not None
    assert campaign.detection is not None
    scene, inputs = shared_inputs(campaign.collection.simulate)
    simulate(scene.model_copy(update={"seed": seed}), folder, inputs=inputs, show_progress=False)

    def resolve(reference: str) -> Path:
        return folder / reference.removeprefix(SIMULATED)

    detection = campaign.detection.model_copy(update={"detectors": ["cem"]})
    observed = observe(campaign.collection, detection, resolve, show_progress=False)
    scenario = load_scenario(TWIN / str(campaign.scenarios[0]))
    processing = scenario.processing.model_copy(update={"detectors": ["cem"]})
    scenario = scenario.model_copy(update={"processing": processing})
    prediction = predict(scenario, Origins(axis=observed.observation.axis, show_progress=False))
    observation = observed.observation
    if not covariances:
        radiance, reflectance = (
            {name: replace(each, pixel_covariance=None) for name, each in spectra.items()}
            for spectra in (observation.radiance, observation.reflectance)
        )
        observation = replace(observation, radiance=radiance, reflectance=reflectance)
    return ResultTable(of_campaign(compare_products(prediction, observation), campaign.name))


def levels(table: ResultTable, pfa: str) -> list[Level]:
    """P_D of every fill, by pixel, at the false-alarm probability ``pfa`` (as "1e-2")."""
    out = []
    for subject in FILLS:
        rows = table.where(product="roc", subject=subject, method="cem/pixel")
        (predicted,) = rows.where(metric=f"pd_predicted@{pfa}")
        (measured,) = rows.where(metric=f"pd_measured@{pfa}")
        out.append(Level(subject, predicted.value, measured.value, measured.lower, measured.upper))
    return out


def difference(table: ResultTable, subject: str, metric: str) -> float:
    """A summary of the difference ratio of the mean radiance of one class."""
    (row,) = table.where(product="radiance", subject=subject, metric=metric)
    return row.value

"""The forward model alone into a folder, without the rooms that read imagery: the command that answers at once."""

from __future__ import annotations

from pathlib import Path

from hyperval.campaign.provenance import record_of
from hyperval.compare.products import product_rows
from hyperval.datasets import InputLog
from hyperval.model import Origins, predict
from hyperval.report import write_outputs
from hyperval.results import ResultTable, of_campaign
from hyperval.run import Run
from hyperval.scenario import load_scenario
from hyperval.storage import whole_folder


def predict_to_folder(name_or_path: str, output: Path) -> int:
    """Run the forward model alone and write its products."""
    scenario = load_scenario(name_or_path)
    log = InputLog(scenario.folder or Path())
    with whole_folder(output) as folder:  # first of all: it may not be writable
        prediction = predict(scenario, Origins(resolve=log.resolve))
        rows = ResultTable(of_campaign(product_rows(prediction, "predicted"), scenario.name))
        record = record_of(log, [scenario], None, {"scenario": scenario}, [prediction])
        run = Run(
            rows, record, {"predicted": prediction}, scenario.title or scenario.name, campaign=scenario.name,
            description=scenario.description, kind="Prediction of scenario", notes=prediction.notes,
        )  # fmt: skip
        write_outputs(run, folder)
    return 0

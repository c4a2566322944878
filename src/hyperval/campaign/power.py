"""Power of campaigns: each standard error is injected into the model; which acceptance criteria detect it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import hyperval
from hyperval import attribute
from hyperval.campaign import power_file
from hyperval.campaign.power_file import Injected, PowerTable, Reasons
from hyperval.campaign.products import collected, predicted_side
from hyperval.campaign.run import outcomes, scenario_model, worlds_of
from hyperval.campaign.schema import Job, jobs_of
from hyperval.errors import MissingDataError
from hyperval.executors import in_order, worker_count, workers
from hyperval.metrics import DIGITS, Evidence
from hyperval.model import Truth, predict
from hyperval.products import PredictedProducts
from hyperval.progress import bars, track
from hyperval.results import Outcome, Result, ResultTable, paired
from hyperval.run import csv_text
from hyperval.storage import POWER, whole_folder, write_text

SEED, WORLDS = 34, 20  # worlds for each kind of cause


@dataclass(frozen=True)
class Power:
    """What came of one campaign.

    Attributes
    ----------
    table : None where nothing was run
    skipped : why nothing was run
    accepted : the table that was accepted before, if any
    """

    campaign: str
    table: PowerTable | None = None
    skipped: str = ""
    accepted: PowerTable | None = None

    @property
    def changes(self) -> list[str]:
        """Errors that are seen by gates, by other rows or not at all where the accepted table says otherwise."""
        if self.table is None or self.accepted is None:
            return []
        now = {name: str(injected.sight) for name, injected in self.table.errors.items()}
        before = {name: str(injected.sight) for name, injected in self.accepted.errors.items()}
        names = dict.fromkeys((*now, *before))
        pairs = [(n, now.get(n, "not in the table"), before.get(n, "not in the table")) for n in names]
        return [f"{name}: {sight}, accepted: {accepted}" for name, sight, accepted in pairs if sight != accepted]


def campaign_power(
    paths: Sequence[Path], *, output: Path | None = None, accept: bool = False, own: Path | None = None
) -> list[Power]:
    """The power table of every campaign whose data are at hand; campaigns run side by side.

    Parameters
    ----------
    output : folder for the tables, NAME.yaml each, and power.csv with all of them
    accept : keep the tables in validation/power, where reports look for them
    own : a file of errors to inject in place of the standard ones (:func:`hyperval.attribute.errors_of_file`)

    Raises
    ------
    HypervalError : of any campaign.
    """
    jobs = jobs_of(*paths)
    with whole_folder(output, POWER) if output is not None else nullcontext() as folder:
        with workers(worker_count(len(jobs))) as where:
            results = in_order(where, partial(_power, own=own), jobs)
            tables = list(track(results, "campaigns", len(jobs)))
        for place in (*([folder] if folder is not None else []), *([power_file.ACCEPTED] if accept else [])):
            for item in tables:
                if item.table is not None:
                    power_file.write_power_table(place / f"{item.campaign}.yaml", item.table)
        if folder is not None:
            write_text(folder / "power.csv", _csv(tables))
    return tables


@bars(False)
def _power(job: Job, own: Path | None) -> Power:
    errors = attribute.errors_of_file(own) if own is not None else attribute.injected_errors()
    name = job.outline.name
    if job.waits is not None:
        return Power(name, skipped=job.waits[0])
    try:
        table = power_table(job, errors)
        return Power(name, table, accepted=power_file.accepted_table(name, job.folder))
    except MissingDataError as error:
        return Power(name, skipped=str(error))


def power_table(job: Job, errors: Mapping[str, attribute.Family]) -> PowerTable:
    """Observe once, predict with each of ``errors``, and compare each time.

    Raises
    ------
    MissingDataError : files of a registered data set that are not on this machine.
    HypervalError : anything else that the user can mend.
    """
    with collected(job) as here:
        scenarios = here.scenarios
        origins = [here.origins(scenario) for scenario in scenarios]
        stated = [predict(s, o, objects=True) for s, o in zip(scenarios, origins, strict=True)]

        def injected(error: attribute.Family) -> Injected:
            """What it turns, and what the attribution says of it when it came to what is measured.

            Of a scenario that has nothing of the kind the prediction stays.
            """
            sides: list[tuple[PredictedProducts, Truth]] = []
            refused = []
            for scenario, plain, own in zip(scenarios, stated, origins, strict=True):
                try:
                    sides.append(attribute.injected_prediction(scenario, error, own, objects=True))
                except attribute.NotInjectable as why:
                    sides.append((plain, {}))
                    refused.append(why.what)
            if len(refused) == len(scenarios):
                return Injected(not_applicable=refused[0])
            predictions, truths = zip(*sides, strict=True)
            found = turned(before, outcomes(here, predicted_side(here, predictions, truths)))
            ((with_it, _),), level = causes.evaluate([truths], "injected error"), causes.predicted
            cause = causes.or_rarer(with_it - level, np.arange(level.size), level, causes.of_inputs)
            reason = " or ".join((cause.first, *cause.alike[:3])) + (", enough" if cause.enough else "")
            return found.model_copy(update={"reason": reason})

        prediction = predicted_side(here, stated)
        before = outcomes(here, prediction)
        causes = attribute.causes_of(scenario_model(here), here.observed.observation, worlds_of(here), prediction)
        rows = {name: injected(error) for name, error in track(errors.items(), "injected errors", len(errors))}
        gates = [row for row in before if row.gates and row.evidence is Evidence.MODEL]
        disagreeing = sum(row.outcome is Outcome.DISAGREES for row in gates)
        return PowerTable(
            schema=1,
            campaign=job.campaign.name,
            version=hyperval.__version__,
            files=power_file.own_files(here.inputs.entries()),
            gates=len(gates) - disagreeing,
            disagreeing=disagreeing,
            stated=power_file.gate_values(before),
            errors=rows,
            reasons=_calibrated(causes),
        )


def _calibrated(causes: attribute.Causes) -> Reasons:
    """What the attribution says of worlds drawn within the stated uncertainty, a fixed seed."""
    named: dict[str, Counter[str]] = {}
    grouped: Counter[str] = Counter()
    stated, wrong, worlds = list[tuple[float, bool]](), 0, 0
    for kind, found in causes.reasoner().drawn(np.random.default_rng(SEED), WORLDS):
        first, group = attribute.kind_of(found.first), {attribute.kind_of(name) for name in (found.first, *found.alike)}
        named.setdefault(kind, Counter())[first] += 1
        grouped[kind] += kind in group
        worlds += 1
        wrong += found.enough and kind not in group
        if first != attribute.NOTHING:  # that chance explains a small error is no mistake
            stated.append((found.probability[found.first], first == kind))
    steps = [(low, [right for p, right in stated if low <= p < low + 0.2]) for low in (0.0, 0.2, 0.4, 0.6, 0.8)]
    standing = causes.standing()[1]
    return Reasons(
        first=standing.first,
        reduced_chi_square=float(f"{standing.chi_square / standing.dof:.{DIGITS}g}"),
        worlds=worlds,
        named={kind: dict(counts) for kind, counts in named.items()},
        grouped=dict(grouped),
        wrong_enough=round(wrong / worlds, 4),
        calibration=[(low + 0.1, round(sum(own) / len(own), 3), len(own)) for low, own in steps if own],
        sides=causes.sides(),
    )


def turned(before: Iterable[Result], after: Iterable[Result]) -> Injected:
    """What disagrees after and did not before."""
    wrong, pairs = Outcome.DISAGREES, paired(ResultTable(before), ResultTable(after))
    new = [p.b for p in pairs if p.b and p.b.outcome is wrong and not (p.a and p.a.outcome is wrong)]
    gates = tuple(dict.fromkeys(row.key for row in new if row.gates))
    return Injected(gates=gates, informing=dict(Counter(row.product for row in new if not row.gates)))


def _csv(table: Sequence[Power]) -> str:
    lines: list[list[Any]] = [["campaign", "error", "seen_by", "gates", "rows_that_do_not_decide", "which"]]
    for item in table:
        for name, injected in item.table.errors.items() if item.table else ():
            which = injected.not_applicable or "; ".join(injected.gates)
            rows = sum(injected.informing.values())
            lines.append([item.campaign, name, str(injected.sight), len(injected.gates), rows, which])
    return csv_text(lines)

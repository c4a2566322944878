"""The power table of a campaign: which standard errors, injected one at a time, its comparisons detect; as a file."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import yaml
from pydantic import Field

import hyperval
from hyperval import attribute
from hyperval.campaign.products import attribution_model, observe_campaign, outcomes, predicted_side
from hyperval.campaign.schema import Job, load_jobs
from hyperval.config import Model, load_model
from hyperval.errors import MissingDataError, UsageError, refuse
from hyperval.executors import in_order, worker_count, workers
from hyperval.metrics import DIGITS, Evidence, default_tolerance, plain_words
from hyperval.model import Truth, predict
from hyperval.products import PredictedProducts
from hyperval.progress import bars, track
from hyperval.results import Outcome, Result, ResultTable, paired, split_key
from hyperval.run import csv_text
from hyperval.storage import POWER, whole_folder, write_text

ACCEPTED = Path("validation/power")
_MAX_NAMED = 4
SEED, WORLDS = 34, 20  # worlds for each kind of cause


class DetectedBy(StrEnum):
    """Which comparisons of a campaign detect an error."""

    GATES = "criteria"
    INFORMING = "informational comparisons"
    UNSEEN = "undetected"
    NOT_APPLICABLE = "not applicable"


class InjectedError(Model):
    """Comparisons that one injected error turns to "disagrees"; those that disagree without it are left out."""

    gates: tuple[str, ...] = Field((), description='criteria that detect it: "product | subject | method | metric"')
    informing: dict[str, int] = Field({}, description="informational rows that detect it, by product")
    not_applicable: str | None = Field(None, description="why it cannot be injected")
    reason: str = Field("", description="what the attribution concludes with it, compared with the unperturbed run")

    @property
    def detected_by(self) -> DetectedBy:
        """Which comparisons detect it."""
        rows = DetectedBy.GATES if self.gates else DetectedBy.INFORMING if self.informing else DetectedBy.UNSEEN
        return DetectedBy.NOT_APPLICABLE if self.not_applicable else rows

    @property
    def words(self) -> str:
        """How many comparisons detect it."""
        rows, criteria = sum(self.informing.values()), len(self.gates)
        parts = [f"{criteria} {'criterion' if criteria == 1 else 'criteria'}"] if criteria else []
        parts += [f"{rows} informational comparison{'' if rows == 1 else 's'}"] if rows else []
        return ", ".join(parts) or self.detected_by

    @property
    def detail(self) -> str:
        """What detects it, some by name; or why it cannot be injected.

        >>> InjectedError(gates=("radiance | lawn | sixs | p_value_shape",)).detail
        'shape of the radiance, lawn'
        >>> gates = [f"radiance | a | b | {method} | p_value_shape" for method in ("sixs", "modtran")]
        >>> InjectedError(gates=gates).detail  # of the subject 'a | b', told once
        'shape of the radiance, a | b'
        """
        words = list(self.gates)
        with suppress(UsageError):  # a metric of another version
            words = [f"{plain_words(m, product)}, {subject}" for product, subject, _, m in map(split_key, words)]
        named = list(dict.fromkeys(words))[:_MAX_NAMED]
        named += [f"and {more} more"] if (more := sum(one not in named for one in words)) else []
        return self.not_applicable or "; ".join(named) or ", ".join(f"{name} {n}" for name, n in self.informing.items())


class AttributionSkill(Model):
    """What the attribution says where it is known what is wrong: of worlds drawn within the stated uncertainty."""

    first: str = Field(description="first cause without an injected error")
    worlds: int = Field(ge=1)
    named: dict[str, dict[str, int]] = Field(description="kind of error -> first cause named, how often")
    grouped: dict[str, int] = Field(description="kind of error -> how often it was first, or in one group with it")
    wrong_enough: float = Field(description="share of all errors for which a wrong cause was called sufficient")
    calibration: list[tuple[float, float, int]] = Field(
        description="stated probability of a cause, share that was right, worlds"
    )
    reduced_chi_square: float = Field(0.0, ge=0, description="of all residuals, unperturbed")
    sides: dict[str, tuple[str, str, str]] = Field(description="unperturbed: bands, observed, predicted; by quantity")

    @property
    def lines(self) -> list[str]:
        """ "of 40 errors of sensor gain 31 are named first, 36 are in the first group; 5 are called sunlight" """
        out = []
        for kind, counts in self.named.items():
            total, right = sum(counts.values()), counts.get(kind, 0)
            others = sorted(((n, name) for name, n in counts.items() if name != kind), reverse=True)[:2]
            words = f"of {total} errors of {kind} {right} are named first, {self.grouped.get(kind, 0)} are in its group"
            out.append("; ".join([words, *(f"{n} are called {name}" for n, name in others)]))
        parts = [f"{100 * p:.0f} % was correct in {100 * share:.0f} % of {n}" for p, share, n in self.calibration]
        stated = f"Stated probabilities of a cause: {'; '.join(parts)}."
        return [*out, stated, f"Wrong but called sufficient: {100 * self.wrong_enough:.1f} %."]


class PowerTable(Model):
    """The power table of one campaign."""

    schema_version: Literal[1] = Field(alias="schema")
    campaign: str
    version: str = Field(description="of hyperval, which computed it")
    files: dict[str, str] = Field(description="the campaign's own files: SHA-256 of each")
    gates: int = Field(ge=0, description="criteria met or inconclusive without an injected error")
    disagreeing: int = Field(ge=0, description="criteria not met without an injected error, which cannot detect any")
    stated: dict[str, float] = Field({}, description="criterion of the model -> its value without an injected error")
    errors: dict[str, InjectedError] = Field(min_length=1)
    reasons: AttributionSkill | None = None

    def changed_files(self, inputs: Iterable[Mapping[str, Any]]) -> list[str]:
        """The campaign's own files that are not, or not any more, as they were when the table was computed.

        ``inputs`` : with ``reference`` and ``sha256``, as provenance has them.
        """
        now = own_files(inputs)
        return sorted(name for name in {*now, *self.files} if now.get(name) != self.files.get(name))

    def changed_gates(self, rows: Iterable[Result]) -> list[str]:
        """Model gates whose value in a run differs from that when the table was computed."""
        now = gate_values(rows)
        values = {n: (self.stated.get(n, math.nan), now.get(n, math.nan)) for n in {**self.stated, **now}}
        # A number that one side lacks is not within the tolerance.
        within = {n: default_tolerance(split_key(n)[3]).width(before) for n, (before, _) in values.items()}
        return [n for n, (before, value) in values.items() if not abs(value - before) <= within[n]]

    def outdated(self, inputs: Iterable[Mapping[str, Any]], rows: Iterable[Result]) -> str:
        """Why the table is not of a run of these inputs and rows; empty where it is."""
        if changed := self.changed_files(inputs):
            return f"The table is older than {', '.join(changed)}: run hyperval power again."
        moved = self.changed_gates(rows)
        outdated = f"The table is outdated: {len(moved)} of its criteria had different values ({', '.join(moved[:1])})."
        return f"{outdated} Run hyperval power again." if moved else ""

    @property
    def sentence(self) -> str:
        """Which injected errors are detected, in words."""
        errors_by = {kind: [name for name, e in self.errors.items() if e.detected_by is kind] for kind in DetectedBy}
        injected = len(self.errors) - len(errors_by[DetectedBy.NOT_APPLICABLE])
        parts = [f"The criteria detect {len(errors_by[DetectedBy.GATES])} of {injected} injected model errors."]
        phrase = {DetectedBy.INFORMING: "Informational comparisons alone detect"}
        others = [kind for kind in DetectedBy if kind is not DetectedBy.GATES and errors_by[kind]]
        parts += [f"{phrase.get(s, s.capitalize())}: {', '.join(errors_by[s])}." for s in others]
        if self.disagreeing:
            some = "criteria that are" if self.disagreeing > 1 else "criterion that is"
            parts.append(f"{self.disagreeing} {some} already not met cannot detect any.")
        return " ".join(parts)


def gate_values(rows: Iterable[Result]) -> dict[str, float]:
    """Gate of the model -> its value, as a power table keeps it; without those that have none."""
    gates = [row for row in rows if row.gates and row.evidence is Evidence.MODEL and math.isfinite(row.value)]
    return {row.key: float(f"{row.value:.{DIGITS}g}") for row in gates}


def own_files(inputs: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Reference -> SHA-256 of those inputs that stand beside the campaign, not in a data set or a simulation.

    >>> names = "campaign.yaml", "MINE.YML", "data:hysu/a.yaml", "line.img"
    >>> [*own_files({"reference": name, "sha256": "0"} for name in names)]
    ['campaign.yaml', 'MINE.YML']
    """
    digests = {str(item["reference"]): str(item["sha256"]) for item in inputs}
    return {n: digest for n, digest in digests.items() if ":" not in n and n.lower().endswith((".yaml", ".yml"))}


def accepted_table(name: str, folder: Path) -> PowerTable | None:
    """The accepted power table of a campaign, None where there is none.

    It is looked for in validation/power of its own folder and of those above it, of the working folder, and of the
    checkout that the program runs from: a copy elsewhere is told what changed since.

    Raises
    ------
    UsageError : mistakes in the file, or a table of another campaign.
    """
    roots = (folder, *folder.resolve().parents, Path(), Path(hyperval.__file__).parents[2])
    path = next((p for p in (root / ACCEPTED / f"{name}.yaml" for root in roots) if p.is_file()), None)
    if path is None:
        return None
    table = load_model(PowerTable, path)
    refuse(table.campaign != name, "power.other", str(path), campaign=table.campaign, name=name)
    return table


def write_power_table(path: Path, table: PowerTable) -> None:
    """Write one table as YAML."""
    data = table.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    head = f"# Errors injected into the model of campaign {table.campaign}, and the criteria that detect them.\n"
    head += "# `hyperval power CAMPAIGN.yaml --accept` renews it.\n"
    write_text(path, head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=140))


class Power(NamedTuple):
    """What came of one campaign.

    Attributes
    ----------
    table : None where nothing was run
    skipped : why nothing was run
    changes : errors that are seen by gates, by other rows or not at all where the accepted table says otherwise
    """

    campaign: str
    table: PowerTable | None = None
    skipped: str = ""
    changes: Sequence[str] = ()


def campaign_power(
    paths: Sequence[Path], *, output: Path | None = None, accept: bool = False, errors_file: Path | None = None
) -> list[Power]:
    """The power table of every campaign whose data are at hand; campaigns run side by side.

    Parameters
    ----------
    output : folder for the tables, NAME.yaml each, and power.csv with all of them
    accept : keep the tables in validation/power, where reports look for them
    errors_file : a file of errors to inject in place of the standard ones (:func:`hyperval.attribute.errors_of_file`)

    Raises
    ------
    HypervalError : of any campaign.
    """
    jobs = load_jobs(*paths)
    with whole_folder(output, POWER) if output is not None else nullcontext() as folder:
        with workers(worker_count(len(jobs))) as where:
            tables = list(track(in_order(where, partial(_power, file=errors_file), jobs), "campaigns", len(jobs)))
        for place in filter(None, (folder, ACCEPTED if accept else None)):
            for table in (item.table for item in tables if item.table is not None):
                write_power_table(place / f"{table.campaign}.yaml", table)
        if folder is not None:
            write_text(folder / "power.csv", _csv(tables))
    return tables


@bars(False)
def _power(job: Job, file: Path | None) -> Power:
    errors, name = attribute.errors_of_file(file) if file else attribute.injected_errors(), job.outline.name
    if job.unavailable is not None:
        return Power(name, skipped=job.unavailable[0])
    try:
        table, accepted = power_table(job, errors), None if file else accepted_table(name, job.folder)
    except MissingDataError as error:
        return Power(name, skipped=str(error))
    now, before = ({n: one.detected_by for n, one in t.errors.items()} for t in (table, accepted or table))
    pairs = {n: [sights.get(n, "not in the table") for sights in (now, before)] for n in dict.fromkeys((*now, *before))}
    return Power(name, table, changes=[f"{n}: {a}, accepted: {b}" for n, (a, b) in pairs.items() if a != b])


def power_table(job: Job, errors: Mapping[str, attribute.Perturbation]) -> PowerTable:
    """Observe once, predict with each of ``errors``, and compare each time.

    Raises
    ------
    MissingDataError : files of a registered data set that are not on this machine.
    HypervalError : anything else that the user can mend.
    """
    with observe_campaign(job) as collection:
        origins = [collection.origins(scenario) for scenario in collection.scenarios]
        stated = [predict(s, o, objects=True) for s, o in zip(collection.scenarios, origins, strict=True)]

        def inject(error: attribute.Perturbation) -> InjectedError:
            """The comparisons that it changes, and the cause that the attribution finds for it.

            The prediction of a scenario that it does not apply to stays.
            """
            sides: list[tuple[PredictedProducts, Truth]] = [(plain, {}) for plain in stated]
            refused = []
            for i, (scenario, origin) in enumerate(zip(collection.scenarios, origins, strict=True)):
                try:
                    sides[i] = attribute.injected_prediction(scenario, error, origin, objects=True)
                except attribute.NotInjectable as why:
                    refused.append(why.what)
            if len(refused) == len(sides):
                return InjectedError(not_applicable=refused[0])
            predictions, truths = zip(*sides, strict=True)
            found = outcome_changes(before, outcomes(collection, predicted_side(collection, predictions, truths)))
            (with_it,), level = causes.evaluate([truths], "injected error"), causes.predicted
            cause = causes.explain_with_rarer(with_it - level, np.arange(level.size), level, causes.input_columns)
            reason = " or ".join((cause.first_cause, *cause.confounded[:3])) + ", enough" * cause.is_sufficient
            return found.model_copy(update={"reason": reason})

        prediction = predicted_side(collection, stated)
        before = outcomes(collection, prediction)
        causes = attribute.collect_effects(attribution_model(collection, prediction))
        rows = {name: inject(error) for name, error in track(errors.items(), "injected errors", len(errors))}
        are_met = [r.outcome is not Outcome.DISAGREES for r in before if r.gates and r.evidence is Evidence.MODEL]
        files, values, reasons = own_files(collection.inputs.entries()), gate_values(before), _attribution_skill(causes)
        return PowerTable(
            schema=1, campaign=job.campaign.name, version=hyperval.__version__, files=files, gates=sum(are_met),
            disagreeing=len(are_met) - sum(are_met), stated=values, errors=rows, reasons=reasons,
        )  # fmt: skip


def _attribution_skill(causes: attribute.CauseEffects) -> AttributionSkill:
    """What the attribution says of worlds drawn within the stated uncertainty, a fixed seed."""
    named, grouped = dict[str, Counter[str]](), Counter[str]()
    stated, wrong = list[tuple[float, bool]](), list[bool]()
    for kind, found in causes.residuals.whitened()[0].simulate(np.random.default_rng(SEED), WORLDS):
        first, *group = (attribute.prior_group(name) for name in (found.first_cause, *found.confounded))
        is_named = kind in (first, *group)
        named.setdefault(kind, Counter())[first] += 1
        grouped[kind] += is_named
        wrong.append(found.is_sufficient and not is_named)
        if first != attribute.NOTHING:  # that chance explains a small error is no mistake
            stated.append((found.probability[found.first_cause], first == kind))
    steps = [(low, [right for p, right in stated if low <= p < low + 0.2]) for low in (0.0, 0.2, 0.4, 0.6, 0.8)]
    calibration = [(low + 0.1, round(sum(hits) / len(hits), 3), len(hits)) for low, hits in steps if hits]
    standing = causes.explain_residuals()[1]
    chi_square = float(f"{standing.chi_square / standing.dof:.{DIGITS}g}")
    return AttributionSkill(
        first=standing.first_cause, reduced_chi_square=chi_square, worlds=len(wrong), named=named, grouped=grouped,
        wrong_enough=round(sum(wrong) / len(wrong), 4), calibration=calibration, sides=causes.sides(),
    )  # fmt: skip


def outcome_changes(before: Iterable[Result], after: Iterable[Result]) -> InjectedError:
    """Comparisons that disagree with an injected error and did not without it."""
    wrong, pairs = Outcome.DISAGREES, paired(ResultTable(before), ResultTable(after))
    new = [p.b for p in pairs if p.b and p.b.outcome is wrong and not (p.a and p.a.outcome is wrong)]
    gates = tuple(dict.fromkeys(row.key for row in new if row.gates))
    return InjectedError(gates=gates, informing=dict(Counter(row.product for row in new if not row.gates)))


def _csv(tables: Sequence[Power]) -> str:
    lines: list[list[Any]] = [["campaign", "error", "seen_by", "gates", "rows_that_do_not_decide", "which"]]
    for item in tables:
        for name, one in item.table.errors.items() if item.table else ():
            which = one.not_applicable or "; ".join(one.gates)
            lines.append([item.campaign, name, one.detected_by, len(one.gates), sum(one.informing.values()), which])
    return csv_text(lines)

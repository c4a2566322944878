"""Running campaigns: observe once, predict, compare, judge and write, several at once, each into its own folder.

Results that are still valid are kept, of a run that was cut off and of an earlier one: ``.hyperval-made-of.json`` in a
campaign's folder records what they were made of, and their files.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import hyperval
from hyperval.attribute import attribute
from hyperval.campaign import products
from hyperval.campaign.pictures import quicklook, score_maps
from hyperval.campaign.power import accepted_table
from hyperval.campaign.provenance import record_of
from hyperval.campaign.schema import Campaign, Job, Outline, load_job, load_jobs
from hyperval.compare import product_rows
from hyperval.datasets import SIMULATED, InputLog, owner_of, resolve
from hyperval.errors import HypervalError, MissingDataError, refuse, words_and_code
from hyperval.executors import WorkersLostError, in_order, worker_count, workers
from hyperval.imagery import COMPANIONS, companion_file
from hyperval.model import predict
from hyperval.observe import Observed, open_source
from hyperval.observe import write_reflectance as reflectance_cube
from hyperval.paths import matching
from hyperval.products import PredictedProducts
from hyperval.progress import step, track, working
from hyperval.report import write_index, write_outputs
from hyperval.results import Cause, Outcome, Result, ResultTable, of_campaign
from hyperval.run import Run, file_stems, read_rows
from hyperval.storage import RECORD, files_within, partial_folder, sha256_of, whole_folder, write_text

# Engine of states that serve attribution alone.
STEPS_OF_REASONS = "6S at the stated state; steps that no budget is made of by its emulator, where it covers both"
Done = tuple[Run, int | None]


def run_campaign(job: Job, *, predicts: bool = True, with_observed: Callable[[Observed], None] = lambda _: None) -> Run:
    """Run one campaign; files it cannot find in a registered data set make it SKIPPED.

    ``with_observed`` is called while the files of the collection, simulated ones too, are still there.

    Raises
    ------
    HypervalError : anything else that the user can mend.
    """
    if job.unavailable is not None:
        return uncompared_run(job, Outcome.SKIPPED, *job.unavailable)
    name = job.campaign.name
    try:
        with ExitStack() as stack:
            with campaign_step(name, "observe", predicts):
                side = stack.enter_context(products.observe_campaign(job))
                with_observed(side.observed)
            sides = []
            if predicts:
                with campaign_step(name, "predict"):
                    sides = [predict(s, side.origins(s), objects=True) for s in side.scenarios]
            with campaign_step(name, "compare" if predicts else "summarise", predicts):
                return _compare_sides(side, sides)
    except MissingDataError as error:
        if not predicts:  # nothing but the collection was asked for
            raise
        # All that the campaign lacks, and not the first that was asked for.
        owners = [owner_of(file.text) for file in job.files if file.path is None]
        sets = list(dict.fromkeys(owner.name for owner in owners if owner is not None))
        remedy = f"hyperval data fetch {' '.join(sets)}" if len(sets) > 1 else error.mend or ""
        return uncompared_run(job, Outcome.SKIPPED, f"{error.where}: {error.what}\n  to fix it: {remedy}", remedy)


def campaign_step(campaign: str, what: str, predicts: bool = True) -> AbstractContextManager[None]:
    """Progress bars within say which campaign and which of its steps they belong to."""
    steps = ("observe", "predict", "compare", "report") if predicts else ("observe", "summarise", "report")
    return step(campaign, steps.index(what) + 1, len(steps), what)


def _compare_sides(side: products.ObservedCampaign, predicted: Sequence[PredictedProducts]) -> Run:
    """What both sides say, compared and judged; what the collection says where nothing was predicted."""
    campaign, scenarios, observed = side.campaign, side.scenarios, side.observed
    prediction, power, deciding = None, None, list[tuple[Result, str]]()
    if predicted:
        power, prediction = accepted_table(campaign.name, side.inputs.base), products.predicted_side(side, predicted)
        rows = products.outcomes(side, prediction)
        deciding = products.undecided_criteria(side, rows, prediction)
        reason_of = {id(row): f"{row.reason}; it takes {words}".removeprefix("; ") for row, words in deciding}
        rows = [replace(row, reason=reason_of[id(row)]) if id(row) in reason_of else row for row in rows]
        if campaign.attribution is not None:  # why the two sides differ
            since = (reasons.sides, reasons.reduced_chi_square) if power and (reasons := power.reasons) else None
            asked = products.attribution_model(side, prediction), campaign.attribution, since
            rows += attribute(*asked, simulated=bool(campaign.simulated))
    else:
        rows = list(product_rows(observed.observation, "observed"))
    notes = ["the collection is imagery and truth that DIRSIG made"] if campaign.simulated == "dirsig" else []
    notes += [*campaign.assumptions, *observed.observation.notes, *products.contradictions(side, prediction, rows)]
    notes += prediction.notes if prediction else ()
    configuration, sides = {"campaign": campaign}, [observed.observation, *predicted]
    provenance = record_of(side.inputs, scenarios, side.seed, configuration, sides)
    if predicted and campaign.attribution and any(s.atmosphere and s.atmosphere.engine == "sixs" for s in scenarios):
        provenance["engines"]["attribution"] = {"atmosphere": STEPS_OF_REASONS}
    return build_run(
        campaign, rows, kind="Campaign" if predicted else "Collection of campaign", provenance=provenance,
        products={"predicted": prediction, "observed": observed.observation}, quicklook=quicklook(observed),
        score_maps=score_maps(observed, campaign.detection, prediction, rows), deciding=deciding,
        power=(power, power.outdated(provenance["inputs"], rows)) if power else None,
        notes=list(dict.fromkeys(notes)), chosen_after=campaign.all_choices(),
    )  # fmt: skip


def build_run(campaign: Outline, rows: Iterable[Result], **more: Any) -> Run:
    """What a campaign's file and its rows alone say; ``more`` : other fields of :class:`hyperval.run.Run`."""
    fields: dict[str, Any] = {name: getattr(campaign, name) for name in ("title", "description", "references")}
    if isinstance(campaign, Campaign) and campaign.collection.radcalnet is not None:  # by a network
        fields["group"] = "Computed references"
    table = ResultTable(of_campaign(rows, campaign.name))
    return Run(table, campaign=campaign.name, simulated=bool(campaign.simulated), **fields, **more)


def uncompared_run(job: Job, outcome: Outcome, reason: str, remedy: str = "") -> Run:
    """The planned comparisons of a campaign that could not be made, each as a row."""
    campaign = job.outline
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    rows = [gate.row_for(subject, outcome, cause, reason) for gate in campaign.comparisons for subject in gate.subjects]
    record = record_of(InputLog.of_file(job.path), [], None, {"campaign": campaign}, [])
    return build_run(campaign, rows, provenance=record, notes=[reason, *campaign.assumptions], remedy=remedy)


# What need not run again ----------------------------------------------------------------------------------------------


def inputs_digest(job: Job, files: Mapping[str, str]) -> str:
    """A digest of everything that a campaign's results follow from.

    What else stood on the command line is none of it, nor what the campaign's file says of other runs: a campaign or
    a flight line more does not make the others run again.

    Parameters
    ----------
    files : SHA-256 by the name of each file that it reads; those that are simulated follow from the others
    """
    log = InputLog(job.folder)
    digests = {log.resolve(name): digest for name, digest in files.items()}
    if job.words:  # one of several runs: what the file says of this one is below
        digests.pop(job.path.resolve(), None)
    configuration = {"campaign": job.campaign, "words": dict(job.words), "program": _program_digest()}
    inner = record_of(log, [], None, configuration, [])
    inner |= {"command": None, "source_revision": None}  # a commit that leaves the program as it is
    power = repr(accepted_table(job.campaign.name, job.folder))
    inner |= {"inputs": sorted(digests.values()), "named": _named_files(job), "power": power}
    return hashlib.sha256(json.dumps(inner, sort_keys=True, default=str).encode()).hexdigest()


@cache
def _program_digest() -> str:
    """A digest of the package's own files: a checkout may change under one version."""
    digest, root = hashlib.sha256(), Path(hyperval.__file__).parent
    for path in (p for p in files_within(root) if p.suffix != ".pyc"):
        digest.update(f"{path.relative_to(root).as_posix()} {sha256_of(path)}\n".encode())
    return digest.hexdigest()


def _named_files(job: Job) -> list[str]:
    """The names of the files that a campaign names, and that the reader of its cube finds beside it.

    Others come and go: but a pattern may match one more, and a grid or a header that comes later is read.
    """
    paths = [path for one in job.files if one.path is not None for path in matching(one.path)]
    if (collection := job.campaign.collection).cube is not None and not collection.simulate:
        raster = open_source(collection.cube, partial(resolve, base=job.folder), collection.bands).raster
        paths += [*raster.source_files, *filter(None, (companion_file(raster.path, kind) for kind in COMPANIONS))]
    return sorted({path.name for path in paths})


class CampaignRun(NamedTuple):
    """A campaign on its way to its folder.

    Attributes
    ----------
    folder : which it is written into; what stands there whole and is unchanged is kept
    earlier : folder of an earlier run that it may be taken from; None: it is not
    raises : whether an error is raised; else it becomes the rows of the campaign
    """

    job: Job
    folder: Path
    earlier: Path | None
    raises: bool

    def find_unchanged(self) -> Run | None:
        """The report of a campaign that stands whole, without its arrays; what does not is removed.

        Files of an earlier run are copied; what else stands there stays.
        """
        if run := find_unchanged_run(self.job, self.folder):
            return run
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        if self.earlier is None or (run := find_unchanged_run(self.job, self.earlier)) is None:
            return None
        for name in (*json.loads((self.earlier / RECORD).read_bytes())["outputs"], RECORD):
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.earlier / name, self.folder / name)
        return run

    def run(self) -> Done:
        """Run it into its folder; its report without the arrays, and the exit code of the error that stopped it."""
        try:
            run, code = run_campaign(self.job), None
        except Exception as error:  # one broken campaign must not hide what the others say
            if self.raises:
                raise
            return self.write_error(error)
        return self.write(run, code)

    def write_error(self, error: Exception) -> Done:
        """What stopped it, as its rows."""
        words, code = words_and_code(error)
        return self.write(uncompared_run(self.job, Outcome.ERROR, words), code)

    def write(self, run: Run, code: int | None) -> Done:
        """Write its folder, and what it was made of, unless it was skipped or an error ended it."""
        with campaign_step(run.campaign, "report"), working("figures and report"):
            write_outputs(run, self.folder)
        if not any(row.cause in (Cause.NO_DATA, Cause.BROKEN) for row in run.table):
            read = {i["reference"]: i["sha256"] for i in run.provenance["inputs"]}
            files = {name: digest for name, digest in read.items() if not name.startswith(SIMULATED)}
            with suppress(OSError, HypervalError):  # a file of elsewhere, which the provenance names without its folder
                written = [path for path in files_within(self.folder) if path.name != RECORD]
                outputs = {path.relative_to(self.folder).as_posix(): sha256_of(path) for path in written}
                record = {"made_of": inputs_digest(self.job, files), "files": list(files), "outputs": outputs}
                write_text(self.folder / RECORD, json.dumps(record, indent=1, sort_keys=True) + "\n")
        table = ResultTable(row for row in run.table if row.planned or not row.per_band)  # most are of single bands
        return replace(run, table=table, products={}, score_maps={}, quicklook=None), code


def find_unchanged_run(job: Job, folder: Path) -> Run | None:
    """The report that stands whole in ``folder``, without its arrays, where it is unchanged."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, HypervalError):
        record, log = json.loads((folder / RECORD).read_bytes()), InputLog(job.folder)
        files = {name: sha256_of(log.resolve(name)) for name in record["files"]}
        is_whole = all(sha256_of(folder / name) == digest for name, digest in record["outputs"].items())
        if record["outputs"] and is_whole and record["made_of"] == inputs_digest(job, files):
            return build_run(job.campaign, read_rows(folder, every=False))
    return None


def _run_all(pieces: Sequence[CampaignRun], scheduler: str | None, tell: Callable[[str], None]) -> list[Done]:
    """Run what has changed; the result does not depend on the number or the place of the processes."""
    done: dict[int, Done] = {i: (run, None) for i, piece in enumerate(pieces) if (run := piece.find_unchanged())}
    for run, _ in done.values():
        tell(f"{run.campaign}: unchanged since the earlier run, whose results are kept (--again repeats it)")
    todo = [i for i in range(len(pieces)) if i not in done]
    with workers(worker_count(len(todo)), scheduler if todo else None) as where:
        one_process = where.executor is None  # one after the other, each with its own bars
        results = in_order(where, CampaignRun.run, [pieces[i] for i in todo], ahead=max(1, len(todo)))
        try:
            done |= zip(todo, track(results, "campaigns", len(todo), show=False if one_process else None), strict=False)
        except WorkersLostError as error:  # the campaigns whose results are not there yet
            done |= {i: pieces[i].write_error(error) for i in todo if i not in done}
    return [done[i] for i in range(len(pieces))]


def validate(
    paths: Sequence[Path],
    output: Path,
    *,
    scheduler: str | None = None,
    strict: bool = False,
    again: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> int:
    """Predict, observe and compare every campaign; write one folder, or one for each and an index.

    Parameters
    ----------
    scheduler : address of a Dask scheduler whose workers run the campaigns; they see the output folder and the data
        under the same names
    strict : undecided and skipped gates give 1, too
    again : run also what stands unchanged in ``output``
    tell : is given a line on what was not run again

    Returns
    -------
    The exit code of the contract.  A campaign whose data set is not at hand is SKIPPED in the table with the
    command that fetches it, or with who holds it.  An error in one of several campaigns becomes ERROR rows, the
    others are run, and the code is that of the first error; with a single campaign it is raised and nothing is
    written.  Of several, those that are finished stand in ``OUTPUT/.hyperval-partial`` until the results are whole:
    the same command goes on from there.
    """
    jobs = load_jobs(*paths)
    with whole_folder(output, beside=(one.path for job in jobs for one in job.files)) as folder:
        earlier = None if again else output.resolve()
        if len(jobs) == 1:
            done = _run_all([CampaignRun(jobs[0], folder, earlier, True)], scheduler, tell)
            return done[0][0].table.exit_code(strict=strict)
        kept, names = partial_folder(output) / "campaigns", file_stems(job.outline.name for job in jobs).values()
        each = zip(jobs, names, strict=True)
        pieces = [CampaignRun(job, kept / name, earlier and earlier / name, False) for job, name in each]
        done = _run_all(pieces, scheduler, tell)
        write_index([run for run, _ in done], folder, parts=kept)
        for name in names:
            os.rename(kept / name, folder / name)
    shutil.rmtree(kept, ignore_errors=True)
    with suppress(OSError):
        kept.parent.rmdir()
    first_error = next((code for _, code in done if code is not None), None)
    return first_error or ResultTable(row for run, _ in done for row in run.table).exit_code(strict=strict)


def observe(path: Path, output: Path, *, write_reflectance: Literal["envi", "cog"] | None = None) -> int:
    """Run the empirical pipeline alone and write what the collection says.

    Parameters
    ----------
    write_reflectance : write the cube after the empirical line as well, to ``reflectance/`` in the folder

    Raises
    ------
    UsageError : a reflectance cube is asked for and the collection has no empirical line.
    """
    job, notes = load_job(Path(path), predicts=False), list[str]()
    with whole_folder(output, beside=(one.path for one in job.files)) as folder:
        refuse(write_reflectance and job.campaign.collection.empirical_line is None, "campaign.line", path)

        def cube(observed: Observed) -> None:
            if observed.place is not None and write_reflectance:
                reflectance = folder / "reflectance", "reflectance", observed.place.cube, observed.place.line
                notes.append(reflectance_cube(*reflectance, write_reflectance)[1])

        run = run_campaign(job, predicts=False, with_observed=cube)
        with campaign_step(run.campaign, "report", predicts=False), working("figures and report"):
            write_outputs(replace(run, notes=[*run.notes, *notes]), folder)
    return 0

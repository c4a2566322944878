"""The command ``observe``: first what measures, then what writes, so that their memory does not add up."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hyperval.apart import call_apart
from hyperval.errors import UsageError
from hyperval.files import scratch_folder
from hyperval.folders import whole_folder
from hyperval.progress import step, working

if TYPE_CHECKING:
    from hyperval.observe import Observed
    from hyperval.report import RunReport

Form = Literal["envi", "cog"]


def observe(
    path: Path, output: Path, *, write_reflectance: Form | None = None, show_progress: bool | None = None
) -> int:
    """Run the empirical pipeline alone and write what the collection says.

    Parameters
    ----------
    write_reflectance : write the cube after the empirical line as well, to ``reflectance/`` in the folder

    Raises
    ------
    UsageError : a reflectance cube is asked for and the collection has no empirical line.
    """
    with whole_folder(output) as folder, scratch_folder("observed") as scratch:
        run = call_apart(partial(observed_report, Path(path), folder, write_reflectance, show_progress), scratch)
        from hyperval.report.outputs import write_outputs

        with step(run.campaign, 3, 3, "report"), working("figures and page", show=show_progress):
            write_outputs(run, folder)
    return 0


def observed_report(
    path: Path, folder: Path, write_reflectance: Form | None, show_progress: bool | None
) -> RunReport:
    """What a collection says; the cube after the empirical line is written into ``folder`` where it is asked for.

    Raises
    ------
    UsageError : as for :func:`observe`.
    """
    from hyperval.campaign.job import job_of
    from hyperval.campaign.one import run_campaign
    from hyperval.observe.reflectance_cube import write_reflectance as reflectance_cube

    job = job_of(path)
    if write_reflectance and job.campaign.collection.empirical_line is None:
        raise UsageError(
            "there is no empirical line that would make a reflectance cube",
            where=str(path),
            mend="add collection.empirical_line, or leave --write-reflectance out",
        )
    notes: list[str] = []

    def cube(observed: Observed) -> None:
        if observed.place is not None and write_reflectance:
            written = reflectance_cube(
                folder / "reflectance", "reflectance", observed.place.cube, observed.elm, write_reflectance,
                show_progress=show_progress,
            )  # fmt: skip
            notes.append(written[1])

    run = run_campaign(
        job, predicts=False, show_progress=show_progress, with_observed=cube if write_reflectance else None
    )
    return replace(run, notes=[*run.notes, *notes])

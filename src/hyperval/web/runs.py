"""Campaigns that can be run here, and runs: their state, results and files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends, Form, Query, Request
from pydantic import BaseModel, Field
from starlette.responses import FileResponse, JSONResponse, RedirectResponse, Response

from hyperval.config import Model, load_yaml, twice
from hyperval.errors import HypervalError
from hyperval.report.html import PICTURES, page_hashes
from hyperval.run import provenance_of
from hyperval.storage import sha256_of
from hyperval.web.forms import needs
from hyperval.web.pages import api, owner_of, page, pages, store_of
from hyperval.web.refusal import FieldMistake, Refusal, deny
from hyperval.web.store import COLLECTION, ENDED, EVERYBODY, ServerSettings, WebRun, view_name

_NAME = re.compile(r"(?:(?:figures|scores)/)?[A-Za-z0-9_-][A-Za-z0-9_.@+-]{0,120}")
_SOURCES = {"prediction": "scenario.yaml", "study": "study.yaml", "pipeline": "campaign.yaml"}


class RunAnswer(WebRun):
    """A run: how it stands, what came of it, names of its files."""

    owner: str = Field("", exclude=True)
    stage: str
    done: float = Field(description="part of the work that is done, 0-1")
    seconds_left: float | None
    files: list[str]


def answer_of(request: Request, run: WebRun) -> RunAnswer:
    """A run as the API tells of it."""
    store = store_of(request)
    return RunAnswer(**run.model_dump(), **store.progress(run), files=files_of(store.place(run.id), run))


def run_of(request: Request, run_id: str) -> WebRun:
    """A run of this session, refused as by :meth:`~hyperval.web.store.Runs.run`."""
    return store_of(request).run(run_id, owner_of(request))


OwnRun = Annotated[WebRun, Depends(run_of)]
Wait = Annotated[float, Query(ge=0, le=60, description="seconds, at most")]
Number = Annotated[int, Query(ge=0, lt=1_000_000)]


@pages.get("/runs")
def runs_page(request: Request) -> Response:
    """Every run of this session."""
    return page(request, "runs.html.j2", runs=store_of(request).visible_to(owner_of(request)))


@api.get("/runs")
def runs(request: Request) -> list[RunAnswer]:
    """Runs of this session, the latest first."""
    return [answer_of(request, run) for run in store_of(request).visible_to(owner_of(request))]


@api.get("/runs/{run_id}")
def run(request: Request, run_id: str, wait: Wait = 0.0) -> RunAnswer:
    """A run of this session; with ``wait`` once it has ended, or after so many seconds."""
    store_of(request).wait(run_of(request, run_id), wait)
    return answer_of(request, run_of(request, run_id))


@pages.get("/runs/{run_id}")
def run_page(request: Request, run: OwnRun, beside: str | None = None) -> Response:
    """A run: its numbers and charts, or how far it is."""
    store = store_of(request)
    other = run_of(request, beside) if beside else None
    others = [r for r in store.visible_to(run.owner, run.kind) if r.id != run.id and r.state == "finished"]
    files = files_of(store.place(run.id), run)
    figures = [name for name in files if name.startswith("figures/") and name.endswith((".svg", ".png"))]
    pictures = [name for name in (f"figures/{p}.png" for p in PICTURES) if name in figures]  # of the scene
    return page(
        request, "run.html.j2", run=run, maps=maps_of(store.place(run.id)), others=others[:50], other=other,
        progress=store.progress(run), ended=run.state in ENDED, is_own=run.owner != EVERYBODY,
        source=_SOURCES.get(run.kind, "") if run.owner != EVERYBODY else "", rows=_detection_rows(run, other),
        files=files, pictures=pictures, figures=[name for name in figures if name not in pictures],
    )  # fmt: skip


def _detection_rows(run: WebRun, other: WebRun | None) -> list[dict[str, Any]]:
    """Rows of P_D, with those of another run and the difference; not those of objects of one pixel."""
    key = itemgetter("subject", "detector", "pfa", "unit")
    earlier, current = (
        {key(row): row for row in (side.summary.get("detection", ()) if side else ())} for side in (other, run)
    )
    rows = []
    for name, row in current.items():
        if name[-1] == "object" and current.get((*name[:-1], "pixel"), {}).get("pd") == row["pd"]:
            continue
        before = earlier.get(name, {}).get("pd")
        difference = None if before is None or row["pd"] is None else row["pd"] - before
        rows.append({**row, "earlier": before, "difference": difference})
    return rows


def files_of(place: Path, run: WebRun) -> list[str]:
    """Names of the files that a run offers."""
    if run.state != "finished":
        return []
    if run.kind == "prediction":
        return ["results.csv", "products.nc", "results.json", "provenance.json", "report.html"]
    results = place / "results"
    paths = [p for p in sorted(results.rglob("*")) if p.is_file() and not p.name.startswith(".")]
    return [name for p in paths if _NAME.fullmatch(name := p.relative_to(results).as_posix())]


@api.get("/runs/{run_id}/charts", response_class=JSONResponse, response_model=None)
def charts(request: Request, run: OwnRun, beside: str | None = None) -> Response:
    """Charts of a prediction, beside another one where one is named: figures as stated for charts.js."""
    other = run_of(request, beside) if beside else None
    is_other = other is not None and (other.kind, other.state) != ("prediction", "finished")
    deny(run.kind != "prediction" or is_other, 409, "charts are of predictions that have finished")
    name, store = view_name(f"charts-{other.id}" if other else "charts"), store_of(request)
    return FileResponse(store.view(run, "draw", name, earlier=str(store.place(other.id)) if other else None))


@pages.get("/runs/{run_id}/files/{name:path}")
@api.get("/runs/{run_id}/files/{name:path}", response_class=Response, response_model=None)
def file(request: Request, run: OwnRun, name: str) -> Response:
    """A file of a run, such as results.csv, products.nc or scenario.yaml."""
    place = store_of(request).place(run.id)
    deny(not _NAME.fullmatch(name) or ".." in name, 404, "this run has no such file")
    path = place / name if name in _SOURCES.values() else place / "results" / name
    if path.parent != place and run.kind == "prediction":  # whose files are written when the first is asked for
        store_of(request).view(run, "files", "results/results.csv")
    # What a command wrote is reached by a link of the store's own; no other leads out of the run.
    is_own = any(path.resolve().is_relative_to(p.resolve()) for p in (place, place / "results"))
    deny(not path.is_file() or not is_own, 404, "this run has no such file")
    taken_as = "inline" if path.suffix in (".html", ".svg", ".png") else "attachment"
    saved_as, headers = f"{run.name.removeprefix('run:')}-{path.name}", dict[str, str]()
    if path.suffix == ".html":  # the page of a report has scripts of its own, and these alone
        headers["content-security-policy"] = (
            f"default-src 'none'; img-src data: 'self'; style-src 'unsafe-inline'; script-src {page_hashes()}; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
    return FileResponse(path, headers=headers, filename=saved_as, content_disposition_type=taken_as)


@pages.post("/runs/{run_id}/cancel")
def run_cancel(request: Request, run_id: str) -> Response:
    """Call a run off."""
    return RedirectResponse(f"/runs/{cancel(request, run_id).id}", status_code=303)


@api.post("/runs/{run_id}/cancel")
def cancel(request: Request, run_id: str) -> RunAnswer:
    """Call a run off."""
    store_of(request).cancel(run_of(request, run_id))
    return run(request, run_id, 5.0)


@pages.post("/runs/{run_id}/remove")
def run_remove(request: Request, run: OwnRun) -> Response:
    """Forget a run."""
    remove(request, run)
    return RedirectResponse("/runs", status_code=303)


@api.delete("/runs/{run_id}", status_code=204, response_model=None)
def remove(request: Request, run: OwnRun) -> None:
    """Forget a run of this session that has ended, and its files."""
    deny(run.state not in ENDED, 409, "it still runs: cancel it first")
    deny(run.owner == EVERYBODY, 409, "a command made it, for everybody: its folder is removed on the server")
    store_of(request).remove(run.id)


class CampaignAnswer(BaseModel):
    """A campaign that may be run; its file stays on the server."""

    name: str
    title: str
    description: str
    path: Path = Field(exclude=True)


class ValidationOrder(Model):
    """Which campaign to run."""

    campaign: str = Field(max_length=100, description="a name of /campaigns")


@api.get("/campaigns")
def campaigns(request: Request) -> list[CampaignAnswer]:
    """Campaigns of the server's folder, and those of this session."""
    return list(known_campaigns(request).values())


def known_campaigns(request: Request) -> dict[str, CampaignAnswer]:
    """Campaigns by name: those of the folder of campaigns, then those of this session."""
    out = {one.name: one for one in campaigns_of(request.app.state.settings)}
    store = store_of(request)
    for run in store.visible_to(owner_of(request), "pipeline"):
        path = store.place(run.id) / "campaign.yaml"
        if run.state == "finished" and path.is_file() and run.summary.get("compares", True):
            about = {"title": run.title or run.name, "description": "Brought by this session."}
            out[f"run:{run.id}"] = CampaignAnswer(name=f"run:{run.id}", **about, path=path)
    return out


def campaigns_of(settings: ServerSettings) -> Iterator[CampaignAnswer]:
    """The campaigns of a server's folder, those of one name by their files; a file is read again when it has changed.

    >>> from tempfile import mkdtemp
    >>> place = Path(mkdtemp())
    >>> for name in ("one", "two"):
    ...     _ = (place / name).mkdir(), (place / name / "campaign.yaml").write_text("name: copied")
    >>> [one.name for one in campaigns_of(ServerSettings(place, place))]
    ['one/campaign.yaml', 'two/campaign.yaml']
    """
    found, folder = list[CampaignAnswer](), settings.campaigns or Path()
    for path in sorted(folder.glob("*/campaign*.yaml")) if settings.campaigns is not None else ():
        with suppress(OSError):
            state = path.stat()
            found += _read(path, state.st_mtime_ns, state.st_size)
    several = twice(one.name for one in found)
    for one in found:
        file = one.path.relative_to(folder).as_posix()
        update = {"name": file, "title": f"{one.title} ({file})"} if one.name in several else {}
        yield one.model_copy(update=update)


@lru_cache(maxsize=256)
def _read(path: Path, changed: int, size: int) -> tuple[CampaignAnswer, ...]:
    """The campaign of a file, where it is one."""
    try:
        data = load_yaml(path)[0]
    except HypervalError:
        return ()
    name = str(data.get("name", path.parent.name))
    # A file of several runs has places that each fills in: {line}.
    title, description = (re.sub(r"\{\w+\}", "…", str(data.get(key, ""))) for key in ("title", "description"))
    return (CampaignAnswer(name=name, title=title or name, description=description, path=path),)


@pages.get("/validate")
def campaigns_page(request: Request) -> Response:
    """Campaigns with their verdicts over time."""
    runs = store_of(request).visible_to(owner_of(request), "validation")
    campaigns = known_campaigns(request)
    lacking = {name: needs(campaign.path.read_text("utf-8")) for name, campaign in campaigns.items()}
    has_folder = request.app.state.settings.campaigns is not None
    return page(request, "validate.html.j2", campaigns=campaigns, lacking=lacking, runs=runs, has_folder=has_folder)


@pages.post("/validate")
def campaign_run(request: Request, order: Annotated[ValidationOrder, Form()]) -> Response:
    """Run a campaign."""
    return RedirectResponse(f"/runs/{validations(request, order).id}", status_code=303)


@api.post("/validations", status_code=201)
def validations(request: Request, order: ValidationOrder) -> RunAnswer:
    """Run a campaign: predict, observe, compare."""
    found = known_campaigns(request).get(order.campaign)
    if found is None:
        raise Refusal(422, [FieldMistake("campaign", "this server has no campaign of that name")])
    run = store_of(request).order(owner_of(request), "validation", found.name, found.title, path=str(found.path))
    return answer_of(request, run)


def maps_of(place: Path) -> list[str]:
    """Names of the score maps of a run."""
    return sorted(path.stem for path in (place / "results" / "scores").glob("*.tif"))


@pages.get("/runs/{run_id}/map")
def map_page(request: Request, run: OwnRun, name: str | None = None) -> Response:
    """A score map with a threshold to move."""
    maps = maps_of(store_of(request).place(run.id))
    deny(not maps or name not in (None, *maps), 404, "this run has no such score map")
    return page(request, "map.html.j2", run=run, maps=maps, name=name or maps[0])


@pages.get("/runs/{run_id}/map.json")
def map_data(request: Request, run: OwnRun, name: str) -> Response:
    """A score map, 16 bits a pixel, with the measured curves that go with it."""
    deny(name not in maps_of(store_of(request).place(run.id)), 404, "this run has no such score map", "name")
    return FileResponse(store_of(request).view(run, "score_map", view_name(f"map-{name}"), name=name))


def campaign_of(request: Request, run: WebRun) -> Path:
    """The campaign of a run: the file that it has read; of several, or when that has changed, the one of its name."""
    read = {entry["sha256"] for entry in provenance_of(store_of(request).place(run.id) / "results").get("inputs", ())}
    rank = {c.path: (sha256_of(c.path) in read, c.name == run.name) for c in known_campaigns(request).values()}
    path = max(rank, key=rank.__getitem__, default=Path())
    deny(not any(rank.get(path, ())), 409, "this server has no campaign that this run has read, and none of its name")
    return path


@pages.get("/runs/{run_id}/pixel.json")
def pixel_data(request: Request, run: OwnRun, line: Number, sample: Number) -> Response:
    """The chart of a pixel's spectrum beside the predicted ones."""
    deny(run.kind != "validation", 409, "spectra of pixels stand beside predictions, which a validation has")
    path = campaign_of(request, run)
    arguments: dict[str, Any] = {"path": str(path), "line": line, "sample": sample}
    if "simulate" in (load_yaml(path)[0].get("collection") or {}):  # which goes when the campaign has run
        store_of(request).view(run, COLLECTION, COLLECTION, path=str(path))
    return FileResponse(store_of(request).view(run, "pixel", view_name(f"pixel-{line}-{sample}"), **arguments))

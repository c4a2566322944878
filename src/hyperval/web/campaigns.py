"""Campaigns of the server's folder, and those that a session brought: what there is, and running them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Query, Request
from starlette.responses import FileResponse, RedirectResponse, Response

from hyperval.config import load_yaml
from hyperval.errors import HypervalError
from hyperval.web.desk import Order
from hyperval.web.limits import Settings
from hyperval.web.pages import page, session_of
from hyperval.web.pages_runs import run_of
from hyperval.web.refusal import Mistake, Refused
from hyperval.web.store import COLLECTION, Run
from hyperval.web.views import view_name

router = APIRouter(include_in_schema=False)
_MAP = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,100}")


@dataclass(frozen=True)
class Known:
    """A campaign that may be run: its name, title and description, and its file, which stays on the server."""

    name: str
    title: str
    description: str
    path: Path


def known_campaigns(request: Request) -> dict[str, Known]:
    """Campaigns by name: those of the folder of campaigns, then those of this session."""
    out = {one.name: one for one in campaigns_of(request.app.state.settings)}
    store = request.app.state.store
    for run in store.runs(session_of(request).owner, "pipeline"):
        path = store.place(run.id) / "campaign.yaml"
        if run.state == "finished" and path.is_file():
            out[f"run:{run.id}"] = Known(f"run:{run.id}", run.title or run.name, "Brought by this session.", path)
    return out


def campaigns_of(settings: Settings) -> Iterator[Known]:
    """The campaigns of a server's folder; a file is read again when it has changed."""
    for path in sorted(settings.campaigns.glob("*/campaign*.yaml")) if settings.campaigns is not None else ():
        with suppress(OSError):
            state = path.stat()
            yield from _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=256)
def _read(path: Path, changed: int, size: int) -> tuple[Known, ...]:
    """The campaign of a file, where it is one."""
    try:
        data = load_yaml(path)[0]
    except HypervalError:
        return ()
    name = str(data.get("name", path.parent.name))
    # A file of several runs has places that each fills in: {line}.
    title, description = (re.sub(r"\{\w+\}", "…", str(data.get(key, ""))) for key in ("title", "description"))
    return (Known(name, title or name, description, path),)


@router.get("/validate")
def campaigns_page(request: Request) -> Response:
    """Campaigns with their verdicts over time."""
    runs = request.app.state.store.runs(session_of(request).owner, "validation")
    return page(request, "validate.html.j2", campaigns=known_campaigns(request), runs=runs)


@router.post("/validate")
async def campaign_run(request: Request) -> Response:
    """Run a campaign."""
    form = await request.form()
    name = form.get("campaign")
    run = order_campaign(request, name if isinstance(name, str) else "")
    return RedirectResponse(f"/runs/{run.id}", status_code=303)


def order_campaign(request: Request, name: str) -> Run:
    """Order the run of a campaign.

    Raises
    ------
    Refused : there is no such campaign, or no room.
    """
    known = known_campaigns(request).get(name)
    if known is None:
        raise Refused(422, [Mistake("campaign", "no campaign of this server goes by that name")])
    own = known.name if not known.name.startswith("run:") else "campaign"
    order = Order("validation", own, known.title, arguments={"path": str(known.path)})
    run: Run = request.app.state.desk.order(session_of(request).owner, order)
    return run


def maps_of(place: Path) -> list[str]:
    """Names of the score maps of a run."""
    folder = place / "results" / "scores"
    return sorted(p.stem for p in folder.glob("*.tif")) if folder.is_dir() else []


@router.get("/runs/{run_id}/map")
def map_page(request: Request, run_id: str, name: str | None = None) -> Response:
    """A score map with a threshold to move."""
    run = run_of(request, run_id)
    maps = maps_of(request.app.state.store.place(run.id))
    if not maps or (name is not None and name not in maps):
        raise Refused(404, "this run has no such score map")
    return page(request, "map.html.j2", run=run, maps=maps, name=name or maps[0])


@router.get("/runs/{run_id}/map.json")
def map_data(request: Request, run_id: str, name: str) -> Response:
    """A score map, 16 bits a pixel, with the measured curves that go with it."""
    run = run_of(request, run_id)
    if not _MAP.fullmatch(name) or name not in maps_of(request.app.state.store.place(run.id)):
        raise Refused(404, [Mistake("name", "this run has no such score map")])
    path = request.app.state.desk.view(run, "score_map", view_name(f"map-{name}"), name=name)
    return FileResponse(path, media_type="application/json")


@router.get("/runs/{run_id}/pixel.json")
def pixel_data(
    request: Request, run_id: str, line: int = Query(ge=0, lt=1_000_000), sample: int = Query(ge=0, lt=1_000_000)
) -> Response:
    """The chart of a pixel's spectrum beside the predicted ones."""
    run = run_of(request, run_id)
    if run.kind != "validation":
        raise Refused(409, "spectra of pixels stand beside predictions, which a validation has")
    known = next((k for k in known_campaigns(request).values() if run.name in (k.name, k.path.parent.name)), None)
    if known is None:
        raise Refused(409, "the campaign of this run is no longer there")
    arguments: dict[str, Any] = {"path": str(known.path), "line": line, "sample": sample}
    if "simulate" in (load_yaml(known.path)[0].get("collection") or {}):  # which goes when the campaign has run
        request.app.state.desk.view(run, COLLECTION, COLLECTION, path=str(known.path))
    path = request.app.state.desk.view(run, "pixel", view_name(f"pixel-{line}-{sample}"), **arguments)
    return FileResponse(path, media_type="application/json")

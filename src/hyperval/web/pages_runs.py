"""Pages of runs: how they stand, what came of them, files to take away."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fastapi import APIRouter, Request
from starlette.responses import FileResponse, JSONResponse, RedirectResponse, Response

from hyperval.config import load_yaml
from hyperval.report.html import PICTURES
from hyperval.report.scripts import script_hashes
from hyperval.web.inputs import link_text
from hyperval.web.pages import page, session_of
from hyperval.web.refusal import Refused
from hyperval.web.store import ENDED, Run
from hyperval.web.views import view_name

router = APIRouter(include_in_schema=False)
_NAME = re.compile(r"(?:(?:figures|scores)/)?[A-Za-z0-9][A-Za-z0-9_.@+-]{0,120}")
PACKED = "campaign.zip"
_OWN = {"scenario.yaml": "text/yaml", "study.yaml": "text/yaml", "campaign.yaml": "text/yaml"}
_TYPES = {
    ".csv": "text/csv", ".json": "application/json", ".nc": "application/x-netcdf", ".svg": "image/svg+xml",
    ".png": "image/png", ".tif": "image/tiff", ".html": "text/html", ".xml": "application/xml",
    ".parquet": "application/octet-stream",
}  # fmt: skip


def run_of(request: Request, run_id: str) -> Run:
    """A run of this session.

    Raises
    ------
    Refused : there is none by that name, or it is another session's.
    """
    try:
        run: Run = request.app.state.store.run(run_id, session_of(request).owner)
    except KeyError:
        raise Refused(404, "there is no such run in this session") from None
    return run


@router.get("/runs")
def runs_page(request: Request) -> Response:
    """Every run of this session."""
    return page(request, "runs.html.j2", runs=request.app.state.store.runs(session_of(request).owner))


@router.get("/runs/{run_id}")
def run_page(request: Request, run_id: str, beside: str | None = None) -> Response:
    """A run: its numbers and charts, or how far it is."""
    run = run_of(request, run_id)
    desk, store = request.app.state.desk, request.app.state.store
    other = run_of(request, beside) if beside else None
    others = [r for r in store.runs(run.owner, run.kind) if r.id != run.id and r.state == "finished"]
    link = ""
    if run.kind == "prediction":
        link = f"/result?s={_link(store.place(run.id) / 'scenario.yaml')}"
        if other is not None:
            link += f"&beside={_link(store.place(other.id) / 'scenario.yaml')}"
    rows = _beside(run, other) if run.kind == "prediction" and run.state == "finished" else []
    maps = (store.place(run.id) / "results" / "scores").is_dir()
    files = files_of(store.place(run.id), run)
    pictures, figures = figures_of(files)
    return page(
        request, "run.html.j2", run=run, maps=maps, progress=desk.progress(run), others=others[:50], other=other,
        link=link, rows=rows, ended=run.state in ENDED, source=_source(run),
        files=files, pictures=pictures, figures=figures,
    )  # fmt: skip


def figures_of(files: Sequence[str]) -> tuple[list[str], list[str]]:
    """Pictures of the scene with the first score maps, which stand beside each other, and all other figures."""
    figures = [name for name in files if name.startswith("figures/") and name.endswith((".svg", ".png"))]
    pictures = [name for name in (f"figures/{p}.png" for p in PICTURES) if name in figures]
    return pictures, [name for name in figures if name not in pictures]


@lru_cache(maxsize=1024)
def _link(path: Path) -> str:
    """The scenario of a run as a part of a link; it does not change."""
    return quote(link_text(load_yaml(path)[0]))


def _source(run: Run) -> str:
    return {"prediction": "scenario.yaml", "study": "study.yaml", "pipeline": "campaign.yaml"}.get(run.kind, "")


def _beside(run: Run, other: Run | None) -> list[dict[str, Any]]:
    """Rows of P_D, with those of another run and the difference."""

    def key(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["subject"], row["detector"], row["unit"], row["pfa"]

    earlier = {key(row): row for row in (other.summary.get("detection", ()) if other else ())}
    rows = []
    every = run.summary.get("detection", ())
    pixels = {(*key(row)[:2], row["pfa"]): row["pd"] for row in every if row["unit"] == "pixel"}
    for row in every:
        if row["unit"] == "object" and pixels.get((*key(row)[:2], row["pfa"])) == row["pd"]:
            continue  # objects of one pixel: nothing new
        before = earlier.get(key(row))
        known = before is not None and None not in (before["pd"], row["pd"])
        difference = row["pd"] - before["pd"] if known and before is not None else None
        rows.append({**row, "earlier": before["pd"] if before else None, "difference": difference})
    return rows


def files_of(place: Path, run: Run) -> list[str]:
    """Names of the files that a run offers."""
    if run.state != "finished":
        return []
    if run.kind == "prediction":
        return ["results.csv", "products.nc", "results.json", "provenance.json", "report.html"]
    results = place / "results"
    own = [PACKED] if run.kind == "pipeline" else []
    paths = [p for p in sorted(results.rglob("*")) if p.is_file() and not p.name.startswith(".")]
    return own + [name for p in paths if _NAME.fullmatch(name := p.relative_to(results).as_posix())]


@router.get("/runs/{run_id}/state")
def run_state(request: Request, run_id: str) -> Response:
    """How far a run is."""
    run = run_of(request, run_id)
    progress = request.app.state.desk.progress(run)
    return JSONResponse({"state": run.state, "reason": run.reason, "ended": run.state in ENDED, **progress})


@router.get("/runs/{run_id}/charts")
def run_charts(request: Request, run_id: str, beside: str | None = None) -> Response:
    """Charts of a prediction, beside another one where one is named."""
    run = run_of(request, run_id)
    other = run_of(request, beside) if beside else None
    if run.kind != "prediction" or (other and (other.kind, other.state) != ("prediction", "finished")):
        raise Refused(409, "charts are of predictions that have finished")
    desk, store = request.app.state.desk, request.app.state.store
    name = view_name(f"charts-{other.id}" if other else "charts")
    path = desk.view(run, "draw", name, earlier=str(store.place(other.id)) if other else None)
    return FileResponse(path, media_type="application/json")


@router.get("/runs/{run_id}/files/{name:path}")
def run_file(request: Request, run_id: str, name: str) -> Response:
    """A file of a run; those of a prediction are written when the first is asked for."""
    return file_of(request, run_of(request, run_id), name)


def file_of(request: Request, run: Run, name: str) -> Response:
    """A file of a run.

    Raises
    ------
    Refused : it has none of that name.
    """
    place = request.app.state.store.place(run.id)
    if not _NAME.fullmatch(name) or ".." in name:
        raise Refused(404, "this run has no such file")
    if name == PACKED and run.kind == "pipeline":
        path, kind = request.app.state.desk.view(run, "pack", PACKED), "application/zip"
    elif name in _OWN:
        path, kind = place / name, _OWN[name]
    else:
        if run.kind == "prediction":
            request.app.state.desk.view(run, "files", "results/results.csv")
        path, kind = place / "results" / name, _TYPES.get(Path(name).suffix, "application/octet-stream")
    if not path.is_file() or not path.resolve().is_relative_to(place.resolve()):
        raise Refused(404, "this run has no such file")
    shown = {".html", ".svg", ".png"} & {path.suffix}
    headers = {"content-disposition": f'{"inline" if shown else "attachment"}; filename="{run.name}-{path.name}"'}
    if path.suffix == ".html":  # the page of a report has scripts of its own, and these alone
        headers["content-security-policy"] = (
            f"default-src 'none'; img-src data: 'self'; style-src 'unsafe-inline'; script-src {script_hashes()}; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
    return FileResponse(path, media_type=kind, headers=headers)


@router.post("/runs/{run_id}/cancel")
def run_cancel(request: Request, run_id: str) -> Response:
    """Call a run off."""
    request.app.state.desk.cancel(run_of(request, run_id).id)
    return RedirectResponse(f"/runs/{run_id}", status_code=303)


@router.post("/runs/{run_id}/remove")
def run_remove(request: Request, run_id: str) -> Response:
    """Forget a run."""
    run = run_of(request, run_id)
    if run.state not in ENDED:
        raise Refused(409, "it still runs: cancel it first")
    request.app.state.store.remove(run.id)
    return RedirectResponse("/runs", status_code=303)

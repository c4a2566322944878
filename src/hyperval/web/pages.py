"""Templates with what every page shows, the reference of the JSON API (version 1), and the sensors."""

from __future__ import annotations

from collections.abc import AsyncIterator
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Request
from pydantic import BaseModel
from starlette.datastructures import FormData
from starlette.responses import FileResponse, HTMLResponse, Response

import hyperval
from hyperval.errors import package_table
from hyperval.report.html import CHARTS, LIBRARY, strict_templates
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.sensor_check import SensorNumber, numbers
from hyperval.storage import installed_file
from hyperval.web.refusal import FieldMistake, deny
from hyperval.web.store import Runs


class Mistakes(BaseModel):
    """Why a request was not carried out: each mistake with the dotted path of its field, empty for the whole."""

    errors: list[FieldMistake]


_REFUSALS = package_table("web/answers.yaml")["refusals"].items()
_PROBLEMS: dict[int | str, dict[str, Any]] = {c: {"model": Mistakes, "description": words} for c, words in _REFUSALS}
pages = APIRouter(include_in_schema=False)
api = APIRouter(prefix="/api/v1", tags=["v1"], responses=_PROBLEMS)
TEMPLATES = strict_templates("hyperval.web")
TEMPLATES.auto_reload = False  # what a server began with stays, whatever is installed beneath it
TEMPLATES.filters["p"] = lambda value: "" if value is None else f"{value:.4f}"
TEMPLATES.filters["since"] = lambda value: f"{datetime.fromtimestamp(value, UTC):%Y-%m-%d %H:%M:%S} UTC"
_STATIC = {file.name: file for file in installed_file("hyperval.web", "static").iterdir()}
_STATIC |= {name: installed_file("hyperval.report", "templates", name) for name in ("style.css", "page.js")}
_DRAWING = zip(("bokeh.js", "bokeh-api.js", "charts.js"), (*LIBRARY, CHARTS), strict=True)
_STATIC |= {name: installed_file(*place) for name, place in _DRAWING}


def owner_of(request: Request) -> str:
    """Whose request it is: what the session's runs are stored under."""
    return str(request.scope["owner"])


def store_of(request: Request) -> Runs:
    """The runs of the server that was asked."""
    runs: Runs = request.app.state.runs
    return runs


async def sent_form(request: Request) -> AsyncIterator[FormData]:
    """The fields and files of a request, until it is answered."""
    async with request.form(max_files=20, max_fields=4000) as form:
        yield form


SentForm = Annotated[FormData, Depends(sent_form)]


def page(request: Request, template: str, /, status: int = 200, **content: Any) -> HTMLResponse:
    """A page of the application; one that shows mistakes of a form bears the status of a refusal."""
    every = {"version": hyperval.__version__, "notices": store_of(request).notices, "place": request.url.path}
    text = TEMPLATES.get_template(template).render(every, **content)
    headers = {"cache-control": "private"} if request.method == "POST" else None  # else no way leads back to it
    return HTMLResponse(text, 422 if content.get("errors") else status, headers)


@pages.get("/static/{name}")
def static(name: str) -> Response:
    """A script, style or picture of the application, or of the packages that it draws with."""
    deny(name not in _STATIC, 404, "there is no such file")
    return FileResponse(_STATIC[name], headers={"cache-control": "public, max-age=3600"})


@pages.get("/{kind}.schema.json")
def schema(kind: Literal["campaign", "scenario", "study"]) -> Response:
    """The schema that the first line of a file names, by which editors complete and check it."""
    return FileResponse(installed_file("hyperval", "schemas", f"{kind}.json"), filename=f"{kind}.schema.json")


@pages.get("/docs")
def reference(request: Request) -> Response:
    """Every operation of the API: what it takes, what it answers."""
    described, address = request.app.openapi(), str(request.base_url).rstrip("/")
    return page(request, "docs.html.j2", described=described, address=address, refusals=_PROBLEMS)


@pages.get("/sensors")
def sensors_page(request: Request) -> Response:
    """The sensors of the library."""
    sensors = {name: load_sensor(name).specification for name in library_names()}
    return page(request, "sensors.html.j2", sensors=sensors)


@api.get("/sensors")
def sensors() -> list[str]:
    """Names of the sensors of the library."""
    return list(library_names())


@pages.get("/sensors/{name}")
def sensor_page(request: Request, name: str) -> Response:
    """A sensor of the library: every number with its unit and source."""
    return page(request, "sensor.html.j2", numbers=sensor(name), sensor=load_sensor(name).specification)


@api.get("/sensors/{name}")
def sensor(name: str) -> list[SensorNumber]:
    """Every number of a sensor of the library."""
    deny(name not in library_names(), 404, "the library has no such sensor", "name")
    return numbers(load_sensor(name).specification)

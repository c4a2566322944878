"""What there is to look up: the API, made from its OpenAPI file, and sensors number by number with their sources."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from fastapi import Request
from starlette.responses import Response

from hyperval.config import schema_text
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.sensor_check import SensorNumber, numbers
from hyperval.web.pages import api, page, pages
from hyperval.web.refusal import FieldMistake, Refused


@pages.get("/{kind}.schema.json")
def schema(kind: Literal["campaign", "scenario", "study"]) -> Response:
    """The schema that the first line of a file names, by which editors complete and check it."""
    headers = {"content-disposition": f'attachment; filename="{kind}.schema.json"'}
    return Response(schema_text(kind), media_type="application/json", headers=headers)


@pages.get("/docs")
def reference(request: Request) -> Response:
    """Every operation of the API: what it takes, what it answers."""
    described = request.app.openapi()
    address = str(request.base_url).rstrip("/")
    refusals = {code: about["description"] for code, about in api.responses.items()}
    return page(request, "docs.html.j2", operations=list(_operations(described)), address=address, refusals=refusals)


def _operations(described: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    schemas = described.get("components", {}).get("schemas", {})
    for path, methods in described["paths"].items():
        for method, operation in methods.items():
            contents = list(operation.get("requestBody", {}).get("content", {}).values())
            body: dict[str, Any] = contents[0]["schema"] if contents else {}
            name = body.get("$ref", "").rsplit("/", 1)[-1]
            fields: dict[str, Any] = dict(schemas.get(name, body).get("properties", ()))
            yield {
                "method": method.upper(),
                "path": path,
                "summary": (operation.get("description") or operation.get("summary", "")).replace("``", ""),
                "parameters": [(p["name"], p.get("description", "")) for p in operation.get("parameters", ())],
                "fields": [(key, value.get("description", "")) for key, value in fields.items()],
            }


@pages.get("/sensors")
def sensors_page(request: Request) -> Response:
    """The sensors of the library."""
    known = {name: load_sensor(name).specification for name in library_names()}
    return page(request, "sensors.html.j2", sensors=known)


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
    if name not in library_names():
        raise Refused(404, [FieldMistake("name", "the library has no such sensor")])
    return numbers(load_sensor(name).specification)

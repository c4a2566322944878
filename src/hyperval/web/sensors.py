"""Sensors number by number, each with the source that its file states."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi import Request
from pydantic import BaseModel
from starlette.responses import Response

from hyperval.sensor.specification import library_names, load_sensor
from hyperval.web.pages import api, page, pages
from hyperval.web.refusal import FieldMistake, Refused

_UNITS = {
    "_s": "s",
    "_um": "um",
    "_nm": "nm",
    "_percent": "%",
    "_electrons": "electrons",
    "_radiance": "uW cm-2 sr-1 nm-1",
}


class SensorNumber(BaseModel):
    """A number of a sensor file: its value in words, its unit, and the source that the file states."""

    name: str
    value: str
    unit: str
    source: str


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
    numbers = sensor(name)
    return page(request, "sensor.html.j2", sensor=load_sensor(name).specification, numbers=numbers)


@api.get("/sensors/{name}")
def sensor(name: str) -> list[SensorNumber]:
    """Every number of a sensor of the library."""
    if name not in library_names():
        raise Refused(404, [FieldMistake("name", "the library has no such sensor")])
    data = load_sensor(name).specification.model_dump(mode="json", exclude_none=True)
    return list(_numbers(data, "", ""))


def _numbers(data: dict[str, Any], at: str, source: str) -> Iterator[SensorNumber]:
    source = str(data.get("source", source))
    for name, value in data.items():
        path = f"{at}{name}"
        if name in ("source", "schema_version", "notes", "title", "name") or name.endswith("_source"):
            continue
        if isinstance(value, dict):
            yield from _numbers(value, f"{path}, ", source)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for number, item in enumerate(value):
                yield from _numbers(item, f"{item.get('name', f'{path} {number + 1}')}, ", source)
        elif value not in ([], ""):
            own = path.removesuffix(", value").removesuffix(", table")
            unit = next((unit for end, unit in _UNITS.items() if own.endswith(end)), "")
            said = str(data.get(f"{name}_source", source))
            yield SensorNumber(name=own.replace("_", " "), value=_shown(value), unit=unit, source=said)


def _shown(value: Any) -> str:
    if isinstance(value, list) and len(value) > 8:
        return f"{len(value)} rows: {_shown(value[0])} to {_shown(value[-1])}"
    if isinstance(value, list):
        return "(" + ", ".join(map(_shown, value)) + ")"
    return f"{value:g}" if isinstance(value, float) else str(value)

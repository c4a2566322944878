"""Sensors number by number, each with the source that its file states."""

from __future__ import annotations

from fastapi import Request
from starlette.responses import Response

from hyperval.sensor.specification import library_names, load_sensor
from hyperval.sensor_check import SensorNumber, numbers
from hyperval.web.pages import api, page, pages
from hyperval.web.refusal import FieldMistake, Refused


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

"""The start page and the form of a prediction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData
from starlette.responses import RedirectResponse, Response

from hyperval.config import load_yaml
from hyperval.sensor.specification import load_sensor
from hyperval.web.desk import Desk, Order
from hyperval.web.forms import MOST_ROWS, Node
from hyperval.web.inputs import checked_scenario, form_data, marked, needs, plain, predefined, scenario_form, yaml_text
from hyperval.web.pages import form_parts, page, session_of
from hyperval.web.refusal import FieldMistake, Refused, copies_of, files_of, to_show
from hyperval.web.runs import run_of
from hyperval.web.store import WebRun

router = APIRouter(include_in_schema=False)
_WAIT_S = 5.0
_FREE: dict[str, Any] = {
    "schema": 1,
    "name": "free",
    "sensor": "prospectir-vs",
    "atmosphere": {},
    "scene": {"classes": [], "targets": []},
}


def warm() -> None:
    """Load what the first page would wait for."""
    for scenario in predefined().values():
        needs(scenario)
        if scenario.sensor is not None:
            load_sensor(scenario.sensor)
        form_parts(scenario_form().nodes(plain(scenario)), {})


@router.get("/")
def start(request: Request) -> Response:
    """What can be done here, and what was done last."""
    runs = request.app.state.store.runs(session_of(request).owner)
    missing = {name: needs(scenario) for name, scenario in predefined().items()}
    return page(request, "start.html.j2", scenarios=predefined(), missing=missing, runs=runs[:8])


@router.get("/predict")
def predict_form(
    request: Request, scenario: str | None = None, s: str | None = None, run: str | None = None
) -> Response:
    """The form, filled in with a predefined scenario, or that of an earlier run."""
    if s is not None:
        words = "links hold no scenario any more: the scenario.yaml of a run stands in their place"
        raise Refused(410, [FieldMistake("s", words)])
    begun = f"run:{run}" if run is not None else scenario or "free"
    if begun == "free":
        return _form(request, _FREE)
    data = _first(request, begun)
    if data is None:
        raise Refused(404, [FieldMistake("scenario", "no scenario or prediction goes by that name")])
    return _form(request, data, begun)


@router.post("/predict")
async def predict_post(request: Request) -> Response:
    """Add or remove a row of the form, or run it."""
    form = await request.form(max_fields=4000)
    given = texts_of(form)
    if given.get("action", ["run"])[0] != "run":
        changed = with_action(given)
        return await run_in_threadpool(_form, request, form_data(scenario_form(), changed), given.get("begun", [""])[0])
    return await run_in_threadpool(_run, request, given)


def _run(request: Request, given: dict[str, list[str]]) -> Response:
    data: dict[str, Any] = {}
    try:
        data = form_data(scenario_form(), given)
        data.setdefault("schema", 1)
        run = order_prediction(request, data)
    except Refused as refusal:
        return _form(request, data, given.get("begun", [""])[0], to_show(refusal), 422)
    request.app.state.desk.wait(run.id, _WAIT_S)
    return RedirectResponse(f"/runs/{run.id}", status_code=303)


def order_prediction(request: Request, data: dict[str, Any]) -> WebRun:
    """Order the prediction of plain data.

    Raises
    ------
    Refused : what is wrong with it, or there is no room.
    """
    owner = session_of(request).owner
    desk: Desk = request.app.state.desk
    own = files_of(request.app.state.settings, owner)
    scenario = checked_scenario(data, desk.limits, own)
    text = yaml_text(plain(scenario))
    copies = copies_of(request.app.state.settings, owner, text, own)
    return desk.order(owner, Order("prediction", scenario.name, scenario.title, {"scenario.yaml": text}, copies))


def scenario_of(request: Request, run_id: str) -> dict[str, Any]:
    """The plain data of a prediction of this session.

    Raises
    ------
    Refused : there is none.
    """
    run = run_of(request, run_id)
    if run.kind != "prediction":
        raise Refused(404, "this run is no prediction")
    data: dict[str, Any] = load_yaml(request.app.state.store.place(run.id) / "scenario.yaml")[0]
    return data


def _first(request: Request, begun: str) -> dict[str, Any] | None:
    """What a form began with: a predefined scenario, or ``run:ID``; None where there is none (any more)."""
    if begun.startswith("run:"):
        with suppress(Refused):
            return scenario_of(request, begun[4:])
    return plain(predefined()[begun]) if begun in predefined() else None


def _form(
    request: Request, data: dict[str, Any], begun: str = "", mistakes: Sequence[FieldMistake] = (), status: int = 200
) -> Response:
    """The form, and what differs in it from the scenario that it began with."""
    settings, owner = request.app.state.settings, session_of(request).owner
    first = _first(request, begun)
    nodes = scenario_form().nodes(data, first, {"sensor": files_of(settings, owner, ["sensors"])})
    titles = {node.path: node.title for node in walk(nodes)} if mistakes else {}
    errors = marked(mistakes, titles)
    return page(
        request, "predict.html.j2", status=status, errors=errors, scenarios=predefined(),
        changes=sum(n.changes for n in nodes), parts=form_parts(nodes, errors, begun if first else ""),
        titles=titles, begun=begun if first else "", uploads=files_of(settings, owner, ["spectra"]),
    )  # fmt: skip


def walk(nodes: Sequence[Node]) -> Iterator[Node]:
    """Every part of a form."""
    for node in nodes:
        yield node
        yield from walk(node.children)


def texts_of(form: FormData) -> dict[str, list[str]]:
    """The fields of a form that hold text."""
    given: dict[str, list[str]] = {}
    for name, value in form.multi_items():
        if isinstance(value, str):
            given.setdefault(name, []).append(value)
    return given


def with_action(given: dict[str, list[str]]) -> dict[str, list[str]]:
    """The fields of a form, with a row more or less, as its button says."""
    action = given["action"][0]
    if action.startswith("add:"):
        name = f"{action[4:]}#"
        count = given.get(name, ["0"])[0]
        if name in given and count.isdecimal() and len(count) < 4 and int(count) < MOST_ROWS:
            return {**given, name: [str(int(count) + 1)]}
    elif action.startswith("remove:"):
        return {**given, f"{action[7:]}!": ["1"]}
    return given

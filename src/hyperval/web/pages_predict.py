"""The start page and the form of a prediction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from fastapi import Query, Request
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData
from starlette.responses import RedirectResponse, Response

from hyperval.config import load_yaml
from hyperval.errors import UsageError
from hyperval.scenario import Scenario
from hyperval.sensor.specification import load_sensor
from hyperval.settings import with_settings
from hyperval.web.dispatch import Desk
from hyperval.web.forms import (
    MOST_ROWS,
    SURFACES,
    Node,
    checked_scenario,
    form_data,
    marked,
    needs,
    plain,
    predefined,
    refuse_excess,
    scenario_form,
    yaml_text,
)
from hyperval.web.pages import api, form_parts, page, pages, session_of
from hyperval.web.refusal import FieldMistake, Refused, copies_of, files_of, mistakes_of, said, to_show
from hyperval.web.runs import RunAnswer, run, run_of
from hyperval.web.store import WebRun

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


@pages.get("/")
def start(request: Request) -> Response:
    """What can be done here, and what was done last."""
    runs = request.app.state.store.runs(session_of(request).owner)
    missing = {name: needs(scenario) for name, scenario in predefined().items()}
    return page(request, "start.html.j2", scenarios=predefined(), missing=missing, runs=runs[:8])


@pages.get("/predict")
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
        raise Refused(404, [FieldMistake("scenario", "no scenario or prediction has that name")])
    return _form(request, data, begun)


@pages.post("/predict")
async def predict_post(request: Request) -> Response:
    """Add or remove a row of the form, or run it."""
    form = await request.form(max_fields=4000)
    given = texts_of(form)
    if given.get("action", ["run"])[0] != "run":
        changed = with_action(given)
        return await run_in_threadpool(_form, request, form_data(changed), given.get("begun", [""])[0])
    return await run_in_threadpool(_run, request, given)


def _run(request: Request, given: dict[str, list[str]]) -> Response:
    data: dict[str, Any] = {}
    try:
        data = form_data(given)
        data.setdefault("schema", 1)
        ordered = order_prediction(request, data)
    except Refused as refusal:
        return _form(request, data, given.get("begun", [""])[0], to_show(refusal), 422)
    request.app.state.desk.wait(ordered.id, _WAIT_S)
    return RedirectResponse(f"/runs/{ordered.id}", status_code=303)


def order_prediction(request: Request, data: dict[str, Any]) -> WebRun:
    """Order the prediction of plain data.

    Raises
    ------
    Refused : what is wrong with it, or there is no room.
    """
    owner = session_of(request).owner
    desk: Desk = request.app.state.desk
    own = files_of(request.app.state.settings, owner)
    scenario = checked_scenario(data, own)
    text = yaml_text("scenario", plain(scenario))
    files: dict[str, str | Path] = {"scenario.yaml": text, **copies_of(request.app.state.settings, owner, text, own)}
    return desk.order(owner, "prediction", scenario.name, scenario.title, files)


def scenario_of(request: Request, run_id: str) -> dict[str, Any]:
    """The plain data of a prediction of this session.

    Raises
    ------
    Refused : there is none.
    """
    if run_of(request, run_id).kind != "prediction":
        raise Refused(404, "this run is not a prediction")
    data: dict[str, Any] = load_yaml(request.app.state.store.place(run_id) / "scenario.yaml")[0]
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


Setting = float | str | bool | list[Any] | None


def small(at: str) -> BeforeValidator:
    """Looks at the size of an entry of a body before its parts are checked one by one."""

    def bounded(data: Any) -> Any:
        refuse_excess(data, at)
        return data

    return BeforeValidator(bounded)


class PredictionOrder(BaseModel):
    """What to predict: a predefined scenario by name, or a scenario, and entries in which it is to differ."""

    model_config = ConfigDict(extra="forbid")
    name: str | None = Field(None, max_length=100, description="a predefined scenario")
    scenario: Annotated[Scenario | None, small("scenario")] = Field(None, description="in place of the name")
    settings: Annotated[dict[str, Setting], small("")] = Field(
        default_factory=dict, max_length=100, description="dotted path: value"
    )


class ScenarioAnswer(BaseModel):
    """A predefined scenario."""

    name: str
    title: str
    description: str
    needs: str = Field(description="data sets that this server lacks for it; empty where it runs")
    scenario: dict[str, Any]


@api.get("/surfaces")
def surfaces() -> list[str]:
    """Names of the surfaces that are built in."""
    return list(SURFACES)


@api.get("/scenarios")
def scenarios() -> list[ScenarioAnswer]:
    """The predefined scenarios."""
    return [
        ScenarioAnswer(name=n, title=s.title, description=s.description, needs=", ".join(needs(s)), scenario=plain(s))
        for n, s in predefined().items()
    ]


@api.post("/predictions", status_code=201)
def predictions(
    request: Request, order: PredictionOrder, wait: float = Query(10.0, ge=0, le=60, description="seconds, at most")
) -> RunAnswer:
    """Predict a scenario, and wait for the numbers."""
    return run(request, order_prediction(request, _scenario_of(order)).id, wait)


def _scenario_of(order: PredictionOrder) -> dict[str, Any]:
    if (order.name is None) == (order.scenario is None):
        raise Refused(422, [FieldMistake("name", "give either name or scenario")])
    if order.scenario is not None:
        scenario = order.scenario
    elif order.name in predefined():
        scenario = predefined()[order.name]
    else:
        raise Refused(422, [FieldMistake("name", f"no predefined scenario; one of {', '.join(predefined())}")])
    try:
        return plain(with_settings(scenario, order.settings) if order.settings else scenario)
    except UsageError as error:
        cause = error.__cause__
        if isinstance(cause, ValidationError):
            raise Refused(422, mistakes_of(cause, plain(scenario))) from error
        raise Refused(422, [FieldMistake("settings", said(error)[:500])]) from error

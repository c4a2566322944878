"""The start page and the form of a prediction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData
from starlette.responses import RedirectResponse, Response

from hyperval.sensor.specification import load_sensor
from hyperval.web.desk import Desk, Order
from hyperval.web.forms import MOST_ROWS, Node
from hyperval.web.inputs import checked_scenario, form_data, marked, needs, plain, predefined, scenario_form, yaml_text
from hyperval.web.pages import form_parts, page, session_of
from hyperval.web.refusal import FieldMistake, Refused, copies_of, files_of, to_show
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
    for name, scenario in predefined().items():
        needs(scenario)
        if scenario.sensor is not None:
            load_sensor(scenario.sensor)
        form_parts(_nodes(_named(name), ()), {}, _named(name).source)


@router.get("/")
def start(request: Request) -> Response:
    """What can be done here, and what was done last."""
    runs = request.app.state.store.runs(session_of(request).owner)
    missing = {name: needs(scenario) for name, scenario in predefined().items()}
    return page(request, "start.html.j2", scenarios=predefined(), missing=missing, runs=runs[:8])


@dataclass(frozen=True)
class FormContent:
    """What a form is filled with: the data, and the words and data of what it began with."""

    data: dict[str, Any]
    source: str = ""
    begun: dict[str, Any] = field(default_factory=dict)


@router.get("/predict")
def predict_form(
    request: Request, scenario: str | None = None, s: str | None = None, run: str | None = None
) -> Response:
    """The form, filled in with a predefined scenario, or that of an earlier run."""
    if s is not None:
        words = "links hold no scenario any more: the scenario.yaml of a run stands in their place"
        raise Refused(410, [FieldMistake("s", words)])
    return _form(request, _named(scenario) if run is None else _begun(scenario_of(request, run), "as in the run"))


def _named(scenario: str | None) -> FormContent:
    if scenario in predefined():
        return _begun(plain(predefined()[scenario]), f"as in {scenario}")
    if scenario is None or scenario == "free":
        return _begun(_FREE, "to start with")
    raise Refused(404, [FieldMistake("scenario", "no predefined scenario goes by that name")])


def _begun(data: dict[str, Any], words: str) -> FormContent:
    return FormContent(data, words, data)


@router.post("/predict")
async def predict_post(request: Request) -> Response:
    """Add or remove a row of the form, or run it."""
    form = await request.form(max_fields=4000)
    given = texts_of(form)
    if given.get("action", ["run"])[0] != "run":
        return await run_in_threadpool(_changed, request, with_action(given))
    return await run_in_threadpool(_run, request, given)


def _content_of(given: dict[str, list[str]], data: dict[str, Any]) -> FormContent:
    """What a form that was sent holds, with what it began with where that has a name."""
    name = given.get("begun", [""])[0]
    begun = _named(name) if name in predefined() else FormContent({})
    return FormContent(data, begun.source, begun.data)


def _changed(request: Request, given: dict[str, list[str]]) -> Response:
    return _form(request, _content_of(given, form_data(scenario_form(), given)))


def _run(request: Request, given: dict[str, list[str]]) -> Response:
    data: dict[str, Any] = {}
    try:
        data = form_data(scenario_form(), given)
        data.setdefault("schema", 1)
        run = order_prediction(request, data)
    except Refused as refusal:
        return _form(request, _content_of(given, data), to_show(refusal), 422)
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
    from hyperval.config import load_yaml

    store = request.app.state.store
    try:
        run = store.run(run_id, session_of(request).owner)
    except KeyError:
        raise Refused(404, "there is no such run in this session") from None
    if run.kind != "prediction":
        raise Refused(404, "this run is no prediction")
    data: dict[str, Any] = load_yaml(store.place(run.id) / "scenario.yaml")[0]
    return data


def _form(request: Request, content: FormContent, mistakes: Sequence[FieldMistake] = (), status: int = 200) -> Response:
    settings, owner = request.app.state.settings, session_of(request).owner
    sensors = files_of(settings, owner, ["sensors"])
    nodes = _nodes(content, sensors)
    titles = {node.path: node.title for node in walk(nodes)} if mistakes else {}
    errors = marked(mistakes, titles)
    return page(
        request, "predict.html.j2", status=status, errors=errors, scenarios=predefined(),
        changes=sum(n.changes for n in nodes),
        parts=form_parts(nodes, errors, content.source, _total(content.data)),
        titles=titles, begun=content.source.removeprefix("as in "), uploads=files_of(settings, owner, ["spectra"]),
    )  # fmt: skip


def _nodes(content: FormContent, sensors: tuple[str, ...]) -> tuple[Node, ...]:
    return scenario_form().nodes(content.data, content.begun, {"sensor": sensors})


def _total(data: dict[str, Any]) -> str:
    """The sum of the fractions."""
    classes = (data.get("scene") or {}).get("classes") or []
    fractions = [c.get("fraction") for c in classes if isinstance(c, dict)]
    return f"{sum(f for f in fractions if isinstance(f, int | float)):g}"


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

"""Trade-off studies: the form of the schema of studies, what is refused beforehand, the order."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

from fastapi import APIRouter, Request
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from hyperval.errors import UsageError
from hyperval.model import in_file
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.study.schema import Input, Required, StudyFile
from hyperval.web.desk import Order
from hyperval.web.forms import Form
from hyperval.web.inputs import checked_scenario, form_data, marked, plain, predefined, yaml_text
from hyperval.web.pages import form_parts, page, session_of
from hyperval.web.pages_predict import scenario_of, texts_of, walk, with_action
from hyperval.web.refusal import FieldMistake, Refused, copies_of, files_of, mistakes_of, said, to_show
from hyperval.web.store import Limits, WebRun

router = APIRouter(include_in_schema=False)
_LEFT_OUT = re.compile(r"schema|references|atmosphere")
_MOST_STATES = 40
_SETTABLE = ("atmosphere", "sensor_changes", "sensor_operation", "scene", "processing")
_FIRST: dict[str, Any] = {
    "schema": 1,
    "name": "fill",
    "title": "Detection against fill",
    "scenario": "yellow-planks-asphalt",
    "inputs": [
        {
            "name": "fill",
            "label": "fill",
            "path": "scene.targets.[yellow plank].subjects.0.fill.fixed",
            "grid": {"start": 0.005, "stop": 0.1, "count": 20},
        }
    ],
    "outputs": [{"name": "pd", "label": "P_D at P_FA 1e-3", "kind": "pd", "subject": "yellow plank 0.02", "pfa": 1e-3}],
    "plots": [{"kind": "lines", "x": "fill", "output": "pd"}],
}


@lru_cache(maxsize=1)
def study_form() -> Form:
    """The form of a study."""
    return Form(StudyFile, left_out=lambda path: _LEFT_OUT.fullmatch(path) is not None)


@router.get("/trade")
def trade(request: Request) -> Response:
    """The form, filled in with a study that runs as it stands."""
    return _page(request, _FIRST)


@router.post("/trade")
async def trade_post(request: Request) -> Response:
    """Add or remove a row, or run the study."""
    given = texts_of(await request.form(max_fields=4000))
    if given.get("action", ["run"])[0] != "run":
        return await run_in_threadpool(lambda: _page(request, form_data(study_form(), with_action(given))))
    return await run_in_threadpool(_run, request, given)


def _run(request: Request, given: dict[str, list[str]]) -> Response:
    data: dict[str, Any] = {}
    try:
        data = form_data(study_form(), given)
        run = order_study(request, {"schema": 1, **data})
    except Refused as refusal:
        return _page(request, data, to_show(refusal), 422)
    return RedirectResponse(f"/runs/{run.id}", status_code=303)


def _page(
    request: Request, data: dict[str, Any], mistakes: list[FieldMistake] | None = None, status: int = 200
) -> Response:
    nodes = study_form().nodes(data, _FIRST)
    titles = {node.path: node.title for node in walk(nodes)}
    errors = marked(mistakes or [], titles)
    runs = request.app.state.store.runs(session_of(request).owner, "prediction")
    return page(
        request, "trade.html.j2", status=status, parts=form_parts(nodes, errors, "to start with"), errors=errors,
        scenarios=predefined(), runs=runs[:20], titles=titles,
        most=request.app.state.settings.limits.points,
    )  # fmt: skip


def order_study(request: Request, data: Mapping[str, Any]) -> WebRun:
    """Order a study of a predefined scenario, or of the scenario of a run of this session (``run:ID``).

    Raises
    ------
    Refused : what is wrong with it, or there is no room.
    """
    owner, state = session_of(request).owner, request.app.state
    limits: Limits = state.settings.limits
    try:
        study = StudyFile.model_validate(data)
    except ValidationError as error:
        raise Refused(422, mistakes_of(error, data)) from error
    uploads = files_of(state.settings, owner)
    name = study.scenario
    if name.startswith("run:"):
        scenario = checked_scenario(scenario_of(request, name[4:]), limits, uploads)
    elif name in predefined():
        scenario = predefined()[name]
    else:
        raise Refused(
            422, [FieldMistake("scenario", f"one of {', '.join(predefined())}, or run: and the name of a run")]
        )
    mistakes = [*_of_size(study, limits), *_of_paths(study, scenario)]
    if mistakes:
        raise Refused(422, mistakes)
    text = yaml_text(plain(scenario))
    own = study.model_dump(mode="json", by_alias=True, exclude_unset=True) | {"scenario": "scenario.yaml"}
    order = Order(
        "study", study.name, study.title, {"study.yaml": yaml_text(own), "scenario.yaml": text},
        copies_of(state.settings, owner, text, uploads),
    )  # fmt: skip
    run: WebRun = state.desk.order(owner, order)
    return run


def _of_size(study: StudyFile, limits: Limits) -> Iterator[FieldMistake]:
    states = 1
    for item in study.inputs:
        if any(m.path.startswith("atmosphere.") for m in item.targets):
            states *= item.size if item.random is None else 7
    points = study.count * (1 + sum(q.scan + 40 for q in study.required) // 4)
    if points > limits.points:
        yield FieldMistake("inputs", f"{points:,} evaluations; this server takes at most {limits.points:,}")
    if states > _MOST_STATES:
        yield FieldMistake("inputs", f"{states} states of the atmosphere; this server takes at most {_MOST_STATES}")


def _of_paths(study: StudyFile, scenario: Scenario) -> Iterator[FieldMistake]:
    """Paths that lead nowhere, and values that cannot stand there."""
    items: list[tuple[str, Input | Required]] = [(f"inputs.{i}", item) for i, item in enumerate(study.inputs)]
    items += [(f"required.{i}", item) for i, item in enumerate(study.required)]
    for at, item in items:
        first: Any = None
        if isinstance(item, Required):
            first = item.between[0]
        elif item.values or item.grid:
            first = item.values[0] if item.values else item.grid.start if item.grid else None
        for move in item.targets:
            is_entry = in_file(move.path) and move.path.partition(".")[0] in Scenario.model_fields
            if not is_entry or first is None or isinstance(first, list):
                continue
            value = move.offset + move.factor * first if isinstance(first, int | float) else first
            try:
                with_settings(scenario, {move.path: value})
            except UsageError as error:
                yield FieldMistake(f"{at}.path", said(error)[:400])
    for path in study.settings:
        if path.partition(".")[0] not in _SETTABLE:
            yield FieldMistake("settings", f"{path!r} is not set from here")

"""The start page, the form of a prediction, and the trade desk.

The desk keeps nothing: its question stands in the address, and workers keep the scenarios they have read.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import groupby
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import Request
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from starlette.datastructures import FormData, QueryParams
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse

from hyperval.config import Model
from hyperval.data import LINEAR_DETECTORS
from hyperval.errors import UsageError
from hyperval.model import is_in_file
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.sensor.specification import load_sensor
from hyperval.settings import with_settings
from hyperval.study.plan import MAX_TRIED, plan_states, point_values, values_to_try
from hyperval.study.schema import StudyFile
from hyperval.study.trade import KINDS, Progress, Setup, Trade, complete, notebook, prepare, trade_study
from hyperval.web.forms import (
    MAX_ROWS,
    SCENES,
    FormNode,
    by_field,
    check_size,
    checked_scenario,
    dump,
    form_data,
    form_nodes,
    needs,
    predefined,
    yaml_text,
)
from hyperval.web.pages import TEMPLATES, SentForm, api, owner_of, page, pages, store_of
from hyperval.web.refusal import FieldMistake, Refusal, deny, error_text, form_mistakes, mistakes_of
from hyperval.web.runs import RunAnswer, Wait, answer_of, run, run_of
from hyperval.web.store import Files, WebRun
from hyperval.web.uploads import Uploads

_FREE: dict[str, Any] = {"schema": 1, "name": "free", "sensor": "prospectir-vs", "atmosphere": {}, "scene": {}}


def warm() -> None:
    """Load what the first page would wait for."""
    for scenario in predefined().values():
        needs(scenario)
        if scenario.sensor is not None:
            load_sensor(scenario.sensor)
        form_nodes(dump(scenario))
    for name in TEMPLATES.list_templates():
        TEMPLATES.get_template(name)


@pages.get("/")
def start(request: Request) -> Response:
    """What can be done here, and what was done last."""
    runs = store_of(request).visible_to(owner_of(request))
    missing = {name: needs(scenario) for name, scenario in predefined().items()}
    return page(request, "start.html.j2", scenarios=predefined(), missing=missing, runs=runs[:8])


@pages.get("/predict")
def predict_form(request: Request, scenario: str | None = None, run: str | None = None) -> Response:
    """The form, filled in with a predefined scenario, or that of an earlier run."""
    begun = f"run:{run}" if run is not None else scenario or "free"
    data = _FREE if begun == "free" else _initial_data(request, begun)
    if data is None:
        raise Refusal(404, [FieldMistake("scenario", "no scenario or prediction has that name")])
    return _form(request, data, begun)


@pages.post("/predict")
def predict_post(request: Request, form: SentForm) -> Response:
    """Add or remove a row of the form, or run it."""
    fields = {name: [text for text in form.getlist(name) if isinstance(text, str)] for name in form}
    begun = fields.get("begun", [""])[0]
    if fields.get("action", ["run"])[0] != "run":
        return _form(request, form_data(apply_action(fields)), begun)
    data = {"schema": 1} | form_data(fields)
    try:
        ordered = order_prediction(request, data)
    except Refusal as refusal:
        return _form(request, data, begun, form_mistakes(refusal))
    store_of(request).wait(ordered, seconds=5.0)
    return RedirectResponse(f"/runs/{ordered.id}", status_code=303)


def order_prediction(request: Request, data: dict[str, Any]) -> WebRun:
    """Order the prediction of plain data.

    Raises
    ------
    Refusal : what is wrong with it, or there is no room.
    """
    uploads = Uploads(request)
    scenario = checked_scenario(data, uploads.names())
    text = yaml_text("scenario", dump(scenario))
    files: Files = {"scenario.yaml": text, **uploads.copies(text)}
    return store_of(request).order(uploads.owner, "prediction", scenario.name, scenario.title, files)


def _file(request: Request, name: str) -> str:
    """A scenario as workers read it: its name, or its file; ``run:ID`` is that of a prediction of this session."""
    if name.startswith("run:"):
        deny(run_of(request, name[4:]).kind != "prediction", 404, "this run is not a prediction")
        return str(store_of(request).place(name[4:]) / "scenario.yaml")
    deny(name not in predefined(), 422, "no scenario has that name", "scenario")
    return str(SCENES.get(name, name))


def _initial_data(request: Request, begun: str) -> dict[str, Any] | None:
    """What a form began with; None where it is there no more."""
    with suppress(Refusal):
        return dump(load_scenario(_file(request, begun)))
    return None


def _form(request: Request, data: dict[str, Any], begun: str = "", mistakes: Sequence[FieldMistake] = ()) -> Response:
    """The form, and what differs in it from the scenario that it began with."""
    uploads, first = Uploads(request), _initial_data(request, begun)
    begun = begun if first else ""
    nodes = form_nodes(data, first, uploads.names("sensors"))
    titles = {node.path: node.title for node in walk(nodes)} if mistakes else {}
    errors = by_field(mistakes, titles)
    holding = {path.rsplit(".", n)[0] for path in errors for n in range(path.count(".") + 1)}  # which stand open
    return page(
        request, "predict.html.j2", errors=errors, holding=holding, scenarios=predefined(),
        changes=sum(n.changes for n in nodes), nodes=nodes,
        titles=titles, begun=begun, uploads=uploads.names("spectra"),
    )  # fmt: skip


def walk(nodes: Sequence[FormNode]) -> Iterator[FormNode]:
    """Every part of a form."""
    for node in nodes:
        yield node
        yield from walk(node.children)


def apply_action(fields: dict[str, list[str]]) -> dict[str, list[str]]:
    """The fields of a form, with a row more or less, as its button says."""
    verb, _, path = fields["action"][0].partition(":")
    count = fields.get(f"{path}#", [""])[0]
    if verb == "add" and count.isdecimal() and len(count) < 4 and int(count) < MAX_ROWS:
        return {**fields, f"{path}#": [str(int(count) + 1)]}
    return {**fields, f"{path}!": ["1"]} if verb == "remove" else fields


Setting = float | str | bool | list[Any] | None


def max_size(field: str) -> BeforeValidator:
    """Bounds the size of an entry of a body before its parts are validated."""
    return BeforeValidator(partial(check_size, field=field))


class PredictionOrder(BaseModel):
    """What to predict: a predefined scenario by name, or a scenario, and entries in which it is to differ."""

    model_config = ConfigDict(extra="forbid")
    name: str | None = Field(None, max_length=100, description="a predefined scenario")
    scenario: Annotated[Scenario | None, max_size("scenario")] = Field(None, description="in place of the name")
    settings: Annotated[dict[str, Setting], max_size("")] = Field({}, max_length=100, description="dotted path: value")


class ScenarioAnswer(BaseModel):
    """A predefined scenario."""

    name: str
    title: str
    description: str
    needs: str = Field(description="data sets that this server lacks for it; empty where it runs")
    scenario: dict[str, Any]


@api.get("/scenarios")
def scenarios() -> list[ScenarioAnswer]:
    """The predefined scenarios."""
    return [
        ScenarioAnswer(name=n, title=s.title, description=s.description, needs=", ".join(needs(s)), scenario=dump(s))
        for n, s in predefined().items()
    ]


@api.post("/predictions", status_code=201)
def predictions(request: Request, order: PredictionOrder, wait: Wait = 10.0) -> RunAnswer:
    """Predict a scenario, and wait for the numbers."""
    deny((order.name is None) == (order.scenario is None), 422, "give either name or scenario", "name")
    scenario = order.scenario or predefined().get(order.name or "")
    if scenario is None:
        raise Refusal(422, [FieldMistake("name", f"no predefined scenario; one of {', '.join(predefined())}")])
    try:
        data = dump(with_settings(scenario, order.settings) if order.settings else scenario)
    except UsageError as error:
        if isinstance(cause := error.__cause__, ValidationError):
            raise Refusal(422, mistakes_of(cause.errors())) from error
        raise Refusal(422, [FieldMistake("settings", error_text(error)[:500])]) from error
    return run(request, order_prediction(request, data).id, wait)


_MAX_STATES = 40
_LISTS = ("subject", "background", "sensor")
_NOTE = "# The emulator of 6S stands in for the engine; without its line each state is a run of 6S.\n"


def _source(request: Request, name: str) -> str:
    """A scenario as workers read it; refused where this server lacks a data set of it."""
    lacking = [f"this server lacks the data set {name}: {text}" for name, text in needs(predefined().get(name)).items()]
    deny(lacking, 422, "; ".join(lacking), "scenario")
    return _file(request, name)


def _parse_trade(request: Request, sent: QueryParams | FormData) -> tuple[str, Trade, Setup]:
    """What is asked, checked against its scenario; refused with every mistake at its field."""
    *asked, mistakes = _valid_part(request, sent)
    deny(mistakes, 422)
    return tuple(asked)


def _valid_part(request: Request, sent: QueryParams | FormData) -> tuple[Any, ...]:
    """Source, trade and scenario of what is right in what is asked, and every mistake of the rest, left out."""
    texts = [(name, text.strip()) for name, text in sent.multi_items() if isinstance(text, str) and text.strip()]
    try:
        return (*_build_trade(request, texts), [])
    except Refusal as refusal:
        mistakes = form_mistakes(refusal)
        if not texts:
            raise
    wrong = {mistake.field for mistake in mistakes}
    rest = [(n, t) for n, t in texts if not {n, n.partition("_")[0]} & wrong]  # with an input the ends of its axis
    fewer = (kept for kept in (rest, [(n, t) for n, t in texts if n == "scenario"], []) if len(kept) < len(texts))
    *right, more = _valid_part(request, QueryParams(next(fewer)))
    # Of another scenario than the one that is asked for there is nothing to be told.
    return (*right, [*mistakes, *(mistake for mistake in more if not {mistake.field, "scenario"} & wrong)])


def _build_trade(request: Request, texts: Sequence[tuple[str, str]]) -> tuple[str, Trade, Setup]:
    """What is asked, filled in from its scenario."""
    data: dict[str, Any] = {name: text for name, text in texts if name in Trade.model_fields}
    data |= {name: [text for key, text in texts if key == name] for name in _LISTS}
    data["moved"] = {name[3:]: text for name, text in texts if name.startswith("at:")}
    uploads = Uploads(request)
    data["kept"] = tuple(uploads.folder / "sensors" / name for name in uploads.names("sensors"))
    try:
        trade = Trade.model_validate(data)
        source = _source(request, trade.scenario)
        p = prepare(source, trade)
        return source, complete(trade, p), p
    except ValidationError as error:
        mistakes = mistakes_of(error.errors())
        raise Refusal(422, [replace(m, field=re.sub(r"^moved\.", "at:", m.field)) for m in mistakes]) from error
    except UsageError as error:
        raise Refusal(422, [FieldMistake(error.where or "", error_text(error))]) from error


@pages.get("/trade")
def trade_page(request: Request) -> Response:
    """The trade page, as its address says."""
    source, trade, offers, mistakes = _valid_part(request, request.query_params)
    ordered = list(offers.inputs.values())
    shown = [
        o for o in ordered
        if o.slider and (o.group != "Target" or len(o.paths) > 1 or any(f"[{s}]" in o.key for s in trade.subject))
    ]  # fmt: skip
    runs = store_of(request).visible_to(owner_of(request), "prediction")
    return page(
        request, "trade.html.j2", trade=trade, offers=offers, sliders=shown,
        errors=by_field(mistakes, [mistake.field for mistake in mistakes]),
        groups=[(name, list(some)) for name, some in groupby(ordered, lambda o: o.group)],
        scenarios={name: s.title or name for name, s in predefined().items() if not needs(s)}, runs=runs[:20],
        kinds=KINDS, detectors=LINEAR_DETECTORS, is_beside=source not in builtin_scenarios(),
    )  # fmt: skip


@pages.get("/trade/live")
def trade_live(request: Request) -> Response:
    """The ROC where the sliders stand, with its interval where that is asked for."""
    source, trade, _ = _parse_trade(request, request.query_params)
    roc = store_of(request).ask("trade_live", source=source, trade=trade, with_limits="limits" in request.query_params)
    return JSONResponse(roc)


@pages.get("/trade/curve")
def trade_curve(request: Request) -> Response:
    """The curve or map, a line of JSON for each piece."""
    source, trade, _ = _parse_trade(request, request.query_params)
    ask = store_of(request).ask

    def pieces() -> Iterator[str]:
        progress = None
        try:
            while progress is None or progress.todo:
                progress = Progress(*ask("trade_piece", source=source, trade=trade, before=progress))
                yield json.dumps({"figure": progress.figure, "needed": progress.messages, "left": progress.todo}) + "\n"
        except Refusal as refusal:  # what went before is sent already
            yield json.dumps({"error": refusal.mistakes[0].message, "left": 0}) + "\n"

    return StreamingResponse(pieces(), media_type="application/x-ndjson")


@pages.get("/trade/{name}")
def download_study(request: Request, name: str) -> Response:
    """The study that gives the same numbers, the scenario beside it, or a notebook that runs it."""
    source, trade, offers = _parse_trade(request, request.query_params)
    is_beside = source not in builtin_scenarios()
    study = trade_study(offers, trade, "scenario.yaml" if is_beside else source)
    note = _NOTE if "atmosphere.engine" in study.settings else ""
    texts = {path.name: path.read_text("utf-8") for path in trade.kept if path.name in trade.sensor}
    texts["study.yaml"] = yaml_text("study", dump(study), note)
    if is_beside:
        texts["scenario.yaml"] = yaml_text("scenario", dump(load_scenario(source)))
    texts["trade.ipynb"] = notebook(texts)
    deny(name not in texts, 404, "there is no such file")
    headers = {"content-disposition": f"attachment; filename*=utf-8''{quote(name)}"}  # as the framework names files
    return Response(texts[name], media_type="application/octet-stream", headers=headers)


@pages.post("/trade")
def keep_study(request: Request, form: SentForm) -> Response:
    """Run the study under the exact engine, and keep what comes of it."""
    _, trade, offers = _parse_trade(request, form)
    run = order_study(request, trade_study(offers, trade, trade.scenario, exact=True))
    return RedirectResponse(f"/runs/{run.id}", status_code=303)


def order_study(request: Request, study: StudyFile) -> WebRun:
    """Order a study of a predefined scenario, or of the scenario of a run of this session (``run:ID``).

    Raises
    ------
    Refusal : what is wrong with it, or there is no room.
    """
    uploads = Uploads(request)
    scenario = load_scenario(_source(request, study.scenario))
    most = request.app.state.settings.points
    deny([*dict.fromkeys((*_check_size(study, scenario, most), *_check_paths(study, scenario, uploads.names())))], 422)
    text = yaml_text("scenario", dump(scenario))
    asked = yaml_text("study", dump(study) | {"scenario": "scenario.yaml"})
    files: Files = {**uploads.copies(text + asked, scenario.folder), "study.yaml": asked, "scenario.yaml": text}
    return store_of(request).order(uploads.owner, "study", study.name, study.title, files)


class StudyOrder(Model):
    """A study of a predefined scenario by name, or of ``run:ID``, a prediction of this session."""

    study: Annotated[StudyFile, max_size("study")]


@api.post("/studies", status_code=201)
def studies(request: Request, order: StudyOrder) -> RunAnswer:
    """Evaluate a trade study; ask for the run to learn how far it is."""
    return answer_of(request, order_study(request, order.study))


def _check_size(study: StudyFile, scenario: Scenario, most: int) -> Iterator[FieldMistake]:
    few, nodes = plan_states(study, scenario)
    states = len(few) or math.prod(map(len, nodes.values()))
    points = study.count * (1 + sum(q.scan + 40 for q in study.required) // 4)
    if points > most:
        yield FieldMistake("inputs", f"{points:,} evaluations; this server allows at most {most:,}")
    if states > _MAX_STATES and study.settings.get("atmosphere.engine") != "emulator":
        yield FieldMistake("inputs", f"{states} states of the atmosphere; this server allows at most {_MAX_STATES}")


def _check_paths(study: StudyFile, scenario: Scenario, uploads: tuple[str, ...]) -> Iterator[FieldMistake]:
    """Paths that lead nowhere, and values that cannot stand there: files of the server among them.

    >>> planks, asked = "yellow-planks-asphalt", Trade(side_m=1.0)  # of a GSD, which the settings of the study make
    >>> study = trade_study(p := prepare(planks, asked), complete(asked, p), planks)
    >>> study.inputs[0].path.endswith("gsd_m"), list(_check_paths(study, load_scenario(planks), ()))
    (True, [])
    """
    tries: list[tuple[str, Mapping[str, Any]]] = [("settings", {})]
    asked = [(f"{kind}.{i}", one) for kind in ("inputs", "required") for i, one in enumerate(getattr(study, kind))]
    for where, item in asked:
        values = list({repr(value): value for value in values_to_try(item)}.values())
        if len(values) > MAX_TRIED:
            yield FieldMistake(f"{where}.values", f"{len(values)} that are no numbers; at most {MAX_TRIED} are taken")
        for value in values[:MAX_TRIED]:
            point = {path: v for path, v in point_values(item, value).items() if v is not None and is_in_file(path)}
            named = {path: point[path] for path in sorted(point) if path.partition(".")[0] in Scenario.model_fields}
            tries.append((f"{where}.path", named))
    for field, moves in tries:
        try:
            checked_scenario(dump(with_settings(scenario, {**study.settings, **moves})), uploads)
        except (UsageError, Refusal) as error:
            words = error_text(error) if isinstance(error, UsageError) else str(error)
            yield FieldMistake(field, words[:400])
            if field == "settings":  # on which the others stand
                return

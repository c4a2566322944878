"""The JSON API, version 1: everything that the pages do."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from hyperval.errors import UsageError
from hyperval.scenario import Scenario
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.settings import with_settings
from hyperval.study.schema import StudyFile
from hyperval.web.bring import PARTS, form_of, take_files
from hyperval.web.inputs import SURFACES, needs, plain, predefined, refuse_excess
from hyperval.web.pages import session_of
from hyperval.web.pages_predict import order_prediction
from hyperval.web.refusal import FieldMistake, Refused, mistakes_of, said
from hyperval.web.runs import file_of, files_of, known_campaigns, order_campaign, remove_run, run_charts, run_of
from hyperval.web.sensors import numbers_of
from hyperval.web.store import WebRun
from hyperval.web.trade import order_study

router = APIRouter(prefix="/api/v1", tags=["v1"])
_OF_RUN = ("id", "kind", "name", "title", "state", "reason", "created", "seconds", "version")
Setting = float | str | bool | list[Any] | None


def _small(at: str) -> BeforeValidator:
    """Looks at the size of an entry of a body before its parts are checked one by one."""

    def bounded(data: Any) -> Any:
        refuse_excess(data, at)
        return data

    return BeforeValidator(bounded)


class Problem(BaseModel):
    """A mistake: dotted path of its field, empty where it concerns the whole, and what is wrong."""

    field: str
    message: str


class Problems(BaseModel):
    """Why a request was not carried out."""

    errors: list[Problem]


class PredictionOrder(BaseModel):
    """What to predict: a predefined scenario by name, or a scenario, and entries in which it is to differ."""

    model_config = ConfigDict(extra="forbid")
    name: str | None = Field(None, max_length=100, description="a predefined scenario")
    scenario: Annotated[Scenario | None, _small("scenario")] = Field(None, description="in place of the name")
    settings: Annotated[dict[str, Setting], _small("")] = Field(
        default_factory=dict, max_length=100, description="dotted path: value"
    )


class RunAnswer(BaseModel):
    """A run: how it stands, what came of it, names of its files."""

    id: str
    kind: str
    name: str
    title: str
    state: str
    reason: str
    created: float = Field(description="Unix time")
    seconds: float
    version: str
    stage: str
    done: float = Field(description="part of the work that is done, 0-1")
    seconds_left: float | None
    summary: dict[str, Any]
    files: list[str]


class UploadAnswer(BaseModel):
    """What came of files: the run of a cube, or the names of all spectra and sensor files that are kept."""

    run: RunAnswer | None = None
    kept: list[str] = []


class SensorNumber(BaseModel):
    """A number of a sensor file: its value in words, its unit, and the source that the file states."""

    name: str
    value: str
    unit: str
    source: str


class ScenarioAnswer(BaseModel):
    """A predefined scenario."""

    name: str
    title: str
    description: str
    needs: str = Field(description="data sets that this server lacks for it; empty where it runs")
    scenario: dict[str, Any]


_PROBLEMS: dict[int | str, dict[str, Any]] = {
    code: {"model": Problems, "description": words}
    for code, words in {
        400: "unreadable", 403: "asked for by a page of another site", 404: "not there", 409: "not in this state",
        413: "too large", 422: "mistakes, each with its field", 429: "too many runs of this session",
        503: "no room for now",
    }.items()
}  # fmt: skip


def answer_of(request: Request, run: WebRun) -> RunAnswer:
    """A run as the API tells of it."""
    app = request.app
    progress = app.state.desk.progress(run)
    return RunAnswer(
        **{name: getattr(run, name) for name in _OF_RUN},
        **progress, summary=dict(run.summary), files=files_of(app.state.store.place(run.id), run),
    )  # fmt: skip


@router.get("/sensors", responses={k: _PROBLEMS[k] for k in (400,)})
def sensors() -> list[str]:
    """Names of the sensors of the library."""
    return list(library_names())


@router.get("/sensors/{name}", responses={k: _PROBLEMS[k] for k in (400, 404)})
def sensor(name: str) -> list[SensorNumber]:
    """Every number of a sensor of the library."""
    if name not in library_names():
        raise Refused(404, [FieldMistake("name", "the library has no such sensor")])
    return [SensorNumber(**row) for row in numbers_of(load_sensor(name).specification)]


@router.get("/surfaces", responses={k: _PROBLEMS[k] for k in (400,)})
def surfaces() -> list[str]:
    """Names of the surfaces that are built in."""
    return list(SURFACES)


@router.get("/scenarios", responses={k: _PROBLEMS[k] for k in (400,)})
def scenarios() -> list[ScenarioAnswer]:
    """The predefined scenarios."""
    return [
        ScenarioAnswer(
            name=name, title=s.title, description=s.description, needs=", ".join(needs(s)), scenario=plain(s)
        )
        for name, s in predefined().items()
    ]


@router.post("/predictions", status_code=201, responses={k: _PROBLEMS[k] for k in (400, 403, 413, 422, 429, 503)})
def predictions(
    request: Request, order: PredictionOrder, wait: float = Query(10.0, ge=0, le=60, description="seconds, at most")
) -> RunAnswer:
    """Predict a scenario, and wait for the numbers."""
    run = order_prediction(request, _scenario_of(order))
    request.app.state.desk.wait(run.id, wait)
    return answer_of(request, run_of(request, run.id))


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


@router.get("/runs", responses={k: _PROBLEMS[k] for k in (400,)})
def runs(request: Request) -> list[RunAnswer]:
    """Runs of this session, the latest first."""
    return [answer_of(request, run) for run in request.app.state.store.runs(session_of(request).owner)]


@router.get("/runs/{run_id}", responses={k: _PROBLEMS[k] for k in (400, 404, 422)})
def run(request: Request, run_id: str, wait: float = Query(0.0, ge=0, le=60)) -> RunAnswer:
    """A run of this session; with ``wait`` once it has ended, or after so many seconds."""
    known = run_of(request, run_id)
    if wait:
        request.app.state.desk.wait(known.id, wait)
    return answer_of(request, run_of(request, run_id))


@router.get(
    "/runs/{run_id}/charts", response_class=JSONResponse, response_model=None,
    responses={k: _PROBLEMS[k] for k in (400, 404, 409, 422, 503)},
)  # fmt: skip
def charts(request: Request, run_id: str, beside: str | None = None) -> Response:
    """Charts of a prediction, as Bokeh draws them."""
    return run_charts(request, run_id, beside)


@router.get(
    "/runs/{run_id}/files/{name:path}", response_class=Response, response_model=None,
    responses={k: _PROBLEMS[k] for k in (400, 404, 409, 503)},
)  # fmt: skip
def file(request: Request, run_id: str, name: str) -> Response:
    """A file of a run, such as results.csv, products.nc or scenario.yaml."""
    return file_of(request, run_of(request, run_id), name)


@router.post("/runs/{run_id}/cancel", responses={k: _PROBLEMS[k] for k in (400, 403, 404)})
def cancel(request: Request, run_id: str) -> RunAnswer:
    """Call a run off."""
    request.app.state.desk.cancel(run_of(request, run_id).id)
    request.app.state.desk.wait(run_id, 5.0)
    return answer_of(request, run_of(request, run_id))


@router.delete("/runs/{run_id}", status_code=204, responses={k: _PROBLEMS[k] for k in (400, 403, 404, 409)})
def remove(request: Request, run_id: str) -> Response:
    """Forget a run and its files."""
    remove_run(request, run_id)
    return Response(status_code=204)


class StudyOrder(BaseModel):
    """A study; its scenario is a predefined one by name, or ``run:ID``, that of a prediction of this session."""

    model_config = ConfigDict(extra="forbid")
    study: Annotated[StudyFile, _small("study")]


class CampaignAnswer(BaseModel):
    """A campaign that may be run."""

    name: str
    title: str
    description: str


class ValidationOrder(BaseModel):
    """Which campaign to run."""

    model_config = ConfigDict(extra="forbid")
    campaign: str = Field(max_length=100, description="a name of /campaigns")


@router.post("/studies", status_code=201, responses={k: _PROBLEMS[k] for k in (400, 403, 413, 422, 429, 503)})
def studies(request: Request, order: StudyOrder) -> RunAnswer:
    """Evaluate a trade-off study; ask for the run to learn how far it is."""
    data = order.study.model_dump(mode="json", by_alias=True, exclude_unset=True)
    return answer_of(request, order_study(request, data))


@router.get("/campaigns", responses={k: _PROBLEMS[k] for k in (400,)})
def campaigns(request: Request) -> list[CampaignAnswer]:
    """Campaigns of the server's folder, and those of this session."""
    known = known_campaigns(request).values()
    return [CampaignAnswer(name=k.name, title=k.title, description=k.description) for k in known]


@router.post("/validations", status_code=201, responses={k: _PROBLEMS[k] for k in (400, 403, 413, 422, 429, 503)})
def validations(request: Request, order: ValidationOrder) -> RunAnswer:
    """Run a campaign: predict, observe, compare."""
    return answer_of(request, order_campaign(request, order.campaign))


_FILE = {"type": "string", "format": "binary"}
_BODY: dict[str, Any] = {
    **dict.fromkeys(("cube", "header", "targets"), _FILE),
    **{key: {"type": "array", "items": _FILE} for key in ("regions", "spectra", "sensors")},
    **{key: {"type": "string"} for key in ("name", "quantity", "unit", "sensor", "time_utc")},
    **{
        f"{part}_{end}": {"type": "string", "description": words}
        for part in PARTS
        for end, words in (("named", "of the server's data folder, not sent"), ("kept", "of an earlier request"))
    },
    **{key: {"type": "number"} for key in ("altitude_km", "pixel_size_m")},
}


_FORM = {"multipart/form-data": {"schema": {"type": "object", "properties": _BODY}}}


@router.post(
    "/uploads", status_code=201, openapi_extra={"requestBody": {"required": True, "content": _FORM}},
    responses={k: _PROBLEMS[k] for k in (400, 403, 413, 422, 429, 503)},
)  # fmt: skip
async def uploads(request: Request) -> UploadAnswer:
    """Bring a cube with regions and spectra, on which the empirical pipeline runs.

    Field spectra and sensor files without a cube are kept for the scenarios of this session.
    """
    form = await form_of(request)
    taken = await run_in_threadpool(take_files, request, form)
    if isinstance(taken, WebRun):
        return UploadAnswer(run=answer_of(request, taken))
    return UploadAnswer(kept=taken)


@router.api_route("/session", methods=["GET"], include_in_schema=False)
@router.api_route("/uploads/{kind}", methods=["POST"], include_in_schema=False)
def replaced() -> None:
    """Say what stands in the place of what there was in versions before."""
    words = "there are no tokens any more: the cookie of the first answer is the session; all files go to /uploads"
    raise Refused(410, words)

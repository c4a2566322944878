"""The application: routes, what every request passes, what is said when something goes wrong."""

from __future__ import annotations

import gc
import os
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import anyio.to_thread
from fastapi import Depends, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response

import hyperval
from hyperval.errors import HypervalError
from hyperval.executors import TaskPool
from hyperval.web import api_v1, bring, pages_predict, reference, runs, sensors, trade
from hyperval.web.desk import Desk
from hyperval.web.guard import Guard
from hyperval.web.pages import page, static
from hyperval.web.refusal import FieldMistake, Refused, field_name, said, sentence, without_paths
from hyperval.web.store import RunStore, ServerSettings

_THREADS = 128  # requests that wait for a worker hold one each


def make_app(settings: ServerSettings, pools: tuple[TaskPool, TaskPool] | None = None) -> FastAPI:
    """The application of one server; its workers run while it is served.

    Raises
    ------
    OSError : the folder cannot be made or written.
    """
    settings.folder.mkdir(parents=True, exist_ok=True)
    os.chmod(settings.folder, 0o700)

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        anyio.to_thread.current_default_thread_limiter().total_tokens = _THREADS
        await anyio.to_thread.run_sync(_warm, settings)
        yield
        app.state.desk.close()

    app = FastAPI(
        title="hyperval",
        version=hyperval.__version__,
        description="Predictions, studies and campaigns of hyperspectral imagers.",
        docs_url=None, redoc_url=None, openapi_url="/api/v1/openapi.json",
        lifespan=life, dependencies=[Depends(closing_files)],
    )  # fmt: skip
    app.state.settings = settings
    app.state.store = RunStore(settings.folder, settings.limits)
    app.state.desk = Desk(settings, app.state.store, pools)
    for room in (pages_predict, runs, trade, runs, bring, reference, sensors, api_v1):
        app.include_router(room.router)

    @app.get("/static/{name}", include_in_schema=False)
    def _static(name: str) -> Response:
        answer = static(name)
        if answer is None:
            raise Refused(404, "there is no such file")
        return answer

    app.add_exception_handler(Refused, _refused)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HypervalError, _package_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_middleware(Guard, settings=settings)
    return app


def _warm(settings: ServerSettings) -> None:
    """Load what the first requests would wait for."""
    pages_predict.warm()
    list(runs.campaigns_of(settings))
    gc.collect()
    gc.freeze()  # what is loaded stays: to go through it again takes up to half a second, while somebody waits


async def closing_files(request: Request) -> AsyncIterator[None]:
    """Close the files of a form when it has been answered."""
    try:
        yield
    finally:
        await request.close()


def _answer(request: Request, status: int, mistakes: list[FieldMistake], wait: int | None = None) -> Response:
    headers = {"retry-after": str(wait)} if wait else None
    if not request.url.path.startswith("/api/") and "text/html" in request.headers.get("accept", ""):
        answer: Response = page(request, "error.html.j2", status=status, mistakes=mistakes, code=status)
        answer.headers.update(headers or {})
        return answer
    errors = [{"field": m.field, "message": m.message} for m in mistakes]
    return JSONResponse({"errors": errors}, status_code=status, headers=headers)


def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, Refused)  # noqa: S101
    return _answer(request, error.status, list(error.mistakes), error.wait)


def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101
    body: Any = error.body
    mistakes = []
    for item in error.errors()[:40]:
        place, *rest = item["loc"]
        name = field_name(rest, body, item["type"] == "missing") if place == "body" else ".".join(map(str, rest))
        words = sentence(item["type"], str(item["msg"]), item["loc"])
        mistakes.append(FieldMistake(name or str(place), without_paths(words)[:500]))
    return _answer(request, 422, mistakes)


def _package_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HypervalError)  # noqa: S101
    return _answer(request, 422 if error.exit_code in (2, 3) else 500, [FieldMistake("", said(error))])


def _http_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101
    words = {404: "there is no such page", 405: "this cannot be done here", 400: "the request cannot be read"}
    field = "body" if error.status_code == 400 else ""
    answer = _answer(request, error.status_code, [FieldMistake(field, words.get(error.status_code, "refused"))])
    answer.headers.update(error.headers or {})
    if error.status_code == 405 and request.url.path.startswith("/api/"):
        answer.headers["allow"] = ", ".join(_methods(request.app, request.url.path))
    return answer


def _methods(app: FastAPI, path: str) -> list[str]:
    """What may be asked of a path: a router tells the methods of one of its routes alone."""
    methods: set[str] = set()
    for template, operations in app.openapi()["paths"].items():
        pattern = re.sub(r"\\\{[^}]*\\\}", "[^/]+", re.escape(template))
        if re.fullmatch(pattern, path):
            methods |= {method.upper() for method in operations}
    return sorted(methods)

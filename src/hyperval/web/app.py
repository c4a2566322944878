"""The application: its routes, the layers that every request passes, and its error responses."""

from __future__ import annotations

import gc
import os
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

import anyio.to_thread
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match

import hyperval
from hyperval.errors import HypervalError, package_table
from hyperval.executors import TaskPool
from hyperval.web import predictions, runs, uploads  # noqa: F401  (their routes)
from hyperval.web.guard import RequestGuard
from hyperval.web.pages import api, page, pages
from hyperval.web.refusal import FieldMistake, Refusal, error_text, json_error, mistakes_of
from hyperval.web.store import Runs, ServerSettings


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
        # Requests that wait for a worker hold a thread each.
        anyio.to_thread.current_default_thread_limiter().total_tokens = 128
        await anyio.to_thread.run_sync(_warm, settings)
        yield
        app.state.runs.close()

    app = FastAPI(
        title="hyperval",
        version=hyperval.__version__,
        description="Predictions, studies and campaigns of hyperspectral imagers.",
        docs_url=None, redoc_url=None, openapi_url="/api/v1/openapi.json",
        lifespan=life,
    )  # fmt: skip
    app.state.settings = settings
    app.state.runs = Runs(settings, pools)
    for router in (pages, api):
        app.include_router(router)

    for kind in (RequestValidationError, HypervalError, HTTPException):
        app.add_exception_handler(kind, _error_response)
    app.add_middleware(RequestGuard, settings=settings)
    return app


def _warm(settings: ServerSettings) -> None:
    """Load what the first requests would wait for."""
    predictions.warm()
    list(runs.campaigns_of(settings))
    gc.collect()
    gc.freeze()  # what is loaded stays: to go through it again takes up to half a second, while somebody waits


_WORDS = package_table("web/answers.yaml")["unsaid"]


def _error_response(request: Request, error: Exception) -> Response:
    """The response to a request that failed, to a browser as a page."""
    status, headers, mistakes = 500, dict[str, str](), list[FieldMistake]()
    if isinstance(error, HTTPException):
        status, headers = error.status_code, {name.lower(): value for name, value in (error.headers or {}).items()}
        unsaid = FieldMistake("body" if status == 400 else "", _WORDS.get(status, "refused"))
        mistakes = list(error.mistakes) if isinstance(error, Refusal) else [unsaid]
    elif isinstance(error, RequestValidationError):
        status, unread = 422, isinstance(error.body, str)
        mistakes = [
            replace(m, field="body" if unread else re.sub(r"^\w+\.", "", m.field)) for m in mistakes_of(error.errors())
        ]
    elif isinstance(error, HypervalError):
        status, mistakes = 422 if error.exit_code in (2, 3) else 500, [FieldMistake("", error_text(error))]
    if request.url.path.startswith("/api/"):
        if status == 405:  # a router names the methods of one of its routes only
            methods = (getattr(r, "methods", ()) for r in api.routes if r.matches(request.scope)[0] is not Match.NONE)
            headers["allow"] = ", ".join(sorted(set[str]().union(*methods)))
    elif "text/html" in request.headers.get("accept", ""):
        response = page(request, "error.html.j2", status=status, mistakes=mistakes, code=status)
        response.headers.update(headers)
        return response
    return json_error(status, mistakes, headers)

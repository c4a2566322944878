"""Imagery that a session brings: checked as it comes in, kept, and put through the empirical pipeline.

A file that is right is kept under its field; what the request that it came with lacks is asked for alone.
"""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Literal

from fastapi import Request
from pydantic import BaseModel, Field, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.responses import RedirectResponse, Response

from hyperval.errors import HypervalError
from hyperval.paths import checked_file
from hyperval.sensor.specification import library_names
from hyperval.web.forms import marked
from hyperval.web.pages import api, page, pages, session_of
from hyperval.web.refusal import FieldMistake, Refused, mistakes_of, to_show
from hyperval.web.runs import RunAnswer, answer_of
from hyperval.web.store import KINDS, SPECTRA, WebRun, checked_name, files_of, folder_of

MOST_FILES = 20
_MOST_KEPT = 50
PARTS = {  # of a collection -> endings of the names of its files
    "cube": (".img", ".dat", ".raw", ".bsq", ".bil", ".bip", ""),
    "header": (".hdr",),
    "regions": (".txt", ".geojson", ".json", ".csv", ".roi"),
    "targets": (".csv", ".geojson", ".json", ".txt"),
    "spectra": (*SPECTRA, ".hdr"),
}
_SINGLE = ("cube", "header", "targets")  # of which one file is taken
_ENDINGS = {**PARTS, "sensors": (".yaml", ".yml")}
_PACKED = {
    b"PK\x03\x04": "a zip archive",
    b"\x1f\x8b": "packed by gzip",
    b"<?xml": "XML",
    b"BZh": "packed by bzip2",
}
_LARGEST_TEXT = 4_000_000
_INSIDE = re.compile(r"(?:[A-Za-z0-9_][A-Za-z0-9_.@+-]{0,100}/){0,12}[A-Za-z0-9_][A-Za-z0-9_.@+-]{0,100}")


class StatedCollection(BaseModel):
    """What a person says of a collection; blank entries are left out."""

    name: str = Field("mine", max_length=60, pattern="^[a-z0-9][a-z0-9-]*$")
    quantity: Literal["radiance", "reflectance"] | None = None
    unit: str | None = Field(None, max_length=60)
    sensor: Literal[library_names()] | None = None  # type: ignore[valid-type]
    time_utc: str | None = Field(None, max_length=60)
    altitude_km: float | None = Field(None, ge=0.01, le=100_000, allow_inf_nan=False)
    pixel_size_m: float | None = Field(None, ge=0.001, le=10_000, allow_inf_nan=False)


@pages.get("/bring")
def bring(request: Request) -> Response:
    """The form."""
    return _page(request, {})


@pages.post("/uploads")
async def uploads_page(request: Request) -> Response:
    """Take files: a cube runs through the empirical pipeline, spectra and sensor files are kept."""
    form = await form_of(request)
    try:
        taken = await run_in_threadpool(take_files, request, form)
    except Refused as refusal:
        given = {name: value for name, value in form.items() if isinstance(value, str)}
        return _page(request, given, to_show(refusal), 422)
    return RedirectResponse(f"/runs/{taken.id}" if isinstance(taken, WebRun) else "/bring", status_code=303)


async def form_of(request: Request) -> FormData:
    """The fields and files of a request.

    Raises
    ------
    Refused : it is not of the form that files come in.
    """
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        raise Refused(422, [FieldMistake("body", "files come as multipart/form-data")])
    return await request.form(max_files=MOST_FILES, max_fields=200)


def _page(
    request: Request, given: Mapping[str, str], mistakes: Sequence[FieldMistake] = (), status: int = 200
) -> Response:
    settings, owner = request.app.state.settings, session_of(request).owner
    errors = marked(mistakes, [mistake.field for mistake in mistakes])
    return page(
        request, "uploads.html.j2", status=status, errors=errors, given=given, most=settings.limits.upload_bytes,
        has_data=settings.data is not None, sensors=library_names(),
        kept={field: files_of(settings, owner, [field]) for field in _ENDINGS},
    )  # fmt: skip


def take_files(request: Request, form: FormData) -> WebRun | list[str]:
    """The run of the cube of a form, or the names of the spectra and sensor files that are kept where it has none.

    Raises
    ------
    Refused : what is wrong with them, or there is no room; what was right is kept none the less.
    """
    state, owner = request.app.state, session_of(request).owner
    fields, mistakes = set[str](), list[FieldMistake]()
    files: dict[str, tuple[str, Path]] = {}  # name in the collection -> its field, and where it is
    for field, find in _given(request, form):
        fields.add(field)
        try:
            path = find()
        except Refused as refusal:
            mistakes += refusal.mistakes
            continue
        if files.setdefault(path.name, (field, path)) != (field, path):
            mistakes.append(FieldMistake(field, f"{path.name}: was given twice"))
    state.store.clear()
    others = [form.get(f"{field}_{end}") for field in PARTS for end in ("kept", "named")]
    if any(others) or not fields or fields - {*KINDS}:
        return _order(request, form, files, mistakes)
    if mistakes:
        raise Refused(422, mistakes)
    return list(files_of(state.settings, owner))


def _given(request: Request, form: FormData) -> Iterator[tuple[str, Callable[[], Path]]]:
    """Field of each file that a form gives, and what finds it: sent, kept of an earlier request, named."""
    settings, owner = request.app.state.settings, session_of(request).owner
    for field, file in form.multi_items():
        if isinstance(file, UploadFile) and field in _ENDINGS and (file.filename or file.size):
            yield field, partial(_keep, request, field, file)
    for field in PARTS:  # of a cube what was sent has taken the place of what was kept
        for name in {*form.getlist(f"{field}_kept")} & {*files_of(settings, owner, [field])}:
            yield field, partial((folder_of(settings, owner) / field).joinpath, str(name))
        for name in filter(None, (n.strip() for n in str(form.get(f"{field}_named") or "").split(","))):
            yield field, partial(_named, request, field, name)


def _keep(request: Request, field: str, file: UploadFile) -> Path:
    """Keep a file under its field; a new one takes the place of one of the same name, and of any other of a cube."""
    settings, owner = request.app.state.settings, session_of(request).owner
    name = checked_name(field, file.filename or "")
    place = folder_of(settings, owner) / field
    place.mkdir(parents=True, exist_ok=True)
    part = place.parent / f"part-{secrets.token_hex(8)}.yaml"
    try:
        with part.open("wb") as out:
            shutil.copyfileobj(file.file, out)
        _check(request, field, name, part)
        if len({*files_of(settings, owner, [field]), name}) > _MOST_KEPT:
            raise Refused(422, [FieldMistake(field, f"a session keeps at most {_MOST_KEPT}")])
        if field in ("cube", "header"):
            shutil.rmtree(place)
            place.mkdir()
        part.replace(place / name)
    finally:
        part.unlink(missing_ok=True)
    return place / name


def _check(request: Request, field: str, name: str, path: Path) -> None:
    """Refuse a file by the ending of its name, its head or its size; one of a sensor by what it says."""
    ending, state = Path(name).suffix.lower(), request.app.state
    with path.open("rb") as file:
        head = file.read(8)
    packed = next((kind for sign, kind in _PACKED.items() if head.startswith(sign)), None)
    largest = state.settings.limits.samples * 8 if field == "cube" else _LARGEST_TEXT
    wrong = {
        f"ends with none of {', '.join(filter(None, _ENDINGS[field]))}": ending not in _ENDINGS[field],
        f"is {packed}, which is not accepted": packed is not None,
        f"larger than {largest:,} bytes": path.stat().st_size > largest,
    }
    if mistakes := [FieldMistake(field, f"{name}: {words}") for words, is_so in wrong.items() if is_so]:
        raise Refused(422, mistakes)
    if field == "sensors":
        try:
            state.desk.ask("sensor", path=str(path))
        except Refused as refusal:
            words = refusal.mistakes[0].message.replace(path.name, name)
            raise Refused(422, [FieldMistake("sensors", f"{name}: {words}")]) from refusal


def _named(request: Request, field: str, name: str) -> Path:
    """A file of the data folder that a form names."""
    data = request.app.state.settings.data
    with suppress(HypervalError, OSError):
        if data is not None and _INSIDE.fullmatch(name):
            path = checked_file(data / name, root=data)
            _check(request, field, path.name, path)
            return path
    raise Refused(422, [FieldMistake(f"{field}_named", "the data folder of this server has no such file")])


def _order(
    request: Request, form: FormData, files: Mapping[str, tuple[str, Path]], mistakes: list[FieldMistake]
) -> WebRun:
    """Order the empirical pipeline of files."""
    owner, settings = session_of(request).owner, request.app.state.settings
    parts = {field: [f"collection/{name}" for name, (of, _) in files.items() if of == field] for field in PARTS}
    wrong = {mistake.field.removesuffix("_named") for mistake in mistakes}
    for field, words in (
        ("cube", "one data file of a cube is needed"),
        ("header", "the ENVI header is needed"),
        ("regions", "at least one file of regions is needed"),
    ):
        if field not in wrong and (not parts[field] or (field == "cube" and len(parts[field]) > 1)):
            mistakes.append(FieldMistake(field, words))
    given = {name: str(value).strip() for name, value in form.items() if name in StatedCollection.model_fields}
    given = {name: value for name, value in given.items() if value}
    try:
        stated = StatedCollection.model_validate(given)
    except ValidationError as error:
        mistakes += mistakes_of(error, given)
    if mistakes:
        raise Refused(422, mistakes)
    sources: dict[str, Any] = {
        "cube": parts["cube"][0], "header": parts["header"][0], "regions": parts["regions"],
        "targets": next(iter(parts["targets"]), None),
        "spectra": [name for name in parts["spectra"] if not name.endswith(".hdr")], "name": stated.name,
        "stated": stated.model_dump(exclude={"name"}, exclude_none=True), "most": settings.limits.samples,
    }  # fmt: skip
    copies = {f"collection/{name}": path for name, (_, path) in files.items()}
    title = f"{stated.name}: {Path(sources['cube']).name}"
    run: WebRun = request.app.state.desk.order(owner, "pipeline", stated.name, title, copies, sources=sources)
    for field in PARTS.keys() - KINDS:
        shutil.rmtree(folder_of(settings, owner) / field, ignore_errors=True)
    return run


class UploadAnswer(BaseModel):
    """What came of files: the run of a cube, or the names of all spectra and sensor files that are kept."""

    run: RunAnswer | None = None
    kept: list[str] = []


_FILE = {"type": "string", "format": "binary"}
_BODY: dict[str, Any] = {
    **{field: _FILE if field in _SINGLE else {"type": "array", "items": _FILE} for field in _ENDINGS},
    **StatedCollection.model_json_schema()["properties"],
    **{
        f"{part}_{end}": {"type": "string", "description": words}
        for part in PARTS
        for end, words in (("named", "of the server's data folder, not sent"), ("kept", "of an earlier request"))
    },
}
_FORM = {"multipart/form-data": {"schema": {"type": "object", "properties": _BODY}}}


@api.post("/uploads", status_code=201, openapi_extra={"requestBody": {"required": True, "content": _FORM}})
async def uploads(request: Request) -> UploadAnswer:
    """Bring a cube with regions and spectra, on which the empirical pipeline runs.

    Field spectra and sensor files without a cube are kept for the scenarios of this session.
    """
    taken = await run_in_threadpool(take_files, request, await form_of(request))
    if isinstance(taken, WebRun):
        return UploadAnswer(run=answer_of(request, taken))
    return UploadAnswer(kept=taken)


@api.get("/session", include_in_schema=False)
@api.post("/uploads/{kind}", include_in_schema=False)
def replaced() -> None:
    """Say what stands in the place of what there was in versions before."""
    words = "there are no tokens any more: the cookie of the first answer is the session; all files go to /uploads"
    raise Refused(410, words)

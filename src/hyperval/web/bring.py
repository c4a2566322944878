"""Imagery that a session brings: checked as it comes in, kept with its run, put through the empirical pipeline."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.responses import RedirectResponse, Response

from hyperval.errors import HypervalError, UsageError
from hyperval.paths import checked_file
from hyperval.sensor.specification import library_names
from hyperval.web.desk import Order
from hyperval.web.pages import page, session_of
from hyperval.web.refusal import KINDS, SPECTRA, FieldMistake, Refused, checked_name, files_of, folder_of, to_show
from hyperval.web.store import ServerSettings, WebRun

router = APIRouter(include_in_schema=False)
MOST_FILES = 20
_MOST_KEPT = 50
_CUBE = (".img", ".dat", ".raw", ".bsq", ".bil", ".bip", "")
_ENDINGS = {
    "cube": _CUBE,
    "header": (".hdr",),
    "regions": (".txt", ".geojson", ".json", ".csv", ".roi"),
    "targets": (".csv", ".geojson", ".json", ".txt"),
    "spectra": (*SPECTRA, ".hdr"),
    "sensors": (".yaml", ".yml"),
}
_PACKED = {
    b"PK\x03\x04": "a zip archive",
    b"\x1f\x8b": "packed by gzip",
    b"<?xml": "XML",
    b"BZh": "packed by bzip2",
}
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,59}")
_LARGEST_TEXT = 4_000_000
_HEAD_BYTES = 8
_PARTS = ("cube", "header", "regions", "targets", "spectra")
_INSIDE = re.compile(r"(?:[A-Za-z0-9_][A-Za-z0-9_.@+-]{0,100}/){0,12}[A-Za-z0-9_][A-Za-z0-9_.@+-]{0,100}")


@dataclass(frozen=True)
class Brought:
    """A file of a request: the field, its name, its size, and what holds it: the request, or the data folder."""

    field: str
    name: str
    size: int
    file: BinaryIO | None = None
    path: Path | None = None

    def head(self) -> bytes:
        """Its first bytes."""
        if self.path is not None:
            with self.path.open("rb") as file:
                return file.read(_HEAD_BYTES)
        assert self.file is not None  # noqa: S101
        head = self.file.read(_HEAD_BYTES)
        self.file.seek(0)
        return head

    def keep(self, path: Path) -> None:
        """Put its content at ``path``: that of the data folder takes no room where the file system can share it."""
        if self.path is not None:
            try:
                os.link(self.path.resolve(), path)
            except OSError:
                shutil.copyfile(self.path, path)
            return
        assert self.file is not None  # noqa: S101
        with path.open("wb") as out:
            shutil.copyfileobj(self.file, out)


@router.get("/bring")
def bring(request: Request) -> Response:
    """The form."""
    return _page(request)


@router.post("/uploads")
async def uploads(request: Request) -> Response:
    """Take files: a cube runs through the empirical pipeline, spectra and sensor files are kept."""
    form = await form_of(request)
    try:
        taken = await run_in_threadpool(take_files, request, form)
    except Refused as refusal:
        return _page(request, to_show(refusal), 422)
    return RedirectResponse(f"/runs/{taken.id}" if isinstance(taken, WebRun) else "/bring", status_code=303)


def take_files(request: Request, form: FormData) -> WebRun | list[str]:
    """The run of the cube of a form, or the names of the spectra and sensor files that are kept where it has none.

    Raises
    ------
    Refused : what is wrong with them, or there is no room.
    """
    keeps = next(_files(form, KINDS), None) is not None
    others = [field for field in _PARTS if field != "spectra"]
    has_cube = next(_files(form, others), None) is not None or any(form.get(f"{field}_named") for field in _PARTS)
    return keep_files(request, form) if keeps and not has_cube else order_pipeline(request, form)


async def form_of(request: Request) -> FormData:
    """The fields and files of a request.

    Raises
    ------
    Refused : it is not of the form that files come in.
    """
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        raise Refused(422, [FieldMistake("body", "files come as multipart/form-data")])
    return await request.form(max_files=MOST_FILES, max_fields=40)


def _page(request: Request, mistakes: Sequence[FieldMistake] = (), status: int = 200) -> Response:
    settings, owner = request.app.state.settings, session_of(request).owner
    return page(
        request, "bring.html.j2", status=status, errors={m.field: m.message for m in mistakes},
        most=settings.limits.upload_bytes, has_data=settings.data is not None, sensors=library_names(),
        spectra=files_of(settings, owner, ["spectra"]), own_sensors=files_of(settings, owner, ["sensors"]),
    )  # fmt: skip


def order_pipeline(request: Request, form: FormData) -> WebRun:
    """Order the empirical pipeline of the files of a form.

    Raises
    ------
    Refused : what is wrong with them, or there is no room.
    """
    owner, settings = session_of(request).owner, request.app.state.settings
    named, mistakes = _named(form, settings)
    files = [*_files(form, _PARTS), *named]
    mistakes += _wrong(files, settings.limits.samples * 8)
    cubes = [f for f in files if f.field == "cube"]
    if len(cubes) != 1:
        mistakes.append(FieldMistake("cube", "one data file of a cube is needed"))
    if not any(f.field == "header" for f in files):
        mistakes.append(FieldMistake("header", "the ENVI header is needed"))
    if not any(f.field == "regions" for f in files):
        mistakes.append(FieldMistake("regions", "at least one file of regions is needed"))
    name, stated = str(form.get("name") or "mine"), {}
    if not _NAME.fullmatch(name):
        mistakes.append(FieldMistake("name", "small letters, digits and hyphens, at most 60"))
    for field in ("quantity", "unit", "sensor", "time_utc"):
        text = form.get(field)
        if isinstance(text, str) and text.strip():
            stated[field] = text.strip()[:60]
    stated_numbers, wrong = _numbers(form)
    mistakes += wrong
    if stated.get("sensor", library_names()[0]) not in library_names():
        mistakes.append(FieldMistake("sensor", f"one of {', '.join(library_names())}"))
    if mistakes:
        raise Refused(422, mistakes)
    place = folder_of(settings, owner) / "incoming" / secrets.token_hex(8)
    place.mkdir(parents=True)
    copies = {}
    for number, brought in enumerate(files):
        path = place / f"{number}-{brought.name}"
        brought.keep(path)
        copies[f"collection/{brought.name}"] = path
    header = next(f"collection/{f.name}" for f in files if f.field == "header")
    sources: dict[str, Any] = {
        "cube": f"collection/{cubes[0].name}",
        "regions": [f"collection/{f.name}" for f in files if f.field == "regions"],
        "targets": next((f"collection/{f.name}" for f in files if f.field == "targets"), None),
        "spectra": [f"collection/{f.name}" for f in files if f.field == "spectra" and not f.name.endswith(".hdr")],
        "name": name,
        "stated": stated | stated_numbers,
        "header": header,
        "most": settings.limits.samples,
    }
    try:
        order = Order("pipeline", name, f"{name}: {cubes[0].name}", copies=copies, arguments={"sources": sources})
        run: WebRun = request.app.state.desk.order(owner, order)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return run


def keep_files(request: Request, form: FormData) -> list[str]:
    """Keep spectra and sensor files of a session; a new one takes the place of one of the same name.

    Raises
    ------
    Refused : a file that is none by its name or, of a sensor, by what it says; too large, or one too many.
    """
    files = list(_files(form, KINDS))
    mistakes = list(_wrong(files))
    settings, owner = request.app.state.settings, session_of(request).owner
    for kind in KINDS:
        names = {*files_of(settings, owner, [kind]), *(f.name for f in files if f.field == kind)}
        if len(names) > _MOST_KEPT:
            mistakes.append(FieldMistake(kind, f"a session keeps at most {_MOST_KEPT}"))
    if mistakes:
        raise Refused(422, mistakes)
    for one in files:
        place = folder_of(settings, owner) / one.field
        place.mkdir(parents=True, exist_ok=True)
        part = place.parent / f"part-{secrets.token_hex(8)}.yaml"
        try:
            one.keep(part)
            if one.field == "sensors":
                _check_sensor(request, part, one.name)
            part.replace(place / one.name)
        finally:
            part.unlink(missing_ok=True)
    return list(files_of(settings, owner))


def _check_sensor(request: Request, path: Path, name: str) -> None:
    try:
        request.app.state.desk.ask("sensor", path=str(path))
    except Refused as refusal:
        words = refusal.mistakes[0].message.replace(path.name, name)
        raise Refused(422, [FieldMistake("sensors", f"{name}: {words}")]) from refusal


def _files(form: FormData, fields: Sequence[str]) -> Iterator[Brought]:
    for field, value in form.multi_items():
        if isinstance(value, UploadFile) and field in fields and (value.filename or value.size):
            yield Brought(field, value.filename or "", value.size or 0, value.file)


def _named(form: FormData, settings: ServerSettings) -> tuple[list[Brought], list[FieldMistake]]:
    """Files of the data folder that a form names, several of a field with commas between."""
    files, mistakes = [], []
    for field in _PARTS:
        value = form.get(f"{field}_named")
        for name in (n.strip() for n in value.split(",")) if isinstance(value, str) else ():
            if not name:
                continue
            try:
                if settings.data is None or not _INSIDE.fullmatch(name):
                    raise UsageError("no file of the data folder")
                path = checked_file(settings.data / name, root=settings.data)
                files.append(Brought(field, path.name, path.stat().st_size, path=path))
            except (HypervalError, OSError):
                mistakes.append(FieldMistake(f"{field}_named", "the data folder of this server has no such file"))
    return files, mistakes


def _wrong(files: Sequence[Brought], largest_cube: int = 0) -> Iterator[FieldMistake]:
    names: set[str] = set()
    for brought in files:
        try:
            checked_name(brought.name)
        except Refused as refusal:
            yield FieldMistake(brought.field, refusal.mistakes[0].message)
            continue
        ending = brought.name[brought.name.rfind(".") :].lower() if "." in brought.name else ""
        if ending not in _ENDINGS[brought.field]:
            yield FieldMistake(
                brought.field,
                f"{brought.name}: ends with none of {', '.join(filter(None, _ENDINGS[brought.field]))}",
            )
        head = brought.head()
        for sign, kind in _PACKED.items():
            if head.startswith(sign):
                yield FieldMistake(brought.field, f"{brought.name}: is {kind}, which is not taken")
        largest = largest_cube if brought.field == "cube" else _LARGEST_TEXT
        if brought.size > largest:
            yield FieldMistake(brought.field, f"{brought.name}: larger than {largest:,} bytes")
        if brought.name in names:
            yield FieldMistake(brought.field, f"{brought.name}: stands twice")
        names.add(brought.name)


def _numbers(form: FormData) -> tuple[dict[str, float], list[FieldMistake]]:
    numbers, wrong = {}, []
    for field, low, high in (("altitude_km", 0.01, 100_000.0), ("pixel_size_m", 0.001, 10_000.0)):
        text = form.get(field)
        if not isinstance(text, str) or not text.strip():
            continue
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            wrong.append(FieldMistake(field, f"a number from {low:g} to {high:g}"))
        numbers[field] = value
    return numbers, wrong

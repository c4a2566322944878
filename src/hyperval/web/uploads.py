"""Uploaded imagery: checked as it comes in, kept, and put through the empirical pipeline.

A file that is right is kept under its field, apart from other sessions, under a name that is no path; what is missing
from its request is asked for alone.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal
from unicodedata import normalize

from fastapi import Request
from pydantic import AfterValidator, BaseModel, Field, ValidationError, ValidationInfo, field_validator
from starlette.datastructures import FormData, UploadFile
from starlette.responses import RedirectResponse, Response

from hyperval.atmosphere.state import AtmosphericState
from hyperval.config import RadianceUnit
from hyperval.errors import HypervalError, package_table
from hyperval.paths import checked_file
from hyperval.sensor.specification import library_names
from hyperval.storage import whole_file
from hyperval.web.forms import by_field
from hyperval.web.pages import SentForm, api, owner_of, page, pages
from hyperval.web.refusal import FieldMistake, Refusal, deny, form_mistakes, mistakes_of, redact
from hyperval.web.runs import RunAnswer, answer_of
from hyperval.web.store import WebRun

_MAX_KEPT = 50
_FIELDS = package_table("web/uploads.yaml")
_OF_SCENARIOS = ("spectra", "sensors")  # which stay when their collection has been taken
PARTS = [field for field in _FIELDS if field != "sensors"]  # of a collection
_PACKED = {b"PK\x03\x04": "a zip archive", b"\x1f\x8b": "packed by gzip", b"<?xml": "XML", b"BZh": "packed by bzip2"}
_MAX_TEXT = 4_000_000
_INSIDE = re.compile(r"(?:\w[\w .@+()-]{0,100}/){0,12}\w[\w .@+()-]{0,100}")
_NAME = re.compile(r"[^\W_][\w .@+()-]{0,79}")
_NAME_WORDS = "letters, digits, blanks and . _ - + @ ( ), at most 80 characters, a letter or digit first"


class Uploads:
    """Files that the session of a request brought: a folder for each field.

    Parameters
    ----------
    request : whose session and server they are

    >>> names = "Überflug 4 (2).hdr", " a.img", ".profile", "_a", "a/b", "a" * 80, "a" * 81
    >>> [bool(_NAME.fullmatch(name)) for name in names]
    [True, False, False, False, False, True, False]
    >>> [bool(_INSIDE.fullmatch(name)) for name in ("line 4/a.img", "../a.img", "a/../b", "a//b", "/a")]
    [True, False, False, False, False]
    """

    def __init__(self, request: Request):
        self._state = request.app.state
        self.owner = owner_of(request)
        self.folder: Path = self._state.settings.folder / "uploads" / self.owner

    def names(self, *fields: str) -> tuple[str, ...]:
        """Names of the files of some fields; of those that scenarios may name where none is given."""
        folders = (self.folder / field for field in fields or _OF_SCENARIOS)
        return tuple(sorted(path.name for folder in folders for path in folder.glob("[!.]*") if path.is_file()))

    def copies(self, text: str, beside: Path | None = None) -> dict[str, Path]:
        """Files that the text of a scenario names, first those ``beside`` it, by their names in a run."""
        named = {name: self.folder / kind / name for kind in _OF_SCENARIOS for name in self.names(kind) if name in text}
        return named | {name: path for name in named if beside is not None and (path := beside / name).is_file()}

    def iter_files(self, form: FormData) -> Iterator[tuple[str, Callable[[], Path]]]:
        """Field of each file of a form, and how to get it: uploaded, kept from an earlier request, or named."""
        for field, file in form.multi_items():
            if isinstance(file, UploadFile) and field in _FIELDS and (file.filename or file.size):
                yield field, partial(self._keep, field, file)
        for field in PARTS:  # uploaded parts of a cube have replaced those that were kept
            for name in {*form.getlist(f"{field}_kept")} & {*self.names(field)}:
                yield field, partial((self.folder / field).joinpath, str(name))
            for name in filter(None, (n.strip() for n in str(form.get(f"{field}_named") or "").split(","))):
                yield field, partial(self._data_file, field, name)

    def _keep(self, field: str, file: UploadFile) -> Path:
        """Keep a file under its field; a new one takes the place of one of its name, and of any other of a cube."""
        name, place = normalize("NFC", file.filename or ""), self.folder / field
        if not _NAME.fullmatch(name) or len(name.encode()) > 240:  # most file systems take 255 bytes
            odd = "".join(dict.fromkeys(c for c in name if c.isprintable() and not re.match(r"[\w .@+()-]", c)))
            words = f"not a name for a file kept here{f', for its {odd}' if odd else ''}: {_NAME_WORDS}"
            raise Refusal(422, [FieldMistake(field, words)])
        with whole_file(place / name) as part:
            with part.open("wb") as out:
                shutil.copyfileobj(file.file, out)
            self._check(field, name, part)
            deny(len({*self.names(field), name}) > _MAX_KEPT, 422, f"a session keeps at most {_MAX_KEPT}", field)
            for other in self.names(field) if field in ("cube", "header") else ():
                (place / other).unlink()
        return place / name

    def _check(self, field: str, name: str, path: Path) -> None:
        """Refuse a file by the ending of its name, its head or its size; one of a sensor by what it says."""
        with path.open("rb") as file:
            head = file.read(8)
        packed = next((kind for sign, kind in _PACKED.items() if head.startswith(sign)), None)
        largest = self._state.settings.samples * 8 if field == "cube" else _MAX_TEXT
        endings, is_large = _FIELDS[field]["endings"], path.stat().st_size > largest
        words = f"{name}: ends with none of {', '.join(filter(None, endings))}"
        deny(Path(name).suffix.lower() not in endings, 422, words, field)
        deny(packed, 422, f"{name}: is {packed}, which is not accepted", field)
        deny(is_large, 422, f"{name}: larger than {largest:,} bytes", field)
        if field == "sensors":
            try:
                self._state.runs.ask("sensor", field, name_or_path=str(path))
            except Refusal as refusal:
                words = form_mistakes(refusal)[0].message.replace(path.name, name)
                mistake = FieldMistake("sensors", words if words.startswith(name) else f"{name}: {words}")
                raise Refusal(422, [mistake]) from refusal

    def _data_file(self, field: str, name: str) -> Path:
        """A file of the data folder that a form names."""
        data = self._state.settings.data
        with suppress(HypervalError, OSError):
            if data is not None and _INSIDE.fullmatch(name):
                path = checked_file(data / name, root=data)
                self._check(field, path.name, path)
                return path
        raise Refusal(422, [FieldMistake(f"{field}_named", "the data folder of this server has no such file")])


class StatedCollection(BaseModel):
    """What a person says of a collection; blank entries are left out.

    >>> percent = {"quantity": "reflectance", "unit": "percent"}
    >>> for wrong in ({"time_utc": "4.6.2018 10:00"}, {"unit": "furlongs"}, percent):
    ...     try:
    ...         StatedCollection(**wrong)
    ...     except ValidationError as error:
    ...         mistakes = mistakes_of(error.errors())
    >>> mistakes
    [FieldMistake(field='unit', message='a reflectance has none; of percent the scale is 0.01')]
    """

    name: str = Field("mine", max_length=60, pattern="^[a-z0-9][a-z0-9-]*$")
    quantity: Literal["radiance", "reflectance"] | None = None
    unit: RadianceUnit | None = Field(None, max_length=60)
    sensor: Literal[library_names()] | None = None  # type: ignore[valid-type]
    time_utc: Annotated[str | None, AfterValidator(AtmosphericState._is_a_time)] = Field(None, max_length=60)
    altitude_km: float | None = Field(None, ge=0.01, le=100_000, allow_inf_nan=False)
    pixel_size_m: float | None = Field(None, ge=0.001, le=10_000, allow_inf_nan=False)
    scale: float | None = Field(None, gt=0.0, allow_inf_nan=False)

    @field_validator("unit", mode="before")
    @classmethod
    def _is_of_radiance(cls, value: Any, info: ValidationInfo) -> Any:
        if info.data.get("quantity") == "reflectance":
            raise ValueError("a reflectance has none; of percent the scale is 0.01")
        return value


@pages.get("/bring")
def upload_form(request: Request) -> Response:
    """The form of uploads."""
    return _page(request, {})


@pages.post("/uploads")
def uploads_page(request: Request, form: SentForm) -> Response:
    """Take files: a cube runs through the empirical pipeline, spectra and sensor files are kept."""
    try:
        taken = take_files(request, form)
    except Refusal as refusal:
        fields = {name: value for name, value in form.items() if isinstance(value, str)}
        return _page(request, fields, form_mistakes(refusal))
    return RedirectResponse(f"/runs/{taken.id}" if isinstance(taken, WebRun) else "/bring", status_code=303)


def _page(request: Request, fields: Mapping[str, str], mistakes: Sequence[FieldMistake] = ()) -> Response:
    settings, uploads = request.app.state.settings, Uploads(request)
    errors = by_field(mistakes, [mistake.field for mistake in mistakes])
    return page(
        request, "uploads.html.j2", errors=errors, given=fields, most=settings.upload_bytes,
        has_data=settings.data is not None, sensors=library_names(),
        kept={field: uploads.names(field) for field in _FIELDS}, parts={field: _FIELDS[field] for field in PARTS},
    )  # fmt: skip


def take_files(request: Request, form: FormData) -> WebRun | list[str]:
    """The run of the cube of a form, or the names of the spectra and sensor files that are kept where it has none.

    Raises
    ------
    Refusal : what is wrong with them, or there is no room; what was right is kept none the less.
    """
    uploads, state, mistakes = Uploads(request), request.app.state, list[FieldMistake]()
    files: dict[str, tuple[str, Path]] = {}  # name in the collection -> its field, and where it is
    fields = set[str]()
    for field, find in uploads.iter_files(form):
        fields.add(field)
        try:
            path = find()
        except Refusal as refusal:
            mistakes += refusal.mistakes
            continue
        if files.setdefault(path.name, (field, path)) != (field, path):
            mistakes.append(FieldMistake(field, f"{path.name}: was given twice"))
    state.runs.clear()
    others = any(form.get(f"{field}_{end}") for field in PARTS for end in ("kept", "named"))
    is_cube = others or not fields or bool(fields - {*_OF_SCENARIOS})
    parts = {field: [name for name, (sender, _) in files.items() if sender == field] for field in PARTS}
    stated = StatedCollection()
    if is_cube:
        wrong = {mistake.field.removesuffix("_named") for mistake in mistakes}
        needed = {field: _FIELDS[field]["needed"] for field in parts if "needed" in _FIELDS[field]}
        lacking = [field for field in needed if not parts[field] or (field == "cube" and len(parts[field]) > 1)]
        mistakes += [FieldMistake(field, needed[field]) for field in lacking if field not in wrong]
        texts = {name: text for name in StatedCollection.model_fields if (text := str(form.get(name) or "").strip())}
        try:
            stated = StatedCollection.model_validate(texts)
        except ValidationError as error:
            mistakes += mistakes_of(error.errors())
    deny(mistakes, 422)
    if not is_cube:
        return list(uploads.names())
    about: dict[str, Any] = {"stated": stated.model_dump(exclude_none=True), "most": state.settings.samples}
    sent = {part: [str(path) for sender, path in files.values() if sender == part] for part in PARTS}
    for key, what in state.runs.ask("draft", "cube", files=sent, **about):
        field, words = key.rpartition(".")[2], redact(f"the files do not say it: {what}")
        if key.startswith("collection."):
            mistakes.append(FieldMistake(field if field in StatedCollection.model_fields else "header", words))
    deny(mistakes, 422)
    run: WebRun = state.runs.order(
        uploads.owner, "pipeline", stated.name, f"{stated.name}: {parts['cube'][0]}",
        {f"collection/{name}": path for name, (_, path) in files.items()}, parts=parts, **about,
    )  # fmt: skip
    for field in {*PARTS} - {*_OF_SCENARIOS}:
        shutil.rmtree(uploads.folder / field, ignore_errors=True)
    return run


class UploadAnswer(BaseModel):
    """What came of files: the run of a cube, or the names of all spectra and sensor files that are kept."""

    run: RunAnswer | None = None
    kept: list[str] = []


_FILE = {"type": "string", "format": "binary"}
_BODY: dict[str, Any] = {
    **{field: {"type": "array", "items": _FILE} if "several" in entry else _FILE for field, entry in _FIELDS.items()},
    **StatedCollection.model_json_schema()["properties"],
    **{
        f"{part}_{end}": {"type": "string", "description": words}
        for part in PARTS
        for end, words in (("named", "of the server's data folder, not sent"), ("kept", "of an earlier request"))
    },
}
_FORM = {"multipart/form-data": {"schema": {"type": "object", "properties": _BODY}}}


@api.post("/uploads", status_code=201, openapi_extra={"requestBody": {"required": True, "content": _FORM}})
def uploads(request: Request, form: SentForm) -> UploadAnswer:
    """Bring a cube with regions and spectra, on which the empirical pipeline runs.

    Field spectra and sensor files without a cube are kept for the scenarios of this session.
    """
    taken = take_files(request, form)
    return UploadAnswer(run=answer_of(request, taken)) if isinstance(taken, WebRun) else UploadAnswer(kept=taken)

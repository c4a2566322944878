"""Files that a session brought: kept apart from those of others, under names that are no paths."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from hyperval.web.limits import Settings
from hyperval.web.refusal import Mistake, Refused

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,60}(?:\.[A-Za-z0-9_-]{1,12}){0,2}")
KINDS = ("spectra", "sensors")
SPECTRA = (".txt", ".csv", ".asd", ".sli", ".sed", ".sig")


def folder_of(settings: Settings, owner: str) -> Path:
    """The folder of a session's uploads."""
    return settings.folder / "uploads" / owner


def checked_name(name: str) -> str:
    """A name under which a file may be kept.

    Raises
    ------
    Refused : it is a path, or holds what a name of a file had better not hold.
    """
    if not NAME.fullmatch(name):
        words = "letters, digits, - and _, with one or two endings, at most 80 characters"
        raise Refused(422, [Mistake("name", f"no name that a file is kept under here: {words}")])
    return name


def files_of(settings: Settings, owner: str, kinds: Sequence[str] = KINDS) -> tuple[str, ...]:
    """Names of the spectra and sensor files that a session brought."""
    folders = [folder_of(settings, owner) / kind for kind in kinds]
    return tuple(sorted(p.name for folder in folders if folder.is_dir() for p in folder.iterdir() if p.is_file()))


def copies_of(settings: Settings, owner: str, text: str, names: Collection[str]) -> dict[str, Path]:
    """Files that the text of a scenario names, by the name that the run keeps them under."""
    folder = folder_of(settings, owner)
    places = {name: folder / kind / name for kind in KINDS for name in files_of(settings, owner, [kind])}
    return {name: places[name] for name in names if name in text}

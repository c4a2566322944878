"""The content of a campaign file that is being drafted, and its text with each guess marked."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml


@dataclass(frozen=True)
class Sources:
    """What the user names.

    Attributes
    ----------
    cube, regions, targets, spectra : files; a folder of spectra stands for its files
    header, quantity, unit, sensor, time_utc, altitude_km, pixel_size_m : where the files do not say it
    """

    cube: Path
    regions: Sequence[Path] = ()
    targets: Path | None = None
    spectra: Sequence[Path] = ()
    header: Path | None = None
    quantity: str | None = None
    unit: str | None = None
    sensor: str | None = None
    time_utc: str | None = None
    altitude_km: float | None = None
    pixel_size_m: float | None = None


@dataclass
class Draft:
    """The content of a campaign file that grows, with its guesses by place, and where it will stand."""

    folder: Path
    content: dict[str, Any] = field(default_factory=dict)
    guesses: dict[tuple[str, ...], str] = field(default_factory=dict)

    def reference(self, path: Path) -> str:
        """A file as the campaign names it: relative to the campaign's own folder."""
        return os.path.relpath(path.resolve(), self.folder.resolve())

    def guess(self, *at: str, because: str) -> None:
        """Mark the value at a place of the content."""
        self.guesses[at] = because


def draft_text(draft: Draft) -> str:
    """The campaign file: what was guessed has a comment before it."""
    head = "# Written by hyperval init. What stands after 'guess' was not stated by any file: look it over.\n"
    return head + "".join(_lines(draft.content, (), 0, draft.guesses))


def _lines(
    content: Mapping[str, Any], at: tuple[str, ...], indent: int, guesses: Mapping[tuple[str, ...], str]
) -> list[str]:
    pad = " " * indent
    out = []
    for key, value in content.items():
        place = (*at, key)
        if place in guesses:
            out.append(f"{pad}# guess: {guesses[place]}\n")
        inside = any(g[: len(place)] == place and len(g) > len(place) for g in guesses)
        if inside and isinstance(value, dict):
            out += [f"{pad}{key}:\n", *_lines(value, place, indent + 2, guesses)]
        elif inside and isinstance(value, list):  # of one mapping
            first, *rest = _lines(value[0], place, indent + 4, guesses)
            out += [f"{pad}{key}:\n", f"{pad}  - {first.lstrip()}", *rest]
        else:
            inline = None if isinstance(value, dict | list) and key != "assumptions" else False
            dumped = yaml.safe_dump(
                {key: value}, sort_keys=False, allow_unicode=True, width=112 - indent, default_flow_style=inline
            )
            out += [f"{pad}{line}\n" for line in dumped.splitlines()]
    return out

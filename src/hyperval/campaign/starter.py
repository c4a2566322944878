"""The first draft of a campaign, from what a cube, its regions, its targets and field spectra say of themselves.

Each value that no file states is a guess: marked in the file, and an assumption of the campaign, so that the report
shows it.  What cannot be guessed, such as the time of the flight, is left to be filled in.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hyperval.campaign.starter_draft import Draft, Sources, draft_text
from hyperval.campaign.starter_scene import (
    add_targets,
    empirical_line,
    field_spectra,
    matching_spectrum,
    materials,
    panels_among,
    scenario,
)
from hyperval.campaign.usual import usual_comparisons
from hyperval.collection import Collection
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery.rasters import Raster, open_raster
from hyperval.observe.place import Place, open_place
from hyperval.units import radiance_to_internal

_SCALES = (0.01, 0.001, 0.0001)  # percent, and reflectance times 1000 or 10000


def starter_campaign(sources: Sources, folder: Path, name: str) -> tuple[str, list[str]]:
    """The text of a campaign file for ``folder``, and its guesses in words.

    Raises
    ------
    InputError : files that are missing or corrupt, regions outside the image.
    UsageError : a quantity, unit or sensor that neither the files nor the user say, or nothing to predict from.
    """
    draft = Draft(folder)
    raster = open_raster(sources.cube, header=sources.header)
    quantity = sources.quantity or stated_quantity(raster)
    collection: dict[str, Any] = {"cube": _cube(sources, raster, quantity, draft)}
    collection["regions"] = [{"file": draft.reference(path)} for path in sources.regions] or [
        {"name": "whole image", "whole_image": True}
    ]
    _scale(collection, raster, draft)
    for entry in collection["regions"] if sources.regions else ():
        _coordinates(collection, entry, draft)
    place = _place(sources, collection, draft)
    spectra = field_spectra(sources.spectra)
    draft.content = {
        "schema": 1,
        "name": name,
        "title": f"{name}: {quantity} of {sources.cube.name}",
        "description": f"{quantity.capitalize()} image of {place.cube.lines} lines, {place.cube.samples} samples "
        f"and {place.cube.bands} bands; written from its files, not yet looked over.",
        "assumptions": [],
        "collection": collection,
    }
    matched = {region: match for region in place.regions if (match := matching_spectrum(region, spectra))}
    panels = panels_among(place.regions, matched)
    if quantity == "radiance":
        empirical_line(draft, panels, matched)
    if panels:
        collection["leave_out"] = panels
        collection["snr_regions"] = panels
    model = scenario(sources, place, quantity, panels, matched, draft)
    add_targets(place, spectra, model, draft)
    draft.content["scenarios"] = [model]
    draft.content["comparisons"] = usual_comparisons(draft.content)
    if not draft.content["comparisons"]:
        raise UsageError(
            "nothing to compare: no region and no target goes with a spectrum by name",
            where=str(sources.cube),
            expected=f"spectra named as {', '.join([*place.regions, *materials(place)])}",
            mend="name the files of field spectra with --spectra, or the records as the regions",
        )
    guesses = [f"{'.'.join(at)}: {because}" for at, because in draft.guesses.items()]
    draft.content["assumptions"] = [f"guess: {text}" for text in guesses] or ["none beyond what the files state"]
    return draft_text(draft), guesses


def stated_quantity(raster: Raster) -> str:
    """Whether an image holds radiance or reflectance, by its metadata, else by its name.

    Raises
    ------
    UsageError : they do not say, or say both.
    """
    about = raster.description
    if about is not None and about.quantity is not None:
        return about.quantity
    entries = raster.header.extras if raster.header is not None else about.entries if about is not None else {}
    words = " ".join(text for key, text in entries.items() if re.search(r"unit|plot titles|description|level", key))
    patterns = {
        "radiance": r"radiance|(?<![a-z])(rdn|rad)(?![a-z])",
        "reflectance": r"refl|(?<![a-z])(rfl|ref)(?![a-z])",
    }
    for text in (words.lower(), raster.path.name.lower()):
        named = [quantity for quantity, pattern in patterns.items() if re.search(pattern, text)]
        if len(named) == 1:
            return named[0]
        if not named and _stated_unit(raster) is not None:
            return "radiance"
    raise UsageError(
        "the files do not say whether the image holds radiance or reflectance",
        where=str(raster.path),
        mend="add --quantity radiance or --quantity reflectance",
    )


def _cube(sources: Sources, raster: Raster, quantity: str, draft: Draft) -> dict[str, Any]:
    entry: dict[str, Any] = {"path": draft.reference(sources.cube), "quantity": quantity}
    if sources.header is not None:
        entry["header"] = draft.reference(sources.header)
    if sources.quantity is None and (raster.description is None or raster.description.quantity is None):
        draft.guess(
            "collection", "cube", "quantity", because=f"{quantity}, by the words of the header or the file name"
        )
    if quantity == "radiance":
        unit = sources.unit or _stated_unit(raster)
        if unit is not None:
            entry["unit"] = unit
        elif raster.description is None or raster.description.unit is None:
            raise UsageError(
                "the files do not say the unit of the radiance",
                where=str(raster.path),
                mend="add --unit, such as --unit 'uW cm-2 sr-1 nm-1'",
            )
    return entry


def _stated_unit(raster: Raster) -> str | None:
    """The radiance unit that a header entry states, None where none is understood."""
    entries: Mapping[str, str] = raster.header.extras if raster.header is not None else {}
    for key, text in entries.items():
        if re.search(r"unit", key) and "wavelength" not in key:
            try:
                radiance_to_internal(text.strip())
            except HypervalError:
                continue
            return text.strip()
    return None


def _opened(collection: Mapping[str, Any], draft: Draft, **parts: Any) -> Place:
    """The collection as it stands, with only these parts beside its cube."""
    content = {"cube": collection["cube"], **parts}

    def resolve(reference: str) -> Path:
        return Path(os.path.normpath(draft.folder.resolve() / reference))

    return open_place(Collection.model_validate(content), resolve, show_progress=False)


def _scale(collection: dict[str, Any], raster: Raster, draft: Draft) -> None:
    """State the scale of an image whose header does not.

    Of reflectance, the largest that makes reflectances of the values; of radiance, the divisor that the header
    states for a reflectance, as some programs write it for either.
    """
    try:
        _opened(collection, draft)
    except InputError as error:
        if "state scale" not in (error.mend or ""):
            raise
        if collection["cube"]["quantity"] != "reflectance":
            factor = raster.header.number("reflectance scale factor") if raster.header is not None else None
            if factor is None or raster.header is None or "data gain values" in raster.header.entries:
                raise
            collection["cube"]["scale"] = 1.0 / factor
            because = f"1/{factor:g}: the header has a 'reflectance scale factor' although it holds radiance"
            draft.guess("collection", "cube", "scale", because=because)
            _opened(collection, draft)
            return
        for scale in _SCALES:
            collection["cube"]["scale"] = scale
            try:
                _opened(collection, draft)
            except InputError:
                continue
            because = f"{scale:g}, the largest that makes the values reflectances"
            draft.guess("collection", "cube", "scale", because=because)
            return
        raise


def _coordinates(collection: Mapping[str, Any], entry: dict[str, Any], draft: Draft) -> None:
    """State what the coordinates of a file of regions are, where they are not those that its format has."""
    first: HypervalError | None = None
    for kind in ({}, {"coordinates": "pixel"}, {"coordinates": "map"}):
        try:
            _opened(collection, draft, regions=[entry | kind])
        except HypervalError as error:
            first = first or error
            continue
        entry |= kind
        if kind:
            draft.guess("collection", "regions", because=f"{entry['file']}: {kind['coordinates']} coordinates")
        return
    assert first is not None  # noqa: S101 - each way failed
    raise first


def _place(sources: Sources, collection: dict[str, Any], draft: Draft) -> Place:
    """The opened collection, its targets one material for each region of their file."""
    parts: dict[str, Any] = {"regions": collection["regions"]}
    if sources.targets is None:
        return _opened(collection, draft, **parts)
    truth = _truth(sources, draft)
    place = _opened(collection, draft, **parts, targets=truth)
    if "regions" in truth:
        file = truth["regions"][0]["file"]
        names = list(dict.fromkeys(target.attributes["region"] for target in place.targets))
        truth["regions"] = [{"material": name, "file": file, "regions": [name]} for name in names]
        place = _opened(collection, draft, **parts, targets=truth)
    collection["targets"] = truth
    return place


def _truth(sources: Sources, draft: Draft) -> dict[str, Any]:
    assert sources.targets is not None  # noqa: S101 - the caller asks where there are targets
    truth: dict[str, Any] = {"guard_pixels": 2}
    if sources.pixel_size_m is not None:
        truth["pixel_size_m"] = sources.pixel_size_m
    path = draft.reference(sources.targets)
    if _is_list(sources.targets):
        return {"csv": path, **truth}
    return {"regions": [{"material": "every region", "file": path}], **truth}


def _is_list(path: Path) -> bool:
    """Whether a file is a list of target centres: a table with a column of materials."""
    if path.suffix.lower() != ".csv":
        return False
    with path.open("r", encoding="utf-8-sig", errors="replace") as file:
        return "material" in file.readline(4096).lower()

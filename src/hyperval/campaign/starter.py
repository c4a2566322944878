"""The first draft of a campaign, from what a cube, its regions, its targets and field spectra say of themselves.

Each value that no file states is a guess: marked in the file, and an assumption of the campaign, so that the report
shows it.  What cannot be guessed, such as the time of the flight, is left to be filled in.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rasterio import warp

from hyperval.campaign.usual import usual_comparisons
from hyperval.collection import Collection
from hyperval.config import FILL_IN
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery.rasters import Raster, open_raster
from hyperval.imagery.regions import guard
from hyperval.imagery.truth import TargetObject
from hyperval.observe.place import Place, open_place
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.readers import read_records
from hyperval.units import radiance_to_internal

_PANEL = re.compile(r"panel|tarp|calib|spectralon|permaflect", re.IGNORECASE)
_SCALES = (0.01, 0.001, 0.0001)  # percent, and reflectance times 1000 or 10000
_REFLECTANCE_UNITS = ("fraction", "percent", "scaled:1000", "scaled:10000")
_RING_PIXELS = 4.0


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


@dataclass(frozen=True)
class Spectrum:
    """A field spectrum that a name of the scene may go with."""

    name: str
    path: Path
    record: str | None
    unit: str | None
    guessed: bool

    def source(self, draft: Draft) -> dict[str, Any]:
        """As a scenario names it."""
        entry: dict[str, Any] = {"file": draft.reference(self.path)}
        if self.record is not None:
            entry["record"] = self.record
        if self.unit is not None:
            entry["reflectance_unit"] = self.unit
        return entry


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
    _scale(collection, draft)
    for entry in collection["regions"] if sources.regions else ():
        _coordinates(collection, entry, draft)
    place = _place(sources, collection, draft)
    spectra = _spectra(sources.spectra)
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
    panels = [region for region in place.regions if _PANEL.search(region)]
    if quantity == "radiance":
        _empirical_line(draft, panels, matched)
    if panels:
        collection["leave_out"] = panels
        collection["snr_regions"] = panels
    scenario = _scenario(sources, place, quantity, panels, matched, draft)
    _targets(place, spectra, scenario, draft)
    draft.content["scenarios"] = [scenario]
    draft.content["comparisons"] = usual_comparisons(draft.content)
    if not draft.content["comparisons"]:
        raise UsageError(
            "nothing to compare: no region and no target goes with a spectrum by name",
            where=str(sources.cube),
            expected=f"spectra named as {', '.join([*place.regions, *_materials(place)])}",
            mend="name the files of field spectra with --spectra, or the records as the regions",
        )
    guesses = [f"{'.'.join(at)}: {because}" for at, because in draft.guesses.items()]
    draft.content["assumptions"] = [f"guess: {text}" for text in guesses] or ["none beyond what the files state"]
    return _text(draft), guesses


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
    told = " ".join(text for key, text in entries.items() if re.search(r"unit|plot titles|description|level", key))
    patterns = {
        "radiance": r"radiance|(?<![a-z])(rdn|rad)(?![a-z])",
        "reflectance": r"refl|(?<![a-z])(rfl|ref)(?![a-z])",
    }
    for text in (told.lower(), raster.path.name.lower()):
        named = [quantity for quantity, pattern in patterns.items() if re.search(pattern, text)]
        if len(named) == 1:
            return named[0]
    raise UsageError(
        "the files do not say whether the image holds radiance or reflectance",
        where=str(raster.path),
        mend="add --quantity radiance or --quantity reflectance",
    )


def matching_spectrum(name: str, spectra: Sequence[Spectrum]) -> Spectrum | None:
    """The spectrum of the same name, else the only one with all its words, else the only one whose words it has."""
    words = _words(name)
    tests: tuple[Callable[[frozenset[str]], bool], ...] = (
        lambda other: other == words,
        lambda other: other >= words,
        lambda other: other <= words,
    )
    for test in tests:
        fits = [s for s in spectra if _words(s.name) and test(_words(s.name))]
        if len(fits) == 1:
            return fits[0]
    return None


def _words(name: str) -> frozenset[str]:
    """Words and numbers of a name in small letters; CamelCase and underscores part them."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return frozenset(re.findall(r"[a-z]+|[0-9]+", parted.lower()))


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


def _scale(collection: dict[str, Any], draft: Draft) -> None:
    """State the scale of a reflectance image whose header does not: the largest that makes reflectances of it."""
    try:
        _opened(collection, draft)
    except InputError as error:
        if collection["cube"]["quantity"] != "reflectance" or "state scale" not in (error.mend or ""):
            raise
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


def _spectra(paths: Sequence[Path]) -> list[Spectrum]:
    """The reflectance spectra of the files, with the unit that each needs to be told."""
    files = [f for path in paths for f in (sorted(path.iterdir()) if path.is_dir() else [path]) if f.is_file()]
    out: list[Spectrum] = []
    for path in files:
        listed = path in paths
        try:
            out += _records(path)
        except HypervalError:
            if listed:  # of a folder only the files that hold spectra count
                raise
    return out


def _records(path: Path) -> list[Spectrum]:
    for unit in (None, *_REFLECTANCE_UNITS):
        try:
            records = read_records(path, reflectance_unit=unit)
        except (UsageError, InputError):
            if unit == _REFLECTANCE_UNITS[-1]:
                break
            continue
        highest = max((float(np.nanpercentile(r.values, 95)) for r in records), default=0.0)
        if unit is None or highest <= 1.5:
            several = len(records) > 1
            return [
                Spectrum(
                    r.name if several else path.stem, path, r.name if several else None, unit, unit is not None
                )
                for r in records
            ]
    read_records(path)  # the reader's own words for what is wrong
    raise InputError("no reflectance in any usual unit", where=str(path))


def _empirical_line(draft: Draft, panels: Sequence[str], matched: Mapping[str, Spectrum]) -> None:
    known = [panel for panel in panels if panel in matched]
    if len(known) < 2:
        return
    entries = [{"region": panel, "spectrum": matched[panel].source(draft)} for panel in known]
    draft.content["collection"]["empirical_line"] = {"panels": entries}
    draft.guess("collection", "empirical_line", because=f"through {', '.join(known)}: regions named as panels")


def _scenario(
    sources: Sources,
    place: Place,
    quantity: str,
    panels: Sequence[str],
    matched: Mapping[str, Spectrum],
    draft: Draft,
) -> dict[str, Any]:
    ground = [region for region in place.regions if region not in panels]
    measured = quantity == "reflectance" or "empirical_line" in draft.content["collection"]
    classes = [region for region in ground if measured or region in matched]
    if not classes:
        raise UsageError(
            "no region of the ground has a reflectance: the model has nothing to predict from",
            where=str(sources.cube),
            expected=f"spectra named as {', '.join(ground) or 'regions'}",
            mend="name the files of field spectra with --spectra, or two panels for an empirical line",
        )
    pixels = np.array([place.pixels_of(region).sum() for region in classes], float)
    shares = np.round(pixels / pixels.sum(), 4)
    shares[-1] = 1.0 - shares[:-1].sum()
    scene: dict[str, Any] = {
        "classes": [
            {"name": region, "fraction": round(float(share), 4), "spectrum": {"measured": region}}
            if region not in matched
            else {
                "name": region,
                "fraction": round(float(share), 4),
                "spectrum": matched[region].source(draft),
                "covariance": {"measured": region} if measured else {"relative_sd": 0.1},
            }
            for region, share in zip(classes, shares, strict=True)
        ],
        "adjacency": {"effective_neighbours": None},
    }
    draft.guess("scenarios", "scene", "classes", because="area fractions as those of the regions' pixels")
    known = [panel for panel in panels if panel in matched]
    if known:
        scene["panels"] = [{"name": panel, "spectrum": matched[panel].source(draft)} for panel in known]
    scenario: dict[str, Any] = {"schema": 1, "name": draft.content["name"]}
    if quantity == "radiance":
        scenario |= _flight(sources, place, draft)
        scenario["uncertainty"] = {"aot550": 0.05, "water_vapour_g_cm2": 0.5}
        draft.guess("scenarios", "uncertainty", "aot550", because="of the two guesses of the atmosphere")
        draft.content["collection"]["calibration"] = {"relative": 0.05}
        draft.guess("collection", "calibration", because="5 %, common to all bands")
    scenario["scene"] = scene
    scenario["processing"] = {"detectors": ["cem"], "bands": {"drop_bad": True}}
    if not (quantity == "radiance" and measured):
        scenario["processing"]["elm"] = "none"
    subjects = [*(c["name"] for c in scene["classes"] if c["name"] in matched), *known]
    if subjects:
        _spectra_known_to(scenario, subjects, draft)
    return scenario


def _flight(sources: Sources, place: Place, draft: Draft) -> dict[str, Any]:
    """Atmosphere, sun and sensor."""
    state: dict[str, Any] = {"aot550": 0.1, "water_vapour_g_cm2": 1.5, "ground_altitude_km": 0.0}
    draft.guess(
        "scenarios", "atmosphere", because="aerosol depth 0.1, 1.5 g cm-2 of water and a ground at sea level"
    )
    state["sensor_altitude_km"] = sources.altitude_km or f"{FILL_IN}: sensor above sea level [km]"
    centre = _centre(place)
    if centre is None:
        state["latitude_deg"] = f"{FILL_IN}: latitude, north positive [deg]"
        state["longitude_deg"] = f"{FILL_IN}: longitude, east positive [deg]"
    else:
        state["latitude_deg"], state["longitude_deg"] = centre
    state["time_utc"] = sources.time_utc or f"{FILL_IN}: time of the line, such as 2012-09-20T16:31:00Z"
    sensor = sources.sensor or _library_sensor(place.cube.axis, draft, sources.cube)
    return {"atmosphere": state, "sensor": draft.reference(Path(sensor)) if Path(sensor).is_file() else sensor}


def _centre(place: Place) -> tuple[float, float] | None:
    """Latitude and longitude of the middle of the image [deg], None where it has no position."""
    cube = place.cube
    if cube.transform is None or cube.crs is None:
        return None
    x, y = cube.transform @ (cube.samples / 2, cube.lines / 2)
    longitude, latitude = warp.transform(cube.crs, "EPSG:4326", [x], [y])
    return round(latitude[0], 4), round(longitude[0], 4)


def _library_sensor(axis: SpectralAxis, draft: Draft, cube: Path) -> str:
    """The sensor of the library with these bands."""
    for name in library_names():
        own = load_sensor(name).axis
        if len(own) == len(axis) and np.all(np.abs(own.centre_nm - axis.centre_nm) < own.fwhm_nm):
            draft.guess("scenarios", "sensor", because=f"{name}, whose bands these are")
            return name
    raise UsageError(
        f"no sensor of the library has the {len(axis)} bands of the image",
        where=str(cube),
        expected="one of: hyperval sensor list",
        mend="name a sensor file with --sensor; hyperval sensor new writes one to be filled in",
    )


def _materials(place: Place) -> list[str]:
    return list(dict.fromkeys(target.material for target in place.targets))


def _targets(place: Place, spectra: Sequence[Spectrum], scenario: dict[str, Any], draft: Draft) -> None:
    """Detection in the image, and the targets of the model."""
    known = {m: match for m in _materials(place) if (match := matching_spectrum(m, spectra))}
    if not known:
        return
    draft.content["detection"] = {
        "group": "{material}",
        "detectors": ["cem"],
        "targets": [
            {"name": material, "material": material, "spectrum": match.source(draft)}
            for material, match in known.items()
        ],
    }
    classes = [c["name"] for c in scenario["scene"]["classes"]]
    entries = []
    for material, match in known.items():
        objects = [target for target in place.targets if target.material == material]
        entries.append(
            {
                "name": material,
                "spectrum": match.source(draft),
                "covariance": {"relative_sd": 0.03, "band_sd": 0.001},
                "host": _host(place, objects, classes),
                "fill": _fill(place, objects),
            }
        )
    scenario["scene"]["targets"] = entries
    draft.guess(
        "scenarios",
        "scene",
        "targets",
        because="host: the class most seen around a target; fill: by a square of the target's size, or of as many "
        "pixels; a spread of 3 % from pixel to pixel",
    )
    _spectra_known_to(scenario, list(known), draft)


def _spectra_known_to(scenario: dict[str, Any], subjects: Sequence[str], draft: Draft) -> None:
    entries = [{"subject": subject, "relative": 0.05} for subject in subjects]
    scenario.setdefault("uncertainty", {}).setdefault("field_spectra", []).extend(entries)
    draft.guess("scenarios", "uncertainty", "field_spectra", because="known to 5 %, the same in all bands")


def _host(place: Place, objects: Sequence[TargetObject], classes: Sequence[str]) -> str:
    """The class with the most pixels around the targets."""
    own = np.zeros(place.cube.shape, bool)
    for target in objects:
        target.paint(own)
    ring = guard(own, _RING_PIXELS) & ~place.near_targets
    return max(classes, key=lambda name: int(np.sum(ring & place.region(name))))


def _fill(place: Place, objects: Sequence[TargetObject]) -> dict[str, Any]:
    """Fill from the geometry of the objects of a material; whole pixels where the ground size is not known."""
    if place.pixel_area_m2 is None:
        return {"fixed": 1.0}
    gsd = math.sqrt(place.pixel_area_m2)
    pixels = float(np.mean([target.part.sum() for target in objects]))
    sides = [target.side_m for target in objects if math.isfinite(target.side_m)]
    side = float(np.mean(sides)) if sides else gsd * math.sqrt(pixels)
    shape = {"side_m": round(side, 3), "heading_deg": "random", "gsd_m": round(gsd, 4)}
    return {"geometry": {**shape, "pixels": "ranked", "n": max(1, min(400, round(pixels)))}}


def _text(draft: Draft) -> str:
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

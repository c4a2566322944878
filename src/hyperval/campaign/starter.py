"""The first draft of a campaign, from what a cube, its regions, its targets and field spectra say of themselves.

Each value that no file states is a guess: marked in the file, and an assumption of the campaign, so that the report
shows it.  What cannot be guessed, such as the time of the flight, is left to be filled in.

The comparisons that a collection and a model of it usually call for, with the ranges that are usual.

The content of a campaign file that is being drafted, and its text with each guess marked.

The model side of a first draft: what field spectra go with, classes, targets, flight and sensor.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from hyperval.campaign.sides import centre_of
from hyperval.collection import CollectionSection
from hyperval.config import FILL_IN
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import Raster, objects, open_cube, open_raster, read_regions
from hyperval.imagery.regions import guard
from hyperval.imagery.truth import TargetObject
from hyperval.observe.place import Place, open_place
from hyperval.products import background_of
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.spectra.axis import SpectralAxis, in_window
from hyperval.spectra.readers import read_records
from hyperval.storage import write_text
from hyperval.units import radiance_to_internal

# A test asks whether the stated errors explain the difference, and a draft has none that anybody stated.
_OF_BUDGET = "whether the budget explains the difference; it is guessed, and decides once the errors are stated"


def usual_comparisons(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Comparisons for the content of a campaign file, as that file states them.

    Level of the radiance of every surface with a spectrum of its own, of the reflectance of those that are no
    panel of the empirical line, the SNR of its panels, detection and false alarms of its targets.  A class whose
    statistics the image itself gives is no evidence, and not compared.
    """
    collection, scenario = content["collection"], content["scenarios"][0]
    scene = scenario["scene"]
    panels = [panel["name"] for panel in scene.get("panels", [])]
    known = [c["name"] for c in scene["classes"] if "measured" not in c["spectrum"]]
    out: list[dict[str, Any]] = []
    if "atmosphere" in scenario and known + panels:
        out += [
            _entry("radiance", known + panels, "median_difference_ratio_windows", {"within": [-0.1, 0.1]},
                   "5 % of the calibration and 5 % of field spectra, at twice their standard uncertainty"),
            _entry("radiance", known + panels, "p_value_shape", {"at_least": 0.01}, _OF_BUDGET, gate=False),
        ]  # fmt: skip
        if panels and panels == collection.get("snr_regions"):
            out.append(
                _entry("snr", panels, "median_difference_ratio_windows", {"within": [-0.3, 0.3]},
                       "detector figures from a data sheet", gate=False)
            )  # fmt: skip
    if known and ("empirical_line" in collection or collection["cube"]["quantity"] == "reflectance"):
        out += [
            _entry("reflectance", known, "median_difference_ratio_windows", {"within": [-0.1, 0.1]},
                   "5 % of field spectra, at twice their standard uncertainty; panels of the line left out"),
            _entry("reflectance", known, "p_value_full", {"at_least": 0.01}, _OF_BUDGET, gate=False),
        ]  # fmt: skip
    materials = [target["name"] for target in scene.get("targets", [])]
    if materials:
        backgrounds = [background_of(name) for name in materials]
        subjects = [s["name"] for target in scene["targets"] for s in target.get("subjects") or [target]]
        out += [
            _entry("roc", subjects, "pd_difference@1e-2", {"within": [-0.15, 0.15]},
                   "a sixth more or fewer target pixels detected is what a user would not act upon",
                   method="cem/pixel"),
            _entry("scores", backgrounds, "pfa_ratio@1e-2", {"within": [0.5, 2.0]},
                   "false alarms to a factor of two"),
        ]  # fmt: skip
    return out


def _entry(
    product: str, subjects: list[str], metric: str, limit: dict[str, Any], reason: str, **more: Any
) -> dict[str, Any]:
    return {"product": product, "subjects": list(subjects), "metric": metric, **limit, **more, "reason": reason}


@dataclass(frozen=True)
class StarterSources:
    """What the user names.

    Attributes
    ----------
    cube, regions, targets, spectra : files; a folder of spectra stands for its files
    header, quantity, unit, sensor, time_utc, altitude_km, pixel_size_m : where the files do not say it
    key : which array is the image, where a file holds several
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
    key: str | None = None


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


_REFLECTANCE_UNITS = ("fraction", "percent", "scaled:1000", "scaled:10000")
_RING_PIXELS = 4.0
_MOST_SIZES = 12
_FLAT = 0.06  # standard deviation over mean, of grey cloths and panels
_PANEL = re.compile(r"panel|tarp|calib|spectralon|permaflect", re.IGNORECASE)
Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Spectrum:
    """A field spectrum that a name of the scene may go with."""

    name: str
    path: Path
    record: str | None
    unit: str | None
    flat: bool = False

    def source(self, draft: Draft) -> dict[str, Any]:
        """As a scenario names it."""
        entry: dict[str, Any] = {"file": draft.reference(self.path)}
        if self.record is not None:
            entry["record"] = self.record
        if self.unit is not None:
            entry["reflectance_unit"] = self.unit
        return entry


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


def field_spectra(paths: Sequence[Path]) -> list[Spectrum]:
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
                    r.name if several else path.stem,
                    path,
                    r.name if several else None,
                    unit,
                    _is_flat(r.values[in_window(r.wavelength_nm)]),
                )
                for r in records
            ]
    read_records(path)  # the reader's own words for what is wrong
    raise InputError("no reflectance in any usual unit", where=str(path))


def _is_flat(reflectance: Array) -> bool:
    """Whether it is as flat as that of a calibration panel: known, and of hardly any slope or feature."""
    if reflectance.size == 0 or not np.all(np.isfinite(reflectance)):
        return False
    return bool(np.std(reflectance) < _FLAT * np.mean(reflectance))


def panels_among(regions: Iterable[str], matched: Mapping[str, Spectrum]) -> list[str]:
    """Regions that are calibration panels by their name, or two and more whose field spectra are flat."""
    flat = [region for region in regions if region in matched and matched[region].flat]
    return [region for region in regions if _PANEL.search(region) or (len(flat) > 1 and region in flat)]


def empirical_line(draft: Draft, panels: Sequence[str], matched: Mapping[str, Spectrum]) -> None:
    """An empirical line through the panels with a spectrum, where there are two."""
    known = [panel for panel in panels if panel in matched]
    if len(known) < 2:
        return
    entries = [{"region": panel, "spectrum": matched[panel].source(draft)} for panel in known]
    draft.content["collection"]["empirical_line"] = {"panels": entries}
    draft.guess(
        "collection",
        "empirical_line",
        because=f"through {', '.join(known)}: regions named as panels, or of flat spectra",
    )


def scenario(
    sources: StarterSources,
    place: Place,
    quantity: str,
    panels: Sequence[str],
    matched: Mapping[str, Spectrum],
    draft: Draft,
) -> dict[str, Any]:
    """Classes, panels, atmosphere and sensor of the model; UsageError where nothing has a reflectance."""
    ground = [region for region in place.regions if region not in panels and place.pixels_of(region).any()]
    measured = quantity == "reflectance" or "empirical_line" in draft.content["collection"]
    classes = [region for region in ground if measured or region in matched]
    if not classes:
        raise UsageError(
            "no region of the ground has a reflectance: the model has nothing to predict from",
            expected=f"--spectra: files of field spectra named as {', '.join(ground) or 'regions'}, or two panels",
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
    out: dict[str, Any] = {"schema": 1, "name": draft.content["name"]}
    if quantity == "radiance":
        out |= _flight(sources, place, draft)
        out["uncertainty"] = {"aot550": 0.05, "water_vapour_g_cm2": 0.5}
        draft.guess("scenarios", "uncertainty", "aot550", because="of the two guesses of the atmosphere")
        draft.content["collection"]["calibration"] = {"relative": 0.05, "uncorrelated": 0.01}
        draft.guess("collection", "calibration", because="5 %, common to all bands, and 1 % of each")
    out["scene"] = scene
    out["processing"] = {"detectors": ["cem"], "bands": {"drop_bad": True}}
    if not (quantity == "radiance" and measured):
        out["processing"]["elm"] = "none"
    subjects = [*(c["name"] for c in scene["classes"] if c["name"] in matched), *known]
    if subjects:
        _spectra_known_to(out, subjects, draft)
    return out


def _flight(sources: StarterSources, place: Place, draft: Draft) -> dict[str, Any]:
    """Atmosphere, sun and sensor."""
    state: dict[str, Any] = {"aot550": 0.1, "water_vapour_g_cm2": 1.5, "ground_altitude_km": 0.0}
    draft.guess("scenarios", "atmosphere", because="aerosol depth 0.1, 1.5 g cm-2 of water and a ground at sea level")
    state["sensor_altitude_km"] = sources.altitude_km or f"{FILL_IN}: sensor above sea level [km]"
    centre = centre_of(place)
    if centre is None:
        state["latitude_deg"] = f"{FILL_IN}: latitude, north positive [deg]"
        state["longitude_deg"] = f"{FILL_IN}: longitude, east positive [deg]"
    else:
        state["latitude_deg"], state["longitude_deg"] = (round(degrees, 4) for degrees in centre)
    state["time_utc"] = sources.time_utc or f"{FILL_IN}: time of the line, such as 2012-09-20T16:31:00Z"
    sensor = sources.sensor or _library_sensor(place.cube.axis, draft)
    named = sources.sensor is not None and Path(sensor).is_file()
    return {"atmosphere": state, "sensor": draft.reference(Path(sensor)) if named else sensor}


def _library_sensor(axis: SpectralAxis, draft: Draft) -> str:
    """The sensor of the library with these bands."""
    for name in library_names():
        own = load_sensor(name).axis
        if len(own) == len(axis) and np.all(np.abs(own.centre_nm - axis.centre_nm) < own.fwhm_nm):
            draft.guess("scenarios", "sensor", because=f"{name}, whose bands these are")
            return name
    return (
        f"{FILL_IN}: no sensor of the library has these {len(axis)} bands; --sensor names a file (hyperval sensor new)"
    )


def materials(place: Place) -> list[str]:
    """Materials of the targets, each once."""
    return list(dict.fromkeys(target.material for target in place.targets))


def add_targets(place: Place, spectra: Sequence[Spectrum], scenario: dict[str, Any], draft: Draft) -> None:
    """Detection in the image, and the targets of the model."""
    listed = materials(place)
    known = {m: match for m in listed if (match := matching_spectrum(m, spectra))}
    if not known and len(listed) == len(spectra) == 1:
        known = {listed[0]: spectra[0]}
        draft.guess("detection", because=f"{spectra[0].name!r} is the spectrum of {listed[0]!r}: each is the only one")
    if not known:
        return
    collection = draft.content["collection"]
    if collection["cube"]["quantity"] == "radiance" and "empirical_line" not in collection:
        because = "no detection: in radiance it needs an empirical line, two panels with a region and a spectrum each"
        draft.guess("collection", "targets", because=because)
        return
    sizes = {material: _sizes([t for t in place.targets if t.material == material]) for material in known}
    draft.content["detection"] = {
        "group": "{target} {side_m} m" if all(sizes.values()) else "{material}",
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
        entry: dict[str, Any] = {
            "name": material,
            "spectrum": match.source(draft),
            "covariance": {"relative_sd": 0.03, "band_sd": 0.001},
            "host": _host(place, objects, classes),
        }
        if all(sizes.values()):
            entry["subjects"] = [
                {"name": f"{material} {size} m", "fill": _fill(place, [t for t in objects if _size(t) == size])}
                for size in sizes[material]
            ]
        else:
            entry["fill"] = _fill(place, objects)
        entries.append(entry)
    scenario["scene"]["targets"] = entries
    draft.guess(
        "scenarios",
        "scene",
        "targets",
        because="host: the class most seen around a target, or else like what is seen there; fill: by a square of "
        "the target's size, or of as many pixels; a spread of 3 % from pixel to pixel",
    )
    _spectra_known_to(scenario, list(known), draft)


def _spectra_known_to(scenario: dict[str, Any], subjects: Sequence[str], draft: Draft) -> None:
    known = {"relative": 0.05, "correlation_nm": 200}
    entries = [{"subject": subject, **known} for subject in subjects]
    scenario.setdefault("uncertainty", {}).setdefault("field_spectra", []).extend(entries)
    draft.guess("scenarios", "uncertainty", "field_spectra", because="known to 5 % over some 200 nm")


def _size(target: TargetObject) -> str | None:
    return target.attributes.get("side_m")


def _sizes(objects: Sequence[TargetObject]) -> list[str]:
    """Sides of squares of known sizes, greatest first; empty where they are all alike, not known, or many."""
    sides = {size: target.side_m for target in objects if (size := _size(target)) and math.isfinite(target.side_m)}
    complete = all(_size(target) in sides for target in objects)
    return sorted(sides, key=lambda size: -sides[size]) if complete and 1 < len(sides) <= _MOST_SIZES else []


def _host(place: Place, objects: Sequence[TargetObject], classes: Sequence[str]) -> str:
    """The class with the most pixels around the targets; where none is there, that of the most similar spectrum."""
    own = np.zeros(place.cube.shape, bool)
    for target in objects:
        target.paint(own)
    ring = guard(own, _RING_PIXELS) & ~place.near_targets
    likeness = [float(np.sum(ring & place.region(name))) for name in classes]
    if max(likeness) == 0.0 and ring.any():
        around, *means = _means(place, [ring, *(place.region(name) for name in classes)])
        likeness = [around @ m / (np.linalg.norm(around) * np.linalg.norm(m)) for m in means]
    return classes[int(np.argmax(likeness))]


def _means(place: Place, masks: Sequence[Mask]) -> Array:
    """(R, B) mean of the pixels of each mask in the bands that are good."""
    good = place.cube.axis.good
    sums, counts = np.zeros((len(masks), int(good.sum()))), np.zeros((len(masks), 1))
    for block in place.cube.blocks(dtype=np.float32):
        rows = slice(block.first_line, block.first_line + block.values.shape[0])
        for i, mask in enumerate(masks):
            chosen = block.values[mask[rows] & block.valid][:, good]
            sums[i] += chosen.sum(axis=0, dtype=float)
            counts[i] += len(chosen)
    return np.asarray(sums / np.maximum(counts, 1.0))


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


_SCALES = (0.01, 0.001, 0.0001)  # percent, and reflectance times 1000 or 10000


def starter_campaign(sources: StarterSources, folder: Path, name: str) -> tuple[str, list[str]]:
    """The text of a campaign file for ``folder``, and its guesses in words.

    What the files do not say is left to be filled in, each with the option that gives it.  Of an image without
    wavelengths the objects of its map and their spectrum are written into files in ``folder``.

    Raises
    ------
    InputError : files that are missing or corrupt, regions outside the image.
    """
    draft = Draft(folder)
    raster = open_raster(sources.cube, header=sources.header, variable=sources.key)
    if raster.description.listed() is None:
        _by_number(sources, raster, draft, name)
    else:
        _by_wavelength(sources, raster, draft, name)
    guesses = [f"{'.'.join(at)}: {because}" for at, because in draft.guesses.items()]
    draft.content["assumptions"] = [f"guess: {text}" for text in guesses] or ["none beyond what the files state"]
    return draft_text(draft), guesses


def _outline(sources: StarterSources, name: str, quantity: str, size: Sequence[int]) -> dict[str, Any]:
    return {
        "schema": 1,
        "name": name,
        "title": f"{name}: {quantity} of {sources.cube.name}",
        "description": f"{quantity.capitalize()} image of {size[0]} lines, {size[1]} samples "
        f"and {size[2]} bands; written from its files, not yet looked over.",
        "assumptions": [],
    }


def _by_wavelength(sources: StarterSources, raster: Raster, draft: Draft, name: str) -> None:
    """The content of a campaign of an image with wavelengths."""
    quantity = sources.quantity or stated_quantity(raster)
    collection: dict[str, Any] = {"cube": _cube(sources, raster, quantity, draft)}
    collection["regions"] = [{"file": draft.reference(path)} for path in sources.regions] or [_WHOLE]
    draft.content = _outline(sources, name, quantity or "unknown", raster.size) | {"collection": collection}
    if any(str(value).startswith(FILL_IN) for value in collection["cube"].values()):
        draft.guess("scenarios", because="left out until it is known what the image holds")
        return
    _scale(collection, raster, draft)
    for entry in collection["regions"] if sources.regions else ():
        _coordinates(collection, entry, draft)
    place = _place(sources, collection, draft)
    if not any(place.pixels_of(region).any() for region in place.regions):  # of targets alone
        collection["regions"].append(_WHOLE)
        place = _place(sources, collection, draft)
    spectra = field_spectra(sources.spectra)
    matched = {region: match for region in place.regions if (match := matching_spectrum(region, spectra))}
    panels = panels_among(place.regions, matched)
    if quantity == "radiance":
        empirical_line(draft, panels, matched)
    if panels:
        collection["leave_out"] = panels
        collection["snr_regions"] = panels
    try:
        model = scenario(sources, place, str(quantity), panels, matched, draft)
        add_targets(place, spectra, model, draft)
        draft.content["scenarios"] = [model]
        draft.content["comparisons"] = usual_comparisons(draft.content)
        if not draft.content["comparisons"]:
            names = ", ".join([*place.regions, *materials(place)])
            raise UsageError("nothing to compare", expected=f"--spectra: files or records named as {names}")
    except UsageError as error:
        for key in ("scenarios", "comparisons", "detection"):
            draft.content.pop(key, None)
        draft.guesses = {at: why for at, why in draft.guesses.items() if at[0] == "collection"}
        draft.guess("scenarios", because=f"no prediction: {error.what}; {error.expected}")


_WHOLE = {"name": "whole image", "whole_image": True}
_KNOWN, _SCORED = "known objects", "scored object"
_FEW = 5  # pixels that tell no spread


def _by_number(sources: StarterSources, raster: Raster, draft: Draft, name: str) -> None:
    """The content of a campaign of an image without wavelengths: a map of objects, and what they stand before.

    Every other object, in order of size, gives the spectrum that the others are looked for with.
    """
    quantity = sources.quantity or "counts"
    cube: dict[str, Any] = {"path": draft.reference(sources.cube), "quantity": quantity, "by_number": True}
    cube |= {"variable": sources.key} if sources.key else {}
    cube |= {"header": draft.reference(sources.header)} if sources.header else {}
    regions = [_WHOLE, *({"file": draft.reference(path)} for path in sources.regions)]
    collection: dict[str, Any] = {"cube": cube, "regions": regions}
    draft.content = _outline(sources, name, quantity, raster.size) | {"collection": collection}
    draft.guess(
        "collection", "cube", because="the file lists no wavelengths: what needs them is left out (collection.bands)"
    )
    detection: dict[str, Any] = {"background": ["scene"], "false_alarms": ["scene"], "bands": "good"}
    draft.content["detection"] = detection
    masks = _object_masks(sources, raster)
    if len(masks) < 2:
        detection["detectors"] = ["rx"]
        draft.guess("detection", because="anomalies alone: no map of two objects is there (--targets)")
        return
    known, scored = masks[1::2], masks[::2]
    rows = ["region,line,sample"]
    for label, mask in [
        (_KNOWN, np.logical_or.reduce(known)),
        *((f"{_SCORED} {i}", m) for i, m in enumerate(scored, 1)),
    ]:
        rows += [f"{label},{line},{sample}" for line, sample in np.argwhere(mask)]
    draft.folder.mkdir(parents=True, exist_ok=True)
    write_text(draft.folder / "objects.csv", "\n".join(rows) + "\n")
    opened = open_cube(sources.cube, quantity=quantity, axis="numbers", variable=sources.key, header=sources.header)  # type: ignore[arg-type]
    mean = opened.spectra(np.logical_or.reduce(known)).mean(axis=0)
    write_text(
        draft.folder / "target.txt",
        "# mean of the known objects, one row a band\n" + "\n".join(map(repr, mean.tolist())) + "\n",
    )
    regions.append({"name": _KNOWN, "file": "objects.csv"})
    collection["targets"] = {
        "guard_pixels": 2,
        "regions": [{"material": "target", "file": "objects.csv", "regions": [f"{_SCORED} *"]}],
    }
    collection["leave_out"] = [_KNOWN]
    detection |= {
        "detectors": ["cem", "ace"],
        "group": "{material}",
        "targets": [{"name": "target", "material": "target", "spectrum": {"file": "target.txt"}}],
    }
    pixels = int(np.sum(known))
    draft.guess(
        "collection",
        "targets",
        because=f"{len(scored)} of {len(masks)} touching groups of the map; the others ({pixels} pixels) give the "
        "spectrum that they are looked for with",
    )
    whole = str(_WHOLE["name"])
    target: dict[str, Any] = {"name": "target", "spectrum": {"measured": _KNOWN}, "covariance": {"measured": _KNOWN}}
    if pixels < _FEW:
        target["covariance"] = {"relative_sd": 0.05}
    scene: dict[str, Any] = {
        "classes": [{"name": whole, "fraction": 1.0, "spectrum": {"measured": whole}, "tail_dof": "measured"}],
        "adjacency": {"effective_neighbours": None},
        "targets": [target | {"host": whole, "fill": {"fixed": 1.0}}],
    }
    processing = {"elm": "none", "detectors": ["cem", "ace"], "bands": {"drop_bad": True}}
    draft.content["scenarios"] = [{"schema": 1, "name": name, "scene": scene, "processing": processing}]
    draft.guess(
        "scenarios",
        "scene",
        "targets",
        because="each marked pixel is filled; pixels spread as those of the known objects",
    )
    draft.content["comparisons"] = usual_comparisons(draft.content)


def _object_masks(sources: StarterSources, raster: Raster) -> list[Mask]:
    """Touching groups of pixels that the map of objects marks, the largest first."""
    own = "MATLAB" in raster.description.product  # in the file of the image itself
    if sources.targets is None and not own:
        return []
    try:
        regions = read_regions(sources.targets or sources.cube, raster.size[:2])
    except HypervalError:
        if sources.targets is not None:
            raise
        return []
    labels, count = objects(np.logical_or.reduce([region.mask for region in regions.values()]))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return [labels == 1 + i for i in np.argsort(-sizes, kind="stable")]


def stated_quantity(raster: Raster) -> str | None:
    """Whether an image holds radiance or reflectance, by its metadata, else by its name; None: nothing says."""
    about = raster.description
    if about.quantity is not None:
        return about.quantity
    entries = about.entries
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
    return None


def _cube(sources: StarterSources, raster: Raster, quantity: str | None, draft: Draft) -> dict[str, Any]:
    entry: dict[str, Any] = {"path": draft.reference(sources.cube)}
    entry["quantity"] = quantity or f"{FILL_IN}: radiance or reflectance (--quantity)"
    if sources.header is not None:
        entry["header"] = draft.reference(sources.header)
    if sources.key is not None:
        entry["variable"] = sources.key
    if quantity and sources.quantity is None and raster.description.quantity is None:
        draft.guess(
            "collection", "cube", "quantity", because=f"{quantity}, by the words of the header or the file name"
        )
    if quantity == "radiance":
        unit = sources.unit or _stated_unit(raster)
        if unit is not None:
            entry["unit"] = unit
        elif raster.description.unit is None:
            entry["unit"] = f"{FILL_IN}: of the radiance, such as uW cm-2 sr-1 nm-1 (--unit)"
    return entry


def _stated_unit(raster: Raster) -> str | None:
    """The radiance unit that a header entry states, None where none is understood."""
    for key, text in raster.description.entries.items():
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

    return open_place(CollectionSection.model_validate(content), resolve, show_progress=False)


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
            entries = raster.description.entries
            if "reflectance scale factor" not in entries or "data gain values" in entries:
                raise
            factor = float(entries["reflectance scale factor"])  # the reader has found it a number
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


def _place(sources: StarterSources, collection: dict[str, Any], draft: Draft) -> Place:
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


def _truth(sources: StarterSources, draft: Draft) -> dict[str, Any]:
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

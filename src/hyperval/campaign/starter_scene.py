"""The model side of a first draft: what field spectra go with, classes, targets, flight and sensor."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.campaign.scenario_notes import centre_of
from hyperval.campaign.starter_draft import Draft, Sources
from hyperval.config import FILL_IN
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery.regions import guard
from hyperval.imagery.truth import TargetObject
from hyperval.observe.place import Place
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.readers import read_records
from hyperval.spectra.windows import in_window

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
    sources: Sources,
    place: Place,
    quantity: str,
    panels: Sequence[str],
    matched: Mapping[str, Spectrum],
    draft: Draft,
) -> dict[str, Any]:
    """Classes, panels, atmosphere and sensor of the model; UsageError where nothing has a reflectance."""
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


def _flight(sources: Sources, place: Place, draft: Draft) -> dict[str, Any]:
    """Atmosphere, sun and sensor."""
    state: dict[str, Any] = {"aot550": 0.1, "water_vapour_g_cm2": 1.5, "ground_altitude_km": 0.0}
    draft.guess(
        "scenarios", "atmosphere", because="aerosol depth 0.1, 1.5 g cm-2 of water and a ground at sea level"
    )
    state["sensor_altitude_km"] = sources.altitude_km or f"{FILL_IN}: sensor above sea level [km]"
    centre = centre_of(place)
    if centre is None:
        state["latitude_deg"] = f"{FILL_IN}: latitude, north positive [deg]"
        state["longitude_deg"] = f"{FILL_IN}: longitude, east positive [deg]"
    else:
        state["latitude_deg"], state["longitude_deg"] = (round(degrees, 4) for degrees in centre)
    state["time_utc"] = sources.time_utc or f"{FILL_IN}: time of the line, such as 2012-09-20T16:31:00Z"
    sensor = sources.sensor or _library_sensor(place.cube.axis, draft, sources.cube)
    return {"atmosphere": state, "sensor": draft.reference(Path(sensor)) if Path(sensor).is_file() else sensor}


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


def materials(place: Place) -> list[str]:
    """Materials of the targets, each once."""
    return list(dict.fromkeys(target.material for target in place.targets))


def add_targets(place: Place, spectra: Sequence[Spectrum], scenario: dict[str, Any], draft: Draft) -> None:
    """Detection in the image, and the targets of the model."""
    known = {m: match for m in materials(place) if (match := matching_spectrum(m, spectra))}
    if not known:
        return
    collection = draft.content["collection"]
    if collection["cube"]["quantity"] == "radiance" and "empirical_line" not in collection:
        because = (
            "no detection: in radiance it needs an empirical line, two panels with a region and a spectrum each"
        )
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
    # An error that is the same in all bands would leave a shape no room: one part in a thousand would disagree.
    known = {"relative": 0.05, "correlation_nm": 200, "nugget": 0.04}
    entries = [{"subject": subject, **known} for subject in subjects]
    scenario.setdefault("uncertainty", {}).setdefault("field_spectra", []).extend(entries)
    draft.guess(
        "scenarios", "uncertainty", "field_spectra", because="known to 5 % over some 200 nm, to 1 % by band"
    )


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

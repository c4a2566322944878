"""The first draft of a campaign, from what a cube, its regions, its targets and field spectra say of themselves.

Each value that no file states is a guess: marked in the file, and an assumption of the campaign, so that the report
shows it.  What cannot be guessed, such as the time of the flight, is left to be filled in.  What every draft holds
stands in ``draft.yaml``.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from hyperval.campaign.products import centre_of
from hyperval.collection import CollectionSection
from hyperval.config import FILL_IN, Location, parse_yaml
from hyperval.errors import HypervalError, InputError, UsageError, refusal, refuse
from hyperval.imagery import Raster, TargetObject, groups_by_size, guard, open_cube, open_raster, read_regions
from hyperval.observe import Place, open_place
from hyperval.pixels import drawn_pixels
from hyperval.products import background_of
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.spectra import SpectralAxis, in_window, read_records
from hyperval.storage import write_text
from hyperval.units import is_radiance

_REFLECTANCE_UNITS = ("fraction", "percent", "scaled:1000", "scaled:10000")
_RING_PIXELS = 4.0
_MOST_SIZES = 12
_FLAT = 0.06  # standard deviation over mean, of grey cloths and panels
_PANEL = re.compile(r"panel|tarp|calib|spectralon|permaflect", re.IGNORECASE)
_SCALES = (0.01, 0.001, 0.0001)  # percent, and reflectance times 1000 or 10000
_WHOLE = {"name": "whole image", "whole_image": True}
_FEW = 5  # pixels that tell no spread
_SOME = 2000  # pixels that tell a mean
Mask = npt.NDArray[np.bool_]


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

    @property
    def collection(self) -> dict[str, Any]:
        """Its section of the collection."""
        section: dict[str, Any] = self.content["collection"]
        return section

    def reference(self, path: Path) -> str:
        """A file as the campaign names it: relative to the campaign's own folder."""
        return os.path.relpath(path.resolve(), self.folder.resolve())

    def guess(self, name: str, /, **words: object) -> None:
        """Mark the value at a place of the content, as ``draft.yaml`` has both under a name."""
        about = _templates()["guesses"][name]
        self.guesses[tuple(about["at"].split("."))] = about["because"].format(**words)

    def opened(self, **parts: Any) -> Place:
        """The collection as it stands, with only these parts beside its cube."""

        def resolve(reference: str) -> Path:
            return Path(os.path.normpath(self.folder.resolve() / reference))

        section = CollectionSection.model_validate({"cube": self.collection["cube"], **parts})
        return open_place(section, resolve, show_progress=False)

    def text(self) -> str:
        """The campaign file: what was guessed has a comment before it."""
        lines = yaml.dump(self.content, Dumper=_Written, sort_keys=False, allow_unicode=True, width=112).splitlines()
        places = parse_yaml("\n".join(lines))[1]
        comments: dict[int, str] = {}
        for at, because in self.guesses.items():
            place: Location = (at[0], 0, *at[1:]) if at[0] == "scenarios" and len(at) > 1 else at
            if place in places:
                row = places[place] - 1
                row -= re.match(rf"[- ]*{at[-1]}:", lines[row]) is None  # what begins below its key
                indent = len(lines[row]) - len(lines[row].lstrip())
                comments[row] = comments.get(row, "") + f"{' ' * indent}# guess: {because}\n"
        head = "# Written by hyperval init. What follows 'guess' was not stated by any file: check it.\n"
        return head + "".join(f"{comments.get(row, '')}{line}\n" for row, line in enumerate(lines))


class _Written(yaml.SafeDumper):  # type: ignore[misc]
    """What holds nothing but values stands on one line, sentences one a line."""

    def __init__(self, *arguments: Any, **options: Any):
        super().__init__(*arguments, **{**options, "default_flow_style": None})

    def ignore_aliases(self, data: Any) -> bool:
        """Write each entry out: the reader refuses aliases."""
        return True

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        """A list; sentences one a line."""
        words = any(isinstance(item, str) and " " in item for item in sequence)
        return super().represent_sequence(tag, sequence, False if words else flow_style)


def starter_campaign(sources: StarterSources, folder: Path, name: str) -> tuple[str, list[str]]:
    """The text of a campaign file for ``folder``, and its guesses in words.

    What the files do not say is left to be filled in, each with the option that gives it.  Of an image without
    wavelengths the objects of its map and their spectrum are written into files in ``folder``.

    Raises
    ------
    InputError : files that are missing or corrupt, regions outside the image.
    """
    raster = open_raster(sources.cube, header=sources.header, variable=sources.key)
    numbered = raster.description.listed() is None
    silent = numbered or "MATLAB" in raster.description.product  # which say nothing of their numbers
    quantity = sources.quantity or ("counts" if silent else stated_quantity(raster))
    lines, samples, bands = raster.size
    draft = Draft(folder)
    cube = {"path": draft.reference(sources.cube)}
    cube["quantity"] = quantity or f"{FILL_IN}: radiance or reflectance (--quantity)"
    cube |= {"header": draft.reference(sources.header)} if sources.header else {}
    cube |= {"variable": sources.key} if sources.key else {}
    draft.content = {
        "schema": 1,
        "name": name,
        "title": f"{name}: {quantity or 'unknown'} of {sources.cube.name}",
        "description": f"{(quantity or 'unknown').capitalize()} image of {lines} lines, {samples} samples "
        f"and {bands} bands; drafted from its files, not yet reviewed.",
        "assumptions": [],
        "collection": {"cube": cube, "regions": [{"file": draft.reference(path)} for path in sources.regions]},
    }
    (_by_objects if numbered or quantity == "counts" else _by_wavelength)(sources, raster, draft, quantity)
    guesses = [f"{'.'.join(at)}: {because}" for at, because in draft.guesses.items()]
    draft.content["assumptions"] = [f"guess: {text}" for text in guesses] or ["none beyond what the files state"]
    return draft.text(), guesses


def _templates() -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("draft.yaml").read_text("utf-8"))
    return content


def _by_wavelength(sources: StarterSources, raster: Raster, draft: Draft, quantity: str | None) -> None:
    """The content of a campaign of an image with wavelengths."""
    collection = draft.collection
    if quantity and sources.quantity is None and raster.description.quantity is None:
        draft.guess("quantity", quantity=quantity)
    if quantity == "radiance":
        unit = sources.unit or _stated_unit(raster)
        if unit is not None or raster.description.unit is None:
            collection["cube"]["unit"] = unit or f"{FILL_IN}: of the radiance, such as uW cm-2 sr-1 nm-1 (--unit)"
    collection["regions"] = collection["regions"] or [_WHOLE]
    if any(str(value).startswith(FILL_IN) for value in collection["cube"].values()):
        flight = {"time_utc": "--time", "altitude_km": "--altitude-km", "sensor": "--sensor"}
        wanted = {"spectra": "--spectra"} | (flight if quantity != "reflectance" else {})
        further = ", ".join(option for name, option in wanted.items() if not getattr(sources, name))
        draft.guess("no image", further=further or "nothing")
        return
    _scale(raster, draft)
    for entry in collection["regions"] if sources.regions else ():  # where they are not those of the format
        kinds = {kind: {"file": entry["file"], "kind": kind} for kind in ("pixel", "map")}
        _stated(entry, "coordinates", kinds, draft, regions=[entry])
    place = _place(sources, draft)
    if not any(place.pixels_of(region).any() for region in place.regions):  # of targets alone
        collection["regions"].append(_WHOLE)
        place = _place(sources, draft)
    spectra = field_spectra(sources.spectra)
    matched = {region: match for region in place.regions if (match := matching_spectrum(region, spectra))}
    flat = [region for region, match in matched.items() if match.flat]
    panels = [region for region in place.regions if _PANEL.search(region) or (len(flat) > 1 and region in flat)]
    known = [panel for panel in panels if panel in matched]
    if quantity == "radiance" and len(known) > 1:
        entries = [{"region": panel, "spectrum": matched[panel].source(draft)} for panel in known]
        collection["empirical_line"] = {"panels": entries}
        draft.guess("line", panels=", ".join(known))
    if panels:
        collection["leave_out"] = panels
        collection["snr_regions"] = panels
    materials = list(dict.fromkeys(target.material for target in place.targets))
    try:
        model = _scenario(sources, place, str(quantity), panels, matched, draft)
        _add_targets(place, materials, spectra, model, draft)
        draft.content["scenarios"] = [model]
        draft.content["comparisons"] = usual_comparisons(draft.content)
        refuse(not draft.content["comparisons"], "starter.nothing", names=", ".join([*place.regions, *materials]))
    except UsageError as error:
        for key in ("scenarios", "comparisons", "detection"):
            draft.content.pop(key, None)
        draft.guesses = {at: why for at, why in draft.guesses.items() if at[0] == "collection"}
        draft.guess("no prediction", what=error.what, expected=error.expected)


def usual_comparisons(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Comparisons for the content of a campaign file, as that file states them: those of the subjects that it has."""
    collection, scenario = content["collection"], content["scenarios"][0]
    scene = scenario["scene"]
    panels = [panel["name"] for panel in scene.get("panels", [])]
    known = [c["name"] for c in scene["classes"] if "measured" not in c["spectrum"]]
    lit = "atmosphere" in scenario
    reflects = "empirical_line" in collection or collection["cube"]["quantity"] == "reflectance"
    targets = scene.get("targets", [])
    subjects = {
        "RADIANCE": [*known, *panels] if lit else [],
        "PANELS": panels if lit and panels == collection.get("snr_regions") else [],
        "REFLECTANCE": known if reflects else [],
        "TARGETS": [s["name"] for target in targets for s in target.get("subjects") or [target]],
        "BACKGROUNDS": [background_of(target["name"]) for target in targets],
    }
    usual = [{**entry, "subjects": subjects[entry["subjects"]]} for entry in _templates()["comparisons"]]
    return [entry for entry in usual if entry["subjects"]]


@dataclass(frozen=True)
class RecordedSpectrum:
    """A field spectrum that a name of the scene may go with.

    Attributes
    ----------
    name : its own, or that of its file
    path, record, unit : where it stands, and what its reader is to be told
    flat : as flat as that of a calibration panel, of hardly any slope or feature
    """

    name: str
    path: Path
    record: str | None
    unit: str | None
    flat: bool

    def source(self, draft: Draft) -> dict[str, Any]:
        """As a scenario names it."""
        entry: dict[str, Any] = {"file": draft.reference(self.path)}
        entry |= {"record": self.record} if self.record is not None else {}
        return entry | ({"reflectance_unit": self.unit} if self.unit is not None else {})


def matching_spectrum(name: str, spectra: Sequence[RecordedSpectrum]) -> RecordedSpectrum | None:
    """The spectrum of the same name, else the only one with all its words, else the only one whose words it has."""
    words = _words(name)
    for test in (frozenset.__eq__, frozenset.__ge__, frozenset.__le__):
        fits = [s for s in spectra if _words(s.name) and test(_words(s.name), words)]
        if len(fits) == 1:
            return fits[0]
    return None


def _words(name: str) -> frozenset[str]:
    """Words and numbers of a name in small letters; CamelCase and underscores part them."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return frozenset(re.findall(r"[a-z]+|[0-9]+", parted.lower()))


def field_spectra(paths: Sequence[Path]) -> list[RecordedSpectrum]:
    """The reflectance spectra of the files, with the unit that each needs to be told."""
    files = [f for path in paths for f in (sorted(path.iterdir()) if path.is_dir() else [path]) if f.is_file()]
    out: list[RecordedSpectrum] = []
    for path in files:
        try:
            out += _records(path)
        except HypervalError:
            if path in paths:  # of a folder only the files that hold spectra count
                raise
    return out


def _records(path: Path) -> list[RecordedSpectrum]:
    for unit in (None, *_REFLECTANCE_UNITS):
        try:
            records = read_records(path, reflectance_unit=unit)
        except (UsageError, InputError):
            continue
        highest = max((float(np.nanpercentile(r.values, 95)) for r in records), default=0.0)
        if unit is not None and highest > 1.5:
            continue
        out = []
        for one in records:
            values = one.values[in_window(one.wavelength_nm)]
            flat = bool(values.size and np.all(np.isfinite(values)) and np.std(values) < _FLAT * np.mean(values))
            own = one.name if len(records) > 1 else None
            out.append(RecordedSpectrum(own or path.stem, path, own, unit, flat))
        return out
    read_records(path)  # the reader's own words for what is wrong
    raise refusal("starter.unit", path)


def _scenario(
    sources: StarterSources,
    place: Place,
    quantity: str,
    panels: Sequence[str],
    matched: Mapping[str, RecordedSpectrum],
    draft: Draft,
) -> dict[str, Any]:
    """Classes, panels, atmosphere and sensor of the model; UsageError where nothing has a reflectance."""
    ground = [region for region in place.regions if region not in panels and place.pixels_of(region).any()]
    measured = quantity == "reflectance" or "empirical_line" in draft.collection
    classes = [region for region in ground if measured or region in matched]
    refuse(not classes, "starter.ground", names=", ".join(ground) or "regions")
    pixels = np.array([place.pixels_of(region).sum() for region in classes], float)
    shares = np.round(pixels / pixels.sum(), 4)
    shares[-1] = 1.0 - shares[:-1].sum()
    surfaces: list[dict[str, Any]] = []
    for region, share in zip(classes, shares, strict=True):
        surfaces.append({"name": region, "fraction": round(float(share), 4), "spectrum": {"measured": region}})
        if region in matched:
            spread = {"measured": region} if measured else {"relative_sd": 0.1}
            surfaces[-1] |= {"spectrum": matched[region].source(draft), "covariance": spread}
    scene: dict[str, Any] = {"classes": surfaces, "adjacency": {"effective_neighbours": None}}
    draft.guess("classes")
    known = [panel for panel in panels if panel in matched]
    if known:
        scene["panels"] = [{"name": panel, "spectrum": matched[panel].source(draft)} for panel in known]
    out: dict[str, Any] = {"schema": 1, "name": draft.content["name"]}
    if quantity == "radiance":
        out |= _flight(sources, place, draft)
    out["scene"] = scene
    out["processing"] = {"detectors": ["cem"], "bands": {"drop_bad": True}}
    if not (quantity == "radiance" and measured):
        out["processing"]["elm"] = "none"
    _spectra_known_to(out, [*(region for region in classes if region in matched), *known], draft)
    return out


def _flight(sources: StarterSources, place: Place, draft: Draft) -> dict[str, Any]:
    """Atmosphere, sun, sensor, and what is known of them."""
    usual = _templates()["flight"]
    state, draft.collection["calibration"] = usual["atmosphere"], usual["calibration"]
    for name in ("atmosphere", "state", "calibration"):
        draft.guess(name)
    centre = centre_of(place)
    if centre is not None:
        state["latitude_deg"], state["longitude_deg"] = (round(degrees, 4) for degrees in centre)
    stated = {"sensor_altitude_km": sources.altitude_km, "time_utc": sources.time_utc}
    state |= {key: value for key, value in stated.items() if value}
    sensor = sources.sensor or _library_sensor(place.cube.axis, draft)
    named = sources.sensor is not None and Path(sensor).is_file()
    sensor = draft.reference(Path(sensor)) if named else sensor
    return {"atmosphere": state, "sensor": sensor, "uncertainty": usual["uncertainty"]}


def _library_sensor(axis: SpectralAxis, draft: Draft) -> str:
    """The sensor of the library with these bands."""
    for name in library_names():
        own = load_sensor(name).axis
        if len(own) == len(axis) and np.all(np.abs(own.centre_nm - axis.centre_nm) < own.fwhm_nm):
            draft.guess("sensor", name=name)
            return name
    return (
        f"{FILL_IN}: no sensor of the library has these {len(axis)} bands; --sensor names a file (hyperval sensor new)"
    )


def _add_targets(
    place: Place,
    materials: Sequence[str],
    spectra: Sequence[RecordedSpectrum],
    scenario: dict[str, Any],
    draft: Draft,
) -> None:
    """Detection in the image, and the targets of the model."""
    known = {m: match for m in materials if (match := matching_spectrum(m, spectra))}
    if not known and len(materials) == len(spectra) == 1:
        known = {materials[0]: spectra[0]}
        draft.guess("only one", spectrum=spectra[0].name, material=materials[0])
    if not known:
        return
    if draft.collection["cube"]["quantity"] == "radiance" and "empirical_line" not in draft.collection:
        draft.guess("no detection")
        return
    members = {material: [t for t in place.targets if t.material == material] for material in known}
    sizes = {material: _sizes(own) for material, own in members.items()}
    looked_for = [{"name": m, "material": m, "spectrum": match.source(draft)} for m, match in known.items()]
    group = "{target} {side_m} m" if all(sizes.values()) else "{material}"
    draft.content["detection"] = {"group": group, "detectors": ["cem"], "targets": looked_for}
    classes = [c["name"] for c in scenario["scene"]["classes"]]
    entries = scenario["scene"]["targets"] = []
    for material, own in members.items():
        entry: dict[str, Any] = {
            "name": material,
            "spectrum": known[material].source(draft),
            "covariance": {"relative_sd": 0.03, "band_sd": 0.001},
            "host": _host(place, own, classes),
        }
        if all(sizes.values()):
            entry["subjects"] = [
                {"name": f"{material} {size} m", "fill": _fill(place, [t for t in own if _size(t) == size])}
                for size in sizes[material]
            ]
        else:
            entry["fill"] = _fill(place, own)
        entries.append(entry)
    draft.guess("targets")
    _spectra_known_to(scenario, list(known), draft)


def _spectra_known_to(scenario: dict[str, Any], subjects: Sequence[str], draft: Draft) -> None:
    if subjects:
        entries = [{"subject": subject, "relative": 0.05, "correlation_nm": 200} for subject in subjects]
        scenario.setdefault("uncertainty", {}).setdefault("field_spectra", []).extend(entries)
        draft.guess("field spectra")


def _size(target: TargetObject) -> str | None:
    return target.attributes.get("side_m")


def _sizes(members: Sequence[TargetObject]) -> list[str]:
    """Sides of squares of known sizes, greatest first; empty where they are all alike, not known, or many."""
    sides = {size: target.side_m for target in members if (size := _size(target)) and math.isfinite(target.side_m)}
    complete = all(_size(target) in sides for target in members)
    return sorted(sides, key=lambda size: -sides[size]) if complete and 1 < len(sides) <= _MOST_SIZES else []


def _host(place: Place, members: Sequence[TargetObject], classes: Sequence[str]) -> str:
    """The class with the most pixels around the targets; where none is there, that of the most similar spectrum."""
    own = np.zeros(place.cube.shape, bool)
    for target in members:
        target.paint(own)
    ring = guard(own, _RING_PIXELS) & ~place.near_targets
    likeness = [float(np.sum(ring & place.region(name))) for name in classes]
    if max(likeness) == 0.0 and ring.any():
        good, rng = place.cube.axis.good, np.random.default_rng(0)
        masks = [ring, *(place.region(name) for name in classes)]
        around, *means = (place.cube.spectra(drawn_pixels(m, _SOME, rng))[:, good].mean(axis=0) for m in masks)
        likeness = [around @ m / (np.linalg.norm(around) * np.linalg.norm(m)) for m in means]
    return classes[int(np.argmax(likeness))]


def _fill(place: Place, members: Sequence[TargetObject]) -> dict[str, Any]:
    """Fill from the geometry of the objects of a material; whole pixels where the ground size is not known."""
    if place.pixel_area_m2 is None:
        return {"fixed": 1.0}
    gsd = math.sqrt(place.pixel_area_m2)
    pixels = float(np.mean([target.part.sum() for target in members]))
    sides = [target.side_m for target in members if math.isfinite(target.side_m)]
    side = float(np.mean(sides)) if sides else gsd * math.sqrt(pixels)
    shape = {"side_m": round(side, 3), "heading_deg": "random", "gsd_m": round(gsd, 4)}
    return {"geometry": {**shape, "pixels": "ranked", "n": max(1, min(400, round(pixels)))}}


def _by_objects(sources: StarterSources, raster: Raster, draft: Draft, quantity: str | None) -> None:
    """The content of a campaign of counts, or without wavelengths: a map of objects, and what they stand before."""
    collection = draft.collection
    collection["cube"]["by_number"] = True
    collection["regions"].insert(0, _WHOLE)
    draft.guess("no wavelengths" if raster.description.listed() is None else "no quantity")
    detection = {"background": ["scene"], "false_alarms": ["scene"], "bands": "good", "detectors": ["rx"]}
    draft.content["detection"] = detection
    masks, why = _object_masks(sources, raster)
    if len(masks) < 2:
        draft.guess("anomalies", why=why)
        return
    scored, known = masks[::2], np.logical_or.reduce(masks[1::2])
    marked = {"known objects": known} | {f"scored object {i}": mask for i, mask in enumerate(scored, 1)}
    rows = [f"{name},{line},{sample}\n" for name, mask in marked.items() for line, sample in np.argwhere(mask)]
    write_text(draft.folder / "objects.csv", "region,line,sample\n" + "".join(rows))
    cube = open_cube(sources.cube, quantity=quantity, axis="numbers", variable=sources.key, header=sources.header)  # type: ignore[arg-type]
    mean = "\n".join(map(repr, np.nan_to_num(cube.spectra(known).mean(axis=0)).tolist()))
    write_text(draft.folder / "target.txt", f"# mean of the known objects, one row a band\n{mean}\n")
    usual = _templates()["objects"]
    collection["regions"].append({"name": "known objects", "file": "objects.csv"})
    collection |= usual["collection"]
    detection |= usual["detection"]
    pixels = int(np.sum(known))
    if pixels < _FEW:
        usual["scene"]["targets"][0]["covariance"] = {"relative_sd": 0.05}
    model = {"scene": usual["scene"], "processing": usual["processing"]}
    draft.content["scenarios"] = [{"schema": 1, "name": draft.content["name"], **model}]
    draft.guess("objects", why=why, scored=len(scored), pixels=pixels)
    draft.guess("objects filled")
    draft.content["comparisons"] = usual_comparisons(draft.content)


def _object_masks(sources: StarterSources, raster: Raster) -> tuple[list[Mask], str]:
    """The objects of the map, the largest first, and words on them."""
    if sources.targets is None and " file" not in raster.description.product:  # none in the file of the image itself
        return [], "no map of objects is there (--targets)"
    try:
        regions = read_regions(sources.targets or sources.cube, raster.size[:2])
    except HypervalError as error:
        if sources.targets is not None:
            raise
        return [], f"no map of objects is there (--targets): {error.what}"
    return groups_by_size(np.logical_or.reduce([region.mask for region in regions.values()]))


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


def _stated_unit(raster: Raster) -> str | None:
    """The radiance unit that a header entry states, None where none is understood."""
    for key, text in raster.description.entries.items():
        if "unit" in key and "wavelength" not in key and is_radiance(text.strip()):
            return text.strip()
    return None


def _scale(raster: Raster, draft: Draft) -> None:
    """State the scale of an image whose header does not.

    Of reflectance, the largest that makes reflectances of the values; of radiance, the divisor that the header
    states for a reflectance, as some programs write it for either.
    """
    cube, entries = draft.collection["cube"], raster.description.entries
    tried = {scale: f"{scale:g}, the largest that makes the values reflectances" for scale in _SCALES}
    if cube["quantity"] != "reflectance":
        tried = {}
        if "reflectance scale factor" in entries and "data gain values" not in entries:
            factor = float(entries["reflectance scale factor"])  # the reader has found it a number
            tried = {
                1.0 / factor: f"1/{factor:g}: the header has a 'reflectance scale factor' although it holds radiance"
            }
    _stated(cube, "scale", {scale: {"why": why} for scale, why in tried.items()}, draft)


def _stated(
    entry: dict[str, Any], key: str, values: Mapping[Any, Mapping[str, Any]], draft: Draft, **parts: Any
) -> None:
    """State the first value of a key with which the collection opens, and its guess; none where it opens without."""
    try:
        draft.opened(**parts)
    except HypervalError as first:
        for value, words in values.items():
            entry[key] = value
            with suppress(HypervalError):
                draft.opened(**parts)
                return draft.guess(key, **words)
        raise first from None


def _place(sources: StarterSources, draft: Draft) -> Place:
    """The opened collection, its targets one material for each region of their file."""
    regions = draft.collection["regions"]
    if sources.targets is None:
        return draft.opened(regions=regions)
    truth: dict[str, Any] = {"guard_pixels": 2}
    truth |= {"pixel_size_m": sources.pixel_size_m} if sources.pixel_size_m is not None else {}
    file = draft.reference(sources.targets)
    if _is_list(sources.targets):
        draft.collection["targets"] = {"csv": file, **truth}
    else:
        every = [{"material": "every region", "file": file}]
        found = draft.opened(regions=regions, targets={"regions": every, **truth}).targets
        names = dict.fromkeys(target.attributes["region"] for target in found)
        own = [{"material": name, "file": file, "regions": [name]} for name in names]
        draft.collection["targets"] = {"regions": own, **truth}
    return draft.opened(regions=regions, targets=draft.collection["targets"])


def _is_list(path: Path) -> bool:
    """Whether a file is a list of target centres: a table with a column of materials."""
    if path.suffix.lower() != ".csv":
        return False
    with path.open("r", encoding="utf-8-sig", errors="replace") as file:
        return "material" in file.readline(4096).lower()

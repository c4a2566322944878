"""The first draft of a campaign, from what a cube, its regions, its targets and field spectra say of themselves.

A value that no file states is a guess: marked in the draft, and listed among the campaign's assumptions.  What cannot
be guessed, such as the time of the flight, is left to be filled in.  ``draft.yaml`` holds what every draft has.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from glob import escape
from itertools import chain, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from hyperval.atmosphere.solar import parse_utc
from hyperval.campaign.products import cube_centre
from hyperval.collection import CollectionSection
from hyperval.config import FILL_IN, Location, parse_yaml, validate
from hyperval.data import Mask
from hyperval.errors import HypervalError, InputError, UsageError, package_table, refusal, refuse, told_of
from hyperval.imagery import Raster, TargetObject, all_pixels, groups_by_size, guard, objects, open_raster, read_regions
from hyperval.observe import Place, open_place
from hyperval.paths import checked_store, head_of
from hyperval.pixels import drawn_pixels
from hyperval.products import background_of
from hyperval.results import grouped
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.spectra import FieldSpectrum, in_window, read_records
from hyperval.storage import decoded, write_text

_UNITS = (None, "fraction", "percent", "scaled:1000", "scaled:10000")  # of reflectances; None: as the file states
_RING_PIXELS = 4.0
_MAX_SIZES = 12
_FLAT = 0.06  # standard deviation over mean, of grey cloths and panels
_PANEL = re.compile(r"panel|tarp|calib|spectralon|permaflect", re.IGNORECASE)
# Of an instrument, not of the scene: its white reference, or what it shows in the dark.
_REFERENCE = re.compile(r"(?<![a-z])wr(?![a-z])|(white|dark)[ _-]?(ref|current)", re.IGNORECASE)
_THOUSANDS = 0.001  # whose brighter images are as possible as dark ones times 10000
_SCALES = (1.0, 0.01, _THOUSANDS, 0.0001)  # reflectance, percent, and times 10000, which most whole numbers are
_WHOLE = {"name": "whole image", "whole_image": True}
_MAX_NAMED = 8
_FEW = 5  # pixels that tell no spread
_SOME = 2000  # pixels that tell a mean
_NAMED = {"radiance": r"radiance|(?<![a-z])(rdn|rad)(?![a-z])", "reflectance": r"refl|(?<![a-z])(rfl|ref)(?![a-z])"}
Entry = dict[str, Any]
_templates = partial(package_table, "campaign/draft.yaml")


@dataclass(frozen=True)
class StarterSources:
    """What the user names.

    Attributes
    ----------
    cube, regions, targets, spectra : files; a folder of spectra stands for its files
    header, quantity, unit, sensor, time_utc, altitude_km, pixel_size_m, scale : where the files do not say it
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
    scale: float | None = None


class RecordedSpectrum(NamedTuple):
    """A field spectrum that a name of the scene may go with.

    Attributes
    ----------
    name : its own, or that of its file
    source : as a scenario names it: where it stands, and what its reader is to be told
    record : as it was read
    """

    name: str
    source: Entry
    record: FieldSpectrum

    def is_copy(self, other: RecordedSpectrum) -> bool:
        """Whether both are one spectrum of one name, to the rounding of a text."""
        same_name = _words(self.name) == _words(other.name) and self.record.values.size == other.record.values.size
        return same_name and np.allclose(self.record.values, other.record.values, rtol=1e-3, atol=1e-3)

    @property
    def is_flat(self) -> bool:
        """Whether it is as flat as that of a calibration panel, of hardly any slope or feature."""
        values = self.record.values[in_window(self.record.wavelength_nm)]
        return bool(values.size and np.all(np.isfinite(values)) and np.std(values) < _FLAT * np.mean(values))


class _CampaignDumper(yaml.SafeDumper):  # type: ignore[misc]
    """What holds nothing but values stands on one line, sentences one a line."""

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

    >>> from tempfile import TemporaryDirectory
    >>> from hyperval.imagery import write_cube
    >>> from hyperval.spectra import SpectralAxis
    >>> corners = [[1, 1], [8, 1], [8, 8], [1, 1]]
    >>> with TemporaryDirectory() as folder:
    ...     _ = (drawn := Path(folder) / "a.json").write_text(f'{{"type": "Polygon", "coordinates": [{corners}]}}')
    ...     np.save(numbers := Path(folder) / "a.npy", np.ones((9, 9, 3)))  # whose bands go by number
    ...     starter_campaign(StarterSources(numbers, [drawn]), Path(folder), "a")[1][:1]
    ...     axis = SpectralAxis(np.array([500.0, 600.0]), np.ones(2))
    ...     raw = write_cube(Path(folder) / "raw", np.ones((9, 9, 2)), data_type=12, axis=axis)
    ...     print(re.search("FILL_IN.*", starter_campaign(StarterSources(raw), Path(folder), "a")[0])[0])
    ['collection.regions: a.json: pixel coordinates']
    FILL_IN: radiance, reflectance or counts (--quantity)'}

    Raises
    ------
    InputError : files that are missing or corrupt, regions outside the image.
    """
    draft = Draft(sources, folder, open_raster(sources.cube, header=sources.header, variable=sources.key), name)
    guesses = draft.fill()
    return draft.text(), guesses


@dataclass
class Draft:
    """The content of a campaign file that grows, with its guesses by place.

    Attributes
    ----------
    folder : where it will stand
    raster : the image
    collection : the section of its collection
    quantity : what the image holds, where that is known
    """

    sources: StarterSources
    folder: Path
    raster: Raster
    name: str
    content: Entry = field(default_factory=dict)
    collection: Entry = field(default_factory=dict)
    quantity: str | None = None
    guesses: dict[tuple[str, ...], str] = field(default_factory=dict)

    def fill(self) -> list[str]:
        """Write all that can be known or guessed; the guesses in words."""
        sources, about = self.sources, self.raster.description
        for option, read, value in (("--time", parse_utc, sources.time_utc), ("--sensor", load_sensor, sources.sensor)):
            with told_of(option):
                _ = value and read(value)
        numbered = about.listed() is None
        # Numbers without wavelengths, or of MATLAB, say nothing of what they are.
        stated = "counts" if numbered or "MATLAB" in about.product else about.quantity or guess_quantity(self.raster)
        self.quantity = quantity = sources.quantity or stated
        refuse("class names" in about.entries, "starter.classes", sources.cube)
        refuse(numbered and quantity == "radiance", "starter.no_wavelengths", sources.cube)
        refuse(quantity == "deviations", "scale.deviations", sources.cube, quantity="radiance or reflectance")
        lines, samples, bands = self.raster.size
        asked = quantity or f"{FILL_IN}: radiance, reflectance or counts (--quantity)"
        header = self.reference(sources.header) if sources.header else None
        entries = {"header": header, "variable": sources.key or None, "scale": sources.scale}
        cube: Entry = {"path": self.reference(sources.cube), "quantity": asked}
        cube |= {key: value for key, value in entries.items() if value is not None}
        regions: list[Entry] = [{"file": self.reference(path)} for path in sources.regions]
        self.collection |= {"cube": cube, "regions": regions or [_WHOLE]}
        what = f"{quantity or 'unknown'} image of {lines} lines, {samples} samples and {bands} bands"
        self.content = {
            "schema": 1, "name": self.name, "title": f"{self.name}: {quantity or 'unknown'} of {sources.cube.name}",
            "description": f"{what[0].upper()}{what[1:]}; drafted from its files, not yet reviewed.",
            "assumptions": [], "collection": self.collection,
        }  # fmt: skip
        if numbered:
            cube["by_number"] = True
        else:
            self._unit_and_order()
        self._scale()
        for entry in regions if FILL_IN not in str(cube) else ():
            self._coordinates(entry, regions=[entry])
        if FILL_IN in str(cube):
            flight = {"time_utc": "--time", "altitude_km": "--altitude-km", "sensor": "--sensor"}
            options = {} if numbered else {"spectra": "--spectra"} | (flight if quantity != "reflectance" else {})
            further = ", ".join(option for name, option in options.items() if not getattr(sources, name))
            self.guess("no image", further=further or "nothing")
        elif numbered or (quantity == "counts" and sources.quantity is None):
            self._draft_by_objects("no wavelengths" if numbered else "no quantity")
        elif not (sources.regions or sources.spectra or sources.targets) and self._object_masks()[0][1:]:
            self._draft_by_objects("no spectra")
        else:
            self._draft_by_wavelength()
        self._note_unused()
        guesses = [f"{'.'.join(location)}: {because}" for location, because in self.guesses.items()]
        self.content["assumptions"] = [f"guess: {text}" for text in guesses] or ["none beyond what the files state"]
        return guesses

    def reference(self, path: Path) -> str:
        """A file as the campaign names it: relative to the campaign's own folder."""
        return os.path.relpath(checked_store(path).resolve(), self.folder.resolve())

    def guess(self, name: str, /, **words: object) -> None:
        """Mark the value at a place of the content, as ``draft.yaml`` has both under a name."""
        about = _templates()["guesses"][name]
        self.guesses[tuple(about["at"].split("."))] = about["because"].format(**words)

    def open_parts(self, **parts: Any) -> Place:
        """The collection as it stands, with only these parts beside its cube."""
        section = validate(CollectionSection, {"cube": self.collection["cube"], **parts}, {}, "draft")
        return open_place(section, lambda name: Path(os.path.normpath(self.folder.resolve() / name)))

    def text(self) -> str:
        """The campaign file: what was guessed has a comment before it."""
        style: dict[str, Any] = {"sort_keys": False, "allow_unicode": True, "width": 112, "default_flow_style": None}
        lines = yaml.dump(self.content, Dumper=_CampaignDumper, **style).splitlines()
        places = parse_yaml("\n".join(lines))[1]
        comments: dict[int, str] = {}
        for key, because in self.guesses.items():
            place: Location = (key[0], 0, *key[1:]) if key[0] == "scenarios" and len(key) > 1 else key
            if place in places:
                row, keys = places[place] - 1, "|".join(key)
                while not re.match(rf"[- ]*({keys}):", lines[row]):  # what begins below its key, or within a line
                    row -= 1
                indent = len(lines[row]) - len(lines[row].lstrip())
                comments[row] = comments.get(row, "") + f"{' ' * indent}# guess: {because}\n"
        head = "# Written by hyperval init. What follows 'guess' was not stated by any file: check it.\n"
        return head + "".join(f"{comments.get(row, '')}{line}\n" for row, line in enumerate(lines))

    # An image with wavelengths ----------------------------------------------------------------------------------------

    def _unit_and_order(self) -> None:
        collection, quantity, sources, stated = self.collection, self.quantity, self.sources, self.raster.description
        if quantity in _NAMED and sources.quantity is None and stated.quantity is None:
            self.guess("quantity", quantity=quantity)
        if quantity == "radiance":
            unit = sources.unit or stated.unit_in_entries()[1]
            if unit is not None or stated.unit is None:
                collection["cube"]["unit"] = unit or f"{FILL_IN}: of the radiance, such as uW cm-2 sr-1 nm-1 (--unit)"
        if (bands := stated.listed()) is not None and not stated.sorts and np.any(np.diff(bands.wavelength) < 0.0):
            collection["cube"]["sort_bands"] = True
            self.guess("sort_bands")

    def _draft_by_wavelength(self) -> None:
        collection, quantity = self.collection, self.quantity
        place = self._place()
        if not any(place.pixels_of(region).any() for region in place.regions):  # of targets alone
            collection["regions"].append(_WHOLE)
            place = self._place()
        matched = {region: match for region in place.regions if (match := self.find_spectrum(region))}
        flat = [region for region, match in matched.items() if match.is_flat]
        panels = [region for region in place.regions if _PANEL.search(region) or (len(flat) > 1 and region in flat)]
        usable = [panel for panel in panels if panel in matched]
        if quantity == "counts" and len(usable) < 2:
            self._draft_by_objects("no line")
            return
        if quantity != "reflectance" and len(usable) > 1:
            entries = [{"region": panel, "spectrum": matched[panel].source} for panel in usable]
            collection["empirical_line"] = {"panels": entries}
            self.guess("line", panels=", ".join(usable))
        if panels:
            collection |= {"leave_out": panels, "snr_regions": [p for p in panels if place.pixels_of(p).sum() >= _FEW]}
        try:
            model = self._scenario(place, panels, matched)
            self._add_targets(place, model)
            self._add_comparisons(model)
            names = ", ".join([*place.regions, *dict.fromkeys(target.material for target in place.targets)])
            refuse(not self.content["comparisons"], "starter.nothing", names=names)
        except UsageError as error:
            for key in ("scenarios", "comparisons", "detection"):
                self.content.pop(key, None)
            self.guesses = {location: why for location, why in self.guesses.items() if location[0] == "collection"}
            self.guess("no prediction", what=error.what, expected=error.expected)

    def _scale(self) -> None:
        """State the scale of an image whose header does not, or states one that was applied before.

        Of reflectance, that by which regions agree with the spectra of their names to a factor of two, else the largest
        that makes reflectances of the values; of radiance, the divisor that the header states for a reflectance, as
        some programs write it for either.  Where none makes possible values, or two are as usual, it is asked for.
        """
        if FILL_IN in str(self.collection["cube"]):
            return
        if self.sources.scale is not None:
            self.open_parts()
            return
        key, header, tried = "reflectance scale factor", self.raster.description.header, dict[float, str]()
        if self.quantity == "reflectance":
            with suppress(HypervalError):
                self.open_parts()
                return
            possible = {scale: ratios for scale in _SCALES if (ratios := self._ratios_to_spectra(scale)) is not None}
            agreeing = [scale for scale, ratios in possible.items() if ratios and 0.5 <= np.median(ratios) <= 2.0]
            tried = {s: f"{s:g}, the usual one that makes reflectances" for s in [*possible][:1] if s != _THOUSANDS}
            tried = {scale: f"{scale:g}, by which it agrees with the field spectra" for scale in agreeing} or tried
        elif header and "data gain values" not in header.entries and (factor := header.number(key)):
            why = f"1/{factor:g}: the header has a {key!r} although it holds radiance"
            tried = {1.0 / factor: why}
        self._state_first(self.collection["cube"], "scale", {scale: {"why": why} for scale, why in tried.items()})

    def _ratios_to_spectra(self, scale: float) -> list[float] | None:
        """How many times the reflectance of its spectrum each region has by a scale; None: no values of an image."""
        cube, ratios = {**self.collection["cube"], "scale": scale}, list[float]()
        try:
            self.open_parts(cube=cube)
        except HypervalError:
            return None
        for entry in self.collection["regions"] if self.sources.regions else ():
            self._coordinates(entry, cube=cube, regions=[entry])
        place = self.open_parts(cube=cube, regions=self.collection["regions"])
        good, centre = place.cube.axis.good, place.cube.axis.centre_nm
        for name in place.regions:
            if (match := self.find_spectrum(name)) is not None:
                reflectance = np.interp(centre, match.record.wavelength_nm, match.record.values, np.nan, np.nan)
                spectra = place.cube.spectra(drawn_pixels(place.region(name), _SOME, np.random.default_rng(0)))
                ratio = (spectra.sum(axis=0) / (len(spectra) * reflectance))[good & np.isfinite(reflectance)]
                ratios += [float(np.median(ratio))] if ratio.size else []
        return ratios

    def _coordinates(self, entry: Entry, **parts: Any) -> None:
        """State those of a file of regions where they are not those of its format."""
        kinds = {kind: {"file": entry["file"], "kind": kind} for kind in ("pixel", "map")}
        self._state_first(entry, "coordinates", kinds, **parts)

    def _state_first(self, entry: Entry, key: str, values: Mapping[Any, Mapping[str, Any]], **parts: Any) -> None:
        """State the first value of a key with which the collection opens, and its guess; none where it opens so.

        A scale that nothing tells is left to be filled in.
        """
        try:
            self.open_parts(**parts)
        except HypervalError as first:
            for value, words in values.items():
                entry[key] = value
                with suppress(HypervalError):
                    self.open_parts(**parts)
                    return self.guess(key, **words)
            if key != "scale" or "scale:" not in (first.mend or ""):
                raise first from None
            entry[key] = f"{FILL_IN}: what multiplies the stored values, such as 0.001 (--scale)"

    def _place(self) -> Place:
        """The opened collection, its targets one material for each region of their file."""
        parts: Entry = {"regions": self.collection["regions"]}
        if self.sources.targets is not None:
            size = self.sources.pixel_size_m
            truth = {"guard_pixels": 2} | ({"pixel_size_m": size} if size is not None else {})
            file = self.reference(self.sources.targets)
            listed: Entry = {"csv": file}
            head = decoded(head_of(self.sources.targets, 4096)).partition("\n")[0].lower()
            if not (self.sources.targets.suffix.lower() == ".csv" and re.search("material|targets_type", head)):
                entry = {"material": "every region", "file": file}
                settings = parts | {"targets": {"regions": [entry], **truth}}
                self._coordinates(entry, **settings)
                names = dict.fromkeys(target.attributes["region"] for target in self.open_parts(**settings).targets)
                listed = {"regions": [{**entry, "material": name, "regions": [escape(name)]} for name in names]}
            parts["targets"] = self.collection["targets"] = listed | truth
        return self.open_parts(**parts)

    # Spectra ----------------------------------------------------------------------------------------------------------

    @cached_property
    def spectra(self) -> list[RecordedSpectrum]:
        """The reflectance spectra of the files, with the unit that each needs to be told; one in two formats once."""
        out: list[RecordedSpectrum] = []
        for path in self.sources.spectra:
            # Of a library the header is read beside it.
            for file in sorted({*path.rglob("*")} - {*path.rglob("*.hdr")}) if path.is_dir() else [path]:
                with suppress(*([] if file == path else [HypervalError])):  # of a folder files of spectra count alone
                    out += [one for one in _read_spectra(file, self.reference(file)) if not any(map(one.is_copy, out))]
        return out

    @cached_property
    def averages(self) -> list[list[RecordedSpectrum]]:
        """The spectra, of replicates the mean: of names that differ in their last number alone; by name of folder.

        >>> of = lambda name, level: FieldSpectrum(name, np.array([500.0, 600.0]), np.array([1.0, 2.0]) * level)
        >>> draft = Draft(StarterSources(Path()), Path(), None, "")
        >>> files = {"turf/s1": 0.2, "turf/s2": 0.21, "lot/s1": 0.3, "lot/s2": 0.31, "DryClay1": 0.1, "DryClay2": 0.1}
        >>> files["lot_edge"] = 0.3  # goes before the mean of a folder
        >>> draft.spectra = [RecordedSpectrum(Path(f).name, {"file": f}, of(f, level)) for f, level in files.items()]
        >>> [draft.find_spectrum(name).source for name in ("turf", "dry", "lot")]
        [{'replicates': {'files': ['turf/s1', 'turf/s2']}}, {'replicates': {'files': ['DryClay1', 'DryClay2']}},
        {'file': 'lot_edge'}]
        >>> draft.collection, draft.content = {"cube": {}}, {"turf": draft.find_spectrum("turf").source}
        >>> draft._note_unused()
        >>> draft.guesses["scenarios", "scene"].rpartition(": ")[2]
        'turf'
        """
        numbered = grouped(self.spectra, lambda one: re.sub(r"[0-9]+(?=[^0-9]*$)", "#", _parted(one.name)))
        folders = grouped(self.spectra, lambda one: Path(one.source["file"]).parent.name)
        return [[one for n, members in each.items() for one in _averaged(n, members)] for each in (numbered, folders)]

    def find_spectrum(self, name: str) -> RecordedSpectrum | None:
        """The spectrum of the same name, else the only one with all its words, else the only one whose words it has.

        Replicates are one where no single spectrum fits; what an instrument shows of its own white reference, or in
        the dark, is none of the scene, unless the scene has such a panel.
        """
        words, is_reference = _words(name), _REFERENCE.search(name)
        tests, both = (frozenset.__eq__, frozenset.__ge__, frozenset.__le__), (self.spectra, self.averages[0])
        pools = [[s for s in p if _words(s.name) and (is_reference or not _REFERENCE.search(s.name))] for p in both]
        fits = ([s for s in pool if test(_words(s.name), words)] for test, pool in product(tests, pools))
        in_folder = [s for s in self.averages[1] if _words(s.name) == words]
        return next((matches[0] for matches in (*fits, in_folder) if len(matches) == 1), None)

    def _note_unused(self) -> None:
        """Say which options and files of spectra stand nowhere in the campaign, and which replicates are averaged."""
        text, sources = str(self.content), self.sources
        if FILL_IN in str(cube := self.collection["cube"]):
            return  # of which nothing is drafted yet
        keys = dict.fromkeys(("time_utc", "altitude_km", "sensor"), "atmosphere")
        keys |= {"unit": "unit", "pixel_size_m": "pixel_size_m"}
        unread = [k for k, key in keys.items() if getattr(sources, k) is not None and f"'{key}'" not in text]
        if options := [f"--{name.removesuffix('_utc').replace('_', '-')}" for name in unread]:
            self.guess("unread", names=", ".join(options), quantity=self.quantity)
        if means := {of: s.name for s in chain(*self.averages) if "replicates" in (of := str(s.source)) and of in text}:
            self.guess("replicates", names=", ".join(means.values()))
        files = [] if "by_number" in cube else [spectrum.source["file"] for spectrum in self.spectra]
        idle = dict.fromkeys(file for file in files or map(str, self.sources.spectra) if repr(file) not in text)
        if names := [Path(file).name for file in idle]:
            self.guess("unused", names=", ".join(names[:_MAX_NAMED]) + ", ..." * (len(names) > _MAX_NAMED))

    # The model --------------------------------------------------------------------------------------------------------

    def _scenario(self, place: Place, panels: Sequence[str], matched: Mapping[str, RecordedSpectrum]) -> Entry:
        """Classes, panels, atmosphere and sensor of the model; UsageError where nothing has a reflectance."""
        ground = [region for region in place.regions if region not in panels and place.pixels_of(region).any()]
        measured = self.quantity == "reflectance" or "empirical_line" in self.collection
        single = [region for region in ground if place.pixels_of(region).sum() == 1]  # whose spread nothing tells
        classes = [region for region in ground if (measured and region not in single) or region in matched]
        refuse(not classes, "starter.ground", names=", ".join(ground) or "regions")
        pixels = np.array([place.pixels_of(region).sum() for region in classes], float)
        shares = np.round(pixels / pixels.sum(), 4)
        shares[-1] = 1.0 - shares[:-1].sum()
        surfaces: list[Entry] = []
        for region, share in zip(classes, shares, strict=True):
            surfaces.append({"name": region, "fraction": round(float(share), 4), "spectrum": {"measured": region}})
            if region in matched:
                spread = {"measured": region} if measured and region not in single else {"relative_sd": 0.1}
                surfaces[-1] |= {"spectrum": matched[region].source, "covariance": spread}
        scene: Entry = {"classes": surfaces, "adjacency": {"effective_neighbours": None}}
        alone = ", ".join(region for region in single if region not in classes)
        without = f"; single pixels have no spread and are none: {alone}" * bool(measured and alone)
        self.guess("classes", without=without)
        if with_spectra := [{"name": panel, "spectrum": matched[panel].source} for panel in panels if panel in matched]:
            scene["panels"] = with_spectra
        flight = self._flight(place) if self.quantity == "radiance" else {}
        processing: Entry = {"detectors": ["cem"], "bands": {"drop_bad": True}}
        processing |= {} if self.quantity == "radiance" and measured else {"elm": "none"}
        return {"schema": 1, "name": self.name, **flight, "scene": scene, "processing": processing}

    def _flight(self, place: Place) -> Entry:
        """Atmosphere, sun, sensor, and what is known of them."""
        sources, template = self.sources, _templates()["flight"]
        state, self.collection["calibration"] = {**template["atmosphere"]}, template["calibration"]
        for name in ("atmosphere", "state", "calibration"):
            self.guess(name)
        if (centre := cube_centre(place)) is not None:
            state["latitude_deg"], state["longitude_deg"] = (round(degrees, 4) for degrees in centre)
        stated = {"sensor_altitude_km": sources.altitude_km, "time_utc": sources.time_utc}
        if not sources.time_utc:
            time_text = place.cube.raster.description.entries.get("acquisition time", "")
            with suppress(UsageError):  # of no time, or in a form that is not clear
                time, clock = parse_utc(time_text), re.search("[T ]([0-9].*)", time_text)
                stated["time_utc"] = f"{time:%Y-%m-%dT%H:%M:%SZ}" if clock else None  # a day has no sun
                if clock and not re.search("[Zz+-]", clock[1]):
                    self.guess("time")
        state |= {key: value for key, value in stated.items() if value is not None}
        sensor_file = Path(sources.sensor or "")
        sensor = self.reference(sensor_file) if sensor_file.is_file() else sources.sensor or self._library_sensor(place)
        return {"atmosphere": state, "sensor": sensor, "uncertainty": {**template["uncertainty"]}}

    def _library_sensor(self, place: Place) -> str:
        """The sensor of the library with the bands of the image."""
        axis = place.cube.axis
        for name in library_names():
            bands = load_sensor(name).axis
            if len(bands) == len(axis) and np.all(np.abs(bands.centre_nm - axis.centre_nm) < bands.fwhm_nm):
                self.guess("sensor", name=name)
                return name
        return f"{FILL_IN}: no sensor of the library has these {len(axis)} bands: --sensor FILE (hyperval sensor new)"

    def _add_targets(self, place: Place, scenario: Entry) -> None:
        """Detection in the image, and the targets of the model."""
        materials = list(dict.fromkeys(target.material for target in place.targets))
        spectra = {m: match for m in materials if (match := self.find_spectrum(m))}
        if not spectra and len(materials) == len(self.spectra) == 1:
            spectra = {materials[0]: self.spectra[0]}
            self.guess("only one", spectrum=self.spectra[0].name, material=materials[0])
        if not spectra:
            return
        if self.quantity == "radiance" and "empirical_line" not in self.collection:
            self.guess("no detection")
            return
        members = {material: [t for t in place.targets if t.material == material] for material in spectra}
        sizes = {material: _group_by_side(same) for material, same in members.items()}
        looked_for = [{"name": m, "material": m, "spectrum": match.source} for m, match in spectra.items()]
        group = "{target} {side_m} m" if all(sizes.values()) else "{material}"
        self.content["detection"] = {"group": group, "detectors": ["cem"], "targets": looked_for}
        classes = [c["name"] for c in scenario["scene"]["classes"]]
        entries = scenario["scene"]["targets"] = []
        for material, same in members.items():
            each = sizes[material].items() if all(sizes.values()) else ()
            subjects = [{"name": f"{material} {m} m", "fill": _fill(place, same_size)} for m, same_size in each]
            fills = {"subjects": subjects} if subjects else {"fill": _fill(place, same)}
            spread = {"relative_sd": 0.03, "band_sd": 0.001}
            target = {"name": material, "spectrum": spectra[material].source, "covariance": spread}
            entries.append({**target, "host": _host(place, same, classes), **fills})
        self.guess("targets")

    def _add_comparisons(self, scenario: Entry) -> None:
        """Add a scenario, how well its field spectra are known, and the usual comparisons of what both sides have."""
        scene, lit, targets = scenario["scene"], "atmosphere" in scenario, scenario["scene"].get("targets", [])
        classes, panels, sought = (
            [surface["name"] for surface in scene.get(kind, []) if "measured" not in surface["spectrum"]]
            for kind in ("classes", "panels", "targets")
        )
        if compared := [*classes, *panels, *sought]:
            stated = [{"subject": name, "relative": 0.05, "correlation_nm": 200} for name in compared]
            scenario.setdefault("uncertainty", {})["field_spectra"] = stated
            self.guess("field spectra")
        reflects = "empirical_line" in self.collection or self.quantity == "reflectance"
        subjects = {
            "RADIANCE": [*classes, *panels] if lit else [],
            "PANELS": [panel for panel in panels if lit and panel in self.collection.get("snr_regions", ())],
            "REFLECTANCE": classes if reflects else [],
            "TARGETS": [s["name"] for target in targets for s in target.get("subjects") or [target]],
            "BACKGROUNDS": [background_of(target["name"]) for target in targets],
        }
        comparisons = [{**entry, "subjects": subjects[entry["subjects"]]} for entry in _templates()["comparisons"]]
        self.content |= {"scenarios": [scenario], "comparisons": [entry for entry in comparisons if entry["subjects"]]}

    # Counts, or an image without wavelengths: a map of objects, and what they stand before ----------------------------

    def _draft_by_objects(self, why_by_number: str) -> None:
        collection = self.collection
        collection["cube"]["by_number"] = True
        collection.pop("targets", None)
        collection["regions"] = [_WHOLE, *(one for one in collection["regions"] if one != _WHOLE)]
        self.guess(why_by_number)
        detection = {"background": ["scene"], "false_alarms": ["scene"], "bands": "good", "detectors": ["rx"]}
        self.content["detection"] = detection
        masks, why, others = self._object_masks()
        if len(masks) < 2:
            self.guess("anomalies", why=why)
            return
        scored, target_pixels = masks[::2], np.logical_or.reduce(masks[1::2])
        marked = {"known objects": target_pixels, "other materials": others}
        marked |= {f"scored object {i}": mask for i, mask in enumerate(scored, 1)}
        rows = [f"{name},{line},{sample}\n" for name, mask in marked.items() for line, sample in np.argwhere(mask)]
        write_text(self.folder / "objects.csv", "region,line,sample\n" + "".join(rows))
        spectra = self.open_parts().cube.spectra(target_pixels)
        mean = "\n".join(map(repr, np.nan_to_num(spectra.mean(axis=0)).tolist()))
        write_text(self.folder / "target.txt", f"# mean of the known objects, one row a band\n{mean}\n")
        template, pixels = _templates()["objects"], int(np.sum(target_pixels))
        left_out = [name for name in template["collection"]["leave_out"] if marked[name].any()]
        collection["regions"] += [{"name": name, "file": "objects.csv"} for name in left_out]
        collection |= {**template["collection"], "leave_out": left_out}
        detection |= template["detection"]
        few = {"covariance": {"relative_sd": 0.05}} if pixels < _FEW else {}
        scene = {**template["scene"], "targets": [{**target, **few} for target in template["scene"]["targets"]]}
        model = {"schema": 1, "name": self.name, "scene": scene, "processing": template["processing"]}
        self.guess("objects", why=why, scored=len(scored), pixels=pixels)
        self.guess("objects filled")
        self._add_comparisons(model)

    def _object_masks(self) -> tuple[list[Mask], str, Mask]:
        """The objects of the map, the largest first, words on them, and pixels of other materials.

        In a map of several materials the objects are the connected groups of the material with most of them; where
        each value marks one group, values are numbers of objects.
        """
        targets, none = self.sources.targets, "no map of objects is there (--targets)"
        nowhere = np.zeros(self.raster.size[:2], bool)
        if targets is None and " file" not in self.raster.description.product:  # none in the file of the image itself
            return [], none, nowhere
        try:
            source, raster = targets or self.sources.cube, self.raster
            regions = read_regions(source, raster.size[:2], transform=raster.transform, crs=raster.crs)
        except HypervalError as error:
            if targets is not None:
                raise
            return [], f"{none}: {error.what}", nowhere
        groups = {name: objects(region.mask)[1] for name, region in regions.items()}
        most = max(groups, key=lambda name: groups[name])
        materials = np.logical_or.reduce([region.mask for region in regions.values()])
        mask = materials if groups[most] < 2 else regions[most].mask
        masks, why = groups_by_size(mask)
        rest = materials & ~mask
        return masks, why + f" of {most!r}; other materials of the map are left out" * bool(rest.any()), rest


def _parted(name: str) -> str:
    """A name in small letters, words in CamelCase parted."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()


def _words(name: str) -> frozenset[str]:
    """Words and numbers of a name in small letters; CamelCase and underscores part them."""
    return frozenset(re.findall(r"[a-z]+|[0-9]+", _parted(name)))


def _read_spectra(path: Path, reference: str) -> list[RecordedSpectrum]:
    for unit in _UNITS:
        with suppress(UsageError, InputError):
            records = read_records(path, reflectance_unit=unit)
            if unit is None or max(np.nanpercentile(one.values, 95) for one in records) <= 1.5:
                more = {"reflectance_unit": unit} if unit else {}
                if len(records) == 1:
                    return [RecordedSpectrum(path.stem, {"file": reference, **more}, records[0])]
                return [RecordedSpectrum(r.name, {"file": reference, "record": r.name, **more}, r) for r in records]
    read_records(path)  # the reader's own words for what is wrong
    raise refusal("starter.unit", path)


def _averaged(name: str, members: Sequence[RecordedSpectrum]) -> Sequence[RecordedSpectrum]:
    """The mean of spectra under one name, where they are as bright to a third; else the spectra as they are.

    Spectra of other keys, such as records of a file, or in another unit are no replicates.

    >>> one = FieldSpectrum("lawn", np.array([500.0, 600.0]), np.array([0.2, 0.4]))
    >>> sources = {"file": "1.csv"}, {"file": "2.csv"}, {"file": "all.csv", "record": "lawn3"}
    >>> each = [RecordedSpectrum(f"lawn{i}", {**source, "reflectance_unit": "percent"}, one)
    ...         for i, source in enumerate(sources, 1)]
    >>> (mean,), unlike = _averaged("lawn#", each[:2]), _averaged("lawn#", each)
    >>> mean.source, len(unlike)
    ({'replicates': {'files': ['1.csv', '2.csv'], 'reflectance_unit': 'percent'}}, 3)
    """
    source, nm = members[0].source, members[0].record.wavelength_nm
    values = [np.interp(nm, one.record.wavelength_nm, one.record.values) for one in members]
    mean = np.mean(values, axis=0)
    unlike = max(float(np.median(np.abs(one - mean))) for one in values) > np.median(mean) / 3.0
    origins = {(*one.source, one.source.get("reflectance_unit")) for one in members}  # keys, and unit
    if len(members) < 2 or unlike or len(origins) > 1:
        return members
    files = {"files": list(dict.fromkeys(one.source["file"] for one in members))}
    records = {"records": [one.source["record"] for one in members]} if "record" in source else {}
    unit = {key: value for key, value in source.items() if key == "reflectance_unit"}
    return [RecordedSpectrum(name, {"replicates": files | records | unit}, replace(members[0].record, values=mean))]


def _group_by_side(members: Sequence[TargetObject]) -> dict[str, list[TargetObject]]:
    """Squares of known sizes by their side, greatest first; empty where they are all alike, not known, or many."""
    largest_first = sorted(members, key=lambda target: -target.side_m)
    each = grouped(largest_first, lambda target: target.attributes.get("side_m", ""))
    is_known = "" not in each and all(math.isfinite(target.side_m) for target in members)
    return each if is_known and 1 < len(each) <= _MAX_SIZES else {}


def _host(place: Place, members: Sequence[TargetObject], classes: Sequence[str]) -> str:
    """The class with the most pixels around the targets; where none is there, that of the most similar spectrum."""
    ring = guard(all_pixels(members, place.cube.shape), _RING_PIXELS) & ~place.near_targets
    likeness = [float(np.sum(ring & place.region(name))) for name in classes]
    if max(likeness) == 0.0 and ring.any():
        good, rng = place.cube.axis.good, np.random.default_rng(0)
        masks = [ring, *(place.region(name) for name in classes)]
        around, *means = (place.cube.spectra(drawn_pixels(m, _SOME, rng))[:, good].mean(axis=0) for m in masks)
        likeness = [around @ m / (np.linalg.norm(around) * np.linalg.norm(m)) for m in means]
    return classes[int(np.argmax(likeness))]


def _fill(place: Place, members: Sequence[TargetObject]) -> Entry:
    """Fill from the geometry of the objects of a material; whole pixels where the ground size is not known."""
    if place.pixel_area_m2 is None:
        return {"fixed": 1.0}
    gsd = math.sqrt(place.pixel_area_m2)
    pixels = float(np.mean([target.part.sum() for target in members]))
    sides = [target.side_m for target in members if math.isfinite(target.side_m)]
    side = float(np.mean(sides)) if sides else gsd * math.sqrt(pixels)
    shape = {"side_m": round(side, 3), "heading_deg": "random", "gsd_m": round(gsd, 4), "pixels": "ranked"}
    return {"geometry": {**shape, "n": max(1, min(400, round(pixels)))}}


def guess_quantity(raster: Raster) -> str | None:
    """Whether an image holds radiance or reflectance, by words of its header, else by its name; None: nothing says."""
    entries = raster.description.entries
    texts = (text for key, text in entries.items() if re.search(r"unit|plot titles|description|level", key))
    for text in (" ".join(texts).lower(), raster.path.name.lower()):
        named = [quantity for quantity, pattern in _NAMED.items() if re.search(pattern, text)]
        if len(named) == 1:
            return named[0]
        if not named and raster.description.unit_in_entries()[1] is not None:
            return "radiance"
    return None

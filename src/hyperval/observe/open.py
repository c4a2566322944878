"""A collection opened: the cube, its regions and targets as one label image, and the pixels of each population.

Regions are read from files, drawn, found by rules on spectra, or made of other regions.  Truth images are finer than
the cube, or of its size with bands of material numbers and of abundances.  A finer map of classes says which part of
the ground is target: the fill of a pixel is the integral of its response, the square aperture convolved with the
Gaussian of the sensor, over that part (f of 3.10).  The response is a product of one along lines and one along samples,
so that the fills of a window are W_y M W_x^T with closed W: exact for cells whose sides run along those of the pixels.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property, partial
from glob import escape
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from affine import Affine
from scipy import ndimage
from scipy.special import ndtri

from hyperval import imagery
from hyperval.collection import (
    AbundanceTruth,
    BandRange,
    BandTableFile,
    CollectionSection,
    CubeSource,
    FinerTruth,
    NormalizedDifference,
    RegionSource,
    TargetRasters,
    TargetTruth,
    VectorSource,
)
from hyperval.config import twice
from hyperval.data import Array, Index, Mask, SampleStatistics
from hyperval.errors import InputError, UsageError, filled_words, needed, one_of, reader, refusal, refuse
from hyperval.imagery import Cube, LocationTable, Raster, Region, TargetObject
from hyperval.imagery.regions import connected_patches, outside_error
from hyperval.imagery.truth import mask_window
from hyperval.model.fill import aperture_weights
from hyperval.paths import Resolve, checked_file, read_text
from hyperval.pixels import SCENE as SCENE
from hyperval.pixels import EmpiricalLine, Labels
from hyperval.progress import track
from hyperval.spectra import SIGMA_PER_FWHM, SpectralAxis, fwhm_from_spacing, number_table, spacing_note
from hyperval.units import RADIANCE_UNIT, plausible, to_internal

IMAGE = "image"
MAX_TABLE_BYTES = 10 << 20
_CHUNK = 1024  # pixels whose spectra are read at once
MAX_CELLS = 400_000_000
MAX_OBJECTS = 10_000
MIN_FILL = 0.02  # pixels that are filled less are none of the target
SHIFTS = 32  # displacements of the finer image, where its registration has an error
_MAX_SKEW = 0.02  # [pixels] of a side of the finer image over its whole length
_REACH_SD = 5.0
_LINES = 64  # read at once
_GUARDED = "\0targets with their guard"  # a label's name that no region can have


@dataclass(frozen=True, eq=False)
class Place:
    """An opened collection.

    Attributes
    ----------
    cube : the image
    labels : regions as drawn, and target pixels with their guard ring and that of left-out regions, as one image
    targets : the target objects of the truth
    pixel_area_m2 : ground area of a pixel, None when the cube is not georeferenced
    target_pixels : which pixels of an object are scored: "touched" or "centre"
    by_rule : names of the regions found by a rule on the spectra
    notes : what was assumed or found on opening
    table : geographic lookup table of a cube in scanner geometry, None without
    leave_out : names of the regions that are left out
    statistics : of the regions and of the subjects of a detection, in the cube's values, once measured
    line : the empirical line, once it is fitted
    """

    cube: Cube
    labels: Labels
    targets: Sequence[TargetObject] = ()
    pixel_area_m2: float | None = None
    target_pixels: str = "touched"
    by_rule: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    table: LocationTable | None = None
    leave_out: frozenset[str] = frozenset()
    statistics: Mapping[str, SampleStatistics] = field(default_factory=dict)
    line: EmpiricalLine | None = None

    @cached_property
    def regions(self) -> Labels:
        """The regions as drawn; each mask is a new array."""
        return replace(self.labels, members={n: bits for n, bits in self.labels.members.items() if n != _GUARDED})

    def with_injected_error(self, mistake: Mapping[str, Any]) -> Place:
        """This place with an injected error; statistics and line are still to be measured.

        ``mistake`` : lines, samples by which targets are displaced; regions (1), that regions are too, except those in
        still, in which case targets are not; beyond, the part of all lines from which displacement begins; exchanged,
        two regions swapped; gain, relative error of each value; offset, relative to the mean of all good bands

        Where lines were lost in the middle of an image, what lies above stays:

        >>> from dataclasses import make_dataclass
        >>> image, one = make_dataclass("Image", ["shape", "gain", "offset"])((6, 1), 1.0, 0.0), np.ones((1, 1), bool)
        >>> guarded = np.array([[True], [False], [False], [True], [False], [False]])
        >>> labels = Labels.from_masks((6, 1), {_GUARDED: guarded})
        >>> planks = [TargetObject(f"plank {line}", "wood", 1.0, 1.0, (6, 1), (line, 0), one) for line in (0, 3)]
        >>> place = Place(image, labels, planks).with_injected_error({"lines": 2, "beyond": 0.5})
        >>> [target.corner[0] for target in place.targets], place.near_targets[:, 0].nonzero()[0].tolist()
        ([0, 5], [0, 5])

        An offset is relative to what good bands hold:

        >>> from types import SimpleNamespace
        >>> image.axis = SimpleNamespace(good=np.array([True, True, False]))
        >>> scene = {SCENE: SimpleNamespace(mean=np.array([1.0, 3.0, 1e9]))}
        >>> float(Place(image, labels, planks, statistics=scene).with_injected_error({"offset": 0.1}).cube.offset)
        0.2
        """
        cube, stated = self.cube, mistake
        shift, factor = (int(stated.get("lines", 0)), int(stated.get("samples", 0))), 1.0 + stated.get("gain", 0.0)
        members, pair = dict(self.labels.members), [n for n in stated.get("exchanged", ()) if n in self.regions]
        members |= dict(zip(pair, [members[name] for name in reversed(pair)], strict=True))
        labels, targets = replace(self.labels, members=members), self.targets
        if any(shift):
            displaced = [name for name in self.regions if stated.get("regions") and name not in stated.get("still", ())]
            first_line = int(stated.get("beyond", 0.0) * cube.shape[0])
            if len(displaced) in (0, len(self.regions)):
                targets = [target.displaced(*shift) if target.corner[0] >= first_line else target for target in targets]
                displaced = [*displaced, _GUARDED]
            labels = labels.displaced(displaced, shift, first_line)
        offset = factor * cube.offset
        if "offset" in stated:
            offset = offset + stated["offset"] * float(np.mean(self.statistics[SCENE].mean[cube.axis.good]))
        cube = replace(cube, gain=factor * cube.gain, offset=offset)
        return replace(self, cube=cube, labels=labels, targets=targets, statistics={}, line=None)

    @cached_property
    def classes(self) -> npt.NDArray[np.int32]:
        """(lines, samples) number of the class of each pixel: pixels that lie in the same regions are of one."""
        if not self.regions:
            return np.zeros(self.cube.shape, np.int32)
        membership = np.stack(list(self.regions.members.values()), axis=1)
        _, number = np.unique(membership, axis=0, return_inverse=True)
        return np.asarray(number.reshape(-1).astype(np.int32)[self.labels.number])

    @property
    def near_targets(self) -> Mask:
        """(lines, samples) target pixels with their guard ring."""
        return self.labels[_GUARDED]

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files of the cube and of its lookup table."""
        return self.cube.raster.source_files + (self.table.raster.source_files if self.table is not None else ())

    def counted(self, *names: str) -> Mask:
        """(K,) labels of the union of regions that count: without targets, their guard and regions that are left out.

        "scene" is all of these; "image" is every pixel, the targets too, as for a detector without knowledge of them.
        A region that is left out counts where it is named.
        """
        drawn, parts = self.labels.members, []
        all_labels = np.ones_like(drawn[_GUARDED])
        for name in names:
            masked = np.any([drawn[n] for n in (_GUARDED, *(() if name in self.leave_out else self.leave_out))], axis=0)
            mask = all_labels if name in (SCENE, IMAGE) else self._region_labels(name)
            parts.append(mask if name == IMAGE else mask & ~masked)
        return np.asarray(np.any(parts, axis=0))

    def pixels_of(self, *names: str) -> Mask:
        """(lines, samples) pixels of :meth:`counted`."""
        return self.labels.mask(self.counted(*names))

    def in_reflectance(self, sample: SampleStatistics) -> tuple[Array, Array]:
        """Mean (B,) and covariance (B, B) after the empirical line; as they stand without one."""
        if self.line is None:
            return sample.mean, sample.covariance
        return self.line.reflectance(sample.mean), sample.covariance / np.outer(self.line.gain, self.line.gain)

    def pixel_values(self, lines: Index, samples: Index, bands: Mask | slice = slice(None)) -> tuple[Array, Mask]:
        """(n, b) values of pixels (n,), in reflectance with a line, and the mask (n,) of those that hold data in the
        ``bands``, all by default.
        """
        values, usable = self.cube.marked_pixels((lines, samples))
        values = (values if self.line is None else self.line.reflectance(values))[:, bands]
        return values, usable if isinstance(bands, slice) else usable & np.isfinite(values).all(axis=1)

    def valid_pixels(self, lines: Index, samples: Index, bands: npt.NDArray[Any]) -> Iterator[tuple[Array, Mask]]:
        """Values (m, b) of those of the pixels (n,) that hold data in the ``bands``, and their mask, in chunks."""
        for start in range(0, lines.size, _CHUNK):
            chunk = slice(start, start + _CHUNK)
            values, valid = self.cube.marked_pixels((lines[chunk], samples[chunk]))
            values = values[:, bands]
            valid &= np.isfinite(values).all(axis=1)
            yield values[valid], valid

    def region(self, name: str) -> Mask:
        """The mask of a region; raises UsageError for a name that no region has."""
        return self.labels.mask(self._region_labels(name))

    def _region_labels(self, name: str) -> Mask:
        refuse(name not in self.regions, "place.region", name=name, known=one_of(self.regions, "a region"))
        return self.regions.members[name]


said = partial(filled_words, "observe/words.yaml")  # notes of an observation


def open_place(collection: CollectionSection, resolve: Resolve, mistake: Mapping[str, float] | None = None) -> Place:
    """Open the cube of a collection with its regions and truth.

    ``mistake`` : nm, displacement of its band centres; scale, relative to their distance from the middle

    Raises
    ------
    InputError : missing or corrupt files, regions outside the image.
    UsageError : names that do not fit.
    """
    image, stated = needed(collection.cube, "place.cube"), mistake or {}
    cube = open_source(image, resolve, collection.bands)
    centre = cube.axis.centre_nm + stated.get("nm", 0.0)
    centre = centre + stated.get("scale", 0.0) * (centre - centre.mean())
    cube = replace(cube, axis=replace(cube.axis, centre_nm=centre))
    table, table_notes = _lookup_table(cube, image, resolve)
    notes = [*cube.notes, *band_table_notes(collection.bands, cube.axis), *table_notes]
    notes += imagery.acquisition_notes(cube.raster.description.entries, cube.axis, cube.quantity)
    if cube.quantity == "counts" and collection.empirical_line is None:
        notes.append("warning: counts of unstated unit: values called reflectance are in counts")
    if table is not None:
        size = f", pixels of {table.pixel_area_m2:.3g} m2" if table.pixel_area_m2 else ""
        notes.append(f"places on the map are found by the lookup table {table.raster.path.name}{size}")
    truth, area_m2 = collection.targets, table.pixel_area_m2 if table is not None else cube.pixel_area_m2
    if truth is not None and truth.pixel_size_m is not None:
        georeferenced = cube.transform is not None and cube.pixel_area_m2 is not None
        refuse(table is not None or georeferenced, "place.position")
        area_m2 = truth.pixel_size_m**2
    site = _Site(cube, table, area_m2, resolve)
    regions: dict[str, Region] = {}
    for source in collection.regions:
        drawn = source.file is None
        new = {str(source.name): site.drawn_region(source, regions)} if drawn else site.regions_from_file(source)
        refuse(twice := sorted(set(new) & set(regions)), "place.twice", twice=twice)
        regions |= new
    targets, remarks = ([], []) if truth is None else site.target_objects(truth)
    guarded = imagery.all_pixels(targets, cube.shape)
    if targets and truth is not None and truth.guard_pixels:
        guarded = imagery.guard(guarded, truth.guard_pixels)
    if lacking := [name for name in collection.leave_out if name not in regions]:
        raise UsageError(f"leave_out names {lacking[0]!r}, which is not a region", expected=", ".join(regions))
    if collection.leave_out and collection.leave_out_guard_pixels:
        left_out = np.any([regions[name].mask for name in collection.leave_out], axis=0)
        margin = imagery.guard(left_out, collection.leave_out_guard_pixels) & ~left_out
        remarks = [*remarks, f"{int((margin & ~guarded).sum())} pixels around what is left out do not count either"]
        guarded = guarded | margin
    by_rule = frozenset(str(r.name) for r in collection.regions if r.normalized_difference is not None)
    notes += [*_region_notes(regions.values(), by_rule), *remarks, *_target_notes(regions.values(), targets, guarded)]
    labels = Labels.from_masks(cube.shape, {name: r.mask for name, r in regions.items()} | {_GUARDED: guarded})
    return Place(
        cube, labels, targets, area_m2, truth.pixels if truth else "touched", by_rule, tuple(notes), table,
        frozenset(collection.leave_out),
    )  # fmt: skip


def check_line_for_detection(place: Place, collection: CollectionSection) -> None:
    """Raise UsageError where targets are looked for in radiance without an empirical line to reflectance."""
    refuse(place.cube.quantity == "radiance" and collection.empirical_line is None, "place.line")


def open_source(source: CubeSource, resolve: Resolve, bands: BandTableFile | None = None) -> Cube:
    """Open the cube that a campaign names, with its bands from a table where the campaign names one."""
    # The unit that simulations write; other cubes without a unit are refused with the campaign.
    unit = source.unit or (RADIANCE_UNIT if source.quantity == "radiance" and not source.may_state_unit else None)
    stated = source.model_dump(include={"quantity", "variable", "engine", "scale", "wavelength_unit", "sort_bands"})
    axis: SpectralAxis | Literal["numbers"] | None = "numbers" if source.by_number else None
    if bands is not None and axis is None:
        axis = read_band_table(resolve(bands.path), bands)
    header = resolve(source.header) if source.header else None
    return imagery.open_cube(resolve(source.path), axis=axis, unit=unit, header=header, **stated)


@reader
def number_rows(path: Path, what: str) -> tuple[Array, int]:
    """Rows (n, columns) of a text table, and the line of the first; titles stand in one row, or begin with #."""
    checked_file(path, what=what, most=MAX_TABLE_BYTES)
    lines = [line.split("#")[0] for line in read_text(path).splitlines()]
    start = needed(next((number for number, line in enumerate(lines, 1) if line.strip()), None), "rows.none", path)
    header, rows, first_row = number_table("\n".join(lines), path)
    damaged = r"^[-+.]?[0-9]|(?<![^\s,;])[-+.]?[0-9][-+.0-9eE]*(?![^\s,;])"  # begins with a number, or holds one
    refuse(any(re.search(damaged, line) for line in header), "rows.heading", f"{path}:{start}")
    return rows, first_row


@reader
def read_band_table(path: Path, table: BandTableFile) -> SpectralAxis:
    """The spectral axis of a text table, whose first column often numbers the bands.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     _ = (path := Path(folder) / "bands.csv").write_text("Band,Wavelength\\n1,0.41\\n2,0.42\\n3,0.44\\n")
    ...     read_band_table(path, BandTableFile(path="", wavelength_unit="um", centre_column=1)).centre_nm
    ...     for column, unit in ((0, "um"), (1, "nm")):
    ...         try:
    ...             read_band_table(path, BandTableFile(path="", wavelength_unit=unit, centre_column=column))
    ...         except InputError as error:
    ...             print(error.what)
    array([410., 420., 440.])
    not a table of bands: column 0 holds 1 to 3 um
    not a table of bands: column 1 holds 0.41 to 0.44 nm

    Raises
    ------
    InputError : a table without numbers or of too few columns, or numbers that are no wavelengths in that unit.
    """
    last_column = max(table.centre_column, table.fwhm_column or 0)
    rows, first_row = number_rows(path, "table of bands")
    refuse(rows.shape[1] <= last_column, "rows.columns", f"{path}:{first_row}", shape=rows.shape, least=last_column + 1)
    stored, factor = rows[:, table.centre_column], to_internal(table.wavelength_unit, "wavelength")
    centre, numbers = stored * factor, stored[0] == 1.0 and np.all(np.diff(stored) == 1.0)
    refuse(numbers or not plausible(centre), "rows.bands", path, least=stored.min(), most=stored.max(), table=table)
    try:
        fwhm = fwhm_from_spacing(centre)[0] if table.fwhm_column is None else rows[:, table.fwhm_column] * factor
        return SpectralAxis(centre, fwhm)
    except UsageError as error:
        raise InputError(f"not a table of bands: {error.what}", where=str(path), expected=error.expected) from error


def band_table_notes(table: BandTableFile | None, axis: SpectralAxis) -> Iterator[str]:
    """Notes on the widths of an axis that a table of bands states."""
    if table is not None and table.fwhm_column is None:
        estimated_nm = axis.centre_nm[fwhm_from_spacing(axis.centre_nm)[1]]
        yield spacing_note("the band table's widths are not named (fwhm_column)", estimated_nm)


def _lookup_table(cube: Cube, source: CubeSource, resolve: Resolve) -> tuple[LocationTable | None, tuple[str, ...]]:
    """The lookup table of a cube in scanner geometry, stated or found, and notes on it."""
    if source.glt is None:
        return imagery.table_of(cube.raster)
    refuse(cube.transform is not None, "place.glt", source.path)
    return imagery.open_lookup_table(resolve(source.glt), cube.shape), ()


@dataclass(frozen=True)
class _Site:
    """The grid that regions and targets are drawn on: the cube, its lookup table, and a pixel's ground area [m2]."""

    cube: Cube
    table: LocationTable | None
    area_m2: float | None
    resolve: Resolve

    def read(self, path: Path, source: VectorSource, patterns: Sequence[str], **options: Any) -> dict[str, Region]:
        """Regions of a file, placed by the lookup table where there is one, else by the cube's transform."""
        table, cube = self.table, self.cube
        return imagery.read_regions(
            path, cube.shape, transform=table or cube.transform, crs=table.crs if table else cube.crs,
            coordinates=source.coordinates, name_field=source.name_field, patterns=patterns, **options,
        )  # fmt: skip

    def drawn_region(self, source: RegionSource, earlier: Mapping[str, Region]) -> Region:
        """A region that is drawn in the campaign; ``earlier``: those of the entries before it."""
        name, shape, made_of = str(source.name), self.cube.shape, source.half or source.ring
        if made_of is not None and made_of.of not in earlier:
            what, names = "half of" if source.half else "a ring around", one_of(earlier, "a region above it")
            raise refusal("place.above", "collection.regions", name=name, what=what, of=made_of.of, known=names)
        if source.rectangle is not None:
            line, sample, lines, samples = source.rectangle
            return imagery.rectangle_region(name, (line, line + lines - 1), (sample, sample + samples - 1), shape)
        if source.half is not None:
            return imagery.half_region(name, earlier[source.half.of], first=source.half.which == "first")
        if (ring := source.ring) is not None:
            if ring.outer_m is None:
                return imagery.ring_region(name, earlier[ring.of], ring.inner_pixels, float(ring.outer_pixels or 0.0))
            area_m2 = needed(self.area_m2, "place.metres", f"region {name!r}")
            sides = imagery.pixel_sides_m(self.cube.transform, area_m2)
            return imagery.ring_region(name, earlier[ring.of], ring.inner_m, ring.outer_m, sides)
        if source.normalized_difference is not None:
            return Region(name, self._normalized_difference(source.normalized_difference), "normalised difference")
        return Region(name, np.broadcast_to(np.True_, shape), "the whole image")

    def regions_from_file(self, source: RegionSource) -> dict[str, Region]:
        """The regions of a file, or of a truth image, by name."""
        path = self.resolve(str(source.file))
        if source.classes:
            return material_regions(source, self.cube, path)
        new = self.read(path, source, [] if source.name is None else [escape(source.name)])
        if source.name is None:
            return new
        chosen = next(iter(new.values())) if len(new) == 1 else new.get(source.name)
        chosen = needed(chosen, "place.no_region", path, name=source.name, names=", ".join(new))
        return {source.name: replace(chosen, name=source.name)}

    def _normalized_difference(self, rule: NormalizedDifference) -> Mask:
        """Pixels (lines, samples) whose (high - low)/(high + low) lies above and below the limits of ``rule``."""
        cube, chosen = self.cube, []
        for low, high in (rule.high_nm, rule.low_nm):
            bands = np.flatnonzero((cube.axis.centre_nm >= low) & (cube.axis.centre_nm <= high) & cube.axis.good)
            refuse(bands.size == 0, "place.no_band", low=low, high=high)
            chosen.append(bands)
        mask = np.zeros(cube.shape, bool)
        for block in track(cube.blocks(dtype=np.float32), "normalised difference"):
            high, low = (block.values[..., bands].mean(axis=-1, dtype=np.float64) for bands in chosen)
            with np.errstate(divide="ignore", invalid="ignore"):
                index = (high - low) / (high + low)
            rows = slice(block.first_line, block.first_line + block.values.shape[0])
            mask[rows] = block.valid & (index >= rule.above) & (index < rule.below)
        return mask

    def target_objects(self, truth: TargetTruth) -> tuple[list[TargetObject], list[str]]:
        """The target objects, and notes on how they were drawn."""
        cube, table, area = self.cube, self.table, self.area_m2
        if truth.csv is not None:
            side = math.sqrt(needed(area, "target.pixel", path := self.resolve(truth.csv)))
            placed = {"transform": table or cube.transform, "crs": cube.crs if table is None else table.crs}
            return imagery.read_targets(path, cube.shape, **placed, pixel_size_m=side), []
        if (image := truth.finer or truth.abundances) is not None:
            return image_targets(image, cube, area, self.resolve)
        if truth.rasters is not None:
            return self._raster_targets(truth.rasters), []
        return self._drawn_targets(truth)

    def _raster_targets(self, rasters: TargetRasters) -> list[TargetObject]:
        shape, masks = self.cube.shape, {}
        for material, reference in rasters.materials.items():
            regions = self.read(self.resolve(reference), VectorSource(), ())
            masks[material] = np.any([np.zeros(shape, bool), *(region.mask for region in regions.values())], axis=0)
        sizes = imagery.raster_of_size(self.resolve(rasters.size_classes), self.cube).read_bands(0, shape[0])
        return imagery.intersected_objects(masks, sizes.reshape(-1, shape[1]), rasters.side_m)  # of one band

    def _drawn_targets(self, truth: TargetTruth) -> tuple[list[TargetObject], list[str]]:
        """Objects drawn as regions: every pixel that a polygon touches, as targets may be smaller than a pixel."""
        targets: list[TargetObject] = []
        remarks: list[str] = []
        for source in truth.regions:
            path = self.resolve(source.file)
            drawn = self.read(path, source, source.regions, touched=True)
            fits = {p: [name for name in drawn if fnmatchcase(name, p)] for p in source.regions}
            if lacking := [pattern for pattern, names in fits.items() if not names]:
                raise UsageError(f"no region {lacking[0]!r}", where=str(path), expected=one_of(sorted(drawn)))
            matched = set().union(*fits.values()) if fits else set(drawn)
            chosen = [region for name, region in drawn.items() if name in matched]
            remarks += [f"{remark} (targets)" for region in chosen for remark in region.remarks]
            by_region = source.objects == "regions"
            new = imagery.region_objects(
                chosen, source.material, whole=by_region, side_m=source.side_m, pixel_area_m2=self.area_m2
            )
            # Class rasters of several materials may share names: the material distinguishes the objects.
            taken = {o.name for o in targets if o.material != source.material}
            targets += [replace(o, name=f"{o.material} {o.name}") if o.name in taken else o for o in new]
        double = twice(o.name for o in targets)
        refuse(double, "place.targets_twice", "targets.regions", names=double)
        return targets, remarks


def _region_notes(regions: Iterable[Region], by_rule: frozenset[str]) -> list[str]:
    """Notes on regions that leave the image, have holes (except those found by a rule), or share pixels."""
    listed = list(regions)
    notes = [remark for region in listed for remark in region.remarks]
    for region in listed:
        count, pixels = (0, 0) if region.name in by_rule else imagery.holes(region.mask)
        if count:
            notes.append(said("hole" if count == 1 else "holes", name=region.name, count=count, pixels=pixels))
    return notes + [f"the regions {a!r} and {b!r} share {n} pixels" for a, b, n in imagery.overlaps(listed)]


def _target_notes(regions: Iterable[Region], targets: Sequence[TargetObject], guarded: Mask) -> Iterator[str]:
    """Notes on regions that hold pixels of targets or of their guard, and on pixels shared by targets."""
    if not targets:
        return
    touched = np.zeros(guarded.shape, np.int32)
    for target in targets:
        touched[target.window] += target.part
    for region in regions:
        touched_count, guarded_count = int(np.sum(region.mask & (touched > 0))), int(np.sum(region.mask & guarded))
        if guarded_count:
            name = "guarded.all" if guarded_count == region.n else "guarded"
            yield said(name, region=region, inside=touched_count, guard=guarded_count - touched_count)
    shared = int(np.sum(touched > 1))
    if shared:
        kinds = {m: [o for o in targets if o.material == m] for m in dict.fromkeys(o.material for o in targets)}
        masks = (Region(m, imagery.all_pixels(objects, guarded.shape), "truth") for m, objects in kinds.items())
        words = ", ".join(f"{n} of {a!r} and {b!r}" for a, b, n in imagery.overlaps(list(masks)))
        yield f"{shared} pixels may hold parts of more than one target" + (f": {words}" if words else "")


@dataclass(frozen=True)
class FinerGrid:
    """Geometry of the cells of a finer image on the cube, and the sensor's blur.

    Attributes
    ----------
    corner : (2,) line and sample of the corner of its first cell, continuous pixel coordinates of the cube
    step : (2,) sides of a cell [pixels]
    blur : FWHM of the sensor's Gaussian along lines and along samples [pixels]
    shifts : (K, 2) equally likely displacements of the cells along lines and samples [pixels]
    """

    corner: Array
    step: Array
    blur: tuple[float, float] = (0.0, 0.0)
    shifts: Array = field(default_factory=lambda: np.zeros((1, 2)))


def window_fills(cells: Array | Mask, grid: FinerGrid, corner: tuple[int, int], size: tuple[int, int]) -> Array:
    """(K, lines, samples) fills of the pixels of a window by the cells of an image (f of 3.10).

    Parameters
    ----------
    cells : (h, w) part of each that is target
    grid : geometry of the cells
    corner, size : first line and sample of the window, and its lines and samples
    """
    y, x = (grid.corner[i] + grid.step[i] * np.arange(cells.shape[i] + 1) for i in (0, 1))
    part = cells.astype(float)
    fills = np.empty((len(grid.shifts), *size))
    for k, (dy, dx) in enumerate(grid.shifts):
        w_y = aperture_weights(y + dy, corner[0], size[0], grid.blur[0])
        fills[k] = w_y @ part @ aperture_weights(x + dx, corner[1], size[1], grid.blur[1]).T
    return np.clip(fills, 0.0, 1.0)


def registration_shifts(error_pixels: float, count: int = SHIFTS) -> Array:
    """(K, 2) equally likely displacements, normal with this standard deviation in each direction [pixels].

    A low-discrepancy sequence with mean 0 and exactly that spread; one displacement of 0 where there is no error.
    """
    if error_pixels == 0.0:
        return np.zeros((1, 2))
    uniform = (0.5 + np.arange(count)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    normal = ndtri(np.clip(uniform, 1e-3, 1.0 - 1e-3))
    normal -= normal.mean(axis=0)
    return np.asarray(error_pixels * normal / normal.std(axis=0))


def image_targets(
    truth: FinerTruth | AbundanceTruth, cube: Cube, pixel_area_m2: float | None, resolve: Resolve
) -> tuple[list[TargetObject], list[str]]:
    """The targets of a truth image with the fills of their pixels, and notes on them.

    Abundances are cells of one pixel each, without blur; DIRSIG writes them as bands of 64-bit numbers in the size of
    the radiance image, each with its name.

    Raises
    ------
    InputError : a finer image that is not finer, lies aslant or elsewhere, has none of the classes, or a target that
        leaves the cube; abundances of another size, in no such band, or that are no parts of a pixel.
    UsageError : an image without a place on the cube.
    """
    path, pixel_area = resolve(truth.image), math.nan if pixel_area_m2 is None else pixel_area_m2
    images: Iterator[tuple[str, Array | Mask, Array | Mask]]
    if isinstance(truth, FinerTruth):
        raster, error = imagery.open_raster(path), truth.registration_pixels or 0.0
        if truth.registration_m is not None:
            refuse(pixel_area_m2 is None, "finer.size", str(path))
            error = truth.registration_m / math.sqrt(pixel_area)
        blur = truth.psf_fwhm_pixels
        fwhm = blur if isinstance(blur, tuple) else (blur, blur)
        grid = replace(_cell_grid(truth, raster, cube, str(path)), blur=fwhm, shifts=registration_shifts(error))
        images = ((name, mask, mask) for name, mask in _class_cells(raster, path, truth.classes))
    else:
        grid, error = FinerGrid(np.zeros(2), np.ones(2)), 0.0
        images = _abundance_maps(truth, imagery.raster_of_size(path, cube), path)
    targets: list[TargetObject] = []
    for material, cells, covered in images:
        listed = list(islice(connected_patches(cells > 0, material, whole=truth.objects != "patches"), MAX_OBJECTS + 1))
        refuse(len(listed) > MAX_OBJECTS, "finer.patches", str(path), most=MAX_OBJECTS, material=material)
        for name, window, member in listed:
            part, start = np.where(member, cells[window], 0), np.array([side.start for side in window])
            shifted = replace(grid, corner=grid.corner + grid.step * start)
            corner, fills = _target_fills(name, part, shifted, cube.shape, str(path))
            area = float(covered[window][member].sum() * grid.step[0] * grid.step[1] * pixel_area)
            targets.append(target_from_fills(name, material, fills, corner, cube.shape, area, str(path)))
    filled = [(o.fills, o.part) for o in targets if o.fills is not None]
    mean, spread = (np.concatenate([stat(fills, axis=0)[part] for fills, part in filled]) for stat in (np.mean, np.std))
    if isinstance(truth, FinerTruth):
        note = f"{len(targets)} targets from {path.name}, {1 / grid.step[1]:.3g} times finer: {mean.size} pixels of "
        note += f"fill {mean.min():.3g} to {mean.max():.3g}, mean {mean.mean():.3g}"
        if error:
            note += f"; registration of {error:.3g} pixels makes {float(np.sqrt(np.mean(spread**2))):.2g} (RMS) of it"
        return targets, [note]
    remarks = [said("abundances", count=len(targets), pixels=mean.size, file=path.name, least=MIN_FILL)]
    return targets, [*remarks, said("abundances.whole", file=path.name)] if np.all(mean == 1.0) else remarks


def _cell_grid(truth: FinerTruth, raster: Raster, cube: Cube, source: str) -> FinerGrid:
    """Corner and step of the cells, by the map or as the campaign states them."""
    if truth.corner is not None and truth.times_finer is not None:
        grid = FinerGrid(np.array(truth.corner), np.full(2, 1.0 / truth.times_finer))
    else:
        fine, image = (needed(placed.transform, "finer.map", source) for placed in (raster, cube))
        if raster.crs is not None and cube.crs is not None and raster.crs != cube.crs:
            raise refusal("finer.crs", source, own=raster.crs.to_string()[:60], other=cube.crs.to_string()[:60])
        to_pixels: Affine = ~image @ fine
        skew = max(abs(to_pixels.b) * raster.lines, abs(to_pixels.d) * raster.samples)
        refuse(skew > _MAX_SKEW or to_pixels.a <= 0 or to_pixels.e <= 0, "finer.aslant", source)
        grid = FinerGrid(np.array([to_pixels.f, to_pixels.c]), np.array([to_pixels.e, to_pixels.a]))
    refuse(grid.step.max() > 0.5, "finer.cells", source, line_step=grid.step[0], sample_step=grid.step[1])
    return grid


def _class_cells(
    raster: Raster, path: Path, classes: Mapping[str, int | BandRange], default_band: int | str = 1
) -> Iterator[tuple[str, Mask]]:
    """Class -> mask (lines, samples) of its cells: a value of ``default_band``, or a range of another."""
    lines, samples = raster.lines, raster.samples
    refuse(lines * samples > MAX_CELLS, "finer.many", path, lines=lines, samples=samples, most=MAX_CELLS)
    for name, chosen in classes.items():
        limits = chosen if isinstance(chosen, BandRange) else BandRange(above=chosen, below=chosen)
        band = _band_index(raster, limits.band if limits is chosen else default_band, path)
        low, high = -np.inf if limits.above is None else limits.above, np.inf if limits.below is None else limits.below
        mask = np.empty((lines, samples), bool)
        for rows, values in _line_strips(raster, band):
            mask[rows] = (values >= low) & (values <= high)
        if not mask.any():
            present = np.unique(np.concatenate([np.unique(values) for _, values in _line_strips(raster, band)]))
            listed = ", ".join(f"{v:g}" for v in present[np.isfinite(present)][:20])
            raise InputError(f"no cell of {name!r}, {chosen}", where=str(path), expected=f"one of {listed}")
        yield name, mask


def _abundance_maps(truth: AbundanceTruth, raster: Raster, path: Path) -> Iterator[tuple[str, Array, Array]]:
    """Material -> (lines, samples) part of each pixel that it fills, 0 below the least; and the same with its edges."""
    for material, wanted in truth.materials.items():
        band = _band_index(raster, wanted, path)
        fill = np.concatenate([values for _, values in _line_strips(raster, band)]).astype(float)
        if not np.all((fill >= -1e-6) & (fill <= 1 + 1e-6)):
            raise refusal("truth.abundance", str(path), band=band + 1, low=np.nanmin(fill), high=np.nanmax(fill))
        fractions = np.where(fill >= MIN_FILL, np.minimum(fill, 1.0), 0.0)
        refuse(not fractions.any(), "truth.empty", str(path), material=material, least=MIN_FILL)
        yield material, fractions, with_edge_fills(np.clip(fill, 0.0, 1.0))


def with_edge_fills(fill: Array) -> Array:
    """Fills (lines, samples) of pixels of a target, with the smaller fills of pixels that touch them added.

    Pixels below the least fill do not belong to the target, and yet hold a part of its area.

    >>> with_edge_fills(np.array([[0.01, 0.3, 0.5, 0.0, 0.01]])).tolist()
    [[0.0, 0.31, 0.5, 0.0, 0.0]]
    >>> with_edge_fills(np.array([[0.01, 0.0], [0.0, 0.5]])).tolist()
    [[0.0, 0.0], [0.0, 0.51]]
    """
    filled_pixels = fill >= MIN_FILL
    distance, nearest = ndimage.distance_transform_edt(~filled_pixels, return_indices=True)
    edge, filled = ~filled_pixels & (distance < 2.0), np.where(filled_pixels, fill, 0.0)
    np.add.at(filled, tuple(nearest[:, edge]), fill[edge])
    return filled


def _target_fills(
    name: str, cells: Array | Mask, grid: FinerGrid, shape: tuple[int, int], source: str
) -> tuple[tuple[int, int], Array]:
    """Corner of the window of pixels that see some of the cells of a target, and their fills (K, h, w)."""
    starts, ends = grid.corner, grid.corner + grid.step * cells.shape
    if np.any(starts < 0) or np.any(ends > shape):
        mend = "check where the finer image lies; a target that the cube cuts is taken out of it"
        raise outside_error(np.array([starts, ends])[:, ::-1], shape, source, f"the target {name!r}", mend)
    reach = np.ceil(_REACH_SD * np.array(grid.blur) * SIGMA_PER_FWHM + np.abs(grid.shifts).max(axis=0))
    low = np.maximum(np.floor(starts) - reach, 0).astype(int)
    high = np.minimum(np.ceil(ends) + reach, shape).astype(int)
    corner, size = (int(low[0]), int(low[1])), (int(high[0] - low[0]), int(high[1] - low[1]))
    return corner, window_fills(cells, grid, corner, size)


def target_from_fills(
    name: str, material: str, fills: Array, corner: tuple[int, int], shape: tuple[int, int], area_m2: float, where: str
) -> TargetObject:
    """A target by the fills (K, h, w) of a window: its pixels are those of which the mean reaches 0.02."""
    mask = fills.mean(axis=0) >= MIN_FILL
    refuse(not mask.any(), "truth.fill", where, name=name, least=MIN_FILL)
    (line, sample), part = mask_window(mask)
    part_fills = fills[:, line : line + part.shape[0], sample : sample + part.shape[1]].copy()
    attributes = {"material": material, "region": name}
    return TargetObject(
        name, material, math.nan, area_m2, shape, (corner[0] + line, corner[1] + sample), part,
        attributes=attributes, fills=part_fills,
    )  # fmt: skip


def subject_fills(targets: Mapping[str, list[TargetObject]]) -> dict[str, list[list[float]]]:
    """Subject -> fills of the pixels of its objects in falling order, a row for each object and displacement.

    Rows are equally likely; displacements are thinned to about 64 rows.
    """
    rows: dict[str, list[list[float]]] = {}
    for subject, members in targets.items():
        listed = [(o.fills, o.part) for o in members if o.fills is not None]
        if len(listed) < len(members):
            continue
        # As many displacements of each object.
        count = min(max(1, 64 // len(listed)), *(len(fills) for fills, _ in listed))
        rows[subject] = [
            np.sort(fills[k][part])[::-1].tolist()
            for fills, part in listed
            for k in np.linspace(0, len(fills) - 1, count).astype(int)
        ]
    return rows


def material_regions(source: RegionSource, cube: Cube, path: Path) -> dict[str, Region]:
    """Regions by the numbers of materials in a band of a truth image.

    Raises
    ------
    InputError : another size than the cube's, no such band, or a number that no pixel has.
    """
    raster, band = imagery.raster_of_size(path, cube, source.name_field), 1 if source.band is None else source.band
    return {name: Region(name, mask, str(path)) for name, mask in _class_cells(raster, path, source.classes, band)}


def _band_index(raster: Raster, wanted: int | str, path: Path) -> int:
    """Index from 0 of a band that is named or numbered (from 1)."""
    names = raster.description.band_names
    if isinstance(wanted, int):
        refuse(not 1 <= wanted <= raster.bands, "truth.band", str(path), wanted=wanted, bands=raster.bands)
        return wanted - 1
    fits = [i for i, name in enumerate(names) if name == wanted]
    fits = fits or [i for i, name in enumerate(names) if fnmatchcase(name.lower(), wanted.lower())]
    choices = one_of(names, f"a number, 1 to {raster.bands}: its header has no name for each band")
    refuse(len(fits) != 1, "truth.bands", path, count=len(fits), wanted=wanted, known=choices)
    return fits[0]


def _line_strips(raster: Raster, band: int) -> Iterator[tuple[slice, Array]]:
    """Slices of lines of one band, and their values."""
    with raster.kept_open():
        for start in range(0, raster.lines, _LINES):
            rows = slice(start, min(start + _LINES, raster.lines))
            yield rows, raster.read_bands(start, rows.stop - start)[band]

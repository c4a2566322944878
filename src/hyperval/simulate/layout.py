"""Where things lie: classes, planks, fills and the regions of interest that are clear of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hyperval.errors import UsageError
from hyperval.simulate import streams
from hyperval.simulate.footprint import Footprint, side_for_fill, square_footprint
from hyperval.simulate.schema import SceneFile, TargetGroup

Mask = npt.NDArray[np.bool_]

SMALLEST_FILL = 1e-4  # a plank that gives less of a pixel's signal is left out of it


@dataclass(frozen=True)
class Plank:
    """One target object; positions in continuous pixel coordinates, side in pixels."""

    name: str
    group: TargetGroup
    centre_line: float
    centre_sample: float
    side_pixels: float
    heading_deg: float
    footprint: Footprint


@dataclass(frozen=True)
class Ground:
    """The scene on the ground before any spectrum is drawn.

    Attributes
    ----------
    surfaces : names of the classes, in the order of the indices in ``class_map``
    class_map : (lines, samples) uint8
    on_panel : (lines, samples) True where a panel lies
    planks : every target object
    fill : (lines, samples) float32 total share of planks
    """

    surfaces: tuple[str, ...]
    class_map: npt.NDArray[np.uint8]
    on_panel: Mask
    planks: tuple[Plank, ...]
    fill: npt.NDArray[np.float32]


def lay_out(scene: SceneFile) -> Ground:
    """Paint the classes and put the planks in place.

    Raises
    ------
    UsageError : ground that no class covers, a plank off its host class, planks that overlap.
    """
    surfaces = tuple(scene.surfaces())
    bare = 255
    if len(surfaces) > bare:
        raise UsageError(f"{len(surfaces)} classes", where=scene.name, expected=f"at most {bare}")
    class_map = np.full((scene.lines, scene.samples), bare, np.uint8)
    on_panel = np.zeros(class_map.shape, bool)
    for area in (*scene.layout, *scene.panels):
        class_map[slice(*area.lines), slice(*area.samples)] = surfaces.index(area.surface)
    for area in scene.panels:
        on_panel[slice(*area.lines), slice(*area.samples)] = True
    if np.any(class_map == bare):
        line, sample = (int(i) for i in np.argwhere(class_map == bare)[0])
        raise UsageError(
            f"line {line}, sample {sample} is covered by no class",
            where=scene.name,
            mend="let the first entry of 'layout' cover the whole image",
        )
    planks = tuple(plank for number, group in enumerate(scene.targets) for plank in _place(scene, number, group))
    fill = np.zeros(class_map.shape, np.float32)
    for plank in planks:
        _add_fill(plank, surfaces.index(plank.group.host), class_map, fill)
    if fill.size and float(fill.max()) > 1.0 + 1e-5:
        raise UsageError("planks of different groups overlap", where=scene.name, mend="move their areas apart")
    return Ground(surfaces, class_map, on_panel, planks, fill)


def _place(scene: SceneFile, number: int, group: TargetGroup) -> list[Plank]:
    rng = streams.generator(scene.seed, streams.PLACEMENT, number)
    psf = scene.psf_fwhm_pixels
    side = group.side_m / scene.gsd_m if group.side_m else side_for_fill(group.fill or 0.0, psf)
    step = group.spacing_pixels
    if side > 0.6 * step:
        raise UsageError(
            f"planks of {side * scene.gsd_m:.2f} m on a grid of {step} pixels see each other",
            where=f"{scene.name}: target group {group.name}",
            mend="raise spacing_pixels",
        )
    rows = np.arange(group.area.lines[0], group.area.lines[1] - step + 1, step) + step // 2
    columns = np.arange(group.area.samples[0], group.area.samples[1] - step + 1, step) + step // 2
    places = np.array([(r, c) for r in rows for c in columns])
    places = places[np.sort(rng.permutation(len(places))[: group.count])]
    planks = []
    same: Footprint | None = None  # centred planks of one heading share one footprint
    for index, (row, column) in enumerate(places):
        shift = rng.uniform(-0.5, 0.5, 2) if group.phase == "random" else np.zeros(2)
        heading = float(rng.uniform(0.0, 90.0)) if group.heading_deg == "random" else group.heading_deg
        y, x = row + 0.5 + shift[0], column + 0.5 + shift[1]
        if group.phase == "random" or group.heading_deg == "random" or same is None:
            seen = square_footprint(y, x, side, heading, psf)
            same, first = seen, (int(row), int(column))
        else:
            seen = Footprint(
                same.first_line + int(row) - first[0], same.first_sample + int(column) - first[1], same.fill
            )
        planks.append(Plank(f"{group.name}-{index:03d}", group, y, x, side, heading, seen))
    return planks


def touched(plank: Plank) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """Lines, samples and fills of the pixels that see a plank."""
    fill = plank.footprint.fill
    rows, columns = np.nonzero(fill >= SMALLEST_FILL)
    return rows + plank.footprint.first_line, columns + plank.footprint.first_sample, fill[rows, columns]


def _add_fill(plank: Plank, host: int, class_map: npt.NDArray[np.uint8], total: npt.NDArray[np.float32]) -> None:
    lines, samples, fill = touched(plank)
    inside = (lines >= 0) & (samples >= 0) & (lines < total.shape[0]) & (samples < total.shape[1])
    if not inside.all() or np.any(class_map[lines, samples] != host):
        raise UsageError(
            f"plank {plank.name} at line {plank.centre_line:.1f}, sample {plank.centre_sample:.1f} "
            f"reaches beyond its host {plank.group.host!r}",
            mend="move the area of the target group inside the class",
        )
    total[lines, samples] += fill.astype(np.float32)


def class_region(ground: Ground, surface: str, border_pixels: int, guard_pixels: int) -> Mask:
    """Pixels of a class away from its borders, from the panels and from every plank."""
    own = (ground.class_map == ground.surfaces.index(surface)) & ~ground.on_panel
    mask: Mask = own
    if border_pixels:
        square = np.ones((2 * border_pixels + 1,) * 2, bool)
        mask = ndimage.binary_erosion(own, square, border_value=1)
    seen = ground.fill > 0.0
    centres = np.zeros(seen.shape, bool)
    for plank in ground.planks:
        centres[int(plank.centre_line), int(plank.centre_sample)] = True
    guard = ndimage.binary_dilation(centres, np.ones((2 * guard_pixels + 1,) * 2, bool))
    return np.asarray(mask & ~seen & ~guard)


def regions(scene: SceneFile, ground: Ground) -> dict[str, Mask]:
    """The regions of interest by name: panel interiors first, then the classes.

    Raises
    ------
    UsageError : a region that holds no pixel.
    """
    masks: dict[str, Mask] = {}
    for panel in scene.panels:
        mask = np.zeros(ground.class_map.shape, bool)
        b = panel.border_pixels
        mask[panel.lines[0] + b : panel.lines[1] - b, panel.samples[0] + b : panel.samples[1] - b] = True
        masks[panel.name] = mask
    for region in scene.regions:
        masks[region.name] = class_region(ground, region.surface, region.border_pixels, scene.target_guard_pixels)
    for name, mask in masks.items():
        if not mask.any():
            raise UsageError(
                f"the region {name!r} holds no pixel", where=scene.name, mend="lower its border_pixels"
            )
    return masks

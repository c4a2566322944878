"""One simulated collection from a scene: the cube, written line by line, and its truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import UsageError
from hyperval.executors import in_order, single_blas_thread
from hyperval.files import write_text
from hyperval.folders import COLLECTION, whole_folder
from hyperval.imagery.envi_write import envi_writer, write_cube
from hyperval.progress import track
from hyperval.simulate import streams, truth
from hyperval.simulate.inputs import SimulationInputs, load_inputs
from hyperval.simulate.layout import Ground, lay_out, regions
from hyperval.simulate.radiometry import Detector, detector
from hyperval.simulate.schema import SceneFile, load_scene
from hyperval.simulate.surface import SurfaceRenderer

Array = npt.NDArray[np.float64]
T = TypeVar("T")

LINES_PER_BLOCK = 16
WORKERS = 2
MAX_CUBE_BYTES = 64 << 30
MAX_MAP_PIXELS = 1 << 26  # each pixel of the maps held in memory takes up to 40 bytes


@dataclass(frozen=True)
class SimulatedCollection:
    """Where the parts of a simulated collection lie and the numbers that describe it.

    Attributes
    ----------
    folder : holds everything
    cube : at-sensor radiance, ENVI BIL int16, header beside it
    regions, targets, panel_spectra, class_map, fill_map, truth : the truth (GeoJSON, CSV, CSV, ENVI, ENVI, JSON)
    average_reflectance : (B,) area average over the scene, the rho_ave of 3.8
    """

    folder: Path
    cube: Path
    regions: Path
    targets: Path
    panel_spectra: Path
    class_map: Path
    fill_map: Path
    truth: Path
    average_reflectance: Array


def simulate_to_folder(scene_yaml: Path, output: Path, *, show_progress: bool | None = None) -> int:
    """Simulate a scene file into ``output``, whose earlier files are replaced whole; returns the exit code 0.

    Raises
    ------
    UsageError : an invalid scene, or ``output`` holds files that no simulation wrote.
    InputError : no such scene file.
    """
    with whole_folder(output, COLLECTION) as folder:
        simulate(scene_yaml, folder, show_progress=show_progress)
    return 0


def simulate(
    scene: SceneFile | Path,
    folder: Path,
    *,
    inputs: SimulationInputs | None = None,
    lines_per_block: int = LINES_PER_BLOCK,
    show_progress: bool | None = None,
) -> SimulatedCollection:
    """Simulate a scene, or the scene file of that name, into an existing or new ``folder``.

    The same scene gives the same bytes whatever the block size: every line has its own random streams.

    Raises
    ------
    UsageError : an invalid scene, a layout that contradicts itself, a scene too large, radiance that does not
        fit the integers.
    InputError, EngineError : a missing file or atmosphere engine.
    """
    beside = Path()
    if not isinstance(scene, SceneFile):
        beside = Path(scene).parent
        scene = load_scene(Path(scene))
    inputs = inputs or load_inputs(scene, beside)
    bands = len(inputs.sensor.axis)
    _check_size(scene, bands)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    ground = lay_out(scene)
    masks = regions(scene, ground)
    renderer = SurfaceRenderer(scene, ground, inputs.classes)
    average, dark = average_reflectance(renderer, show=show_progress)
    chain = detector(inputs, average, scene.counts_per_radiance)
    files = {
        "regions": folder / "regions.geojson",
        "targets": folder / "targets.csv",
        "panel_spectra": folder / "panel_spectra.csv",
        "truth": folder / "truth.json",
    }
    ends = {"cube": "rad", "class_map": "class", "fill_map": "fill"}
    files |= {part: folder / f"{scene.name}_{end}.img" for part, end in ends.items()}
    saturated = _write_cube(files["cube"], scene, inputs, renderer, chain, lines_per_block, show_progress)
    truth.write_regions(files["regions"], scene, masks)
    truth.write_table(files["targets"], truth.TARGET_COLUMNS, truth.target_rows(scene, ground))
    truth.write_panel_spectra(files["panel_spectra"], scene)
    _write_maps(files["class_map"], files["fill_map"], scene, ground)
    facts = {
        "simulated": True,
        "scene": scene.model_dump(by_alias=True, mode="json"),
        "sensor": inputs.sensor.name,
        "atmosphere": {k: str(v) for k, v in inputs.terms.provenance.items()},
        "classes": {name: c.source for name, c in inputs.classes.items()},
        "surfaces": {str(i): name for i, name in enumerate(ground.surfaces, start=1)},
        "wavelength_nm": inputs.sensor.axis.centre_nm.tolist(),
        "average_reflectance": average.tolist(),
        "negative_reflectance_fraction": dark,
        "saturated_fraction": saturated,
    }
    write_text(files["truth"], json.dumps(facts, indent=1) + "\n")
    return SimulatedCollection(folder, **files, average_reflectance=average)


def average_reflectance(renderer: SurfaceRenderer, *, show: bool | None = None) -> tuple[Array, float]:
    """Area average (B,) of what the scene reflects, by rendering every line once.

    Also the share of drawn reflectances below 0, which a Gaussian law does not exclude.
    """

    def totals(line: int) -> tuple[Array, int]:
        rho = renderer.lit_reflectance(line)
        return rho.sum(axis=0, dtype=np.float64), int(np.count_nonzero(rho < 0.0))

    lines = renderer.scene.lines
    total, negative = np.zeros(renderer.bands), 0
    for part, count in track(_in_order(totals, range(lines)), "average reflectance", lines, show=show):
        total += part
        negative += count
    pixels = lines * renderer.scene.samples
    return total / pixels, negative / (pixels * renderer.bands)


def _write_cube(
    path: Path,
    scene: SceneFile,
    inputs: SimulationInputs,
    renderer: SurfaceRenderer,
    chain: Detector,
    lines_per_block: int,
    show: bool | None,
) -> float:
    """Write the cube; returns the share of samples beyond the detector's full scale."""

    def stored(line: int) -> tuple[npt.NDArray[np.int16], int]:
        rng = streams.generator(scene.seed, streams.NOISE, line)
        radiance = chain.radiance(renderer.lit_reflectance(line))
        values, clipped = chain.stored(chain.measured(radiance, rng))
        if clipped:
            raise UsageError(
                f"{clipped} radiances of line {line} do not fit 16-bit integers",
                where=scene.name,
                mend="lower counts_per_radiance",
            )
        return values, chain.saturated(radiance)

    axis = inputs.sensor.axis
    scale = 1.0 / scene.counts_per_radiance
    gains = ", ".join([repr(scale)] * len(axis))
    noun = "closure: surfaces drawn as the model assumes" if scene.mode == "closure" else "broken assumptions"
    with envi_writer(
        path,
        lines=scene.lines,
        samples=scene.samples,
        bands=len(axis),
        data_type=2,
        interleave="bil",
        axis=axis,
        description=(
            f"SIMULATED at-sensor radiance, scene {scene.name} ({noun}), seed {scene.seed}, "
            f"stored integers x {scale:g} = uW cm-2 sr-1 nm-1; no instrument collected it"
        ),
        transform=_transform(scene),
        crs=_crs(scene),
        extra={
            "sensor type": f"{inputs.sensor.name} (simulated)",
            **({"acquisition time": scene.acquired_utc} if scene.acquired_utc else {}),
            "data gain values": "{" + gains + "}",
            "data offset values": "{" + ", ".join(["0"] * len(axis)) + "}",
            **scene.header,
        },
    ) as writer:
        lines = track(_in_order(stored, range(scene.lines)), "cube", scene.lines, show=show)
        saturated = 0
        for block in _blocks(lines, lines_per_block):
            writer.write(np.stack([values for values, _ in block]))
            saturated += sum(count for _, count in block)
    return saturated / (scene.lines * scene.samples * len(axis))


def _write_maps(class_path: Path, fill_path: Path, scene: SceneFile, ground: Ground) -> None:
    place = {"transform": _transform(scene), "crs": _crs(scene)}
    write_cube(
        class_path,
        ground.class_map[:, :, None] + np.uint8(1),  # 0 stands for "no class" in this format
        data_type=1,
        interleave="bsq",
        description="SIMULATED truth: surface class",
        file_type="ENVI Classification",
        extra={
            "classes": str(len(ground.surfaces) + 1),
            "class names": "{" + ", ".join(("Unclassified", *ground.surfaces)) + "}",
        },
        **place,
    )
    write_cube(
        fill_path,
        ground.fill[:, :, None],
        data_type=4,
        interleave="bsq",
        description="SIMULATED truth: share of planks in the pixel's signal",
        **place,
    )


def _transform(scene: SceneFile) -> Affine:
    return Affine(scene.gsd_m, 0.0, scene.map.easting_m, 0.0, -scene.gsd_m, scene.map.northing_m)


def _crs(scene: SceneFile) -> CRS:
    return CRS.from_epsg((32600 if scene.map.hemisphere == "north" else 32700) + scene.map.utm_zone)


def _check_size(scene: SceneFile, bands: int) -> None:
    pixels = scene.lines * scene.samples
    if pixels > MAX_MAP_PIXELS or 2 * pixels * bands > MAX_CUBE_BYTES:
        raise UsageError(
            f"{scene.lines} lines x {scene.samples} samples x {bands} bands is too large",
            where=scene.name,
            expected=f"at most {MAX_MAP_PIXELS} pixels and {MAX_CUBE_BYTES >> 30} GiB",
        )


def _in_order(work: Callable[[int], T], items: Iterable[int]) -> Iterator[T]:
    """Results of ``work`` in the order of ``items``, a few ahead at a time so that memory stays bounded."""
    with single_blas_thread(), ThreadPoolExecutor(WORKERS) as pool:  # the limit belongs to the process
        yield from in_order(pool, work, items, ahead=4 * WORKERS)


def _blocks(items: Iterable[T], size: int) -> Iterator[list[T]]:
    block: list[T] = []
    for item in items:
        block.append(item)
        if len(block) == size:
            yield block
            block = []
    if block:
        yield block

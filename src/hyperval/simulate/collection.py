"""A simulated collection from a scene file: the cube, written line by line, and its truth.

Radiance, sampled detector noise and quantisation make the stored integers.  Class statistics, atmosphere and sensor
numbers are those of the model; nothing derived is shared with it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio import features
from rasterio.crs import CRS

from hyperval import datasets
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.data import Array, Mask
from hyperval.errors import T, UsageError, package_table, refusal, refuse
from hyperval.executors import Workers, in_order, single_blas_thread
from hyperval.imagery import envi_writer, write_cube
from hyperval.progress import track
from hyperval.run import csv_text
from hyperval.sensor import NoiseModel, load_sensor
from hyperval.simulate import schema
from hyperval.simulate.ground import Field, GroundLayout, SurfaceRenderer, lay_out, regions
from hyperval.simulate.schema import SceneFile, load_scene
from hyperval.spectra.axis import SpectralAxis
from hyperval.statistics_library import ClassStatistics, builtin_class, builtin_mean
from hyperval.storage import COLLECTION, whole_folder, write_text

Engine = Callable[[AtmosphericState], AtmosphericTerms]


@dataclass(frozen=True)
class SimulationInputs:
    """Everything a scene needs besides its own file; ``terms`` and ``classes`` stand on the sensor's bands.

    Raises
    ------
    UsageError : a sensor whose noise is not drawn here.
    """

    sensor: str
    axis: SpectralAxis
    noise: NoiseModel
    terms: AtmosphericTerms
    classes: Mapping[str, ClassStatistics]

    def __post_init__(self) -> None:
        n = self.noise
        refuse(np.ndim(n.bits) or np.ndim(n.bit_error_rate), "simulate.arms", sensor=self.sensor)
        if (n.readings, n.digital_readings, n.calibration_readings) != (1.0, 1.0, 1.0):
            raise UsageError(f"sensor {self.sensor!r}: averaged readings (co-adds, bins) cannot be simulated")


def load_inputs(scene: SceneFile, beside: Path, engine: Engine | None = None) -> SimulationInputs:
    """Everything a scene needs; a sensor file is looked for ``beside`` the scene file.

    ``engine`` : stands for that of the scene's atmosphere

    Raises
    ------
    UsageError : an unknown sensor, surface or key of the atmosphere.
    InputError, EngineError : a missing file or engine.
    """
    from hyperval.atmosphere import atmospheric_terms  # loads the engines, which a test with its own terms spares

    path = beside / scene.sensor
    sensor = load_sensor(str(path) if path.is_file() else scene.sensor)
    # Before the engine, which may take a minute: a name that no surface has is told at once.
    classes = {name: builtin_class(name, sensor.axis) for name in scene.materials()}
    engine = engine or partial(atmospheric_terms, resolve=partial(datasets.resolve, base=beside))
    terms = engine(scene.atmosphere).at_bands(sensor.axis)
    return SimulationInputs(sensor.name, sensor.axis, sensor.noise(), terms, classes)


# Above this many electrons a Poisson count is drawn from the normal law of the same mean and
# variance: its skewness, 1/sqrt(N), is then under 0.032.
NORMAL_ABOVE_ELECTRONS = 1000.0


@dataclass(frozen=True)
class Detector:
    """The closed form of 3.7 per pixel and one realisation of every noise source.

    ``offset`` and ``slope`` (B,): radiance of a black pixel in this scene, and radiance per reflectance.
    """

    noise: NoiseModel
    offset: Field
    slope: Field
    counts_per_radiance: float

    @cached_property
    def lsb(self) -> Array:
        """(B,) radiance of one digital number; 0 without quantisation."""
        return np.asarray(self.noise.lsb_electrons / self.noise.electrons_per_radiance)

    def radiance(self, reflectance: Field) -> Field:
        """(samples, B) at-sensor radiance without noise [uW cm-2 sr-1 nm-1]."""
        return np.asarray(reflectance * self.slope + self.offset)

    def count_saturated(self, radiance: Field) -> int:
        """How many of the radiances lie beyond the full scale of the digital numbers."""
        full = np.where(self.lsb > 0.0, self.lsb * (2 ** int(self.noise.bits) - 1), np.inf)
        return int(np.count_nonzero(radiance > full.astype(np.float32)))

    def measure(self, radiance: Field, rng: np.random.Generator) -> Field:
        """(samples, B) radiance as the sensor delivers it [uW cm-2 sr-1 nm-1].

        Photon noise is drawn on the electrons (3.13), fixed noise added (3.15), both taken through the noise
        factor g_d (3.16); the sum is rounded to digital numbers (3.18), bits are flipped at their error rate
        (3.19), and the calibration of every sample carries its own relative error (3.17).
        """
        out = self._draw_noise(radiance, rng)
        out *= np.float32(self.noise.detector_gain)  # (3.16)
        out += radiance
        out = self._digitise(out, rng)
        relative = self.noise.calibration_percent / 100.0
        if np.any(relative > 0.0):
            out += rng.standard_normal(out.shape, dtype=np.float32) * relative.astype(np.float32) * radiance  # (3.17)
        return out

    def _draw_noise(self, radiance: Field, rng: np.random.Generator) -> Field:
        """One draw of the detector's noise [radiance], before the noise factor."""
        n = self.noise
        noise = rng.standard_normal(radiance.shape, dtype=np.float32)
        if n.constant is not None:  # a sensor known by its noise alone: no electrons to count
            g, sigma = n.electrons_per_radiance, n.fixed_noise
            a, b, c = (x.astype(np.float32) for x in (1.0 / np.sqrt(g), sigma**2 / g, n.constant))
            return np.asarray(noise * np.abs(a * np.sqrt(np.maximum(b + radiance, 0.0)) + c))
        gain = n.electrons_per_radiance.astype(np.float32)
        electrons = np.maximum(radiance * gain, 0.0)  # (3.13); a dark draw emits no photons
        noise *= np.sqrt(electrons)
        few = electrons < NORMAL_ABOVE_ELECTRONS
        noise[few] = (rng.poisson(electrons[few].astype(np.float64)) - electrons[few]).astype(np.float32)
        noise += rng.standard_normal(radiance.shape, dtype=np.float32) * n.fixed_noise.astype(np.float32)  # (3.15)
        return np.asarray(noise / gain)  # back in radiance

    def _digitise(self, radiance: Field, rng: np.random.Generator) -> Field:
        n, bits = self.noise, int(self.noise.bits)
        lsb = np.where(self.lsb > 0.0, self.lsb, 1.0).astype(np.float32)
        number = np.minimum(np.rint(radiance / lsb), np.float32(2**bits - 1))  # (3.18), up to full scale
        if (rate := float(n.bit_error_rate)) > 0.0:
            flips = rng.binomial(number.size * bits, rate)
            where = rng.integers(0, number.size, flips)
            weight = 1 << rng.integers(0, bits, flips)
            # The flip of a set bit lowers the number; a negative number stands on a dark level, taken as 0 here.
            words = np.clip(number, 0, 2**bits - 1).astype(np.int64).ravel()
            delta = np.zeros(words.size)
            np.add.at(delta, where, np.where(words[where] & weight, -weight, weight))
            number += delta.reshape(number.shape).astype(np.float32)  # (3.19)
        return np.where(self.lsb > 0.0, number * lsb, radiance).astype(np.float32)

    def to_integers(self, measured: Field) -> tuple[npt.NDArray[np.int16], int]:
        """(samples, B) integers of the file and how many of them had to be clipped."""
        counts = np.rint(measured * np.float32(self.counts_per_radiance))
        whole = np.iinfo(np.int16)
        clipped = int(np.count_nonzero((counts < whole.min) | (counts > whole.max)))
        return np.clip(counts, whole.min, whole.max).astype("<i2"), clipped


def detector(inputs: SimulationInputs, average_reflectance: Array, counts_per_radiance: float) -> Detector:
    """The detector over a scene of the given area-average reflectance (B,).

    L = L_a + (A rho + B rho_ave) / (1 - S rho_ave) (3.7), so the black pixel has L_a + B rho_ave / (1 - S rho_ave).
    """
    t = inputs.terms
    bounce = 1.0 - t.spherical_albedo * average_reflectance
    offset, slope = t.path_radiance + t.adjacency * average_reflectance / bounce, t.direct / bounce
    return Detector(inputs.noise, offset.astype(np.float32), slope.astype(np.float32), counts_per_radiance)


WRITTEN = package_table("simulate/files.yaml")
FIELD_FWHM_NM = 3.0  # of a field spectrometer


def write_regions(path: Path, scene: SceneFile, masks: Mapping[str, Mask]) -> None:
    """Regions of interest as GeoJSON polygons along pixel edges, x = sample, y = line.

    (0, 0) is the upper left corner of the first pixel.  GeoJSON proper is in degrees;
    ``coordinates: pixel`` among the members says that this file is not.
    """
    records = []
    surfaces = {p.name: p.surface for p in scene.panels} | {r.name: r.surface for r in scene.regions}
    for name, mask in masks.items():
        shapes = [shape for shape, value in features.shapes(mask.astype(np.uint8), mask=mask) if value == 1]
        geometry = {"type": "MultiPolygon", "coordinates": [shape["coordinates"] for shape in shapes]}
        properties = {"name": name, "surface": surfaces[name], "pixels": int(mask.sum())}
        records.append({"type": "Feature", "properties": properties, "geometry": geometry})
    content = {"type": "FeatureCollection", "name": scene.name, "coordinates": "pixel", "features": records}
    write_text(path, json.dumps(content) + "\n")


def write_targets(path: Path, scene: SceneFile, ground: GroundLayout) -> None:
    """CSV with one row per plank, with the fills as rendered and not as asked for.

    ``line``, ``sample``: its centre, continuous; ``best_line``, ``best_sample``: the pixel it fills most, whole
    numbers; ``pixels``: how many hold at least 1e-4 of it.
    """
    rows = []
    for plank in ground.planks:
        group, side = plank.group, plank.side_pixels * scene.gsd_m
        best = int(np.argmax(plank.fills))
        rows.append((
            plank.name, group.name, group.material, group.host, group.fill, round(side, 6), round(side**2, 6),
            round(plank.centre_line, 4), round(plank.centre_sample, 4), group.phase, round(plank.heading_deg, 3),
            int(plank.lines[best]), int(plank.samples[best]), round(float(plank.fills[best]), 6), int(plank.fills.size),
        ))  # fmt: skip
    write_text(path, csv_text([WRITTEN["targets"], *rows]))


def field_axis() -> SpectralAxis:
    """The 1 nm grid of the simulated field spectrometer."""
    centre = np.arange(350.0, 2501.0)
    return SpectralAxis(centre, np.full(centre.size, FIELD_FWHM_NM))


def write_panel_spectra(path: Path, scene: SceneFile) -> None:
    """CSV: wavelength_nm, then mean NAME and standard deviation NAME_sd of every panel, reflectance as a fraction.

    A reading is the panel's mean reflectance with ``relative_noise`` of the instrument, independent between
    wavelengths; the panels' own spread from pixel to pixel is averaged by the sweep of the spectrometer.  A comment
    says how many readings are behind the means, where there is more than one.
    """
    axis = field_axis()
    noise, count = scene.field_spectra.relative_noise, scene.field_spectra.readings
    columns: dict[str, Any] = {"wavelength_nm": [f"{nm:.1f}" for nm in axis.centre_nm]}
    for number, panel in enumerate(scene.panels):
        mean = builtin_mean(panel.surface, axis)
        rng = schema.generator(scene.seed, schema.FIELD_SPECTRA, number)
        readings = mean * (1.0 + noise * rng.standard_normal((count, mean.size)))
        deviation = readings.std(axis=0, ddof=1) if count > 1 else np.zeros(mean.size)
        both = {panel.name: readings.mean(axis=0), f"{panel.name}_sd": deviation}
        columns |= {name: [f"{value:.6f}" for value in values] for name, values in both.items()}
    words = f"# means of N = {count} readings and their standard deviations\n" if count > 1 else ""
    write_text(path, words + csv_text([columns, *zip(*columns.values(), strict=True)]))


WORKERS = 2
MAX_CUBE_BYTES = 64 << 30
MAX_MAP_PIXELS = 1 << 26  # each pixel of the maps held in memory takes up to 40 bytes


def simulate_to_folder(scene_yaml: Path, output: Path) -> int:
    """Simulate a scene file into ``output``, whose earlier files are replaced whole; returns the exit code 0.

    Raises
    ------
    UsageError : an invalid scene, or ``output`` holds files that no simulation wrote.
    InputError : no such scene file.
    """
    with whole_folder(output, COLLECTION) as folder:
        simulate(scene_yaml, folder)
    return 0


def simulate(scene: SceneFile | Path | str, folder: Path, *, inputs: SimulationInputs | None = None) -> dict[str, Any]:
    """Simulate a scene, or the scene file of that name, into an existing or new ``folder``.

    Returned are paths: ``folder``, ``cube`` (at-sensor radiance, ENVI BIL int16, header beside it), and the truth as
    ``regions``, ``targets``, ``panel_spectra``, ``class_map``, ``fill_map``, ``truth``; and ``average_reflectance``
    (B,), the area average over the scene, the rho_ave of 3.8.  The same scene gives the same bytes in whatever order
    lines are drawn: each has its own random streams.

    Raises
    ------
    UsageError : an invalid scene, a layout that contradicts itself, a scene too large, radiance that does not
        fit the integers.
    InputError, EngineError : a missing file or atmosphere engine.
    """
    base = Path()
    if not isinstance(scene, SceneFile):
        base = Path(scene).parent
        scene = load_scene(Path(scene))
    inputs = inputs or load_inputs(scene, base)
    bands = len(inputs.axis)
    pixels = scene.lines * scene.samples
    if pixels > MAX_MAP_PIXELS or 2 * pixels * bands > MAX_CUBE_BYTES:
        size = {"lines": scene.lines, "samples": scene.samples, "bands": bands}
        raise refusal("scene.large", scene.name, **size, most=MAX_MAP_PIXELS, gib=MAX_CUBE_BYTES >> 30)
    folder.mkdir(parents=True, exist_ok=True)
    ground = lay_out(scene)
    masks = regions(scene, ground)
    renderer = SurfaceRenderer(scene, ground, inputs.classes)
    average, dark = average_reflectance(renderer)
    chain = detector(inputs, average, scene.counts_per_radiance)
    files = {part: folder / name.format(scene.name) for part, name in WRITTEN["files"].items()}
    saturated = _write_cube(files["cube"], scene, inputs, renderer, chain)
    write_regions(files["regions"], scene, masks)
    write_targets(files["targets"], scene, ground)
    write_panel_spectra(files["panel_spectra"], scene)
    _write_maps(files["class_map"], files["fill_map"], scene, ground)
    facts = {
        "simulated": True,
        "scene": scene.model_dump(by_alias=True, mode="json"),
        "sensor": inputs.sensor,
        "atmosphere": {k: str(v) for k, v in inputs.terms.provenance.items()},
        "classes": {name: c.source for name, c in inputs.classes.items()},
        "surfaces": {str(i): name for i, name in enumerate(ground.surfaces, start=1)},
        "wavelength_nm": inputs.axis.centre_nm.tolist(),
        "average_reflectance": average.tolist(),
        "negative_reflectance_fraction": dark,
        "saturated_fraction": saturated,
    }
    write_text(files["truth"], json.dumps(facts, indent=1) + "\n")
    return {"folder": folder, **files, "average_reflectance": average}


def average_reflectance(renderer: SurfaceRenderer) -> tuple[Array, float]:
    """Area average (B,) of what the scene reflects, by rendering every line once.

    Also the share of drawn reflectances below 0, which a Gaussian law does not exclude.
    """

    def sum_line(line: int) -> tuple[Array, int]:
        rho = renderer.reflectance(line)
        return rho.sum(axis=0, dtype=np.float64), int(np.count_nonzero(rho < 0.0))

    scene, total, negative = renderer.scene, np.zeros(renderer.bands), 0
    for part, count in _line_by_line(sum_line, scene, "average reflectance"):
        total += part
        negative += count
    pixels = scene.lines * scene.samples
    return total / pixels, negative / (pixels * renderer.bands)


def _write_cube(
    path: Path, scene: SceneFile, inputs: SimulationInputs, renderer: SurfaceRenderer, chain: Detector
) -> float:
    """Write the cube; returns the share of samples beyond the detector's full scale."""

    def simulate_line(line: int) -> tuple[npt.NDArray[np.int16], int]:
        rng = schema.generator(scene.seed, schema.NOISE, line)
        radiance = chain.radiance(renderer.reflectance(line))
        values, clipped = chain.to_integers(chain.measure(radiance, rng))
        refuse(clipped, "scene.radiance", scene.name, clipped=clipped, line=line)
        return values, chain.count_saturated(radiance)

    axis, scale = inputs.axis, 1.0 / scene.counts_per_radiance
    noun = "closure: surfaces drawn as the model assumes" if scene.mode == "closure" else "broken assumptions"
    words = (
        f"SIMULATED at-sensor radiance, scene {scene.name} ({noun}), seed {scene.seed}, "
        f"stored integers x {scale:g} = uW cm-2 sr-1 nm-1; no instrument collected it"
    )
    entries = {"sensor type": f"{inputs.sensor} (simulated)", "data units": "uW cm-2 sr-1 nm-1"}
    if scene.acquired_utc:
        entries["acquisition time"] = scene.acquired_utc
    for name, number in (("gain", repr(scale)), ("offset", "0")):
        entries[f"data {name} values"] = "{" + ", ".join([number] * len(axis)) + "}"
    options = {"data_type": 2, "axis": axis, "description": words, "extra": entries | scene.header, **_map_place(scene)}
    with envi_writer(path, lines=scene.lines, samples=scene.samples, bands=len(axis), **options) as writer:
        saturated = 0
        for values, count in _line_by_line(simulate_line, scene, "cube"):
            writer.write(values[None])
            saturated += count
    return saturated / (scene.lines * scene.samples * len(axis))


def _write_maps(class_path: Path, fill_path: Path, scene: SceneFile, ground: GroundLayout) -> None:
    names, common = ("Unclassified", *ground.surfaces), {"interleave": "bsq", **_map_place(scene)}
    entries = {"file type": "ENVI Classification", "classes": str(len(names))}
    entries["class names"] = "{" + ", ".join(names) + "}"
    numbers = ground.class_map[:, :, None] + np.uint8(1)  # 0 stands for "no class" in this format
    words = "SIMULATED truth: surface class"
    write_cube(class_path, numbers, data_type=1, description=words, extra=entries, **common)
    words = "SIMULATED truth: share of planks in the pixel's signal"
    write_cube(fill_path, ground.fill[:, :, None], description=words, **common)


def _map_place(scene: SceneFile) -> dict[str, Any]:
    """Where a map of the scene lies."""
    origin = scene.map
    zone = (32600 if origin.hemisphere == "north" else 32700) + origin.utm_zone
    transform = Affine(scene.gsd_m, 0.0, origin.easting_m, 0.0, -scene.gsd_m, origin.northing_m)
    return {"transform": transform, "crs": CRS.from_epsg(zone)}


def _line_by_line(work: Callable[[int], T], scene: SceneFile, words: str) -> Iterator[T]:
    """Results of ``work`` in the order of the lines, a few ahead at a time so that memory stays bounded."""
    with single_blas_thread(), ThreadPoolExecutor(WORKERS) as pool:  # the limit belongs to the process
        yield from track(in_order(Workers(pool), work, range(scene.lines), ahead=4 * WORKERS), words, scene.lines)

"""Whatever can be moved, moved in three ways: the value in the scenario's file, a study, and an input of a budget.

The paths are those that the program itself lists, so that a new one is covered at once: what the rules below can
not move fails.
"""

import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hyperval import api
from hyperval.atmosphere import AtmosphericTable, write_table
from hyperval.data import Components
from hyperval.errors import UsageError
from hyperval.model import PATHS, Origins, all_paths, find_path, is_reread, predict, predictions, read_world, value_at
from hyperval.scenario import Scenario, load_scenario
from hyperval.settings import setting, with_settings
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import ClassStatistics, builtin_class, write_statistics_library

EQUAL = 1e-9  # relative
# A probability follows from a logarithm, and what differs by a rounding of the score differs far out by more; a
# noise-free mean has none of it.  Below these a difference is no difference.
FLOOR = {"pd": 1e-12, "threshold": 1e-12, "score mean": 1e-12}
AXIS = SpectralAxis(np.array([450.0, 490, 550, 600, 670, 745, 865, 1050, 1240, 1650, 2130, 2250]), np.full(12, 10.0))

SCENARIO = Path(__file__).with_name("paths.yaml").read_text()
VARIANTS: dict[str, dict[str, Any]] = yaml.safe_load(Path(__file__).with_name("variants.yaml").read_text())
SPECTRAL = [
    {"name": f"{kind}/{s}/{nm:.0f}", "kind": kind, "subject": s, "band_nm": nm}
    for kind in ("radiance", "snr")
    for s in ("asphalt", "panel")
    for nm in (490.0, 865.0)
]
Key = tuple[str, ...]
PFA = (1e-2, 1e-4)
# What does not hang on the variant is asked of two of them: curves of objects, what is read anew, inputs moved alone.
WHOLE = ("base", "mixtures")
# The others are left to make test-slow: each moves a hundred paths in three ways.
QUICK = (*WHOLE, "reflectance domain")
EACH = pytest.mark.parametrize(
    "variant", [pytest.param(v, marks=[pytest.mark.slow] * (v not in QUICK)) for v in VARIANTS]
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The scenario's file with an atmosphere, a sensor and a library of statistics beside it."""
    here = tmp_path_factory.mktemp("model")
    (here / "base.yaml").write_text(SCENARIO)
    assumed = "assumed: for tests"
    sensor = {
        "schema": 1, "name": "twelve", "title": "Twelve bands", "source": assumed,
        "bands": {"table": [[float(nm), 10.0, 1] for nm in AXIS.centre_nm], "source": assumed},
        "measured_noise": {"table": [[400.0, 0.004, 0.5, 0.0], [2500.0, 0.001, 0.5, 0.0]], "source": assumed},
        "calibration_error_percent": {"value": 0.1, "source": assumed},
    }  # fmt: skip
    (here / "sensor.yaml").write_text(yaml.safe_dump(sensor))
    write_table(sky(), here / "sky.nc")
    shutil.copy(Path(__file__).parents[1] / "sensor" / "smile.yaml", here)
    readings = "".join(f"{w},{20 + w / 100},{22 + w / 100},{21 + w / 90}\n" for w in range(350, 2500, 10))
    (here / "readings.csv").write_text("wavelength,one,two,three\n" + readings)
    soil, away = builtin_class("soil", AXIS), np.linspace(0.01, 0.04, len(AXIS))
    wide = soil.covariance + 1e-5 * np.eye(len(AXIS))
    parts = Components(np.array([0.8, 0.2]), np.array([-0.2 * away, 0.8 * away]), np.array([wide, 0.4 * wide]), 12.0)
    field = ClassStatistics("field", AXIS, soil.mean, parts.covariance, 500, "made", None, parts)
    write_statistics_library(here / "classes.nc", [field])
    return here


def sky() -> AtmosphericTable:
    """Smooth terms over optical depth."""
    w, aot = np.arange(400.0, 2301.0, 20.0), np.array([0.0, 0.2, 0.5, 1.0])
    depth = aot[:, None]
    haze, gas = 1.0 - np.exp(-depth * 550.0 / w), np.exp(-0.2 * np.exp(-(((w - 1050.0) / 300.0) ** 2)))
    gas = gas * np.ones_like(depth)
    quantities = {
        "path": 0.03 * (450.0 / w) ** 3 + 0.12 * haze,
        "direct": 0.8 * gas * np.exp(-0.6 * depth * 550.0 / w),
        "adjacency": 0.15 * haze * gas,
        "spherical_albedo": 0.05 * (450.0 / w) ** 3 + 0.15 * haze * np.ones_like(gas),
        "ground": 0.9 * gas * np.exp(-0.2 * depth),
        "gas": gas,
        "diffuse": 0.1 + 0.5 * haze * np.ones_like(gas),
    }  # fmt: skip
    axes = {"aot550": aot}
    fixed = {
        "water_vapour_g_cm2": 2.0, "ozone_atm_cm": 0.3, "ground_altitude_km": 0.0, "sensor_altitude_km": 1.0,
        "solar_zenith_deg": 35.0, "view_zenith_deg": 0.0,
    }  # fmt: skip
    return AtmosphericTable(w, axes, fixed, quantities)


def file_of(variant: str) -> str:
    """Name of the file of a variant."""
    return f"{variant.replace(' ', '-')}.yaml"


def in_file(scenario: Scenario, path: str) -> bool:
    """Whether the path is that of an entry of the file."""
    try:
        return setting(scenario, path) is not None
    except UsageError:
        return False


def variant_of(folder: Path, variant: str) -> Scenario:
    """A variant of the scenario, from a file of its own."""
    path = folder / file_of(variant)
    data = with_settings(load_scenario(folder / "base.yaml"), VARIANTS[variant])
    path.write_text(yaml.safe_dump(data.model_dump(mode="json", by_alias=True, exclude_unset=True)))
    return load_scenario(path)


def candidates(stated: Any) -> list[Any]:
    """Other values than the one that stands there."""
    if isinstance(stated, list | tuple):
        return [[candidates(x)[i] for x in stated] for i in range(3)]
    if isinstance(stated, int) and not isinstance(stated, bool):
        return [stated + 1, stated - 1, stated + 2]
    return [1.04 * stated, 0.96 * stated, 0.03] if stated else [0.03, 0.5, 3.0]


def moved_in_file(scenario: Scenario, path: str) -> tuple[Any, Scenario] | None:
    """Another value at an entry of the file, and the scenario with it; None where every other value is refused."""
    for value in candidates(setting(scenario, path)):
        try:
            return value, with_settings(scenario, {path: value})
        except UsageError:
            continue
    return None


def numbers(p: Any) -> dict[Key, np.ndarray]:
    """Everything that a prediction says, as arrays."""
    out = {
        (product, name): e.mean
        for product in ("radiance", "snr", "reflectance")
        for name, e in getattr(p, product).items()
    }
    spread = {name: e.pixel_covariance for name, e in p.radiance.items() if e.pixel_covariance is not None}
    out |= {("spread", name): np.sqrt(np.diag(covariance)) for name, covariance in spread.items()}
    for key, score in p.scores.items():
        out["score mean", *key], out["score sd", *key] = np.array([score.mean]), np.array([score.sd])
    for key, curve in p.roc.items():
        out["pd", *key], out["threshold", *key] = curve.pd, curve.threshold
    return out


def difference(ours: Mapping[Key, Any], theirs: Mapping[Key, Any]) -> float:
    """Greatest relative difference, of what lies above its floor."""
    worst = 0.0
    for key, a in ours.items():
        b = np.asarray(theirs[key])
        assert np.array_equal(np.isnan(a), np.isnan(b)), key
        away = np.abs(a - b) - FLOOR.get(key[0], 0.0)
        worst = max(worst, float(np.nanmax(away / np.maximum(np.abs(b), 1e-300), initial=0.0)))
    return worst


def studied(folder: Path, variant: str, scenario: Scenario, values: Mapping[str, Any]) -> dict[str, dict[Key, float]]:
    """path -> outputs with another value there, by one study that moves one input after the other."""
    outputs = [o for o in SPECTRAL if scenario.atmosphere is not None]
    outputs += [
        {"name": f"pd/{p.name}/{d}/{unit}/{i}", "kind": "pd", "subject": p.name, "detector": d, "by": unit, "pfa": pfa}
        for t in scenario.scene.targets
        for p in t.populations
        for d in scenario.processing.detectors
        for unit in (("pixel", "object") if variant in WHOLE else ("pixel",))
        for i, pfa in enumerate(PFA)
    ]
    keys = [tuple(o["name"].split("/")) for o in outputs]
    outputs = [{**o, "name": f"o{k}"} for k, o in enumerate(outputs)]
    # What is a column of numbers stands there beside the stated value, which must not disturb it.
    stated = read_world(scenario).stated
    listed = {p: [setting(scenario, p)] * (not is_reread(stated, p)) + [v] for p, v in values.items()}
    study = {
        "schema": 1, "name": "paths", "scenario": file_of(variant), "design": {"kind": "one-at-a-time"},
        "inputs": [{"name": f"i{k}", "path": p, "values": v} for k, (p, v) in enumerate(listed.items())],
        "outputs": outputs,
    }  # fmt: skip
    (folder / "study.yaml").write_text(yaml.safe_dump(study))
    table = api.study(folder / "study.yaml", show_progress=False).to_dataframe()
    rows = iter(table[[o["name"] for o in outputs]].to_numpy())
    first, found = dict(zip(keys, next(rows), strict=True)), {}
    for path, of_path in listed.items():
        here = [dict(zip(keys, next(rows), strict=True)) for _ in of_path]
        assert len(here) == 1 or difference(here[0], first) < EQUAL, f"{path}: the value that stands there"
        found[path] = here[-1]
    assert next(rows, None) is None
    return found


def as_studied(p: Any, keys: Iterable[Key]) -> dict[Key, float]:
    """What a study asks, of a prediction, where that has it: a P_FA of its grid."""
    out: dict[Key, float] = {}
    for key in keys:
        if key[0] == "pd":
            curve = p.roc[key[1], key[2], key[3]]
            at = np.flatnonzero(np.abs(np.log(curve.pfa / PFA[int(key[4])])) < 1e-9)
            if at.size:
                out[key] = float(curve.pd[at[0]])
        else:
            out[key] = float(getattr(p, key[0])[key[1]].mean[np.argmin(np.abs(p.axis.centre_nm - float(key[2])))])
    return out


def away_from(nominal: Any) -> np.ndarray:
    """Another value of an input: a number, or one for each band or fill."""
    at = np.asarray(nominal, float)
    if np.all(np.isinf(at)):
        return np.array([6.0])
    return np.where(at == 0.0, 0.02, 1.03 * at)


def twin(scenario: Scenario, path: str, value: np.ndarray) -> dict[str, Any] | None:
    """Entries of the file that say the same as an input at another value; None where it has no words for it."""
    pattern = re.sub(r"\[.*\]", "*", path)
    name = path.partition("[")[2].partition("]")[0]
    v, scene = float(value.ravel()[0]), scenario.scene
    match pattern:
        case "light.irradiance" if scenario.atmosphere is not None:
            distance = scenario.atmosphere.distance_au / np.sqrt(v)
            return {"atmosphere.day_of_year": None, "atmosphere.earth_sun_distance_au": distance}
        case "light.surroundings" if scene.adjacency.spectrum is not None:
            return {"scene.adjacency.spectrum.constant": v * (scene.adjacency.spectrum.constant or 0.0)}
        case "sensor.electrons" if scenario.sensor_changes is not None:
            return {"sensor_changes.signal_factor": v * scenario.sensor_changes.signal_factor}
        case "sensor.wavelength_shift_nm" if scenario.sensor_operation is not None:
            return {
                "sensor_operation.wavelength_shift_nm": v
                + setting(scenario, pattern.replace("sensor", "sensor_operation"))
            }
        case "surfaces.*.mean" if name == "panel":
            return {"scene.panels.panel.spectrum.constant": v}
        case "surfaces.*.spread" if name == "wide":
            return {"scene.targets.wide.covariance.relative_sd": 0.05 * v}
        case "surfaces.*.tail_dof":
            return {f"scene.classes.{name}.tail_dof": v}
        case "fill.*" if name in ("small", "loose"):
            return {f"scene.targets.plank.subjects.{name}.fill.{'fixed' if name == 'small' else 'mean'}": v}
        case "fraction.*":
            rest = (1.0 - v) / sum(c.fraction for c in scene.classes if c.name != name)
            return {
                f"scene.classes.{c.name}.fraction": v if c.name == name else rest * c.fraction for c in scene.classes
            }
        case "blur":
            return {"scene.targets.wide.fill.geometry.psf_fwhm_pixels": v}
    return None


def same_line(path: str, value: float) -> dict[str, float] | None:
    """Gain and offset of what a line gives whose panel truly reflects ``value`` times what it is taken for."""
    if path not in ("line.dark", "line.bright"):
        return None
    dark, bright = (0.1 * value, 0.6) if path == "line.dark" else (0.1, 0.6 * value)
    gain = 0.5 / (bright - dark)
    return {"line.gain": gain, "line.offset": 0.1 - gain * dark}


def paths_of(variant: str, scenario: Scenario, *, of_file: bool) -> list[str]:
    """The paths to move; a detector of many draws, which takes a hundred times longer, has one of each sort."""
    paths = [p for p in all_paths(read_world(scenario)) if in_file(scenario, p) is of_file]
    if variant != "ACE":
        return paths
    stated = read_world(scenario).stated
    sorts = {(find_path(stated, p).field if of_file else re.sub(r"\[.*\]", "*", p)): p for p in reversed(paths)}
    anew = ["scene.classes.[soil].spectrum.constant", "processing.seed", "processing.samples"]
    return [*sorts.values(), *(anew if of_file else [])]


@pytest.fixture(scope="module")
def stated(folder) -> dict[Key, np.ndarray]:
    return with_errors(load_scenario(folder / "base.yaml"))


def with_errors(scenario: Scenario) -> dict[Key, np.ndarray]:
    p = predict(scenario)
    return numbers(p) | {("error", name): np.diag(e.error_covariance) for name, e in p.radiance.items()}


MOVED = yaml.safe_load(Path(__file__).with_name("moved.yaml").read_text())


@pytest.mark.parametrize("entries", [pytest.param(e, marks=[pytest.mark.slow] * ("atmosphere" in e)) for e in MOVED])
def test_an_entry_that_no_shipped_scenario_has_moves_the_prediction(folder, stated, entries):
    moved = with_errors(with_settings(load_scenario(folder / "base.yaml"), entries))
    assert any(k not in stated or not np.array_equal(v, stated[k], equal_nan=True) for k, v in moved.items())


@EACH
def test_a_value_in_the_file_a_study_and_a_moved_input_give_the_same(folder, variant):
    scenario = variant_of(folder, variant)
    world, origins, whole = read_world(scenario), Origins(), variant in WHOLE
    paths = paths_of(variant, scenario, of_file=True)
    values: dict[str, Any] = {}
    truths = {}
    refused = set()
    for path in paths:
        if (there := moved_in_file(scenario, path)) is not None:
            try:
                values[path], truths[path] = there[0], predict(there[1], origins, object_curves=whole)
                continue
            except UsageError:  # a state that the table does not have
                with pytest.raises(UsageError):
                    predict(scenario, origins, truth={path: there[0]})
        refused.add(re.sub(r"\[.*\]", "*", path))
    assert refused <= {
        "schema", "scene.classes.*.fraction", "atmosphere.water_vapour_g_cm2", "atmosphere.ozone_atm_cm",
        "atmosphere.sensor_altitude_km", "atmosphere.ground_altitude_km", "atmosphere.solar_zenith_deg",
        "atmosphere.view_zenith_deg",
    }, "moved by nothing that this suite knows"  # fmt: skip
    wrong = []
    plain = [p for p, v in values.items() if not isinstance(v, list)]
    moved = predictions(scenario, ({p: values[p]} for p in plain), origins, object_curves=whole)
    for path, found in zip(plain, moved, strict=True):
        if difference(numbers(found), numbers(truths[path])) > EQUAL:
            wrong.append(f"moved: {path} at {values[path]}")
    moving = {p: v for p, v in values.items() if whole or not is_reread(world.stated, p)}
    # Each state of the light is a run of the engine, and is made for each scenario that is read anew.
    of_light = {p: v for p, v in moving.items() if whole and p.startswith("atmosphere.")}
    rest = {p: v for p, v in moving.items() if p not in of_light}
    for path, row in [x for v in (of_light, rest) if v for x in studied(folder, variant, scenario, v).items()]:
        if difference(as_studied(truths[path], row), row) > EQUAL:
            wrong.append(f"study: {path} at {values[path]}")
    assert not wrong


@EACH
def test_an_input_moved_among_others_alone_and_in_the_file_gives_the_same(folder, variant):
    scenario = variant_of(folder, variant)
    world, origins, whole = read_world(scenario), Origins(), variant in WHOLE
    paths = paths_of(variant, scenario, of_file=False)
    sort = {p: re.sub(r"\[.*\]", "*", p) for p in paths}
    assert set(sort.values()) <= set(PATHS)

    def seen(there: Scenario, truth: Mapping[str, Any] | None = None) -> dict[Key, np.ndarray]:
        return numbers(predict(there, origins, truth=truth, object_curves=whole))

    def together(truths: Iterable[Mapping[str, Any]]) -> list[dict[Key, np.ndarray]]:
        return [numbers(p) for p in predictions(scenario, truths, origins, object_curves=whole)]

    at = {p: np.asarray(value_at(world, p)[0], dtype=float) for p in paths}
    values = {p: away_from(at[p]).reshape(at[p].shape or 1) for p in paths}
    stated, wrong, moving = seen(scenario), [], set()
    unmoved = [p for p in paths if variant != "ACE" and np.all(np.isfinite(at[p]))]
    for path, here in zip(unmoved, together({p: at[p]} for p in unmoved), strict=True):
        if difference(here, stated) > EQUAL:
            wrong.append(f"{path}: at the value that stands there")
    for (path, value), here in zip(values.items(), together({p: v} for p, v in values.items()), strict=True):
        if whole and difference(here, seen(scenario, {path: value})) > EQUAL:
            wrong.append(f"{path}: alone")
        entries = twin(scenario, path, value)
        if entries and difference(here, seen(with_settings(scenario, entries))) > EQUAL:
            wrong.append(f"{path}: {entries}")
        line = same_line(path, float(value.ravel()[0])) if scenario.formulation == "corrected" else None
        if line is not None and difference(here, seen(scenario, line)) > EQUAL:
            wrong.append(f"{path}: {line}")
        if difference(here, stated) > EQUAL:
            moving.add(sort[path])
    assert not wrong
    assert variant != "base" or moving == set(sort.values())


def test_every_field_of_the_world_is_moved(folder):
    """A field that no variant moves would go without a comparison."""
    worlds = [read_world(variant_of(folder, v)) for v in VARIANTS]
    moved = {find_path(world.stated, p).field for world in worlds for p in all_paths(world)}
    assert moved == {path.field for path in PATHS.values()}

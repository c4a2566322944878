"""The tasks of the workers: each takes plain values and folders, and returns what a list or page shows of its result.

Of a prediction its scenario and what pages draw of it are kept.  Anything else, such as charts beside those of an
earlier run, is computed again from the scenario, in less time than reading its covariances would take.
"""

from __future__ import annotations

import base64
import json
import math
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval import api
from hyperval.campaign import StarterSources, load_jobs, observe, predict_to_folder, starter_campaign, validate
from hyperval.collection import CollectionSection, CubeSource
from hyperval.config import load_model, parse_yaml, placeholders, write_draft
from hyperval.datasets import InputLog
from hyperval.envi_header import header_beside
from hyperval.errors import UsageError, needed, refuse
from hyperval.executors import under_command
from hyperval.figures import Figure, densities_figure, exceedance_figure, figure_json, first_figures, spectra_figure
from hyperval.imagery import image_record, open_raster
from hyperval.observe import open_source
from hyperval.products import ObservedProducts, PredictedProducts, SpectralEstimate, background_of
from hyperval.run import file_stems, read_products
from hyperval.scenario import Scenario
from hyperval.sensor.specification import load_sensor
from hyperval.simulate import simulate
from hyperval.storage import write_text
from hyperval.study import live_figure, next_piece, study_to_folder
from hyperval.web.refusal import redact
from hyperval.web.store import COLLECTION, MAX_LISTED, summary_of, view_name


def charts_of(*sides: PredictedProducts) -> list[dict[str, Any]]:
    """Charts of a prediction, and of an earlier one where there are two."""
    names = ("this run", "earlier run")
    both = sides[0], sides[1] if len(sides) > 1 else None
    scores = densities_figure(list(zip(names, sides, strict=False)))
    figures = (*first_figures(both, names=names), scores, exceedance_figure((sides[0], None)))
    return [chart_data(figure) for figure in figures if figure is not None]


def chart_data(figure: Figure) -> dict[str, Any]:
    """A figure as JSON for a page."""
    return {
        "name": f"chart-{figure.name}", "section": figure.section, "title": figure.caption, "alt": figure.alt,
        "content": figure_json(figure), "subjects": [view.subject for view in figure.views],
    }  # fmt: skip


_MAX_PIXELS = 1_000_000


def warm() -> None:
    """Load what a first prediction and its charts would wait for."""
    charts_of(api.predict("yellow-planks-asphalt").products)


def predict(folder: str) -> dict[str, Any]:
    """Predict the scenario of a folder, and write what pages draw of it.

    Returns
    -------
    Bands, mean SNR, and P_D at some P_FA with 95 % limits, a row for each curve.
    """
    draw(folder)
    prediction, rows = _predict(folder), list[dict[str, Any]]()
    for key, pfa in product(prediction.products.roc, (1e-4, 1e-3, 1e-2)):
        about = dict(zip(("subject", "detector", "unit"), key, strict=True))
        with suppress(UsageError):  # where the curves of the scenario begin above it
            found = zip(("pd", "lower", "upper"), map(_number, prediction.pd(pfa=pfa, **about)), strict=True)
            rows.append({**about, "pfa": pfa, **dict(found)})
    good = prediction.axis.clear
    medians = {n: _number(np.nanmedian(e.mean[good])) for n, e in prediction.snr.items() if not n.endswith(")")}
    snr = [{"subject": name, "median": median} for name, median in medians.items()]
    nm = prediction.axis.centre_nm
    return {
        "bands": int(nm.size), "range_nm": [float(nm[0]), float(nm[-1])], "detection": rows,
        "snr": snr[:MAX_LISTED], "notes": list(prediction.notes),
    }  # fmt: skip


def _number(value: Any) -> float | None:
    """A number as JSON has it: None where there is none."""
    return float(value) if np.isfinite(value) else None


@lru_cache(maxsize=8)
def _predict(folder: str) -> api.Prediction:
    return api.predict(load_model(Scenario, Path(folder) / "scenario.yaml"))


def draw(folder: str, earlier: str | None = None) -> None:
    """Write the charts of a prediction, beside those of an earlier one where there is one."""
    sides = [_predict(one).products for one in (folder, earlier) if one is not None]
    name = "charts" if earlier is None else f"charts-{Path(earlier).name}"
    _write(Path(folder) / view_name(name), charts_of(*sides))


def files(folder: str) -> None:
    """Write the folder that ``hyperval predict`` writes of the scenario."""
    with under_command("hyperval", "predict", "scenario.yaml"):
        predict_to_folder(str(Path(folder) / "scenario.yaml"), Path(folder) / "results")


def study(folder: str) -> dict[str, Any]:
    """Evaluate the study of a folder."""
    with under_command("hyperval", "study", "study.yaml"):
        study_to_folder(Path(folder) / "study.yaml", Path(folder) / "results")
    return summary_of("study", Path(folder) / "results")


def campaign(folder: str, path: str) -> dict[str, Any]:
    """Run a campaign into a folder."""
    with under_command("hyperval", "validate", Path(path).name):
        code = validate([Path(path)], Path(folder) / "results")
    return summary_of("validation", Path(folder) / "results") | {"exit_code": code}


def pipeline(folder: str, parts: Mapping[str, list[str]], stated: Mapping[str, Any], most: int) -> dict[str, Any]:
    """Write the campaign of what was brought, and run its empirical pipeline.

    Parameters
    ----------
    parts : of the collection -> names of files;  stated : what a person says of it;  most : values of the cube
    """
    place = Path(folder)
    files = {part: [place / COLLECTION / name for name in names] for part, names in parts.items()}
    text, guesses, header = _draft_campaign(place, files, stated, most)
    write_draft(place / "campaign.yaml", "campaign", text)
    with under_command("hyperval", "observe", "campaign.yaml"):
        observe(place / "campaign.yaml", place / "results")
    compares = "comparisons" in parse_yaml(text)[0]
    summary = {"header": header, "guesses": [redact(guess) for guess in guesses], "compares": compares}
    return summary_of("pipeline", place / "results") | summary


def _draft_campaign(
    place: Path, files: Mapping[str, list[Path]], stated: Mapping[str, Any], most: int
) -> tuple[str, list[str], dict[str, str]]:
    """The campaign of the files of each part, what is guessed in it, and what the header says."""
    cube, about, targets = files["cube"][0], dict(stated), next(iter(files["targets"]), None)
    header_file = files["header"][0]
    stated_header = None if header_file == header_beside(cube) else header_file
    raster = open_raster(cube, header=stated_header)
    refuse((count := math.prod(raster.size)) > most, "web.values", count=count, most=most)
    described = raster.description
    quantity = about.get("quantity") or ("radiance" if "unit" in about else described.quantity)
    amended = replace(raster, description=replace(described, quantity=quantity, unit=about.get("unit", described.unit)))
    header = {what: value for what, value, _ in image_record(amended) if what != "assumed"}
    if "scale" in about:
        header |= {what: f"x {about['scale']:g}" for what in header if what.startswith("scale of ")}
    spectra = [path for path in files["spectra"] if path.suffix != ".hdr"]
    name = about.pop("name")
    named = StarterSources(cube, files["regions"], targets, spectra, header=stated_header, **about)
    return (*starter_campaign(named, place, name), header)


def draft(files: Mapping[str, list[str]], stated: Mapping[str, Any], most: int) -> list[tuple[str, str]]:
    """Entries of the campaign of the files that these leave open, and what they are."""
    paths = {part: [Path(file) for file in names] for part, names in files.items()}
    with TemporaryDirectory(prefix="hyperval-draft-") as place:
        text, *_ = _draft_campaign(Path(place), paths, stated, most)
    return [(one.key, one.what) for one in placeholders(*parse_yaml(text), "")]


def score_map(folder: str, name: str) -> None:
    """Write a score map as pages draw it: at most a million pixels, 16 bits between its ends."""
    raster = open_raster(Path(folder) / "results" / "scores" / f"{name}.tif")
    values = raster.read_some_bands(0, raster.lines, [0])[0]
    step = int(np.ceil(np.sqrt(values.size / _MAX_PIXELS)))
    shown = values[::step, ::step]
    finite = np.isfinite(values)
    low, high = (float(v) for v in np.quantile(values[finite], [0.0, 1.0])) if finite.any() else (0.0, 1.0)
    part = (shown.astype(float) - low) / (high - low or 1.0)
    scaled = np.nan_to_num(np.rint(part * 65534) + 1, nan=0.0).astype("<u2")  # 0: no score
    ordered = np.sort(values[finite])[::-1]
    curves = _curves(folder, name)
    content = {
        "width": shown.shape[1], "height": shown.shape[0], "step": step, "low": low, "high": high,
        "pixels": base64.b64encode(scaled.tobytes()).decode(), "known": int(finite.sum()),
        "above": _thresholds(ordered, curves), "curves": curves,
    }  # fmt: skip
    _write(Path(folder) / view_name(f"map-{name}"), content)


def _thresholds(ordered: npt.NDArray[Any], curves: list[dict[str, Any]]) -> list[list[float]]:
    """Thresholds, and how many pixels lie at each or above: evenly in that number, and at every target's score."""
    if not ordered.size:
        return []
    evenly = ordered[np.unique(np.geomspace(1, ordered.size, 200).astype(int)) - 1].astype(float)
    targets = [score for curve in curves for score in curve["target_scores"]]
    values = np.unique(np.concatenate([evenly, targets]))[::-1]
    counts = np.searchsorted(-ordered.astype(float), -values, side="right")
    return [[float(v), int(n)] for v, n in zip(values, counts, strict=True) if n]


def _curves(folder: str, name: str) -> list[dict[str, Any]]:
    """Measured curves whose scores the map shows: threshold, P_FA, P_D, and the scores at their upper ends."""
    _, observed = read_products(Path(folder) / "results").pair
    stems, out = [path.stem for path in (Path(folder) / "results" / "scores").glob("*.tif")], list[dict[str, Any]]()
    if observed is None:
        return out
    for (subject, detector, unit), c in observed.roc.items():
        # A map is named TARGET-DETECTOR, that of anomalies by its detector alone.  One map has all curves of its
        # detector; of several, a curve belongs to the map with the longest name that begins its subject.
        maps = {stem: stem.removesuffix(f"-{detector}") for stem in stems if f"-{stem}".endswith(f"-{detector}")}
        begun = [stem for stem, target in maps.items() if file_stems([subject])[subject].startswith(target)]
        map_name = max(maps if len(maps) == 1 else begun, key=len, default="")
        valid = np.isfinite(c.threshold) & np.isfinite(c.pd)
        if map_name == name and valid.any():
            parts = {part: getattr(c, part)[valid].tolist() for part in ("threshold", "pfa", "pd")}
            targets, background = _scores(observed, subject, detector, unit)
            out.append({"subject": subject, "unit": unit, "target_scores": targets, "n_target": c.n_target,
                        "background_scores": background, "n_background": c.n_background, **parts})  # fmt: skip
    return out


def _scores(observed: ObservedProducts, subject: str, detector: str, unit: str) -> tuple[list[float], list[float]]:
    """Greatest scores of what a curve counts and of its background, as a map has them; none where halos count."""
    objects = observed.object_scores.get((subject, detector))
    if objects is None:
        return [], []
    pixels, background = (observed.scores.get((name, detector)) for name in (subject, background_of(subject)))
    targets = objects.values if unit == "object" else None if pixels is None else pixels.greatest
    alarms = None if background is None else background.greatest
    both = (np.empty(0) if values is None else values[np.isfinite(values)] for values in (targets, alarms))
    first, second = (np.sort(values.astype("<f4"))[::-1].tolist() for values in both)
    return first, second


def _collection(path: str) -> tuple[CollectionSection, CubeSource, InputLog]:
    """The collection of a campaign, its cube, and where its files are."""
    job = next((job for job in load_jobs(Path(path)) if job.unavailable is None), None)
    if job is None or job.campaign.collection is None or job.campaign.collection.cube is None:
        raise UsageError("this campaign has no cube")
    return job.campaign.collection, job.campaign.collection.cube, InputLog.of_file(job.path)


def collection(folder: str, path: str) -> None:
    """Make the simulated collection of a campaign again, as its seed says, and keep it beside the run."""
    stated, _, inputs = _collection(path)
    part = Path(folder) / "collection.part"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    simulate(inputs.resolve(str(stated.simulate)), part)
    part.replace(Path(folder) / COLLECTION)


def pixel(folder: str, path: str, line: int, sample: int) -> None:
    """Write the chart of a pixel's spectrum beside the predicted ones."""
    stated, source, inputs = _collection(path)
    if stated.simulate:
        inputs.simulated = Path(folder) / COLLECTION
    cube = open_source(source, inputs.resolve, stated.bands)
    if not (0 <= line < cube.lines and 0 <= sample < cube.samples):
        raise UsageError(f"no such pixel: ({line}, {sample})", expected=f"({cube.lines}, {cube.samples}) pixels")
    values = cube.read(line, 1).values[0, sample]
    predicted, quantity = read_products(Path(folder) / "results").pair[0], source.quantity
    spectra = needed(getattr(predicted, quantity, None) or None, "web.spectra", quantity=quantity)
    spectrum = SpectralEstimate(values, np.zeros((values.size, values.size)))
    sides: dict[str, Any] = {quantity: dict.fromkeys(spectra, spectrum)}
    observed = ObservedProducts(cube.axis, **sides)
    figure = spectra_figure((predicted, observed), quantity, names=("predicted", f"pixel ({line}, {sample})"))
    _write(Path(folder) / view_name(f"pixel-{line}-{sample}"), [chart_data(figure)] if figure else [])


def _write(path: Path, content: Any) -> None:
    write_text(path, json.dumps(content, separators=(",", ":")))


TASKS: Mapping[str, Callable[..., Any]] = {
    "warm": warm, "prediction": predict, "draw": draw, "files": files, "study": study, "validation": campaign,
    "pipeline": pipeline, "draft": draft, "score_map": score_map, "pixel": pixel, "sensor": load_sensor,
    "collection": collection, "trade_live": live_figure, "trade_piece": next_piece,
}  # fmt: skip

"""Images for the report: score maps beside the expected score of every pixel, and a quicklook of the scene."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping
from itertools import product

import numpy as np

from hyperval.collection import Detection
from hyperval.imagery import all_pixels
from hyperval.observe import Observed, Place, map_name, scored_part, target_groups
from hyperval.pixels import nearest_point
from hyperval.products import PredictedProducts, background_of
from hyperval.results import Result
from hyperval.run import ExpectedScores, Quicklook, ScoreMap

Expected = Mapping[tuple[str, str, str], float]
# A region's name under "", or for each target that is looked for the subject that an object is in.
Content = dict[str, str]


def expected_maps(place: Place, detection: Detection, expected: Expected) -> dict[str, ExpectedScores]:
    """Name of a score map -> expected scores, of the maps of which the model says anything.

    Parameters
    ----------
    expected : (what lies there, target, detector) -> score [1]
    """
    numbers, contents = scene_content(place, detection, {subject for subject, _, _ in expected})
    out = {}
    for target, detector in product(detection.targets, detection.detectors):
        scores = np.full(len(contents) + 1, np.nan, np.float32)
        for i, content in enumerate(contents):
            keys = [(name, target.name, detector) for name in (content.get(target.name, ""), *content.values())]
            scores[i] = next((expected[key] for key in keys if key in expected), np.nan)
        if np.isfinite(scores).any():
            out[map_name(target.name, detector)] = ExpectedScores(numbers, scores)
    return out


def scene_content(
    place: Place, detection: Detection, subjects: Container[str]
) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.int16]], list[Content]]:
    """(lines, samples) number of what lies in a pixel, -1 where that is not known, and what the numbers mean.

    A region inside another one stands before it.  Pixels near targets that are not scored, and those that two
    targets share, hold an unknown part of them.
    """
    numbers, contents = np.full(place.cube.shape, -1, np.int16), list[Content]()
    sizes = {name: np.count_nonzero(place.region(name)) for name in place.regions if name in subjects}
    for name in sorted(sizes, key=lambda name: -sizes[name]):
        numbers[place.pixels_of(name)] = len(contents)
        contents.append({"": name})
    kinds: dict[str, Content] = {}
    for target in detection.targets:
        for subject, members in target_groups(place.targets, target, detection.group).items():
            for one in members:
                kinds.setdefault(one.name, {})[target.name] = subject
    of_targets = np.zeros(numbers.shape, bool)
    for one in (target for target in place.targets if target.name in kinds):
        contents += [kinds[one.name]] if kinds[one.name] not in contents else []
        part = scored_part(one, place)
        shared = of_targets[part.window][part.part]
        numbers[part.window][part.part] = np.where(shared, -1, contents.index(kinds[one.name]))
        part.paint(of_targets)
    return numbers, contents


# Wavelength [nm] of red, green, blue and the solar irradiance there relative to green (ASTM G173, rounded).
COLOURS = ((650.0, 0.84), (550.0, 1.0), (470.0, 1.07))
MAX_PIXELS = 1_000_000  # of the picture: of larger images every second, third ... line and sample is shown
STRETCH_PIXELS = 250_000  # that the stretch is taken from, at least
LINES_TOGETHER = 64
GAMMA = 0.6  # lifts the dark part of the scene, where most surfaces are


def score_maps(
    observed: Observed, detection: Detection | None, prediction: PredictedProducts | None, rows: Iterable[Result]
) -> dict[str, ScoreMap]:
    """Every score map with its place on the ground, the outlines of its targets and what the model expects there.

    ``rows`` : of the comparison with the prediction, which say what carries a difference of false alarms
    """
    if observed.detected is None or observed.place is None or detection is None:
        return {}
    cube, size = observed.place.cube, observed.place.pixel_area_m2
    maps = expected_maps(observed.place, detection, prediction.expected_scores) if prediction else {}
    reasons = {(r.subject, r.method): r.reason for r in rows if r.metric == "pfa_ratio_without@1e-2"}
    carried = {}
    for key, law in prediction.exceedance.items() if prediction else ():
        if law.influence is not None and (words := reasons.get((background_of(key[0]), key[1]))):
            measured = observed.observation.exceedance[key]
            threshold = float(measured.threshold[nearest_point(measured, 1e-2)])
            ratio = np.append(law.influence.at(threshold), np.nan)[law.influence.number]
            carried[map_name(*key)] = ratio, threshold, words
    transform = tuple(cube.transform)[:6] if cube.transform else None
    crs, side_m = cube.crs.to_wkt() if cube.crs else None, float(np.sqrt(size)) if size else None
    outlines = observed.detected.outlines
    return {
        name: ScoreMap(values, transform, crs, outlines.get(name, {}), side_m, maps.get(name), carried.get(name))
        for name, values in observed.detected.score_maps.items()
    }


def quicklook(observed: Observed) -> Quicklook | None:
    """Red, green and blue of the scene under one stretch; None without a cube.

    Reflectance (after the empirical line where there is one) keeps its natural balance; radiance is divided by the
    solar irradiance first, which leaves the blue of the path radiance.  Regions found by a rule, scattered over the
    whole image, are not outlined.
    """
    if observed.place is None:
        return None
    cube = observed.place.cube
    centre = cube.axis.centre_nm
    bands = [int(np.argmin(np.abs(centre - nm))) for nm, _ in COLOURS]
    if cube.axis.numbered:  # from the long end to the short one, as red, green and blue stand
        bands = [cube.bands * quarter // 4 for quarter in (3, 2, 1)]
    step = max(1, math.ceil(math.sqrt(cube.lines * cube.samples / MAX_PIXELS)))
    lines = range(0, cube.lines, step)  # every so many, and as many samples
    picture = np.empty((len(lines), len(range(0, cube.samples, step)), len(bands)), np.float32)
    # A few bands of a file of arrays are read without the others, and its blocks hold many lines.
    together = step * max(1, LINES_TOGETHER // step) if cube.raster.in_blocks else 1
    with cube.raster.kept_open():
        for out, start in zip(picture, lines, strict=True):
            if start % together == 0:
                part = cube.read_some_bands(start, min(together, cube.lines - start), bands)
            out[:] = part[start % together, ::step]
    offset, gain = np.zeros(3), np.ones(3)
    line = observed.place.line
    if line is not None and np.all(line.usable[bands]):
        offset, gain = line.offset[bands], line.gain[bands]
    elif cube.quantity == "radiance":
        gain = np.array([irradiance for _, irradiance in COLOURS])
    thinned = (picture[:: max(1, picture[..., 0].size // STRETCH_PIXELS)] - offset) / gain
    high = max(float(np.nanpercentile(thinned, 99.0)), float(np.finfo(np.float32).tiny))
    colours = np.empty(picture.shape, np.uint8)
    for row, values in zip(colours, picture, strict=True):  # the whole picture in float64 would be the run's peak
        row[:] = np.rint(255.0 * np.nan_to_num(np.clip((values - offset) / gain / high, 0.0, 1.0)) ** GAMMA)
    number, members = observed.place.labels.number[::step, ::step], observed.place.regions.members.items()
    outlines = {name: mask[number] for name, mask in members if name not in observed.place.by_rule}
    if observed.place.targets:
        outlines["targets"] = all_pixels(observed.place.targets, cube.shape)[::step, ::step].copy()
    size = observed.place.pixel_area_m2
    side_m = step * float(np.sqrt(size)) if size else None
    shown = ", ".join(f"{nm:.0f}" for nm in centre[bands])
    return Quicklook(colours, outlines, f"bands {shown}" if cube.axis.numbered else f"{shown} nm", side_m)

"""What lies in each pixel of a collection, as far as regions and truth say, and the score expected there."""

from __future__ import annotations

from collections.abc import Container, Mapping

import numpy as np

from hyperval.collection import Detection
from hyperval.observe.filter_bank import map_name
from hyperval.observe.objects import scored_pixels, target_groups
from hyperval.observe.place import Place
from hyperval.report import ExpectedScores

Expected = Mapping[tuple[str, str, str], float]
# A region's name, or for each target that is looked for the subject that an object is in.
Content = dict[str, str]
ANY = ""


def expected_maps(place: Place, detection: Detection, expected: Expected) -> dict[str, ExpectedScores]:
    """Name of a score map -> expected scores, of the maps of which the model says anything.

    Parameters
    ----------
    expected : (what lies there, target, detector) -> score [1]
    """
    if not expected:
        return {}
    numbers, contents = scene_content(place, detection, {subject for subject, _, _ in expected})
    out = {}
    for target in detection.targets:
        for detector in detection.detectors:
            scores = np.full(len(contents) + 1, np.nan, np.float32)
            for i, content in enumerate(contents):
                names = [content.get(target.name), *content.values()]
                keys = [(name, target.name, detector) for name in names if name is not None]
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
        contents.append({ANY: name})
    kinds: dict[str, Content] = {}
    for target in detection.targets:
        for subject, members in target_groups(place.targets, target, detection.group).items():
            for one in members:
                kinds.setdefault(one.name, {})[target.name] = subject
    of_targets = np.zeros(numbers.shape, bool)
    for one in place.targets:
        if one.name not in kinds:
            continue
        if kinds[one.name] not in contents:
            contents.append(kinds[one.name])
        (line, sample), part = scored_pixels(one, place)
        window = slice(line, line + part.shape[0]), slice(sample, sample + part.shape[1])
        shared = of_targets[window][part]
        numbers[window][part] = np.where(shared, -1, contents.index(kinds[one.name]))
        of_targets[window] |= part
    return numbers, contents

"""The interactive chart of many objects: a map of measured minus predicted score, and a histogram of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.report.charts_base import Chart, Fill, chart_content
from hyperval.report.run import ScoreMap
from hyperval.report.sides import Sides
from hyperval.report.text_cache import chart_models

Array = npt.NDArray[np.float64]
MANY_OBJECTS = 40  # of fewer, each has its place in a list
_BINS = 24
_MOST_TABS = 6


@dataclass(frozen=True)
class MapObjects:
    """The objects of one score map, with a prediction each.

    Attributes
    ----------
    names : of the objects (N)
    line, sample : (N,) centre of each [pixel]
    measured : (N,) greatest score over the pixels of each [1]
    predicted : (N,) median of its predicted scores [1]
    draws : for each object the number of its predicted scores in ``by_subject``
    by_subject : the predicted scores of each subject
    """

    names: tuple[str, ...]
    line: Array
    sample: Array
    measured: Array
    predicted: Array
    draws: npt.NDArray[np.intp]
    by_subject: tuple[Array, ...]

    def histogram(self) -> tuple[Array, Array, Array]:
        """Edges (K + 1,) [1], measured objects in each bin (K,) and how many the prediction expects there (K,).

        Scores beyond the edges count in the outermost bins, so that both sum to the number of objects.
        """
        ends = np.concatenate([self.measured, *(np.quantile(d, [0.005, 0.995]) for d in self.by_subject)])
        edges = np.linspace(ends.min(), max(ends.max(), ends.min() + 1e-9), _BINS + 1)
        expected = np.zeros(_BINS)
        for number, draws in enumerate(self.by_subject):
            share = np.histogram(np.clip(draws, edges[0], edges[-1]), edges)[0] / draws.size
            expected += np.count_nonzero(self.draws == number) * share
        return edges, np.histogram(self.measured, edges)[0].astype(float), expected


def map_objects(name: str, score_map: ScoreMap, sides: Sides) -> MapObjects | None:
    """The objects of a score map that have a measured and a predicted score; None for few."""
    if None in sides or len(score_map.outlines) <= MANY_OBJECTS:
        return None
    predicted, measured = (side.object_scores for side in sides if side is not None)
    names, values, draws = [], [], []
    by_subject: list[Array] = []
    for (subject, detector), scores in measured.items():
        law = predicted.get((subject, detector))
        if law is None or not name.endswith(f"-{detector}"):
            continue
        own = [
            i for i, one in enumerate(scores.names) if one in score_map.outlines and np.isfinite(scores.values[i])
        ]
        if own:
            names += [scores.names[i] for i in own]
            values += [float(scores.values[i]) for i in own]
            draws += [len(by_subject)] * len(own)
            by_subject.append(np.ravel(law.values))
    if len(names) <= MANY_OBJECTS:
        return None
    centres = np.array([np.mean(np.nonzero(score_map.outlines[one]), axis=1) for one in names]) + 0.5
    medians, number = np.array([np.median(d) for d in by_subject]), np.array(draws)
    return MapObjects(
        tuple(names), centres[:, 0], centres[:, 1], np.array(values), medians[number], number, tuple(by_subject)
    )


def objects_chart(maps: Mapping[str, ScoreMap], sides: Sides) -> Chart | None:
    """A map of the objects of each score map and a histogram of their scores; None where they are few."""
    shown = {name: own for name, one in maps.items() if (own := map_objects(name, one, sides)) is not None}
    shown = dict(list(shown.items())[:_MOST_TABS])
    if not shown:
        return None
    fill, words = Fill(), []
    for tab, (name, own) in enumerate(shown.items()):
        difference = own.measured - own.predicted
        columns = {"sample": own.sample, "line": own.line, "measured": own.measured, "predicted": own.predicted}
        fill.add(f"objects-{tab}", columns | {"difference": difference})
        fill.texts[f"objects-{tab}"] = {"name": list(own.names)}
        edges, measured, expected = own.histogram()
        fill.add(
            f"bins-{tab}", {"left": edges[:-1], "right": edges[1:], "measured": measured, "predicted": expected}
        )
        reach = float(np.max(np.abs(difference))) or 1.0
        fill.colours[f"difference-{tab}"] = -reach, reach
        margin = 0.02 * (edges[-1] - edges[0])
        fill.ranges[f"score-{tab}"] = float(edges[0] - margin), float(edges[-1] + margin)
        fill.ranges[f"count-{tab}"] = 0.0, 1.08 * float(max(measured.max(), expected.max()))
        words.append(
            f"{name}: {len(own.names)} objects, median measured {np.median(own.measured):.3g}, "
            f"predicted {np.median(own.predicted):.3g}"
        )
    return Chart(
        "chart-objects",
        "scores",
        "Score of each object, measured minus predicted median, at its place, and the scores of all: what is "
        "chosen in one stands out in the other",
        "Map of the objects coloured by measured minus predicted score, and a histogram of the measured scores "
        f"with what the prediction expects, a tab for each score map. {'; '.join(words)}.",
        chart_content(chart_models("objects", "chart-objects", tuple(shown)), fill),
    )

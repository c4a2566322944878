"""The score that the model expects of a pixel of which it is known what lies there (means of 3.26 and 3.27)."""

from __future__ import annotations

import numpy as np

from hyperval.prediction.batch import Batch
from hyperval.prediction.object_scores import Evaluations, Index
from hyperval.prediction.responses import lit_surface
from hyperval.processing.elm_model import retrieved_reflectance
from hyperval.scene.radiance import target_pixel_reflectance


def expected_scores(batch: Batch, points: Index) -> dict[tuple[str, str, str], float]:
    """(what lies there, target, detector) -> expected score [1], of linear detectors in the first of ``points``.

    What lies there is a class, a panel, a site or a population of any target, whichever target the filter looks
    for.  The score is linear in what the detector sees, and that in the reflectance: the mean score of a population
    is that of its mean fill.  A surface whose spectrum lacks bands of the detector has none.
    """
    here, point = Evaluations(batch, points[:1]), int(points[0])
    group, row = here.group, here.row
    at, setting = group.at.rows(np.array([row])), batch.points.setting[point]
    surfaces = batch.settings.grounds[batch.settings.which[setting]].surfaces
    scene = batch.scenario.scene
    means = {s.name: surfaces[s.name].mean[group.bands] for s in (*scene.classes, *scene.panels, *scene.sites)}
    for number, target in enumerate(batch.targets):
        beam, sky = (batch.points.of(part, number)[points[:1]] for part in (batch.points.beam, batch.points.sky))
        lit = lit_surface(at, batch.material(number, beam, sky, group.bands))[0][0, 0]
        for p, population in enumerate(target.populations):
            fill = batch.fill_of(point, number, p).mean
            means[population.name] = target_pixel_reflectance(fill, lit, means[target.host])
    seen = retrieved_reflectance(at.view.line(), at.levels(np.array(list(means.values()))))[0]
    out: dict[tuple[str, str, str], float] = {}
    for (looks_for, detector), (filters, _, _) in group.filters.items():
        scores = seen @ filters.weights[row] - filters.offset[row]
        expected = zip(means, scores.tolist(), strict=True)
        out |= {(name, looks_for, detector): score for name, score in expected if np.isfinite(score)}
    return out

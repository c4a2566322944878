"""Peers of the benchmark: matched filter, ACE and RX of SPy on the same pixels, bands, spectra and background."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import spectral
from scipy import stats

from hyperval.collection import Detection
from hyperval.compare.rows import RowMaker
from hyperval.observe import Observed
from hyperval.observe.objects import scored_pixels, target_groups
from hyperval.prediction.inputs import Sources
from hyperval.processing.objects import values_on
from hyperval.results import Cause, Result
from hyperval.scoreboard.looks import EVERY_OBJECT, PRODUCT

Array = npt.NDArray[np.float64]
MOST_VALUES = 50_000_000  # of the image in the bands of the filters: SPy works on all of it in memory
PEER = "spy"


# By the name of our own detector.
PEERS: dict[str, Callable[[Array, Array, Any], Any]] = {
    "matched-filter": spectral.matched_filter,
    "ace": spectral.ace,
    "rx": lambda image, _, background: spectral.rx(image, background=background),
}


def peer_rows(observed: Observed, detection: Detection | None, resolve: Callable[[str], Path]) -> list[Result]:
    """Area under the ROC by pixel of each subject and peer (``auc``), and how SPy's scores follow ours.

    ``score_rank_correlation`` is Spearman's between its map and ours over all pixels that both score: 1 where
    both put them into the same order.  One SKIPPED row where the image is too large to be taken into memory.
    """
    place, detected = observed.place, observed.detected
    if detection is None or place is None or detected is None:
        return []
    cube, bands = place.cube, np.flatnonzero(detected.bands)
    if cube.lines * cube.samples * bands.size > MOST_VALUES:
        why = f"SPy holds the image in memory, and it has more than {MOST_VALUES:.0e} values"
        return [RowMaker(PRODUCT, EVERY_OBJECT, PEER).skipped(Cause.REFUSED, why, "auc")]
    image = np.concatenate([block.values[..., bands] for block in cube.blocks()])
    if observed.elm is not None:
        image = (image - observed.elm.offset[bands]) / observed.elm.gain[bands]
    valid = np.isfinite(image).all(axis=-1)
    background = spectral.calc_stats(image, mask=(place.background(detection.background) & valid).astype(np.int8))
    image[~valid] = background.mean
    alarms = place.background(detection.false_alarms) & valid
    sources = Sources(cube.axis, {}, resolve)
    rows = []
    for target in detection.targets:
        spectrum = sources.spectrum(target.spectrum, target.name).mean[bands]
        groups = target_groups(place.targets, target, detection.group)
        for name, peer in PEERS.items():
            scores = np.asarray(peer(image, spectrum, background), dtype=np.float64)
            scores[~valid] = np.nan
            for subject, members in groups.items():
                pixels = np.concatenate([values_on(scores, scored_pixels(o, place)) for o in members])
                make = RowMaker(PRODUCT, subject, f"{PEER}-{name}/pixel")
                rows += _subject_rows(make, pixels[np.isfinite(pixels)], scores[alarms])
            own = detected.score_maps.get(name if name == "rx" else f"{target.name}-{name}")
            if own is not None:
                make = RowMaker(PRODUCT, target.name, f"{PEER}-{name}/pixel")
                both = np.isfinite(own) & np.isfinite(scores)
                value = float(stats.spearmanr(own[both], scores[both]).statistic)
                rows.append(make.row("score_rank_correlation", value, n=int(both.sum()), reason=_version()))
    return rows


def _subject_rows(make: RowMaker, pixels: Array, noise: Array) -> list[Result]:
    if not pixels.size or not noise.size:
        return [make.skipped(Cause.NO_OBSERVATION, "no valid pixel on the targets or in the background", "auc")]
    share = stats.mannwhitneyu(pixels, noise).statistic / (pixels.size * noise.size)
    return [make.row("auc", float(share), n=int(pixels.size), reason=_version())]


def _version() -> str:
    return f"a peer: SPy {spectral.__version__}, same bands, spectra and background"

"""Measured error of a Gaussian maximum-likelihood classifier, trained on some lines and tried on others."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from hyperval.collection import Classification
from hyperval.errors import UsageError
from hyperval.observe.place import Place
from hyperval.processing.class_features import class_features, feature_bands
from hyperval.processing.gaussian_classifier import ClassLaw, measured_error
from hyperval.processing.sample import statistics_of
from hyperval.products import ClassificationError
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Fewer training pixels for each feature, and the classifier's own error is that of its training.
PIXELS_PER_FEATURE = 3


@dataclass(frozen=True, eq=False)
class _Half:
    """Pixels (n, B) of one class and the block that each lies in."""

    pixels: Array
    blocks: npt.NDArray[np.intp]


def classification_errors(place: Place, task: Classification) -> dict[tuple[str, str], ClassificationError]:
    """Errors by (classes, features); classes joined by " / ".

    Blocks of whole lines are dealt out at random (the campaign's seed) to training and test.

    Raises
    ------
    UsageError : a region that is none, or one with too few pixels in either half.
    """
    axis = place.cube.axis
    usable = in_window(axis.centre_nm) & axis.good
    halves = {name: _halves(place, name, task) for name in task.classes}
    out = {}
    for chosen in class_sets(task):
        for choice in task.features:
            bands = feature_bands(axis.centre_nm, usable, choice.bands_nm)
            trained = [statistics_of(halves[name][0].pixels[:, bands]) for name in chosen]
            laws = [ClassLaw(s.mean, s.covariance) for s in trained]
            psi = class_features(laws, choice.pca)
            for name, law_n in zip(chosen, (s.n for s in trained), strict=True):
                if law_n < PIXELS_PER_FEATURE * psi.shape[0]:
                    raise UsageError(
                        f"classification: {law_n} training pixels of {name!r} for {psi.shape[0]} features",
                        expected=f"{PIXELS_PER_FEATURE} for each",
                        mend="use fewer bands, or pca",
                    )
            out[" / ".join(chosen), choice.name] = measured_error(
                [law.project(psi) for law in laws],
                [halves[name][1].pixels[:, bands] @ psi.T for name in chosen],
                [halves[name][1].blocks for name in chosen],
            )
    return out


def class_sets(task: Classification) -> list[tuple[str, ...]]:
    """All classes together, and every pair of them where the campaign asks for pairs."""
    sets = [tuple(task.classes)]
    if task.pairs and len(task.classes) > 2:
        sets += list(combinations(task.classes, 2))
    return sets


def _halves(place: Place, name: str, task: Classification) -> tuple[_Half, _Half]:
    mask = place.pixels_of(name)
    lines, samples = np.nonzero(mask)
    block = lines // task.block_lines
    blocks = np.unique(block)
    if blocks.size < 2:
        raise UsageError(
            f"classification: region {name!r} lies in one block of {task.block_lines} lines",
            mend="make classification.block_lines smaller: training and test take whole blocks",
        )
    rng = np.random.default_rng([task.seed, place.cube.lines])
    # Half of the blocks that hold the class train.
    order = rng.permutation(int(-(-place.cube.lines // task.block_lines)))
    dealt = order[np.isin(order, blocks)]
    trains = np.isin(block, dealt[: dealt.size // 2])
    return (
        _half(place, lines[trains], samples[trains], block[trains], task.pixels, name),
        _half(place, lines[~trains], samples[~trains], block[~trains], task.pixels, name),
    )


def _half(
    place: Place,
    lines: npt.NDArray[np.intp],
    samples: npt.NDArray[np.intp],
    block: npt.NDArray[np.intp],
    most: int,
    name: str,
) -> _Half:
    step = max(-(-lines.size // most), 1)  # evenly thinned
    at = lines[::step], samples[::step]
    pixels, valid = place.cube.marked_pixels(at)
    if np.count_nonzero(valid) < 2:
        raise UsageError(f"classification: region {name!r} has fewer than two valid pixels in one of the halves")
    return _Half(pixels if valid.all() else pixels[valid], block[::step][valid])

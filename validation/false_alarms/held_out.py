"""False alarms of HySU's five filters, in sample and on blocks of the image that the model was not told of.

    HYPERVAL_DATA=... python validation/false_alarms/held_out.py [SPLITS]

Each model is fitted to the pixels outside the targets, class by class as in the campaign: to all of them, and to
one half of the image's blocks (drawn at random, SPLITS times, each half in turn), the filters being those of the
campaign.  Printed are predicted over measured P_FA at the threshold that the pixels themselves set: in sample,
and on the other half as geometric means, with the share of pairs of filter and half within a factor of two.
The last line is the yardstick: one half of the pixels in the place of a model.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from law_coverage import parts_of, scored

from hyperval.campaign import load_jobs
from hyperval.datasets import InputLog
from hyperval.model import ClassScores, log_false_alarm
from hyperval.observe import observe
from hyperval.pixels import class_mixture, fit_leading_tails

CAMPAIGN = Path(__file__).parents[2] / "campaigns" / "hysu-2018" / "campaign.yaml"
MATERIALS = ("bitumen", "red_metal", "blue_fabric", "red_fabric", "green_fabric")
LEVELS = (1e-2, 1e-3)
SIDE = 10  # pixels of a block, 7 m

Pixels = np.ndarray


class Image:
    """Pixels outside the targets: spectra, class, block, and the scores of the five filters."""

    def __init__(self) -> None:
        job = load_jobs(CAMPAIGN)[0]
        detection = job.campaign.detection.model_copy(update={"unmixing": None})
        observed = observe(job.campaign.collection, detection, InputLog.of_file(job.path).resolve)
        place, detected = observed.place, observed.detected
        counted = place.pixels_of(*detection.false_alarms)
        self.lines, self.samples = np.nonzero(counted)
        self.spectra = place.cube.spectra((self.lines, self.samples))[:, detected.bank.bands]
        self.kind = sum(i * place.pixels_of(name)[counted] for i, name in enumerate(place.regions))
        self.block = (self.lines // SIDE) * 1000 + self.samples // SIDE
        filters = [detected.bank.detectors[f"{m}-cem"] for m in MATERIALS]
        self.weights = np.array([f.weights[0] for f in filters])
        self.offsets = -np.array([f.constants[0] for f in filters])
        self.maps = [detected.score_maps[f"{m}-cem"] for m in MATERIALS]
        self.counted = counted
        self.scores = np.array([m[counted] for m in self.maps])


def laws(image: Image, rows: Pixels, count: object, tails: bool) -> list[ClassScores]:
    """Scores of the laws of all classes, for each filter, of the pixels ``rows``."""
    parts = []
    for kind in np.unique(image.kind):
        members = rows[image.kind[rows] == kind]
        x = image.spectra[members]
        mean, covariance = x.mean(axis=0), np.cov(x.T)
        fit = class_mixture(x, image.block[members], count, tails=tails)
        mixture = None if fit is None else fit.components(x)
        tail = fit_leading_tails(x, mean, covariance) if tails and mixture is None else None
        parts += [(members.size / rows.size * f, *rest) for f, *rest in parts_of(mean, covariance, tail, mixture)]
    return [scored(w, offset, parts) for w, offset in zip(image.weights, image.offsets, strict=True)]


def ratios(image: Image, share: Callable[[int, float], float], rows: Pixels) -> np.ndarray:
    """(levels, filters) ``share`` above a threshold of a filter over that of the pixels ``rows``, who set it."""
    out = np.empty((len(LEVELS), len(MATERIALS)))
    for f in range(len(MATERIALS)):
        ordered = np.sort(image.scores[f][rows])[::-1]
        for i, level in enumerate(LEVELS):
            alarms = max(round(level * rows.size), 1)
            out[i, f] = share(f, ordered[alarms]) / (alarms / rows.size)
    return out


def by_laws(models: list[ClassScores]) -> Callable[[int, float], float]:
    return lambda f, x: float(np.exp(log_false_alarm(np.array([x]), models[f])[0][0]))


def by_pixels(image: Image, told: Pixels) -> Callable[[int, float], float]:
    """The pixels ``told`` in the place of a model; half an alarm where they have none."""
    return lambda f, x: max(np.count_nonzero(image.scores[f][told] > x), 0.5) / told.size


def halves(image: Image, splits: int) -> list[tuple[Pixels, Pixels]]:
    blocks, block_of = np.unique(image.block, return_inverse=True)
    out = []
    for number in range(splits):
        first = (np.random.default_rng(number).permutation(blocks.size) % 2)[block_of] == 0
        one, other = np.flatnonzero(first), np.flatnonzero(~first)
        out += [(one, other), (other, one)]
    return out


def line(name: str, inside: np.ndarray | None, outside: np.ndarray) -> str:
    means = np.exp(np.log(np.maximum(outside, 1e-6)).mean(axis=0))
    within = (np.abs(np.log2(outside)) <= 1.0).mean(axis=(0, 2))
    cells = [name]
    for i in range(len(LEVELS)):
        cells.append(" ".join(f"{v:.2g}" for v in inside[i]) if inside is not None else "1 by construction")
    for i in range(len(LEVELS)):
        cells.append(" ".join(f"{v:.2g}" for v in means[i]) + f" ({within[i]:.2f})")
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    splits = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    image = Image()
    every, pairs = np.arange(image.kind.size), halves(image, splits)
    print("| background | in sample 1e-2 | in sample 1e-3 | held out 1e-2 (within 2) | held out 1e-3 (within 2) |")
    print("| --- | --- | --- | --- | --- |")
    for name, count, tails in (
        ("three classes, normal", 1, False), ("three classes, t", 1, True),
        ("mixtures, normal", "auto", False), ("mixtures, t", "auto", True),
    ):  # fmt: skip
        inside = ratios(image, by_laws(laws(image, every, count, tails)), every)
        outside = np.array([ratios(image, by_laws(laws(image, told, count, tails)), rows) for told, rows in pairs])
        print(line(name, inside, outside), flush=True)
    yardstick = np.array([ratios(image, by_pixels(image, told), rows) for told, rows in pairs])
    print(line("the other half of the image", None, yardstick), flush=True)


if __name__ == "__main__":
    main()

"""What regions and targets have in common, and what of them is not part of the image, in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from hyperval.imagery.regions import Region, holes, overlaps
from hyperval.imagery.truth import TargetObject

Mask = npt.NDArray[np.bool_]


def region_notes(regions: Iterable[Region], by_rule: frozenset[str] = frozenset()) -> list[str]:
    """What leaves the image, which regions have holes (but those that a rule found), which share pixels."""
    listed = list(regions)
    notes = [remark for region in listed for remark in region.remarks]
    for region in listed:
        count, pixels = (0, 0) if region.name in by_rule else holes(region.mask)
        if count:
            what = "a hole" if count == 1 else f"{count} holes"
            notes.append(f"the region {region.name!r} has {what} of {pixels} pixels, which are not part of it")
    notes += [
        f"the regions {first!r} and {second!r} share {count} pixels" for first, second, count in overlaps(listed)
    ]
    return notes


def target_overlaps(regions: Iterable[Region], targets: Sequence[TargetObject], near: Mask) -> list[str]:
    """Which regions hold pixels of targets or of their guard, and what becomes of these; likewise two targets."""
    notes: list[str] = []
    if not targets:
        return notes
    touched = np.zeros(near.shape, np.int32)
    for target in targets:
        touched[target.window] += target.part
    for region in regions:
        inside, guarded = int(np.sum(region.mask & (touched > 0))), int(np.sum(region.mask & near))
        if not guarded:
            continue
        what = f"the region {region.name!r} holds {inside} pixels of targets and {guarded - inside} of their guard"
        if guarded == region.n:
            notes.append(f"warning: {what}, which is all of it: they stay in its statistics")
        else:
            notes.append(f"{what} among {region.n}: left out of its statistics")
    shared = int(np.sum(touched > 1))
    if shared:
        notes.append(f"{shared} pixels may hold parts of more than one target" + _between(targets))
    return notes


def _between(targets: Sequence[TargetObject]) -> str:
    """Which materials share pixels, in words: ": 12 of 'a' and 'b'"."""
    masks: dict[str, Mask] = {}
    for target in targets:
        masks[target.material] = masks[target.material] | target.mask if target.material in masks else target.mask
    pairs = overlaps(Region(name, mask, "targets") for name, mask in masks.items())
    return ": " + ", ".join(f"{n} of {a!r} and {b!r}" for a, b, n in pairs) if pairs else ""

"""Which objects of the truth a subject holds, and which of their pixels count."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from hyperval.collection import DetectionTarget
from hyperval.errors import UsageError
from hyperval.imagery.truth import TargetObject
from hyperval.observe.place import Place
from hyperval.processing.objects import Placed

# Names in braces are replaced as they stand: str.format would take widths that fill the memory.
_BRACES = re.compile(r"\{([^{}]*)\}")


def scored_pixels(target: TargetObject, place: Place) -> Placed:
    """The pixels of an object that are scored, in their window."""
    if place.target_pixels == "touched" or target.centre_pixel is None:
        return target.placed
    return target.centre_pixel, np.ones((1, 1), bool)


def target_groups(
    objects: Sequence[TargetObject], target: DetectionTarget, form: str
) -> dict[str, list[TargetObject]]:
    """Objects of the target's material by subject name, in the order of the truth."""
    out: dict[str, list[TargetObject]] = {}
    for item in objects:
        if item.material != target.material:
            continue
        words = {"name": item.name, "material": item.material, **item.attributes, "target": target.name}
        subject = _subject(form, words)
        out.setdefault(subject, []).append(item)
    if not out:
        known = sorted({o.material for o in objects})
        raise UsageError(
            f"target {target.name!r}: the truth has no object of material {target.material!r}",
            expected="one of " + ", ".join(known) if known else "a truth with targets",
        )
    return out


def _subject(form: str, words: Mapping[str, str]) -> str:
    unknown = [word for word in _BRACES.findall(form) if word not in words]
    if unknown:
        raise UsageError(
            f"detection.group {form!r} does not fit the truth: no {unknown[0]!r}",
            expected="names in braces out of " + ", ".join(sorted(words)),
        )
    return _BRACES.sub(lambda match: words[match[1]], form)

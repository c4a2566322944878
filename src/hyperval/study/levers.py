"""Which inputs of a scenario move as columns of numbers, and what each of them touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hyperval.errors import UsageError
from hyperval.scenario import Scenario
from hyperval.settings import path_parts

PFA = "pfa"  # reserved: the false-alarm probability at which P_D is read, no entry of a scenario
_OPERATION = ("frames_averaged", "averaged", "spatial_binning")
_SHADE = {"beam": "beam", "sky_view": "sky"}


@dataclass(frozen=True)
class Lever:
    """What a dotted path moves.

    Attributes
    ----------
    kind : atmosphere, changes, operation, fraction, gain, tail, kappa, target_gain, beam, sky, fill, pfa; or
    prepare,
        for entries after whose change everything is read anew
    item : number of the class or target that it belongs to
    subject : number of the target's population
    key : the entry, for atmosphere, changes, operation and fill
    """

    kind: str
    item: int = 0
    subject: int = 0
    key: str = ""

    @property
    def needs_preparation(self) -> bool:
        """True where the scenario has to be prepared anew for each value."""
        return self.kind == "prepare"


def lever_of(scenario: Scenario, path: str) -> Lever:
    """What ``path`` moves in ``scenario``.

    Raises
    ------
    UsageError : no dotted path.
    """
    if path == PFA:
        return Lever("pfa")
    match path_parts(path):
        case ["atmosphere", key] if scenario.atmosphere is not None and key != "engine" and key != "table":
            return Lever("atmosphere", key=key)
        case ["sensor_changes", key] if scenario.atmosphere is not None:
            return Lever("changes", key=key)
        case ["sensor_operation", key] if scenario.atmosphere is not None and key in _OPERATION:
            return Lever("operation", key=key)
        case ["scene", "adjacency", "effective_neighbours"]:
            return Lever("kappa")
        case ["scene", "classes", name, key] if key in ("fraction", "gain", "tail_dof"):
            item = _number([c.name for c in scenario.scene.classes], name, path)
            return Lever("tail" if key == "tail_dof" else key, item)
        case ["scene", "targets", name, *rest]:
            return _of_target(scenario, _number([t.name for t in scenario.scene.targets], name, path), rest, path)
    return Lever("prepare", key=path)


def _of_target(scenario: Scenario, item: int, rest: Sequence[str], path: str) -> Lever:
    target = scenario.scene.targets[item]
    match list(rest):
        case ["gain"]:
            return Lever("target_gain", item)
        case ["illumination", key] if key in _SHADE:
            return Lever(_SHADE[key], item)
        case ["fill", *keys] if keys and not target.subjects:
            return Lever("fill", item, 0, ".".join(keys))
        case ["subjects", name, "fill", *keys] if keys and target.subjects:
            return Lever("fill", item, _number([s.name for s in target.subjects], name, path), ".".join(keys))
    return Lever("prepare", key=path)


def _number(names: Sequence[str], part: str, path: str) -> int:
    if part in names:
        return list(names).index(part)
    if part.isdecimal() and int(part) < len(names):
        return int(part)
    raise UsageError(f"setting {path!r}: no item {part!r}", expected="one of " + ", ".join(names))

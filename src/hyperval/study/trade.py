"""Trade-offs by plain names: one or two inputs against an output, piece by piece, and the ROC where sliders stand.

What is asked is a study (:func:`trade_study`), whose YAML ``hyperval study`` runs unchanged to the same numbers.  Where
it can, the emulator gives the atmosphere, so that sliders of sun and haze answer at once; its error is shown and is
part of the intervals.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from hyperval.config import Model
from hyperval.data import LINEAR_DETECTORS, Array, Mask
from hyperval.datasets import resolve
from hyperval.errors import UsageError, package_table, refusal, refuse
from hyperval.figures.spec import CURVES, PREDICTED, WAVELENGTH, Axis, Figure, Mark, Panels, Part, Rules, figure_json
from hyperval.model import Origins, World, all_paths, evaluations, predict, read_world, value_at, with_values
from hyperval.model.intervals import Z95
from hyperval.model.radiance import mean_radiance
from hyperval.model.roc import detection_at
from hyperval.model.world import as_column, is_in_file, matches_path, with_truths
from hyperval.scenario import Scenario, load_scenario
from hyperval.sensor.specification import library_names
from hyperval.settings import numbers_of, path_parts, setting, with_settings
from hyperval.study import plan
from hyperval.study.page import cell_edges, heat_mark
from hyperval.study.schema import Grid, Input, Move, Output, Plot, Probability, Required, StudyFile

POINTS, MAP_POINTS = 33, 17  # along an input: 1 more than a power of two, so that each piece halves the steps
_STRIDES = (8, 4, 2, 1)
_LIMITS_AT = 9  # values of the input at which an interval is predicted
_SCAN, _MAX_LINES = 17, 12
_ROC = np.geomspace(1e-6, 0.999, 73)
OFFERED = package_table("study/trade.yaml")
KINDS: dict[str, str] = OFFERED["outputs"]


class Trade(Model):
    """What is asked of a scenario; inputs go by the keys of :class:`TradeInput`, sensors of files by their names."""

    scenario: str = Field("yellow-planks-asphalt", max_length=100)
    x: str = Field("", max_length=300)
    x_from: float | None = None
    x_to: float | None = None
    y: str = Field("", max_length=300)
    y_from: float | None = None
    y_to: float | None = None
    output: Literal["pd", "auc", "snr", "radiance"] = "pd"
    pfa: Probability = 1e-3
    from_nm: float = Field(500.0, gt=0)
    to_nm: float = Field(900.0, gt=0)
    detector: str = Field("", max_length=40)
    subject: list[str] = Field(default_factory=list, max_length=_MAX_LINES)
    background: list[str] = Field(default_factory=list, max_length=_MAX_LINES)
    sensor: list[str] = Field(default_factory=list, max_length=2)
    side_m: float | None = Field(None, gt=0, le=100, description="of a target of fixed fill, so that it has a GSD")
    wanted: float | None = Field(None, description="required value of the output, solved for along x")
    moved: dict[str, float] = Field(default_factory=dict, max_length=20)
    kept: tuple[Path, ...] = ()

    @property
    def is_spectral(self) -> bool:
        """Whether the output is a spectrum's."""
        return self.output in ("snr", "radiance")


class TradeInput(Model):
    """An input that may be picked: a row of ``trade.yaml``, of the paths of a scenario.

    Attributes
    ----------
    path, together : pattern of what it moves, and whether all that is of the pattern moves as one
    group, name, unit, column : where it stands, what it is called, also in a table
    low, high, spacing : range of its axis and slider, and how they run
    now : value in the scenario, NaN where it states none
    paths : what it moves, by the first of which it is picked;  slider : whether the page has one for it
    """

    path: str
    name: str
    column: str = ""
    unit: str = "1"
    low: float
    high: float
    spacing: Literal["linear", "log"] = "linear"
    slider: bool = False
    together: bool = False
    now: float = Field(math.nan, allow_inf_nan=True)
    group: str = ""
    paths: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Path that it is selected by."""
        return self.paths[0]

    @property
    def title(self) -> str:
        """Name with unit."""
        return self.name + (f" [{self.unit}]" if self.unit != "1" else "")

    def with_unit(self, value: float) -> str:
        """A value with the unit of the input."""
        return f"{value:.4g}" + (f" {self.unit}" if self.unit != "1" else "")

    def limits(self, low: float | None, high: float | None) -> tuple[float, float]:
        """Ends of an axis where they are stated, else about the value in the scenario."""
        near = self.spacing == "log" and 0.0 < self.now < math.inf
        first, last = (max(self.low, self.now / 10), min(self.high, self.now * 10)) if near else (self.low, self.high)
        return first if low is None else low, last if high is None else high


class Setup(NamedTuple):
    """A scenario read for a trade: its world, what was set in it, and what it has to pick from.

    Attributes
    ----------
    inputs : by their keys
    surfaces : classes and panels, where there is light
    why : why its atmosphere is not that of the emulator
    """

    scenario: Scenario
    world: World
    settings: Mapping[str, Any]
    inputs: Mapping[str, TradeInput]
    targets: tuple[str, ...]
    surfaces: tuple[str, ...]
    backgrounds: tuple[str, ...]
    sensors: tuple[str, ...]
    has_fixed_fill: bool
    why: str


@lru_cache(maxsize=16)
def _prepare(source: str, detector: str, side_m: float | None, population: str, kept: tuple[Any, ...]) -> Setup:
    scenario, settings, why = load_scenario(source), dict[str, Any](), ""
    files = {path.name: path for path, _ in kept if path.name != scenario.sensor}  # whose own lies beside it
    origins = Origins(resolve=lambda name: files.get(name) or resolve(name, scenario.folder))
    linear = [d for d in scenario.processing.detectors if d in LINEAR_DETECTORS]
    if scenario.scene.targets:
        settings["processing.detectors"] = [detector or (linear[0] if linear else "cem")]
    # Population of a fixed fill -> path of the fill, and the fill.
    paths = [path for path in numbers_of(scenario) if path.endswith(".fill.fixed")]
    fixed = {path_parts(p)[-3]: (p.removesuffix(".fixed"), float(setting(scenario, p))) for p in paths}
    if side_m is not None and fixed:
        path, fill = fixed.get(population) or next(iter(fixed.values()))
        geometry = {"side_m": side_m, "gsd_m": side_m / math.sqrt(max(fill, 1e-4)), "heading_deg": "random"}
        settings[path] = {"geometry": geometry}
    emulated = settings | ({} if scenario.atmosphere is None else {"atmosphere.engine": "emulator"})
    try:
        world = read_world(with_settings(scenario, emulated), origins)
        if scenario.atmosphere is not None:
            world.stated.atmosphere.run({})
        settings = emulated
    except UsageError as error:
        why, world = error.what, read_world(with_settings(scenario, settings), origins)
    scene = scenario.scene
    return Setup(
        world.stated.scenario, world, settings,
        {offer.key: offer for offer in _trade_inputs(world) if not (why and offer.key.startswith("atmosphere."))},
        targets=tuple(p.name for t in scene.targets for p in t.populations),
        surfaces=tuple(s.name for s in (*scene.classes, *scene.panels)) if scenario.atmosphere else (),
        backgrounds=tuple(c.name for c in scene.classes),
        sensors=tuple(dict.fromkeys((scenario.sensor, *library_names(), *files))) if scenario.sensor else (),
        has_fixed_fill=bool(fixed), why=why,
    )  # fmt: skip


def prepare(source: str, trade: Trade) -> Setup:
    """A scenario by name or file, read once for what is asked of it."""
    kept = tuple((path, path.stat().st_mtime_ns) for path in trade.kept)
    return _prepare(source, trade.detector, trade.side_m, trade.subject[0] if trade.subject else "", kept)


def _trade_inputs(world: World) -> Iterator[TradeInput]:
    known_paths, state = all_paths(world), world.stated.scenario.atmosphere
    for row in (TradeInput(group=group, **row) for group, rows in OFFERED["inputs"].items() for row in rows):
        paths = [path for path in known_paths if matches_path(row.path, path)]
        if not paths and "now" in row.model_fields_set and (state is not None or row.path == plan.PFA):
            paths = [row.path]
        for members in [tuple(paths)] if row.together and paths else [(path,) for path in paths]:
            low, high, value = row.low, row.high, row.now
            with suppress(UsageError, TypeError):  # what holds where it states nothing stands in the row
                value = float(np.ravel(value_at(world, members[0]))[0])
            if row.path == "atmosphere.sensor_altitude_km" and state is not None:
                low = max(low, state.ground_altitude_km + 0.5)
            if math.isfinite(value):
                low, high = min(low, value), max(high, value)
            item = next((part for part in reversed(path_parts(members[0])) if f"[{part}]" in members[0]), "")
            stated = {"name": row.name.replace("*", item), "column": row.column or row.path.rpartition(".")[2]}
            yield row.model_copy(update={**stated, "low": low, "high": high, "now": value, "paths": members})


def complete(trade: Trade, p: Setup) -> Trade:
    """The trade with every field that was left open filled in.

    >>> complete(Trade(moved={"atmosphere.meteorological_range_km": 5.0}), prepare("yellow-planks-asphalt", Trade()))
    Traceback (most recent call last):
    hyperval.errors.UsageError: at:atmosphere.meteorological_range_km: 5 km is beyond the emulator of the atmosphere
      expected: 7.716 km or more
    >>> complete(Trade(x="atmosphere.solar_zenith_deg", x_from=-95.0), prepare("panels", Trade()))
    Traceback (most recent call last):
    hyperval.errors.UsageError: x_from: -95 deg: atmosphere.solar_zenith_deg at -95.0
      expected: a number from -85 to 84.9
    >>> at = {"time_utc": "2012-09-20T16:00:00Z", "latitude_deg": 43.0, "longitude_deg": -77.7}
    >>> at |= dict.fromkeys(("solar_zenith_deg", "solar_azimuth_deg", "day_of_year"))
    >>> lit = load_scenario("panels").with_values({f"atmosphere.{key}": value for key, value in at.items()})
    >>> world = plan.read_world(lit)
    >>> angles = {"atmosphere.solar_zenith_deg": 35.0, "atmosphere.view_zenith_deg": -5.0}  # past nadir
    >>> plan.check_changes(world, {**angles, "sensor.gain": np.int64(1)})  # place and time give way

    Raises
    ------
    UsageError : something that the scenario does not have; ``where`` names the field.
    """
    trade = trade if p.targets else trade.model_copy(update={"output": trade.output if trade.is_spectral else "snr"})
    among = p.surfaces if trade.is_spectral else p.targets
    subject = [name for name in trade.subject if name in among] or list(among[:1])
    refuse(not subject, "trade.subject", "output")
    x = trade.x or _initial_input(p, "" if trade.is_spectral else f"[{subject[0]}]")
    for field, names, valid in (
        ("x", [x], p.inputs), ("y", [trade.y], ("", *p.inputs)), ("subject", trade.subject, p.targets + p.surfaces),
        ("sensor", trade.sensor, p.sensors), ("background", trade.background, p.backgrounds),
        ("detector", [trade.detector], ("", *LINEAR_DETECTORS)),
        ("moved", trade.moved, [key for key in p.inputs if is_in_file(key)]),  # which the study can set
    ):  # fmt: skip
        wrong = [name for name in names if name not in valid]
        refuse(wrong, "trade.unknown", field, wrong=wrong, known=", ".join(filter(None, valid)))
    refuse(trade.y == x, "trade.same", "y")
    refuse(not trade.from_nm < trade.to_nm, "trade.bands", "to_nm", to_nm=trade.to_nm, from_nm=trade.from_nm)
    filled: dict[str, Any] = {"x": x, "subject": subject}
    for field, key in (("x", x), ("y", trade.y)):
        if key:
            low, high = p.inputs[key].limits(getattr(trade, f"{field}_from"), getattr(trade, f"{field}_to"))
            refuse(not low < high, "trade.ends", f"{field}_to", high=high, low=low)
            refuse(p.inputs[key].spacing == "log" and low <= 0.0, "trade.log", f"{field}_from")
            filled |= {f"{field}_from": low, f"{field}_to": high}
            for where, end in ((f"{field}_from", low), (f"{field}_to", high)):
                _check(p, where, key, end)
    state = {key.partition(".")[2]: value for key, value in trade.moved.items() if key.startswith("atmosphere.")}
    for key, value in trade.moved.items():
        _check(p, f"at:{key}", key, value, bool(state) and _is_emulated(p, state))
    lines = len(subject) * max(len(trade.background), 1) * max(len(trade.sensor), 1)
    refuse(lines > _MAX_LINES, "trade.curves", "subject", lines=lines, most=_MAX_LINES)
    return trade.model_copy(update=filled)


def _check(p: Setup, where: str, key: str, value: float, is_emulated: bool = False) -> None:
    """Refuse a value that the scenario does not take, or at which the atmosphere is not emulated, in its own unit.

    ``is_emulated`` : whether the state of all moved values, which is asked for anyway, is known to be
    """
    offer, inside, outside, name = p.inputs[key], p.inputs[key].now, value, key.partition(".")[2]
    try:
        plan.check_changes(p.world, dict.fromkeys(offer.paths, value))
    except UsageError as error:
        raise UsageError(
            f"{offer.with_unit(value)}: {error.what.rpartition(': ')[2]}", where=where, expected=error.expected
        ) from error
    if key.startswith("atmosphere.") and not (is_emulated or _is_emulated(p, {name: value})):
        while abs(outside - inside) > 1e-6 * max(abs(inside), abs(value)):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if _is_emulated(p, {name: middle}) else (inside, middle)
        near = (inside, 1.0005 * inside, 0.9995 * inside)  # rounded, it is to be taken
        end = next((v for v in near if _is_emulated(p, {name: float(f"{v:.4g}")})), inside)
        limit = f"{offer.with_unit(end)} or {'more' if value < inside else 'less'}"
        raise refusal("trade.emulated", where, value=offer.with_unit(value), limit=limit)


def _is_emulated(p: Setup, state: Mapping[str, float]) -> bool:
    with suppress(UsageError):
        return bool(p.world.stated.atmosphere.run(state))
    return False


def _initial_input(p: Setup, target: str) -> str:
    """The initial input: the first slider; of a target its own fill or GSD."""
    sliders = [offer for offer in p.inputs.values() if offer.slider]
    of_target = [o for o in sliders if target and any(target in path for path in o.paths)]
    return next((o.key for o in (*of_target, *sliders) if o in of_target or o.group != "Target"), "")


def selected_moves(offer: TradeInput, trade: Trade) -> list[Move]:
    """What an input moves: of several targets together, those that are asked for."""
    asked = tuple(path for path in offer.paths if any(f"[{name}]" in path for name in trade.subject))
    return [Move(path=path) for path in (asked if len(offer.paths) > 1 and asked else offer.paths)]


def trade_outputs(trade: Trade) -> list[Output]:
    """The output of each subject."""
    label = KINDS[trade.output]
    asked: dict[str, Any] = {"kind": trade.output}
    if trade.output == "pd" and plan.PFA not in (trade.x, trade.y):
        asked["pfa"] = trade.pfa
        label += f" at P_FA {trade.pfa:g}"
    if trade.is_spectral:
        asked["range_nm"] = trade.from_nm, trade.to_nm
        label += f", mean of {trade.from_nm:g} to {trade.to_nm:g} nm"
    names = [trade.output if len(trade.subject) == 1 else f"{trade.output}-{i + 1}" for i in range(len(trade.subject))]
    both = zip(names, trade.subject, strict=True)
    return [Output(name=name, subject=subject, label=f"{label}, {subject}", **asked) for name, subject in both]


def trade_study(p: Setup, trade: Trade, scenario: str, *, exact: bool = False) -> StudyFile:
    """The study of the same question: its table holds the numbers of the page.

    Parameters
    ----------
    scenario : its name, or the file that lies beside the study
    exact : under the engine that the scenario names in place of the emulator

    Examples
    --------
    >>> p = prepare("yellow-planks-asphalt", Trade())
    >>> every = [trade_study(p, complete(Trade(x=key, wanted=0.5), p), "yellow-planks-asphalt") for key in p.inputs]
    >>> all(study.required[0].entries == study.inputs[-1].entries for study in every)
    True
    >>> [i.grid.stop for study in every for i in study.inputs if i.name == "tail_dof"]
    [100.0, 100.0, 100.0]
    """
    axes = [_axis_input(p, trade, field) for field in ("y", "x") if getattr(trade, field)]
    overlays = _overlays(p, trade)
    settings = {path: value for path, value in p.settings.items() if not (exact and path == "atmosphere.engine")}
    settings |= plan.file_entries(p.scenario, _slider_values(p, trade))
    of_sky = sum(key.startswith("atmosphere.") for key in (trade.x, trade.y))
    atmosphere: dict[str, Any] = {"above": 1, "nodes": 7 if of_sky < 2 else 5} if exact else {"above": 400}
    outputs, asked = trade_outputs(trade), _required_inputs(p, trade)
    more: dict[str, Any] = {"kind": "heat", "y": axes[0].name} if trade.y else {"kind": "lines"}
    more |= {"family": overlays[0].name} if overlays and not trade.y else {}
    inputs, scale = [*overlays, *axes], p.inputs[trade.x].spacing
    data = {
        "schema": 1, "name": "trade", "title": f"{KINDS[trade.output]} against {' and '.join(i.label for i in axes)}",
        "scenario": scenario, "settings": settings, "inputs": inputs, "outputs": outputs,
        "plots": [Plot(x=axes[-1].name, output=o.name, scale=scale, **more) for o in outputs],
    }  # fmt: skip
    data |= ({"atmosphere": atmosphere} if of_sky else {}) | ({"required": asked} if asked else {})
    return StudyFile.model_validate(data)


def _axis_input(p: Setup, trade: Trade, field: str) -> Input:
    """The input along an axis, over the values at which a curve or map is drawn."""
    offer = p.inputs[getattr(trade, field)]
    grid = Grid(
        start=getattr(trade, f"{field}_from"), stop=getattr(trade, f"{field}_to"),
        count=MAP_POINTS if trade.y else POINTS, spacing=offer.spacing,
    )  # fmt: skip
    moves = selected_moves(offer, trade)
    where: dict[str, Any] = {"path": moves[0].path} if len(moves) == 1 else {"moves": moves}
    return Input(name=offer.column + "-y" * (field == "y"), label=offer.name, unit=offer.unit, grid=grid, **where)


def _overlays(p: Setup, trade: Trade) -> list[Input]:
    """Inputs whose values are curves over each other: backgrounds of the targets, and sensors."""
    out = []
    if trade.background and not trade.is_spectral:
        targets = [t.name for t in p.scenario.scene.targets if {q.name for q in t.populations} & set(trade.subject)]
        moves = [{"path": f"scene.targets.[{name}].host"} for name in targets]
        out.append(Input.model_validate({"name": "background", "moves": moves, "values": trade.background}))
    if trade.sensor:
        out.append(Input.model_validate({"name": "sensor", "path": "sensor", "values": trade.sensor}))
    return out


def _slider_values(p: Setup, trade: Trade) -> dict[str, float]:
    """Path -> value of what sliders moved and no axis moves."""
    keys = [key for key in trade.moved if key not in (trade.x, trade.y, plan.PFA)]
    return {move.path: trade.moved[key] for key in keys for move in selected_moves(p.inputs[key], trade)}


def _world(p: Setup, trade: Trade) -> World:
    """The world where sliders stand that no axis moves."""
    return with_values(p.world, {path: [value] for path, value in _slider_values(p, trade).items()})


def _families(p: Setup, trade: Trade) -> tuple[dict[str, Any], list[str]]:
    """Columns of overlaid backgrounds and sensors, a row for each family, and the names of its curves.

    Curves run by family and subject, subjects within.
    """
    inputs = _overlays(p, trade)
    rows = list(product(*(i.values or [] for i in inputs)))
    columns = plan.path_values(inputs, {i.name: as_column([row[k] for row in rows]) for k, i in enumerate(inputs)})
    names = [", ".join(str(row[k]) for k, i in enumerate(inputs) if len(i.values or []) > 1) for row in rows]
    several = len(trade.subject) > 1
    labels = [", ".join(filter(None, (s if several or not n else "", n))) for n in names for s in trade.subject]
    return columns or {"line.offset": np.zeros(1)}, labels


def _evaluated_mask(trade: Trade, stride: int) -> Mask:
    """Mask (n,) of the points, or flattened (y, x), that are evaluated at a stride."""
    coarse = np.arange(MAP_POINTS if trade.y else POINTS) % stride == 0
    return np.outer(coarse, coarse).ravel() if trade.y else coarse


class Progress(NamedTuple):
    """What stands after some pieces.

    Attributes
    ----------
    values : (F, K, O) of families, points and subjects, NaN where not yet
    limits : (F, K, O, 2) 95 % limits where the model gives them
    needed : the value of x that each curve needs for the wanted output, NaN without, and in words; once looked for
    figure : what is to be drawn;  todo : pieces that are still to come
    remarks : what is to be said of points, such as what saturates there, by their number
    """

    values: Array
    limits: Array
    needed: tuple[tuple[float, str], ...]
    figure: str
    todo: int
    remarks: Mapping[int, str] = {}

    @property
    def messages(self) -> list[str]:
        """What each curve needs, and what is to be said of points: of the one of which there is most to say.

        >>> remarks = {1: "no", 2: "no, nor here"}
        >>> Progress(np.zeros((1, 3, 1)), np.zeros(0), ((0.2, "x = 0.2"),), "", 0, remarks).messages
        ['x = 0.2', 'no, nor here (2 of 3 points, this one the most)']
        """
        points = f" ({len(self.remarks)} of {self.values[..., 0].size} points, this one the most)"
        most = max(self.remarks.values(), key=len, default="")
        return [*(words for _, words in self.needed), *([most + points] if most else [])]


def next_piece(source: str, trade: Trade, before: Progress | None = None) -> Progress:
    """The next piece: points twice as dense as before, what is required with the last of them; limits of a family."""
    p = prepare(source, trade)
    study, (columns, labels) = trade_study(p, trade, source), _families(p, trade)
    families, subjects, along = len(labels) // len(trade.subject), len(trade.subject), study.inputs[-1]
    steps: list[tuple[str, int]] = [("points", stride) for stride in _STRIDES]
    steps += [("limits", i) for i in range(families) if not trade.y and trade.output != "auc"]
    blank = np.full((families, _evaluated_mask(trade, 1).size, subjects), np.nan)
    before = before or Progress(blank, np.stack([blank, blank], axis=-1), (), "", len(steps))
    values, limits, needed, remarks = before.values.copy(), before.limits.copy(), before.needed, {**before.remarks}
    what, step = steps[-before.todo]
    if what == "points":
        new = _evaluated_mask(trade, step) & ~(_evaluated_mask(trade, 2 * step) if before.figure else np.False_)
        rows = np.flatnonzero(np.tile(new, families))
        part = {path: column[rows] for path, column in plan.path_values(study.inputs, plan.input_values(study)).items()}
        values.reshape(-1, subjects)[rows], notes = plan.output_values(_world(p, trade), part, study.outputs)
        remarks |= {int(rows[i]): words for i, words in notes.items()}
        needed = _solutions(p, trade, study) if trade.wanted is not None and step == _STRIDES[-1] else ()
    else:
        limits[step] = _limits(p, trade, along, {path: column[step] for path, column in columns.items()}, values[step])
    stride = step if what == "points" else _STRIDES[-1]
    drawn = _map(p, trade, study, values, stride) if trade.y else _curves(p, trade, along, values, limits, labels)
    return Progress(values, limits, needed, figure_json(drawn), before.todo - 1, remarks)


def _required_inputs(p: Setup, trade: Trade) -> list[Required]:
    """At which value of x each output comes to what is wanted, where that is asked; y stands where its slider does.

    >>> p, asphalt = prepare("yellow-planks-asphalt", Trade()), "surfaces.[asphalt]."
    >>> asked = (complete(Trade(y=asphalt + name, wanted=0.5), p) for name in ("spread", "tail_dof"))
    >>> [[move.offset for move in _required_inputs(p, trade)[0].entries[1:]] for trade in asked]  # no tail is no number
    [[1.0], []]
    """
    offer, moves = p.inputs[trade.x], selected_moves(p.inputs[trade.x], trade)
    if trade.y and math.isfinite(now := _current_value(p, trade, trade.y)):
        moves += [Move(path=move.path, factor=0.0, offset=now) for move in selected_moves(p.inputs[trade.y], trade)]
    return [
        Required(
            name=f"required-{o.name}", label=f"{offer.name} for {o.label} = {trade.wanted:g}", unit=offer.unit,
            between=(trade.x_from or 0.0, trade.x_to or 1.0), scan=_SCAN, output=o.name,
            spacing=offer.spacing, equals=trade.wanted, moves=moves,
        ) for o in trade_outputs(trade) if trade.wanted is not None
    ]  # fmt: skip


def _solutions(p: Setup, trade: Trade, study: StudyFile) -> tuple[tuple[float, str], ...]:
    """The value of x at which the output of each curve comes to what is wanted, and in words.

    >>> trade = complete(Trade(wanted=2.0), p := prepare("yellow-planks-asphalt", Trade()))
    >>> _solutions(p, trade, trade_study(p, trade, ""))[0][1]
    'not reached in this range: probability of detection P_D stays below 2; the nearest is 1 at 0.2'
    """
    columns, labels = _families(p, trade)
    values_of = partial(plan.output_values, _world(p, trade))
    found = [(q, plan.required_values(values_of, columns, q, study.outputs)) for q in study.required]
    needed, offer = list[tuple[float, str]](), p.inputs[trade.x]
    for label, (i, (q, answer)) in zip(labels, product(range(len(labels) // len(found)), found), strict=True):
        value, why = float(answer.solutions[i]), answer.reasons.get(i, "").replace(q.output, KINDS[trade.output])
        why = why.replace("no solution", "not reached in this range")
        words = f"{offer.name} = {offer.with_unit(value)} for {KINDS[trade.output]} = {trade.wanted:g}"
        words = f"{words} ({why})" if why and math.isfinite(value) else why or words
        if trade.y and math.isfinite(now := _current_value(p, trade, trade.y)):
            words += f"; along {offer.name} alone, {p.inputs[trade.y].name} at {p.inputs[trade.y].with_unit(now)}"
        needed.append((value, f"{label}: {words}" if len(labels) > 1 else words))
    return tuple(needed)


def _truth_limits(p: Setup, trade: Trade, truth: Mapping[str, Any], pfa: Array) -> Array:
    """(subjects, n, 2) 95 % limits in one truth, NaN where they are no interval.

    Of P_D at P_FA (n,); of a spectrum's mean over its bands, where n is 1.
    """
    truth = {**_slider_values(p, trade), **truth}
    products = predict(p.scenario, p.world.stated.origins, truth=truth, object_curves=False)
    out = np.full((len(trade.subject), pfa.size, 2), np.nan)
    for k, o in enumerate(trade_outputs(trade)):
        if trade.is_spectral:
            spectrum, bands = getattr(products, trade.output)[o.subject], plan.output_bands(o, products.axis)
            sd = math.sqrt(max(float(spectrum.error_covariance[np.ix_(bands, bands)].mean()), 0.0))
            if sd > 0.0:
                out[k] = float(spectrum.mean[bands].mean()) + np.array([-Z95, Z95]) * sd
        else:
            curve = products.roc[o.subject, p.scenario.processing.detectors[0], "pixel"]
            if curve.has_limits:
                out[k] = np.stack([detection_at(curve, pfa, y) for y in (curve.pd_lower, curve.pd_upper)], axis=1)
    return out


def _limits(p: Setup, trade: Trade, along: Input, family: Mapping[str, Any], values: Array) -> Array:
    """(K, O, 2) limits of values (K, O) along x, predicted at some of them and between them as the curve runs."""
    _, x = _axis(along)
    if trade.x == plan.PFA:
        return np.moveaxis(_truth_limits(p, trade, family, x), 0, 1)
    nodes, top = np.linspace(0, x.size - 1, _LIMITS_AT).round().astype(int), np.inf if trade.is_spectral else 1.0
    ends = np.full((nodes.size, len(trade.subject) * 2), np.nan)  # from the values
    for i, k in enumerate(nodes):
        truth = {**family, **{move.path: float(x[k]) for move in along.entries}}
        with suppress(UsageError):  # that the value is not taken is seen in the curve
            ends[i] = (_truth_limits(p, trade, truth, np.array([trade.pfa]))[:, 0] - values[k][:, None]).ravel()
            if np.isnan(ends[i]).all():
                break
    limits = np.stack([np.interp(np.arange(x.size), nodes, column) for column in ends.T], axis=1)
    return np.asarray(np.clip(values[..., None] + limits.reshape(x.size, -1, 2), 0.0, top))


def _axis(along: Input) -> tuple[Axis, Array]:
    """An axis, and the values along it."""
    assert along.grid is not None  # noqa: S101 - an axis has one
    ends = along.grid.start, along.grid.stop
    return Axis(along.title, along.grid.spacing, ends=ends), np.asarray(along.listed_values, float)


def _current_value(p: Setup, trade: Trade, key: str) -> float:
    """Where an input stands; NaN where the scenario does not state it."""
    return trade.pfa if key == plan.PFA else trade.moved.get(key, p.inputs[key].now)


def _current_rule(p: Setup, trade: Trade, field: Literal["x", "y"] = "x") -> Rules:
    """A rule at the present value of an input, where it lies on its axis."""
    now = _current_value(p, trade, getattr(trade, field))
    return ((field, now),) if getattr(trade, f"{field}_from") <= now <= getattr(trade, f"{field}_to") else ()


def _y_axis(trade: Trade) -> Axis:
    unit = " [µW cm⁻² sr⁻¹ nm⁻¹]" if trade.output == "radiance" else ""
    return Axis(KINDS[trade.output] + unit, ends=None if trade.is_spectral else (-0.03, 1.03))


def _line_marks(labels: Sequence[str], lines: Sequence[tuple[Array, Array]], bands: Array) -> tuple[Mark, ...]:
    """Curves (x, y) with their limits (K, 2) where there are some; beyond six colours another dash."""
    marks = []
    for k, (label, (x, y)) in enumerate(zip(labels, lines, strict=True)):
        valid = np.isfinite(y)
        columns = {"x": x[valid], "y": y[valid]}
        if np.isfinite(bands[k]).any():
            columns |= {"low": bands[k][valid, 0], "high": bands[k][valid, 1]}
        colour = PREDICTED if len(labels) == 1 else CURVES[k % 6]
        marks.append(Mark("line", columns, label, colour, "dashed" if k // 6 else "solid"))
    return tuple(marks)


def _curves(p: Setup, trade: Trade, along: Input, values: Array, limits: Array, labels: Sequence[str]) -> Figure:
    axis, x = _axis(along)
    lines = [(x, line) for line in np.moveaxis(values, 1, 2).reshape(-1, x.size)]
    marks = _line_marks(labels, lines, np.moveaxis(limits, 1, 2).reshape(-1, x.size, 2))
    rules = _current_rule(p, trade) + ((("y", trade.wanted),) if trade.wanted is not None else ())
    view = Panels(axis, (Part(_y_axis(trade), marks, rules),))
    return Figure("trade", "study", f"{KINDS[trade.output]} against {axis.label}", (view,))


def _map(p: Setup, trade: Trade, study: StudyFile, values: Array, stride: int) -> Figure:
    """The map of the first curve, which stands above it.

    >>> asked = {"y": "atmosphere.solar_zenith_deg", "sensor": ["prospectir-vs", "emit"]}
    >>> trade = complete(Trade(**asked), prepare("yellow-planks-asphalt", Trade()))
    >>> json.loads(next_piece("yellow-planks-asphalt", trade).figure)["views"][0]["note"]
    'yellow plank 0.02, prospectir-vs'
    """
    (x_axis, x), (y_axis, y) = map(_axis, study.inputs[:-3:-1])
    grid = values[0, :, 0].reshape(MAP_POINTS, MAP_POINTS)[::stride, ::stride]
    edges = [cell_edges(v[::stride], axis.scale == "log") for axis, v in ((x_axis, x), (y_axis, y))]
    rows, columns = np.nonzero(np.isfinite(grid))
    mark = heat_mark(edges, (columns, rows), grid[rows, columns], KINDS[trade.output])
    part = Part(y_axis, (mark,), _current_rule(p, trade) + _current_rule(p, trade, "y"))
    note = ", ".join(dict.fromkeys((trade.subject[0], *_families(p, trade)[1][0].split(", "))))
    title = f"{KINDS[trade.output]}, {note}"
    return Figure("trade", "study", title, (Panels(x_axis, (part,), note=note),), legend_title=title)


def live_figure(source: str, trade: Trade, with_limits: bool = False) -> dict[str, Any]:
    """Where the sliders stand, the ROC of every curve, or the spectrum of a spectral output.

    Returns
    -------
    ``figure`` of them; ``values``, the output of each curve by its name; ``error``: of the atmosphere; what saturates

    Examples
    --------
    >>> bright = Trade(output="snr", moved={"sensor_changes.signal_factor": 2.0})
    >>> live_figure("panels", complete(bright, prepare("panels", Trade())))["error"].partition("SATURATION: ")[2]
    'full scale is passed by grass, white panel, grey panel 48.'
    >>> dark = Trade(output="snr", from_nm=2600.0, to_nm=2700.0)  # no curve is left to draw
    >>> live_figure("panels", complete(dark, prepare("panels", Trade())))
    Traceback (most recent call last):
    hyperval.errors.UsageError: output 'snr': no usable band from 2600 to 2700 nm
    """
    p = prepare(source, trade)
    trade = trade.model_copy(update={"x": "", "y": ""})
    (columns, labels), outputs, world = _families(p, trade), trade_outputs(trade), _world(p, trade)
    lines, values = [(np.empty(0), np.empty(0))] * len(labels), [math.nan] * len(labels)
    bands, remarks, several = np.full((len(labels), _ROC.size, 2), np.nan), {_accuracy(p, trade): None}, len(outputs)
    for first in range(0, len(labels), several):  # families one by one: where one has no curves, others have
        truth = {path: column[first // several] for path, column in columns.items()}
        try:
            ((_, e),) = evaluations(with_truths(world, [truth]))
            for k, o in enumerate(outputs, first):
                values[k] = float(plan.evaluate_output(e, o, None)[0])
                if trade.is_spectral:
                    lines[k] = e.axis.centre_nm, (e.snr if trade.output == "snr" else e.radiance)(o.subject)[0]
                else:
                    lines[k] = _ROC, e.scores(o.subject, p.scenario.processing.detectors[0]).detection(_ROC[None, :])[0]
            if with_limits and not trade.is_spectral:
                bands[first : first + several] = _truth_limits(p, trade, truth, _ROC)
            problems = plan.saturation(e) | e.problems
        except UsageError as error:
            if len(labels) == several:
                raise
            problems = {0: error}
        names = f"{' and '.join(labels[first : first + several])}: " if len(labels) > several else ""
        remarks |= dict.fromkeys(f"{names}{' '.join(str(words).split())}." for words in problems.values())
    marks = _line_marks(labels, lines, bands)
    named = tuple((label, v if math.isfinite(v) else None) for label, v in zip(labels, values, strict=True))
    x, y, rules = Axis(WAVELENGTH), _y_axis(trade), Rules()
    if not trade.is_spectral:
        x, y = Axis("probability of false alarm P_FA", "log", ends=(1e-6, 1.0)), Axis("P_D", ends=(-0.03, 1.03))
        rules = (("x", trade.pfa),)
    figure = Figure("live", "roc", "", (Panels(x, (Part(y, marks, rules),)),))
    return {"figure": figure_json(figure), "values": named, "error": " ".join(remarks)}


def _accuracy(p: Setup, trade: Trade) -> str:
    """How far the emulated atmosphere may be from that of the engine, in words."""
    if p.scenario.atmosphere is None:
        return "The scenario has no atmosphere."
    if p.why:
        return f"The atmosphere is that of the engine, and fixed: {p.why}."
    sky = {k.partition(".")[2]: v for k, v in _slider_values(p, trade).items() if k.startswith("atmosphere.")}
    terms = p.world.stated.atmosphere.run(sky)
    if terms.path_uncertainty is None:
        return ""
    part = 100.0 * terms.path_uncertainty / mean_radiance(terms, plan.GROUND, plan.GROUND)
    part = part[terms.gas_transmittance > plan.MIN_GAS]
    return (
        f"Atmosphere: emulator of 6S, standard error {np.median(part):.2g} % of the radiance over ground of "
        f"{plan.GROUND:g} in the median band, {part.max():.2g} % in the worst."
    )


def notebook(files: Mapping[str, str]) -> str:
    """A notebook that writes a study and what lies beside it, by name, and runs it by the API."""
    text = resources.files("hyperval.study").joinpath("trade.ipynb").read_text("utf-8")
    return text.rstrip().replace("FILES = {}", json.dumps(f"FILES = {dict(files)!r}")[1:-1])

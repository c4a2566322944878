"""U truths of one scenario as arrays, and the one table of what can be moved in them.

:func:`read_world` makes the world that a scenario states (U = 1); :func:`with_values` is the only way anything in it is
moved.  The scenario is what is believed: filters look for the spectra it names, products are labelled by its bands.
What is moved is what is there to be seen.

An array has U rows, or one where all truths share it, so that what nothing moves is computed once.  What several paths
move (:data:`PATHS`) composes: factors multiply, what is added adds up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.data import Array, Index
from hyperval.errors import UsageError, nearest, package_table, refuse
from hyperval.model.fill import (
    FillDistribution,
    fill_distribution,
    fill_with_mean,
    fills_of_population,
    pixels_of_object,
    stacked_fills,
    whole_object_fills,
)
from hyperval.model.stated import Origins, Stated, Truth, Values, distinct, plain, read_files, state_value, without_gaps
from hyperval.scenario import ElmPanels, Fill, Scenario, TargetSubject
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import SensorChanges, SensorOperation
from hyperval.settings import item_number, numbers_of, path_parts, setting, with_settings


class Path(NamedTuple):
    """Where a dotted path leads.

    Attributes
    ----------
    field : array of the world; empty: an entry of the scenario's file, after whose change it is read again
    of : what its star names: class, target or surface
    shape : of a value: a number, or a spectrum or list of numbers (vector)
    low, high : between which it can be
    name, stated : what it is called, and the entry of a scenario's ``uncertainty`` that says how far it may be off
    neutral : what stands there where nothing is moved, of a factor 1, of what is added 0; None: what the scenario says
    item, populations : of a scenario, what its star names, by number; and of fills the populations that it moves, by
        number, with the part of its values that is of each

    Limits that the state of the atmosphere has are the same here:

    >>> from hyperval.atmosphere.state import LONGEST_KM, MAX_SOLAR_ZENITH_DEG, SHORTEST_KM
    >>> haze, sun = (PATHS[f"atmosphere.{key}"] for key in ("meteorological_range_km", "solar_zenith_deg"))
    >>> (haze.low, haze.high) == (SHORTEST_KM, LONGEST_KM), sun.low == -MAX_SOLAR_ZENITH_DEG
    (True, True)
    """

    field: str
    of: str = ""
    unit: str = "1"
    shape: str = "number"
    low: float = -np.inf
    high: float = np.inf
    name: str = ""
    stated: str = ""
    neutral: float | None = None
    item: int = 0
    populations: Mapping[int, slice] = {}


PATHS: Mapping[str, Path] = {pattern: Path(**row) for pattern, row in package_table("model/paths.yaml").items()}
SHIFT, WIDTH = "sensor.wavelength_shift_nm", "sensor.band_width"
# One number for all bands, or one for each, as it is where nothing is moved.
NEUTRAL = {entry.field: float(entry.neutral) for entry in PATHS.values() if entry.neutral is not None}
NOT_WITHOUT_LIGHT = ("light.*", "sensor.noise", "sensor.electrons", "sensor.fixed_noise", "atmosphere.*")
_OF_SENSOR = ("sensor_operation", "sensor_changes")
# What leaves light, sensor and classes alone, and with them the filters.
_OF_TARGETS = ("tail", "fill", "fill entry", "blur", "target_gain", "beam", "sky_view", "fine_texture")


def fits(pattern: str, path: str) -> bool:
    """Whether a path is of a pattern of :data:`PATHS`."""
    of, parts = pattern.split("."), path_parts(path)
    if of[-1] == "**":
        of, parts = of[:-1], parts[: len(of) - 1]
    return len(of) == len(parts) and all(a in ("*", b) for a, b in zip(of, parts, strict=True))


def in_file(path: str) -> bool:
    """Whether a path is an entry of the scenario's file; others lead to an array of the world alone."""
    root = next(p for p in PATHS if fits(p, path)).partition(".")[0]
    return root in ("atmosphere", "sensor_changes", "sensor_operation", "scene", "**")


def column_of(values: Sequence[Any]) -> Values:
    """Values as a column: numbers as floats, anything else as objects."""
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return np.array(values, dtype=float)
    items = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):  # one by one: lists of one length are not rows of a matrix
        items[i] = value
    return items


def _numbers(values: Values) -> Array:
    """A column of numbers, NaN where an entry is as stated."""
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def find(stated: Stated, path: str) -> Path:
    """Where a path of a scenario leads, to which of its items.

    Raises
    ------
    UsageError : to something that the scenario does not have.

    Examples
    --------
    >>> from hyperval.scenario import load_scenario
    >>> from hyperval.settings import with_settings
    >>> unlit = with_settings(load_scenario("yellow-planks-asphalt"), {"atmosphere": None, "processing.elm": "none"})
    >>> find(read_world(unlit).stated, "sensor.fixed_noise")
    Traceback (most recent call last):
    hyperval.errors.UsageError: sensor.fixed_noise: the scenario has no atmosphere
    """
    return stated.once(("path", path), lambda: _found(stated, path))


def _found(stated: Stated, path: str) -> Path:
    pattern = next(p for p in PATHS if fits(p, path))
    entry, parts, scenario = PATHS[pattern], path_parts(path), stated.scenario
    again = PATHS["**"]
    if scenario.atmosphere is None:
        refuse(any(fits(p, path) for p in NOT_WITHOUT_LIGHT[:-1]), "path.light", path=path)
        if entry.field in ("atmosphere", "sensor"):
            return again
    refuse(entry.field in ("dark", "bright") and not isinstance(scenario.processing.elm, ElmPanels), "path.panels")
    if entry.field == "atmosphere":
        nodes = stated.atmosphere.nodes
        return again if parts[1] in ("engine", "table") or (nodes and parts[1] not in nodes) else entry
    if entry.field == "fill entry":
        number = item_number(stated.names["target"], parts[2], path)
        subjects = [s.name for s in stated.targets[number].subjects]
        if (parts[3] == "subjects") != bool(subjects):
            return again  # and refused there
        within = item_number(subjects, parts[4], path) if subjects else 0
        number_of = next(i for i, (t, k, _) in enumerate(stated.populations) if (t, k) == (number, within))
        return entry._replace(populations={number_of: slice(None)})
    if entry.field in ("fill", "blur"):
        moves = _moved_fills(stated, entry.field, parts[1] if len(parts) > 1 else None)
        refuse(not moves, "path.fill" if entry.field == "fill" else "path.blur", path=path)
        return entry._replace(populations=moves)
    if not entry.of:
        return entry
    name, names = parts[pattern.split(".").index("*")], stated.names[entry.of]
    if parts[0] == "scene":
        return entry._replace(item=item_number(names, name, path))
    refuse(name not in names, "path.unknown", path=path, of=entry.of, names=", ".join(names))
    refuse(entry.field == "fine_texture" and name not in stated.names["target"], "path.target", path=path, name=name)
    return entry._replace(item=names.index(name))


def _moved_fills(stated: Stated, field: str, name: str | None) -> dict[int, slice]:
    """Populations with a fill of some name or any, or those whose fill is blurred, and their part of the values."""
    out, end = {}, 0
    for i, (t, _, p) in enumerate(stated.populations):
        if field == "fill":
            size = int(name in (None, p.name, stated.targets[t].name))
        else:
            size = np.size(p.fill.geometry.psf_fwhm_pixels or 0.0) if p.fill.geometry else 0
        if size:
            out[i], end = slice(end, end + size), end + size
    return out


def value_at(world: World, path: str) -> Any:
    """What stands at a path: (U or 1, ...), or of one truth as stated.

    Raises
    ------
    UsageError : it leads nowhere, or to something that the scenario does not state.

    Examples
    --------
    What was read again with bands elsewhere has them there: an uncertainty of the shift is about that.

    >>> from hyperval.scenario import load_scenario
    >>> ((_, elsewhere),) = settled(with_values(read_world(load_scenario("panels")), {SHIFT: np.array([[2.0]])}))
    >>> value_at(elsewhere, SHIFT).ravel().tolist(), value_at(elsewhere, WIDTH).tolist()
    ([2.0], [1.0])
    """
    if path in world.moved:
        return world.moved[path]
    stated, parts = world.stated, path_parts(path)
    entry = find(stated, path)
    item, populations = entry.item, entry.populations
    if entry.field in NEUTRAL:
        return np.array([NEUTRAL[entry.field]])
    if entry.field in stated.columns:
        return stated.columns[entry.field][:, item]
    if entry.field == "mean":
        return np.nan_to_num(stated.mean[item : item + 1])
    if entry.field == "share":
        fractions = stated.columns["fraction"][0]
        refuse(fractions.size < 2 or fractions[item] >= 1.0, "uncertainty.fractions", parts=parts)
        return fractions[item : item + 1]
    if entry.field == "fill":
        return np.array([[fill_distribution(stated.populations[i][2].fill).mean for i in populations]])
    if entry.field == "blur":
        fills = (stated.populations[i][2].fill.geometry for i in populations)
        return np.concatenate([np.atleast_1d((g and g.psf_fwhm_pixels) or 0.0) for g in fills])[None].astype(float)
    if path in (SHIFT, WIDTH):
        return np.asarray(stated.shift_nm if path == SHIFT else stated.width, dtype=float)[None]
    if path.startswith("atmosphere.") and path in PATHS and stated.scenario.atmosphere:
        return np.array([state_value(stated.scenario.atmosphere, parts[1])])
    try:
        return column_of([setting(stated.scenario, path)])
    except UsageError as error:
        near = nearest(path, every_path(world))
        if error.mend or not near:
            raise
        mend = f"did you mean {near[0]}?"
        raise UsageError(error.what, where=error.where, expected=error.expected, mend=mend) from error


def check_numbers(world: World, truth: Truth) -> None:
    """Refuse what is beyond the limits of a path of the model, or is neither a number nor a list of as many as it has.

    Raises
    ------
    UsageError : the path, what was given, and what was expected.
    """
    for path, given in truth.items():
        entry, is_zenith = find(world.stated, path), path.endswith("_zenith_deg")  # which is taken beyond the zenith
        of_column = isinstance(given, Real) and entry.field and not path.startswith("atmosphere.")
        if in_file(path) and not is_zenith and not of_column:  # the file's own rules hold
            continue
        value = np.asarray(column_of(given) if isinstance(given, list | tuple) else given)
        counts = {1, *((np.size(value_at(world, path)), len(world.stated.axis)) if entry.shape == "vector" else ())}
        is_number = value.dtype.kind in "fiu" and value.ndim <= (entry.shape == "vector") and value.size in counts
        is_taken = is_number and np.all((entry.low <= value) & (value <= entry.high))
        ends = {"above" if entry.low > float(f"{entry.low:g}") else "from": entry.low, "to": entry.high}
        words = [f" {word} {end:g}" for word, end in ends.items() if np.isfinite(end)]
        words += [f", or a list of {count}" for count in sorted(counts - {1})]
        refuse(not is_taken, "study.limits", path=path, given=f"{given!r:.80}", words="".join(words))


def every_path(world: World) -> list[str]:
    """Every path of a scenario that leads to a number, or to numbers over wavelength: what can be moved."""
    stated = world.stated
    fills = [n for t in stated.targets for n in (t.name, *(p.name for p in t.populations))]
    names = {**stated.names, "fill": list(dict.fromkeys(fills))}
    out = []
    for pattern, entry in PATHS.items():
        of_file = pattern.startswith(("scene.", "sensor_")) or pattern in ("atmosphere.*", "**")
        dark = pattern.startswith("atmosphere.") and stated.scenario.atmosphere is None
        if of_file or dark:
            continue
        for name in names[entry.of or "fill"] if "*" in pattern else [""]:
            path = pattern.replace("*", f"[{name}]")
            with suppress(UsageError):  # not in this scenario
                value_at(world, path)
                out.append(path)
    return list(dict.fromkeys([*out, *numbers_of(stated.scenario)]))


Populations = tuple[tuple[str, TargetSubject], ...]  # each with the name of its target
_OF_FILLS = ("fill_models", "populations")


@dataclass(frozen=True, eq=False)
class World:
    """U truths of one scenario.

    Attributes
    ----------
    moved : path -> values (U or 1, ...) of all that was moved; what follows from them is made when it is asked for
    size : U
    """

    stated: Stated
    moved: Mapping[str, Values] = field(default_factory=dict)
    size: int = 1

    def made(self) -> World:
        """Itself, with what follows from all that was moved; what contradicts itself is refused.

        A thousand fixed fills of a study are a column, not a thousand entries of the file that are checked:

        >>> from hyperval.api import load_scenario
        >>> world = read_world(load_scenario("yellow-planks-asphalt"), Origins())
        >>> study = {"scene.targets.yellow plank.subjects.[yellow plank 0.1].fill.fixed": np.linspace(0.0, 1.0, 1000)}
        >>> "fill_models" in vars(with_values(world, study).made())
        False
        """
        for name, part in [*vars(World).items()]:  # which pickling adds to
            if isinstance(part, cached_property) and name not in _OF_FILLS:  # which fixed fills do not need
                getattr(self, name)
        return self

    def rows(self, index: Index) -> World:
        """Some of the truths."""
        if index.size == self.size and np.array_equal(index, np.arange(self.size)):
            return self
        if self.size == 1 and index.size > 1:
            return self
        return World(self.stated, {p: v[index] if len(v) > 1 else v for p, v in self.moved.items()}, index.size)

    def fields(self, *names: str) -> Iterable[tuple[str, int, Values]]:
        """Path, number of the item and values of what was moved of some fields, in the order in which it was."""
        for path, values in self.moved.items():
            entry = find(self.stated, path)
            if entry.field in names:
                yield path, entry.item, values

    def distinct(self, targets: Sequence[str] = ()) -> tuple[Index, Index]:
        """First of all truths with other light, sensor and classes, and which (U,) of these each truth has.

        ``targets`` : surfaces of targets that are told apart too, with the light on them
        """
        alone = ("tail", "fill", "fill entry", "blur", "target_gain") if targets else _OF_TARGETS
        others = set(self.stated.names["target"]) - set(targets) - set(self.stated.classes)
        columns = []
        for path, values in self.moved.items():
            entry = find(self.stated, path)
            of_other = entry.of == "surface" and self.stated.names["surface"][entry.item] in others
            if len(values) > 1 and entry.field not in alone and not of_other:
                columns.append(values)
        return distinct(columns, self.size)

    def column(self, name: str, stated: Array | None = None) -> Array:
        """(U or 1, items) of a field, or (U or 1, B or 1) where it is one for all items.

        ``stated`` (1, items) : what stands where nothing is moved; None: what the scenario says
        """
        if name in NEUTRAL:
            out = np.array([[NEUTRAL[name]]])
            for _, _, values in self.fields(name):
                new = values if values.ndim > 1 else values[:, None]
                out = out * new if NEUTRAL[name] else out + new
            return out
        out = self.stated.columns[name] if stated is None else stated
        for _, item, values in self.fields(name):
            new = _numbers(values)
            new = np.where(np.isnan(new), out[:, item], new)
            out = np.array(np.broadcast_to(out, (max(len(out), len(new)), out.shape[1])))
            out[:, item] = new
        return out

    @cached_property
    def fraction(self) -> Array:
        """(U or 1, M) f_m; where some are moved by their share, the others give way in proportion.

        Raises
        ------
        UsageError : they do not sum to 1.
        """
        stated = self.column("fraction")
        named = np.clip(self.column("share", np.full((1, stated.shape[1]), np.nan)), 0.0, 1.0)  # NaN: gives way
        moved = np.isfinite(named)
        if moved.any():
            rest, total = np.where(moved, 0.0, stated).sum(axis=1), np.nansum(named, axis=1)
            gives_way = (rest > 0.0) & (total < 1.0)
            scale = np.where(gives_way, (1.0 - total) / np.where(rest > 0.0, rest, 1.0), 1.0)
            out = np.where(moved, named, stated * scale[:, None])
            refuse(np.any(out.sum(axis=1) <= 0.0), "path.area")
            return np.asarray(np.where(moved.any(axis=1, keepdims=True), out / out.sum(axis=1, keepdims=True), stated))
        total = stated.sum(axis=1)
        wrong = np.any(np.abs(total - 1.0) > 1e-6) or np.any(stated < 0.0)
        refuse(wrong, "path.partition", low=total.min(), high=total.max())
        return stated

    @cached_property
    def law_fraction(self) -> Array:
        """(U or 1, J) area fractions of the laws that the classes are made of (3.33)."""
        laws = self.stated.laws
        return np.asarray(self.fraction[:, [law.owner for law in laws]] * [law.weight for law in laws])

    @cached_property
    def law_dof(self) -> Array:
        """(U or 1, J) degrees of freedom of the laws; infinity: Gaussian."""
        laws, tail = self.stated.laws, self.stated.columns["tail"]
        stated = [tail[0, law.owner] if law.dof is None else law.dof for law in laws]
        moved = self.column("tail", np.full(tail.shape, np.nan))[:, [law.owner for law in laws]]
        return np.where(np.isnan(moved), stated, moved)

    @cached_property
    def kappa(self) -> Array:
        """(U or 1, 1, 1) 1 / N_eff of (3.11); 1 as printed."""
        if self.stated.scenario.formulation == "thesis":
            return np.ones((1, 1, 1))
        return np.asarray(1.0 / self.column("neighbours")[:, :, None])

    @cached_property
    def _recorded(self) -> tuple[Array, Array]:
        """(U or 1, S, B or 1) gain and offset on the reflectance of surfaces, where it is what is recorded."""
        scenario, scene = self.stated.scenario, self.stated.scenario.scene
        named = (*scene.classes, *scene.panels, *scene.sites, *scene.targets)
        free = np.array([scenario.atmosphere is None and s.spectrum.measured is None for s in named])[None, :, None]
        gain, offset = self.column("gain")[:, None, :], self.column("offset")[:, None, :]
        return np.where(free, gain, 1.0), np.where(free, offset, 0.0)

    @cached_property
    def mean(self) -> Array:
        """(U or 1, S, B) mean reflectance of the surfaces."""
        out, before = self.stated.mean[None], self.stated.nominal.mean
        for _, item, values in self.fields("mean"):
            out = np.array(np.broadcast_to(out, (max(len(out), len(values)), *out.shape[1:])))
            out[:, item] += values.reshape(len(values), -1) - np.nan_to_num(before[item])
        gain, offset = self._recorded
        return out if np.all(gain == 1.0) and not np.any(offset) else gain * out + offset

    @cached_property
    def surroundings(self) -> tuple[AtmosphericTerms, Array]:
        """Terms of (3.7) at the bands, (U or 1, 1, B) each, and (U or 1, M, B) means of the classes, gaps filled."""
        moved = {p: v for p, _, v in self.fields("atmosphere")}
        means = self.mean[:, [self.surface(name) for name in self.stated.classes]]
        return self.stated.atmosphere(moved, self.size), np.apply_along_axis(without_gaps, -1, means)

    @cached_property
    def stretch(self) -> Array:
        """(U or 1, S, B or 1) factor on the departures of the surfaces from their means."""
        return np.asarray(self.column("spread")[:, :, None] * self._recorded[0])

    def surface(self, name: str) -> int:
        """Number of a surface."""
        return self.stated.names["surface"].index(name)

    def of_target(self, name: str, target: int) -> Array:
        """(U,) of a field of targets."""
        return np.broadcast_to(self.column(name)[:, target], (self.size,))

    # ---- light and sensor ----------------------------------------------------------------------------------

    @cached_property
    def sensor_noise(self) -> tuple[list[NoiseModel], Index]:
        """The different noise models (3.13)-(3.20), none without a sensor, and which (U,) of them each truth has."""
        stated = self.stated
        if stated.noise is None or stated.scenario.atmosphere is None:
            return [], np.zeros(self.size, int)
        columns = {p: np.broadcast_to(v, (self.size,)) for p, _, v in self.fields("sensor")}
        first, which = distinct(columns.values(), self.size)
        each = [{p: plain(v[u]) for p, v in columns.items() if v[u] is not None} for u in first]
        return [_noise(stated, moved) if moved else stated.noise for moved in each], which

    @cached_property
    def of_light(self) -> tuple[World, Index]:
        """The truths with other light, sensor and classes, and which (U,) of these each truth has."""
        first, which = self.distinct()
        return self.rows(first), which

    # ---- fills ---------------------------------------------------------------------------------------------

    def of_fill(self, number: int) -> dict[str, Values]:
        """Path -> values of what moves the fill of a population."""
        return {p: v for p, v in self.moved.items() if number in find(self.stated, p).populations}

    @cached_property
    def fill_models(self) -> list[tuple[list[Fill], Index]]:
        """Of each population its different fills, and which (U,) of them each truth has."""
        out = []
        for n, moved in enumerate(map(self.of_fill, range(len(self.stated.populations)))):
            first, which = distinct((np.broadcast_to(v, (self.size, *v.shape[1:])) for v in moved.values()), self.size)
            each = ({p: v[u if len(v) > 1 else 0] for p, v in moved.items()} for u in first)
            out.append(([self._fill(n, one) for one in each], which))
        return out

    def _fill(self, number: int, moved: Truth) -> Fill:
        """The fill of a population where what moves it in one truth stands at its paths."""
        fill, before = (s.populations[number][2].fill for s in (self.stated, self.stated.nominal))
        entries, change = {}, 0.0
        for path, value in moved.items():
            found, parts, each = find(self.stated, path), path_parts(path), np.atleast_1d(value)
            if found.field == "fill entry":
                if value is not None:
                    entries[".".join(parts[6 if parts[3] == "subjects" else 4 :])] = plain(value)
                continue
            widths = (each[found.populations[number]] if each.size > 1 else each).tolist()
            if found.field == "fill":
                change += widths[0] - fill_distribution(before).mean
            else:
                entries["geometry.psf_fwhm_pixels"] = widths[0] if len(widths) == 1 else widths
        of_entries = with_settings(fill, entries) if entries else fill
        return fill_with_mean(of_entries, change) if change else of_entries

    @cached_property
    def populations(self) -> tuple[list[Populations], Index]:
        """The different populations of target pixels with their fills, each with the name of its target, and which
        (U,) of these each truth has.
        """
        first, which = distinct([which for _, which in self.fill_models], self.size)
        named = [(self.stated.targets[t].name, p) for t, _, p in self.stated.populations]

        def at(u: int) -> Populations:
            fills = (models[of[u]] for models, of in self.fill_models)
            return tuple((t, p.model_copy(update={"fill": f})) for (t, p), f in zip(named, fills, strict=True))

        return [at(u) for u in first.tolist()], which

    @cached_property
    def pixel_fills(self) -> list[FillDistribution]:
        """Fills of the pixels of each population (f of 3.10) in each truth."""
        return [self.fills(number) for number in range(len(self.stated.populations))]

    def fills(self, number: int, objects: bool = False) -> FillDistribution:
        """Fills of the pixels of a population (f of 3.10) in each truth, or of the pixels of its objects.

        Raises
        ------
        UsageError : objects of different numbers of pixels.
        """
        thesis, moved = self.stated.scenario.formulation == "thesis", self.of_fill(number)
        stated = self.stated.populations[number][2].fill
        if len(moved) == 1 and next(iter(moved)).endswith("fill.fixed") and stated.fixed is not None:
            (column,) = moved.values()
            values = np.nan_to_num(_numbers(column), nan=stated.fixed)[:, None]
            refuse(not np.all((values >= 0.0) & (values <= 1.0)), "fill.range", low=values.min(), high=values.max())
            return FillDistribution(values, np.ones((1, 1)))
        make = whole_object_fills if objects else fills_of_population
        if not moved:
            return make(stated, thesis)
        models, which = self.fill_models[number]
        return stacked_fills([make(fill, thesis) for fill in models], which)


def _noise(stated: Stated, moved: Truth) -> NoiseModel:
    """The noise with other numbers of the sensor or of how it is run."""
    scenario, sensor = stated.scenario, stated.sensor
    run, changes = scenario.sensor_operation or SensorOperation(), scenario.sensor_changes or SensorChanges()
    entries = {room: {p[len(room) + 1 :]: v for p, v in moved.items() if p.startswith(room)} for room in _OF_SENSOR}
    run, changes = with_settings(run, entries[_OF_SENSOR[0]]), with_settings(changes, entries[_OF_SENSOR[1]])
    assert sensor is not None  # noqa: S101 - asked for where there is noise
    return sensor.operated_noise(stated.axis if run.spectral_binning == 1 else None, run, changes, stated.kept)


def with_values(world: World, values: Mapping[str, npt.ArrayLike]) -> World:
    """The world with other values at some paths (:data:`PATHS`).

    Parameters
    ----------
    values : path -> (U,) numbers or entries, one for each truth, (U, n) where they are spectra or lists of numbers;
        None leaves an entry of the file as it is

    Raises
    ------
    UsageError : a path that leads nowhere, or numbers of truths that differ.
    """
    moved = dict(world.moved)
    for path, entry in values.items():
        find(world.stated, path)
        moved.pop(path, None)  # what is moved last stands last
        value = np.asarray(entry) if not isinstance(entry, list) else column_of(entry)
        moved[path] = value.astype(float) if value.dtype.kind in "iu" else value
    sizes = {len(v) for v in moved.values()} - {1}
    refuse(len(sizes) > 1, "path.truths", values=sorted(sizes))
    return World(world.stated, moved, max(sizes, default=1))


def with_truths(world: World, truths: Sequence[Truth]) -> World:
    """The world of several truths, each of which moves what it names of the stated one."""
    values: dict[str, Values] = {}
    for path in dict.fromkeys(p for truth in truths for p in truth):
        if find(world.stated, path).shape == "number":
            here = world.moved[path][0] if path in world.moved else None  # as stated
            each = [truth.get(path, here) for truth in truths]
            values[path] = column_of([v.item() if isinstance(v, np.ndarray) and v.size == 1 else v for v in each])
        else:
            here = value_at(world, path)[0]
            spectra = (np.asarray(truth.get(path, here), dtype=float) for truth in truths)
            values[path] = np.array(np.broadcast_arrays(*spectra))
    return replace(with_values(world, values), size=len(truths))


_AGAIN = 16  # of the latest scenarios that were read again


def reads_again(stated: Stated, path: str, values: Values | None = None) -> bool:
    """Whether the scenario is read again for each different value of a path."""
    field_ = find(stated, path).field
    if not field_:
        return True
    if values is None or values.dtype != object or field_ not in stated.columns:
        return False
    return any(v is not None and not isinstance(v, int | float) for v in values)


def settled(world: World) -> list[tuple[Index, World]]:
    """Truths that share what is read, and the number of pixels of objects: what is read again is so for each value."""
    stated = world.stated
    again = {
        p: np.broadcast_to(v, (world.size, *v.shape[1:])) for p, v in world.moved.items() if reads_again(stated, p, v)
    }
    geometric = [i for i, (*_, p) in enumerate(stated.populations) if p.fill.geometry is not None]
    fills = [world.fill_models[number] for number in geometric if world.of_fill(number)]
    sizes = [np.array([pixels_of_object(fill) for fill in models])[which] for models, which in fills]
    if not again and not sizes:
        return [(np.arange(world.size), world.made())]
    first, which = distinct([*again.values(), *sizes], world.size)
    rest, out = World(stated, {p: v for p, v in world.moved.items() if p not in again}, world.size), []
    for i, u in enumerate(first):
        index = np.flatnonzero(which == i)
        again_read = _read_with(stated, {p: v[u] for p, v in again.items()}) if again else stated
        out.append((index, replace(rest.rows(index), stated=again_read, size=index.size).made()))
    return out


def _read_with(stated: Stated, values: Truth) -> Stated:
    """What a scenario says where some paths of it stand at other values."""
    kept: dict[str, Stated] = stated.kept.setdefault("again", {})
    key = repr([(p, v.tobytes() if isinstance(v, np.ndarray) else v) for p, v in values.items() if v is not None])
    if key not in kept:
        settings = {p: plain(v) for p, v in values.items() if v is not None and p not in (SHIFT, WIDTH)}
        scenario = with_settings(stated.scenario, settings) if settings else stated.scenario
        atmosphere = stated.atmosphere
        bands = values.get(SHIFT, stated.shift_nm), values.get(WIDTH) or stated.width
        stated_there = read_files(scenario, stated.origins, *bands, atmosphere.nodes, atmosphere.star)
        kept[key] = replace(stated_there, before=stated.nominal)
        if len(kept) > _AGAIN:
            del kept[next(iter(kept))]
    return kept[key]


def read_world(
    scenario: Scenario, origins: Origins | None = None, nodes: Mapping[str, Sequence[float]] | None = None
) -> World:
    """The world that a scenario states (U = 1), all its files read (3.7-3.20).

    Parameters
    ----------
    nodes : of the atmosphere, between which its terms are interpolated

    Raises
    ------
    UsageError, InputError : a scenario that contradicts itself, a file that is missing or corrupt.
    """
    return World(read_files(scenario, origins or Origins(), nodes=nodes))

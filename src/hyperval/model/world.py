"""U truths of one scenario as arrays, and the one table of quantities that can be perturbed in them.

:func:`read_world` makes the world that a scenario states (U = 1); :func:`with_values` is the only way anything in it is
moved.  Filters and labels stay those of the stated scenario; moved values are the truth that the sensor observes.

An array has U rows, or one where all truths share it, so that unperturbed quantities are computed once.  Perturbations
by several paths (:data:`PATHS`) compose: factors multiply, addends add up.
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
    object_pixel_count,
    stacked_fills,
    whole_object_fills,
)
from hyperval.model.stated import Origins, Stated, Truth, Values, fill_gaps, read_files, scalar, state_value, unique
from hyperval.scenario import ElmPanels, Fill, Scenario, TargetSubject
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import SensorChanges, SensorOperation
from hyperval.settings import item_number, numbers_of, path_parts, setting, with_settings


class Path(NamedTuple):
    """Where a dotted path leads.

    Attributes
    ----------
    field : array of the world; empty: an entry of the scenario's file, after whose change it is read again
    of : kind of item that its star names: class, target or surface
    shape : of a value: a number, or a spectrum or list of numbers (vector)
    low, high : limits of a value
    name, stated : its name, and the entry of a scenario's ``uncertainty`` that states its standard uncertainty
    neutral : value without perturbation, 1 of a factor, 0 of an addend; None: the scenario's value
    item, populations : in a scenario, number of the item that the star names; and of fills the populations that it
        moves, by number, each with its slice of the values

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
_SENSOR_KEYS = ("sensor_operation", "sensor_changes")
# Fields that do not change light, sensor and classes, nor the filters made of them.
_TARGET_FIELDS = ("tail", "fill", "fill entry", "blur", "target_gain", "beam", "sky_view", "fine_texture")


def matches_path(pattern: str, path: str) -> bool:
    """Whether a path is of a pattern of :data:`PATHS`."""
    names, parts = pattern.split("."), path_parts(path)
    if names[-1] == "**":
        names, parts = names[:-1], parts[: len(names) - 1]
    return len(names) == len(parts) and all(a in ("*", b) for a, b in zip(names, parts, strict=True))


def is_in_file(path: str) -> bool:
    """Whether a path is an entry of the scenario's file; others lead to an array of the world alone."""
    root = next(p for p in PATHS if matches_path(p, path)).partition(".")[0]
    return root in ("atmosphere", "sensor_changes", "sensor_operation", "scene", "**")


def as_column(values: Sequence[Any]) -> Values:
    """Values as a column: numbers as floats, anything else as objects."""
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return np.array(values, dtype=float)
    items = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):  # one by one: lists of one length are not rows of a matrix
        items[i] = value
    return items


def _number_column(values: Values) -> Array:
    """A column of numbers, NaN for entries as stated."""
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def find_path(stated: Stated, path: str) -> Path:
    """The field that a path of a scenario moves, and the number of its item.

    Raises
    ------
    UsageError : a quantity that the scenario does not have.

    Examples
    --------
    >>> from hyperval.scenario import load_scenario
    >>> from hyperval.settings import with_settings
    >>> unlit = with_settings(load_scenario("yellow-planks-asphalt"), {"atmosphere": None, "processing.elm": "none"})
    >>> find_path(read_world(unlit).stated, "sensor.fixed_noise")
    Traceback (most recent call last):
    hyperval.errors.UsageError: sensor.fixed_noise: the scenario has no atmosphere
    """
    return stated.cached(("path", path), lambda: _find_entry(stated, path))


def _find_entry(stated: Stated, path: str) -> Path:
    pattern = next(p for p in PATHS if matches_path(p, path))
    entry, parts, scenario = PATHS[pattern], path_parts(path), stated.scenario
    reread = PATHS["**"]
    if scenario.atmosphere is None:
        refuse(any(matches_path(p, path) for p in NOT_WITHOUT_LIGHT[:-1]), "path.light", path=path)
        if entry.field in ("atmosphere", "sensor"):
            return reread
    refuse(entry.field in ("dark", "bright") and not isinstance(scenario.processing.elm, ElmPanels), "path.panels")
    if entry.field == "atmosphere":
        nodes = stated.atmosphere.nodes
        return reread if parts[1] in ("engine", "table") or (nodes and parts[1] not in nodes) else entry
    if entry.field == "fill entry":
        number = item_number(stated.names["target"], parts[2], path)
        subjects = [s.name for s in stated.targets[number].subjects]
        if (parts[3] == "subjects") != bool(subjects):
            return reread  # and refused there
        subject = item_number(subjects, parts[4], path) if subjects else 0
        population_number = next(i for i, (t, k, _) in enumerate(stated.populations) if (t, k) == (number, subject))
        return entry._replace(populations={population_number: slice(None)})
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
    """Populations of some name or all, or those with a blur, each with its slice of the values."""
    slices, end = {}, 0
    for i, (t, _, p) in enumerate(stated.populations):
        if field == "fill":
            size = int(name in (None, p.name, stated.targets[t].name))
        else:
            size = np.size(p.fill.geometry.psf_fwhm_pixels or 0.0) if p.fill.geometry else 0
        if size:
            slices[i], end = slice(end, end + size), end + size
    return slices


def value_at(world: World, path: str) -> Any:
    """The value at a path: (U or 1, ...), or of one truth as stated.

    Raises
    ------
    UsageError : no such path, or a quantity that the scenario does not state.

    Examples
    --------
    A scenario that was read again with shifted bands has that shift as its value:

    >>> from hyperval.scenario import load_scenario
    >>> ((_, elsewhere),) = group_by_files(with_values(read_world(load_scenario("panels")), {SHIFT: np.array([[2.0]])}))
    >>> value_at(elsewhere, SHIFT).ravel().tolist(), value_at(elsewhere, WIDTH).tolist()
    ([2.0], [1.0])
    """
    if path in world.moved:
        return world.moved[path]
    stated, parts = world.stated, path_parts(path)
    entry = find_path(stated, path)
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
        return as_column([setting(stated.scenario, path)])
    except UsageError as error:
        suggestions = nearest(path, all_paths(world))
        if error.mend or not suggestions:
            raise
        mend = f"did you mean {suggestions[0]}?"
        raise UsageError(error.what, where=error.where, expected=error.expected, mend=mend) from error


def check_numbers(world: World, truth: Truth) -> None:
    """Refuse values beyond the limits of a path of the model, and lists of another length than it has.

    Raises
    ------
    UsageError : the path, what was given, and what was expected.
    """
    for path, raw in truth.items():
        entry, is_zenith = find_path(world.stated, path), path.endswith("_zenith_deg")  # which may pass the zenith
        of_column = isinstance(raw, Real) and entry.field and not path.startswith("atmosphere.")
        if is_in_file(path) and not is_zenith and not of_column:  # the file's own rules hold
            continue
        value = np.asarray(as_column(raw) if isinstance(raw, list | tuple) else raw)
        counts = {1, *((np.size(value_at(world, path)), len(world.stated.axis)) if entry.shape == "vector" else ())}
        is_number = value.dtype.kind in "fiu" and value.ndim <= (entry.shape == "vector") and value.size in counts
        is_valid = is_number and np.all((entry.low <= value) & (value <= entry.high))
        ends = {"above" if entry.low > float(f"{entry.low:g}") else "from": entry.low, "to": entry.high}
        words = [f" {word} {end:g}" for word, end in ends.items() if np.isfinite(end)]
        words += [f", or a list of {count}" for count in sorted(counts - {1})]
        refuse(not is_valid, "study.limits", path=path, given=f"{raw!r:.80}", words="".join(words))


def all_paths(world: World) -> list[str]:
    """Every path of a scenario to a number, or to numbers over wavelength."""
    stated = world.stated
    fills = [n for t in stated.targets for n in (t.name, *(p.name for p in t.populations))]
    names = {**stated.names, "fill": list(dict.fromkeys(fills))}
    paths = []
    for pattern, entry in PATHS.items():
        file_entry = pattern.startswith(("scene.", "sensor_")) or pattern in ("atmosphere.*", "**")
        unlit = pattern.startswith("atmosphere.") and stated.scenario.atmosphere is None
        if file_entry or unlit:
            continue
        for name in names[entry.of or "fill"] if "*" in pattern else [""]:
            path = pattern.replace("*", f"[{name}]")
            with suppress(UsageError):  # not in this scenario
                value_at(world, path)
                paths.append(path)
    return list(dict.fromkeys([*paths, *numbers_of(stated.scenario)]))


Populations = tuple[tuple[str, TargetSubject], ...]  # each with the name of its target
_FILL_PROPERTIES = ("fill_models", "populations")


@dataclass(frozen=True, eq=False)
class World:
    """U truths of one scenario.

    Attributes
    ----------
    moved : path -> values (U or 1, ...) of all perturbations; derived arrays are computed when they are used
    size : U
    """

    stated: Stated
    moved: Mapping[str, Values] = field(default_factory=dict)
    size: int = 1

    def computed(self) -> World:
        """This world with all derived arrays computed, so that contradictions are refused.

        A thousand fixed fills of a study are a column, not a thousand entries of the file that are checked:

        >>> from hyperval.api import load_scenario
        >>> world = read_world(load_scenario("yellow-planks-asphalt"), Origins())
        >>> study = {"scene.targets.yellow plank.subjects.[yellow plank 0.1].fill.fixed": np.linspace(0.0, 1.0, 1000)}
        >>> "fill_models" in vars(with_values(world, study).computed())
        False
        """
        for name, part in [*vars(World).items()]:  # which pickling adds to
            if isinstance(part, cached_property) and name not in _FILL_PROPERTIES:  # which fixed fills do not need
                getattr(self, name)
        return self

    def rows(self, index: Index) -> World:
        """The world of some of the truths."""
        if index.size == self.size and np.array_equal(index, np.arange(self.size)):
            return self
        if self.size == 1 and index.size > 1:
            return self
        return World(self.stated, {p: v[index] if len(v) > 1 else v for p, v in self.moved.items()}, index.size)

    def perturbations(self, *names: str) -> Iterable[tuple[str, int, Values]]:
        """Path, number of the item and values of perturbations of some fields, in their order."""
        for path, values in self.moved.items():
            entry = find_path(self.stated, path)
            if entry.field in names:
                yield path, entry.item, values

    def distinct_truths(self, targets: Sequence[str] = ()) -> tuple[Index, Index]:
        """First truth of each distinct light, sensor and classes, and the number (U,) of the group of each truth.

        ``targets`` : surfaces of targets that must be the same in a group too, with the light on them
        """
        excluded = ("tail", "fill", "fill entry", "blur", "target_gain") if targets else _TARGET_FIELDS
        other_surfaces = set(self.stated.names["target"]) - set(targets) - set(self.stated.classes)
        columns = []
        for path, values in self.moved.items():
            entry = find_path(self.stated, path)
            of_other = entry.of == "surface" and self.stated.names["surface"][entry.item] in other_surfaces
            if len(values) > 1 and entry.field not in excluded and not of_other:
                columns.append(values)
        return unique(columns, self.size)

    def column(self, name: str, stated: Array | None = None) -> Array:
        """(U or 1, items) of a field, or (U or 1, B or 1) of one common to all items.

        ``stated`` (1, items) : unperturbed values; None: the scenario's
        """
        if name in NEUTRAL:
            column = np.array([[NEUTRAL[name]]])
            for _, _, values in self.perturbations(name):
                moved = values if values.ndim > 1 else values[:, None]
                column = column * moved if NEUTRAL[name] else column + moved
            return column
        column = self.stated.columns[name] if stated is None else stated
        for _, item, values in self.perturbations(name):
            moved = _number_column(values)
            moved = np.where(np.isnan(moved), column[:, item], moved)
            column = np.array(np.broadcast_to(column, (max(len(column), len(moved)), column.shape[1])))
            column[:, item] = moved
        return column

    @cached_property
    def fraction(self) -> Array:
        """(U or 1, M) f_m; where some are moved by their share, the others are scaled to a sum of 1.

        Raises
        ------
        UsageError : they do not sum to 1.
        """
        stated = self.column("fraction")
        named = np.clip(self.column("share", np.full((1, stated.shape[1]), np.nan)), 0.0, 1.0)  # NaN: gives way
        moved = np.isfinite(named)
        if moved.any():
            unmoved, total = np.where(moved, 0.0, stated).sum(axis=1), np.nansum(named, axis=1)
            gives_way = (unmoved > 0.0) & (total < 1.0)
            scale = np.where(gives_way, (1.0 - total) / np.where(unmoved > 0.0, unmoved, 1.0), 1.0)
            f = np.where(moved, named, stated * scale[:, None])
            refuse(np.any(f.sum(axis=1) <= 0.0), "path.area")
            return np.asarray(np.where(moved.any(axis=1, keepdims=True), f / f.sum(axis=1, keepdims=True), stated))
        total = stated.sum(axis=1)
        wrong = np.any(np.abs(total - 1.0) > 1e-6) or np.any(stated < 0.0)
        refuse(wrong, "path.partition", low=total.min(), high=total.max())
        return stated

    @cached_property
    def law_fraction(self) -> Array:
        """(U or 1, J) area fractions of the laws of the classes (3.33)."""
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
    def _signal_gain_offset(self) -> tuple[Array, Array]:
        """(U or 1, S, B or 1) gain and offset on the reflectance of surfaces, where reflectance itself is recorded."""
        scenario, scene = self.stated.scenario, self.stated.scenario.scene
        named = (*scene.classes, *scene.panels, *scene.sites, *scene.targets)
        free = np.array([scenario.atmosphere is None and s.spectrum.measured is None for s in named])[None, :, None]
        gain, offset = self.column("gain")[:, None, :], self.column("offset")[:, None, :]
        return np.where(free, gain, 1.0), np.where(free, offset, 0.0)

    @cached_property
    def mean(self) -> Array:
        """(U or 1, S, B) mean reflectance of the surfaces."""
        mean, nominal = self.stated.mean[None], self.stated.nominal.mean
        for _, item, values in self.perturbations("mean"):
            mean = np.array(np.broadcast_to(mean, (max(len(mean), len(values)), *mean.shape[1:])))
            mean[:, item] += values.reshape(len(values), -1) - np.nan_to_num(nominal[item])
        gain, offset = self._signal_gain_offset
        return mean if np.all(gain == 1.0) and not np.any(offset) else gain * mean + offset

    @cached_property
    def surroundings(self) -> tuple[AtmosphericTerms, Array]:
        """Terms of (3.7) at the bands, (U or 1, 1, B) each, and (U or 1, M, B) means of the classes, gaps filled."""
        moved = {p: v for p, _, v in self.perturbations("atmosphere")}
        means = self.mean[:, [self.surface_number(name) for name in self.stated.classes]]
        return self.stated.atmosphere(moved, self.size), np.apply_along_axis(fill_gaps, -1, means)

    @cached_property
    def stretch(self) -> Array:
        """(U or 1, S, B or 1) factor on the pixel-to-pixel spread of the surfaces."""
        return np.asarray(self.column("spread")[:, :, None] * self._signal_gain_offset[0])

    def surface_number(self, name: str) -> int:
        """Number of a surface."""
        return self.stated.names["surface"].index(name)

    def target_column(self, name: str, target: int) -> Array:
        """(U,) values of a field of targets."""
        return np.broadcast_to(self.column(name)[:, target], (self.size,))

    # ---- light and sensor ----------------------------------------------------------------------------------

    @cached_property
    def sensor_noise(self) -> tuple[list[NoiseModel], Index]:
        """The distinct noise models (3.13)-(3.20), none without a sensor, and the number (U,) of that of each truth."""
        stated = self.stated
        if stated.noise is None or stated.scenario.atmosphere is None:
            return [], np.zeros(self.size, int)
        columns = {p: np.broadcast_to(v, (self.size,)) for p, _, v in self.perturbations("sensor")}
        first, which = unique(columns.values(), self.size)
        changes = [{p: scalar(v[u]) for p, v in columns.items() if v[u] is not None} for u in first]
        return [_changed_noise(stated, moved) if moved else stated.noise for moved in changes], which

    @cached_property
    def by_light(self) -> tuple[World, Index]:
        """The truths of distinct light, sensor and classes, and the number (U,) of that of each truth."""
        first, which = self.distinct_truths()
        return self.rows(first), which

    # ---- fills ---------------------------------------------------------------------------------------------

    def fill_perturbations(self, number: int) -> dict[str, Values]:
        """Path -> values of the perturbations of the fill of a population."""
        return {p: v for p, v in self.moved.items() if number in find_path(self.stated, p).populations}

    @cached_property
    def fill_models(self) -> list[tuple[list[Fill], Index]]:
        """For each population its distinct fills, and the number (U,) of that of each truth."""
        fill_models = []
        for n, moved in enumerate(map(self.fill_perturbations, range(len(self.stated.populations)))):
            first, which = unique((np.broadcast_to(v, (self.size, *v.shape[1:])) for v in moved.values()), self.size)
            changes = ({p: v[u if len(v) > 1 else 0] for p, v in moved.items()} for u in first)
            fill_models.append(([self._perturbed_fill(n, change) for change in changes], which))
        return fill_models

    def _perturbed_fill(self, number: int, moved: Truth) -> Fill:
        """The fill of a population with the perturbations of one truth."""
        fill, nominal_fill = (s.populations[number][2].fill for s in (self.stated, self.stated.nominal))
        entries, change = {}, 0.0
        for path, value in moved.items():
            entry, parts, numbers = find_path(self.stated, path), path_parts(path), np.atleast_1d(value)
            if entry.field == "fill entry":
                if value is not None:
                    entries[".".join(parts[6 if parts[3] == "subjects" else 4 :])] = scalar(value)
                continue
            widths = (numbers[entry.populations[number]] if numbers.size > 1 else numbers).tolist()
            if entry.field == "fill":
                change += widths[0] - fill_distribution(nominal_fill).mean
            else:
                entries["geometry.psf_fwhm_pixels"] = widths[0] if len(widths) == 1 else widths
        of_entries = with_settings(fill, entries) if entries else fill
        return fill_with_mean(of_entries, change) if change else of_entries

    @cached_property
    def populations(self) -> tuple[list[Populations], Index]:
        """The distinct populations of target pixels with their fills, each with the name of its target, and the number
        (U,) of those of each truth.
        """
        first, which = unique([which for _, which in self.fill_models], self.size)
        named = [(self.stated.targets[t].name, p) for t, _, p in self.stated.populations]

        def truth_populations(u: int) -> Populations:
            fills = (models[index[u]] for models, index in self.fill_models)
            return tuple((t, p.model_copy(update={"fill": f})) for (t, p), f in zip(named, fills, strict=True))

        return [truth_populations(u) for u in first.tolist()], which

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
        thesis, moved = self.stated.scenario.formulation == "thesis", self.fill_perturbations(number)
        stated = self.stated.populations[number][2].fill
        if len(moved) == 1 and next(iter(moved)).endswith("fill.fixed") and stated.fixed is not None:
            (column,) = moved.values()
            values = np.nan_to_num(_number_column(column), nan=stated.fixed)[:, None]
            refuse(not np.all((values >= 0.0) & (values <= 1.0)), "fill.range", low=values.min(), high=values.max())
            return FillDistribution(values, np.ones((1, 1)))
        make = whole_object_fills if objects else fills_of_population
        if not moved:
            return make(stated, thesis)
        models, which = self.fill_models[number]
        return stacked_fills([make(fill, thesis) for fill in models], which)


def _changed_noise(stated: Stated, moved: Truth) -> NoiseModel:
    """The noise with other numbers of the sensor or of its operation."""
    scenario, sensor = stated.scenario, stated.sensor
    run, changes = scenario.sensor_operation or SensorOperation(), scenario.sensor_changes or SensorChanges()
    entries = {room: {p[len(room) + 1 :]: v for p, v in moved.items() if p.startswith(room)} for room in _SENSOR_KEYS}
    run, changes = with_settings(run, entries[_SENSOR_KEYS[0]]), with_settings(changes, entries[_SENSOR_KEYS[1]])
    assert sensor is not None  # noqa: S101 - asked for where there is noise
    return sensor.operated_noise(stated.axis if run.spectral_binning == 1 else None, run, changes, stated.cache)


def with_values(world: World, values: Mapping[str, npt.ArrayLike]) -> World:
    """The world with other values at some paths (:data:`PATHS`).

    Parameters
    ----------
    values : path -> (U,) numbers or entries, one for each truth, (U, n) where they are spectra or lists of numbers;
        None leaves an entry of the file as it is

    Raises
    ------
    UsageError : no such path, or different numbers of truths.
    """
    moved = dict(world.moved)
    for path, entry in values.items():
        find_path(world.stated, path)
        moved.pop(path, None)  # the latest perturbation comes last
        value = np.asarray(entry) if not isinstance(entry, list) else as_column(entry)
        moved[path] = value.astype(float) if value.dtype.kind in "iu" else value
    sizes = {len(v) for v in moved.values()} - {1}
    refuse(len(sizes) > 1, "path.truths", values=sorted(sizes))
    return World(world.stated, moved, max(sizes, default=1))


def with_truths(world: World, truths: Sequence[Truth]) -> World:
    """The world of several truths, each of which moves what it names of the stated one."""
    values: dict[str, Values] = {}
    for path in dict.fromkeys(p for truth in truths for p in truth):
        if find_path(world.stated, path).shape == "number":
            nominal = world.moved[path][0] if path in world.moved else None  # as stated
            entries = [truth.get(path, nominal) for truth in truths]
            values[path] = as_column([v.item() if isinstance(v, np.ndarray) and v.size == 1 else v for v in entries])
        else:
            nominal = value_at(world, path)[0]
            spectra = (np.asarray(truth.get(path, nominal), dtype=float) for truth in truths)
            values[path] = np.array(np.broadcast_arrays(*spectra))
    return replace(with_values(world, values), size=len(truths))


_REREAD_SCENARIOS = 16  # most scenarios read again that are cached


def is_reread(stated: Stated, path: str, values: Values | None = None) -> bool:
    """Whether the scenario is read again for each different value of a path."""
    field_ = find_path(stated, path).field
    if not field_:
        return True
    if values is None or values.dtype != object or field_ not in stated.columns:
        return False
    return any(v is not None and not isinstance(v, int | float) for v in values)


def group_by_files(world: World) -> list[tuple[Index, World]]:
    """Groups of truths that share the files read, and the number of pixels of objects."""
    stated = world.stated
    reread = {
        p: np.broadcast_to(v, (world.size, *v.shape[1:])) for p, v in world.moved.items() if is_reread(stated, p, v)
    }
    geometric = [i for i, (*_, p) in enumerate(stated.populations) if p.fill.geometry is not None]
    fills = [world.fill_models[number] for number in geometric if world.fill_perturbations(number)]
    sizes = [np.array([object_pixel_count(fill) for fill in models])[which] for models, which in fills]
    if not reread and not sizes:
        return [(np.arange(world.size), world.computed())]
    first, which = unique([*reread.values(), *sizes], world.size)
    unread, groups = World(stated, {p: v for p, v in world.moved.items() if p not in reread}, world.size), []
    for i, u in enumerate(first):
        index = np.flatnonzero(which == i)
        group_stated = _read_with(stated, {p: v[u] for p, v in reread.items()}) if reread else stated
        groups.append((index, replace(unread.rows(index), stated=group_stated, size=index.size).computed()))
    return groups


def _read_with(stated: Stated, values: Truth) -> Stated:
    """The scenario read again with other values at some paths."""
    cache: dict[str, Stated] = stated.cache.setdefault("again", {})
    key = repr([(p, v.tobytes() if isinstance(v, np.ndarray) else v) for p, v in values.items() if v is not None])
    if key not in cache:
        settings = {p: scalar(v) for p, v in values.items() if v is not None and p not in (SHIFT, WIDTH)}
        scenario = with_settings(stated.scenario, settings) if settings else stated.scenario
        atmosphere = stated.atmosphere
        bands = values.get(SHIFT, stated.shift_nm), values.get(WIDTH) or stated.width
        reread = read_files(scenario, stated.origins, *bands, atmosphere.nodes, atmosphere.star)
        cache[key] = replace(reread, reread_from=stated.nominal)
        if len(cache) > _REREAD_SCENARIOS:
            del cache[next(iter(cache))]
    return cache[key]


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

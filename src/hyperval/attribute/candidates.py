"""Candidate causes: uncertain inputs, each moved along its directions, and the standard errors of a model.

Inputs without a stated uncertainty have a usual one here, as they too may be the cause.  An injected error moves one or
several inputs of the model alone: the spectra that detectors look for and the labels of bands stay, so that the
pipeline that is compared is the same.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from functools import partial
from itertools import combinations, product
from pathlib import Path
from typing import Any, get_args

import numpy as np

from hyperval.atmosphere.solar import SPECTRA as SOLAR_SPECTRA
from hyperval.atmosphere.solar import parse_utc
from hyperval.atmosphere.state import AtmosphereModel
from hyperval.config import load_yaml
from hyperval.data import Array
from hyperval.errors import UsageError, package_table, refuse
from hyperval.model import Origins, Truth, UncertainInput, inputs_of, number_input, predict, read_world, value_at
from hyperval.model.inputs import Kind, error_rows, field_spectrum_of, form_in_words, spectral_input
from hyperval.model.world import World, check_numbers
from hyperval.products import PredictedProducts, SpectralEstimate
from hyperval.scenario import BackgroundClass, Scenario, SpectralForm, Surface, Target, TargetSubject
from hyperval.statistics_library import BUILTIN_NAMES, builtin_mean

Family = Callable[[World], Truth]  # what stands where with an error, for what a scenario says

# Directions of an input that move all that is compared at once: of a smooth error nearly all of its variance, of a
# rough one little.  The rest counts for each spectrum by itself (``stated_beyond``), and not for scores.
MOST_DIRECTIONS = 8
# A direction that would have to move farther is no reason: stated uncertainties, usual steps, steps of a smooth gain
# or offset (half of the radiance).
MOST_UNITS, MOST_STEPS, MOST_SMOOTH = 10.0, 200.0, 16.0
SHIFT_NM = 0.2
SINGLE_BANDS = "single bands"
# A surface that is described by another one of its kind: part of its reflectance, over so many nm together, along
# the directions that hold nine tenths of its variance between 400 and 2500 nm.
SURFACE, SURFACE_NM, SURFACE_DIRECTIONS = 0.10, 300.0, 4
_OTHER_SIZES, _BELOW, _ABOVE = (-5.0, 5.0), 1.6, 2.0
# Tables of what may be wrong, and where the model is asked for it.
CAUSES = package_table("attribute/causes.yaml")
_SIZES: dict[str, list[float]] = {name: sizes for name, *_, sizes in CAUSES["usual"]} | CAUSES["sizes"]
_LEAST, _MOST = 0.05, 10.0  # factors that a change may have on what is given in parts
LIGHT = ("sunlight", "path radiance", "spherical albedo")
# Of spectra in another unit; what the brightest bands of a reflectance are at least, and at most.
SCALES, DARKEST, BRIGHTEST = (0.01, 0.1, 10.0, 100.0), 0.02, 1.5
HEIGHTS = ("sensor altitude", "ground height")
HAZES = ("rural", "continental", "maritime", "urban", "desert")


def assumed_inputs(world: World) -> list[UncertainInput]:
    """Every input of a scenario that may be off and whose uncertainty it does not state, with a usual one."""
    stated = {item.path for item in inputs_of(world)}
    return [item for item in usual_inputs(world) if item.path not in stated]


def usual_inputs(world: World) -> Iterator[UncertainInput]:
    """Every input of a scenario that may be off, with a usual uncertainty."""
    scene = world.stated.scenario.scene
    yield from (_usual(world, *row) for *row, _ in CAUSES["usual"] if _there(world, row[2]))
    for c in scene.classes:
        yield _usual(world, f"spread of {c.name}", "surface", f"surfaces.[{c.name}].spread", "10 %")
        if np.all(np.isfinite(np.asarray(value_at(world, f"surfaces.[{c.name}].tail_dof"), dtype=float))):
            yield _usual(world, f"tails of {c.name}", "surface", f"surfaces.[{c.name}].tail_dof", "10 %")
    # Mean spectra that the collection itself does not vouch for.  Those of targets are left out: mixed with their
    # hosts they look like their fill, which is there already.
    form = SpectralForm(correlation_nm=SURFACE_NM)
    for s in _of_ground(world):
        if s.spectrum.measured is None:
            sd = SURFACE * np.nan_to_num(world.stated.surfaces[s.name].mean)
            one = spectral_input(world, field_spectrum_of(s.name), "surface", f"surfaces.[{s.name}].mean", sd, form)
            words = f"{100 * SURFACE:g} %, {form_in_words(form)}"
            yield replace(one, rows=one.rows[:SURFACE_DIRECTIONS], source="usual", correlation=words)
    shares = [c for c in scene.classes if _there(world, f"fraction.[{c.name}]")]
    for c in shares[:1] if len(scene.classes) == 2 else shares:  # of two the other one's is the same input
        yield _usual(world, f"fraction of {c.name}", "scene", f"fraction.[{c.name}]", "10 %")


def _of_ground(world: World) -> tuple[Surface, ...]:
    scene = world.stated.scenario.scene
    return (*scene.classes, *scene.panels, *scene.sites)


def _usual(world: World, name: str, kind: Kind, path: str, step: str) -> UncertainInput:
    """An input of which one unit is a step, in its own unit or in percent of what stands there."""
    size = float(step.split()[0])
    one = number_input(world, name, kind, path, size, source="usual", words=step)
    return replace(one, rows=size / 100.0 * one.nominal[None, :]) if step.endswith("%") else one


def _there(world: World, path: str) -> bool:
    """Whether a scenario has something at a path that is not 0; an atmosphere's table is of one state."""
    state = world.stated.scenario.atmosphere
    if path.startswith("atmosphere.") and (state is None or state.engine == "table"):
        return False
    try:
        return bool(np.any(np.nan_to_num(np.asarray(value_at(world, path), dtype=float))))
    except UsageError:
        return False


@dataclass(frozen=True)
class Candidate:
    """A cause: an input of several directions, or sizes of one thing, or alternatives.

    Attributes
    ----------
    name, kind : for people
    step : one unit in words
    budgeted : its uncertainty is stated, and is in the covariance already
    knots_nm : where its directions stand, over wavelength
    unbounded : of a change: how far a user's mistake goes is not what the uncertainty says
    members : the input that it is in each scenario, None where it is none there
    sizes : of one thing, in units: where the model is asked; without one it is a set of directions
    labels : of alternatives
    moved : the truths of all scenarios at a size, or of an alternative by its number
    """

    name: str
    kind: str
    step: str
    budgeted: bool
    members: tuple[UncertainInput | None, ...] = field(default=(), compare=False, repr=False)
    sizes: tuple[float, ...] = field(default=(), compare=False)
    labels: tuple[str, ...] = field(default=(), compare=False)
    moved: Callable[[float], list[Truth]] | None = field(default=None, compare=False, repr=False)
    unbounded: bool = field(default=False, compare=False)
    knots_nm: tuple[float, ...] = field(default=(), compare=False)

    @property
    def size(self) -> int:
        """Directions that are followed."""
        return min(max((m.size for m in self.members if m is not None), default=0), MOST_DIRECTIONS)

    @property
    def path(self) -> str:
        """Of the input that it moves; its name where it is none."""
        return next((m.path for m in self.members if m is not None), self.name)

    @property
    def unit(self) -> str:
        """One unit in a sentence."""
        return "stated uncertainty" if self.budgeted else f"step of {self.step}".removesuffix(" of ")

    @property
    def most(self) -> float:
        """Units that it may go: ten stated uncertainties, 200 usual steps, or half of the radiance."""
        if self.knots_nm:
            return MOST_SMOOTH
        return MOST_UNITS if self.budgeted and not self.unbounded else MOST_STEPS

    @property
    def ends(self) -> tuple[float, float]:
        """Least and greatest size that it may have; no factor lies below 0.

        >>> depth = Candidate("depth", "atmosphere", "10 %", False, sizes=(-5.0, 10.0))
        >>> [replace(depth, unbounded=of_a_change).ends for of_a_change in (False, True)]
        [(-8.0, 20.0), (-9.5, 90.0)]
        >>> Candidate("scale", "sensor", "0.1 %", False, sizes=(-8.0, 8.0), unbounded=True).ends
        (-12.8, 32.0)
        >>> Candidate("light of a target", "scene", "10 %", False, sizes=(-9.0, 7.0)).ends
        (-10.0, 14.0)
        """
        number, _, unit = self.step.partition(" ")
        low, high = _BELOW * min(0.0, *self.sizes), (1.0 + self.unbounded) * _ABOVE * max(0.0, *self.sizes)
        if self.budgeted:
            return min(low, -self.most), max(high, self.most)
        whole = 100.0 / float(number) if unit == "%" else math.inf
        if self.unbounded and whole <= 100.0:
            low, high = min(low, (_LEAST - 1.0) * whole), max(high, (_MOST - 1.0) * whole)
        return max(low, -whole), high

    def as_far_as(self, usual: Candidate) -> Candidate:
        """A number of a small stated uncertainty, asked at the sizes of one of which nothing is stated: who mistypes it
        is no more careful than another.

        >>> stated, usual = (UncertainInput("time", "scene", "hour", np.ones(1), np.array([[sd]])) for sd in (0.1, 1.0))
        >>> clock = Candidate("time", "scene", "1 h", False, (usual,), (1.0, -1.0, 4.0))
        >>> watch = Candidate("time", "scene", "one number", True, (stated,), (1.0, -1.0)).as_far_as(clock)
        >>> watch.sizes, watch.ends
        ((10.0, -10.0, 40.0), (-16.0, 80.0))
        """
        first, other = (next((m for m in c.members if m is not None), None) for c in (self, usual))
        if first is None or not (self.budgeted and self.sizes and usual.sizes):
            return self
        step = np.max(np.abs(other.rows)) if other is not None else float(usual.step.partition(" ")[0])
        ratio = float(step / np.max(np.abs(first.rows)))
        return replace(self, sizes=tuple(ratio * z for z in usual.sizes)) if ratio > 1.0 else self

    def at(self, direction: int, units: float) -> list[Truth]:
        """The truth of each scenario so many units along one direction."""
        if self.moved is not None:
            return self.moved(units)
        return [{} if m is None or direction >= m.size else m.direction(direction, units) for m in self.members]

    @property
    def makes_anything(self) -> bool:
        """Whether it can make nearly any change of a spectrum, band by band."""
        return self.name == SINGLE_BANDS or (self.kind == "surface" and not self.sizes)

    @property
    def of_engine(self) -> bool:
        """Whether each value of it takes a run of the engine."""
        return any(m is not None and m.path.startswith("atmosphere.") for m in self.members)

    def alone(self, number: int, scenario: str) -> Candidate:
        """The same in one scenario.

        >>> later = Candidate("time", "scene", "1 h", False, sizes=(1.0,), moved=lambda z: [{"hour": 9 + z}] * 2)
        >>> second = later.alone(1, "line 2")
        >>> second.name, second.at(0, 1.0)
        ('time in line 2', [{}, {'hour': 10.0}])
        """

        def moved(units: float) -> list[Truth]:
            return [truth if i == number else {} for i, truth in enumerate(self.at(0, units))]

        return replace(self, name=f"{self.name} in {scenario}", members=(), moved=moved)

    def in_words(self, amplitudes: Array) -> str:
        """How far it is from what is stated.

        >>> gain = Candidate("smooth gain", "sensor", "3 % in smooth pieces", False, knots_nm=(400.0, 600.0))
        >>> gain.in_words(np.array([-4.0, 1.0]))
        '-12 % at 400 nm and less elsewhere'
        >>> aod = Candidate("depth", "atmosphere", "10 %", False, sizes=(1.0, -1.0))
        >>> aod.in_words(np.array([5.0])), aod.in_words(np.array([0.004]))
        ('x 1.5', '+0.04 %')
        """
        if self.labels:
            return self.labels[int(amplitudes[0])]
        number, _, unit = self.step.partition(" ")
        if self.knots_nm:
            most = int(np.argmax(np.abs(amplitudes)))
            return f"{float(number) * amplitudes[most]:+.2g} % at {self.knots_nm[most]:g} nm and less elsewhere"
        if not self.sizes or self.budgeted or not unit:
            size = f"{amplitudes[0]:+.2g}" if amplitudes.size == 1 else f"{np.sqrt(np.mean(amplitudes**2)):.2g}"
            return f"{size} times the {self.unit}"
        value = float(amplitudes[0]) * float(number)
        return f"x {1.0 + value / 100.0:.3g}" if unit == "%" and abs(value) >= 1.0 else f"{value:+.2g} {unit}"


def candidates(
    stated: Sequence[Sequence[UncertainInput]], assumed: Sequence[Sequence[UncertainInput]]
) -> list[Candidate]:
    """Inputs of all scenarios by name: what bears one name moves in all of them at once.

    ``stated, assumed`` : inputs of each scenario, those with a stated uncertainty and the others; one that is stated in
    any scenario is left out of the others.
    """
    out: dict[str, Candidate] = {}
    for budgeted, groups in ((True, stated), (False, assumed)):
        for name in dict.fromkeys(i.name for group in groups for i in group):
            members = tuple(next((i for i in group if i.name == name), None) for group in groups)
            first = next(m for m in members if m is not None)
            one = Candidate(name, first.kind, first.correlation, budgeted, members)
            if one.size == 1:
                further = () if budgeted else _SIZES.get(name, _SIZES.get(name.partition(" of ")[0], _OTHER_SIZES))
                one = replace(one, sizes=(1.0, -1.0, *further))
            out.setdefault(name, one)
    return list(out.values())


def further_candidates(worlds: Sequence[World]) -> list[Candidate]:
    """What is no number: bands elsewhere, another time or haze, spectra at another level, exchanged or in another unit.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> world = read_world(load_scenario("yellow-planks-asphalt"))
    >>> of = {c.name: c for c in further_candidates([world, world])}
    >>> [truth["sensor.band_width"] for truth in of["band width"].at(0, 2.0)]
    [1.2, 1.2]
    >>> grass = of["level of the spectrum of grass"]
    >>> mean = world.stated.surfaces["grass"].mean
    >>> [float(np.median(truth["surfaces.[grass].mean"] / mean).round(9)) for truth in grass.at(0, 2.0)]
    [1.1, 1.1]
    >>> scale, some = of["scale of a spectrum"], ("grass", "black", "yello")  # that leaves a reflectance
    >>> [label for i, label in enumerate(scale.labels) if any(scale.at(0, i)) and label[:5] in some]
    ['grass x 0.1', 'black panel x 10', 'yellow plank x 0.1 or of another material']
    """
    states = [world.stated.scenario.atmosphere for world in worlds]
    if any(s is not None and s.engine == "table" for s in states):
        states = [None for _ in states]

    def wider(units: float) -> list[Truth]:  # or spectra that were smoothed over bands
        return [{**_shifted(world), "sensor.band_width": 1.0 + 0.1 * units} for world in worlds]

    shifted, sizes = partial(_elsewhere, worlds, 1.0), (1.0, -1.0, -50.0, -25.0, -5.0, 5.0, 25.0, 50.0)
    out = [Candidate("wavelength shift", "sensor", f"{SHIFT_NM:g} nm", False, moved=shifted, sizes=sizes)]
    out.append(Candidate("band width", "sensor", "10 %", False, moved=wider, sizes=(-4.0, 10.0, 30.0)))
    if any(s is not None and s.time_utc for s in states):
        later = partial(_later, worlds, timedelta(hours=1))
        out.append(Candidate("time of overflight", "scene", "1 h", False, sizes=(1.0, -1.0), moved=later))
    if all(s is not None and s.solar_zenith_deg is not None and not s.time_utc for s in states):
        sun = "solar zenith angle", "scene", "atmosphere.solar_zenith_deg", "1 deg"
        out.append(_of_input(worlds, sun, (1.0, -1.0, -5.0, 5.0)))
        if len(days := [s.day_of_year for s in states if s is not None and s.day_of_year]) == len(states):
            months, day = (-2.0, -1.0, 1.0, 2.0, 4.0, 6.0), partial(_on_day, days)
            out.append(Candidate("date of overflight", "scene", "30 d", False, sizes=months, moved=day))
    if all(world.stated.noise is not None for world in worlds):
        out.append(_noise(worlds, "fixed_noise", "noise without signal", (1.0, -1.0, -10.0, 10.0, 30.0)))
    if hazes := {s.aerosol for s in states if s is not None and isinstance(s.aerosol, str) and s.aerosol in HAZES}:
        kinds = {h: [{"atmosphere.aerosol": h} if s else {} for s in states] for h in HAZES if h not in hazes}
        out.append(_one_of("aerosol type", "atmosphere", kinds))
    pairs, scaled = dict[str, list[Truth]](), dict[str, list[Truth]]()
    levels = defaultdict[str, list[dict[str, Array]]](lambda: [{} for _ in worlds])
    for number, world in enumerate(worlds):
        scene, alone = world.stated.scenario.scene, partial(_alone, number, len(worlds))
        for name in dict.fromkeys(p.name for _, _, p in world.stated.populations):
            fill = f"fill fraction of {name}", "scene", f"fill.[{name}]", "5 %"
            out.append(_of_input(worlds, fill, (-10.0, 12.0), number))
        if len(scene.targets) > 1 or any(_side(p) for t in scene.targets for p in t.populations):
            out += [_sized(target, number, worlds) for target in scene.targets]
        for kind in (scene.classes, (*scene.panels, *scene.sites), scene.targets):
            for names in combinations([x.name for x in kind], 2):
                pairs[" and ".join(names)] = alone(_exchanged(world, names))
            scaled |= {words: alone(truth) for words, truth in _rescaled(world, kind)}
        for s, path in _field_spectra(_of_ground(world)):
            levels[s.name][number][path] = np.asarray(value_at(world, path))[0]
    out += [_level(f"the spectrum of {name}", means) for name, means in levels.items()]
    found = {"exchanged spectra or regions": pairs, "scale of a spectrum": scaled}
    return out + [_one_of(name, "scene", each) for name, each in found.items() if each]


def _rescaled(world: World, kind: Sequence[Surface]) -> Iterator[tuple[str, Truth]]:
    """Field spectra in another unit; of targets, whose scores do not tell, or others in their place.

    What is no reflectance then moves nothing: it keeps its part of what is thought likely before.
    """
    for s, path in _field_spectra(kind):
        level, other = np.nan_to_num(world.stated.surfaces[s.name].mean), isinstance(s, Target)
        for x in SCALES:
            possible = DARKEST <= np.percentile(x * level, 95) <= BRIGHTEST
            yield f"{s.name} x {x:g}{' or of another material' * other}", {path: x * level} if possible else {}


def _later(worlds: Sequence[World], step: timedelta, units: float) -> list[Truth]:
    """Another time of overflight, where one is stated; another day at the same hour.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> at = {"solar_zenith_deg": None, "solar_azimuth_deg": None, "day_of_year": None, "latitude_deg": 43.0,
    ...       "longitude_deg": -77.7, "time_utc": "2012-09-20T16:00:00Z"}
    >>> stated = load_scenario("green-planks-grass")
    >>> there = stated.with_values({f"atmosphere.{name}": value for name, value in at.items()})
    >>> _later([read_world(there), read_world(stated)], timedelta(hours=1), -2.0)
    [{'atmosphere.time_utc': '2012-09-20T14:00:00+00:00'}, {}]
    >>> _later([read_world(there)], timedelta(days=30), 0.52)
    [{'atmosphere.time_utc': '2012-10-06T16:00:00+00:00'}]
    """
    by = units * step if step < timedelta(days=1) else timedelta(days=round(units * step.days))
    times = [s and s.time_utc and parse_utc(s.time_utc) + by for s in (w.stated.scenario.atmosphere for w in worlds)]
    return [{"atmosphere.time_utc": t.isoformat()} if t else {} for t in times]


def _on_day(days: Sequence[int], units: float) -> list[Truth]:
    """Another day of the year.

    >>> _on_day([264, 10], 4.0)
    [{'atmosphere.day_of_year': 19}, {'atmosphere.day_of_year': 130}]
    """
    return [{"atmosphere.day_of_year": (round(day + 30.0 * units) - 1) % 365 + 1} for day in days]


def _noise(worlds: Sequence[World], key: str, name: str, sizes: Iterable[float], of: Array | float = 1.0) -> Candidate:
    """Electrons per radiance or fixed noise of another size, in bands ``of`` (B,)."""

    def other(units: float) -> list[Truth]:
        return [{f"sensor.{key}": 1.0 + 0.05 * units * of}] * len(worlds)

    return Candidate(name, "sensor", "5 %", False, sizes=tuple(sizes), moved=other)


def _sized(target: Target, number: int, worlds: Sequence[World]) -> Candidate:
    """Targets of another size than stated: their sides, where fills follow from those; else their fills.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> worlds = [read_world(load_scenario("green-planks-grass"))]
    >>> sized = _sized(worlds[0].stated.scenario.scene.targets[0], 0, worlds)
    >>> {path: fill.round(9).tolist() for path, fill in sized.at(0, 2.0)[0].items()}  # sides longer by 10 %
    {'fill.[green plank 0.1]': [0.121], 'fill.[green plank 0.2]': [0.242], 'fill.[green plank 0.4]': [0.484]}
    """

    def sized(units: float) -> list[Truth]:
        factor, truth = 1.0 + 0.05 * units, dict[str, Any]()
        for p in target.populations:
            if side := _side(p):
                truth[f"{_geometry(target, p)}.side_m"] = factor * side
            else:
                fill = np.asarray(value_at(worlds[number], f"fill.[{p.name}]"), dtype=float)[0]
                truth[f"fill.[{p.name}]"] = np.minimum(factor**2 * fill, 1.0)
        return _alone(number, len(worlds), truth)

    return Candidate(f"size of {target.name}", "scene", "5 %", False, sizes=(-6.0, 8.0), moved=sized)


def _side(p: TargetSubject) -> float | None:
    return p.fill.geometry.side_m if p.fill is not None and p.fill.geometry is not None else None


def _geometry(target: Target, p: TargetSubject) -> str:
    return f"scene.targets.[{target.name}]{f'.subjects.[{p.name}]' if target.subjects else ''}.fill.geometry"


def exchanged_entries(worlds: Sequence[World], looked_for: Mapping[str, Any]) -> list[Candidate]:
    """Spectra of targets and of classes in the file, which move what goes with them: what the model's filters look for,
    covariances.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> scenario = load_scenario("yellow-planks-asphalt")
    >>> (classes,) = exchanged_entries([read_world(scenario)], {})
    >>> classes.labels[0], classes.at(0, 0.0)[0]
    ('asphalt: that of grass', {'scene.classes.[asphalt].spectrum': {'builtin': 'grass'}})
    """
    found: dict[str, dict[str, list[Truth]]] = {"targets": {}, "classes": {}}
    for number, world in enumerate(worlds):
        for kind, entries in found.items():
            items = getattr(world.stated.scenario.scene, kind)
            spectra = {x.name: x.spectrum.model_dump(exclude_none=True, exclude_defaults=True) for x in items}
            others = looked_for if kind == "targets" else {}
            for words, changed in others_in_place(spectra, others, "looked for").items():
                truth = {f"scene.{kind}.[{name}].spectrum": entry for name, entry in changed.items()}
                entries[words] = _alone(number, len(worlds), truth)
    return [_one_of(f"spectra of {kind} in the file", "scene", each) for kind, each in found.items() if each]


def others_in_place(named: Mapping[str, Any], others: Mapping[str, Any], what: str) -> dict[str, dict[str, Any]]:
    """Of named entries what changes where one has the place of another, or two have each other's.

    Parameters
    ----------
    own, others : entries, and further ones that may stand there; ``what`` is said of those of the same name

    Examples
    --------
    >>> others_in_place({"red": 1, "green": 1}, {"green": 2}, "looked for")
    {'red: that of green': {'red': 2}, 'green: that looked for': {'green': 2}}
    """
    entries = {str(entry): (by, entry) for by, entry in (*others.items(), *named.items())}.values()
    tried = [(name, by, entry) for name, (by, entry) in product(named, entries) if entry != named[name]]
    out = {f"{name}: that {what if by == name else f'of {by}'}": {name: entry} for name, by, entry in tried}
    return out | exchanged_pairs(named)


def exchanged_pairs(named: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Two of named entries in each other's place, by the names of both.

    >>> exchanged_pairs({"red": 1, "green": 2, "blue": 1})
    {'red and green': {'red': 2, 'green': 1}, 'green and blue': {'green': 1, 'blue': 2}}
    """
    return {f"{i} and {j}": {i: named[j], j: named[i]} for i, j in combinations(named, 2) if named[i] != named[j]}


def rarer_candidates(worlds: Sequence[World]) -> list[Candidate]:
    """What is looked for where little else explains a change: field spectra at another level, one of them or the
    covariance of another in its place, fractions that two classes trade, shade, electrons of one arm, stretched bands,
    heights, the direction of view, another date or sun.

    Examples
    --------
    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> hazy = {"meteorological_range_km": None, "aot550": 0.2, "angstrom_exponent": 1.2}
    >>> stated = load_scenario("yellow-planks-asphalt")
    >>> world = read_world(stated.with_values({f"atmosphere.{name}": value for name, value in hazy.items()}))
    >>> both = {c.name: c for c in reversed(rarer_candidates([world, world]))}
    >>> def shown(name, units):
    ...     for truth in both[name].at(0, units):
    ...         print({path: np.round(value, 3).ravel()[[0, -1]].tolist() for path, value in truth.items()})
    >>> shown("light of yellow plank", -4.0)  # of the first scenario: as stated it lies in full light
    {'scene.targets.[yellow plank].illumination.beam': [0.6, 0.6]}
    {}
    >>> shown("fraction of asphalt for grass", 2.0)
    {'scene.classes.[asphalt].fraction': [0.7, 0.7], 'scene.classes.[grass].fraction': [0.2, 0.2]}
    {'scene.classes.[asphalt].fraction': [0.7, 0.7], 'scene.classes.[grass].fraction': [0.2, 0.2]}
    >>> stretched = both["wavelength scale"].at(0, 1.0)[1]["sensor.wavelength_shift_nm"]
    >>> centre = world.stated.axis.centre_nm
    >>> float(stretched.mean().round(9)), float((np.ptp(stretched) / np.ptp(centre)).round(9))
    (0.0, 0.001)
    >>> level = both["level of all spectra of the ground"].at(0, -4.0)[0]["surfaces.[grass].mean"]
    >>> float(np.abs(level / world.stated.surfaces["grass"].mean - 0.8).max().round(9))
    0.0
    >>> entries = both["entry of a surface"]
    >>> lit, spread = len(entries.labels) - 1, entries.labels.index("covariance of grass in asphalt")
    >>> entries.labels[lit], entries.at(0, lit)[0], sorted(entries.at(0, lit)[1].values())
    ('yellow plank in full light', {}, [1.0, 1.0])
    >>> entries.at(0, spread)
    [{}, {'scene.classes.[asphalt].covariance': {'builtin': 'grass'}}]
    >>> both["host of the targets"].labels, both["host of the targets"].at(0, 0.0)[1]
    (('yellow plank on grass', 'yellow plank on soil'), {'scene.targets.[yellow plank].host': 'grass'})
    >>> plank = {"spectrum": {"builtin": "yellow-paint-plank"}, "host": "asphalt", "fill": {"fixed": 0.1}}
    >>> two = [{"name": name, **plank} for name in "ab"]
    >>> several = rarer_candidates([read_world(stated.with_values({"scene.targets": two}))])
    >>> hosts = next(c for c in several if c.name == "host of the targets")
    >>> hosts.labels[:3], sorted(hosts.at(0, 2.0)[0].values())
    (('a on grass', 'b on grass', 'all targets on grass'), ['grass', 'grass'])
    >>> arm = both["electrons per radiance of 942-2470 nm"]
    >>> [truth["sensor.electrons"].round(9).ravel()[[0, -1]].tolist() for truth in arm.at(0, 2.0)]
    [[1.0, 1.1], [1.0, 1.1]]
    >>> arm = both["wavelength shift of 942-2470 nm"]
    >>> [truth["sensor.wavelength_shift_nm"].ravel()[[0, -1]].tolist() for truth in arm.at(0, 5.0)]
    [[0.0, 1.0], [0.0, 1.0]]
    >>> arm = both["noise without signal of 942-2470 nm"]
    >>> [truth["sensor.fixed_noise"].round(9).ravel()[[0, -1]].tolist() for truth in arm.at(0, -10.0)]
    [[1.0, 0.5], [1.0, 0.5]]
    >>> both["bits of a recorded number"].at(0, 2.0)
    [{'sensor_changes.bits': 12}, {'sensor_changes.bits': 12}]
    >>> [name for name in both if both[name].of_engine]
    ['Angstrom exponent', 'view zenith angle', 'ground height', 'sensor altitude']
    >>> *row, sizes = CAUSES["state"][3]
    >>> slanted = _of_input([read_world(stated.with_values({"atmosphere.view_zenith_deg": 6.0}))], row, sizes)
    >>> slanted.sizes, both["view zenith angle"].sizes, both["ground height"].sizes
    ((-6.0, 5.0, 20.0), (5.0, 20.0), (-1.7, 4.0, 12.0))
    >>> shown("ground height", both["ground height"].sizes[-2])
    {'atmosphere.ground_altitude_km': [0.57, 0.57]}
    {'atmosphere.ground_altitude_km': [0.57, 0.57]}
    >>> both["standard atmosphere"].labels[0], both["standard atmosphere"].at(0, 0.0)
    ('tropical', [{'atmosphere.model': 'tropical'}, {'atmosphere.model': 'tropical'}])
    """
    out, pixels = list[Candidate](), [dict[str, Any]() for _ in worlds]
    entries, hosts = dict[str, list[Truth]](), dict[str, list[Truth]]()
    levels = defaultdict[str, list[dict[str, Array]]](lambda: [{} for _ in worlds])

    def stretched(units: float) -> list[Truth]:
        centres = (world.stated.axis.centre_nm for world in worlds)
        return [_shifted(w, nm=1e-3 * units * (c - c.mean())) for w, c in zip(worlds, centres, strict=True)]

    for number, world in enumerate(worlds):
        scene, alone = world.stated.scenario.scene, partial(_alone, number, len(worlds))
        for kind in (scene.classes, (*scene.panels, *scene.sites), scene.targets):
            means = {s.name: np.asarray(value_at(world, path))[0] for s, path in _field_spectra(kind)}
            for s, path in _field_spectra(kind):
                of_file = [f"spectra of {s.spectrum.file} {s.spectrum.record or ''}".strip()] * bool(s.spectrum.file)
                for name in (f"the spectrum of {s.name}", *of_file, "all spectra of the ground"):
                    levels[name][number][path] = means[s.name]
                entries |= {f"{by} in the place of {s.name}": alone({path: means[by]}) for by in means if by != s.name}
        entries |= {words: alone(truth) for words, truth in _covariances(scene.classes)}
        for t in scene.targets:
            shapes = ((_geometry(t, p), p.fill and p.fill.geometry) for p in t.populations)
            pixels[number] |= {f"{path}.gsd_m": shape.gsd_m for path, shape in shapes if shape}
            path = f"scene.targets.[{t.name}].illumination"
            light = f"light of {t.name}", "scene", f"{path}.beam", "10 %"
            out.append(_of_input(worlds, light, (-9.0, -4.0, 7.0), number))
            entries[f"{t.name} in full light"] = alone({f"{path}.beam": 1.0, f"{path}.sky_view": 1.0})
        for c in scene.classes:
            on = {t.name: {f"scene.targets.[{t.name}].host": c.name} for t in scene.targets if t.host != c.name}
            hosts |= {f"{name} on {c.name}": alone(truth) for name, truth in on.items()}
            if len(on) > 1:
                hosts[f"all targets on {c.name}"] = alone({k: v for truth in on.values() for k, v in truth.items()})
    classes = [{c.name: c for c in world.stated.scenario.scene.classes} for world in worlds]
    for a, b in dict.fromkeys(pair for of in classes for pair in combinations(of, 2)):
        name, pairs = f"fraction of {a} for {b}", [(of[a], of[b]) if {a, b} <= of.keys() else () for of in classes]
        traded = partial(_traded, pairs)
        out.append(Candidate(name, "scene", "0.05 of the area", False, sizes=(-8.0, 8.0), moved=traded))
    names = {str([sorted(means) for means in each]): name for name, each in reversed(levels.items())}
    tried = {f"the spectrum of {s.name}" for world in worlds for s in _of_ground(world)}
    out += [_level(name, levels[name]) for name in names.values() if name not in tried]  # of the same spectra the first
    entries |= _files_changed(levels)
    if any(pixels):
        larger = partial(_levelled, pixels)
        out.append(Candidate("pixel size of the fills", "sensor", "5 %", False, sizes=(-8.0, 12.0), moved=larger))
    out += _of_arms(worlds)
    if all(world.stated.noise is not None for world in worlds):
        words = {f"{bits} bits": [{"sensor_changes.bits": bits} for _ in worlds] for bits in (8, 10, 12, 14, 16)}
        out.append(_one_of("bits of a recorded number", "sensor", words))
    out.append(Candidate("wavelength scale", "sensor", "0.1 %", False, sizes=(-8.0, 8.0), moved=stretched))
    named = {"entry of a surface": entries, "host of the targets": hosts}
    out += [_one_of(name, "scene", each) for name, each in named.items() if each]
    is_engine = all(_there(world, "atmosphere.sensor_altitude_km") for world in worlds)
    return [*out, *(_of_atmosphere(worlds) if is_engine else ())]


def _of_atmosphere(worlds: Sequence[World]) -> list[Candidate]:
    """What is stated of atmosphere, sun and view, at other values.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> at = {"solar_zenith_deg": None, "solar_azimuth_deg": None, "day_of_year": None, "latitude_deg": 43.0,
    ...       "longitude_deg": -77.7, "time_utc": "2012-09-20T16:00:00Z"}
    >>> there = load_scenario("green-planks-grass").with_values({f"atmosphere.{name}": v for name, v in at.items()})
    >>> of = {c.name: c for c in _of_atmosphere([read_world(there)])}
    >>> [of["date of overflight"].at(0, z)[0]["atmosphere.time_utc"][:10] for z in of["date of overflight"].sizes]
    ['2012-08-21', '2012-10-20', '2012-07-22', '2012-11-19']
    >>> of["place on the globe"].labels, of["place on the globe"].at(0, 0.0)
    (('latitude with the other sign', 'longitude with the other sign'), [{'atmosphere.latitude_deg': -43.0}])
    """
    states = [world.stated.scenario.atmosphere for world in worlds]
    rows = {path.partition(".")[2]: (row, sizes) for *row, sizes in CAUSES["state"] for path in row[2:3]}
    out = [_of_input(worlds, *of) for key, of in rows.items() if all(getattr(s, key, None) is not None for s in states)]
    if any(s is not None and s.time_utc for s in states):
        later = partial(_later, worlds, timedelta(days=30))
        out.append(Candidate("date of overflight", "scene", "30 d", False, sizes=(-1.0, 1.0, -2.0, 2.0), moved=later))
    signs = {
        f"{key.partition('_')[0]} with the other sign": [{} if x is None else {f"atmosphere.{key}": -x} for x in values]
        for key in ("latitude_deg", "longitude_deg") if any(values := [getattr(s, key, None) for s in states])
    }  # fmt: skip
    out += [_one_of("place on the globe", "atmosphere", signs)] if signs else []
    models, suns = get_args(AtmosphereModel), tuple(SOLAR_SPECTRA)
    for name, key, words in (("solar spectrum", "solar_spectrum", suns), ("standard atmosphere", "model", models)):
        stated = [getattr(s, key, None) for s in states]
        others = {word: [{f"atmosphere.{key}": word} for _ in worlds] for word in words if word not in stated}
        out.append(_one_of(name, "atmosphere", others))
    return out


def _of_input(
    worlds: Sequence[World], row: Sequence[Any], sizes: Sequence[float], only: int | None = None
) -> Candidate:
    """A number of all scenarios, or of one of them."""
    inputs = [_usual(world, *row) if only in (None, i) else None for i, world in enumerate(worlds)]
    name, kind, _, step = row
    if not step.endswith("%"):  # down to 0 at most, which is what the smallest ones are mistaken for
        least = -min(float(np.min(np.abs(one.nominal))) for one in inputs if one) / float(step.split()[0])
        sizes = tuple(dict.fromkeys(z for z in (max(z, least) for z in sizes) if z))
    return Candidate(name, kind, step, False, tuple(inputs), tuple(sizes))


def _field_spectra(kind: Iterable[Surface]) -> list[tuple[Any, str]]:
    """Surfaces whose spectrum is not measured on the imagery, with the path of their mean."""
    return [(s, f"surfaces.[{s.name}].mean") for s in kind if s.spectrum.measured is None]


def _files_changed(levels: Mapping[str, Sequence[Mapping[str, Array]]]) -> dict[str, list[Truth]]:
    """One file of field spectra in the place of another, or both exchanged, wherever they are read.

    >>> a, b = {"surfaces.[red].mean": np.array([0.1])}, {"surfaces.[green].mean": np.array([0.4])}
    >>> changed = _files_changed({"spectra of a.txt": [a], "spectra of b.txt": [b], "all": [{**a, **b}]})
    >>> for words, (truth,) in changed.items():
    ...     print(words, {path: value.tolist() for path, value in truth.items()})
    spectra of b.txt in the place of spectra of a.txt {'surfaces.[red].mean': [0.4]}
    spectra of a.txt in the place of spectra of b.txt {'surfaces.[green].mean': [0.1]}
    spectra of b.txt exchanged with spectra of a.txt {'surfaces.[green].mean': [0.1], 'surfaces.[red].mean': [0.4]}
    """
    files = [name for name in levels if name.startswith("spectra of ")]
    means = {file: next(mean for each in levels[file] for mean in each.values()) for file in files}
    out = dict[str, list[Truth]]()
    for a, b in combinations(files, 2):
        if means[a].shape == means[b].shape:
            one: list[Truth] = [dict.fromkeys(of, means[b]) for of in levels[a]]
            other: list[Truth] = [dict.fromkeys(of, means[a]) for of in levels[b]]
            out |= {f"{b} in the place of {a}": one, f"{a} in the place of {b}": other}
            out[f"{b} exchanged with {a}"] = [{**i, **j} for i, j in zip(other, one, strict=True)]
    return out


def _level(name: str, means: Sequence[Mapping[str, Array]]) -> Candidate:
    return Candidate(f"level of {name}", "scene", "5 %", False, sizes=(-6.0, 8.0), moved=partial(_levelled, means))


def _levelled(values: Sequence[Mapping[str, Any]], units: float) -> list[Truth]:
    return [{path: (1.0 + 0.05 * units) * value for path, value in each.items()} for each in values]


def arms_of(world: World) -> dict[str, Array]:
    """Arms of a sensor by their wavelengths, 1 in their bands (B,); either side of 1000 nm where none are known."""
    axis, sensor = world.stated.axis, world.stated.sensor
    arms = np.array([axis.centre_nm < 1000.0, axis.centre_nm >= 1000.0])
    if sensor is not None and sensor.specification.arms:
        arms = error_rows(np.ones(len(axis)), SpectralForm(correlation="arms"), axis, sensor) > 0.0
    several = len(arms) > 1 and bool(np.all(np.any(arms, axis=1)))
    return {"{:.0f}-{:.0f} nm".format(*axis.centre_nm[arm][[0, -1]]): 1.0 * arm for arm in arms if several}


def _elsewhere(worlds: Sequence[World], of: Array | float, units: float) -> list[Truth]:
    return [_shifted(world, nm=SHIFT_NM * units * of) for world in worlds]


def _of_arms(worlds: Sequence[World]) -> list[Candidate]:
    """Wavelengths, electrons per radiance and fixed noise of one arm."""
    out = list[Candidate]()
    for where, arm in arms_of(worlds[0]).items():
        noises = {"electrons": "electrons per radiance", "fixed_noise": "noise without signal"}
        for key, name in noises.items() if all(world.stated.noise is not None for world in worlds) else ():
            out.append(_noise(worlds, key, f"{name} of {where}", _SIZES[name], arm))
        name, moved = f"wavelength shift of {where}", partial(_elsewhere, worlds, arm)
        out.append(Candidate(name, "sensor", f"{SHIFT_NM:g} nm", False, sizes=(-25.0, -5.0, 5.0, 25.0), moved=moved))
    return out


def _covariances(classes: Sequence[BackgroundClass]) -> Iterator[tuple[str, Truth]]:
    """Classes whose covariance is stated as that of another one, or of the spectrum it belongs to."""
    for c, other in product(classes, repeat=2):
        for source in filter(None, (other.covariance, other.spectrum)):
            spread = source.model_dump(include={"builtin", "measured", "replicates"}, exclude_none=True)
            if spread and source is not (c.covariance or c.spectrum):
                of = next(iter(spread.values()))
                yield f"covariance of {of} in {c.name}", {f"scene.classes.[{c.name}].covariance": spread}


def _traded(pairs: Sequence[Sequence[BackgroundClass]], units: float) -> list[Truth]:
    """Of each scenario two classes, the first with so much more area, or none."""
    truths = list[Truth]()
    for pair in pairs:
        area = min(max(0.05 * units, -pair[0].fraction), pair[1].fraction) if pair else 0.0
        changed = zip(pair, (area, -area), strict=False)
        truths.append({f"scene.classes.[{c.name}].fraction": c.fraction + more for c, more in changed})
    return truths


def _alone(number: int, of: int, truth: Truth) -> list[Truth]:
    """What is moved in one scenario."""
    return [truth if i == number else {} for i in range(of)]


def _one_of(name: str, kind: str, truths: Mapping[str, Sequence[Truth]]) -> Candidate:
    each = [list(truth) for truth in truths.values()]
    return Candidate(name, kind, "", False, labels=tuple(truths), moved=lambda i: each[int(i)])


NORMAL_DOF = 1e6  # degrees of freedom of tails that are left out


class NotInjectable(UsageError):
    """An error of something that the scenario does not have."""


def injected_errors() -> dict[str, Family]:
    """The standard errors by name, each of its size, in the order of the power table."""
    made = {
        f.__name__: f for f in (_times, _shifted, _without_tails, _exchanged, _other_material, _fine_texture, _line)
    }
    return {name: partial(made[f"_{what}"], **of) for name, (what, of) in CAUSES["errors"].items()}


def errors_of_file(path: Path) -> dict[str, Family]:
    """Errors of a user's own: name -> {path: value}, or the name alone of a standard one.

    Raises
    ------
    UsageError : a name that is no standard error, or something else than paths and values.
    """
    (entries, _), standard = load_yaml(path), injected_errors()
    out: dict[str, Family] = {}
    for name, values in entries.items():
        refuse(values is None and name not in standard, "attribution.error", path, name=name)
        refuse(values is not None and not isinstance(values, dict), "attribution.errors", path)
        out[str(name)] = standard[name] if values is None else partial(lambda moves, _: moves, values)
    return out


def injected_prediction(
    scenario: Scenario, error: Family, origins: Origins | None = None, *, objects: bool | int = False
) -> tuple[PredictedProducts, Truth]:
    """The prediction of a scenario with one error injected, its budget as stated; and the truth behind it.

    Raises
    ------
    NotInjectable : the scenario has nothing of the kind.
    UsageError : a path that is none, and is nearly one of the scenario's; a value that the model does not take.

    Examples
    --------
    >>> from hyperval.api import load_scenario
    >>> scenario = load_scenario("panels").with_values({"atmosphere.engine": "emulator"})
    >>> gains = 1.0, np.linspace(1.0, 1.02, 360).tolist()
    >>> seen = [injected_prediction(scenario, lambda _, x=x: {"line.gain": x})[0].reflectance["grass"] for x in gains]
    >>> of, more = (estimate.pixel_covariance for estimate in seen)
    >>> bool(np.allclose(more, np.outer(gains[1], gains[1]) * of)), float(seen[1].mean[-1] / seen[0].mean[-1])
    (True, 1.02)
    >>> noise, tail = "sensor.noise", "scene.classes.grass.tail_dof"
    >>> for path, value in (noise, float("nan")), (noise, "loud"), (noise, [1.0, [2.0]]), (tail, 2.0):
    ...     try:
    ...         injected_prediction(scenario, lambda _: {path: value})
    ...     except UsageError as error:
    ...         print(error.what, "expected:", error.expected)
    sensor.noise at nan expected: a number from 0.001, or a list of 360
    sensor.noise at 'loud' expected: a number from 0.001, or a list of 360
    sensor.noise at [1.0, [2.0]] expected: a number from 0.001, or a list of 360
    scene.classes.grass.tail_dof at 2.0 expected: a number above 2
    """
    world = read_world(scenario, origins)
    try:
        truth = error(world)
        for path in truth:
            value_at(world, path)
    except UsageError as why:
        raise (UsageError if why.mend else NotInjectable)(why.what, expected=why.expected, mend=why.mend) from why
    check_numbers(world, truth)
    prediction = predict(scenario, origins, truth=truth, objects=objects)
    if {"line.gain", "line.offset"} & truth.keys():  # what was collected is through its own line: it shows in its own
        gain, offset = (np.asarray(truth.get(f"line.{name}", x)) for name, x in (("gain", 1.0), ("offset", 0.0)))
        shown = {name: _through_line(estimate, gain, offset) for name, estimate in prediction.reflectance.items()}
        prediction = replace(prediction, reflectance=shown)
    return prediction, truth


def _each(world: World, path: str) -> dict[str, Any]:
    """What stands at a path, or at that of each class or target, where it speaks of them."""
    what = "target" if "{target}" in path else "class"
    names = _names(world, what) if "{" in path else [""]
    paths = [path.replace(f"{{{what}}}", name) for name in names]
    return {each: np.asarray(value_at(world, each)[0], dtype=float) for each in paths}


def _names(world: World, what: str) -> list[str]:
    """Classes, those that cover most first; or targets."""
    scene = world.stated.scenario.scene
    names = [x.name for x in (scene.targets if what == "target" else sorted(scene.classes, key=lambda c: -c.fraction))]
    refuse(not names, "attribution.none", what=f"there is no {what}")
    return names


def _times(world: World, *, path: str, factor: float) -> Truth:
    nominal = _each(world, path)
    refuse(not any(map(np.any, nominal.values())), "attribution.none", what=f"{path} is 0")
    return {each: factor * value for each, value in nominal.items()}


def _shifted(world: World, *, bands: float = 0.0, nm: float | Array = 0.0) -> Truth:
    """True band centres off by a part of each band's width, or by so much; spectra may end before such a band."""
    moves: dict[str, Any] = {"sensor.wavelength_shift_nm": bands * world.stated.axis.fwhm_nm + nm}
    for key in ("classes", "panels", "sites", "targets"):
        for s in getattr(world.stated.scenario.scene, key):
            if s.spectrum.measured is None:
                moves[f"scene.{key}.[{s.name}].spectrum.gaps"] = "allowed"
    return moves


def _without_tails(world: World) -> Truth:
    heavy = {path: NORMAL_DOF for path, dof in _each(world, "surfaces.[{class}].tail_dof").items() if dof < NORMAL_DOF}
    refuse(not heavy, "attribution.none", what="no class has tails")
    return heavy


def _other_material(world: World) -> Truth:
    """Of the built-in materials the one that is least like the target."""
    others = [builtin_mean(n, world.stated.axis) for n in BUILTIN_NAMES if not n.endswith("NN")]
    means = _each(world, "surfaces.[{target}].mean").items()
    return {path: max(others, key=lambda mean: float(np.nanmean((mean - stated) ** 2))) for path, stated in means}


def _fine_texture(world: World) -> Truth:
    """All of the targets' spread."""
    names = [name for name in _names(world, "target") if np.any(world.stated.surfaces[name].covariance)]
    refuse(not names, "attribution.none", what="no target has a spread")
    return {f"surfaces.[{name}].fine_texture": 1.0 for name in names}


def _exchanged(world: World, names: Sequence[str] = (), what: str = "surface") -> Truth:
    """Each surface has the mean spectrum of the next one, where that is known; the two classes that cover most."""
    names = names or (_names(world, what)[:2] if what == "class" else _names(world, what))
    refuse(len(names) < 2, "attribution.none", what=f"there is one {what}")
    moves = {}
    for name, other in zip(names, (*names[1:], names[0]), strict=True):
        mean, other_mean = world.stated.surfaces[name].mean, world.stated.surfaces[other].mean
        moves[f"surfaces.[{name}].mean"] = np.nan_to_num(np.where(np.isfinite(other_mean), other_mean, mean))
    return moves


def _line(world: World, *, gain: float, offset: float) -> Truth:
    """An empirical line that is off for the detectors; where reflectance was collected, in the surfaces' own."""
    if world.stated.scenario.atmosphere is None:
        return {"sensor.gain": gain, "sensor.offset": offset}
    refuse(world.stated.scenario.processing.elm == "none", "attribution.none", what="there is no empirical line")
    return {"line.gain": gain, "line.offset": offset}


def _through_line(estimate: SpectralEstimate, gain: Array, offset: Array) -> SpectralEstimate:
    pixels = None if estimate.pixel_covariance is None else np.multiply.outer(gain, gain) * estimate.pixel_covariance
    return replace(estimate, mean=gain * estimate.mean + offset, pixel_covariance=pixels)

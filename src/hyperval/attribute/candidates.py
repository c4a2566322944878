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
from itertools import chain, combinations, product
from pathlib import Path
from typing import Any, get_args

import numpy as np

from hyperval.atmosphere.solar import SPECTRA as SOLAR_SPECTRA
from hyperval.atmosphere.solar import parse_utc
from hyperval.atmosphere.state import AtmosphereModel, AtmosphericState
from hyperval.config import load_yaml
from hyperval.data import Array
from hyperval.errors import UsageError, package_table, refuse
from hyperval.model import Origins, Truth, UncertainInput, number_input, predict, read_world, uncertain_inputs, value_at
from hyperval.model.inputs import Kind, correlation_words, error_rows, field_spectrum_of, spectral_input
from hyperval.model.world import World, check_numbers
from hyperval.products import PredictedProducts, SpectralEstimate
from hyperval.scenario import BackgroundClass, Scenario, SpectralForm, Surface, Target, TargetSubject
from hyperval.statistics_library import BUILTIN_NAMES, builtin_mean

Perturbation = Callable[[World], Truth]  # what stands where with an error, for what a scenario says
Moved = Callable[[int, Any], Truth]

# Directions of an input that move all that is compared at once: of a smooth error nearly all of its variance, of a
# rough one little.  The rest counts for each spectrum by itself (``excess_covariance``), and not for scores.
MAX_DIRECTIONS = 8
# A direction that would have to move farther is no reason: stated uncertainties, usual steps, steps of a smooth gain
# or offset (half of the radiance).
MAX_UNITS, MAX_STEPS, MAX_SMOOTH = 10.0, 200.0, 16.0
SHIFT_NM = 0.2
SINGLE_BANDS = "single bands"
# A surface that is described by another one of its kind: part of its reflectance, over so many nm together, along
# the directions that hold nine tenths of its variance between 400 and 2500 nm.
SURFACE, SURFACE_NM, SURFACE_DIRECTIONS = 0.10, 300.0, 4
_BELOW, _ABOVE = 1.6, 2.0
# Tables of what may be wrong, and where the model is asked for it.
CAUSES = package_table("attribute/causes.yaml")
_SIZES: dict[str, list[float]] = {name: sizes for name, *_, sizes in CAUSES["usual"]} | CAUSES["sizes"]
_LEAST, _MOST = 0.05, 10.0  # factors that a change may have on what is given in parts
LIGHT = ("sunlight", "path radiance", "spherical albedo")
# Of spectra in another unit; what the brightest bands of a reflectance are at least, and at most.
SCALES, DARKEST, BRIGHTEST = (0.01, 0.1, 10.0, 100.0), 0.02, 1.5
HEIGHTS = ("sensor altitude", "ground height")
HAZES = ("rural", "continental", "maritime", "urban", "desert")


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
    members : of each scenario its truth so many units along a direction, or by the label of an alternative; None where
        nothing is moved
    sizes : of one thing, in units: where the model is asked; without one it is a set of directions
    labels : of alternatives
    path, size : of an input, with the directions that are followed
    """

    name: str
    kind: str
    step: str
    budgeted: bool
    members: tuple[Moved | None, ...] = field(default=(), compare=False, repr=False)
    sizes: tuple[float, ...] = field(default=(), compare=False)
    labels: tuple[str, ...] = field(default=(), compare=False)
    unbounded: bool = field(default=False, compare=False)
    knots_nm: tuple[float, ...] = field(default=(), compare=False)
    path: str = field(default="", compare=False)
    size: int = field(default=1, compare=False)

    @property
    def unit(self) -> str:
        """One unit in a sentence."""
        return "stated uncertainty" if self.budgeted else f"step of {self.step}".removesuffix(" of ")

    @property
    def max_units(self) -> float:
        """Units that it may go: ten stated uncertainties, 200 usual steps, or half of the radiance."""
        if self.knots_nm:
            return MAX_SMOOTH
        return MAX_UNITS if self.budgeted and not self.unbounded else MAX_STEPS

    @property
    def size_limits(self) -> tuple[float, float]:
        """Least and greatest size that it may have; no factor lies below 0.

        >>> depth = Candidate("depth", "atmosphere", "10 %", False, sizes=(-5.0, 10.0))
        >>> [replace(depth, unbounded=of_a_change).size_limits for of_a_change in (False, True)]
        [(-8.0, 20.0), (-9.5, 90.0)]
        >>> Candidate("scale", "sensor", "0.1 %", False, sizes=(-8.0, 8.0), unbounded=True).size_limits
        (-12.8, 32.0)
        >>> Candidate("light of a target", "scene", "10 %", False, sizes=(-9.0, 7.0)).size_limits
        (-10.0, 14.0)
        """
        number, _, unit = self.step.partition(" ")
        low, high = _BELOW * min(0.0, *self.sizes), (1.0 + self.unbounded) * _ABOVE * max(0.0, *self.sizes)
        if self.budgeted:
            return min(low, -self.max_units), max(high, self.max_units)
        whole = 100.0 / float(number) if unit == "%" else math.inf
        if self.unbounded and whole <= 100.0:
            low, high = min(low, (_LEAST - 1.0) * whole), max(high, (_MOST - 1.0) * whole)
        return max(low, -whole), high

    def truths(self, direction: int, units: float) -> list[Truth]:
        """The truth of each scenario so many units along one direction, or of the alternative of that number."""
        amount = self.labels[int(units)] if self.labels else units
        return [{} if moved is None else moved(direction, amount) for moved in self.members]

    @property
    def fits_any_spectrum(self) -> bool:
        """Whether it can make nearly any change of a spectrum, band by band."""
        return self.name == SINGLE_BANDS or (self.kind == "surface" and not self.sizes)

    @property
    def needs_engine(self) -> bool:
        """Whether each value of it takes a run of the engine."""
        return self.path.startswith("atmosphere.")

    def for_scenario(self, number: int, scenario: str) -> Candidate:
        """The same in one scenario.

        >>> later = Candidate("time", "scene", "1 h", False, 2 * (lambda _, z: {"hour": 9 + z},), (1.0,))
        >>> second = later.for_scenario(1, "line 2")
        >>> second.name, second.truths(0, 1.0)
        ('time in line 2', [{}, {'hour': 10.0}])
        """
        members = tuple(moved if i == number else None for i, moved in enumerate(self.members))
        return replace(self, name=f"{self.name} in {scenario}", members=members)

    def describe(self, amplitudes: Array) -> str:
        """How far it is from what is stated.

        >>> gain = Candidate("smooth gain", "sensor", "3 % in smooth pieces", False, knots_nm=(400.0, 600.0))
        >>> gain.describe(np.array([-4.0, 1.0]))
        '-12 % at 400 nm and less elsewhere'
        >>> aod = Candidate("depth", "atmosphere", "10 %", False, sizes=(1.0, -1.0))
        >>> aod.describe(np.array([5.0])), aod.describe(np.array([0.004]))
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


def merge_candidates(scenarios: Iterable[Iterable[Candidate]]) -> list[Candidate]:
    """Candidates of one name in several scenarios as one that moves all of these, by sizes that each of them allows.

    >>> each = [_candidate("date", "scene", "1 d", (z, 9.0), lambda z: {"day": z}) for z in (-9.0, -2.0)]
    >>> (both,) = merge_candidates([each[:1], each[1:]])
    >>> both.sizes, both.truths(0, 9.0)
    ((-2.0, 9.0), [{'day': 9.0}, {'day': 9.0}])
    >>> one, other = (next(_alternatives("haze", "atmosphere", {name: {"haze": name}})) for name in ("rural", "urban"))
    >>> date, haze = merge_candidates([[each[0], one], [other]])
    >>> date.truths(0, 2.0), haze.labels, haze.truths(0, 1)
    ([{'day': 2.0}, {}], ('rural', 'urban'), [{}, {'haze': 'urban'}])
    """
    by_name = [{c.name: c for c in candidates} for candidates in scenarios]
    out = list[Candidate]()
    for name in dict.fromkeys(name for candidates in by_name for name in candidates):
        namesakes = [candidates[name] for candidates in by_name if name in candidates]
        least = max(min(c.sizes, default=0.0) for c in namesakes)
        sizes = tuple(dict.fromkeys(max(z, least) for z in namesakes[0].sizes))
        labels = tuple(dict.fromkeys(label for c in namesakes for label in c.labels))
        members = tuple(candidates[name].members[0] if name in candidates else None for candidates in by_name)
        size = max(c.size for c in namesakes)
        out.append(replace(namesakes[0], members=members, sizes=sizes, labels=labels, size=size))
    return out


def _candidate(name: str, kind: str, step: str, sizes: Sequence[float], truth: Callable[[float], Truth]) -> Candidate:
    """A candidate that is no input of the scenario: ``truth`` moves it by so many units."""
    return Candidate(name, kind, step, False, (lambda _, units: truth(units),), tuple(sizes))


def _alternatives(name: str, kind: str, truths: Mapping[str, Truth]) -> Iterator[Candidate]:
    """Alternatives of a scenario by their labels; nothing where there are none."""
    if truths:
        yield Candidate(name, kind, "", False, (lambda _, label: truths.get(label, {}),), labels=tuple(truths))


def _input_candidate(item: UncertainInput, sizes: tuple[float, ...], *, budgeted: bool = False) -> Candidate:
    """An input along its leading directions.

    >>> few, many = (UncertainInput("gain", "sensor", "sensor.gain", np.ones(20), np.eye(20)[:k]) for k in (2, 12))
    >>> (both,) = merge_candidates([[_input_candidate(few, ())], [_input_candidate(many, ())]])
    >>> both.size, [list(moved) for moved in both.truths(3, 1.0)]
    (8, [[], ['sensor.gain']])
    """

    def truth(direction: int, units: float) -> Truth:
        return item.perturbation_along(direction, units) if direction < item.size else {}

    size = min(item.size, MAX_DIRECTIONS)
    return Candidate(item.name, item.kind, item.correlation, budgeted, (truth,), sizes, path=item.path, size=size)


def _number_input(world: World, name: str, kind: Kind, path: str, step: str, sizes: Sequence[float]) -> Candidate:
    """A number, of which one unit is a step in its own unit or in percent of what stands there; in its own unit down to
    0 at most, which is what the smallest ones are mistaken for.
    """
    size = float(step.split()[0])
    one = number_input(world, name, kind, path, size, words=step)
    if step.endswith("%"):
        return _input_candidate(replace(one, rows=size / 100.0 * one.nominal[None, :]), tuple(sizes))
    least = -float(np.min(np.abs(one.nominal))) / size
    return _input_candidate(one, tuple(z for z in dict.fromkeys(max(z, least) for z in sizes) if z))


def every_input(worlds: Sequence[World], further: Iterable[Candidate]) -> list[Candidate]:
    """Inputs with a stated uncertainty, and the others that may be wrong, with a typical one.

    ``further`` : of :func:`further_candidates`, which give the range of a stated input too

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> stated = {"solar_zenith_deg": 0.1, "wavelength_shift": {"absolute": 0.02, "correlation": "systematic"}}
    >>> spectra = {"grass": {"correlation": "systematic"}, "asphalt": {"correlation_nm": 100.0}}
    >>> stated["field_spectra"] = [{"subject": name, "relative": 0.02, **of} for name, of in spectra.items()]
    >>> world = read_world(load_scenario("yellow-planks-asphalt").with_values({"uncertainty": stated}))
    >>> for c in every_input([world], further_candidates([world])):
    ...     if c.budgeted:
    ...         print(c.name, [round(size) for size in c.sizes[:4]])
    solar zenith angle [10, -10, -50, 50]
    field spectrum of asphalt []
    field spectrum of grass [1, -1]
    wavelength shift [10, -10, -500, -250]
    """
    usual = merge_candidates([usual_inputs(world) for world in worlds])
    stated = merge_candidates([stated_inputs(world, [*usual, *further]) for world in worlds])
    stated_paths = {c.path for c in stated}
    return [*stated, *(c for c in usual if c.path not in stated_paths)]


def stated_inputs(world: World, usual: Iterable[Candidate]) -> Iterator[Candidate]:
    """The inputs of a stated uncertainty.

    A number with a small uncertainty is evaluated at the sizes of one without: a mistake in the file may be as large.

    Parameters
    ----------
    usual : candidates of the same inputs without a stated uncertainty

    Examples
    --------
    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> share = {"subject": "grass", "absolute": 0.002}
    >>> world = read_world(load_scenario("yellow-planks-asphalt").with_values({"uncertainty.fractions": [share]}))
    >>> (stated,) = (c for c in stated_inputs(world, usual_inputs(world)) if c.path == "fraction.[grass]")
    >>> [round(size) for size in stated.sizes], [round(end) for end in stated.size_limits]  # of 0.002 in 0.3
    ([15, -15, -75, 75], [-120, 150])
    >>> wide = world.stated.scenario.with_values({"uncertainty.fractions": [share | {"absolute": 0.1}]})
    >>> [c.sizes for c in stated_inputs(read_world(wide), usual_inputs(world)) if c.path == "fraction.[grass]"]
    [(1.0, -1.0)]
    """
    by_key = {key: c for c in usual if c.sizes for key in (c.name, c.path)}
    for item in uncertain_inputs(world):
        sizes: tuple[float, ...] = (1.0, -1.0) if item.size == 1 else ()
        if sizes and (other := by_key.get(item.path, by_key.get(item.name))) is not None:
            number, _, unit = other.step.partition(" ")
            step = float(number) * (float(np.max(np.abs(item.nominal))) / 100.0 if unit == "%" else 1.0)
            ratio = step / float(np.max(np.abs(item.rows)))
            sizes = tuple(ratio * z for z in other.sizes) if ratio > 1.0 else sizes
        yield _input_candidate(item, sizes, budgeted=True)


def usual_inputs(world: World) -> Iterator[Candidate]:
    """Every input of a scenario that may be off, with a usual uncertainty.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> heavy = load_scenario("yellow-planks-asphalt").with_values({"scene.classes.grass.tail_dof": 8.0})
    >>> found = {c.name: c for c in usual_inputs(read_world(heavy))}
    >>> [name for name in found if name.startswith("tails")], found["field spectrum of grass"].size
    (['tails of grass'], 4)
    """
    names = [c.name for c in world.stated.scenario.scene.classes]
    shares = [name for name in names if _has_number(world, f"fraction.[{name}]")]
    # Two fractions sum to 1: the second is the same input.
    subjects = {"{class}": names, "{share}": shares[:1] if len(names) == 2 else shares}
    for name, kind, path, step, sizes in CAUSES["usual"]:
        placeholder = next((key for key in subjects if key in path), "")
        for subject in subjects.get(placeholder, [""]):
            if _has_number(world, filled := path.replace(placeholder, subject)):
                yield _number_input(world, name.replace(placeholder, subject), kind, filled, step, (1.0, -1.0, *sizes))
    # Mean spectra that were not measured in the collection.  Those of targets are left out: mixed with their hosts
    # they have the effect of the fill fraction, which is a candidate already.
    form = SpectralForm(correlation_nm=SURFACE_NM)
    for s, path in _field_spectra(_ground_surfaces(world)):
        sd = SURFACE * np.nan_to_num(world.stated.surfaces[s.name].mean)
        one = spectral_input(world, field_spectrum_of(s.name), "surface", path, sd, form)
        words = f"{100 * SURFACE:g} %, {correlation_words(form)}"
        yield _input_candidate(replace(one, rows=one.rows[:SURFACE_DIRECTIONS], correlation=words), ())


def _ground_surfaces(world: World) -> Iterator[Surface]:
    return chain(*_interchangeable(world)[:2])


def _interchangeable(world: World) -> tuple[Sequence[Surface], ...]:
    """Surfaces that may be taken for each other: classes, panels and sites, targets."""
    scene = world.stated.scenario.scene
    return scene.classes, (*scene.panels, *scene.sites), scene.targets


def _atmospheric_state(world: World) -> AtmosphericState | None:
    """What is stated of the atmosphere; a table is of one state.

    >>> from types import SimpleNamespace as Of
    >>> kinds = "sixs", "table"
    >>> [_atmospheric_state(Of(stated=Of(scenario=Of(atmosphere=Of(engine=kind))))) is None for kind in kinds]
    [False, True]
    """
    state = world.stated.scenario.atmosphere
    return None if state is None or state.engine == "table" else state


def _has_number(world: World, path: str) -> bool:
    """Whether a scenario has a number other than 0 at a path."""
    if path.startswith("atmosphere.") and _atmospheric_state(world) is None:
        return False
    try:
        value = np.asarray(value_at(world, path), dtype=float)
        return bool(np.any(np.isfinite(value) & (value != 0.0)))
    except UsageError:
        return False


def further_candidates(worlds: Sequence[World]) -> list[Candidate]:
    """No numbers: bands elsewhere, another time or haze, spectra at another level, exchanged or in another unit.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> world = read_world(load_scenario("yellow-planks-asphalt"))
    >>> of = {c.name: c for c in further_candidates([world, world])}
    >>> [truth["sensor.band_width"] for truth in of["band width"].truths(0, 2.0)]
    [1.2, 1.2]
    >>> grass = of["level of the spectrum of grass"]
    >>> mean = world.stated.surfaces["grass"].mean
    >>> [float(np.median(truth["surfaces.[grass].mean"] / mean).round(9)) for truth in grass.truths(0, 2.0)]
    [1.1, 1.1]
    >>> scale, some = of["scale of a spectrum"], ("grass", "black", "yello")  # that leaves a reflectance
    >>> [label for i, label in enumerate(scale.labels) if any(scale.truths(0, i)) and label[:5] in some]
    ['grass x 0.1', 'black panel x 10', 'yellow plank x 0.1 or of another material']
    >>> of["exchanged spectra or regions"].labels[:1], "rural" in of["aerosol type"].labels
    (('asphalt and grass',), False)
    >>> clear = {"atmosphere.aerosol": "none", "atmosphere.meteorological_range_km": None}
    >>> clear["scene.targets.[yellow plank].subjects.0.fill"] = {"geometry": {"side_m": 0.4, "gsd_m": 1.0}}
    >>> names = {c.name for c in further_candidates([read_world(world.stated.scenario.with_values(clear))])}
    >>> {"date of overflight", "size of yellow plank"} <= names, "aerosol type" in names
    (True, False)
    """
    return merge_candidates([_further_candidates(world) for world in worlds])


def _further_candidates(world: World) -> Iterator[Candidate]:
    stated, state = world.stated, _atmospheric_state(world)
    scene, sizes = stated.scenario.scene, (1.0, -1.0, -50.0, -25.0, -5.0, 5.0, 25.0, 50.0)
    yield _candidate("wavelength shift", "sensor", f"{SHIFT_NM:g} nm", sizes, partial(_band_shift, world, 1.0))

    def broadened(units: float) -> Truth:  # or spectra that were smoothed over bands
        return {**_shifted(world), "sensor.band_width": 1.0 + 0.1 * units}

    yield _candidate("band width", "sensor", "10 %", (-4.0, 10.0, 30.0), broadened)
    if state is not None and state.time_utc:
        yield _candidate("time of overflight", "scene", "1 h", (1.0, -1.0), partial(_delay, state, timedelta(hours=1)))
    elif state is not None and state.solar_zenith_deg is not None:
        path, angles = "atmosphere.solar_zenith_deg", (1.0, -1.0, -5.0, 5.0)
        yield _number_input(world, "solar zenith angle", "scene", path, "1 deg", angles)
        if state.day_of_year:
            months, day = (-2.0, -1.0, 1.0, 2.0, 4.0, 6.0), partial(_shifted_day, state.day_of_year)
            yield _candidate("date of overflight", "scene", "30 d", months, day)
    if stated.noise is not None:
        yield _noise_candidate("fixed_noise", "noise without signal", (1.0, -1.0, *_SIZES["noise without signal"]))
    for name in dict.fromkeys(p.name for _, _, p in stated.populations):
        yield _number_input(world, f"fill fraction of {name}", "scene", f"fill.[{name}]", "5 %", (-10.0, 12.0))
    if len(scene.targets) > 1 or any(_side_m(p) for t in scene.targets for p in t.populations):
        yield from (_size_candidate(world, target) for target in scene.targets)
    for s, path in _field_spectra(_ground_surfaces(world)):
        yield _level_candidate(f"the spectrum of {s.name}", {path: value_at(world, path)[0]})
    if state is not None and state.aerosol in HAZES:
        hazes = {haze: {"atmosphere.aerosol": haze} for haze in HAZES if haze != state.aerosol}
        yield from _alternatives("aerosol type", "atmosphere", hazes)
    pairs = [names for kind in _interchangeable(world) for names in combinations([x.name for x in kind], 2)]
    exchanged = {" and ".join(names): _exchanged(world, names) for names in pairs}
    scaled = dict(item for kind in _interchangeable(world) for item in _scale_errors(world, kind))
    yield from _alternatives("exchanged spectra or regions", "scene", exchanged)
    yield from _alternatives("scale of a spectrum", "scene", scaled)


def _scale_errors(world: World, kind: Sequence[Surface]) -> Iterator[tuple[str, Truth]]:
    """Field spectra in another unit; of targets, whose scores do not tell, or others in their place.

    What is no reflectance then moves nothing: it keeps its part of what is thought likely before.
    """
    for s, path in _field_spectra(kind):
        level, other = np.nan_to_num(world.stated.surfaces[s.name].mean), isinstance(s, Target)
        for x in SCALES:
            possible = DARKEST <= np.percentile(x * level, 95) <= BRIGHTEST
            yield f"{s.name} x {x:g}{' or of another material' * other}", {path: x * level} if possible else {}


def _delay(state: AtmosphericState, step: timedelta, units: float) -> Truth:
    """Another time of overflight; another day at the same hour.

    >>> from hyperval.api import load_scenario
    >>> at = {"solar_zenith_deg": None, "solar_azimuth_deg": None, "day_of_year": None, "latitude_deg": 43.0,
    ...       "longitude_deg": -77.7, "time_utc": "2012-09-20T16:00:00Z"}
    >>> scenario = load_scenario("green-planks-grass")
    >>> state = scenario.with_values({f"atmosphere.{name}": value for name, value in at.items()}).atmosphere
    >>> _delay(state, timedelta(hours=1), -2.0), _delay(state, timedelta(days=30), 0.52)
    ({'atmosphere.time_utc': '2012-09-20T14:00:00+00:00'}, {'atmosphere.time_utc': '2012-10-06T16:00:00+00:00'})
    """
    delay = units * step if step < timedelta(days=1) else timedelta(days=round(units * step.days))
    return {"atmosphere.time_utc": (parse_utc(str(state.time_utc)) + delay).isoformat()}


def _shifted_day(day: int, units: float) -> Truth:
    """Another day of the year.

    >>> _shifted_day(264, 4.0), _shifted_day(10, 4.0)
    ({'atmosphere.day_of_year': 19}, {'atmosphere.day_of_year': 130})
    """
    return {"atmosphere.day_of_year": (round(day + 30.0 * units) - 1) % 365 + 1}


def _noise_candidate(key: str, name: str, sizes: Sequence[float], arm: Array | float = 1.0) -> Candidate:
    """Electrons per radiance or fixed noise of another size, in the bands of an ``arm`` (B,)."""
    return _candidate(name, "sensor", "5 %", sizes, lambda units: {f"sensor.{key}": 1.0 + 0.05 * units * arm})


def _size_candidate(world: World, target: Target) -> Candidate:
    """Targets of another size than stated: their sides, where fills follow from those; else their fills.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> world = read_world(load_scenario("green-planks-grass"))
    >>> sized = _size_candidate(world, world.stated.scenario.scene.targets[0])
    >>> {path: fill.round(9).tolist() for path, fill in sized.truths(0, 2.0)[0].items()}  # sides longer by 10 %
    {'fill.[green plank 0.1]': [0.121], 'fill.[green plank 0.2]': [0.242], 'fill.[green plank 0.4]': [0.484]}
    """

    def resized(units: float) -> Truth:
        factor, truth = 1.0 + 0.05 * units, dict[str, Any]()
        for p in target.populations:
            if side := _side_m(p):
                truth[f"{_geometry_path(target, p)}.side_m"] = factor * side
            else:
                fill = np.asarray(value_at(world, f"fill.[{p.name}]"), dtype=float)[0]
                truth[f"fill.[{p.name}]"] = np.minimum(factor**2 * fill, 1.0)
        return truth

    return _candidate(f"size of {target.name}", "scene", "5 %", (-6.0, 8.0), resized)


def _side_m(p: TargetSubject) -> float | None:
    return p.fill.geometry.side_m if p.fill is not None and p.fill.geometry is not None else None


def _geometry_path(target: Target, p: TargetSubject) -> str:
    return f"scene.targets.[{target.name}]{f'.subjects.[{p.name}]' if target.subjects else ''}.fill.geometry"


def entry_candidates(worlds: Sequence[World], looked_for: Mapping[str, Any]) -> list[Candidate]:
    """Spectra of targets and of classes in the file, which move what goes with them: what the model's filters look for,
    covariances.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> scenario = load_scenario("yellow-planks-asphalt")
    >>> (classes,) = entry_candidates([read_world(scenario)], {})
    >>> classes.labels[0], classes.truths(0, 0.0)[0]
    ('asphalt: that of grass', {'scene.classes.[asphalt].spectrum': {'builtin': 'grass'}})
    """
    return merge_candidates([_entry_candidates(world, looked_for) for world in worlds])


def _entry_candidates(world: World, looked_for: Mapping[str, Any]) -> Iterator[Candidate]:
    for kind, others in (("targets", looked_for), ("classes", {})):
        items, truths = getattr(world.stated.scenario.scene, kind), dict[str, Truth]()
        spectra = {x.name: x.spectrum.model_dump(exclude_none=True, exclude_defaults=True) for x in items}
        for words, changed in substitutions(spectra, others, "looked for").items():
            truths[words] = {f"scene.{kind}.[{name}].spectrum": entry for name, entry in changed.items()}
        yield from _alternatives(f"spectra of {kind} in the file", "scene", truths)


def substitutions(named: Mapping[str, Any], others: Mapping[str, Any], what: str) -> dict[str, dict[str, Any]]:
    """Changes of named entries where one takes the place of another, or two are exchanged.

    Parameters
    ----------
    named, others : entries, and further ones that may stand there; ``what`` is said of those of the same name

    Examples
    --------
    >>> substitutions({"red": 1, "green": 1}, {"green": 2}, "looked for")
    {'red: that of green': {'red': 2}, 'green: that looked for': {'green': 2}}
    """
    entries = {str(entry): (owner, entry) for owner, entry in (*others.items(), *named.items())}.values()
    tried = [(name, owner, entry) for name, (owner, entry) in product(named, entries) if entry != named[name]]
    out = {f"{name}: that {what if owner == name else f'of {owner}'}": {name: entry} for name, owner, entry in tried}
    return out | exchanged_pairs(named)


def exchanged_pairs(named: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Two of named entries in each other's place, by the names of both.

    >>> exchanged_pairs({"red": 1, "green": 2, "blue": 1})
    {'red and green': {'red': 2, 'green': 1}, 'green and blue': {'green': 1, 'blue': 2}}
    """
    return {f"{i} and {j}": {i: named[j], j: named[i]} for i, j in combinations(named, 2) if named[i] != named[j]}


def rarer_candidates(worlds: Sequence[World]) -> list[Candidate]:
    """Candidates for a change that the usual ones do not explain: field spectra at another level, one of them or the
    covariance of another in its place, fractions traded between two classes, shade, electrons of one arm, a stretched
    wavelength scale, heights, the view direction, another date or solar spectrum.

    Examples
    --------
    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> hazy = {"meteorological_range_km": None, "aot550": 0.2, "angstrom_exponent": 1.2}
    >>> stated = load_scenario("yellow-planks-asphalt")
    >>> world = read_world(stated.with_values({f"atmosphere.{name}": value for name, value in hazy.items()}))
    >>> both = {c.name: c for c in reversed(rarer_candidates([world, world]))}
    >>> def shown(name, units):
    ...     for truth in both[name].truths(0, units):
    ...         print({path: np.round(value, 3).ravel()[[0, -1]].tolist() for path, value in truth.items()})
    >>> shown("light of yellow plank", -4.0)  # as stated it lies in full light
    {'scene.targets.[yellow plank].illumination.beam': [0.6, 0.6]}
    {'scene.targets.[yellow plank].illumination.beam': [0.6, 0.6]}
    >>> shown("fraction of asphalt for grass", 2.0)
    {'scene.classes.[asphalt].fraction': [0.7, 0.7], 'scene.classes.[grass].fraction': [0.2, 0.2]}
    {'scene.classes.[asphalt].fraction': [0.7, 0.7], 'scene.classes.[grass].fraction': [0.2, 0.2]}
    >>> stretched = both["wavelength scale"].truths(0, 1.0)[1]["sensor.wavelength_shift_nm"]
    >>> centre = world.stated.axis.centre_nm
    >>> float(stretched.mean().round(9)), float((np.ptp(stretched) / np.ptp(centre)).round(9))
    (0.0, 0.001)
    >>> level = both["level of all spectra of the ground"].truths(0, -4.0)[0]["surfaces.[grass].mean"]
    >>> float(np.abs(level / world.stated.surfaces["grass"].mean - 0.8).max().round(9))
    0.0
    >>> entries = both["entry of a surface"]
    >>> lit, spread = len(entries.labels) - 1, entries.labels.index("covariance of grass in asphalt")
    >>> entries.labels[lit], sorted(entries.truths(0, lit)[1].values())
    ('yellow plank in full light', [1.0, 1.0])
    >>> entries.for_scenario(1, "").truths(0, spread)
    [{}, {'scene.classes.[asphalt].covariance': {'builtin': 'grass'}}]
    >>> entries.labels.count("grass in the place of grass"), "level of the spectrum of grass" in both
    (0, False)
    >>> both["host of the targets"].labels, both["host of the targets"].truths(0, 0.0)[1]
    (('yellow plank on grass', 'yellow plank on soil'), {'scene.targets.[yellow plank].host': 'grass'})
    >>> plank = {"spectrum": {"builtin": "yellow-paint-plank"}, "host": "asphalt", "fill": {"fixed": 0.1}}
    >>> two = [{"name": name, **plank} for name in "ab"]
    >>> several = rarer_candidates([read_world(stated.with_values({"scene.targets": two}))])
    >>> hosts = next(c for c in several if c.name == "host of the targets")
    >>> hosts.labels[:3], sorted(hosts.truths(0, 2.0)[0].values())
    (('a on grass', 'b on grass', 'all targets on grass'), ['grass', 'grass'])
    >>> sum(c.name == "size of a" for c in _further_candidates(read_world(stated.with_values({"scene.targets": two}))))
    1
    >>> alone = {"scene.classes": [{"name": "lawn", "fraction": 1.0, "spectrum": {"builtin": "grass"}}]}
    >>> lawn = read_world(stated.with_values(alone | {"scene.targets": [], "scene.panels": []}))
    >>> [c.name for c in rarer_candidates([lawn]) if c.name.startswith("level")]  # all of it is that of one
    []
    >>> arm = both["electrons per radiance of 942-2470 nm"]
    >>> [truth["sensor.electrons"].round(9).ravel()[[0, -1]].tolist() for truth in arm.truths(0, 2.0)]
    [[1.0, 1.1], [1.0, 1.1]]
    >>> arm = both["wavelength shift of 942-2470 nm"]
    >>> [truth["sensor.wavelength_shift_nm"].ravel()[[0, -1]].tolist() for truth in arm.truths(0, 5.0)]
    [[0.0, 1.0], [0.0, 1.0]]
    >>> arm = both["noise without signal of 942-2470 nm"]
    >>> [truth["sensor.fixed_noise"].round(9).ravel()[[0, -1]].tolist() for truth in arm.truths(0, -10.0)]
    [[1.0, 0.5], [1.0, 0.5]]
    >>> both["bits of a recorded number"].truths(0, 2.0)
    [{'sensor_changes.bits': 12}, {'sensor_changes.bits': 12}]
    >>> [name for name in both if both[name].needs_engine]
    ['Angstrom exponent', 'view zenith angle', 'ground height', 'sensor altitude']
    >>> tilted = read_world(stated.with_values({"atmosphere.view_zenith_deg": 6.0}))
    >>> slanted = _number_input(tilted, *CAUSES["state"][3])
    >>> slanted.sizes, both["view zenith angle"].sizes, both["ground height"].sizes
    ((-6.0, 5.0, 20.0), (5.0, 20.0), (-1.7, 4.0, 12.0))
    >>> shown("ground height", both["ground height"].sizes[-2])
    {'atmosphere.ground_altitude_km': [0.57, 0.57]}
    {'atmosphere.ground_altitude_km': [0.57, 0.57]}
    >>> both["standard atmosphere"].labels[0], both["standard atmosphere"].truths(0, 0.0)
    ('tropical', [{'atmosphere.model': 'tropical'}, {'atmosphere.model': 'tropical'}])
    """
    levels = [_spectra_by_source(world) for world in worlds]
    means = {name: next(iter(truth.values())) for spectra in levels for name, truth in spectra.items()}
    every = merge_candidates([[_level_candidate(name, truth) for name, truth in spectra.items()] for spectra in levels])
    first = {str([sorted(truth) for truth in c.truths(0, 1.0)]): c for c in reversed(every)}.values()  # of one spectrum
    tried = {f"level of the spectrum of {s.name}" for world in worlds for s in _ground_surfaces(world)}
    rarer = merge_candidates(map(lambda w, s: _rarer_candidates(w, _file_substitutions(s, means)), worlds, levels))
    return [*(c for c in first if c.name not in tried), *rarer]


def _spectra_by_source(world: World) -> dict[str, dict[str, Array]]:
    """Field spectra by their paths: of a surface, of a file, of everything, which one mistake may be in."""
    out = defaultdict[str, dict[str, Array]](dict)
    for s, path in (item for kind in _interchangeable(world) for item in _field_spectra(kind)):
        of_file = [f"spectra of {s.spectrum.file} {s.spectrum.record or ''}".strip()] * bool(s.spectrum.file)
        for name in (f"the spectrum of {s.name}", *of_file, "all spectra of the ground"):
            out[name][path] = np.asarray(value_at(world, path))[0]
    return out


def _rarer_candidates(world: World, of_files: Mapping[str, Truth]) -> Iterator[Candidate]:
    scene, axis = world.stated.scenario.scene, world.stated.axis
    pixels, hosts, entries = dict[str, Any](), dict[str, Truth](), dict[str, Truth]()
    for kind in _interchangeable(world):
        means = {s.name: np.asarray(value_at(world, path))[0] for s, path in _field_spectra(kind)}
        for s, path in _field_spectra(kind):
            entries |= {f"{other} in the place of {s.name}": {path: means[other]} for other in means if other != s.name}
    entries |= dict(_covariance_substitutions(scene.classes))
    for t in scene.targets:
        shapes = ((_geometry_path(t, p), p.fill and p.fill.geometry) for p in t.populations)
        pixels |= {f"{path}.gsd_m": shape.gsd_m for path, shape in shapes if shape}
        path = f"scene.targets.[{t.name}].illumination"
        yield _number_input(world, f"light of {t.name}", "scene", f"{path}.beam", "10 %", (-9.0, -4.0, 7.0))
        entries[f"{t.name} in full light"] = {f"{path}.beam": 1.0, f"{path}.sky_view": 1.0}
    for c in scene.classes:
        moves = {t.name: {f"scene.targets.[{t.name}].host": c.name} for t in scene.targets if t.host != c.name}
        hosts |= {f"{name} on {c.name}": truth for name, truth in moves.items()}
        if len(moves) > 1:
            hosts[f"all targets on {c.name}"] = {path: host for truth in moves.values() for path, host in truth.items()}
    for a, b in combinations(scene.classes, 2):
        name, traded = f"fraction of {a.name} for {b.name}", partial(_traded_fractions, a, b)
        yield _candidate(name, "scene", "0.05 of the area", (-8.0, 8.0), traded)
    if pixels:
        yield _candidate("pixel size of the fills", "sensor", "5 %", (-8.0, 12.0), partial(_scaled_values, pixels))
    noises = {"electrons": "electrons per radiance", "fixed_noise": "noise without signal"}
    for where, arm in arm_masks(world).items():
        for key, name in noises.items() if world.stated.noise is not None else ():
            yield _noise_candidate(key, f"{name} of {where}", _SIZES[name], arm)
        name, sizes = f"wavelength shift of {where}", (-25.0, -5.0, 5.0, 25.0)
        yield _candidate(name, "sensor", f"{SHIFT_NM:g} nm", sizes, partial(_band_shift, world, arm))
    if world.stated.noise is not None:
        words = {f"{bits} bits": {"sensor_changes.bits": bits} for bits in (8, 10, 12, 14, 16)}
        yield from _alternatives("bits of a recorded number", "sensor", words)
    from_middle = (axis.centre_nm - axis.centre_nm.mean()) / (1e3 * SHIFT_NM)
    yield _candidate("wavelength scale", "sensor", "0.1 %", (-8.0, 8.0), partial(_band_shift, world, from_middle))
    yield from _alternatives("entry of a surface", "scene", {**entries, **of_files})
    yield from _alternatives("host of the targets", "scene", hosts)
    if (state := _atmospheric_state(world)) is not None:
        yield from _atmosphere_candidates(world, state)


def _atmosphere_candidates(world: World, state: AtmosphericState) -> Iterator[Candidate]:
    """What is stated of atmosphere, sun and view, at other values.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> at = {"solar_zenith_deg": None, "solar_azimuth_deg": None, "day_of_year": None, "latitude_deg": 43.0,
    ...       "longitude_deg": -77.7, "time_utc": "2012-09-20T16:00:00Z"}
    >>> scenario = load_scenario("green-planks-grass").with_values({f"atmosphere.{name}": v for name, v in at.items()})
    >>> named = {c.name: c for c in _atmosphere_candidates(read_world(scenario), scenario.atmosphere)}
    >>> date = named["date of overflight"]
    >>> [date.truths(0, z)[0]["atmosphere.time_utc"][:10] for z in date.sizes]
    ['2012-08-21', '2012-10-20', '2012-07-22', '2012-11-19']
    >>> named["place on the globe"].labels, named["place on the globe"].truths(0, 0.0)
    (('latitude with the other sign', 'longitude with the other sign'), [{'atmosphere.latitude_deg': -43.0}])
    >>> named["standard atmosphere"].labels.count(scenario.atmosphere.model)
    0
    >>> named["solar spectrum"].labels.count(scenario.atmosphere.solar_spectrum)
    0
    >>> names = {c.name for c in _further_candidates(read_world(scenario))}
    >>> sorted({"time of overflight", "solar zenith angle"} & names)
    ['time of overflight']
    """
    for name, kind, path, step, sizes in CAUSES["state"]:
        if getattr(state, path.partition(".")[2], None) is not None:
            yield _number_input(world, name, kind, path, step, sizes)
    if state.time_utc:
        later = partial(_delay, state, timedelta(days=30))
        yield _candidate("date of overflight", "scene", "30 d", (-1.0, 1.0, -2.0, 2.0), later)
    place = {"latitude": state.latitude_deg, "longitude": state.longitude_deg}
    signs = {f"{key} with the other sign": {f"atmosphere.{key}_deg": -x} for key, x in place.items() if x}
    suns = {sun: {"atmosphere.solar_spectrum": sun} for sun in SOLAR_SPECTRA if sun != state.solar_spectrum}
    models = {air: {"atmosphere.model": air} for air in get_args(AtmosphereModel) if air != state.model}
    yield from _alternatives("place on the globe", "atmosphere", signs)
    yield from _alternatives("solar spectrum", "atmosphere", suns)
    yield from _alternatives("standard atmosphere", "atmosphere", models)


def _field_spectra(kind: Iterable[Surface]) -> list[tuple[Any, str]]:
    """Surfaces whose spectrum is not measured on the imagery, with the path of their mean."""
    return [(s, f"surfaces.[{s.name}].mean") for s in kind if s.spectrum.measured is None]


def _file_substitutions(spectra: Mapping[str, Mapping[str, Array]], means: Mapping[str, Array]) -> dict[str, Truth]:
    """One file of field spectra in the place of another, or both exchanged, where a scenario reads them; means on other
    bands, of another scenario, are left out.

    >>> a, b = {"surfaces.[red].mean": np.array([0.1])}, {"surfaces.[green].mean": np.array([0.4])}
    >>> means = {f"spectra of {x}.txt": np.array(mean) for x, mean in {"a": [0.1], "b": [0.4], "c": [0.2, 0.2]}.items()}
    >>> changed = _file_substitutions({"spectra of a.txt": a, "spectra of b.txt": b, "all": {**a, **b}}, means)
    >>> for words, truth in changed.items():
    ...     print(words, {path: value.tolist() for path, value in truth.items()})
    spectra of b.txt in the place of spectra of a.txt {'surfaces.[red].mean': [0.4]}
    spectra of a.txt in the place of spectra of b.txt {'surfaces.[green].mean': [0.1]}
    spectra of b.txt exchanged with spectra of a.txt {'surfaces.[green].mean': [0.1], 'surfaces.[red].mean': [0.4]}
    """
    out = dict[str, Truth]()
    bands = {mean.shape for truth in spectra.values() for mean in truth.values()}
    files = [name for name, mean in means.items() if name.startswith("spectra of ") and mean.shape in bands]
    for a, b in combinations(files, 2):
        one, other = (dict.fromkeys(spectra.get(x, {}), means[y]) for x, y in ((a, b), (b, a)))
        out |= {f"{b} in the place of {a}": one, f"{a} in the place of {b}": other}
        out[f"{b} exchanged with {a}"] = {**other, **one}
    return out


def _level_candidate(name: str, means: Mapping[str, Array]) -> Candidate:
    return _candidate(f"level of {name}", "scene", "5 %", (-6.0, 8.0), partial(_scaled_values, means))


def _scaled_values(values: Mapping[str, Any], units: float) -> Truth:
    return {path: (1.0 + 0.05 * units) * value for path, value in values.items()}


def arm_masks(world: World) -> dict[str, Array]:
    """Arms of a sensor by their wavelengths, 1 in their bands (B,); either side of 1000 nm where none are known."""
    axis, sensor = world.stated.axis, world.stated.sensor
    arms = np.array([axis.centre_nm < 1000.0, axis.centre_nm >= 1000.0])
    if sensor is not None and sensor.specification.arms:
        arms = error_rows(np.ones(len(axis)), SpectralForm(correlation="arms"), axis, sensor) > 0.0
    several = len(arms) > 1 and bool(np.all(np.any(arms, axis=1)))
    return {"{:.0f}-{:.0f} nm".format(*axis.centre_nm[arm][[0, -1]]): 1.0 * arm for arm in arms if several}


def _band_shift(world: World, profile: Array | float, units: float) -> Truth:
    return _shifted(world, nm=SHIFT_NM * units * profile)


def _covariance_substitutions(classes: Sequence[BackgroundClass]) -> Iterator[tuple[str, Truth]]:
    """The covariance of each class replaced by that of another one, or by the covariance of its spectrum."""
    for c, other in product(classes, repeat=2):
        for source in filter(None, (other.covariance, other.spectrum)):
            spread = source.model_dump(include={"builtin", "measured", "replicates"}, exclude_none=True)
            if spread and source is not (c.covariance or c.spectrum):
                origin = next(iter(spread.values()))
                yield f"covariance of {origin} in {c.name}", {f"scene.classes.[{c.name}].covariance": spread}


def _traded_fractions(a: BackgroundClass, b: BackgroundClass, units: float) -> Truth:
    """Two classes, the first with so much more area, of the second.

    >>> from types import SimpleNamespace as Of
    >>> lawn, lot = Of(name="lawn", fraction=0.3), Of(name="lot", fraction=0.1)
    >>> [[round(x, 9) for x in _traded_fractions(lawn, lot, units).values()] for units in (-8.0, 1.0, 8.0)]
    [[0.0, 0.4], [0.35, 0.05], [0.4, 0.0]]
    """
    area = min(max(0.05 * units, -a.fraction), b.fraction)
    return {f"scene.classes.[{c.name}].fraction": c.fraction + more for c, more in ((a, area), (b, -area))}


NORMAL_DOF = 1e6  # degrees of freedom of tails that are left out


class NotInjectable(UsageError):
    """An error of something that the scenario does not have."""


def injected_errors() -> dict[str, Perturbation]:
    """The standard errors by name, each of its size, in the order of the power table."""
    errors = _scaled_input, _shifted, _without_tails, _exchanged, _other_material, _fine_texture, _line_error
    made = {error.__name__: error for error in errors}
    return {name: partial(made[f"_{function}"], **options) for name, (function, options) in CAUSES["errors"].items()}


def errors_of_file(path: Path) -> dict[str, Perturbation]:
    """Errors of a user's own: name -> {path: value}, or the name alone of a standard one.

    Raises
    ------
    UsageError : a name that is no standard error, or something else than paths and values.
    """
    (entries, _), standard = load_yaml(path), injected_errors()
    out: dict[str, Perturbation] = {}
    for name, values in entries.items():
        refuse(values is None and name not in standard, "attribution.error", path, name=name)
        refuse(values is not None and not isinstance(values, dict), "attribution.errors", path)
        out[str(name)] = standard[name] if values is None else partial(lambda moves, _: moves, values)
    return out


def injected_prediction(
    scenario: Scenario, error: Perturbation, origins: Origins | None = None, *, objects: bool | int = False
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
    >>> sides = [injected_prediction(scenario, lambda _, x=x: {"line.gain": x})[0].reflectance["grass"] for x in gains]
    >>> stated, more = (estimate.pixel_covariance for estimate in sides)
    >>> bool(np.allclose(more, np.outer(gains[1], gains[1]) * stated)), float(sides[1].mean[-1] / sides[0].mean[-1])
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
        shown = {name: _apply_line(estimate, gain, offset) for name, estimate in prediction.reflectance.items()}
        prediction = replace(prediction, reflectance=shown)
    return prediction, truth


def _nominal(world: World, path: str) -> dict[str, Any]:
    """What stands at a path, or at that of each class or target, where it speaks of them."""
    what = "target" if "{target}" in path else "class"
    names = _subject_names(world, what) if "{" in path else [""]
    paths = [path.replace(f"{{{what}}}", name) for name in names]
    return {each: np.asarray(value_at(world, each)[0], dtype=float) for each in paths}


def _subject_names(world: World, what: str) -> list[str]:
    """Classes, those that cover most first; or targets."""
    scene = world.stated.scenario.scene
    names = [x.name for x in (scene.targets if what == "target" else sorted(scene.classes, key=lambda c: -c.fraction))]
    refuse(not names, "attribution.none", what=f"there is no {what}")
    return names


def _scaled_input(world: World, *, path: str, factor: float) -> Truth:
    """What stands at a path by a factor.

    >>> from hyperval.api import load_scenario
    >>> dark = load_scenario("yellow-planks-asphalt").with_values({"scene.targets.0.spectrum": {"constant": 0.0}})
    >>> _scaled_input(read_world(dark), path="surfaces.[{target}].mean", factor=0.8)
    Traceback (most recent call last):
    hyperval.errors.UsageError: surfaces.[yellow plank].mean is 0
    """
    nominal = _nominal(world, path)
    refuse(not any(map(np.any, nominal.values())), "attribution.none", what=f"{' and '.join(nominal)} is 0")
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
    heavy = {key: NORMAL_DOF for key, dof in _nominal(world, "surfaces.[{class}].tail_dof").items() if dof < NORMAL_DOF}
    refuse(not heavy, "attribution.none", what="no class has tails")
    return heavy


def _other_material(world: World) -> Truth:
    """Of the built-in materials the one that is least like the target."""
    others = [builtin_mean(n, world.stated.axis) for n in BUILTIN_NAMES if not n.endswith("NN")]
    means = _nominal(world, "surfaces.[{target}].mean").items()
    return {path: max(others, key=lambda mean: float(np.nanmean((mean - stated) ** 2))) for path, stated in means}


def _fine_texture(world: World) -> Truth:
    """All of the targets' spread."""
    names = [name for name in _subject_names(world, "target") if np.any(world.stated.surfaces[name].covariance)]
    refuse(not names, "attribution.none", what="no target has a spread")
    return {f"surfaces.[{name}].fine_texture": 1.0 for name in names}


def _exchanged(world: World, names: Sequence[str] = (), what: str = "surface") -> Truth:
    """Each surface has the mean spectrum of the next one, where that is known; the two classes that cover most."""
    names = names or (_subject_names(world, what)[:2] if what == "class" else _subject_names(world, what))
    refuse(len(names) < 2, "attribution.none", what=f"there is one {what}")
    moves = {}
    for name, other in zip(names, (*names[1:], names[0]), strict=True):
        mean, other_mean = world.stated.surfaces[name].mean, world.stated.surfaces[other].mean
        moves[f"surfaces.[{name}].mean"] = np.nan_to_num(np.where(np.isfinite(other_mean), other_mean, mean))
    return moves


def _line_error(world: World, *, gain: float, offset: float) -> Truth:
    """An empirical line that is off for the detectors; where reflectance was collected, in the surfaces' own."""
    if world.stated.scenario.atmosphere is None:
        return {"sensor.gain": gain, "sensor.offset": offset}
    refuse(world.stated.scenario.processing.elm == "none", "attribution.none", what="there is no empirical line")
    return {"line.gain": gain, "line.offset": offset}


def _apply_line(estimate: SpectralEstimate, gain: Array, offset: Array) -> SpectralEstimate:
    pixels = None if estimate.pixel_covariance is None else np.multiply.outer(gain, gain) * estimate.pixel_covariance
    return replace(estimate, mean=gain * estimate.mean + offset, pixel_covariance=pixels)

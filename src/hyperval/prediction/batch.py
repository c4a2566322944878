"""The forward model of n evaluations at once: radiance, SNR, scores and ROC (3.7-3.33).

Evaluations that share atmosphere, sensor and ground share their filter; everything else goes through arrays.
One scenario is a batch of one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.background import Seen, Settings, seen_classes
from hyperval.prediction.departure import Fills, object_fills_of, pixel_fills
from hyperval.prediction.filters import (
    Designer,
    Filters,
    Material,
    Population,
    Responses,
    law_scores,
    responses,
    target_population,
)
from hyperval.prediction.inputs import cut
from hyperval.processing.elm import retrieved_reflectance
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.processing.roc_model import ClassScores, Host, RocScores
from hyperval.scenario import Scenario, Target, TargetSubject
from hyperval.scene.fill import FillDistribution
from hyperval.spectra.axis import SpectralAxis, in_window

Array = npt.NDArray[np.float64]
Made = TypeVar("Made")
Index = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Points:
    """What n evaluations have besides their setting.

    Attributes
    ----------
    setting : (n,) number of it
    dof : (n or 1, M) degrees of freedom of the classes; infinity: Gaussian
    laws : (J,) number of the class of each law that the classes are made of, and (n or 1, J) degrees of freedom of
        its own, NaN for those of its class; None: a law for each class
    gain, beam, sky : (n or 1, T) g_T and the parts of the light in the open that reach each target
    fills : (number of the target, of its population) -> fills, where they are not those of the scenario
    shift : (n,) by how many standard deviations of the score the targets depart from their spectra
    """

    setting: Index
    dof: Array
    gain: Array
    beam: Array
    sky: Array
    fills: Callable[[int, int, bool], Fills | None] = lambda target, population, objects: None
    shift: Array | float = 0.0
    laws: tuple[Index, Array] | None = None

    @property
    def law_dof(self) -> Array:
        """(n or 1, J) degrees of freedom of the laws."""
        if self.laws is None:
            return self.dof
        owner, own = self.laws
        return np.where(np.isnan(own), self.dof[:, owner], own)

    def __len__(self) -> int:
        return self.setting.size

    def of(self, values: Array, target: int) -> Array:
        """(n,) one target's column of (n or 1, T) values."""
        return np.broadcast_to(values[:, target], (len(self),))


@dataclass(frozen=True, eq=False)
class Group:
    """Settings of one set of detector bands.

    Attributes
    ----------
    numbers : (V,) of the settings in the batch
    bands : (F,) of the detectors
    at, seen : the settings and the classes as seen, on those bands
    designer : of their filters
    filters : (target, detector) -> filters, theta_m (V, J), sigma_m (V, J) of the J laws of the classes, of linear
        detectors
    problems : number in the group -> why there is no filter
    """

    numbers: Index
    bands: Index
    at: Settings
    seen: Seen
    designer: Designer
    filters: Mapping[tuple[str, str], tuple[Filters, Array, Array]]
    problems: Mapping[int, UsageError] = field(default_factory=dict)


class Batch:
    """n evaluations; quantities are computed when asked for.

    Parameters
    ----------
    scenario, axis : what all evaluations share: names, processing, bands as they are labelled
    signatures : target -> (B,) reflectance that its filter looks for
    settings, points : what differs
    errors : target -> (B, B) error covariance of its spectrum
    designers : room for matrices kept from batch to batch
    """

    def __init__(
        self,
        scenario: Scenario,
        axis: SpectralAxis,
        signatures: Mapping[str, Array],
        settings: Settings,
        points: Points,
        errors: Mapping[str, Array] | None = None,
        designers: dict[bytes, Designer] | None = None,
    ):
        self.scenario, self.axis, self.signatures = scenario, axis, signatures
        self.settings, self.points = settings, points
        self.errors = errors or {}
        self._designers = {} if designers is None else designers
        self._made: dict[Any, Any] = {}

    def __len__(self) -> int:
        return len(self.points)

    @property
    def targets(self) -> list[Target]:
        """The targets of the scene."""
        return self.scenario.scene.targets

    @property
    def class_names(self) -> list[str]:
        """Names of the M background classes."""
        return [c.name for c in self.scenario.scene.classes]

    # ---- spectra -------------------------------------------------------------------------------------------

    def radiance(self, subject: str) -> Array:
        """Mean radiance of a class, panel or site in each setting (U, B) (3.7) [uW cm-2 sr-1 nm-1]."""
        return self.once(("radiance", subject), lambda: self.settings.levels(self.settings.means([subject]))[:, 0])

    def snr(self, subject: str, calibration: bool = True) -> Array:
        """SNR of a class, panel or site in each setting (U, B) (3.20) [1]; with C_R or without."""
        noise = self.settings.view.noise
        if noise is None:
            raise UsageError("the scenario has no sensor noise", mend="name an atmosphere and a sensor")
        return self.once(
            ("snr", subject, calibration),
            lambda: np.asarray(noise.snr(self.radiance(subject)[:, None, :], calibration=calibration)[:, 0]),
        )

    # ---- detection -----------------------------------------------------------------------------------------

    @cached_property
    def needed(self) -> list[str]:
        """Surfaces that the detectors need."""
        return [*self.class_names, *(t.name for t in self.targets)]

    @cached_property
    def groups(self) -> list[Group]:
        """Settings by the bands that their detectors use, with their filters."""
        settings = self.settings
        usable = np.broadcast_to(settings.view.lit(), (len(settings), 1, len(self.axis)))[:, 0]
        usable = usable & np.isfinite(settings.means(self.needed)).all(axis=1)
        for spectrum in self.signatures.values():
            usable = usable & np.isfinite(spectrum)
        patterns, which = np.unique(usable, axis=0, return_inverse=True)
        return [self._group(np.flatnonzero(which.reshape(-1) == i), pattern) for i, pattern in enumerate(patterns)]

    def _group(self, numbers: Index, usable: npt.NDArray[np.bool_]) -> Group:
        bands = detection_bands(self.scenario, self.axis, usable)
        processing = self.scenario.processing
        key = bands.tobytes()
        if key not in self._designers:
            self._designers.clear()  # one set of bands serves nearly all points, and each holds large matrices
            self._designers[key] = Designer(processing, self.class_names, bands.size)
        designer = self._designers[key]
        at = self.settings.rows(numbers).at(bands, self.needed)
        seen = seen_classes(at)
        linear = [d for d in processing.detectors if d in LINEAR_DETECTORS]
        names = [(t.name, detector) for t in self.targets for detector in linear]
        group = Group(numbers, bands, at, seen, designer, {})
        wanted = [(detector, self.spectrum_as_seen(group, target)) for target, detector in names]
        _, first, which = np.unique(self.alike()[numbers], return_index=True, return_inverse=True)
        one, of_one = at.rows(first), seen.rows(first)
        spectra = [(detector, spectrum[first]) for detector, spectrum in wanted]
        filters, problems = designer.design(one, of_one, spectra)
        made = {}
        for n, f in zip(names, filters, strict=True):
            means, sds = law_scores(one, of_one, f)
            made[n] = f.rows(which), means[which], sds[which]
        every = {int(u): problems[w] for u, w in enumerate(which) if w in problems}
        return replace(group, filters=made, problems=every)

    def alike(self, target: str | None = None) -> Index:
        """(U,) the same number for settings with the same filters, and the same target where one is named."""
        names = [] if target is None else [target]
        return self.once(("alike", target), lambda: self.settings.alike(names))

    @property
    def has_filters(self) -> bool:
        """Whether the filters were asked for."""
        return "groups" in vars(self)

    @property
    def problems(self) -> dict[int, UsageError]:
        """Setting -> why it has no filter."""
        return {int(g.numbers[u]): e for g in self.groups for u, e in g.problems.items()}

    def spectrum_as_seen(self, group: Group, target: str) -> Array:
        """(V, F) what a filter looks for, in the units of the image."""
        line, at = group.at.view.library_line(), group.at
        return retrieved_reflectance(line, at.levels(self.signatures[target][None, group.bands]))[:, 0]

    def population_at(self, group: Group, u: int, point: int, target: int, fill: FillDistribution) -> Population:
        """Pixels of one target as the detector of setting ``u`` sees them, by the moments of their fill (3.12)."""
        row = np.full(len(group.at), 1.0)
        material = self.material(target, row * self._at(self.points.beam, point, target),
                                 row * self._at(self.points.sky, point, target), group.bands)  # fmt: skip
        gain = self._at(self.points.gain, point, target)
        return target_population(group.at, group.seen, u, material, fill, gain)

    def material(self, target: int, beam: Array, sky: Array, bands: Index) -> Material:
        """A target with its host, its light and the error of its spectrum."""
        t = self.targets[target]
        error = cut(self.errors[t.name], bands) if t.name in self.errors else None
        return Material(t.name, self.class_names.index(t.host), beam, sky, error)

    def fill_of(self, point: int, target: int, population: int) -> FillDistribution:
        """Fill of one evaluation."""
        fills = self.fills(target, population)
        row = point if fills.values.shape[0] > 1 else 0
        weights = fills.weights[row if fills.weights.shape[0] > 1 else 0]
        return FillDistribution(fills.values[row], weights)

    def fills(self, target: int, population: int, objects: bool = False) -> Fills:
        """Fills of the pixels of a population (f of 3.10) in each evaluation, or of the pixels of its objects."""
        own = self.points.fills(target, population, objects)
        if own is not None:
            return own
        thesis = self.scenario.formulation == "thesis"
        subject = self.targets[target].populations[population]
        return object_fills_of(subject, thesis) if objects else pixel_fills(subject, thesis)

    def scores(self, population: str, detector: str) -> RocScores:
        """What the ROC of a target population needs in each evaluation (3.26-3.29), pixel by pixel."""
        return self.once(("scores", population, detector), lambda: self._scores(population, detector, False))

    def object_scores(self, population: str, detector: str) -> RocScores:
        """The same where an object is detected when one of its pixels is."""
        return self.once(("objects", population, detector), lambda: self._scores(population, detector, True))

    def _scores(self, population: str, detector: str, objects: bool) -> RocScores:
        number, subject, _ = self.population(population)
        fills, points = self.fills(number, subject, objects), self.points
        means, sds = (np.full((len(self), fills.values.shape[1]), np.nan) for _ in range(2))
        bare = np.full((2, len(self)), np.nan)
        shift = np.broadcast_to(points.shift, (len(self),))
        for g in self.groups:
            here = np.flatnonzero(np.isin(points.setting, g.numbers))
            rows, response = self.responses(g, number, detector, here)
            own = fills.values if fills.values.shape[0] == 1 else fills.values[here]
            gain = points.of(points.gain, number)[here]
            means[here], sds[here] = response.at(own, gain, rows, shift[here])
            bare[:, here] = response.means[rows, 0], response.variances(gain, rows)[:, 0]
        classes, which = self.once(("classes", number, detector), lambda: self._classes(number, detector))
        host = self.host(number, detector, np.arange(len(self)), 1.0 - fills.values, *bare)
        if fills.shape is None:
            return RocScores(classes, which, means, sds, np.broadcast_to(fills.weights, means.shape), None, host)
        each = (means.reshape(len(self), *fills.shape), sds.reshape(len(self), *fills.shape))
        return RocScores(classes, which, means, sds, np.full(means.shape, np.nan), each, host)

    def host(
        self, number: int, detector: str, points: Index, share: Array, mean: Array, variance: Array
    ) -> Host | None:
        """The host of a target in some evaluations, as :class:`Host` has it; None: one normal law in all."""
        laws, parts, _ = self.host_laws(number)
        classes, which = self.once(("classes", number, detector), lambda: self._classes(number, detector))
        scores = classes.rows(which[points]).of(laws)
        host = Host(share, mean, variance, replace(scores, fraction=np.broadcast_to(parts, scores.mean.shape)))
        return None if host.normal.all() else host

    def host_laws(self, number: int) -> tuple[Index, Array, Array]:
        """(C,) which of the background's laws a target's host is made of, their parts, and (n or 1, C) dof."""
        owner = self.class_names.index(self.targets[number].host)
        laws = [j for j, law in enumerate(self.settings.grounds[0].laws) if law.owner == owner]
        parts = [self.settings.grounds[0].laws[j].weight for j in laws]
        return np.array(laws), np.array(parts), self.points.law_dof[:, laws]

    def _classes(self, number: int, detector: str) -> tuple[ClassScores, Index]:
        """Scores of the background's laws for each different combination of setting and tails."""
        laws = self.settings.grounds[0].laws
        size = (len(self.settings), len(laws))
        means, sds = np.full(size, np.nan), np.full(size, np.nan)
        for g in self.groups:
            _, means[g.numbers], sds[g.numbers] = g.filters[self.targets[number].name, detector]
        points, dof = self.points, self.points.law_dof
        alike = self.alike()[points.setting]
        first, which = distinct([alike, *(dof.T if dof.shape[0] > 1 else ())], len(self))
        settings = points.setting[first]
        tails = np.broadcast_to(dof, (len(self), dof.shape[1]))[first]
        return ClassScores(self.settings.law_fractions()[settings], means[settings], sds[settings], tails), which

    def responses(self, group: Group, target: int, detector: str, points: Index) -> tuple[Index, Responses]:
        """Scores against the fill by the filter that looks for a target, and which row of them each point has."""
        name = self.targets[target].name
        return self.responses_to(group, target, group.filters[name, detector][0], points)

    def responses_to(self, group: Group, target: int, filters: Filters, points: Index) -> tuple[Index, Responses]:
        """Scores of pixels that hold a target, by filters (V, F) that may look for another one."""
        beam = self.points.of(self.points.beam, target)[points]
        sky = self.points.of(self.points.sky, target)[points]
        local, name = np.searchsorted(group.numbers, self.points.setting[points]), self.targets[target].name
        first, rows = distinct([self.alike(name)[self.points.setting[points]], beam, sky], points.size)
        settings = local[first]
        material = self.material(target, beam[first], sky[first], group.bands)
        at, seen = group.at.rows(settings), group.seen.rows(settings)
        return rows, responses(at, seen, filters.rows(settings), material)

    # ---- small things --------------------------------------------------------------------------------------

    def population(self, name: str) -> tuple[int, int, TargetSubject]:
        """Number of the target and of its population of that name, and what the scenario says of it."""
        for number, target in enumerate(self.targets):
            for subject, population in enumerate(target.populations):
                if population.name == name:
                    return number, subject, population
        raise UsageError(f"no target population {name!r}")

    def _at(self, values: Array, point: int, target: int) -> float:
        return float(values[point if values.shape[0] > 1 else 0, target])

    def once(self, key: Any, make: Callable[[], Made]) -> Made:
        """What ``make`` gives, made the first time that ``key`` is asked for."""
        if key not in self._made:
            self._made[key] = make()
        made: Made = self._made[key]
        return made


def distinct(columns: Sequence[npt.NDArray[Any]], n: int) -> tuple[Index, Index]:
    """First point of each different row of the columns, and the number of its row for each point."""
    if not columns:
        return np.zeros(1, int), np.zeros(n, int)
    codes = np.zeros(n, int)
    for column in columns:
        _, code = np.unique(column, return_inverse=True)
        _, codes = np.unique(codes * (int(code.max(initial=0)) + 1) + code.reshape(-1), return_inverse=True)
    _, first = np.unique(codes, return_index=True)
    return first, codes.reshape(-1)


def detection_bands(scenario: Scenario, axis: SpectralAxis, usable: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Indices of the bands that the detectors use (Psi of unit rows, 3.21).

    ``usable`` (B,) is False where a spectrum or the light is lacking.  Raises UsageError when none is left.
    """
    choice = scenario.processing.bands
    keep = usable.copy()
    if choice.drop_bad:
        keep &= axis.good
    if choice.windows_only:
        keep &= in_window(axis.centre_nm)
    if choice.ranges:
        keep &= np.any([(axis.centre_nm >= a) & (axis.centre_nm <= b) for a, b in choice.ranges], axis=0)
    for name, listed in (("channels", choice.channels), ("bad_channels", choice.bad_channels)):
        if listed and max(listed) >= keep.size:
            raise UsageError(
                f"processing.bands.{name}: band {max(listed)} of {keep.size}",
                expected=f"numbers from 0 to {keep.size - 1}",
            )
        if listed:
            here = np.isin(np.arange(keep.size), listed)
            keep &= here if name == "channels" else ~here
    if not keep.any():
        raise UsageError("no band is left for detection", mend="widen processing: bands")
    return np.flatnonzero(keep)

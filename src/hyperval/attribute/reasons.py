"""Attribution: every input moved and ranked, every what-if run, and the results as rows.

A what-if is a named experiment: a run with something changed, and its effect on the residuals and the false alarms.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain, product
from typing import Any

import numpy as np
from scipy import special

from hyperval.attribute.candidates import (
    CAUSES,
    HEIGHTS,
    SINGLE_BANDS,
    Candidate,
    arm_masks,
    entry_candidates,
    every_input,
    further_candidates,
    rarer_candidates,
)
from hyperval.attribute.posterior import ALL, NONE, NOTHING, Posterior, Residuals, Whitened
from hyperval.attribute.residuals import POINTS, RADIOMETRIC, SPECTRUM_FLOOR, Quantity, Stack, quantities, stack_of
from hyperval.attribute.schema import AttributionOptions, WhatIf
from hyperval.compare.detection import compare_exceedance
from hyperval.compare.rows import named, row, short_label
from hyperval.data import Array, Index
from hyperval.errors import EngineError, HypervalError, MissingDataError, UsageError, needed, refuse
from hyperval.model import Truth, World
from hyperval.products import Products, background_of
from hyperval.progress import track
from hyperval.results import Cause, Outcome, Result
from hyperval.scenario import Scenario
from hyperval.settings import with_settings

ATMOSPHERE, MAX_SCENARIOS = "atmosphere", 3  # inputs of this kind are asked for large errors in so many scenarios
# In which the model is asked again at the sizes found, of so many candidates; pixels that regions may lie elsewhere.
MAX_ROUNDS, MAX_REFINED, MAX_PIXELS = 6, 4, 4
# Error of each band by itself, common to all subjects: what smooth inputs cannot explain.
# A gain and an offset of the calibration that change smoothly over wavelength: a piece at each knot.
SMOOTH_PART = 0.03
KNOTS_NM = np.array([400, 430, 460, 500, 550, 600, 650, 700, 800, 900, 1000, 1200, 1400, 1650, 2000, 2250, 2500], float)
BAND_PART = 0.01
_FARTHER = [(k, 0) for k in (3, -3, 4, -4, 5, -5, 6, -6)]  # as far as lost lines take regions and targets
UNITS = np.array([0.001, 0.01, 0.1, 10.0, 100.0, 1000.0])  # of spectra in another unit than is stated
FACTOR = 2.0  # a ratio of false alarms within it is good
AS_WRITTEN = 2e-5  # part of a value within which the six digits of an accepted one and of another machine agree
# Of a change between two runs, which has no noise: rounding of what is no spectrum; part of an effect that is off as it
# is large or was found at another level; part of a spectrum that has not moved.
CHANGE_FLOOR, OFF, UNMOVED = 2e-4, 0.01, 1e-4
_OFFSETS = (-20.0, -8.0, -2.0, 2.0, 8.0, 20.0)
_EVERYTHING, SINCE = "every input", "since the accepted run"
UNCHANGED = "spectra, SNR, scores, and false alarms at 1e-2 and 1e-3 have not changed beyond their uncertainty"

Truths = Sequence[Truth]  # what is moved in each scenario
# Sides of an accepted run by quantity (:meth:`CauseEffects.sides`), and its reduced chi-square of all; 0: not known
Accepted = tuple[Mapping[str, Sequence[str]], float]
Classes = Mapping[str, Mapping[str, Array]]  # (B,) mean of each by product
Columns = Mapping[Candidate, Array]  # (n, k) what each candidate does to residuals
Key = tuple[str, str, str]  # background, detector, metric
Evaluate = Callable[..., list[Array]]  # what is explained, of truths, a title, and whether a budget is made of them
Numbers = Mapping[Quantity, float]
Ends = Mapping[Candidate, tuple[Numbers, Numbers]]  # with an input one unit up and down
Sides = dict[tuple[Candidate, float], Array]  # what is explained, with a candidate at a size


@dataclass(frozen=True, eq=False)
class ScenarioModel:
    """Scenarios with what predicts them, and what was measured.

    Attributes
    ----------
    scenarios, worlds : as they stand in the campaign, and what each of them states
    predict : (scenarios, truths, budgeted) -> for each truth their products, merged as the campaign compares them;
        what a budget is made of as exactly as what is predicted
    observed : what was measured
    budgeted : the prediction with its error covariances; what they hold beyond the inputs' directions is added to each
        spectrum
    observe : measures the collection again with changed settings, or with a mistake in its image
        (:meth:`hyperval.observe.open.Place.with_injected_error`)
    exchanges : what may stand in each other's place: the settings of :attr:`observe` for each pair, and ""; of a
        number, those of so many steps, and a step in words
    looked_for : entries of the spectra that detectors look for, by their targets
    """

    scenarios: Sequence[Scenario]
    worlds: Sequence[World]
    predict: Callable[[Sequence[Scenario], Sequence[Truths], bool], Iterator[Products]]
    observed: Products
    budgeted: Products
    observe: Callable[[Mapping[str, Any], Mapping[str, Any]], Products]
    exchanges: Mapping[str, tuple[Mapping[Any, Mapping[str, Any]], str]] = field(default_factory=dict)
    looked_for: Mapping[str, Any] = field(default_factory=dict)

    def predict_scenarios(self, scenarios: Sequence[Scenario]) -> Products:
        """Products of other scenarios."""
        return next(self.predict(scenarios, [[{} for _ in scenarios]], True))


@dataclass(frozen=True, eq=False)
class CauseEffects:
    """What was asked of the model before residuals are looked at.

    Attributes
    ----------
    stack : what is explained, as a vector
    predicted, numbers : the same with nothing moved, as a vector and as single numbers
    spectral_errors : errors that are linear in the spectra at a level (n,)
    entry_effects : entries of a scenario's file exchanged, where all that is made of them moves too
    rarer : what is looked for where little else explains a change, one after the other: heights; of many scenarios what
        few have in ``columns``, which takes runs of the engine; then the rest
    residuals : observed minus predicted, with everything that is budgeted in their covariance
    ends : numbers with an input one unit up and down
    evaluate : asks the model again
    mistake_effect : what is measured now, less what is measured with a mistake in the image
    exchange_effects : of what is measured, the exchanges of :attr:`ScenarioModel.exchanges`, and an offset in one arm
    """

    stack: Stack
    predicted: Array
    numbers: Numbers
    spectral_errors: Callable[[Array], dict[Candidate, Array]]
    entry_effects: Callable[[], dict[Candidate, Array]]
    rarer: Sequence[Callable[[], dict[Candidate, Array]]]
    residuals: Residuals
    ends: Ends
    evaluate: Evaluate
    mistake_effect: Callable[[Mapping[str, Any]], Array]
    exchange_effects: Callable[[], dict[Candidate, Array]]

    def explain_residuals(self) -> tuple[Residuals, Posterior]:
        """The residuals and what explains them; where no single cause is sufficient, a height where that is.

        >>> from hyperval.attribute import ResidualBlock
        >>> gain, height = (Candidate(name, "scene", "1 km", False) for name in ("gain", "height"))
        >>> stack, one = Stack((ResidualBlock("scores", "paint", "cem", np.zeros(20), np.eye(20), len),)), np.eye(20)
        >>> def causes(residual):
        ...     columns, further = {gain: one[:, :1]}, [lambda: {height: one[:, 1:2]}]
        ...     residuals = Residuals(residual, one, columns, 0.1 * one[:, 4:])
        ...     return CauseEffects(stack, np.zeros(20), {}, dict, dict, further, residuals, {}, len, None, dict)
        >>> [[f.name for f in causes(30.0 * one[i]).explain_residuals()[1].best.causes] for i in (0, 1)]
        [['gain'], ['height']]

        A size that was asked for beside it stays known:

        >>> gain = Candidate("gain", "scene", "1 km", False, (lambda _, z: {"km": z},), sizes=(-2.0, 2.0))
        >>> asked = lambda truths, title, budgeted: [truth["km"] * one[0] for (truth,) in truths]
        >>> tried = replace(causes(0.0), evaluate=asked)
        >>> case = Residuals(3.0 * one[0] + 30.0 * one[1], one, {gain: np.outer(one[0], gain.sizes)}, 0.1 * one[:, 4:])
        >>> found = replace(tried, residuals=case).explain_residuals()[0].columns
        >>> [len(one.sizes) == made.shape[1] > 2 for one, made in found.items()]
        [True]
        """
        explain = partial(self.explain, rows=np.arange(self.predicted.size), level=self.predicted, noisy=True)

        def is_enough(found: Posterior) -> bool:
            return found.first_cause == NOTHING or (found.is_sufficient and len(found.best.causes) == 1)

        residuals, found = explain(self.residuals)
        heights = {} if is_enough(found) else self.rarer[0]()
        if heights and is_enough((wider := explain(residuals._replace(columns={**residuals.columns, **heights})))[1]):
            return wider
        return residuals, found

    def sides(self) -> dict[str, tuple[str, str, str]]:
        """Of each quantity the bands, what is observed and what is predicted, to six digits."""
        out = {}
        for block, i in self.stack.with_slices():
            observed, predicted = (" ".join(f"{x:.6g}" for x in side) for side in (block.observed, self.predicted[i]))
            out[block.quantity] = (" ".join(map(str, self.stack.bands[i])), observed, predicted)
        return out

    def explain_since(self, texts_of: Mapping[str, Sequence[str]], *, simulated: bool) -> Posterior | None:
        """What explains the change since a run with the sides ``texts_of``; None where both share no quantity.

        What is less than its uncertainty and is not explained is nothing to explain.  Else the same data and the same
        draws have no noise: what was measured moved, or the prediction did.  Where measured spectra moved the data are
        to say why, and the model too where they are ``simulated``; else the model.

        Spectra of two targets that a user exchanged in both files move scores of both sides, and P_FA at thresholds
        that were measured, which says nothing of the model alone; where a score near 0 ends in another digit, nothing
        is asked:

        >>> from hyperval.attribute import ResidualBlock
        >>> def block(product, *observed):
        ...     return ResidualBlock(product, "paint", "cem", np.array(observed), 1e-6 * np.eye(len(observed)), len)
        >>> def causes(*blocks, **of):
        ...     stack, none = Stack(blocks), {}
        ...     n, files = stack.observed.size, of.get("files", {})
        ...     asked = of.get("evaluate", lambda truths, title, budgeted: [])
        ...     rarer = of.get("rarer", ())
        ...     residuals = Residuals(np.zeros(n), 1e-6 * np.eye(n), {}, np.eye(n))
        ...     return CauseEffects(stack, np.zeros(n), {}, lambda level: none, lambda: files, rarer, residuals,
        ...                   {}, asked, of.get("mistake_effect"), lambda: none)
        >>> exchanged = Candidate("spectra of targets in the file", "scene", "", False, labels=("red and green",))
        >>> tried = causes(block("scores", 0.1, 0.9), block("roc", -4.0), files={exchanged: np.c_[[0.8, -0.6, -9.0]]})
        >>> texts = {"scores of paint cem": ("-1 -2", "0.5 0.4", "0.8 -0.6"), "roc of paint cem": ("-1", "-4", "2.0")}
        >>> found = tried.explain_since(texts, simulated=False)
        >>> found.first_cause, found.is_sufficient
        ('spectra of targets in the file', True)
        >>> texts = {"scores of paint cem": ("-1 -2", "0.10001 0.9", "0 1e-05"), "roc of paint cem": ("-1", "-4", "0")}
        >>> tried.explain_since(texts, simulated=False).first_cause
        'nothing to explain'

        Targets are looked for two pixels away at first, where one pixel may show nothing, then beside the best:

        >>> def at(mistake):
        ...     by = np.array([mistake.get("lines", 0), mistake.get("samples", 0)])
        ...     return (np.hypot(3, 2) - np.hypot(*(by - [3, 2]))) * np.array([0.1, 0.0]) * np.any(np.abs(by) > 1)
        >>> texts = {"scores of paint cem": ("-1 -2", f"{0.1 - 0.1 * 13**0.5} 0.9", "0 0")}
        >>> found = causes(block("scores", 0.1, 0.9), mistake_effect=at).explain_since(texts, simulated=False)
        >>> found.first_cause, found.best.causes[0].description
        ('position of the target regions', '+3 lines, +2 samples')

        An atmosphere that explains a change is told by the engine itself, not by its emulator:

        >>> air = Candidate("standard atmosphere", "atmosphere", "", False, (lambda *_: {},), labels=("winter",))
        >>> texts = {"scores of paint cem": ("-1 -2 -3", "0.1 0.9 0.4", "0.5 -0.3 0.2")}
        >>> tried = causes(block("scores", 0.1, 0.9, 0.4), rarer=[lambda: {air: np.c_[[0.45, -0.33, 0.2]]}],
        ...                evaluate=lambda truths, title, budgeted: [np.array([0.5, -0.3, 0.2]) * budgeted])
        >>> tried.explain_since(texts, simulated=False).is_sufficient
        True

        Regions that alone moved are looked for elsewhere, and two of them in each other's place:

        >>> def light(name, level):
        ...     return ResidualBlock("radiance", name, "", np.full(3, level), 1e-6 * np.eye(3), len, np.arange(3))
        >>> texts = {f"radiance of {name}": ("0 1 2", "0.4 0.5 0.6", "0 0 0") for name in ("red", "green", "lot")}
        >>> texts["radiance of lot"] = ("0 1 2", "0.7 0.7 0.7", "0 0 0")
        >>> tried = causes(light("red", 0.2), light("green", 0.1), light("lot", 0.7), mistake_effect=lambda mistake:
        ...                asked.append(mistake) or np.zeros(9))
        >>> asked = []
        >>> tried.explain_since(texts, simulated=False).first_cause, len(asked), asked[0]
        ('none of these', 40, {'exchanged': ['red', 'green']})
        >>> asked[1], asked[32]["lines"]
        ({'lines': -2, 'samples': -2, 'regions': True, 'still': ['lot']}, -6)

        Where no place of all targets fits, lines were lost, and those that lie beyond are looked for alone:

        >>> def lost(mistake):
        ...     is_lost = (mistake.get("lines"), mistake.get("samples")) == (-5, 0)
        ...     return np.array([0.3 * is_lost, 0.0, 0.2 * is_lost * (mistake.get("beyond", 0.0) < 0.6), 0.0])
        >>> noise = 1e-6 * np.eye(2)
        >>> two = [ResidualBlock("scores", n, "cem", np.array([0.4, 0.9]), noise, len) for n in ("red", "lot")]
        >>> texts = {"scores of red cem": ("-1 -2", "0.1 0.9", "0 0"), "scores of lot cem": ("-1 -2", "0.4 0.9", "0 0")}
        >>> found = causes(*two, mistake_effect=lost).explain_since(texts, simulated=False)
        >>> found.first_cause, found.best.causes[0].description, found.is_sufficient
        ('position of the target regions beyond some line', '-5 lines, +0 samples from 5/8 of the image on', True)

        Scores that moved by some thousandths are no rounding:

        >>> texts = {"scores of paint cem": ("-1 -2 -3", "0.1 0.9 0.4", "0.003 -0.002 0.001")}
        >>> fill = {Candidate("fill fraction", "scene", "", False): np.c_[[0.003, -0.002, 0.001]]}
        >>> tried = causes(block("scores", 0.1, 0.9, 0.4), rarer=[lambda: fill])
        >>> tried.explain_since(texts, simulated=False).first_cause
        'fill fraction'

        Spectra that hardly moved do not hide scores that did:

        >>> texts = {"radiance of red": ("0 1 2", "0.4 0.4 0.4", "0 0 0"), "scores of paint cem": ("-1", "0.9", "0.0")}
        >>> tried = causes(light("red", 0.40005), block("scores", 0.1), mistake_effect=lambda mistake: np.zeros(4))
        >>> tried.explain_since(texts, simulated=False).first_cause
        'none of these'

        A band that held nothing in the accepted run has no part by which it moved:

        >>> spectrum = ResidualBlock("radiance", "paint", "", np.full(3, 0.4), 1e-6 * np.eye(3), len, np.arange(3))
        >>> texts = {"radiance of paint": ("0 1 2", "0 0.4 0.4", "0 0 0")}
        >>> tried = causes(spectrum, mistake_effect=lambda mistake: np.zeros(3))
        >>> tried.explain_since(texts, simulated=False).first_cause
        'none of these'

        What is rarer is asked one after the other, until one cause suffices:

        >>> def rarer(name, column):
        ...     return lambda: asked.append(name) or {Candidate(name, "scene", "", False): np.c_[column]}
        >>> texts, asked = {"scores of paint cem": ("-1 -2 -3", "0.1 0.9 0.4", "0.5 0.2 0.1")}, []
        >>> three = [rarer("haze", [1.0, 9.0, 1.0]), rarer("date", [0.5, 0.2, 0.1]), rarer("sun", [1.0, 0.0, 0.0])]
        >>> found = causes(block("scores", 0.1, 0.9, 0.4), rarer=three).explain_since(texts, simulated=False)
        >>> found.first_cause, found.is_sufficient, asked
        ('date', True, ['haze', 'date'])

        And none of it where there is nothing to explain:

        >>> tried, none = causes(block("scores", 0.1, 0.9, 0.4), rarer=three), np.zeros(3)
        >>> tried.explain_with_rarer(none, np.arange(3), none + 1.0, {}).first_cause, asked
        ('nothing to explain', ['haze', 'date'])
        """
        sides = {name: [np.array(text.split(), dtype=float) for text in texts] for name, texts in texts_of.items()}
        shared = self.stack.shared_entries({name: bands for name, (bands, *_) in sides.items()})
        if not shared:
            return None
        rows = np.concatenate([part for _, part, _ in shared])
        observed, predicted = np.hstack([np.array(sides[name][1:])[:, index] for name, _, index in shared])
        moved, of_model = change = np.array([self.stack.observed[rows] - observed, predicted - self.predicted[rows]])
        scale = np.maximum(np.abs([observed, predicted]), self.stack.bands[rows] < 0)  # scores: written to digits of 1
        same = np.all(np.abs(change) <= AS_WRITTEN * scale)
        posterior = None if same else self._explain_moves(moved, of_model, rows, observed, predicted, simulated)
        size = Whitened(moved + of_model, self.residuals.covariance[np.ix_(rows, rows)]).chi_square
        if posterior is not None and (size > 1.0 or posterior.is_sufficient):
            return posterior
        return Posterior.for_zero_residuals(rows.size)

    def _explain_moves(
        self, moved: Array, of_model: Array, rows: Index, observed: Array, predicted: Array, simulated: bool
    ) -> Posterior:
        """What explains that the entries ``rows`` moved from what was ``observed`` and ``predicted``."""
        spectral, level, columns = self.stack.bands >= 0, self.predicted.copy(), self.residuals.columns
        if np.any(np.abs(moved) > UNMOVED * np.abs(observed), where=spectral[rows]):
            level[rows] = np.where(spectral[rows], observed, predicted)
            light = (spectral | (self.stack.entry_labels("product") == "snr"))[rows]
            all_rows, change, rows, moved = rows, moved, rows[light], moved[light]
            # No field spectrum, which could make anything, has moved what was measured.
            can = (c for c in columns if c.kind == "sensor" or (simulated and not c.fits_any_spectrum))
            columns = {c: self.scale_to_level(level, columns[c]) for c in can}
            columns |= self.spectral_errors(level) | self.stack.subject_errors(level)
            if len(displaced := self._moved_subjects(moved, rows, level)[0]) == 2:
                one = Candidate("exchanged regions", "scene", "", False, labels=(" and ".join(displaced),))
                columns[one] = self.mistake_effect({"exchanged": displaced})[:, None]
            if simulated and (by_setting := self.explain_with_rarer(moved, rows, level, columns)).is_sufficient:
                return by_setting
            found = self.explain_displaced(moved, rows, level, columns, True)
            if simulated and found.first_cause == NONE:  # a new simulation has other noise, and scores too
                each = (self.input_columns, *(more() for more in self.rarer))
                inputs = {replace(c, unbounded=True): g[all_rows] for columns in each for c, g in columns.items()}
                residuals = self.residuals.subset(all_rows)._replace(values=change, columns=inputs)
                _, noisy = self.explain(residuals, all_rows, self.predicted, True)
                return replace(noisy, beside_noise=True) if noisy.is_sufficient else found
            if found.first_cause != NOTHING:  # else scores moved, and spectra hardly did
                return found
            rows, moved, level = all_rows, change, self.predicted.copy()
        of_scores = bool(np.any(np.abs(of_model) > CHANGE_FLOOR, where=~spectral[rows]))
        is_measured = bool(np.any(np.abs(moved) > CHANGE_FLOOR))
        # A wrong entry moves filters, and all that follows from them, on both sides; false alarms are read at
        # measured thresholds.
        alone = (self.stack.entry_labels("product")[rows] != "roc") | (not is_measured)
        by_entry = self.explain_change(of_model[alone], rows[alone], level, self.entry_effects()) if of_scores else None
        if by_entry and by_entry.is_sufficient:
            return by_entry
        if is_measured:
            steps = dict[Candidate, Array]()
            for name, step, key, unit, sizes in CAUSES["image"]:
                effects = np.column_stack([self.mistake_effect({key: unit * z}) for z in sizes])
                steps[Candidate(name, "sensor", step, False, sizes=tuple(sizes))] = effects
            if (by_data := self.explain_displaced(moved, rows, level, steps, False)).first_cause not in (NONE, NOTHING):
                return by_data
        return self.explain_with_rarer(moved + of_model, rows, level, self.input_columns)

    @property
    def input_columns(self) -> dict[Candidate, Array]:
        """What may have moved a prediction: no pixel has moved."""
        return {c: g for c, g in self.residuals.columns.items() if c.kind != "region"}

    def explain_with_rarer(self, moved: Array, rows: Index, level: Array, columns: Columns) -> Posterior:
        """What explains a change; where no single cause suffices, rarer candidates are tried too."""
        found = self.explain_change(moved, rows, level, columns)
        for more in self.rarer:
            if found.first_cause == NOTHING or (found.is_sufficient and len(found.best.causes) == 1):
                break
            if further := more():
                columns = {**columns, **further}
                found = self.explain_change(moved, rows, level, columns)
        return found

    def explain_displaced(self, moved: Array, rows: Index, level: Array, columns: Columns, regions: bool) -> Posterior:
        """What explains a change; where nothing does, regions and targets displaced by some pixels, measured again."""
        found = self.explain_change(moved, rows, level, columns)
        if found.first_cause == NONE and (exchanged := self.exchange_effects()):
            columns = {**columns, **exchanged}
            found = self.explain_change(moved, rows, level, columns)
        displaced, still = self._moved_subjects(moved, rows, level)
        effects, nearest = dict[tuple[int, int], Array](), (0, 0)
        where = f"regions {', '.join(displaced)}" if regions and still else "regions" if regions else "target regions"
        for _ in range(MAX_PIXELS if found.first_cause == NONE else 0):
            reach = (-1, 0, 1) if effects else (-2, -1, 0, 1, 2)
            around = [(nearest[0] + i, nearest[1] + j) for i, j in product(reach, repeat=2)]
            around += [] if effects else _FARTHER
            for i, j in around:
                if (i, j) not in effects and (i, j) != (0, 0):
                    effects[i, j] = self.mistake_effect({"lines": i, "samples": j, "regions": regions, "still": still})
            labels = tuple(f"{i:+d} lines, {j:+d} samples" for i, j in effects)
            place = Candidate(f"position of the {where}", "scene", "", False, labels=labels)
            found = self.explain_change(moved, rows, level, {**columns, place: np.column_stack([*effects.values()])})
            best = next((f for f in found.fits if f.candidate == place), None)
            before, nearest = nearest, list(effects)[int(best.amplitudes[0])] if best else nearest
            if found.is_sufficient or nearest == before:
                break
        if effects and found.first_cause == NONE:  # lost lines displace some of them: by the entries that moved most
            size = np.where(self.stack.bands[rows] < 0, 1.0, np.abs(level[rows]) + np.abs(moved) + 1e-12)
            most = np.abs(moved) > 0.1 * size * np.max(np.abs(moved / size))
            i, j = min(effects, key=lambda shift: float(np.sum(((moved - effects[shift][rows]) / size)[most] ** 2)))
            lost = {f"{i:+d} lines, {j:+d} samples from {n}/8 of the image on": n / 8.0 for n in range(1, 8)}
            mistake = {"lines": i, "samples": j, "regions": regions}
            moves = [self.mistake_effect({**mistake, "beyond": part}) for part in lost.values()]
            what = f"position of the {'' if regions else 'target '}regions beyond some line"
            one = Candidate(what, "scene", "", False, labels=tuple(lost))
            found = self.explain_change(moved, rows, level, {**columns, one: np.column_stack(moves)})
        return found

    def _moved_subjects(self, moved: Array, rows: Index, level: Array) -> tuple[list[str], list[str]]:
        """Subjects whose measured radiance moved from ``level``, and those whose did not."""
        # Reflectance follows the empirical line, which is fitted to other regions.
        light = np.isin(self.stack.entry_labels("product")[rows], RADIOMETRIC)
        light = light if light.any() else self.stack.bands[rows] >= 0
        subjects, off = self.stack.entry_labels("subject")[rows], np.abs(moved) > UNMOVED * np.abs(level[rows])
        displaced = list(dict.fromkeys(subjects[light & off].tolist()))
        return displaced, [name for name in dict.fromkeys(subjects[light].tolist()) if name not in displaced]

    def explain_change(self, moved: Array, rows: Index, level: Array, columns: Columns) -> Posterior:
        """What explains a change (k,) of the entries ``rows``, beside ``level`` (m,).

        Its variance is that of rounding, and of the error of effects that were evaluated at another level.
        """
        variance, change = np.zeros(level.size), np.zeros(level.size)
        change[rows] = moved
        for block, i in self.stack.with_slices():
            size, floor = (np.abs(level[i]), SPECTRUM_FLOOR) if block.bands is not None else (np.ones(1), CHANGE_FLOOR)
            size = size.clip(1e-3 * size.max() + 1e-12)
            variance[i] = size**2 * (floor**2 + OFF**2 * np.mean((change[i] / size) ** 2))
        near = {replace(c, unbounded=True): g[rows] for c, g in columns.items() if np.any(g[rows])}
        residuals = Residuals(moved, np.diag(variance[rows]), near, self.residuals.wide[rows])
        return self.explain(residuals, rows, level, False)[1]

    def scale_to_level(self, level: Array, change: Array) -> Array:
        """A change (n,) or (n, k) of the prediction, that of spectra scaled to ``level`` (n,)."""
        spectral = self.stack.bands >= 0
        return np.asarray((change.T * np.divide(level, self.predicted, np.ones(level.size), where=spectral)).T)

    def explain(self, residuals: Residuals, rows: Index, level: Array, noisy: bool) -> tuple[Residuals, Posterior]:
        """What explains residuals of the entries ``rows``: between sizes the model is interpolated, and asked at those
        that are found, of a change by the engine itself; the residuals with those.
        """
        columns, exact = dict(residuals.columns), set[tuple[Candidate, float]]()
        for last in range(MAX_ROUNDS, -1, -1):
            residuals = residuals._replace(columns=columns)
            found = residuals.posterior(ALL, noisy)
            named = [f for h in found.hypotheses[:MAX_REFINED] for f in h.causes] + list(found.fits[:MAX_REFINED])
            sizes = {c: float(f.amplitudes[0]) for f in named if (c := f.candidate).sizes and c.members}
            # At none of those that the model was asked at.
            sizes = {c: a for c, a in sizes.items() if min(abs(a - s) for s in (0.0, *c.sizes)) > 0.005 * abs(a) + 1e-4}
            labels = {f.candidate: float(f.amplitudes[0]) for f in named if f.candidate.labels}
            sizes |= {c: i for c, i in labels.items() if c.kind == ATMOSPHERE and not noisy and (c, i) not in exact}
            evaluate = partial(self.evaluate, budgeted=not noisy)
            more = _evaluate(evaluate, [c.truths(0, a) for c, a in sizes.items()]) if last and sizes else []
            for (c, a), side in zip(sizes.items(), more, strict=False):
                if side is not None:
                    change = self.scale_to_level(level, side - self.predicted)[rows]
                    if c.labels:
                        exact.add((c, a))
                        columns[c] = np.where(np.arange(len(c.labels)) == a, change[:, None], columns[c])
                    else:
                        columns[replace(c, sizes=(*c.sizes, a))] = np.column_stack([columns.pop(c), change])
            if not any(side is not None for side in more):
                break
        return residuals, found


def _evaluate(evaluate: Evaluate, truths: Sequence[Truths]) -> list[Array | None]:
    """What the model says; None of what cannot be, such as a sun below the horizon, or is not on this machine.

    >>> def evaluate(truths, title):
    ...     if "kurucz" in truths:
    ...         raise MissingDataError("the solar spectrum 'kurucz' is not on this machine")
    ...     return [np.zeros(1) for _ in truths]
    >>> [side is not None for side in _evaluate(evaluate, ["tsis-1", "kurucz", "astm-g173"])]
    [True, False, True]
    """
    try:
        return [*evaluate(truths, "attribution: larger errors")]
    except (UsageError, EngineError, MissingDataError):
        half = len(truths) // 2
        return [*_evaluate(evaluate, truths[:half]), *_evaluate(evaluate, truths[half:])] if half else [None]


def collect_effects(model: ScenarioModel) -> CauseEffects:
    """Everything that may have made a difference, each as a change of what is compared.

    Raises
    ------
    UsageError : nothing that both sides hold.

    Examples
    --------
    Candidates of two scenarios are tried in each of them too; those of four are not, as each takes runs of its own.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.errors import InputError
    >>> from hyperval.model import read_world
    >>> from hyperval.products import PredictedProducts, SpectralEstimate
    >>> stated = load_scenario("green-planks-grass").model_copy(update={"atmosphere": None})
    >>> world, lawn = read_world(stated), SpectralEstimate(np.full(360, 0.2), 1e-4 * np.eye(360))
    >>> side = PredictedProducts(world.stated.axis, reflectance={"lawn": lawn})
    >>> predict = lambda scenarios, truths, budgeted: iter([side] * len(truths))
    >>> def causes(lines):
    ...     scenarios = [stated.model_copy(update={"name": f"line {i}"}) for i in range(lines)]
    ...     asked = predict, side, side, None
    ...     return collect_effects(ScenarioModel(scenarios, [world] * lines, *asked, looked_for={"green plank": 0.3}))
    >>> [[c.name for c in causes(n).rarer[2]() if c.name.startswith("wavelength shift in")] for n in (1, 2, 4)]
    [[], ['wavelength shift in line 0', 'wavelength shift in line 1'], []]
    >>> fraction = {"subject": stated.scene.classes[0].name, "absolute": 0.002}
    >>> tight = stated.with_values({"uncertainty.fractions": [fraction]})
    >>> model = ScenarioModel([tight], [read_world(tight)], predict, side, side, None)
    >>> (only,) = (c for c in collect_effects(model).residuals.columns if c.budgeted)
    >>> [round(size) for size in only.sizes]  # of 0.002, at which 0.2 is asked where nothing is stated
    [10, -10, -50, 50]

    What was measured is off by 0.01 in each band, what is predicted too, by 0.002 of these in all bands at once:

    >>> def moves(scenarios, truths, budgeted):
    ...     for (moved,) in truths:
    ...         off = sum(float(value.sum()) for path, value in moved.items() if path.startswith("fraction"))
    ...         yield replace(side, reflectance={"lawn": replace(lawn, mean=lawn.mean + off)})
    >>> budget = collect_effects(replace(model, predict=moves)).residuals.covariance
    >>> (1e6 * budget[0, :2]).round(2), round(2e2 + 4.0 - 1e2 / len(budget), 2), round(4.0 - 1e2 / len(budget), 2)
    (array([203.39,   3.39]), 203.39, 3.39)
    >>> [one.labels[0] for one in causes(1).entry_effects()]
    ['green plank: that looked for', 'asphalt: that of grass']

    A field spectrum is off by four smooth shapes, and in each band by itself:

    >>> grass = PredictedProducts(world.stated.axis, reflectance={"grass": lawn})
    >>> both = lambda scenarios, truths, budgeted: iter([grass] * len(truths))
    >>> (made,) = (g for c, g in collect_effects(ScenarioModel([stated], [world], both, grass, grass, None))
    ...            .residuals.columns.items() if c.name == "field spectrum of grass")
    >>> made.shape[1] - len(made)
    4

    What takes runs of the engine moves many scenarios one by one; what few have is asked where little else explains:

    >>> lit = load_scenario("green-planks-grass")
    >>> def asked(scenarios, truths, budgeted):
    ...     for moved in truths:
    ...         yield replace(side, reflectance={"lawn": replace(lawn, mean=lawn.mean + 0.01 * sum(map(bool, moved)))})
    >>> for n in (3, 4):
    ...     made = collect_effects(ScenarioModel([lit] * n, [read_world(lit)] * n, asked, side, side, None))
    ...     air = {c.name: g[0].round(9).tolist() for c, g in made.residuals.columns.items() if c.kind == ATMOSPHERE}
    ...     [air.get(name) for name in ("aerosol optical depth", "sunlight", "aerosol type")]
    ...     [c.sizes for c in made.residuals.columns if "depth" in c.name], [len(more()) for more in made.rarer[:2]]
    [[0.03, 0.03, 0.03, 0.03], [0.03, 0.03, 0.03, 0.03], [0.03, 0.03, 0.03, 0.03]]
    ([(1.0, -1.0, -5.0, 10.0)], [2, 0])
    [[0.01, 0.01, 0.01, 0.01], [0.04, 0.04, 0.04, 0.04], None]
    ([()], [0, 1])

    What is measured again with another setting is a number by its steps or one of several, as it is stated; what
    cannot be measured, such as an empty region, is none of them.  An offset of one arm moves that arm.

    >>> def observe(settings, mistake):
    ...     if (limit := settings.get("limit", 0.0)) > 0.8:
    ...         raise InputError("the region 'lawn' holds no pixel")
    ...     light = replace(lawn, mean=lawn.mean + limit + mistake.get("offset", 0.0))
    ...     return PredictedProducts(world.stated.axis, radiance={"lawn": light})
    >>> limits = {-1.0: 0.5, 2.0: 0.9, "a for b": 0.7, "c": 0.9}
    >>> each = [(z, {"limit": x}) for z, x in limits.items()]
    >>> tried = {"limit": (dict(each[:2]), "0.05"), "entry": (dict(each[2:]), "")}
    >>> side = PredictedProducts(world.stated.axis, radiance={"lawn": lawn})
    >>> found = collect_effects(ScenarioModel([stated], [world], predict, side, side, observe, tried))
    >>> for one, made in found.exchange_effects().items():
    ...     print(one.name, one.sizes[:2], one.labels, made[[0, -1], 0].round(9).tolist())
    limit (-1.0,) () [-0.5, -0.5]
    entry () ('a for b',) [-0.7, -0.7]
    offset of 942-2470 nm (-20.0, -8.0) () [0.0, 0.2]
    offset of 395-936 nm (-20.0, -8.0) () [0.2, 0.0]
    >>> gain = {c.name: g for c, g in found.spectral_errors(found.predicted).items()}["sensor gain of 942-2470 nm"]
    >>> (100.0 * gain[[0, -1], -1]).round(9).tolist()  # by 25 %
    [0.0, 5.0]
    """
    base, observed, worlds = model.predict_scenarios(model.scenarios), model.observed, model.worlds
    stack = stack_of(base, observed)
    refuse(not stack.blocks, "attribution.nothing")
    predicted = stack.predicted(base)

    def predictions(truths: Sequence[Truths], title: str, budgeted: bool = False) -> Iterable[Products]:
        return track(model.predict(model.scenarios, truths, budgeted), title, len(truths))

    def evaluate(*asked: Any, **options: Any) -> list[Array]:
        return [stack.predicted(p) for p in predictions(*asked, **options)]

    further = further_candidates(worlds)
    moved = every_input(worlds, further)
    steps = {
        stated: [c.truths(d, z) for c in moved if c.budgeted is stated for d in range(c.size) for z in (1.0, -1.0)]
        for stated in (True, False)
    }  # the order of the candidates
    found = chain.from_iterable(predictions(steps[stated], "attribution: inputs", stated) for stated in steps)
    units, ends, sides = dict[Candidate, Array](), dict[Candidate, tuple[Numbers, Numbers]](), Sides()
    for candidate in moved:
        both = [(next(found), next(found)) for _ in range(candidate.size)]
        ends[candidate] = quantities(both[0][0], observed), quantities(both[0][1], observed)
        up, down = (np.stack([stack.predicted(side) for side in way], axis=1) for way in zip(*both, strict=True))
        units[candidate] = 0.5 * (up - down)
        sides |= {(candidate, 1.0): up[:, 0], (candidate, -1.0): down[:, 0]}
    budget = sum((g @ g.T for c, g in units.items() if c.budgeted), np.zeros((predicted.size, predicted.size)))
    covariance = stack.covariance + budget + stack.excess_covariance(model.budgeted, budget)
    # Each atmospheric value takes an engine run per scenario: with many scenarios each input has one direction.
    many = len(worlds) > MAX_SCENARIOS
    by_engine = [c for c in moved if many and c.needs_engine and c.sizes]
    rare = [c for c in further if many and c.kind == ATMOSPHERE]
    by_name = {c.name: c for c in (*further, *moved) if c not in (*rare, *by_engine)}
    sampled = [c for c in by_name.values() if c.sizes or c.labels]
    columns = {c: g for c, g in units.items() if not c.sizes} | _candidate_columns(sampled, sides, predicted, evaluate)
    for c in by_engine:
        truths = [c.for_scenario(i, "").truths(0, 1.0) for i in range(len(worlds))]
        each = evaluate(truths, "attribution: scenario by scenario")
        columns[replace(c, sizes=())] = np.column_stack([side - predicted for side in each])
    for c in moved:  # each band of a field spectrum by itself too
        if c.kind == "surface" and not c.sizes and (name := c.name.removeprefix("field spectrum of ")) != c.name:
            columns[c] = np.column_stack([columns[c], stack.subject_bands(predicted, name)])
    fractions = {c.name: c.fraction for s in model.scenarios for c in s.scene.classes}
    spectra = {b.product: getattr(base, b.product) for b in stack.blocks if b.bands is not None}.items()
    classes = {product: {n: s.mean for n, s in each.items() if n in fractions} for product, each in spectra}
    arms = arm_masks(worlds[0])
    spectral_errors = partial(_spectral_errors, stack, classes, fractions, observed.axis.centre_nm)
    columns |= spectral_errors(predicted, {})
    residuals = Residuals(stack.observed - predicted, covariance, columns, stack.unstructured(predicted))
    entry_effects = partial(_candidate_columns, entry_candidates(worlds, model.looked_for), {}, predicted, evaluate)
    rarer = rarer_candidates(worlds)
    if not many:  # candidates of several scenarios, in one of them
        shared = [c for c in (*sampled, *rarer) if sum(map(bool, c.truths(0, 0.0))) > 1]
        rarer += [c.for_scenario(i, s.name) for i, s in enumerate(model.scenarios) for c in shared]

    def mistake_effect(mistake: Mapping[str, Any], settings: Mapping[str, Any] = {}) -> Array:
        try:
            return stack.difference_from(stack_of(base, model.observe(settings, mistake)))
        except HypervalError:  # not measurable so: panels that make no line, an empty region
            return np.zeros(predicted.size)

    def exchange_effects() -> dict[Candidate, Array]:
        out = dict[Candidate, Array]()
        for name, (variants, step) in model.exchanges.items():
            effects = {z: effect for z, settings in variants.items() if np.any(effect := mistake_effect({}, settings))}
            if effects:
                sizes, labels = (tuple(effects), ()) if step else ((), tuple(effects))
                one = Candidate(name, "scene", step, False, sizes=sizes, labels=labels)
                out[one] = np.column_stack([*effects.values()])
        for where, arm in arms.items():  # the noise stays, so that the SNR of dark pixels moves too
            one = Candidate(f"offset of {where}", "sensor", "0.01 of the mean", False, sizes=_OFFSETS)
            out[one] = np.column_stack([mistake_effect({"offset": 0.01 * z * arm}) for z in one.sizes])
        return out

    heights = [c for c in rarer if c.name in HEIGHTS and not many]
    parts = heights, rare, [c for c in rarer if c not in heights]
    asked = [cache(partial(_candidate_columns, candidates, {}, predicted, evaluate)) for candidates in parts]
    return CauseEffects(
        stack, predicted, quantities(base, observed), partial(spectral_errors, arms=arms), entry_effects, asked,
        residuals, ends, evaluate, mistake_effect, exchange_effects,
    )  # fmt: skip


def _candidate_columns(
    candidates: Sequence[Candidate], sides: Sides, predicted: Array, evaluate: Evaluate
) -> dict[Candidate, Array]:
    """What candidates make at their sizes or by their alternatives, without what cannot be; some are known.

    >>> def evaluate(truths, title):
    ...     if ["kurucz"] in truths:
    ...         raise MissingDataError("the solar spectrum 'kurucz' is not on this machine")
    ...     return [np.zeros(1) for _ in truths]
    >>> sun = Candidate("solar spectrum", "atmosphere", "", False, (lambda _, label: label,), labels=("kurucz", "tsis"))
    >>> (candidate,) = _candidate_columns([sun], {}, np.zeros(1), evaluate)
    >>> candidate.labels, candidate.truths(0, 0.0)
    (('tsis',), ['tsis'])
    """
    places: dict[Candidate, Sequence[float]] = {c: c.sizes or range(len(c.labels)) for c in candidates}
    wanted = [(c, z) for c, sizes in places.items() for z in sizes if (c, z) not in sides]
    asked = _evaluate(evaluate, [c.truths(0, z) for c, z in wanted]) if wanted else []
    found, out = {**sides, **dict(zip(wanted, asked, strict=True))}, {}
    for c, sizes in places.items():
        made = {z: side - predicted for z in sizes if (side := found[c, z]) is not None}
        kept = {"sizes": tuple(made)} if c.sizes else {"labels": tuple(c.labels[int(i)] for i in made)}
        if made:
            out[replace(c, **kept)] = np.column_stack([*made.values()])
    return out


def attribute(
    model: ScenarioModel, options: AttributionOptions, accepted: Accepted | None, *, simulated: bool
) -> list[Result]:
    """Move every input, run every what-if, say how likely each is the reason.

    Rows of the product attribution: for each group of residuals ``reduced_chi_square`` and ``p_value`` under the
    stated uncertainties, then for each candidate ``probability`` (of being the first cause), ``likelihood_gain`` (twice
    the log-likelihood gained, averaged over its sizes) and ``needed_uncertainty`` (its size in units of its stated
    uncertainty, or of a usual step); of each quantity ``reduced_chi_square`` after the causes that are named; of a
    background its ``pfa_ratio``, and which experiment explains it if any.  sensitivity: for each number of the
    comparison the change per unit of each input, with the units that would close the gap, and
    its share of the variance.
    what-if: ``reduced_chi_square`` after the experiment, each summary gap after it, and ``pfa_ratio`` of every
    background.

    Parameters
    ----------
    accepted : what came since that run is told by itself
    simulated : whether what is measured comes of a model too

    Raises
    ------
    UsageError : nothing that both sides hold, or a what-if that fits no scenario.
    """
    effects = collect_effects(model)
    stated = {c: ends for c, ends in effects.ends.items() if c.budgeted}
    outcomes = _what_ifs(model, effects, options.what_ifs)
    ranked = effects.explain_residuals()[0].posteriors(effects.stack, options.each)
    if accepted and (since := effects.explain_since(accepted[0], simulated=simulated)) is not None:
        since = add_uncertainty_remark(since, ranked[0].chi_square / ranked[0].dof, accepted[1])
        ranked.append(replace(since, group=SINCE, level=ranked[0].level))
    rows = [item for group in ranked for item in _posterior_rows(group)]
    rows += _remainder_rows(effects, ranked[0])
    measured = quantities(model.observed, model.observed)
    for quantity, value in effects.numbers.items():
        shares = variance_shares(value, [(up[quantity], down[quantity]) for up, down in stated.values()])
        shares_of = dict(zip(stated, shares.tolist(), strict=True))
        rows += _sensitivity_rows(quantity, measured[quantity] - value, effects.ends, shares_of)
    return rows + outcomes


def variance_shares(base: float, ends: Sequence[tuple[float, float]]) -> Array:
    """(k,) part of a quantity's variance that each of k inputs brings; NaN for a quantity without variance.

    Inputs are standard normal, and the quantity is the polynomial of degree two through the values: of
    f0 + a z + b (z^2 - 1)/sqrt(2) with orthonormal terms the variance is the sum of the squares of
    a = (f+ - f-)/2 and b = (f+ + f- - 2 f0)/sqrt(2).  Source: Sudret, Reliab. Eng. Syst. Saf. 93, 964-979, 2008.

    Parameters
    ----------
    base : f0, the quantity with every input at its middle
    ends : for each input f+ and f-, with it one standard deviation up and down

    Examples
    --------
    >>> f = lambda z, w: 3.0 * z + w**2
    >>> ends = [(f(1.0, 0.0), f(-1.0, 0.0)), (f(0.0, 1.0), f(0.0, -1.0))]
    >>> (11.0 * variance_shares(f(0.0, 0.0), ends)).round(9).tolist(), variance_shares(1.0, [(1.0, 1 + 1e-13)])
    ([9.0, 2.0], array([nan]))
    """
    alone = np.array([0.25 * (up - down) ** 2 + 0.5 * (up + down - 2.0 * base) ** 2 for up, down in ends])
    variance = alone.sum()
    return alone / (variance if variance > 1e-24 * (1.0 + base**2) else np.nan)


def _spectral_errors(
    stack: Stack, classes: Classes, area: Mapping[str, float], centre_nm: Array, level: Array, arms: Mapping[str, Array]
) -> dict[Candidate, Array]:
    """Errors that are linear in the spectra that are compared: of single bands, of a smooth gain, of stray light ..."""
    bands, mixed = stack.single_bands(level), stack.class_mixing(level, classes)
    gain, offset = (stack.pieces(level, centre_nm, KNOTS_NM, additive=additive) for additive in (False, True))
    gains, shared = gain.sum(axis=1), offset.sum(axis=1)
    scene = stack.scene_mean(classes, area, shared)
    flat = np.where(gains != 0.0, np.mean(shared[gains != 0.0]), 0.0) if gains.any() else gains
    smooth, mean, part = f"{100 * SMOOTH_PART:g} % in smooth pieces", "0.01 of the mean radiance", "0.01 of the area"
    parts: list[tuple[str, str, str, tuple[float, ...], Array]] = [
        (SINGLE_BANDS, "sensor", f"{100 * BAND_PART:g} % in each band", (), BAND_PART * bands),
        ("smooth gain of the sensor", "sensor", smooth, (), SMOOTH_PART * gain),
        ("smooth offset of the sensor", "sensor", smooth, (), SMOOTH_PART * offset),
        ("stray light", "sensor", mean, (-5.0, 20.0), 0.01 * (scene - gains)),
        ("stray light between wavelengths", "sensor", mean, (-5.0, 20.0), 0.01 * stack.spectral_stray_light(level)),
        ("constant offset of the sensor", "sensor", mean, (-5.0, 20.0), 0.01 * flat),
        *((name, "region", part, (-5.0, 50.0), change) for name, change in mixed.items()),
    ]
    for where, arm in arms.items():
        parts.append((f"sensor gain of {where}", "sensor", "1 %", (-20.0, 25.0), 0.01 * gains * arm[stack.bands]))
    units = tuple(f"x {factor:g}" for factor in UNITS)
    lit = np.where(stack.bands >= 0, level, 0.0)
    out = {Candidate("unit of the measured spectra", "sensor", "", False, labels=units): np.outer(lit, UNITS - 1.0)}
    for name, kind, step, sizes, change in parts:
        if np.any(change):
            one = Candidate(name, kind, step, False, sizes=sizes, knots_nm=tuple(KNOTS_NM) if step == smooth else ())
            out[one] = np.outer(change, sizes) if sizes else change
    return out


NEAR_A_POWER = 0.3  # of ten: to a factor of two


def scale_warnings(rows: Sequence[Result]) -> Iterator[str]:
    """A warning where every spectrum that was measured is ten times what is predicted, a tenth of it, or the like.

    >>> def rows(*levels):
    ...     return [Result("", "reflectance", "", "", "median_difference_ratio_windows", 0.4 / x - 1.0) for x in levels]
    >>> [[text[9:63] for text in scale_warnings(rows(*seen))] for seen in ((0.04, 0.03, math.nan), (0.04, 0.4), (0.1,))]
    [['every measured reflectance is some 0.1 times the predi'], [], []]
    """
    for quantity in ("radiance", "reflectance", "toa_reflectance"):
        ratios = [r.value for r in rows if (r.product, r.metric) == (quantity, "median_difference_ratio_windows")]
        logs = [math.log10(1.0 + ratio) for ratio in ratios if ratio > -1.0]
        powers = {-round(x) if abs(x - round(x)) < NEAR_A_POWER else 0 for x in logs}
        if len(powers) == 1 and (power := powers.pop()):
            why = "a scale of the image that is off by a power of ten (collection.cube.scale), or another material"
            yield f"warning: every measured {quantity} is some {10.0**power:g} times the predicted one: {why}"


def add_uncertainty_remark(since: Posterior, now: float, then: float) -> Posterior:
    """A change, with a remark where numbers that are the same have another reduced chi-square than ``then``, if any."""
    other = then and abs(now / then - 1.0) > OFF
    words = f"check the stated uncertainty (reduced chi-square {now:.3g}, {then:.3g} in that run): "
    return replace(since, remark=words if other else "")


def _posterior_rows(r: Posterior) -> Iterator[Result]:
    """Rows of what explains one group of residuals, or a change.

    >>> since = replace(Posterior.for_zero_residuals(40), group=SINCE)
    >>> next(_posterior_rows(since)).reason
    'spectra, SNR, scores, and false alarms at 1e-2 and 1e-3 have not changed beyond their uncertainty'
    >>> next(_posterior_rows(add_uncertainty_remark(since, 2.0, 1.8))).reason[:77]
    'check the stated uncertainty (reduced chi-square 2, 1.8 in that run): spectra'
    >>> add_uncertainty_remark(since, 2.0, 2.0).remark, add_uncertainty_remark(since, 2.0, 0.0).remark
    ('', '')
    >>> next(_posterior_rows(replace(since, group=ALL, chi_square=40.0, p_value=0.47))).reason
    'nothing to explain: reduced chi-square 1 of 40 residuals (p = 0.47)'
    >>> lawn = replace(since, group="lawn", p_value=1e-9)
    >>> [str(next(_posterior_rows(replace(since, group=ALL, p_value=p, parts=(lawn,)))).outcome) for p in (1e-9, 0.47)]
    ['disagrees', 'none']
    >>> from hyperval.attribute.posterior import Hypothesis, build_effect
    >>> one = np.eye(2)[:, :1]
    >>> a, b = (build_effect(Candidate(name, "sensor", "1 %", False), one).fit(9.0 * one[:, 0]) for name in "ab")
    >>> likely = {NOTHING: 0.0, NONE: 0.0, "a": 0.2, "b": 0.8}
    >>> both = Posterior(ALL, 81.0, 2, 0.0, (a, b), (Hypothesis((b,), 0.0, (0.1,)),), likely)
    >>> [(x.method, x.reason[:6]) for x in _posterior_rows(both) if x.metric == "probability" and x.reason]
    [('b', 'rank 1'), ('a', 'rank 2')]
    >>> [x.value for x in _posterior_rows(both) if x.metric == "likelihood_gain"] == 2 * [2.0 * a.evidence]
    True
    """
    # The test of all products together concludes too, and informs.
    words = r.remark + UNCHANGED if r.group == SINCE and r.first_cause == NOTHING else r.conclusion
    summary = row("reduced_chi_square", r.chi_square / r.dof, reason=words, n=r.dof)
    if r.group != SINCE and (r.is_too_wide or r.p_value < r.level):
        summary = replace(summary, outcome=Outcome.DISAGREES, cause=Cause.TOO_WIDE if r.is_too_wide else Cause.NONE)
    tests = [summary, row("p_value", r.p_value, n=r.dof)]
    if r.best.causes:
        why = "with " + " and ".join(x.name for x in r.best.causes) + " freed"
        tests.append(row("p_value_explained", r.remaining_p_value, reason=why, n=r.dof))
    yield from named(tests, "attribution", r.group, _EVERYTHING)
    for name in (NOTHING, NONE):
        yield from named([row("probability", r.probability[name], n=r.dof)], "attribution", r.group, name)
    by_probability = sorted(r.fits, key=lambda fit: -float(f"{r.probability[fit.name]:.6g}"))
    for place, item in enumerate(by_probability, start=1):
        none, cause = ("", Cause.NONE) if item.candidate.budgeted else (" (none is stated)", Cause.NO_UNCERTAINTY)
        unit = f"in units of the {item.candidate.unit}{none}"
        gained = {"probability": r.probability[item.name], "likelihood_gain": max(2.0 * item.evidence, 0.0)}
        out = [row(name, value, reason=f"rank {place}: {item.description}", n=r.dof) for name, value in gained.items()]
        if not item.candidate.labels:  # one of several has no size
            out.append(row("needed_uncertainty", abs(item.units), cause=cause, reason=unit))
        yield from named(out, "attribution", r.group, item.name)


def _remainder_rows(effects: CauseEffects, r: Posterior) -> Iterator[Result]:
    """Of each quantity the reduced chi-square before and after the cause that is named first.

    >>> from hyperval.attribute import ResidualBlock
    >>> one, gain = np.eye(20), Candidate("gain", "scene", "1 km", False)
    >>> stack = Stack((ResidualBlock("scores", "paint", "cem", np.zeros(20), one, len),))
    >>> residuals = Residuals(30.0 * one[0] + 2.0 * one[1], one, {gain: one[:, :1]}, 0.1 * one[:, 4:])
    >>> effects = CauseEffects(stack, np.zeros(20), {}, dict, dict, [], residuals, {}, len, None, dict)
    >>> found = _remainder_rows(effects, residuals.posterior(ALL, True))
    >>> [(r.subject, r.method, round(r.value, 1), r.reason) for r in found]
    [('scores of paint cem', 'gain', 0.2, '45.2 before')]
    """
    if not r.best.causes or r.first_cause == NONE:
        return
    (residual, covariance, *_), first = effects.residuals, r.best.causes[0]
    remaining = residual - Whitened(residual, covariance).unwhiten(first.shown)
    for block, part in effects.stack.with_slices():
        spread = covariance[part, part]
        before, after = (Whitened(x[part], spread).chi_square / block.observed.size for x in (residual, remaining))
        found = row("reduced_chi_square", after, n=block.observed.size, before=before, reason=f"{before:.4g} before")
        yield from named([found], "attribution", block.quantity, first.name)


def _sensitivity_rows(
    quantity: Quantity, gap: float, ends: Ends, shares: Mapping[Candidate, float]
) -> Iterator[Result]:
    """Rows of one number, by input: its change with one unit, and how many units would close the gap.

    >>> quantity, gain = ("roc", "lawn", "cem/pixel", "pd@1e-2"), Candidate("gain", "sensor", "1 %", True)
    >>> moves = {gain: (0.6, 0.4), Candidate("haze", "scene", "10 %", False): (0.5, 0.5 + 1e-15)}
    >>> ends = {candidate: tuple({quantity: pd} for pd in both) for candidate, both in moves.items()}
    >>> for r in _sensitivity_rows(quantity, 0.05, ends, {gain: 0.25}):
    ...     print(r.method, round(r.value, 9), r.before, r.reason)
    gain / cem/pixel 0.1 0.05 per stated uncertainty; gap 0.05, closed by +0.5 units; share of the variance 0.25
    haze / cem/pixel -0.0 0.05 per 10 %; gap 0.05, which this input cannot close
    >>> next(_sensitivity_rows(quantity, 0.05, ends, {gain: math.nan})).reason[-5:]
    'units'
    """
    product, subject, numbered, metric = quantity
    for candidate, (up, down) in ends.items():
        change = 0.5 * (up[quantity] - down[quantity])
        closes = round(gap / change, 12) if abs(change) > 1e-12 * abs(up[quantity]) else math.inf
        reason = f"gap {gap:.4g}"
        reason += f", closed by {closes:+.3g} units" if math.isfinite(closes) else ", which this input cannot close"
        if math.isfinite(share := shares.get(candidate, math.nan)):  # no stated input moves some
            reason += f"; share of the variance {share:.3g}"
        unit = "stated uncertainty" if candidate.budgeted else candidate.step
        method = f"{candidate.name} / {numbered}" if numbered else candidate.name
        found = row(f"{product}_{metric}_change", change, before=gap, reason=f"per {unit}; {reason}")
        yield replace(found, product="sensitivity", subject=subject, method=method)


def _what_ifs(model: ScenarioModel, effects: CauseEffects, what_ifs: Sequence[WhatIf]) -> list[Result]:
    """Rows of every experiment of a campaign, the one that closes most of the gap first; then those of false alarms.

    ``reduced_chi_square`` after it, ``likelihood_gain`` and each summary gap after it.  The gain is the fall of the
    chi-square: twice the log-likelihood gained under the same covariance.

    Raises
    ------
    UsageError : an experiment that fits no scenario, or compares other things than the campaign does.

    Examples
    --------
    What is measured again has another uncertainty, and false alarms follow.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.products import ExceedanceCurve, SpectralEstimate
    >>> from hyperval.spectra import SpectralAxis
    >>> axis, p = SpectralAxis([500.0, 600.0], 5.0), np.geomspace(0.5, 1e-5, 200)
    >>> def side(level, variance=0.0):
    ...     light = SpectralEstimate(np.full(2, level), variance * np.eye(2))
    ...     curve = ExceedanceCurve(-level * np.log(p), p, p / 2.0, p, 5000)
    ...     return Products(axis, radiance={"lawn": light}, exceedance={("roof", "cem"): curve})
    >>> def predict(scenarios, truths, budgeted):
    ...     return iter([side(scenarios[0].scene.classes[0].gain)])
    >>> data, stack = side(1.1, 0.01), stack_of(side(1.0), side(1.1, 0.01))
    >>> residuals = Residuals(np.zeros(2), stack.covariance + 0.01 * np.eye(2), {}, np.eye(2))
    >>> numbers = quantities(side(1.0), data)
    >>> effects = CauseEffects(stack, np.ones(2), numbers, dict, dict, [], residuals, {}, len, None, dict)
    >>> model = ScenarioModel([load_scenario("panels")], [], predict, data, data, lambda settings, _: side(1.05, 0.04))
    >>> tried = [WhatIf(name="dark", question="darker?", scenario={"scene.classes.grass.gain": 0.9}),
    ...          WhatIf(name="again", question="better?", observe={"collection.cube.scale": 2.0})]
    >>> for r in _what_ifs(model, effects, tried):
    ...     print(r.method, r.metric, round(r.value, 3), r.n, r.reason)
    again reduced_chi_square 0.05 2 0.5 before; better?
    again likelihood_gain 0.9 2 p = 0.95 after
    again median_radiance_difference_ratio 0.048 2 0.09091 before
    dark reduced_chi_square 2.0 2 0.5 before; darker?
    dark likelihood_gain -3.0 2 p = 0.14 after
    dark median_radiance_difference_ratio 0.182 2 0.09091 before
    cem pfa_ratio@1e-2 0.631 None within a factor of two
    again / cem pfa_ratio@1e-2 0.794 None 0.631 before (0.32 to 1.3)
    dark / cem pfa_ratio@1e-2 0.359 None 0.631 before (0.32 to 1.3)
    """
    stack = effects.stack

    def misfit(name: str, predicted: Products, other: Products) -> tuple[Whitened, dict[str, float], dict[Key, Result]]:
        """Residuals over their uncertainty, summary gaps, ratios of false alarms."""
        after = stack if other is model.observed else stack_of(predicted, other)
        now, before = ([b.observed.shape for b in side.blocks] for side in (after, stack))
        measured: Array | None = None
        with suppress(KeyError):  # of a subject that is not there any more
            measured = after.predicted(predicted) if now == before else None
        values = after.observed - needed(measured, "whatif.other", name=name)
        spread = effects.residuals.covariance
        spread = spread if after is stack else spread - stack.covariance + after.covariance
        return Whitened(values, spread), summary_gaps(effects.numbers, predicted, other), alarm_ratios(predicted, other)

    def run(item: WhatIf) -> tuple[Whitened, dict[str, float], dict[Key, Result]]:
        predicted = model.predict_scenarios(changed_scenarios(model.scenarios, item))
        return misfit(item.name, predicted, model.observe(item.observe, {}) if item.observe else model.observed)

    if not what_ifs:
        return []
    (start, gaps, alarms), rows = misfit("", model.predict_scenarios(model.scenarios), model.observed), list[Result]()
    outcomes = sorted(((w, *run(w)) for w in track(what_ifs, "attribution: what-ifs")), key=lambda o: o[1].chi_square)
    n = start.residual.size
    was = start.chi_square / n
    for item, after, closed, _ in outcomes:
        now, p, words = after.chi_square / n, special.chdtrc(n, after.chi_square), f"{was:.4g} before; {item.question}"
        out = [row("reduced_chi_square", now, n=n, before=was, reason=words)]
        out.append(row("likelihood_gain", (was - now) * n, n=n, reason=f"p = {p:.2g} after"))
        for name, gap in gaps.items():
            metric = "_".join(name.replace("|", "").replace("@", " at ").split())
            out.append(row(metric, closed[name], n=n, before=gap, reason=f"{gap:.4g} before"))
        rows += named(out, "what-if", "all", item.name)
    return [*rows, *_alarm_rows(alarms, [(item.name, ratios) for item, *_, ratios in outcomes])]


def changed_scenarios(scenarios: Sequence[Scenario], item: WhatIf) -> list[Scenario]:
    """The scenarios with an experiment's settings; one whose names do not fit stays as it is.

    Raises
    ------
    UsageError : the settings fit none of them.

    Examples
    --------
    >>> from hyperval.api import load_scenario
    >>> both = [load_scenario("panels"), load_scenario("green-planks-grass")]
    >>> larger = WhatIf(name="larger", question="?", scenario={"scene.targets.green plank.gain": 2.0})
    >>> [[target.gain for target in s.scene.targets] for s in changed_scenarios(both, larger)]
    [[], [2.0]]
    """
    out, errors = [], []
    for scenario in scenarios:
        try:
            out.append(with_settings(scenario, item.scenario) if item.scenario else scenario)
        except UsageError as error:
            errors.append(error)
            out.append(scenario)
    refuse(errors and len(errors) == len(scenarios), "whatif.nowhere", name=item.name, why=errors and errors[0].what)
    return out


def summary_gaps(numbers: Numbers, predicted: Products, observed: Products) -> dict[str, float]:
    """Summary gaps: median relative difference of spectra, mean difference of P_D; without what is measured no more.

    >>> from hyperval.products import RocCurve, SpectralEstimate
    >>> from hyperval.spectra import SpectralAxis
    >>> pfa = np.array([1e-2, 1.0])
    >>> def side(*levels):
    ...     each = dict(zip("abc", levels))
    ...     light = {name: SpectralEstimate(np.full(1, x), np.eye(1)) for name, x in each.items()}
    ...     curves = {(n, "cem", "pixel"): RocCurve(pfa, *3 * [x / 4.0 * pfa**0], -pfa) for n, x in each.items()}
    ...     return Products(SpectralAxis([500.0], 5.0), radiance=light, roc=curves)
    >>> predicted, measured = side(1.1, 0.8, 2.0), side(1.0, 1.0, 1.0)
    >>> numbers = quantities(predicted, measured)
    >>> {name: round(gap, 9) for name, gap in summary_gaps(numbers, predicted, measured).items()}
    {'median |radiance difference ratio|': 0.2, 'mean |pd@1e-2 difference|': 0.108333333}
    >>> fewer = {quantity: value for quantity, value in numbers.items() if quantity[1] != "c"}
    >>> [round(gap, 9) for gap in summary_gaps(fewer, predicted, measured).values()]
    [0.15, 0.0375]
    """
    parts, measured = defaultdict[str, list[float]](list), quantities(observed, observed)
    for quantity, value in quantities(predicted, observed).items():
        product, *_, metric = quantity
        name = f"mean |{metric} difference|" if product == "roc" else f"median |{product} difference ratio|"
        if quantity in numbers:  # a spectrum over itself is 1
            parts[name].append(abs(value - measured[quantity]))
    return {name: float(np.mean(v) if name.startswith("mean") else np.median(v)) for name, v in parts.items()}


def alarm_ratios(predicted: Products, observed: Products) -> dict[Key, Result]:
    """Rows of P_FA predicted over measured by (background, detector, metric), at 1e-2 and 1e-3 where both have it.

    >>> from hyperval.products import ExceedanceCurve
    >>> from hyperval.spectra import SpectralAxis
    >>> p = np.geomspace(0.5, 1e-5, 200)
    >>> curves = (ExceedanceCurve(-np.log(p), p, p / 2.0, p, n) for n in (None, 5000))
    >>> sides = (Products(SpectralAxis([500.0], 5.0), exceedance={("roof", "cem"): curve}) for curve in curves)
    >>> [(r.subject, r.method, r.n, r.metric, round(r.value, 9)) for r in alarm_ratios(*sides).values()]
    [('roof background', 'cem', None, 'pfa_ratio@1e-2', 1.0)]
    """
    wanted = {f"pfa_ratio@{short_label(level)}" for level in POINTS}
    return {
        (background_of(name), detector, one.metric): replace(one, subject=background_of(name), method=detector, n=None)
        for (name, detector), measured in observed.exceedance.items()
        if (model := predicted.exceedance.get((name, detector))) is not None
        for one in compare_exceedance(model, measured)
        if one.metric in wanted and one.outcome is Outcome.NONE
    }


def _log_error(ratio: Result) -> float:
    """|ln ratio|: by how much it is wrong, either way."""
    return abs(math.log(ratio.value)) if ratio.value > 0.0 else math.inf


def explain_ratio(before: Result, tried: Iterable[tuple[str, Result]]) -> str:
    """In words, which experiment explains a ratio that is off by more than a factor of two, or that none does.

    Examples
    --------
    >>> r = [row("pfa_ratio@1e-2", v, (v / 2, v * 2)) for v in (6.0, 1.5, 4.0)]
    >>> explain_ratio(r[0], [("local", r[1]), ("tails", r[2])])
    "off by a factor of 6; 'local' leaves 1.5, which would explain it"
    >>> explain_ratio(r[1], [("tails", r[2])])
    'within a factor of two'
    """
    if _log_error(before) <= math.log(FACTOR):
        return "within a factor of two"
    size = f"off by a factor of {math.exp(_log_error(before)):.2g}"
    if before.lower <= FACTOR and before.upper >= 1.0 / FACTOR:
        size += ", within its interval"
    name, best = min(tried, key=lambda item: _log_error(item[1]), default=("", before))
    if _log_error(best) >= _log_error(before):
        return f"{size}; no what-if reduces it"
    end = "which would explain it" if _log_error(best) <= math.log(FACTOR) else "the largest reduction, not sufficient"
    return f"{size}; {name!r} leaves {best.value:.2g}, {end}"


def _alarm_rows(before: Mapping[Key, Result], outcomes: Sequence[tuple[str, Mapping[Key, Result]]]) -> Iterator[Result]:
    """Every ratio of false alarms with its reason, then the ratio after each experiment.

    >>> ratio, after = (replace(row("pfa_ratio@1e-2", v, (v / 2, v * 2)), method="cem") for v in (6.0, 1.5))
    >>> key = "roof background", "cem", "pfa_ratio@1e-2"
    >>> for r in _alarm_rows({key: ratio, ("other", *key[1:]): ratio}, [("local", {key: after})]):
    ...     print(r.product, r.method, r.value, r.reason)
    attribution cem 6.0 off by a factor of 6; 'local' leaves 1.5, which would explain it
    what-if local / cem 1.5 6 before (3 to 12)
    """
    tried = {k: each for k in before if (each := [(name, alarms[k]) for name, alarms in outcomes if k in alarms])}
    for key, each in tried.items():
        yield replace(before[key], product="attribution", reason=explain_ratio(before[key], each))
    for key, each in tried.items():
        words = f"{before[key].value:.3g} before ({before[key].lower:.2g} to {before[key].upper:.2g})"
        for name, after in each:
            yield replace(after, product="what-if", method=f"{name} / {after.method}", reason=words)

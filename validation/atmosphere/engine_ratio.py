"""What MODTRAN 6 has over the embedded engine, as numbers that the package ships.

    HYPERVAL_DATA=... python validation/atmosphere/engine_ratio.py src/hyperval/atmosphere/engine_ratio.csv

Made from eleven airborne states of two flights, whose coefficient A (sun to ground to sensor) is divided by its own
continuum, a line through the windows, so that scattering stays out.  Channel by channel the logarithm of 6S over
MODTRAN is a straight line in the air and in the water on the way.  Path of the aerosol and spherical albedo come from
the states that were run with DISORT.

``tests/atmosphere/test_atmosphere_modtran.py`` predicts each flight from numbers made without it (another sun, height,
band model): what is left then is the error that a budget holds.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from modtran_cases import Case, cases, data_file, matched, smoothed

from hyperval.atmosphere import AtmosphericTerms, EngineRatio, amounts, sixs_terms
from hyperval.datasets import cache_root

# Channels where gases absorb next to nothing in both codes: the continuum of the ratio goes through them.
CONTINUUM_NM = (
    377, 407, 437, 452, 557, 617, 677, 752.5, 782.6, 872.7, 1008, 1038, 1053, 1248.4, 1563.9, 1624, 2134.9, 2240.1
)  # fmt: skip
MIN_TRANSMITTANCE = 0.02  # below it MODTRAN prints too few digits, and nothing can be seen
WINDOW = 0.95
SMOOTH_NM = 30.0
PATH_NM = (600.0, 700.0, 1700.0)  # scalar and vector Rayleigh light differ below; emission counts beyond
MIN_AOT = 0.1  # for the path: thinner haze is mostly above the aircraft
PASSES = 2
HEAD = """What MODTRAN 6 has over 6S V2.1, by validation/atmosphere/engine_ratio.py from airborne channel files:
isofit/isofit examples/topoflux/lut and isofit/isofit-tutorials 20171108_Pasadena (Apache-2.0).
dry: optical depth per slanted atm; water: per slanted g cm-2; path: factor on rural aerosol;
albedo: factor on the part that rural aerosol below the free troposphere has in S.
"""


@dataclass(frozen=True)
class Pair:
    """A state, its MODTRAN terms and the ways of its light."""

    case: Case
    theirs: AtmosphericTerms
    air_atm: float
    water_g_cm2: float

    @property
    def flight(self) -> str:
        """The first word of the name."""
        return self.case.name.split()[0]

    def ours(self, ratio: EngineRatio | None) -> AtmosphericTerms:
        """The embedded engine at MODTRAN's channels, under its sun."""
        return matched(self.case, sixs_terms(self.case.state, cache_root(), ratio=ratio))[0]


def pairs_of(locate: Callable[[str], Path]) -> list[Pair]:
    """All states."""
    pairs = []
    for case in cases(locate):
        _, theirs = matched(case, sixs_terms(case.state, cache_root(), ratio=None))
        air_atm, water_g_cm2, _ = amounts(case.state)[1][:, 0]
        pairs.append(Pair(case, theirs, air_atm, water_g_cm2))
    return pairs


def fitted(pairs: Sequence[Pair]) -> EngineRatio:
    """The numbers from some states."""
    nm = pairs[0].theirs.wavelength_nm
    none, one = np.zeros(nm.size), np.ones(nm.size)
    ratio = EngineRatio(nm, none, none, one, one)
    for _pass in range(PASSES):  # the second mends what the average over a channel left of the first
        dry, water = _gas(pairs, ratio)
        ratio = EngineRatio(nm, ratio.dry + dry, ratio.water + water, one, one)
    return EngineRatio(nm, ratio.dry, ratio.water, _path(pairs, ratio), _albedo(pairs, ratio))


def _gas(pairs: Sequence[Pair], ratio: EngineRatio) -> tuple[np.ndarray, np.ndarray]:
    """(n,) optical depth that MODTRAN has over ours, per air and per water."""
    nm = pairs[0].theirs.wavelength_nm
    rows, seen = [], []
    anchors = [int(np.argmin(np.abs(nm - x))) for x in CONTINUUM_NM]
    for pair in pairs:
        ours, theirs = pair.ours(ratio), pair.theirs
        known = (theirs.direct > 0.0) & (theirs.gas_transmittance > MIN_TRANSMITTANCE)
        log = np.log(np.where(known, ours.direct, 1.0) / np.where(known, theirs.direct, 1.0))
        rows.append(log - np.interp(np.log(nm), np.log(nm[anchors]), log[anchors]))
        seen.append(known)
    y, known = np.array(rows), np.array(seen)
    design = np.array([[p.air_atm, p.water_g_cm2] for p in pairs])
    solution = np.full((2, nm.size), np.nan)
    for i in range(nm.size):
        here = known[:, i]
        if np.linalg.matrix_rank(design[here]) == 2:
            solution[:, i] = np.linalg.lstsq(design[here], y[here, i], rcond=None)[0]
    there = np.isfinite(solution[0])
    return np.interp(nm, nm[there], solution[0, there]), np.interp(nm, nm[there], solution[1, there])


def _smooth(nm: np.ndarray, values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Gaussian mean over SMOOTH_NM of straight lines through the known values."""
    return smoothed(nm, np.interp(nm, nm[known], values[known]), SMOOTH_NM)


def _path(pairs: Sequence[Pair], ratio: EngineRatio) -> np.ndarray:
    """(n,) what the aerosol's part of the path is to be multiplied by; 1 in the visible."""
    nm = pairs[0].theirs.wavelength_nm
    factors, window = [], np.ones(nm.size, dtype=bool)
    for pair in pairs:
        if pair.case.albedos is None or pair.case.state.aot550 < MIN_AOT:
            continue
        twice = EngineRatio(nm, ratio.dry, ratio.water, 2.0 * ratio.path, ratio.albedo)
        once = pair.ours(ratio).path_radiance
        aerosol = pair.ours(twice).path_radiance - once
        factors.append(1.0 + (pair.theirs.path_radiance - once) / np.maximum(aerosol, 1e-9))
        window &= pair.theirs.gas_transmittance > WINDOW
    if not factors:
        return np.ones(nm.size)
    window &= (nm >= PATH_NM[0]) & (nm <= PATH_NM[2])
    level = _smooth(nm, np.mean(factors, axis=0), window)
    share = np.clip((nm - PATH_NM[0]) / (PATH_NM[1] - PATH_NM[0]), 0.0, 1.0)
    return 1.0 + share * (level - 1.0)


def _albedo(pairs: Sequence[Pair], ratio: EngineRatio) -> np.ndarray:
    """(n,) factor on the aerosol's part of the spherical albedo."""
    nm = pairs[0].theirs.wavelength_nm
    known = [p for p in pairs if p.case.albedos is not None]
    depth = np.array([p.case.state.aot550 for p in known])
    window = np.all([p.theirs.gas_transmittance > WINDOW for p in known], axis=0)
    none = EngineRatio(nm, ratio.dry, ratio.water, ratio.path, np.zeros(nm.size))
    factors = []
    for pair in known:
        molecules, whole = pair.ours(none).spherical_albedo, pair.ours(ratio).spherical_albedo
        factors.append((pair.theirs.spherical_albedo - molecules) / (whole - molecules))
    # Each amount of haze counts once, however many amounts of water it has.
    levels = [np.mean([f for f, d in zip(factors, depth, strict=True) if d == x], axis=0) for x in np.unique(depth)]
    return _smooth(nm, np.mean(levels, axis=0), window)


if __name__ == "__main__":
    ratio = fitted(pairs_of(data_file))
    columns = [getattr(ratio, f.name) for f in fields(EngineRatio)]
    names = ",".join(f.name for f in fields(EngineRatio))
    np.savetxt(sys.argv[1], np.stack(columns, axis=1), "%.5g", ",", header=HEAD + names)

"""MODTRAN 6 channel files of airborne states, the same states for hyperval, and what the scripts beside share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, read_channels, read_chn, terms_from_runs
from hyperval.spectra import SpectralAxis

ALBEDOS = (0.0, 0.1, 0.5)


def data_file(relative: str) -> Path:
    """A file below HYPERVAL_DATA."""
    root = os.environ.get("HYPERVAL_DATA")
    if not root:
        sys.exit("set HYPERVAL_DATA to the data directory")
    return Path(root) / relative


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def smoothed(wavelength_nm: np.ndarray, values: np.ndarray, sigma_nm: float) -> np.ndarray:
    """Gaussian mean of the values that there are."""
    finite = np.isfinite(values)
    weights = np.exp(-0.5 * ((wavelength_nm[:, None] - wavelength_nm) / sigma_nm) ** 2) * finite
    return (weights @ np.where(finite, values, 0.0)) / weights.sum(axis=1)


@dataclass(frozen=True)
class Case:
    """One MODTRAN state."""

    name: str
    path: Path
    state: AtmosphericState
    albedos: tuple[float, ...] | None


def cases(locate: Callable[[str], Path]) -> Iterator[Case]:
    """Every airborne state with a stated run template (rural aerosol, midlatitude summer, 0.3 atm cm ozone)."""
    common = {"ozone_atm_cm": 0.3, "aerosol": "rural", "model": "midlatitude-summer"}
    topoflux = {
        "ground_altitude_km": 0.401945, "sensor_altitude_km": 2.300449,
        "latitude_deg": 34.45333858, "longitude_deg": -118.59692454, "time_utc": "2018-09-11T18:57:00Z",
    }  # fmt: skip
    pasadena = {
        "ground_altitude_km": 0.35, "sensor_altitude_km": 2.3,
        "latitude_deg": 34.139247, "longitude_deg": -118.127521, "time_utc": "2017-11-08T18:42:29Z",
    }  # fmt: skip
    flights = (
        ("topoflux", "modtran/modtran6_airborne_lut/{}.chn.gz", topoflux, ALBEDOS, (0.05, 0.2), (0.75, 1.25, 2.25)),
        ("pasadena lut", "pasadena/lut/{}.chn", pasadena, None, (0.01, 0.1), (1.5, 2.0)),
        ("pasadena lut_multi", "pasadena/lut_multi/{}.chn", pasadena, ALBEDOS, (0.1,), (1.5,)),
    )
    for flight, path, of_flight, albedos, *states in flights:
        for aot, water in product(*states):
            name = f"AOT550-{aot:.4f}_H2OSTR-{water:.4f}"
            state = AtmosphericState(**common, **of_flight, aot550=aot, water_vapour_g_cm2=water)
            yield Case(f"{flight} {name}", locate(path.format(name)), state, albedos)


def matched(case: Case, terms: AtmosphericTerms) -> tuple[AtmosphericTerms, AtmosphericTerms]:
    """(hyperval, MODTRAN) at the channels, both with the solar spectrum of the file.

    The file gives mu0 E0 / pi averaged over the channel; each term of ours is divided by its own average
    and multiplied by the file's.
    """
    runs = read_channels(case.path)
    run = runs[0]
    reference = terms_from_runs(runs, case.albedos) if case.albedos else read_chn(case.path)
    axis = SpectralAxis(run.wavelength_nm, np.clip(run.width_nm * 0.9394, 1.0, None))  # Gaussian of equal width
    ours = terms.at_bands(axis)
    ratio = run.sun / ours.diffuser_radiance
    return (
        AtmosphericTerms(
            ours.wavelength_nm, ours.path_radiance * ratio, ours.direct * ratio, ours.adjacency * ratio,
            ours.spherical_albedo, ours.ground_irradiance * ratio, ours.gas_transmittance,
        ),
        reference,
    )  # fmt: skip


def total_radiance(terms: AtmosphericTerms, rho: float) -> np.ndarray:
    """At-sensor radiance over uniform ground."""
    return terms.path_radiance + (terms.direct + terms.adjacency) * rho / (1.0 - terms.spherical_albedo * rho)

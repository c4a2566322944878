"""Top-of-atmosphere reflectance that a network of sites computed, as the collected side."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hyperval.collection_files import RadCalNetSource
from hyperval.errors import InputError
from hyperval.prediction.inputs import correlation
from hyperval.products import Observation, SpectralEstimate
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.radcalnet import TOP, read_radcalnet

DECIMALS = 4  # of the values in a file
ROUNDING, NETWORK = "rounding", "as the network states"


def observe_radcalnet(source: RadCalNetSource, resolve: Callable[[str], Path]) -> Observation:
    """The half hours of a day, each a subject.

    The bands are those in which any of them has a value.

    Raises
    ------
    InputError : a file that is missing or corrupt, of the surface, or without a value.
    UsageError : a half hour without values.
    """
    day = read_radcalnet(resolve(source.path))
    if day.quantity != TOP:
        raise InputError(
            "holds the reflectance of the surface", where=day.source, expected="the day's file that ends in .output"
        )
    times = tuple(source.times) or day.valid
    if not times:
        raise InputError("no half hour has a value", where=day.source, mend="take a day of better weather")
    rows = [day.column(time) for time in times]
    bands = np.isfinite(day.values[rows]).any(axis=0)
    nm = day.wavelength_nm[bands]
    axis = SpectralAxis(nm, np.full(nm.size, source.fwhm_nm))
    rounding = np.eye(nm.size) * 10.0 ** (-2 * DECIMALS) / 12.0
    out = {}
    for time, row in zip(times, rows, strict=True):
        stated = np.nan_to_num(day.uncertainty[row, bands])
        errors = {ROUNDING: rounding}
        if not source.shared_inputs:
            errors[NETWORK] = np.outer(stated, stated) * correlation(axis, source.correlation_nm)
        budget = {name: np.sqrt(np.diag(c)) for name, c in errors.items()}
        out[source.subject.format(site=day.site, time=time)] = SpectralEstimate(
            day.values[row, bands], np.sum(list(errors.values()), axis=0), budget=budget, stated=stated
        )
    notes = [f"bands are taken as {source.fwhm_nm:g} nm wide: the network's file does not state their width"]
    if source.shared_inputs:
        notes.append("both sides start from the same surface and state: their errors are not in the difference")
    return Observation(axis=axis, toa_reflectance=out, notes=tuple(notes), provenance={"quantity": TOP})

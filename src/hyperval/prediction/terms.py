"""Atmospheric terms on bands, kept for the next prediction of the same state."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.spectra.axis import SpectralAxis

_KEPT: OrderedDict[tuple[object, ...], AtmosphericTerms] = OrderedDict()
_MOST = 32
# What decides which files an engine finds.
_ENVIRONMENT = (
    "HYPERVAL_CACHE", "HYPERVAL_DATA", "HYPERVAL_MODTRAN", "HYPERVAL_MODTRAN_VERSION", "HYPERVAL_MODTRAN_DATA"
)  # fmt: skip


def terms_in_memory(
    engine: Callable[..., AtmosphericTerms],
    state: AtmosphericState,
    axis: SpectralAxis,
    *,
    cache_dir: Path | None,
    show_progress: bool | None,
) -> AtmosphericTerms:
    """The terms of ``engine`` at the bands of ``axis``; the latest 32 are kept in memory.

    Engines are deterministic: the same engine, state, place of its files and bands give the same terms.
    """
    key = (
        engine, state, cache_dir, *(os.environ.get(name) for name in _ENVIRONMENT),
        axis.centre_nm.tobytes(), axis.fwhm_nm.tobytes(),
    )  # fmt: skip
    terms = _KEPT.get(key)
    if terms is None:
        terms = engine(state, cache_dir=cache_dir, show_progress=show_progress).at_bands(axis)
        _KEPT[key] = terms
        if len(_KEPT) > _MOST:
            _KEPT.popitem(last=False)
    _KEPT.move_to_end(key)
    return terms

"""A table computed from an engine over a grid of states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.atmosphere import solar
from hyperval.atmosphere.cache import cache_folder
from hyperval.atmosphere.sixs import sixs_terms
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.table import AXES, OPTIONAL, QUANTITIES, AtmosphericTable, coordinates, leave_one_out
from hyperval.errors import UsageError
from hyperval.progress import track

_GREATEST_NODES = 20_000
_BUILT = [name for name in AXES if name in AtmosphericState.model_fields]  # an azimuth between two is no field


def build_table(
    base: AtmosphericState,
    axes: Mapping[str, Sequence[float]],
    *,
    cache_dir: Path | None = None,
    show_progress: bool | None = None,
) -> AtmosphericTable:
    """Run the embedded engine at every node of a grid.

    Parameters
    ----------
    base : the state that all nodes share but for the axes
    axes : field of the state -> increasing nodes; fields of the sun need a ``base`` whose sun is given by angles
    cache_dir, show_progress : of the engine; what it computed before is not computed again

    Returns
    -------
    AtmosphericTable with its leave-one-node-out error.

    Raises
    ------
    UsageError : an axis that a table cannot have, or a node that is no valid state.
    EngineError : the engine failed.
    """
    if base.engine != "sixs":
        raise UsageError(f"a table is built with engine: sixs, not {base.engine}")
    order = [name for name in _BUILT if name in axes]
    unknown = set(axes) - set(order)
    if unknown or not order:
        named = ", ".join(sorted(unknown)) or "no axis"
        raise UsageError(f"{named} in a table", expected="axes among " + ", ".join(_BUILT))
    nodes = {name: np.asarray(axes[name], dtype=float) for name in order}
    shape = tuple(n.size for n in nodes.values())
    if np.prod(shape) > _GREATEST_NODES:
        raise UsageError(f"{np.prod(shape)} nodes", expected=f"at most {_GREATEST_NODES}")
    combinations = list(product(*(n.tolist() for n in nodes.values())))
    states = [_at_node(base, dict(zip(order, c, strict=True))) for c in combinations]
    folder = cache_folder(cache_dir)
    rows = [
        _quantities(state, folder)
        for state in track(states, "atmosphere table", total=len(states), show=show_progress)
    ]
    wavelength = rows[0]["wavelength_nm"]
    quantities = {
        name: np.stack([row[name] for row in rows]).reshape((*shape, wavelength.size))
        for name in (*QUANTITIES, *OPTIONAL)
    }
    engine = {k: v for k, v in rows[0]["provenance"].items() if k not in ("state", "solar_spectrum")}
    table = AtmosphericTable(
        wavelength, nodes, _fixed(base, order), quantities, source={"engine": engine, "nodes": len(rows)}
    )
    return replace(table, errors=leave_one_out(table))


def _at_node(base: AtmosphericState, changes: dict[str, float]) -> AtmosphericState:
    fields = base.model_dump(exclude_none=True)
    if "aot550" in changes:
        fields.pop("meteorological_range_km", None)
    try:
        return AtmosphericState(**{**fields, **changes})
    except ValueError as error:
        raise UsageError(f"no valid state at {changes}: {error}") from error


def _quantities(state: AtmosphericState, folder: Path) -> dict[str, Any]:
    terms = sixs_terms(state, folder, False)
    mu0 = np.cos(np.deg2rad(state.sun[0]))
    irradiance = solar.extraterrestrial_irradiance(state.solar_spectrum, terms.wavelength_nm, state.distance_au)
    unit = mu0 * irradiance / np.pi
    return {
        "wavelength_nm": terms.wavelength_nm,
        "path": terms.path_radiance / unit,
        "direct": terms.direct / unit,
        "adjacency": terms.adjacency / unit,
        "spherical_albedo": terms.spherical_albedo,
        "ground": terms.ground_irradiance / (np.pi * unit),
        "gas": terms.gas_transmittance,
        "diffuse": terms.diffuse_fraction,
        "provenance": terms.provenance,
    }


def _fixed(base: AtmosphericState, axes: list[str]) -> dict[str, Any]:
    fixed: dict[str, Any] = {n: base.model_dump(mode="json")[n] for n in ("model", "aerosol")}
    return fixed | {name: round(value, 9) for name, value in coordinates(base).items() if name not in axes}

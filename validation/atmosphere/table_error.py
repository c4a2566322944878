"""How far a table of the embedded engine is from the engine itself, between its nodes.

    python validation/atmosphere/table_error.py

One axis at a time, with the node counts that a study would take; the engine is run at states between the nodes.
"""

from __future__ import annotations

import numpy as np

from hyperval.atmosphere import AtmosphericState, aot550_from_range, atmospheric_terms, build_table

RHO = 0.3
LEAST_GAS = 0.1
BASE = {
    "model": "midlatitude-summer", "aerosol": "rural", "aot550": 0.15, "water_vapour_g_cm2": 1.5,
    "ground_altitude_km": 0.3, "sensor_altitude_km": 2.0, "solar_zenith_deg": 40.0, "solar_azimuth_deg": 150.0,
    "day_of_year": 180,
}  # fmt: skip
_RANGES_KM = (80.0, 50.0, 30.0, 20.0, 12.0, 8.0, 5.0)
AXES = {
    "aot550": (
        [aot550_from_range(v, 0.3) for v in _RANGES_KM],
        [aot550_from_range(v, 0.3) for v in (60.0, 23.0, 6.2)],
    ),
    "sensor_altitude_km": ([0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 10.0], [0.7, 2.4, 5.5]),
    "solar_zenith_deg": ([0.0, 15.0, 30.0, 45.0, 60.0, 70.0], [8.0, 38.0, 65.0]),
    "water_vapour_g_cm2": ([0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0], [0.33, 1.2, 3.5]),
}


def error(axis: str) -> tuple[float, float, dict[str, float] | None]:
    """Worst and rms relative error of the total radiance between the nodes, and the table's own statement."""
    nodes, between = AXES[axis]
    table = build_table(AtmosphericState(**BASE), {axis: nodes})
    found = []
    for value in between:
        state = AtmosphericState(**{**BASE, axis: value})
        exact = atmospheric_terms(state)
        guess = table.terms(AtmosphericState(**{**BASE, axis: value, "engine": "table", "table": "-"}))
        seen = exact.gas_transmittance > LEAST_GAS
        found.append((_total(guess) / _total(exact) - 1.0)[seen])
    every = np.concatenate(found)
    stated = table.errors[axis] if table.errors else None
    return float(np.max(np.abs(every))), float(np.sqrt(np.mean(every**2))), stated


def _total(terms) -> np.ndarray:
    ground = terms.direct + terms.adjacency
    return terms.path_radiance + ground * RHO / (1.0 - terms.spherical_albedo * RHO)


def main() -> None:
    """Print the table."""
    print("| axis | nodes | worst between | rms between | stated: worst, rms |")
    print("| --- | --- | --- | --- | --- |")
    for axis, (nodes, _) in AXES.items():
        worst, rms, stated = error(axis)
        said = f"{stated['worst']:.2%}, {stated['rms']:.2%}" if stated else "none"
        span = f"{len(nodes)}, {min(nodes):.3g} to {max(nodes):.3g}"
        print(f"| `{axis}` | {span} | {worst:.2%} | {rms:.2%} | {said} |", flush=True)


if __name__ == "__main__":
    main()

"""How far the embedded engine is from MODTRAN 6, by window and by transmittance, under the same sun.

    HYPERVAL_DATA=... python validation/atmosphere/compare_modtran.py [--write validation/atmosphere/README.md]

Prints the tables in Markdown, and with ``--write`` puts them between the marks of that file.  Criteria:

- total radiance over ground of 0.3 within 2 % in windows, and within 5 % where the two-way gas
  transmittance (MODTRAN's coefficient A over its continuum) is above 0.7;
- path radiance within 10 % below 1.1 um, in windows.

A criterion is judged by the median over all channels and states of a window or class; beside it stands
which part of the channels meets it one by one.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from modtran_cases import cases, data_file, markdown, matched, total_radiance

from hyperval.atmosphere import AtmosphericTerms, atmospheric_terms

RHO = 0.3
WINDOWS_NM = (
    (400, 500), (500, 600), (600, 685), (740, 755), (775, 805), (845, 885), (1000, 1070), (1220, 1250),
    (1550, 1700), (2100, 2300),
)  # fmt: skip
CLASSES = ((0.85, 1.01), (0.7, 0.85), (0.5, 0.7), (0.3, 0.5), (0.1, 0.3))
TOTAL_IN_WINDOWS, TOTAL_ABOVE_07, PATH_BELOW_1100 = 0.02, 0.05, 0.10


@dataclass(frozen=True)
class Differences:
    """hyperval over MODTRAN less one, at every channel of every state: (n,) each."""

    wavelength_nm: np.ndarray
    gas: np.ndarray
    total: np.ndarray
    path: np.ndarray
    albedo: np.ndarray
    states: int

    def window(self, low: float, high: float) -> np.ndarray:
        """Which channels lie in a window."""
        return (self.wavelength_nm >= low) & (self.wavelength_nm <= high)

    def transmitting(self, low: float, high: float) -> np.ndarray:
        """Which channels of 400-2450 nm have a two-way gas transmittance in a class."""
        return (self.gas >= low) & (self.gas < high) & self.window(400.0, 2450.0)


@dataclass(frozen=True)
class Verdict:
    """One criterion in one window or class."""

    name: str
    limit: float
    median: float
    share: float

    @property
    def met(self) -> bool:
        """True when the median keeps the limit."""
        return abs(self.median) <= self.limit


def differences(pairs: list[tuple[AtmosphericTerms, AtmosphericTerms]]) -> Differences:
    """From (hyperval, MODTRAN) at the same channels."""
    rows = []
    for ours, theirs in pairs:
        with np.errstate(divide="ignore", invalid="ignore"):
            rows.append(
                (
                    ours.wavelength_nm,
                    theirs.gas_transmittance,
                    total_radiance(ours, RHO) / total_radiance(theirs, RHO) - 1.0,
                    ours.path_radiance / theirs.path_radiance - 1.0,
                    ours.spherical_albedo / theirs.spherical_albedo - 1.0,
                )
            )
    return Differences(*(np.concatenate(x) for x in zip(*rows, strict=True)), states=len(pairs))


def verdicts(found: Differences) -> list[Verdict]:
    """Every criterion in every window and class that it speaks of."""
    classes = {"above 0.7": (0.7, 1.01)} | {f"{a:g}-{min(b, 1):g}": (a, b) for a, b in CLASSES if a >= 0.7}
    asked = [
        *((f"total radiance, {a}-{b} nm", found.total[found.window(a, b)], TOTAL_IN_WINDOWS) for a, b in WINDOWS_NM),
        *(
            (f"total radiance, transmittance {name}", found.total[found.transmitting(*ends)], TOTAL_ABOVE_07)
            for name, ends in classes.items()
        ),
        *(
            (f"path radiance, {a}-{b} nm", found.path[found.window(a, b)], PATH_BELOW_1100)
            for a, b in WINDOWS_NM
            if b < 1100
        ),
    ]
    return [Verdict(name, limit, float(np.median(x)), float(np.mean(np.abs(x) <= limit))) for name, x, limit in asked]


def tables(found: Differences) -> str:
    """The tables in Markdown."""

    def spread(x: np.ndarray) -> str:
        low, middle, high = 100 * np.quantile(x, [0.05, 0.5, 0.95])
        return f"{middle:+.2f} ({low:+.1f}, {high:+.1f})"

    radiances = [f"total radiance, rho = {RHO:g}", "path radiance"]
    windows = [
        [f"{a} - {b}", *(spread(x[found.window(a, b)]) for x in (found.total, found.path, found.albedo))]
        for a, b in WINDOWS_NM
    ]
    classes = [
        [f"{a:.2f} - {min(b, 1):.2f}", *(spread(x[found.transmitting(a, b)]) for x in (found.total, found.path))]
        for a, b in CLASSES
    ]
    judged = [
        [v.name, f"{v.limit:.0%}", f"{v.median:+.2%}", f"{v.share:.0%}", "met" if v.met else "MISSED"]
        for v in verdicts(found)
    ]
    head = (
        f"{found.states} states; hyperval over MODTRAN less one, percent: "
        "median (5 %, 95 % of all channels and states)."
    )
    return "\n\n".join([
        head,
        markdown(["window [nm]", *radiances, "spherical albedo"], windows),
        markdown(["two-way gas transmittance", *radiances], classes),
        markdown(["criterion", "limit", "median", "channels that keep it", ""], judged),
    ])  # fmt: skip


def main() -> None:
    """Print the tables, or put them into a document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, help="document with the marks between which the tables stand")
    document = parser.parse_args().write
    print(text := tables(differences([matched(case, atmospheric_terms(case.state)) for case in cases(data_file)])))
    if document:
        begin, end = (f"<!-- compare_modtran.py: {edge} -->" for edge in ("begin", "end"))
        before, _, after = document.read_text("utf-8").partition(begin)
        if end not in after:
            sys.exit(f"{document} lacks the marks {begin} and {end}")
        document.write_text(f"{before}{begin}\n{text}\n{end}{after.partition(end)[2]}", "utf-8")


if __name__ == "__main__":
    main()

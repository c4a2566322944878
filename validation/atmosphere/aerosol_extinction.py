"""Extinction of the solver's aerosol components over wavelength, as the package ships it.

    python validation/atmosphere/aerosol_extinction.py [--write]

The solver prints the optical depth of an aerosol beside everything else it solves, which takes a quarter of a second a
wavelength; extinction adds up by the volume of the components, so that pure components and one mixture of each with
dust give it for every mixture.  The last wavelength at which it solves, 3750 nm, follows from its straight line in
the logarithms between there and 2250 nm.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hyperval.atmosphere import sixs
from hyperval.datasets import cache_root

FILE = Path(__file__).parents[2] / "src/hyperval/atmosphere/aerosol_extinction.csv"
HEAD = """\
# Extinction of 6S's four basic aerosol components by volume (over that of dust at 550 nm), and of its desert
# aerosol over that at 550 nm, where it solves.  Made by validation/atmosphere/aerosol_extinction.py.
# wavelength nm, dust, water-soluble, oceanic, soot, desert
"""
LAST_NM = 3750.0
PURE = ("4\n1 0 0 0", "4\n0 1 0 0", "4\n0 0 1 0", "4\n0 0 0 1", "5")
WITH_DUST = (("4\n.5 .5 0 0", 0.5), ("4\n.5 0 .5 0", 0.5), ("4\n.97 0 0 .03", 0.03))  # and the share that is not dust


def shape(card: str) -> np.ndarray:
    """(nodes,) extinction over that at 550 nm, the last one at 3750 nm."""
    depths = []
    for nm in sixs.NODES_NM:
        run = sixs.deck(sixs.Setting(0.0, 0.0, 0.0, 0.0, None), "0\n", f"-1\n{nm / 1e3:.4f}", (card, 1.0, 1.0))
        depths.append(sixs.parse_monochromatic(sixs.run_sixs(run, cache_root()))["depth_aerosol"])
    found, nm = np.array(depths), sixs.NODES_NM
    power = np.log(found[-1] / found[-2]) / np.log(nm[-1] / nm[-2])
    found[-1] = found[-2] * (LAST_NM / nm[-2]) ** power
    return found / found[int(np.flatnonzero(nm == 550.0)[0])]


def extinctions() -> np.ndarray:
    """(nodes, 6) wavelength, the four components by volume over dust at 550 nm, desert."""
    dust, *others, desert = (shape(card) for card in PURE)
    columns = [dust]
    for pure, (card, share) in zip(others, WITH_DUST, strict=True):
        # mix (1 - w + w a) = (1 - w) dust + w a pure, with a the extinction at 550 nm over that of dust
        mix = shape(card)
        rest, slope = (1.0 - share) * (dust - mix), share * (mix - pure)
        columns.append(pure * float(rest @ slope / (slope @ slope)))
    return np.stack([np.append(sixs.NODES_NM[:-1], LAST_NM), *columns, desert], axis=1)


def main() -> None:
    """Print the table, or write it into the package."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    lines = [",".join([f"{row[0]:g}", *(f"{v:.5f}" for v in row[1:])]) for row in extinctions()]
    text = HEAD + "\n".join(lines) + "\n"
    if parser.parse_args().write:
        FILE.write_text(text)
    else:
        print(text, end="")


if __name__ == "__main__":
    main()

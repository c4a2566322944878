"""The spectrum of TSIS-1 as numbers that the package ships, and how well bands see it through them.

    HYPERVAL_DATA=... python validation/atmosphere/solar_table.py [--write] [--document validation/atmosphere/README.md]

``--write`` puts the numbers into ``src/hyperval/atmosphere/solar_tsis_1.csv``.  They are the corners of straight
lines whose mean under the triangle around each corner is that of the source (the nearest such lines in the sense of
least squares), so that energy is kept and Fraunhofer lines are as deep as the step allows.
The table shows what other steps, and plain averages over the step, would do to bands.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from modtran_cases import put_between_marks
from scipy.sparse import csr_matrix, diags_array
from scipy.sparse.linalg import spsolve

from hyperval.atmosphere import solar
from hyperval.datasets import resolve

Array = npt.NDArray[np.float64]

SOURCE = "data:sensors/tsis_f0_0p5.txt"  # mW m-2 nm-1, every half nanometre
STEP_NM = 1.0
WIDTHS_NM = (3.0, 5.0, 10.0)
REGIONS_NM = ((365, 400), (400, 500), (500, 700), (700, 1000), (1000, 1750), (1750, 2480))
HEAD = """\
# Solar irradiance at 1 au by TSIS-1, made by validation/atmosphere/solar_table.py: corners of straight lines.
# O. M. Coddington et al., The TSIS-1 Hybrid Solar Reference Spectrum, Geophys. Res. Lett. 48 (2021) e2020GL091709,
# doi:10.1029/2020GL091709 (0.3 % at 460-2365 nm, 1.3 % beside), as isofit has it (Apache-2.0).
# wavelength [nm], irradiance [mW m-2 nm-1]
"""


def projection(nm: Array, irradiance: Array, corners_nm: Array) -> Array:
    """(m,) irradiance at the corners of the straight lines nearest to those between the (n,) samples.

    Every corner is one of the samples' wavelengths.
    """
    step = np.diff(nm)
    ends = np.concatenate([[0.0], step]) + np.concatenate([step, [0.0]])
    mass = diags_array([step / 6.0, ends / 3.0, step / 6.0], offsets=[-1, 0, 1])  # mean products of straight lines
    corner = np.clip(np.searchsorted(corners_nm, nm, side="right") - 1, 0, corners_nm.size - 2)
    share = (nm - corners_nm[corner]) / np.diff(corners_nm)[corner]
    rows = np.arange(nm.size)
    lines = csr_matrix(
        (np.concatenate([1.0 - share, share]), (np.tile(rows, 2), np.concatenate([corner, corner + 1]))),
        shape=(nm.size, corners_nm.size),
    )
    return np.asarray(spsolve((lines.T @ mass @ lines).tocsc(), lines.T @ (mass @ irradiance)))


def averages(nm: Array, irradiance: Array, corners_nm: Array) -> Array:
    """(m,) plain averages over the step around each corner, to compare with."""
    between = np.concatenate([[0.0], np.cumsum(np.diff(nm) * (irradiance[1:] + irradiance[:-1]) / 2.0)])
    half = np.diff(corners_nm)[0] / 2.0
    edges = np.clip(np.stack([corners_nm - half, corners_nm + half]), nm[0], nm[-1])
    fine = np.linspace(nm[0], nm[-1], 10 * (nm.size - 1) + 1)
    total = np.interp(edges, fine, np.interp(fine, nm, between))
    return np.asarray((total[1] - total[0]) / (edges[1] - edges[0]))


RULES = (("lines", projection, 1.0), ("lines", projection, 2.0), ("averages", averages, 1.0))


def in_bands(at: Callable[[Array], Array], centre_nm: Array, fwhm_nm: float) -> Array:
    """(n,) averages over Gaussian bands, by plain sums every twentieth of a nanometre."""
    offset = np.arange(-1.3 * fwhm_nm, 1.3 * fwhm_nm + 1e-9, 0.05)
    weight = np.exp2(-((2.0 * offset / fwhm_nm) ** 2))
    return np.asarray(at(centre_nm[:, None] + offset) @ weight / weight.sum())


def table(nm: Array, irradiance: Array) -> str:
    """The study in Markdown: worst and rms error of bands by region [%], and the step from ASTM G173."""
    source = lambda x: np.interp(x, nm, irradiance)  # noqa: E731
    lines = [
        "| | bands | " + " | ".join(f"{a}-{b} nm" for a, b in REGIONS_NM) + " |",
        "| --- | --- |" + " --- |" * len(REGIONS_NM),
    ]
    centres = [np.arange(low, high, 1.3) for low, high in REGIONS_NM]
    for name, rule, step in RULES:
        corners = np.arange(nm[0], nm[-1] + 1e-6, step)
        values = rule(nm, irradiance, corners)
        at = lambda x, y=values, c=corners: np.interp(x, c, y)  # noqa: E731
        for width in WIDTHS_NM:
            error = [100.0 * (in_bands(at, c, width) / in_bands(source, c, width) - 1.0) for c in centres]
            cells = " | ".join(f"{np.abs(e).max():.2f}, {np.sqrt(np.mean(e**2)):.2f}" for e in error)
            lines.append(f"| {name}, {step:g} nm | {width:g} nm | {cells} |")
    wide_nm, wide = solar.source_samples("astm-g173")
    old = lambda x: np.interp(x, wide_nm, wide) * 10.0  # noqa: E731 - uW cm-2 nm-1 is 10 mW m-2 nm-1
    change = [100.0 * (np.mean(source(c)) / np.mean(old(c)) - 1.0) for c in centres]
    lines.append("| TSIS-1 over ASTM G173 - 1 | whole region | " + " | ".join(f"{c:+.1f}" for c in change) + " |")
    return "\n".join(lines)


def made() -> tuple[Array, Array]:
    """Wavelength [nm] and the numbers [mW m-2 nm-1], as they are shipped: to six digits."""
    nm, irradiance = np.loadtxt(resolve(SOURCE), unpack=True)
    corners = np.arange(nm[0], nm[-1] + 1e-6, STEP_NM)
    return corners, np.array([float(f"{v:.6g}") for v in projection(nm, irradiance, corners)])


def main() -> int:
    """Print the study; with ``--write`` and ``--document`` renew the numbers and the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--document", type=Path)
    options = parser.parse_args()
    nm, irradiance = np.loadtxt(resolve(SOURCE), unpack=True)
    if options.write:
        rows = "".join(f"{a:g},{b:.6g}\n" for a, b in zip(*made(), strict=True))
        Path(solar.__file__).with_name(solar.TSIS_1).write_text(HEAD + rows, "utf-8")
    text = table(nm, irradiance)
    print(text)
    if options.document:
        put_between_marks(options.document, "solar_table.py", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The spectrum of TSIS-1 as numbers that the package ships.

    HYPERVAL_DATA=... python validation/atmosphere/solar_table.py src/hyperval/atmosphere/solar_tsis_1.csv

They are the corners of straight lines whose mean under the triangle around each corner is that of the source (the
nearest such lines in the sense of least squares), so that energy is kept and Fraunhofer lines are as deep as the step
allows.  ``tests/atmosphere/test_atmosphere_solar.py`` makes them again and holds how well bands see the source
through them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix, diags_array
from scipy.sparse.linalg import spsolve

from hyperval.datasets import resolve

Array = npt.NDArray[np.float64]

SOURCE = "data:sensors/tsis_f0_0p5.txt"  # mW m-2 nm-1, every half nanometre
STEP_NM = 1.0
HEAD = """Solar irradiance at 1 au by TSIS-1, made by validation/atmosphere/solar_table.py: corners of straight lines.
O. M. Coddington et al., The TSIS-1 Hybrid Solar Reference Spectrum, Geophys. Res. Lett. 48 (2021) e2020GL091709,
doi:10.1029/2020GL091709 (0.3 % at 460-2365 nm, 1.3 % beside), as isofit has it (Apache-2.0).
wavelength [nm], irradiance [mW m-2 nm-1]"""


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


def in_bands(at: Callable[[Array], Array], centre_nm: Array, fwhm_nm: float) -> Array:
    """(n,) averages over Gaussian bands, by plain sums every twentieth of a nanometre."""
    offset = np.arange(-1.3 * fwhm_nm, 1.3 * fwhm_nm + 1e-9, 0.05)
    weight = np.exp2(-((2.0 * offset / fwhm_nm) ** 2))
    return np.asarray(at(centre_nm[:, None] + offset) @ weight / weight.sum())


def made() -> tuple[Array, Array]:
    """Wavelength [nm] and the numbers [mW m-2 nm-1], as they are shipped: to six digits."""
    nm, irradiance = np.loadtxt(resolve(SOURCE), unpack=True)
    corners = np.arange(nm[0], nm[-1] + 1e-6, STEP_NM)
    return corners, np.array([float(f"{v:.6g}") for v in projection(nm, irradiance, corners)])


if __name__ == "__main__":
    np.savetxt(sys.argv[1], np.stack(made(), axis=1), ("%g", "%.6g"), ",", header=HEAD)

"""How far the printed equations are from the corrected ones: the tables of README.md.

Run ``python validation/equations/formulation_differences.py`` to print them; a test compares.
"""

from __future__ import annotations

import numpy as np

from hyperval.atmosphere import AtmosphericTerms
from hyperval.model import mean_radiance, radiance_covariance, target_pixel_covariance
from hyperval.sensor import solid_angle
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

# 6S V2.1 for the built-in scenario yellow-planks-asphalt (range 23 km, sensor at 1 km, sun at 35 deg),
# 10 nm bands, four digits.
AXIS = SpectralAxis(np.array([450.0, 550, 670, 860, 1650, 2200]), np.full(6, 10.0))
TERMS = AtmosphericTerms(
    wavelength_nm=AXIS.centre_nm,
    path_radiance=np.array([0.7717, 0.4574, 0.2621, 0.1064, 0.006807, 0.001116]),
    direct=np.array([34.70, 35.42, 31.76, 21.88, 5.308, 1.770]),
    adjacency=np.array([4.695, 3.604, 2.435, 1.120, 0.08639, 0.01923]),
    spherical_albedo=np.array([0.2165, 0.1469, 0.1043, 0.06805, 0.02035, 0.01041]),
    ground_irradiance=np.ones(6),
    gas_transmittance=np.ones(6),
)
FRACTIONS = {"asphalt": 0.6, "grass": 0.3, "soil": 0.1}
KAPPA = 1e-3
FILL, FILL_SD = 0.1, 0.03


def radiometric_rows() -> list[str]:
    """Printed over corrected, per band."""
    classes = [builtin_class(n, AXIS) for n in FRACTIONS]
    f = np.array(list(FRACTIONS.values()))
    means, covariances = [c.mean for c in classes], [c.covariance for c in classes]
    average = f @ means
    spread = np.tensordot(f, covariances, 1) + (np.transpose(means - average) * f) @ (means - average)
    host, plank = classes[0], builtin_class("yellow-paint-plank", AXIS)

    def mean_ratio(rho: np.ndarray) -> np.ndarray:
        return mean_radiance(TERMS, rho, average, "thesis") / mean_radiance(TERMS, rho, average)

    def variance(rho: np.ndarray, covariance: np.ndarray, form: str) -> np.ndarray:
        found = radiance_covariance(TERMS, rho, covariance, average, spread, kappa=KAPPA, formulation=form)  # type: ignore[arg-type]
        return np.diag(found)

    def pixel(form: str) -> np.ndarray:
        return target_pixel_covariance(
            FILL, (form == "corrected") * FILL_SD**2, plank.mean, plank.covariance, host.mean, host.covariance
        )  # type: ignore[arg-type]

    mixed = FILL * plank.mean + (1 - FILL) * host.mean
    slopes = variance(host.mean, host.covariance, "thesis") / variance(host.mean, host.covariance, "corrected")
    fill = np.diag(pixel("thesis")) / np.diag(pixel("corrected"))
    both = variance(mixed, pixel("thesis"), "thesis") / variance(mixed, pixel("corrected"), "corrected")
    rows = []
    for i, w in enumerate(AXIS.centre_nm):
        rows.append(
            f"| {w:.0f} | {mean_ratio(host.mean)[i]:.4f} | {mean_ratio(plank.mean)[i]:.4f} | "
            f"{slopes[i]:.3f} | {fill[i]:.3f} | {both[i]:.3f} |"
        )
    return rows


def sensor_rows() -> list[str]:
    """Printed over corrected, for the sensor equations."""
    cone = solid_angle(1e-3, "cone") / solid_angle(1e-3)
    return [
        f"| solid angle of a square pixel (3.14) | {cone:.4f} |",
        f"| bit-error variance, 12 bits, rate per bit (3.19) | {1 / 12:.4f} |",
    ]


if __name__ == "__main__":
    print("\n".join([*radiometric_rows(), *sensor_rows()]))

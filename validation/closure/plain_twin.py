"""The twin that shares nothing with the model: radiance, counts, empirical line and filter in plain linear algebra.

    python validation/closure/plain_twin.py FOLDER

writes the spectra of the campaign ``share2012-independent`` from its ``terms.csv`` (see ``engine_terms.py``).  No
package of this project is imported.  What it takes from elsewhere are facts: the terms, the ASTM G173 spectrum of
the sun (through pvlib), and the sensor's data sheet, whose numbers stand below.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pvlib

Array = np.ndarray

FINE_NM = np.arange(400.0, 1690.0, 0.1)

ZENITH_DEG, DAY = 42.5, 264  # 20 September 2012 was day 264
SITES = {"black": 0.02, "dark": 0.05, "grey": 0.18, "light": 0.35, "bright": 0.60}
GROUND = 0.20  # all around: half 0.10, half 0.30
# Data sheet: F-number, slit [um], detector height [um], optical transmittance, quantum efficiency, integration [s],
# fixed noise [electrons], bits, full well [electrons].
VNIR = (2.4, 30.0, 24.0, 0.5, ((390, 450, 550, 650, 750, 850, 940), (0.25, 0.45, 0.55, 0.55, 0.45, 0.30, 0.15)),
        0.003, 60.0, 12, 250_000.0)  # fmt: skip
SWIR = (2.0, 30.0, 30.0, 0.45, ((939, 1100, 2300, 2475), (0.45, 0.65, 0.65, 0.45)), 0.005, 250.0, 12, 1_200_000.0)
CALIBRATION_PERCENT = 0.5
# Bands of the data sheet [nm] in windows, where neither water, oxygen nor carbon dioxide takes more than 2 %.
BANDS = (
    (430.15, 3.57), (443.59, 3.56), (457.12, 3.56), (470.65, 3.55), (484.17, 3.54), (497.68, 3.53), (511.3, 3.43),
    (524.76, 3.47), (538.28, 3.54), (552.05, 3.62), (566.04, 3.69), (608.1, 3.72), (617.58, 3.55),
    (640.56, 3.78), (663.82, 4.01), (673.12, 4.1), (677.78, 4.15), (781.9, 3.87), (858.88, 3.72), (863.69, 3.72),
    (868.48, 3.72), (873.28, 3.72), (1037.94, 7.61), (1044.41, 7.66), (1239.0, 7.43), (1617.93, 9.08),
    (1624.19, 9.17), (1630.46, 9.27),
)  # fmt: skip


def distance_au(day: int) -> float:
    """Of the Earth from the Sun (Astronomical Almanac, low precision: 1e-4), at 17 hours UTC of a day of 2012."""
    days = 4382.5 + day - 1 + 17.0 / 24.0  # since noon of 2000-01-01; that of 2012 began 4382.5 days later
    g = np.radians(357.529 + 0.98560028 * days)
    return float(1.00014 - 0.01671 * np.cos(g) - 0.00014 * np.cos(2.0 * g))


def band_means(at_nm: Array, values: Array, shift: float = 0.0) -> Array:
    """Gaussian bands, cut at three standard deviations, of values (n,); shifted by parts of a width."""
    out = []
    for centre, width in BANDS:
        sigma = width / 2.3548200450309493
        x = (at_nm - centre - shift * width) / sigma
        response = np.where(np.abs(x) <= 3.0, np.exp(-0.5 * x**2), 0.0)
        out.append(np.sum(response * values) / np.sum(response))
    return np.array(out)


@dataclass
class World:
    """What an error can be injected in."""

    electrons: float = 1.0
    path: float = 1.0
    spherical_albedo: float = 1.0
    shift: float = 0.0
    distance: bool = True


def read_terms(path: Path) -> dict[str, Array]:
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def sun_at(wavelength_nm: Array) -> Array:
    """Irradiance at one astronomical unit [uW cm-2 nm-1]; ASTM G173 has W m-2 nm-1."""
    sun = pvlib.spectrum.get_reference_spectra()["extraterrestrial"]
    return 100.0 * np.interp(wavelength_nm, sun.index.to_numpy(), sun.to_numpy())


def light_on(wavelength_nm: Array, world: World | None = None) -> Array:
    """mu0 E0 / pi of the day [uW cm-2 sr-1 nm-1]."""
    au = distance_au(DAY) if world is None or world.distance else 1.0
    return sun_at(wavelength_nm) * np.cos(np.radians(ZENITH_DEG)) / np.pi / au**2


def radiance(terms: dict[str, Array], reflectance: float, world: World | None = None) -> Array:
    """(B,) radiance over a ground patch among surroundings of 0.2 [uW cm-2 sr-1 nm-1]."""
    world = world or World()
    light = light_on(FINE_NM, world)
    t = {name: np.interp(FINE_NM, terms["wavelength_nm"], values) for name, values in terms.items()}
    s = world.spherical_albedo * t["spherical_albedo"]
    signal = world.path * t["path"] + (t["direct"] * reflectance + t["adjacency"] * GROUND) / (1.0 - s * GROUND)
    return band_means(FINE_NM, light * signal, world.shift)


def electrons_per_radiance(world: World | None = None) -> Array:
    """(B,) from photons through the slit: L [uW cm-2 sr-1 nm-1] to electrons."""
    world = world or World()
    out = []
    for centre, width in BANDS:
        f_number, slit, height, optics, (at, efficiency), seconds, *_ = VNIR if centre < 939.0 else SWIR
        etendue = slit * 1e-4 * height * 1e-4 * np.pi / (4.0 * f_number**2 + 1.0)  # [cm2 sr]
        watts = 1e-6 * etendue * width  # of a radiance of 1
        photon = 6.62607015e-34 * 2.99792458e8 / (centre * 1e-9)
        out.append(watts / photon * seconds * optics * np.interp(centre, at, efficiency))
    return world.electrons * np.array(out)


def noise_sd(level: Array, world: World | None = None) -> Array:
    """(B,) standard deviation of one pixel at a radiance (B,): shot, fixed, steps and calibration."""
    per = electrons_per_radiance(world)
    swir = np.array([centre >= 939.0 for centre, _ in BANDS])
    fixed, well = (np.where(swir, SWIR[i], VNIR[i]) for i in (6, 8))
    step = well / 2.0**12 / per
    return np.sqrt((per * level + fixed**2) / per**2 + step**2 / 12.0 + (CALIBRATION_PERCENT / 100.0 * level) ** 2)


def line_of(dark: Array, bright: Array, reflectances: tuple[float, float]) -> tuple[Array, Array]:
    """Gain and offset of the empirical line through two panels."""
    gain = (bright - dark) / (reflectances[1] - reflectances[0])
    return gain, dark - reflectances[0] * gain


def filter_of(pixels: Array, target: Array) -> tuple[Array, float]:
    """Weights and offset of the matched filter that gives the target 1 and the mean of the pixels 0."""
    mean = pixels.mean(axis=0)
    solved = np.linalg.solve(np.cov(pixels.T), target - mean)
    weights = solved / (solved @ (target - mean))
    return weights, float(weights @ mean)


def main() -> None:
    folder = Path(sys.argv[1])
    terms = read_terms(folder / "terms.csv")
    table = "\n".join(f"{i} {c:.2f} {w:.2f}" for i, (c, w) in enumerate(BANDS, 1))
    (folder / "bands.txt").write_text(table + "\n")
    for name, reflectance in SITES.items():
        values = radiance(terms, reflectance)
        text = "\n".join(f"{c:.2f} {v:.6f}" for (c, _), v in zip(BANDS, values, strict=True))
        (folder / f"{name}.txt").write_text(text + "\n")


if __name__ == "__main__":
    main()

"""MODTRAN output made by the closed form: what runs over ground of known albedos would print."""

import numpy as np

from hyperval.atmosphere import RADIANCE_COLUMNS

RADIANCE_WIDTHS = (8, *([11] * 9), 9, 9, 8, 7, 11, 11)
CHANNEL_WIDTHS = (12, 3, 3, 13, 13, 8, 13, 9, 9, 9, 9, *([13] * 10), *([10] * 5), 11)

CARDS = (
    "T F 2    2    2   -1    0    0    0    0    0    0    0    0    1   0.000 {albedo:6.4f}",
    "    1    0    0    0    0    0  23.00000   0.00000   0.00000   0.00000   0.00000",
)
# Channels: wavelength [nm], path radiance, mu0 E0 / pi, A and B over it, S.
ROWS = [
    (450.0, 2.0, 40.0, 0.75, 0.09, 0.18),
    (550.0, 1.0, 38.0, 0.82, 0.06, 0.11),
    (865.0, 0.2, 22.0, 0.9, 0.03, 0.04),
]


def spectrum(n: int = 60) -> dict[str, np.ndarray]:
    """Wavenumber [cm-1] and the terms per wavenumber [W cm-2 sr-1 / cm-1] of a smooth atmosphere."""
    nu = np.linspace(4000.0, 25000.0, n)
    um = 1e4 / nu
    sun = 8e-6 * np.exp(-(((um - 0.9) / 1.2) ** 2))
    return {
        "nu": nu,
        "sun": sun,
        "path": sun * 0.02 * um**-4,
        "direct": sun * 0.2 * np.exp(-0.05 * um**-2),
        "adjacency": sun * 0.02 * um**-1.5,
        "albedo": 0.09 * um**-2.2,
        "emission": 1e-9 * np.exp(-um),
    }


def tape7(albedos, *, emission: bool = False, albedo_stated: bool = True, terms=None) -> str:
    """A tape7 of one case for each albedo, by 3.7 over uniform ground."""
    t = terms or spectrum()
    lines = []
    heading = "".join(f"{name:>{w}}" for name, w in zip(RADIANCE_COLUMNS, RADIANCE_WIDTHS, strict=True))
    for rho in albedos:
        bounced = rho / (1.0 - t["albedo"] * rho)
        ground, scattered = t["direct"] * bounced, t["path"] + t["adjacency"] * bounced
        surface = (1.0 - rho) * t["emission"] * emission
        card, second = CARDS
        lines += [card.format(albedo=rho) if albedo_stated else card.split(" 0.000 ")[0], second, heading]
        for i, nu in enumerate(t["nu"]):
            values = [
                f"{nu:8.2f}", f"{0.9:11.8f}", f"{0.0:11.4E}", f"{'':11}", f"{surface[i]:11.4E}",
                f"{scattered[i]:11.4E}", f"{0.7 * scattered[i]:11.4E}", f"{ground[i]:11.4E}",
                f"{0.8 * t['direct'][i] * rho:11.4E}", f"{ground[i] + scattered[i] + surface[i]:11.4E}", f"{'':9}",
                f"{'':9}", f"{0.105:8.3f}", f"{1.0 - rho:7.4f}", f"{t['sun'][i]:11.4E}", f"{300.0:11.3f}",
            ]  # fmt: skip
            lines.append("".join(values))
        lines.append(" -9999.")
    return "\n".join(lines) + "\n"


def channels(rows=ROWS, rho: float = 0.0) -> str:
    """A channel table of this form: L = L_a + F (A + B) rho / (1 - S rho)."""
    lines = ["", "HEAD", "  ".join("-" * w for w in CHANNEL_WIDTHS)]
    for number, (nm, path, f, a, b, s) in enumerate(rows, 1):
        width = 10.0
        ground, scattered = f * a * rho / (1 - s * rho), path + f * b * rho / (1 - s * rho)
        total = ground + scattered
        values = [nm, 1, number, 0.0, total * 1e-6, 300.0, total * width * 1e-6, 1.0, width, nm - 9, nm + 9]
        values += [0.0, 0.0, 0.0, 0.4 * scattered * width * 1e-6, 0.6 * scattered * width * 1e-6]
        values += [ground * width * 1e-6, 0.0, f * width * 1e-6, 0.0, 0.0, a, b, s, 0.9, 1.0]
        cells = [f"{v:>{w}.6E}" if w == 13 else f"{v:>{w}.7g}" for v, w in zip(values, CHANNEL_WIDTHS, strict=False)]
        lines.append("  ".join(cells) + "  CENTER")
    return "\n".join(lines) + "\n\n"

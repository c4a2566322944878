"""A twin that shares nothing with the model: radiance by another engine; sensor, filter and line by plain code.

Errors injected into what the first twin shares with the model are seen where they exceed what the two sides differ by.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plain_twin as plain
import pytest
from solver_nodes import run_solver_at

from hyperval.atmosphere import AtmosphericState, atmospheric_terms, distance_on_day, extraterrestrial_irradiance
from hyperval.model import Origins, predict
from hyperval.scenario import Scenario, load_scenario
from hyperval.sensor import load_sensor
from hyperval.spectra import SpectralAxis, band_average

FOLDER = Path(__file__).parents[2] / "campaigns" / "share2012-independent"
AXIS = SpectralAxis(*np.array(plain.BANDS).T)
TERMS = plain.read_terms(FOLDER / "terms.csv")


def test_the_campaign_has_the_spectra_of_the_plain_code():
    for name, reflectance in plain.SITES.items():
        written = np.loadtxt(FOLDER / f"{name}.txt")
        assert written[:, 0] == pytest.approx(AXIS.centre_nm, abs=0.006)
        assert written[:, 1] == pytest.approx(plain.radiance(TERMS, reflectance), abs=6e-7)
    assert np.loadtxt(FOLDER / "bands.txt")[:, 1:] == pytest.approx(np.array(plain.BANDS), abs=0.006)


def noise_difference(world: plain.World) -> float:
    """Greatest relative difference of the noise of one pixel between model and plain code."""
    model, level = load_sensor("prospectir-vs").noise(AXIS, None), plain.radiance(TERMS, 0.35)
    return float(np.abs(np.sqrt(model.variance(level)) / plain.noise_sd(level, world) - 1.0).max())


def distance_difference(world: plain.World) -> float:
    """Of the irradiance at the Earth's distance."""
    au = plain.distance_au(plain.DAY) if world.distance else 1.0
    return abs((au / distance_on_day(plain.DAY)) ** 2 - 1.0)


def response_difference(world: plain.World) -> float:
    """Root mean square over the bands, of the sun's spectrum as they see it."""
    model = band_average(plain.FINE_NM, extraterrestrial_irradiance("astm-g173", plain.FINE_NM), AXIS)
    return float(
        np.sqrt(np.mean((plain.band_means(plain.FINE_NM, plain.sun_at(plain.FINE_NM), world.shift) / model - 1) ** 2))
    )


@pytest.mark.parametrize(
    ("difference", "within", "injected"),
    [
        (noise_difference, 1e-9, plain.World(electrons=1.05)),
        (distance_difference, 3e-4, plain.World(distance=False)),
        (response_difference, 1e-3, plain.World(shift=0.1)),
    ],
)
def test_sensor_sun_and_bands_meet_and_a_injected_error_shows(difference, within, injected):
    assert difference(plain.World()) < within < 2.0 * within < difference(injected)


@pytest.fixture(scope="module")
def engine():
    """Terms of 6S at ten wavelengths of the bands, of one state."""
    made = {}
    with pytest.MonkeyPatch.context() as patch:
        run_solver_at(patch, 430.0, 470.0, 520.0, 570.0, 670.0, 870.0, 1040.0, 1240.0, 1624.0)

        def terms(state: AtmosphericState):
            if state not in made:
                made[state] = atmospheric_terms(state, show_progress=False)
            return made[state]

        yield terms


@pytest.mark.slow
def test_two_engines_meet_and_injected_errors_of_path_and_albedo_show(engine):
    # Stated for the engine: 5 % of the path radiance, 1 % of the ground light; its spherical albedo is 3 to 19 %
    # lower below 700 nm than that of SASKTRAN2, and what it does to the radiance is a part of that 1 %.
    scenario = load_scenario(FOLDER / "scenario.yaml")
    model = engine(scenario.atmosphere).at_bands(AXIS)
    fine, light = plain.FINE_NM, plain.light_on(plain.FINE_NM)
    other = {
        n: plain.band_means(fine, light * np.interp(fine, TERMS["wavelength_nm"], TERMS[n]))
        for n in ("path", "direct", "adjacency")
    }
    clear = (AXIS.centre_nm > 450.0) & (AXIS.centre_nm < 900.0)
    path, ground = model.path_radiance / other["path"], model.direct / other["direct"]
    assert np.all(np.abs(path[clear] - 1.0) < 0.05)
    assert np.all(np.abs(path[clear] / 1.1 - 1.0) > 0.05)
    assert np.abs(np.median(ground[clear]) - 1.0) < 0.01
    albedo = model.spherical_albedo / np.interp(AXIS.centre_nm, TERMS["wavelength_nm"], TERMS["spherical_albedo"])
    blue = AXIS.centre_nm < 700.0
    assert np.all(np.abs(albedo[blue] - 1.0) < 0.2)
    assert np.all(np.abs(albedo[blue] / 1.5 - 1.0) > 0.2)


@pytest.mark.slow
def test_line_filter_and_scores_of_drawn_pixels(engine, tmp_path):
    """Pixels through the other engine, the plain sensor, line and filter score as the model says."""
    ramp = np.interp(AXIS.centre_nm, [430.0, 1640.0], [0.08, 0.45])
    (tmp_path / "ramp.csv").write_text(
        "wavelength,reflectance\n" + "\n".join(f"{w},{v}" for w, v in zip(AXIS.centre_nm, ramp, strict=True))
    )
    data = load_scenario(FOLDER / "scenario.yaml").model_dump(exclude_unset=True, by_alias=True)
    spread = {"relative_sd": 0.04, "band_sd": 0.002, "correlation_nm": 150}
    for c in data["scene"]["classes"]:
        c["covariance"] = spread
    source = {"file": str(tmp_path / "ramp.csv"), "wavelength_unit": "nm", "reflectance_unit": "fraction"}
    target = {"name": "ramp", "spectrum": source, "host": "around dark", "fill": {"fixed": 0.12}}
    target["covariance"] = {"relative_sd": 0.0}
    data["scene"] |= {"sites": [], "targets": [target]}
    data["processing"] = {"elm": {"reflectances": [0.1, 0.6]}, "detectors": ["cem"], "bands": {"drop_bad": False}}
    data["uncertainty"] = {}
    model = predict(Scenario.model_validate(data), Origins(AXIS, engine=engine, resolve=Path))
    curve, score = model.roc["ramp", "cem", "pixel"], model.scores["ramp", "cem"]

    rng, n = np.random.default_rng(5), 40_000
    gap = AXIS.centre_nm[:, None] - AXIS.centre_nm[None, :]
    kernel = np.exp(-0.5 * (gap / 150.0) ** 2)
    drawn = {
        level: level + rng.standard_normal((n, len(AXIS))) @ np.linalg.cholesky(
            (0.04 * level) ** 2 * kernel + 4e-6 * np.eye(len(AXIS))
        ).T
        for level in (0.1, 0.3)
    }  # fmt: skip
    black, unit = plain.radiance(TERMS, 0.0), plain.radiance(TERMS, 1.0) - plain.radiance(TERMS, 0.0)

    def image(reflectance: np.ndarray) -> np.ndarray:
        level = black + unit * reflectance
        return level + plain.noise_sd(level) * rng.standard_normal(level.shape)

    panels = [image(np.full((4000, len(AXIS)), r)).mean(axis=0) for r in (0.1, 0.6)]
    gain, offset = plain.line_of(*panels, (0.1, 0.6))
    ground = (image(np.concatenate([drawn[0.1], drawn[0.3]])) - offset) / gain
    weights, constant = plain.filter_of(ground, ramp)
    host = 0.1 + rng.standard_normal((n, len(AXIS))) @ np.linalg.cholesky(16e-6 * kernel + 4e-6 * np.eye(len(AXIS))).T
    scores = ((image(0.12 * ramp + 0.88 * host) - offset) / gain) @ weights - constant
    # Means of 40,000 scores are known to 0.5 % of their spread, spreads to 0.4 %, P_D to 0.0025; the panels' means
    # and the filter of 80,000 pixels add as much.  The bounds are six of these.
    assert scores.mean() == pytest.approx(score.mean, abs=0.04 * score.sd)
    assert scores.std() == pytest.approx(score.sd, rel=0.03)
    background = np.sort(ground @ weights - constant)
    for level in (1e-1, 1e-2):
        point = int(np.argmin(np.abs(np.log(curve.pfa / level))))
        found = float(np.mean(scores > background[int((1.0 - curve.pfa[point]) * background.size)]))
        assert found == pytest.approx(curve.pd[point], abs=0.03)

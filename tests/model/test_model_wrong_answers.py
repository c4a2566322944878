"""Numbers that were wrong, by definitions and by truths that are moved one at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri
from stand_in_atmosphere import blue_and_haze, smooth_terms, sunlight

from hyperval.config import parse_yaml, validate
from hyperval.model import Origins, predict, predictions, read, value_at
from hyperval.products import PredictedProducts, background_of
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.linspace(450.0, 2250.0, 30), np.full(30, 20.0))
TEXT = """
schema: 1
name: small
atmosphere: {aot550: 0.2, sensor_altitude_km: 1, solar_zenith_deg: 30, solar_azimuth_deg: 0, day_of_year: 200}
sensor: prospectir-vs
scene:
  classes:
    - {name: asphalt, fraction: 0.6, spectrum: {builtin: asphalt}}
    - {name: grass, fraction: 0.4, spectrum: {builtin: grass}}
  panels: [{name: panel, spectrum: {builtin: grey-panel-30}}]
  targets:
    - name: plank
      spectrum: {builtin: yellow-paint-plank}
      host: asphalt
      subjects: [{name: full, fill: {fixed: 1.0}}, {name: tenth, fill: {fixed: 0.1}}]
processing: {detectors: [cem], bands: {drop_bad: false}, false_alarm_grid: {lowest: 1.0e-5, per_decade: 4}}
"""


def scenario(extra: str = "", **replaced: str) -> Scenario:
    """The scene, with words of its text replaced and more after it."""
    text = TEXT + extra
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    data, lines = parse_yaml(text)
    return validate(Scenario, data, lines, "text")


ORIGINS = Origins(
    axis=AXIS,
    engine=lambda state: smooth_terms(*blue_and_haze(state.aot550 or 0.2), sunlight(), 0.7 * sunlight() / np.pi),
)


def run(s: Scenario, **how) -> PredictedProducts:
    """The prediction on thirty bands under a stand-in for the engine."""
    return predict(s, ORIGINS, **how)


@pytest.mark.parametrize("form", ["corrected", "thesis"])
@pytest.mark.parametrize("elm", ["none", "{reflectances: [0.1, 0.6]}"])
def test_correlation_filter_is_that_of_the_correlation_matrix(elm, form):
    """w = R^-1 t / (t R^-1 t), R = Sigma + mu mu^T of what the line leaves (Harsanyi, 1993)."""
    s = scenario(**{"[cem]": f"[cem-correlation], elm: {elm}", "small": f"small\nformulation: {form}"})
    p = run(s)
    seen = p.radiance if elm == "none" else p.reflectance
    classes = [(c.fraction, seen[c.name]) for c in s.scene.classes]
    mean = sum(f * e.mean for f, e in classes)
    second = sum(f * (e.pixel_covariance + np.outer(e.mean, e.mean)) for f, e in classes)
    target = seen["full"].mean
    w = np.linalg.solve(second, target)
    w /= target @ w
    key = background_of("tenth"), "cem-correlation"
    assert p.scores[key].mean == pytest.approx(w @ mean, rel=1e-6)
    assert p.scores[key].sd == pytest.approx(np.sqrt(w @ second @ w - (w @ mean) ** 2), rel=1e-6)


@pytest.mark.parametrize("form", ["corrected", "thesis"])
def test_budget_of_a_field_spectrum_holds_what_the_surroundings_do(form):
    """Half the difference of two truths, for every subject; by D_A alone asphalt's radiance had 8 % less."""
    u = "uncertainty: {field_spectra: [{subject: asphalt, relative: 0.05}]}\n"
    s = scenario(u, small=f"small\nformulation: {form}")
    p, path = run(s), "surfaces.[asphalt].mean"
    up, down = (run(s, truth={path: f * value_at(read(s, ORIGINS), path)[0]}) for f in (1.05, 0.95))
    for product in ("radiance", "snr", "reflectance"):
        for name, estimate in getattr(p, product).items():
            half = 0.5 * np.abs(getattr(up, product)[name].mean - getattr(down, product)[name].mean)
            found = estimate.budget.get("field spectrum", np.zeros(len(AXIS)))
            floor = 1e-6 * np.abs(estimate.mean).max()
            np.testing.assert_allclose(found, half, rtol=2e-3, atol=floor, err_msg=name)


ROUGH = SpectralAxis(np.linspace(450.0, 1240.0, 80), np.full(80, 10.0))
GRASS, NOISE = "surfaces.[grass].mean", "sensor.noise"


@pytest.mark.parametrize(
    ("entry", "path", "step", "axis", "lost"),
    [
        ("field_spectra: [{subject: grass, relative: 0.05, correlation: random}]", GRASS, 0.05, AXIS, {}),
        ("noise: {relative: 0.3, correlation: random}", NOISE, 0.3, AXIS, {}),
        (
            "field_spectra: [{subject: grass, relative: 0.001, correlation_nm: 10}]", GRASS, 0.001, ROUGH,
            {8: 0.99, 24: 0.7, 40: 0.3},
        ),
    ],
    ids=["random, of a class", "random, of noise", "10 nm, of a class"],
)  # fmt: skip
def test_interval_of_detection_follows_every_direction(entry, path, step, axis, lost):
    """Of independent bands, and of an error that is as rough as them: 8 directions of it hold 0.1 % of the variance.

    ``lost`` : greatest directions -> least part of the variance that they do not hold
    """
    s = scenario(f"uncertainty: {{{entry}}}\n", **{"[cem]": "[cem], elm: none"})
    origins = replace(ORIGINS, axis=axis)
    curve, stated = predict(s, origins).roc["tenth", "cem", "pixel"], value_at(read(s, origins), path)[0]
    inner, nominal = np.abs(ndtri(curve.pd)) < 2.0, np.broadcast_to(stated, len(axis))
    sd = step * nominal
    ends = np.concatenate([nominal + np.diag(sd), nominal - np.diag(sd)])
    moved = predictions(s, ({path: end} for end in ends), origins, object_curves=False)
    up, down = np.split(np.array([ndtri(p.roc["tenth", "cem", "pixel"].pd[inner]) for p in moved]), 2)
    gradient = 0.5 * (up - down) / sd[:, None]
    gap = (axis.centre_nm[:, None] - axis.centre_nm) / 10.0  # AXIS has bands so far apart that they are independent
    covariance = np.exp(-0.5 * gap**2) * np.outer(sd, sd)
    variance = np.einsum("bk,bc,ck->k", gradient, covariance, gradient)
    values, vectors = np.linalg.eigh(covariance)
    along = values[::-1, None] * (vectors[:, ::-1].T @ gradient) ** 2
    for count, part in lost.items():
        assert np.all(along[count:].sum(axis=0) > part * variance)
    width = (ndtri(curve.pd_upper) - ndtri(curve.pd_lower))[inner] / (2.0 * 1.959964)
    assert inner.sum() > 4
    # 2,048 draws of the curves, whose even part belongs to the interval too.
    np.testing.assert_allclose(width, np.sqrt(variance), rtol=0.04)


@pytest.mark.parametrize(
    ("relative", "says"), [(0.01, None), (0.06, "shift the mean of P_D"), (0.3, "from 400 draws of the budget")]
)
def test_a_prediction_says_where_errors_shift_detection_by_much_of_their_spread(relative, says):
    s = scenario(f"uncertainty: {{field_spectra: [{{subject: grass, relative: {relative}, correlation: random}}]}}\n")
    notes = [note for note in run(s).notes if "shift the mean" in note]
    assert [says in note for note in notes] == ([] if says is None else [True])


def test_an_interval_whose_directions_do_not_add_up_is_that_of_draws():
    """Even parts of 80 directions, each moved alone, add up to several times what all do at once."""
    entry = "field_spectra: [{{subject: grass, relative: 0.05, correlation_nm: 10}}], method: {}"
    origins = replace(ORIGINS, axis=ROUGH)
    by = {
        method: predict(scenario(f"uncertainty: {{{entry.format(method)}}}\n"), origins).roc["tenth", "cem", "pixel"]
        for method in ("linear", "monte-carlo")
    }
    for end in ("pd_lower", "pd_upper"):
        np.testing.assert_array_equal(getattr(by["linear"], end), getattr(by["monte-carlo"], end))


def test_an_error_of_the_target_moves_ace_as_far_as_errors_of_its_bands_do():
    """ACE follows the direction that its filter looks along; the bands moved one at a time are the other route."""
    axis = SpectralAxis(np.linspace(450.0, 2250.0, 12), np.full(12, 20.0))
    s = scenario(
        "uncertainty: {field_spectra: [{subject: plank, relative: 0.1, correlation: random}]}\n",
        **{"[cem]": "[ace], samples: 400, elm: none"},
    )
    origins, key = replace(ORIGINS, axis=axis), ("tenth", "ace", "pixel")
    curve = predict(s, origins, object_curves=False).roc[key]
    inner, path = np.abs(ndtri(curve.pd)) < 1.0, "surfaces.[plank].mean"
    stated = value_at(read(s, origins), path)[0]
    moved = [{path: stated + sign * np.diag(0.1 * stated)[k]} for sign in (1, -1) for k in range(len(axis))]
    z = np.array([ndtri(p.roc[key].pd[inner]) for p in predictions(s, moved, origins, object_curves=False)])
    up, down = np.split(z, 2)
    width = (ndtri(curve.pd_upper) - ndtri(curve.pd_lower))[inner] / (2.0 * 1.959964)
    # The interval holds what is even in the errors too; along the weights of another scale it would be 0.44 of this.
    np.testing.assert_allclose(width / np.sqrt(((0.5 * (up - down)) ** 2).sum(axis=0)), 1.1, atol=0.2)

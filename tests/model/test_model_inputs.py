"""Inputs of the budget and what is moved by its path: what each changes, where it stops, and what leads nowhere."""

from pathlib import Path

import numpy as np
import pytest
from uncertain_scene import ATMOSPHERE, AXIS, ORIGINS, run, scenario

from hyperval import model
from hyperval.attribute import every_input
from hyperval.errors import UsageError
from hyperval.scenario import Fill, Scenario, SpectralForm, Uncertainty
from hyperval.spectra import SpectralAxis

EVERYTHING = ATMOSPHERE + Path(__file__).with_name("uncertainty.yaml").read_text()


def inputs(s: Scenario) -> dict[str, model.UncertainInput]:
    found = model.uncertain_inputs(model.read_world(s, ORIGINS))
    assert len({i.name for i in found}) == len(found)
    return {i.name: i for i in found}


def test_every_input_of_the_scene_is_there_moves_something_and_can_be_drawn_with_the_others():
    s = scenario(EVERYTHING)
    found = inputs(s)
    assert {i.kind for i in found.values()} == {"atmosphere", "surface", "sensor", "scene", "engine"}
    base = run(s.model_copy(update={"uncertainty": Uncertainty()}))
    plain = s.model_copy(update={"uncertainty": Uncertainty()})
    blind = {"solar azimuth", "view zenith angle", "sensor altitude", "ground height"}  # to the stand-in engine
    for name, item in found.items():
        off = run(plain, truth=item.perturbation_along(0, 1.0))
        moved = [
            not np.allclose(off.radiance["tenth"].mean, base.radiance["tenth"].mean, rtol=1e-9),
            not np.allclose(off.snr["panel"].mean, base.snr["panel"].mean, rtol=1e-9),
            not np.allclose(off.roc["tenth", "cem", "pixel"].pd, base.roc["tenth", "cem", "pixel"].pd, rtol=1e-9),
        ]
        assert any(moved) != (name in blind), name
        assert item.correlation
    draws = [run(plain, truth=truth) for truth in model.draw_truths(list(found.values()), 3, 1)]
    assert len({float(d.radiance["grass"].mean[0]) for d in draws}) == 3


def test_directions_give_back_the_covariance_of_each_form():
    sd = np.linspace(0.01, 0.03, len(AXIS))
    cases = {
        "systematic": (SpectralForm(), np.outer(sd, sd)),
        "random": (SpectralForm(correlation="random"), np.diag(sd**2)),
        "length": (SpectralForm(correlation_nm=200), np.outer(sd, sd) * model.band_correlation(AXIS, 200.0)),
    }
    assert model.correlation_words(cases["length"][0]) == "correlation length 200 nm"
    for name, (form, expected) in cases.items():
        rows = model.error_rows(sd, form, AXIS)
        np.testing.assert_allclose(rows.T @ rows, expected, atol=1e-5 * expected.max(), err_msg=name)
        assert np.all(np.diff((rows**2).sum(axis=1)) <= 1e-15) or name == "random"
    assert model.covariance_directions(np.zeros((3, 3))).shape == (0, 3)
    # Less than a millionth of the variance is left out, and no more directions are followed than that needs.
    rows = model.covariance_directions(np.diag([1.0, 1e-3, 1e-5, 1e-7, 1e-9]))
    assert rows.shape == (5, 5)
    assert model.UncertainInput("x", "scene", "fill", np.zeros(5), rows).size == 3
    with pytest.raises(UsageError, match="needs a sensor with arms"):
        model.error_rows(sd, SpectralForm(correlation="arms"), AXIS)


B = len(AXIS)
KEY = ("tenth", "cem", "pixel")
PLANK = "surfaces.plank.mean"
WORLD = model.read_world(scenario(), ORIGINS)


def mean(surface: str) -> np.ndarray:
    """Its reflectance as stated."""
    return model.value_at(model.read_world(scenario(), ORIGINS), f"surfaces.{surface}.mean")[0]


def test_recorded_gain_and_offset_scale_radiance_and_noise_and_cancel_after_the_empirical_line():
    gain, offset = np.linspace(0.9, 1.1, B), 0.05
    base, off = run(scenario()), run(scenario(), truth={"sensor.gain": gain, "sensor.offset": offset})
    for name in ("grass", "panel", "tenth"):
        np.testing.assert_allclose(off.radiance[name].mean, gain * base.radiance[name].mean + offset, rtol=1e-12)
        np.testing.assert_allclose(
            off.radiance[name].pixel_covariance, np.outer(gain, gain) * base.radiance[name].pixel_covariance
        )
        np.testing.assert_allclose(off.reflectance[name].mean, base.reflectance[name].mean, rtol=1e-10)
    np.testing.assert_allclose(off.roc[KEY].pd, base.roc[KEY].pd, rtol=1e-9)
    # The signal-to-noise ratio of a recorded gain alone is that of the detector.
    gained = run(scenario(), truth={"sensor.gain": gain})
    np.testing.assert_allclose(gained.snr["panel"].mean, base.snr["panel"].mean, rtol=1e-12)
    np.testing.assert_allclose(gained.noise["panel"]["shot"], gain**2 * base.noise["panel"]["shot"], rtol=1e-12)


def test_spectrum_departs_while_the_filter_looks_for_what_was_stated():
    added, stated = np.linspace(-0.03, 0.03, B), mean("plank")
    base, off = run(scenario()), run(scenario(), truth={PLANK: stated + added})
    np.testing.assert_allclose(off.reflectance["tenth"].mean - base.reflectance["tenth"].mean, 0.1 * added, atol=1e-12)
    # Filter, background and threshold stay; the score moves by the filter on the change, to first order in it.
    assert off.roc[KEY].threshold == pytest.approx(base.roc[KEY].threshold, rel=1e-12)
    half = run(scenario(), truth={PLANK: stated + 0.5 * added})
    moved = off.scores["tenth", "cem"].mean - base.scores["tenth", "cem"].mean
    assert moved == pytest.approx(2 * (half.scores["tenth", "cem"].mean - base.scores["tenth", "cem"].mean), rel=1e-6)
    assert abs(moved) > 1e-4


def test_fill_from_geometry_moves_its_mean_by_area():
    fill = Fill.model_validate({"geometry": {"side_m": 0.3, "gsd_m": 1.0, "pixels": "best"}})
    before = model.fill_distribution(fill)
    after = model.fill_distribution(model.fill_with_mean(fill, 0.01))
    assert after.mean - before.mean == pytest.approx(0.01, rel=1e-3)


def test_changes_at_one_path_add_up_and_paths_to_one_number_compose():
    world = model.read_world(scenario(), ORIGINS)
    rows = np.array([np.linspace(0.01, 0.02, B)])
    grass = "surfaces.[grass].mean"
    one, other = (
        model.number_input(world, n, "surface", grass, 0.0, rows=k * rows) for n, k in (("a", 1.0), ("b", 2.0))
    )
    both = model.add_perturbations([(one, one.perturbation_along(0, 1.0)), (other, other.perturbation_along(0, -1.0))])
    np.testing.assert_allclose(both[grass], mean("grass") - rows[0])
    twice = run(scenario(), truth={"sensor.electrons": 1.5, "sensor_changes.signal_factor": 2.0})
    once = run(scenario(), truth={"sensor.electrons": 3.0})
    np.testing.assert_allclose(twice.noise["panel"]["shot"], once.noise["panel"]["shot"], rtol=1e-12)


def test_a_library_at_the_labelled_bands_moves_with_a_shift_and_is_not_smoothed():
    w = np.arange(400.0, 1000.0, 5.0)
    axis = SpectralAxis(w, np.full(w.size, 6.0))
    values = 0.3 + 0.2 * np.exp(-(((w - 700.0) / 15.0) ** 2))
    for shift in (0.2, -1.0):
        true = SpectralAxis(w + shift, axis.fwhm_nm)
        exact = 0.3 + 0.2 * np.exp(-(((w + shift - 700.0) / 15.0) ** 2))
        np.testing.assert_allclose(model.in_bands(w, values, true, axis), exact, atol=3e-4)
        # Averaged over the bands a second time the peak would lose more than the shift moves it.
        assert np.nanmax(np.abs(model.in_bands(w, values, true) - exact)) > 3e-3
    holes = np.where(np.abs(w - 500) < 8, np.nan, values)
    assert np.array_equal(np.isnan(model.in_bands(w, holes, true, axis)), np.isnan(holes))


def test_numbers_stop_at_the_ends_of_their_range_and_reflectance_at_nothing():
    def far_below(path: str):
        return model.number_input(WORLD, "x", "scene", path, 1.0).perturbation_along(0, -1e6)[path]

    assert far_below("atmosphere.aot550") == 0.0
    assert far_below("sensor.noise") == pytest.approx(1e-3)
    np.testing.assert_array_equal(far_below("surfaces.asphalt.mean"), np.zeros(B))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("surfaces.nobody.mean", "no such surface"),
        ("surfaces.plank.tail_dof", "no such class"),
        ("fraction.plank", "no such class"),
        ("fill.nobody", "fill.nobody"),
        ("blur", "geometry"),
        ("atmosphere.view", "no 'view'"),
        ("nothing.at.all", "no 'nothing'"),
    ],
)
def test_a_path_that_leads_nowhere_is_refused(path, words):
    with pytest.raises(UsageError, match=words):
        model.value_at(WORLD, path)


def test_what_is_stated_is_not_assumed_again_and_every_class_mean_is_a_candidate():
    text = ATMOSPHERE + "uncertainty: {noise: {relative: 0.1}, fractions: [{subject: grass, absolute: 0.1}]}\n"
    world = model.read_world(scenario(text), ORIGINS)
    assumed = {c.path for c in every_input([world], []) if not c.budgeted}
    assert not assumed & {i.path for i in model.uncertain_inputs(world)}
    assert {"sensor.gain", "surfaces.[grass].mean", "surfaces.[panel].mean"} <= assumed
    assert "surfaces.[plank].mean" not in assumed

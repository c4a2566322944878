"""Panels of an empirical line are no evidence for it, and a bad line is said to be one."""

from __future__ import annotations

import numpy as np
import pytest
from small_world import BANDS

from hyperval.compare import compare_spectra
from hyperval.observe import rounding_variance
from hyperval.results import ResultTable


def with_more(made, grey: float, light: float):
    """Two panels more, of 0.30 and 0.45 on the ground, under these reflectances as the field has them."""
    world = made.world
    values = world.values.copy()
    noise = 1.0 + 1e-3 * np.random.default_rng(4).standard_normal((2, 4, 4, values.shape[2]))
    values[6:10, 30:34] = (made.offset + made.gain * 0.30) * noise[0]
    values[6:10, 36:40] = (made.offset + made.gain * 0.45) * noise[1]
    world.write(values)
    rows = "".join(f"{w},{grey},{light}\n" for w in range(400, 1701))
    world.text("more.csv", "wavelength_nm,grey,light\n" + rows)
    world.collection["regions"] += [
        {"name": "grey", "rectangle": [6, 30, 4, 4]}, {"name": "light", "rectangle": [6, 36, 4, 4]},
    ]  # fmt: skip
    panels = world.collection["empirical_line"]["panels"]
    panels += [{"region": n, "spectrum": world.source("more.csv", n)} for n in ("grey", "light")]
    for panel in panels:
        panel["relative_uncertainty"] = 0.01
    return world


def rows(observation, subject):
    estimate = observation.reflectance[subject]
    return ResultTable(compare_spectra(
        estimate, estimate, product="reflectance", subject=subject, method="m", axis=observation.axis
    ))  # fmt: skip


def test_two_panels_leave_no_degree_of_freedom(make_radiance):
    seen = make_radiance(relative_noise=0.002).world.observe().observation
    for panel in ("white", "black"):
        (row,) = rows(seen, panel)
        assert np.isnan(row.value)
        assert "no degree of freedom" in row.reason
    assert len(rows(seen, "field" if "field" in seen.reflectance else next(iter(seen.reflectance)))) > 1


def test_a_panel_of_more_than_two_is_seen_by_the_line_through_the_others(make_radiance):
    world = with_more(make_radiance(relative_noise=0.002), 0.30, 0.50)  # the last is not what it is taken for
    seen = world.observe()
    light = seen.observation.reflectance["light"]
    assert light.circular == ""
    others = [p for p in world.collection["empirical_line"]["panels"] if p["region"] != "light"]
    world.collection["empirical_line"]["panels"] = others
    alone = world.observe().observation.reflectance["light"]
    assert light.mean == pytest.approx(alone.mean, rel=1e-9)  # 0.45, as it is no panel of that line
    assert light.mean == pytest.approx(0.45, abs=0.01)
    assert light.error_covariance == pytest.approx(alone.error_covariance, rel=1e-6)


def test_a_line_that_its_panels_contradict_is_as_wide_as_they_lie_apart(make_radiance):
    world = with_more(make_radiance(relative_noise=0.002), 0.30, 0.45)
    world.collection["regions"].append({"name": "bare", "rectangle": [20, 2, 8, 8]})
    found = [world.observe().observation]
    world.text("more.csv", "wavelength_nm,grey,light\n" + "".join(f"{w},0.30,0.62\n" for w in range(400, 1701)))
    found.append(world.observe().observation)
    agreeing, apart = (seen.reflectance["bare"].budget["empirical line"] for seen in found)
    (chi2,) = [float(n.split("chi-square ")[1].split()[0]) for n in found[1].notes if "variance is widened" in n]
    assert chi2 > 20
    # The line itself hardly turns, so that its width is what differs.
    assert apart == pytest.approx(agreeing * np.sqrt(chi2), rel=0.25)


def test_a_line_that_its_panels_contradict_is_warned_of(make_radiance):
    good = with_more(make_radiance(relative_noise=0.002), 0.30, 0.45).observe().observation.notes
    assert not [n for n in good if n.startswith("warning:")]


def test_panels_off_the_line_and_panels_far_off_the_others(make_radiance):
    notes = with_more(make_radiance(relative_noise=0.002), 0.30, 0.62).observe().observation.notes
    warned = [n for n in notes if n.startswith("warning:")]
    assert any("do not lie on one line" in n for n in warned)
    assert any(
        "the other panels of the empirical line give light a reflectance that is off by 0.17" in n for n in warned
    )


def test_a_line_without_most_of_the_bands_is_warned_of(make_radiance):
    world = make_radiance(relative_noise=0.002).world
    rows = "".join(f"{w},0.6,{0.05 if w < 700 else 0.55}\n" for w in range(400, 1701))
    world.text("panels.csv", "wavelength_nm,white,black\n" + rows)
    notes = world.observe().observation.notes
    assert any("warning: the empirical line can be used in 4 of 8 good bands only" in n for n in notes)


@pytest.mark.parametrize("spread", [0.0, 0.1, 0.2, 0.35])
def test_rounding_to_whole_steps_leaves_its_error_in_a_mean(spread):
    # Mean over the normal law by quadrature, mean square over 400 places within a step.
    x = (np.arange(400) + 0.5) / 400.0
    z = np.linspace(-6, 6, 4001)
    density = np.exp(-0.5 * z**2)
    density /= density.sum()
    error = np.rint(x[:, None] + spread * z) @ density - x
    assert rounding_variance(1.0, spread) == pytest.approx(np.mean(error**2), rel=0.02)
    assert rounding_variance(0.5, 0.5 * spread) == pytest.approx(0.25 * rounding_variance(1.0, spread))


def test_noise_of_a_step_smooths_the_rounding_away():
    assert rounding_variance(1.0, 1.0) < 1e-17
    assert rounding_variance(1.0, 0.0) == pytest.approx(1.0 / 12.0, rel=0.01)


def test_a_flat_panel_in_whole_numbers_has_the_error_of_its_rounding(make_radiance):
    world = make_radiance().world
    world.write(np.rint(world.values * 10.0), data_type=2)
    world.collection["cube"]["scale"] = 0.1
    found = world.observe()
    radiance, reflectance = found.observation.radiance["white"], found.observation.reflectance["corner"]
    assert radiance.standard_uncertainty == pytest.approx(0.1 / np.sqrt(12.0), rel=0.01)
    assert radiance.rounding == pytest.approx(np.full(BANDS, 0.01 / 12.0))
    assert reflectance.rounding == pytest.approx(0.01 / 12.0 / found.elm.gain**2)

"""Errors of the empirical line's panels, of areas by unmixing and of tails, each by hand or in plain loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_world import AXIS, BANDS, LINES, PLANTED, SAMPLES, background_spread

from hyperval.collection import EmpiricalLineSource
from hyperval.errors import UsageError
from hyperval.imagery import open_cube
from hyperval.model import Sources
from hyperval.observe import empirical_line
from hyperval.observe.detection import _ring
from hyperval.pixels import region_statistics
from hyperval.products import EstimatedPart


def line_of(made, source):
    """The line of a collection with panels that have no error of their own mean."""
    cube = open_cube(made.world.folder / "cube.img", quantity="radiance", unit="uW cm-2 sr-1 nm-1", check_values=False)
    masks = {name: np.zeros((LINES, SAMPLES), bool) for name in ("white", "black")}
    masks["white"][0:4, 30:34] = masks["black"][0:4, 36:40] = True
    measured = region_statistics(cube, masks)
    sampling = {name: EstimatedPart(np.zeros((BANDS, BANDS)), 15.0) for name in measured}
    return empirical_line(EmpiricalLineSource.model_validate(source), measured, sampling, cube, made.world.resolve)


def test_errors_of_a_panel_and_of_the_darkest_pixel_by_hand(make_radiance):
    made = make_radiance()
    white = [p for p in made.world.collection["empirical_line"]["panels"] if p["region"] == "white"]
    found = line_of(made, {
        "panels": [{**white[0], "relative_uncertainty": 0.02, "correlation_nm": 300}],
        "darkest_pixel": {"reflectance": 0.03, "uncertainty": 0.01, "radiance_noise": 0.02},
    })  # fmt: skip
    # The panel: 2 % of 0.6 with the stated correlation.  The dark surface: one unknown for all bands, and noise
    # that is each band's own.
    apart = np.abs(AXIS.centre_nm[:, None] - AXIS.centre_nm[None])
    first, second = found.panels
    assert np.diag(first.reflectance_error) == pytest.approx(np.full(BANDS, 0.012**2), rel=1e-9)
    assert np.all(np.diff(first.reflectance_error[0][np.argsort(apart[0])]) < 0)
    assert second.reflectance_error == pytest.approx(np.full((BANDS, BANDS), 0.01**2), rel=1e-12)
    assert second.radiance_error == pytest.approx(np.full(BANDS, 0.02**2), rel=1e-12)
    # Two points: var k = (sum of var L + k^2 var rho)/(rho_2 - rho_1)^2.
    k = found.gain
    expected = (0.02**2 + k**2 * (0.01**2 + 0.012**2)) / 0.57**2
    assert found.covariance[:, 0, 0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("length", [None, 1e6])
def test_a_spread_that_a_file_carries_counts_by_the_number_of_its_readings(make_radiance, monkeypatch, length):
    made = make_radiance()
    plain = Sources.spectrum

    def with_spread(self, source, name):
        samples, spread = (AXIS.centre_nm, np.full(BANDS, 0.03)), {"standard_deviation": np.full(BANDS, 0.03), "n": 9}
        return replace(plain(self, source, name), sampled_deviation=samples, mean_error=None, **spread)

    source = made.world.collection["empirical_line"]
    for panel in source["panels"]:
        panel["correlation_nm"] = length
    monkeypatch.setattr(Sources, "spectrum", with_spread)
    found = line_of(made, source)
    for panel in found.panels:
        assert np.diag(panel.reflectance_error) == pytest.approx(np.full(BANDS, 0.01**2), rel=1e-9)


def test_a_panel_with_a_full_pixel_is_refused(make_radiance):
    made = make_radiance()
    world = made.world
    for panel in world.collection["empirical_line"]["panels"]:
        panel["relative_uncertainty"] = 0.02
    world.collection["empirical_line"]["saturation"] = float(world.values[0:4, 30:34].max()) + 0.01
    assert world.observe().elm is not None
    values = world.values.copy()
    values[2, 31, 0] += 0.02
    world.write(values)
    with pytest.raises(UsageError, match=r"'white' is saturated in 1 of 16 pixels .first: band 1, 450 nm"):
        world.observe()


def test_a_stored_integer_at_the_end_of_its_type_is_full_save_in_bad_bands(make_radiance):
    made = make_radiance()
    world, scale = made.world, 2.5e-4
    for panel in world.collection["empirical_line"]["panels"]:
        panel["relative_uncertainty"] = 0.02
    world.collection["cube"]["scale"] = scale
    numbers = np.rint(world.values / scale)
    numbers[0, 30, 2] = numbers[1, 33, 6] = 65535
    world.write(numbers, data_type=12)
    with pytest.raises(UsageError, match=r"'white' is saturated in 2 of 16 pixels .first: band 3"):
        world.observe()
    bad = ~np.isin(np.arange(BANDS), [2, 6])
    world.write(numbers, data_type=12, axis=type(AXIS)(AXIS.centre_nm, AXIS.fwhm_nm, bad))
    assert world.observe().elm is not None


def test_the_report_says_how_far_each_panel_is_off_by_the_others(make_radiance):
    made = make_radiance()
    world = made.world
    values = world.values.copy()
    values[6:10, 30:34] = made.offset + made.gain * 0.30
    values[6:10, 36:40] = made.offset + made.gain * 0.45
    world.write(values)
    rows = "".join(f"{w},0.30,0.50\n" for w in range(400, 1701))  # the second is not what it is taken for
    world.text("more.csv", "wavelength_nm,grey,light\n" + rows)
    world.collection["regions"] += [
        {"name": "grey", "rectangle": [6, 30, 4, 4]}, {"name": "light", "rectangle": [6, 36, 4, 4]},
    ]  # fmt: skip
    panels = world.collection["empirical_line"]["panels"]
    panels += [{"region": n, "spectrum": world.source("more.csv", n)} for n in ("grey", "light")]
    for panel in panels:
        panel["relative_uncertainty"] = 0.02
    notes = world.observe().observation.notes
    (told,) = (n for n in notes if "leave-one-panel-out" in n)
    assert "light -0.05 (median over bands, at most -0.05)" in told
    assert any("reduced chi-square of its panels" in n for n in notes)


@pytest.fixture
def unmixing(world):
    world.collection["regions"] = [{"name": "ground", "rectangle": [0, 0, LINES, SAMPLES]}]
    world.detection["unmixing"] = {"targets": [{"target": "paint", "endmembers": "field"}], "background": "ground",
                                   "weights": ["equal"], "ring_pixels": 5}  # fmt: skip
    return world


def test_background_around_a_target_lies_within_its_ring_and_holds_no_target(unmixing):
    unmixing.detection["group"] = "{name}"
    found = unmixing.observe()
    near = np.zeros((LINES, SAMPLES), bool)
    for line, sample in PLANTED:
        for dl, ds in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            near[line + dl, sample + ds] = True
    lines, samples = np.indices(near.shape)
    for subject, (line, sample) in zip(found.unmixed.subjects, PLANTED, strict=True):
        assert found.observation.abundance[subject.subject, "fcls field"].n == 1
        expected = (np.hypot(lines - line, samples - sample) <= 5.0) & ~near
        assert subject.ring == expected.sum()


def test_a_ring_leaves_out_the_pixels_that_it_is_about():
    own = np.array([10, 10]), np.array([10, 11])
    lines, samples = _ring(own, np.ones((LINES, SAMPLES), bool), 2)
    # Two discs of 13 pixels share 8; less the two pixels themselves.
    assert lines.size == 2 * 13 - 8 - 2
    assert not {(10, 10), (10, 11)} & set(zip(lines.tolist(), samples.tolist(), strict=True))


def test_the_error_of_a_mean_area_is_that_of_its_objects_added_up(unmixing):
    together = unmixing.observe().observation.abundance
    unmixing.detection["group"] = "{name}"
    alone = unmixing.observe().observation.abundance
    for fill in (0.8, 0.3):
        own = [alone[f"t{i}", "fcls field"] for i, f in enumerate(PLANTED.values()) if f == fill]
        group = together[f"fill {fill:g}", "fcls field"]
        assert group.area_m2 == pytest.approx(np.mean([a.area_m2 for a in own]), rel=1e-12)
        expected = np.sqrt(sum(a.standard_uncertainty**2 for a in own)) / len(own)
        assert group.standard_uncertainty == pytest.approx(expected, rel=1e-12)


def test_distances_of_a_region_are_those_from_its_other_pixels(world):
    side = 15
    rng = np.random.default_rng(6)
    values = 0.3 + rng.multivariate_normal(np.zeros(BANDS), background_spread(), (side, side))
    values *= 1.0 + 0.02 * rng.standard_t(4, (side, side, 1))  # some far out
    world.write(values)
    world.detection, world.collection["targets"] = None, None
    world.collection["regions"] = [{"name": "all", "rectangle": [0, 0, side, side]}]
    found = world.observe().observation.distribution["all"]
    x = values.reshape(-1, BANDS)
    leading = np.linalg.eigh(np.cov(x.T))[1][:, ::-1][:, : found.leading_dimension]
    scores = (x - x.mean(axis=0)) @ leading
    distances = []
    for i in range(len(x)):
        others = np.delete(scores, i, axis=0)
        z = scores[i] - others.mean(axis=0)
        distances.append(z @ np.linalg.solve(np.atleast_2d(np.cov(others.T)), z))
    assert found.distance[-1] == pytest.approx(max(distances), rel=1e-6)
    assert found.exceedance[-1] == pytest.approx(1 / (len(x) + 1))

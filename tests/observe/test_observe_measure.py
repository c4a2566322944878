"""Means, covariances and tails of regions, their errors, clusters and classes; which pixels count for what."""

import re
from dataclasses import replace

import numpy as np
import pytest
from small_world import AXIS, BANDS, LINES, SAMPLES, background_spread, moments

from hyperval.campaign import completed_scenario, merged_predictions, without_circular_spectra
from hyperval.collection import Classification
from hyperval.errors import InputError, UsageError
from hyperval.model import Sources
from hyperval.observe import RegionLaws
from hyperval.pixels import factor_covariance, small_sample_factor, snr_decorrelated
from hyperval.products import PredictedProducts, SpectralEstimate
from hyperval.scenario import CovarianceSource, Scenario, SpectrumSource, Surface


def test_mean_and_covariance_of_a_region_equal_numpy(world):
    seen = world.observe()
    mean, covariance = moments(world.values[35:45, 5:25])
    corner, handed = seen.observation.reflectance["corner"], seen.statistics["corner"]
    assert (corner.mean, corner.n, set(corner.budget)) == (pytest.approx(mean, rel=1e-12), 200, {"sampling"})
    assert corner.pixel_covariance == pytest.approx(covariance, rel=1e-9, abs=1e-16)
    widened = small_sample_factor(200.0) / 200
    assert corner.error_covariance == pytest.approx(covariance * widened, rel=1e-9, abs=1e-18)
    # Pixels that are independent of each other: n - 1 degrees of freedom behind the error.
    (part,) = corner.estimated
    assert part.dof == pytest.approx(199, rel=0.02)
    # A test widens by these degrees of freedom, and gets the covariance without the widening.
    assert part.model == pytest.approx(covariance / 200, rel=1e-9, abs=1e-18)
    assert (seen.observation.radiance, handed.mean, handed.n) == ({}, pytest.approx(mean), 200)
    # Four pixels alike are fewer independent ones, behind the error as behind the samples' own covariance.
    world.write(world.values[::2, ::2].repeat(2, axis=0).repeat(2, axis=1))
    (part,) = world.observe().observation.reflectance["corner"].estimated
    assert 120 > part.dof == pytest.approx(part.sample_dof)


def test_the_mean_of_fewer_pixels_than_bands_has_an_error_in_every_direction(world):
    world.regions(few=[40, 5, 2, 3])
    few = world.observe().observation.reflectance["few"]
    sample = moments(world.values[40:42, 5:8])[1]
    expected, _, dof = factor_covariance(sample, 6)
    assert few.error_covariance == pytest.approx((2.5705818 / 1.9599640) ** 2 * expected / 6, rel=1e-6)  # Student's t
    assert np.linalg.matrix_rank(few.error_covariance) == BANDS
    (part,) = few.estimated
    assert (part.model, part.sample) == (pytest.approx(expected / 6), pytest.approx(sample / 6))
    assert (part.dof, part.sample_dof) == (pytest.approx(dof), 5)
    world.write(axis=replace(AXIS, good=np.arange(BANDS) < 5))  # of the good bands there are fewer than pixels
    (part,) = world.observe().observation.reflectance["few"].estimated
    assert part.model[:5, :5] == pytest.approx(sample[:5, :5] / 6)


def test_a_region_keeps_clear_of_targets_unless_nothing_is_left(world):
    world.regions(**{"around": [8, 8, 5, 5], "on it": [9, 9, 1, 3], "inside": [10, 9, 1, 3]})
    reflectance = world.observe().observation.reflectance
    # The corners of the ring are free; the last is target and ring throughout, and taken as drawn.
    assert [reflectance[name].n for name in ("around", "on it", "inside")] == [25 - 5, 2, 3]
    assert reflectance["inside"].mean[0] == pytest.approx(world.values[10, 9:12, 0].mean())


def test_a_table_of_bands_stands_for_a_header_without_wavelengths(world):
    world.detection = None
    header = world.folder / "cube.hdr"
    header.write_text(re.sub(r"(wavelength|fwhm|bbl)[a-z ]*= (\{[^}]*\}|.*)\n", "", header.read_text()))
    with pytest.raises(InputError, match=r"collection\.bands"):
        world.observe()
    rows = [f"{1e-3 * c:.4f} {1e-3 * w:.4f}" for c, w in zip(AXIS.centre_nm, AXIS.fwhm_nm, strict=True)]
    world.text("bands.txt", "\n".join(["\ufeffcentre\tFWHM at 50%", "(um)\t(um)", *rows]) + "\n")
    world.collection["bands"] = {"path": "bands.txt", "wavelength_unit": "um", "fwhm_column": 1}
    axis = world.observe().observation.axis
    assert (axis.centre_nm, axis.fwhm_nm) == (pytest.approx(AXIS.centre_nm), pytest.approx(AXIS.fwhm_nm))


def test_a_single_pixel_gives_a_mean_and_no_spread(make_radiance):
    world = make_radiance().world
    world.collection["regions"].append({"name": "dot", "rectangle": [4, 7, 1, 1]})
    world.collection["calibration"] = {"relative": 0.03}
    seen = world.observe()
    dot = seen.observation.radiance["dot"]
    assert dot.mean == pytest.approx(world.values[4, 7], rel=1e-12)
    assert (dot.n, set(dot.budget), dot.pixel_covariance) == (1, {"calibration"}, None)
    assert set(seen.observation.reflectance["dot"].budget) == {"empirical line"}
    assert any("region 'dot' is a single pixel" in note for note in seen.observation.notes)
    sources, source = Sources(AXIS, seen.statistics, world.resolve), SpectrumSource(measured="dot")
    with pytest.raises(UsageError, match="'dot' is a single pixel: the spread of 'court' is not known"):
        sources.surface(Surface(name="court", spectrum=source))
    found = sources.surface(Surface(name="court", spectrum=source, covariance=CovarianceSource(relative_sd=0.1)))
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(0.1 * found.mean)


def test_snr_of_a_region_is_that_of_its_pixels(panels):
    values = panels.values.copy()
    values[34:50] = 30.0 * (1.0 + 0.01 * np.random.default_rng(3).standard_normal((16, SAMPLES, BANDS)))
    values[34:36], good = 90.0, np.arange(BANDS) != 3
    values[..., ~good] = np.random.default_rng(4).uniform(1.0, 60.0, (LINES, SAMPLES, 1))  # what a bad band may hold
    panels.write(values, axis=replace(AXIS, good=good))
    panels.regions(*panels.collection["regions"], flat=[34, 0, 16, SAMPLES], roof=[34, 0, 2, SAMPLES])
    panels.collection |= {"snr_regions": ["flat"], "leave_out": ["roof"]}
    seen = panels.observe()
    (found,), error = seen.observation.snr.values(), np.diag(seen.sampling["flat"].covariance)  # of its mean
    flat = np.diag(seen.place.statistics["flat"].covariance)
    assert error[3] / flat[3] == pytest.approx(error[good].sum() / flat[good].sum(), rel=1e-9)
    assert ((found.budget["mean"] * 30.0 / found.mean) ** 2)[good] == pytest.approx(error[good], rel=1e-2)
    assert found.mean[good] == pytest.approx(snr_decorrelated(values[36:50][..., good].reshape(-1, BANDS - 1)).mean)


@pytest.mark.parametrize("dof", [6.0, np.inf])
def test_tails_of_a_region(make_field, dof):
    found = make_field(dof=dof).observe().observation.distribution["all"]
    # Seed fixed; the interval misses in one of twenty seeds.
    assert found.tail_lower <= dof <= found.tail_upper
    # In components chosen for the spread of these very pixels tails come out 3 % too heavy, give or take 3 %.
    assert 1 / found.leading_tail_dof == pytest.approx(1 / dof, abs=0.025)
    assert (found.normality_p_value < 1e-6) == np.isfinite(dof)
    assert (found.dimension, found.effective_n) == (BANDS, pytest.approx([3600.0] * found.effective_n.size, rel=0.05))
    assert np.diff(found.distance).min() >= 0 >= np.diff(found.exceedance).max()


@pytest.mark.parametrize("background", [["scene"], ["ground"]])
def test_regions_that_are_left_out_are_left_out_of_every_population(world, background):
    world.regions({"name": "ground", "whole_image": True}, **{"bright roof": [40, 30, 3, 3]})
    world.collection["leave_out"] = ["bright roof"]
    world.detection |= {"background": background, "false_alarms": background}
    world.values[40:43, 30:33] = 0.9
    world.write()
    seen, scene = world.observe(), world.place().pixels_of("scene")
    assert scene.sum() == seen.statistics["ground"].n == next(iter(seen.observation.exceedance.values())).n
    assert seen.statistics["ground"].mean.max() < 0.5
    assert seen.statistics["bright roof"].n == 9  # what is left out has statistics of its own
    assert not [n for n in seen.observation.notes if "false alarms are counted on" in n]


def test_the_notes_say_how_the_populations_differ(world):
    world.detection |= {"background": ["image"], "false_alarms": ["scene"]}
    seen = world.observe()
    near, total = int(seen.place.near_targets.sum()), LINES * SAMPLES
    (note,) = [n for n in seen.observation.notes if "false alarms are counted on" in n]
    assert note.startswith(f"the filters have their statistics from {total} pixels (image)")
    assert f"counted on {total - near} (scene)" in note
    within = f"{near} pixels of targets and their guard are in the filters'"
    assert any(n.startswith(within) for n in seen.observation.notes)


def test_another_detection_in_the_same_collection_measures_only_pixels_that_it_changes(make_radiance):
    world = make_radiance(relative_noise=0.01).world
    first = world.observe()
    world.detection |= {"background": ["corner"], "false_alarms": ["corner"], "group": "all"}
    again, short = world.observe(), world.observe(before=first)
    for name, part in first.sampling.items():  # the groups are another one, the regions are taken over
        assert ("fill" in name) != (short.sampling.get(name) is part)
    again, short = again.observation, short.observation
    assert short.distribution == again.distribution != {}
    for product in ("radiance", "reflectance"):
        assert list(getattr(short, product)) == list(getattr(again, product))
        for name, estimate in getattr(again, product).items():
            found = getattr(short, product)[name]
            assert np.array_equal(found.mean, estimate.mean, equal_nan=True)
            assert np.array_equal(found.error_covariance, estimate.error_covariance, equal_nan=True)
    assert (short.scores, short.notes) == (again.scores, again.notes)
    assert {k: c.pd.tolist() for k, c in short.roc.items()} == {k: c.pd.tolist() for k, c in again.roc.items()}


def scenario(classes: list[dict], **scene: object) -> Scenario:
    return Scenario.model_validate({"name": "s", "scene": {"classes": classes, **scene}, "schema": 1})


@pytest.fixture
def clusters(make_field):
    """60 x 60 pixels, a fifth of them in patches of 3 x 3 whose mean lies elsewhere.

    One has no data in a bad band, where opening does not look."""
    rng = np.random.default_rng(3)
    patch = np.kron(rng.random((20, 20)) < 0.2, np.ones((3, 3), bool))
    z = rng.multivariate_normal(np.zeros(BANDS), background_spread(), (60, 60))
    z[1, 7, 3] = np.nan
    world = make_field(0.3 + z + patch[..., None] * np.linspace(0.05, -0.08, BANDS))
    world.write(axis=replace(AXIS, good=np.arange(BANDS) != 3))
    return world


def mixed(*mixtures: int | str, region: str = "all") -> Scenario:
    return scenario([
        {"name": f"class {i}", "fraction": 1.0 / len(mixtures), "spectrum": {"measured": region}, "mixture": m}
        for i, m in enumerate(mixtures)
    ])  # fmt: skip


def test_what_a_scenario_asks_for_is_fitted_once_or_refused_by_name(clusters):
    clusters.regions(*clusters.collection["regions"], corner=[0, 0, 3, 3], shade=[0, 0, 20, 20], wall=[0, 0, 20, 20])
    clusters.collection["leave_out"] = ["wall"]  # corner and shade have no pixel that counts, and are taken as drawn
    laws = RegionLaws(clusters.observe())
    first = laws.statistics(mixed(2))["all"].components
    assert (len(first), laws.statistics(mixed(1))["all"].components) == (2, None)
    assert laws.statistics(mixed(2))["all"].components is first
    with pytest.raises(UsageError, match="different components of region 'all'"):
        laws.statistics(mixed(2, 3))
    with pytest.raises(UsageError, match=r"region 'corner'(?s:.*)8 components of 9 pixels"):
        laws.statistics(mixed(8, region="corner"))
    assert [len(without) for _, without in laws.jackknife_replicates(mixed(1, region="shade"))] == [16]


def test_statistics_without_each_part_of_a_region(clusters):
    """Sixteen parts of 225 pixels; what is left out and what is left make the whole; small regions have none."""
    seen = clusters.observe()
    laws, stated = RegionLaws(seen), seen.statistics["all"]
    ((name, without),) = laws.jackknife_replicates(mixed(2))
    assert (name, len(without)) == ("all", 16)
    assert without is next(iter(laws.jackknife_replicates(mixed(2))))[1]
    assert np.mean([s.mean for s in without], axis=0) == pytest.approx(stated.mean, rel=1e-9)
    assert max(np.abs(s.mean - stated.mean).max() for s in without) > 1e-4
    for s in without:
        assert len(s.components) == 2
        assert s.components.covariance == pytest.approx(s.covariance, abs=0.1 * np.abs(s.covariance).max())


@pytest.fixture
def two_classes(make_field):
    """Two classes, one standard deviation of one band apart."""
    values = 0.3 + 0.01 * np.random.default_rng(4).standard_normal((LINES, SAMPLES, BANDS))
    values[:, SAMPLES // 2 :, 2] += 0.02
    world = make_field(values)
    world.regions(dark=[0, 0, LINES, 20], bright=[0, 20, LINES, 20])

    def classified(**settings):
        task = {"classes": ["dark", "bright"], "features": [{"name": "all"}]} | settings
        return world.observe(classification=Classification.model_validate(task)).observation.classification

    return classified


def test_classification_error_of_known_classes(world, two_classes):
    found = two_classes(block_lines=2)["dark / bright", "all"]
    assert found.lower <= 0.158655 <= found.upper  # Phi(-1)
    assert 800 <= found.n <= 1200
    assert found.distance == pytest.approx(0.5, abs=0.15)
    blind = two_classes(features=[{"name": "one", "bands_nm": [870]}])["dark / bright", "one"]
    assert blind.error == pytest.approx(0.5, abs=0.06)
    assert two_classes(seed=1) != two_classes()
    before = two_classes()
    world.collection["regions"].append({"name": "path", "rectangle": [0, 9, LINES, 1]})
    world.collection |= {"leave_out": ["path"], "leave_out_guard_pixels": 10}  # no pixel of the dark class counts
    assert two_classes() == before
    for settings, message in (({"block_lines": 100}, "one block of 100 lines"),
                              ({"classes": ["dark", "wood"]}, "no region 'wood'")):  # fmt: skip
        with pytest.raises(UsageError, match=message):
            two_classes(**settings)


def test_a_covariance_of_other_pixels_is_evidence_and_of_its_own_is_not(world):
    world.regions(field=[35, 5, 10, 20], left=[35, 5, 10, 10], right=[35, 15, 10, 10])

    def surface(name: str, region: str) -> dict:
        return {"name": name, "spectrum": {"constant": 0.2}, "covariance": {"measured": region}}

    sites = [surface("right", "left"), surface("left", "left")]
    given = scenario([surface("field", "left") | {"fraction": 1.0}], sites=sites)
    spectra = {n: SpectralEstimate(np.ones(BANDS), np.eye(BANDS), np.eye(BANDS)) for n in ("field", "right", "left")}
    prediction = PredictedProducts(AXIS, reflectance=spectra)
    kept = without_circular_spectra(prediction, [given], world.place()).reflectance
    assert {name for name, s in kept.items() if s.pixel_covariance is not None} == {"right"}
    # Where the pixels are not known, every measured covariance counts as the subject's own.
    blind = without_circular_spectra(prediction, [given]).reflectance
    assert all(s.pixel_covariance is None for s in blind.values())
    # Scenarios together say what each says, noise and full scale too.
    each = [PredictedProducts(AXIS, noise={name: {}}, full_scale={name: np.ones(BANDS)}) for name in "ab"]
    assert [[*merged_predictions(each).noise], [*merged_predictions(each).full_scale]] == [["a", "b"]] * 2


def test_fractions_are_those_of_the_pixels_that_count(world):
    world.regions(field=[35, 5, 10, 20], corner=[5, 5, 10, 20])  # two targets with a guard of one pixel in the last
    place = world.place()
    classes = [
        {"name": "field", "fraction": 0.5, "spectrum": {"constant": 0.2}},
        {"name": "elsewhere", "fraction": 0.5, "spectrum": {"measured": "corner"}},
    ]
    stated = scenario(classes)
    assert completed_scenario(stated, place, None) is stated
    counted = completed_scenario(scenario(classes, fractions="measured"), place, None)
    pixels = np.array([200, 200 - 2 * 5])  # a guard of one pixel is a cross
    assert [c.fraction for c in counted.scene.classes] == pytest.approx(list(pixels / pixels.sum()), rel=1e-12)
    classes[0]["name"] = "nowhere"
    for where, message in ((place, "class 'nowhere' has no region"), (None, "the campaign has no image")):
        with pytest.raises(UsageError, match=message):
            completed_scenario(scenario(classes, fractions="measured"), where, None)

"""Built-in surfaces, class statistics and fills: what they promise, counted another way, and what cannot be."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.data import ClassStatistics
from hyperval.errors import UsageError
from hyperval.model import (
    FillDistribution,
    Neighbour,
    TargetGeometry,
    average_reflectance,
    beta_fill,
    object_fills,
    pixel_fills,
    shared_pixel_fills,
)
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class, builtin_mean

AXIS = SpectralAxis(np.linspace(380, 2480, 320), np.full(320, 7.0))
NAMES = [
    "grass", "asphalt", "soil", "yellow-paint-plank", "green-paint-plank",
    "white-panel", "black-panel", "grey-panel-30",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_surface_is_physical_and_of_full_rank(name):
    found = builtin_class(name, AXIS)
    assert builtin_mean(name, AXIS).tolist() == found.mean.tolist()
    assert np.all((found.mean > 0) & (found.mean < 1))
    eigenvalues = np.linalg.eigvalsh(found.covariance)
    assert eigenvalues[0] > 0
    assert eigenvalues[-1] / eigenvalues[0] < 1e6
    assert "not a measurement" in found.source


@pytest.mark.parametrize("name", ["lawn", "grey-panel-x", "grey-panel-100"])
def test_unknown_surface(name):
    with pytest.raises(UsageError, match="unknown built-in surface"):
        builtin_class(name, AXIS)


@pytest.mark.parametrize("fractions", [[0.5, 0.4], [1.5, -0.5], []])
def test_fractions_that_are_no_partition(fractions):
    with pytest.raises(UsageError, match="not a partition"):
        average_reflectance(fractions, np.ones((len(fractions), 2)))


def test_binned_distribution_keeps_mean_and_nearly_the_variance():
    rng = np.random.default_rng(1)
    fill = FillDistribution(rng.random(2000), np.full(2000, 1 / 2000))
    binned = fill.binned(48)
    assert binned.values.size <= 48
    assert binned.mean == pytest.approx(fill.mean, rel=1e-12)
    # Within a bin of width h the lost variance is h^2/12 = (1/48)^2/12.
    assert fill.variance - binned.variance == pytest.approx((1 / 48) ** 2 / 12, rel=0.2)


@pytest.mark.parametrize("bad", [{"length_m": 0.0}, {"gsd_m": -1.0}, {"psf_fwhm_pixels": -0.1}, {"length_m": 1000.0}])
def test_impossible_geometry(bad):
    with pytest.raises(UsageError):
        TargetGeometry(**{"length_m": 1.0, "width_m": 1.0, "gsd_m": 1.0, **bad})


AXIS_OF_REFUSALS = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
MEAN, COVARIANCE = [0.1, 0.2], [[4e-4, 1e-4], [1e-4, 9e-4]]


@pytest.mark.parametrize(
    ("mean", "covariance", "tail_dof", "words"),
    [
        ([0.1], COVARIANCE, None, r"mean \(1,\) and covariance \(2, 2\) do not fit 2 bands"),
        (MEAN, [4e-4, 9e-4], None, r"mean \(2,\) and covariance \(2,\) do not fit 2 bands"),
        ([0.1, np.nan], COVARIANCE, None, "mean and covariance must be finite"),
        (MEAN, [[4e-4, np.inf], [np.inf, 9e-4]], None, "mean and covariance must be finite"),
        (MEAN, [[4e-4, 1e-4], [2e-4, 9e-4]], None, "the covariance is not symmetric"),
        (MEAN, [[4e-4, 7e-4], [7e-4, 9e-4]], None, "the covariance is not positive semi-definite"),
        (MEAN, COVARIANCE, 2.0, "tail_dof must exceed 2, got 2"),
        (MEAN, COVARIANCE, np.nan, "tail_dof must exceed 2, got nan"),
    ],
)
def test_statistics_that_are_none_are_refused_by_the_name_of_their_class(mean, covariance, tail_dof, words):
    with pytest.raises(UsageError, match=f"class 'grass': {words}"):
        ClassStatistics("grass", AXIS_OF_REFUSALS, np.array(mean), np.array(covariance), tail_dof=tail_dof)


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 0.1), (1.0, 0.1), (0.5, 0.5), (0.5, 0.6), (0.1, 0.31)])
def test_moments_that_no_fill_has_are_refused(mean, sd):
    with pytest.raises(UsageError, match="no fill fraction between 0 and 1 has mean"):
        beta_fill(mean, sd)


BLUR = (1.4, 0.3)  # along (y), across (x)


def geometry(blur, heading=0.0, length=1.3, width=0.6) -> TargetGeometry:
    return TargetGeometry(length, width, 1.0, heading, blur)


def test_a_turn_by_a_right_angle_changes_the_directions():
    # A target turned by 90 degrees under blur (a, b) is the mirror image of the target under blur (b, a).
    fills = pixel_fills(geometry(BLUR), np.array([[0.2, 0.1]]), np.array([90.0]))[0]
    mirror = pixel_fills(geometry(BLUR[::-1]), np.array([[0.1, 0.2]]), np.array([0.0]))[0]
    assert fills == pytest.approx(mirror.T, abs=1e-9)


def test_a_negative_width_is_refused():
    with pytest.raises(UsageError, match="PSF width not negative"):
        geometry((1.0, -0.1))


def neighbour_fill_geometry(length=1.0, width=1.4, heading=12.0, blur=1.0, phase="random"):
    return TargetGeometry(length, width, 0.7, heading, blur, phase)


@pytest.mark.parametrize("blur", [0.5, 1.0, (1.0, 0.6)])
@pytest.mark.parametrize("heading", [0.0, 12.0, 80.0])
def test_alone_it_is_the_fill_of_the_object(blur, heading):
    own, others = shared_pixel_fills(neighbour_fill_geometry(heading=heading, blur=blur), 6, [])
    assert own == pytest.approx(object_fills(neighbour_fill_geometry(heading=heading, blur=blur), 6), abs=2e-4)
    assert others.shape == (377, 6, 0)


def test_halves_side_by_side_are_the_whole():
    # 1 m x 2 m aligned with the lines, cut in two along the samples: in each pixel the halves add up.
    half, whole = neighbour_fill_geometry(1.0, 1.0, 0.0), neighbour_fill_geometry(1.0, 2.0, 0.0)
    own, others = shared_pixel_fills(half, 60, [Neighbour(half, (0.0, 1.0 / 0.7))])
    far, _ = shared_pixel_fills(half, 60, [Neighbour(half, (0.0, 30.0))])
    middle, _ = shared_pixel_fills(neighbour_fill_geometry(1.0, 1.0, 0.0, phase="centred"), 1, [])
    assert own == pytest.approx(far, abs=1e-12)
    assert (own + others[..., 0]).sum(axis=1) == pytest.approx(np.full(377, 2.0 / 0.49), rel=0.02)
    # The pixel between the two, where the whole has its centre.
    at = pixel_fills(whole, [[0.0, 0.0]], [0.0])[0]
    centre = at[at.shape[0] // 2, at.shape[1] // 2]
    left, right = shared_pixel_fills(
        neighbour_fill_geometry(1.0, 1.0, 0.0, phase="centred"), 200, [Neighbour(half, (0.0, 1.0 / 0.7))]
    )
    assert middle[0, 0] == pytest.approx(left[0, 0])
    # Sampled at whole pixels from one half's centre: compare with the whole moved by half of its side.
    moved = pixel_fills(whole, [[0.5 / 0.7, 0.0]], [0.0])[0]
    assert np.sort((left + right[..., 0])[0])[-9:] == pytest.approx(np.sort(moved.ravel())[-9:], abs=2e-4)
    assert centre > 0.5


def test_the_neighbour_lies_where_it_is_said_to():
    """Lines first: a neighbour below fills pixels below, by another route at one stated place."""
    own = neighbour_fill_geometry(1.0, 1.0, 20.0, phase="centred")
    offset = (2.2, -0.7)
    fills, others = shared_pixel_fills(own, 25, [Neighbour(own, offset)])
    mine = pixel_fills(own, [[0.0, 0.0]], [20.0])[0]
    beside = pixel_fills(own, [[offset[1] % 1.0 - 1.0, offset[0] % 1.0]], [20.0])[0]  # (x, y) within a pixel
    # Its grid is moved by whole pixels: two lines down, no sample (the -0.7 is already within a pixel's reach).
    shift = int(np.floor(offset[0])), int(np.floor(offset[1])) + 1
    half = mine.shape[0] // 2
    for rank in np.argsort(-mine.ravel(), kind="stable")[:6]:
        line, sample = np.unravel_index(rank, mine.shape)
        at = line - half - shift[0] + beside.shape[0] // 2, sample - half - shift[1] + beside.shape[1] // 2
        k = int(np.argmin(np.abs(fills[0] - mine[line, sample]) + np.abs(others[0, :, 0] - beside[at])))
        assert fills[0, k] == pytest.approx(mine[line, sample], abs=2e-4)
        assert others[0, k, 0] == pytest.approx(beside[at], abs=2e-4)


def test_places_known_roughly_never_fill_a_pixel_twice():
    rng = np.random.default_rng(1)
    square = neighbour_fill_geometry(2.0, 2.0, 0.0)
    own, others = shared_pixel_fills(square, 16, [Neighbour(square, (0.0, 2.2))], rng.normal(0.0, 0.5, (377, 1, 2)))
    assert np.all(own + others.sum(axis=2) <= 1.0 + 1e-12)


def test_a_random_heading_with_neighbours_is_refused():
    with pytest.raises(UsageError, match="lies any way"):
        shared_pixel_fills(neighbour_fill_geometry(heading=None), 4, [])

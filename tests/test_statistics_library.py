"""Statistics libraries: samples, there and back, other bands, and files that are none."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from hyperval import statistics_library
from hyperval.data import Components
from hyperval.errors import InputError, UsageError
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.linspace(450.0, 900.0, 10), np.full(10, 20.0), np.arange(10) != 3)
PARTS = Components(
    np.array([0.7, 0.3]),
    np.array([np.full(10, -0.03), np.full(10, 0.07)]),
    np.array([np.eye(10), 2.0 * np.eye(10)]),
    6.0,
)
GRASS = replace(statistics_library.builtin_class("grass", AXIS), n=120, source="lawn", tail_dof=5.0, components=PARTS)
SOIL = statistics_library.builtin_class("soil", AXIS)
THIRDS = Components(np.full(3, 1 / 3), np.zeros((3, 10)), np.array([np.eye(10)] * 3))
MUD = replace(SOIL, name="mud", components=THIRDS)


@pytest.fixture
def path(tmp_path):
    statistics_library.write_statistics_library(tmp_path / "library.nc", [GRASS, SOIL, MUD])
    return tmp_path / "library.nc"


def test_samples_by_hand():
    axis = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
    s = statistics_library.statistics_of_samples("a", axis, [[1.0, 2.0], [3.0, 2.0], [2.0, 5.0]])
    assert s.mean == pytest.approx([2.0, 3.0])
    assert s.covariance == pytest.approx(np.array([[1.0, 0.0], [0.0, 3.0]]))
    assert s.n == 3
    for bad in ([[1.0, 2.0]], [[1.0], [2.0]], [1.0, 2.0]):
        with pytest.raises(UsageError, match=r"array of|do not fit 2 bands"):
            statistics_library.statistics_of_samples("a", axis, bad)


def test_there_and_back(path):
    for wanted in (GRASS, SOIL, MUD):
        back = statistics_library.read_statistics_library(path, wanted.name)
        for part in ("mean", "covariance", "n", "source", "tail_dof"):
            assert np.array_equal(getattr(back, part), getattr(wanted, part))
        assert np.array_equal(back.axis.good, AXIS.good)
        for part in ("weights", "offsets", "covariances", "dof"):
            assert np.array_equal(getattr(back.components, part, None), getattr(wanted.components, part, None))


def test_files_that_are_no_library(path, tmp_path):
    with pytest.raises(InputError, match="no such statistics library"):
        statistics_library.read_statistics_library(tmp_path / "none.nc")
    (tmp_path / "text.nc").write_text("wavelength mean")
    with pytest.raises(InputError, match="not a statistics library"):
        statistics_library.read_statistics_library(tmp_path / "text.nc")
    cut = tmp_path / "cut.nc"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError):
        statistics_library.read_statistics_library(cut, "grass")
    with pytest.raises(UsageError, match="not a path of a local"):
        statistics_library.read_statistics_library("https://example.org/library.nc")


def test_other_bands_by_hand():
    assert statistics_library.on_bands(SOIL, AXIS) is SOIL
    half = SpectralAxis(np.array([475.0, 550.0]), np.full(2, 20.0))
    s = statistics_library.on_bands(SOIL, half)
    assert s.mean == pytest.approx([0.5 * (SOIL.mean[0] + SOIL.mean[1]), SOIL.mean[2]])
    # The variance of a mean of two bands.
    c = SOIL.covariance
    assert s.covariance[0, 0] == pytest.approx(0.25 * (c[0, 0] + 2 * c[0, 1] + c[1, 1]))
    with pytest.raises(UsageError, match="covers 450-900 nm and 1 bands lie outside it"):
        statistics_library.on_bands(SOIL, SpectralAxis(np.array([500.0, 950.0]), np.full(2, 10.0)))
    fewer = np.array([0, 4, 9])
    cut = statistics_library.on_bands(GRASS, SpectralAxis(AXIS.centre_nm[fewer], np.full(3, 20.0))).components
    assert cut.covariances == pytest.approx(PARTS.at(fewer).covariances)
    assert cut.offsets == pytest.approx(PARTS.offsets[:, fewer])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.drop_vars(["covariance", *(v for v in d if "component" in v)]), "lacks covariance"),
        (lambda d: d.isel(band_2=slice(0, 4)), r"covariance has shape \(3, 10, 4\)"),
        (lambda d: d.isel(band=slice(0, 0), band_2=slice(0, 0)), r"has shape \(0,\)"),
        (lambda d: d.drop_vars("component_offset"), "No variable named 'component_offset'"),
        (lambda d: d.assign(component_weight=2.0 * d["component_weight"]), "not those of a mixture"),
        (lambda d: d.assign(component_covariance=-d["component_covariance"]), "not positive semi-definite"),
    ],
)
def test_what_contradicts_itself_is_refused(path, change, words):
    with xr.open_dataset(path, engine="h5netcdf") as data:
        held = data.load()
    path.unlink()
    change(held).to_netcdf(path, engine="h5netcdf")
    with pytest.raises((InputError, UsageError), match=words):
        statistics_library.read_statistics_library(path, "grass")

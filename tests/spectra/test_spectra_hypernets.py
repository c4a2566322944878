"""Surface reflectance of HYPERNETS: errors by kind with their correlation, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from spectra_shells import CORRELATION, NM, hypernets

from hyperval.errors import InputError
from hyperval.model import Sources, covariance_in_bands
from hyperval.scenario import SpectrumSource
from hyperval.spectra import SpectralAxis, band_average, read_hypernets, read_records, read_spectrum

REAL = "hypernets/HYPERNETS_L_GHNA_L2A_REF_20231103T0901_20240124T2246_v2.0.nc"


def written(tmp_path: Path, **changes) -> Path:
    return hypernets(tmp_path / "sequence.nc", **changes)


def test_a_series_and_its_errors(tmp_path):
    found = read_hypernets(written(tmp_path))
    assert (found.site, found.latitude_deg) == ("XXXX", -23.6)
    assert found.names == ("series 1: zenith 30 azimuth 263", "series 2: zenith 0 azimuth 98")
    covariance = found.errors(0).covariance()
    assert np.diag(covariance) == pytest.approx(0.04 * (0.01**2 + 0.03**2))
    assert covariance[0, 1] == pytest.approx(0.9 * 0.006**2)
    assert covariance[0, -1] == pytest.approx(0.3 * 0.006**2)


def test_rounding_of_the_correlation_leaves_no_negative_variance(tmp_path):
    rounded = np.round(np.exp(-0.5 * (np.subtract.outer(NM, NM) / 40.0) ** 2), 2)
    assert np.linalg.eigvalsh(rounded)[0] < -1e-3
    found = read_hypernets(written(tmp_path, err_corr_systematic_reflectance=rounded))
    assert np.linalg.eigvalsh(found.correlation)[0] > -1e-12
    assert np.diag(found.correlation) == pytest.approx(1.0)
    assert found.correlation == pytest.approx(rounded, abs=0.01)


def test_it_is_a_file_of_spectra_like_others(tmp_path):
    path = written(tmp_path)
    assert len(read_records(path)) == 2
    nadir = read_spectrum(path, record="zenith 0")
    assert nadir.n == 12
    assert nadir.notes == ("quality flags 0x10",)
    assert nadir.errors is not None
    assert nadir.errors.random == pytest.approx(0.01 * nadir.values)


def test_errors_go_into_bands_as_the_mean_does(tmp_path):
    """Draws averaged over bands have the covariance that the formula gives (seed 4; 1 in 1e4 fails)."""
    found = read_hypernets(written(tmp_path))
    covariance, axis = found.errors(1).covariance(), SpectralAxis(np.array([410.0, 430.0, 450.0]), 10.0)
    expected = covariance_in_bands(NM, covariance, axis)
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(NM.size), covariance, 40_000)
    assert np.cov(band_average(NM, draws, axis).T) == pytest.approx(expected, rel=0.05)
    surface = Sources(axis, {}, Path).spectrum(SpectrumSource(file=str(written(tmp_path)), record="zenith 0"), "sand")
    assert surface.mean_error == pytest.approx(expected)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"quality_flag": None}, "holds no quality_flag"),
        ({"wavelength": NM[::-1].copy()}, "do not increase"),
        ({"u_rel_random_reflectance": np.full((NM.size, 2), -1.0)}, "below 0"),
        ({"err_corr_systematic_reflectance": 2.0 * CORRELATION}, "beyond -1 to 1"),
        ({"acquisition_time": np.array([1e300, 0.0])}, "place or time"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        read_hypernets(written(tmp_path, **changes))


def test_a_cut_file_is_refused(tmp_path):
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="cannot be read"):
        read_hypernets(path)


@pytest.mark.data
def test_the_real_sequence(data_dir):
    found = read_hypernets(data_dir(REAL))
    assert found.site == "GHNA"
    assert found.reflectance.shape == (45, 1554)
    assert np.flatnonzero(found.flags).tolist() == [7, 9]
    nadir = read_spectrum(data_dir(REAL), record="series 24: zenith 0 azimuth 293")
    assert nadir.errors is not None
    total = np.sqrt(np.diag(nadir.errors.covariance())) / nadir.values
    assert 0.028 < np.median(total) < 0.04  # the systematic part is 3 %

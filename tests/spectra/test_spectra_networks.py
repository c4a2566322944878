"""Files of RadCalNet and HYPERNETS: what they say, errors by kind with their correlation, and what is refused."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import yaml
from spectra_shells import CORRELATION, NM, RADCALNET, RADCALNET_ERRORS, hypernets

from hyperval import spectra
from hyperval.errors import InputError, UsageError
from hyperval.model import Sources, covariance_in_bands
from hyperval.scenario import SpectrumSource


def day_file(folder: Path, text: str = RADCALNET, name: str = "day.input") -> Path:
    (folder / name).write_text(text, "utf-8-sig")  # some programs write its mark
    return folder / name


def test_a_day_as_it_stands_and_as_spectra_like_others(tmp_path):
    path = day_file(tmp_path)
    day = spectra.read_radcalnet(path)
    assert (day.site, day.latitude_deg, day.longitude_deg, day.altitude_m) == ("XXXX01", 40.5, -109.5, 1270.0)
    times = (datetime(2020, 2, 29, 3, 30, tzinfo=UTC), datetime(2020, 2, 29, 4, 0, tzinfo=UTC))
    assert (day.times, day.wavelength_nm.tolist()) == (times, [400.0, 410.0, 420.0])
    np.testing.assert_array_equal(day.values, [[0.10, np.nan, 0.12], [0.20, 0.21, 0.22]])
    np.testing.assert_array_equal(day.uncertainty, [[0.01, np.nan, 0.02], [0.02, 0.03, 0.02]])
    assert day.valid == ("03:30",)  # the Angstrom exponent of the other is no value
    at = day.at("03:30")
    assert (at["pressure_hpa"], at["ozone_atm_cm"], at["u_aot550"]) == (900.0, 0.28, 0.1)
    for words in ("04:00 holds no value", "05:00 is none of the file"):
        with pytest.raises(UsageError, match=words):
            day.at(words[:5])
    found = {at.name: (at.wavelength_nm.tolist(), at.standard_deviation.tolist()) for at in spectra.read_records(path)}
    assert found == {"03:30": ([400.0, 420.0], [0.01, 0.02])}
    with pytest.raises(InputError, match=r"holds top-of-atmosphere reflectance, not reflectance"):
        spectra.read_spectrum(day_file(tmp_path, name="day.output"), record="03:30")
    with pytest.raises(UsageError, match=r"\.input \(surface\)"):
        spectra.read_radcalnet(day_file(tmp_path, name="day.txt"))
    later = RADCALNET.replace("Type:", "Zen:\t64\t59\nAzi:\t46\t41\n\nType:").replace("20\t0.02", "20\t9.02")
    top = spectra.read_radcalnet(day_file(tmp_path, later, "day.txt"))
    assert (top.quantity, np.isfinite(top.values[:, -1]).tolist()) == ("top-of-atmosphere reflectance", [False, True])


DAYS = yaml.safe_load(Path(__file__).with_name("days.yaml").read_text("utf-8"))


@pytest.mark.parametrize("case", [*DAYS, {"old": RADCALNET_ERRORS, "new": "", "words": "end of the file"}])
def test_a_day_that_cannot_be_is_refused(tmp_path, case):
    assert case["old"] in RADCALNET
    with pytest.raises(InputError, match=case["words"]):
        spectra.read_radcalnet(day_file(tmp_path, RADCALNET.replace(case["old"], case["new"], 1)))


def test_a_series_and_its_errors(tmp_path):
    first, nadir = spectra.read_records(hypernets(tmp_path / "s.nc"))
    assert (first.name, nadir.name) == ("series 1: zenith 30 azimuth 263", "series 2: zenith 0 azimuth 98")
    covariance = first.errors.covariance()
    assert np.diag(covariance) == pytest.approx(0.04 * (0.01**2 + 0.03**2))
    assert covariance[0, [1, -1]] == pytest.approx(np.array([0.9, 0.3]) * 0.006**2)
    assert (nadir.n, nadir.notes) == (12, ("quality flags 0x10",))
    assert nadir.errors.random == pytest.approx(0.01 * nadir.values)
    assert nadir.errors.correlation is first.errors.correlation


def test_rounding_of_the_correlation_leaves_no_negative_variance(tmp_path):
    rounded = np.round(np.exp(-0.5 * (np.subtract.outer(NM, NM) / 40.0) ** 2), 2)
    path = hypernets(tmp_path / "s.nc", err_corr_systematic_reflectance=rounded)
    found = spectra.read_records(path)[0].errors.correlation
    assert np.linalg.eigvalsh(rounded)[0] < -1e-3 < -1e-12 < np.linalg.eigvalsh(found)[0]
    assert (np.diag(found), found) == (pytest.approx(1.0), pytest.approx(rounded, abs=0.01))


def test_errors_go_into_bands_as_the_mean_does(tmp_path):
    """Draws averaged over bands have the covariance that the formula gives (seed 4; 1 in 1e4 fails)."""
    path = hypernets(tmp_path / "s.nc")
    covariance = spectra.read_records(path)[1].errors.covariance()
    axis = spectra.SpectralAxis(np.array([410.0, 430.0, 450.0]), 10.0)
    expected = covariance_in_bands(NM, covariance, axis)
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(NM.size), covariance, 40_000)
    assert np.cov(spectra.band_average(NM, draws, axis).T) == pytest.approx(expected, rel=0.05)
    surface = Sources(axis, {}, Path).spectrum(SpectrumSource(file=str(path), record="zenith 0"), "sand")
    assert surface.mean_error == pytest.approx(expected)
    # Bands that truly stand off their labels have the errors that the file states for these.
    moved = Sources(spectra.SpectralAxis(NM + 0.2, 1.0), {}, Path, spectra.SpectralAxis(NM, 1.0))
    surface = moved.spectrum(SpectrumSource(file=str(path), record="zenith 0"), "sand")
    assert surface.mean_error == pytest.approx(covariance)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"quality_flag": None}, "lacks quality_flag"),
        ({"wavelength": NM[::-1].copy()}, "do not increase"),
        ({"u_rel_random_reflectance": np.full((NM.size, 2), -1.0)}, "below 0"),
        ({"err_corr_systematic_reflectance": 2.0 * CORRELATION}, "beyond -1 to 1"),
        (None, "damaged"),  # cut
    ],
)
def test_a_sequence_that_cannot_be_is_refused(tmp_path, changes, words):
    path = hypernets(tmp_path / "s.nc", **(changes or {}))
    if changes is None:
        path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match=words):
        spectra.read_records(path)


@pytest.mark.data
def test_real_files(data_dir):
    day = spectra.read_radcalnet(data_dir("radcalnet/BTCN02_2018_148_v00.03.input"))
    assert (day.valid[0], day.valid[6:], day.at("05:30")["angstrom_exponent"]) == ("04:00", ("07:00",), 0.196)
    top = spectra.read_radcalnet(data_dir("radcalnet/BTCN02_2018_148_v02.03.output"))
    assert (top.quantity, top.values[top.column("05:30"), 0]) == ("top-of-atmosphere reflectance", 0.1784)
    name = "hypernets/HYPERNETS_L_GHNA_L2A_REF_20231103T0901_20240124T2246_v2.0.nc"
    found = spectra.read_records(data_dir(name))
    flagged = [i for i, series in enumerate(found) if series.notes]
    assert (len(found), found[0].wavelength_nm.size, flagged) == (45, 1554, [7, 9])
    total = np.sqrt(np.diag(found[23].errors.covariance())) / found[23].values
    assert found[23].name == "series 24: zenith 0 azimuth 293"
    assert 0.028 < np.median(total) < 0.04  # the systematic part is 3 %

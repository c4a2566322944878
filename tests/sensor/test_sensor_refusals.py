"""Entries of a sensor file that contradict themselves are refused; each limit is met from both sides."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hyperval.errors import UsageError
from hyperval.sensor.response import solid_angle
from hyperval.sensor.specification import Bands, Blur, PublishedSnr, Quantity, SpectralShift, Throughput, load_sensor

SOURCE = "assumed: for tests"
ONE = {"value": 1.0, "source": SOURCE}
SCENE = {"reflectance": 0.3, "solar_zenith_deg": 30.0, "sensor_altitude_km": 700.0, "source": SOURCE}


@pytest.mark.parametrize(
    ("kind", "entries", "words"),
    [
        (Quantity, {}, "give either value or table"),
        (Quantity, {"value": 1.0, "table": [[400.0, 1.0], [500.0, 1.0]]}, "give either value or table"),
        (Quantity, {"table": [[400.0, 1.0]]}, "at least two rows in rising wavelength"),
        (Quantity, {"table": [[400.0, 1.0], [400.0, 1.0]]}, "at least two rows in rising wavelength"),
        (Bands, {}, "give either table, regular or parts"),
        (Blur, {}, "give either fwhm_pixels or mtf_at_nyquist"),
        (Blur, {"fwhm_pixels": [1.0, 1.0], "mtf_at_nyquist": [0.3, 0.3]}, "give either fwhm_pixels or"),
        (Blur, {"fwhm_pixels": [1.0, 5.1]}, "fwhm_pixels lies between 0 and 5"),
        (Blur, {"fwhm_pixels": [-0.1, 1.0]}, "fwhm_pixels lies between 0 and 5"),
        (Blur, {"mtf_at_nyquist": [0.3, 0.64]}, "mtf_at_nyquist lies between 0.01 and 0.6366"),
        (Blur, {"mtf_at_nyquist": [0.009, 0.3]}, "mtf_at_nyquist lies between 0.01 and 0.6366"),
        (PublishedSnr, {"table": [[500.0, 100.0]], "radiance": ONE, "scene": SCENE}, "radiance or scene, not both"),
        (Throughput, {}, "the convention square-ifov needs aperture_m, ifov_mrad"),
        (Throughput, {"convention": "slit", "f_number": 2.0}, "slit needs slit_width_um, slit_height_um"),
        (SpectralShift, {"smile_nm": [1.0]}, "smile_nm and columns go together"),
        (SpectralShift, {"columns": 100}, "smile_nm and columns go together"),
    ],
)  # fmt: skip
def test_entries_that_contradict_themselves_are_refused(kind, entries, words):
    with pytest.raises(ValidationError, match=words):
        kind(**entries, source=SOURCE)


@pytest.mark.parametrize("entries", [{"fwhm_pixels": [0.0, 5.0]}, {"mtf_at_nyquist": [0.01, 0.6366]}])
def test_the_ends_of_the_ranges_of_a_blur_belong_to_them(entries):
    along, across = Blur(**entries, source=SOURCE).fwhm
    if "fwhm_pixels" in entries:
        assert (along, across) == (0.0, 5.0)
    else:
        assert along > 2.0 > 0.1 > across >= 0.0


def test_a_quantity_is_linear_in_wavelength_and_keeps_its_ends():
    table = Quantity(table=[[400.0, 1.0], [500.0, 3.0]], source=SOURCE)
    assert table.at(np.array([300.0, 400.0, 425.0, 500.0, 900.0])).tolist() == [1.0, 1.0, 1.5, 3.0, 3.0]


def test_a_solid_angle_of_another_convention_is_refused():
    with pytest.raises(UsageError, match="unknown convention 'round'"):
        solid_angle(1e-3, "round")


def test_an_arm_serves_fifty_nanometres_beyond_its_range_and_no_more():
    sensor = load_sensor("hydice")
    low = min(arm.range_nm[0] for arm in sensor.specification.arms)
    assert sensor.arm_index(np.array([low - 50.0])).size == 1
    with pytest.raises(UsageError, match="has no arm at"):
        sensor.arm_index(np.array([low - 50.1]))


def test_widths_of_bands_are_those_of_the_table_or_of_each_part():
    table = Bands(table=[[450.0, 10.0, 1], [460.0, 12.0, 1]], source=SOURCE)
    regular = {"first_nm": 400.0, "step_nm": 10.0, "count": 3, "fwhm_nm": 9.0}
    assert table.fwhms == [10.0, 12.0]
    assert Bands(regular=regular, source=SOURCE).fwhms == [9.0]
    assert Bands(parts=[regular, {**regular, "first_nm": 500.0, "fwhm_nm": 8.0}], source=SOURCE).fwhms == [9.0, 8.0]

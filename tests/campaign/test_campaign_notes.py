"""What a cube and its truth say of time, place and targets, held against the scenarios of the campaign."""

import re
from typing import Any

import numpy as np
import pytest

from hyperval import api
from hyperval.imagery import open_cube, write_cube
from small_campaign import SmallCampaign, data_of

FLIGHT = {"latitude_deg": 42.9, "longitude_deg": -77.75, "time_utc": "2012-07-18T17:00:00Z"}
SQUARE = {"side_m": 0.38, "gsd_m": 1.0, "pixels": "ranked", "n": 1}


def warnings(small: SmallCampaign) -> list[str]:
    small.data["comparisons"] = small.data["comparisons"][:1]
    notes = api.validate(small.write()).notes
    return [note for note in notes if note.startswith("warning: ") and "the empirical line" not in note]


def at(small: SmallCampaign, **flight: Any) -> None:
    given = small.scenario["atmosphere"]
    for key in ("solar_zenith_deg", "solar_azimuth_deg", "day_of_year"):
        del given[key]
    given |= FLIGHT | flight


@pytest.mark.parametrize(("entry", "flight", "words"), data_of("other_flights"))
def test_another_place_or_time_is_a_warning(small, entry, flight, words):
    at(small, **flight)
    small.edit("small_rad.hdr", lambda text: text + entry + "\n")
    said = warnings(small)
    assert len(said) == (words is not None)
    assert words is None or re.search(words, said[0])


def test_a_raw_cube_lies_where_its_tables_place_it_and_has_the_sun_of_its_angles(small):
    at(small)
    places = small.collection
    cube = open_cube(places / "small_rad.img", quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    small.edit("small_rad.hdr", lambda t: re.sub(r"(?m)^(map info|coordinate system string) = .*\n", "", t))
    small.data["collection"]["targets"]["pixel_size_m"] = 1.0
    assert warnings(small) == []  # nothing says where it lies
    del small.data["collection"]["targets"]["pixel_size_m"]
    line, sample = np.mgrid[0 : cube.lines, 0 : cube.samples]
    degrees = np.stack([-77.75 + 1e-5 * sample, 44.9 - 1e-5 * line], axis=-1)
    degrees[:, :40] = -9999.0  # pixels without a place, the middle among them
    for name in ("small_rad.img", "small_rad.hdr"):
        (places / name).rename(places / name.replace("small_rad", "small_rdn"))
    small.data["collection"]["cube"]["path"] = "collection/small_rdn.img"
    write_cube(places / "small_igm.img", degrees, data_type=5)
    write_cube(places / "small_obs.img", np.full((*cube.shape, 2), 41.5), data_type=5)
    angles = places / "small_obs.hdr"
    angles.write_text(angles.read_text() + "band names = {Path length, To-sun zenith}\n")
    said = " ".join(warnings(small))
    assert "the cube lies at latitude 44.9" in said
    assert re.search(r"the sun is at a zenith angle of 41\.50 degrees in small_obs\.img, at 2\d\.\d\d in", said)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, None),
        ({"pixels": "touched", "n": None}, "counts 1.91 pixels for each object, the truth 1"),
        ({"gsd_m": 1.2}, r"pixels are 1.2 m wide \(gsd_m\), those of the image 1 m"),
        ({"side_m": 0.5}, r"sides are 0.5 m \(side_m\), those of the truth 0.379 m"),
    ],
)
def test_targets_of_another_kind_than_the_truth_are_a_warning(small, change, words):
    geometry = {k: v for k, v in (SQUARE | change).items() if v is not None}
    small.scenario["scene"]["targets"][0]["subjects"][0]["fill"] = {"geometry": geometry}
    said = warnings(small)
    assert len(said) == (words is not None), said
    assert words is None or re.search(f"^warning: 'small-planks' of scenario 'small': .*{words}", said[0]), said


def test_filters_for_another_spectrum_and_bands_of_other_widths_than_the_model_has_are_warnings(small):
    small.data["detection"]["targets"][0]["spectrum"] = {"constant": 0.4}
    small.edit("small_rad.hdr", lambda text: re.sub(r"(?s)fwhm = .*?\}\n", "", text))  # the spacing is taken
    assert re.search("bands of the image are .* times as wide.*look for another spectrum", " ".join(warnings(small)))

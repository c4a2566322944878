"""Files as other providers write them: wavelengths in tags, percent, containers that are no cubes."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.errors import NotGeoreferencedWarning

from hyperval.errors import InputError
from hyperval.imagery import open_cube, open_raster, tiff, write_cube

CENTRE = (450.0, 550.0, 650.0, 850.0)


def tagged(path: Path, values: np.ndarray, tags: list[dict[str, str]]) -> Path:
    """A GeoTIFF without a map position, with tags for each band."""
    lines, samples, bands = values.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", height=lines, width=samples, count=bands, dtype="float32") as out:
            out.write(values.astype(np.float32).transpose(2, 0, 1))
            for band, entries in enumerate(tags, start=1):
                out.update_tags(band, **entries)
    return path


@pytest.mark.parametrize("domain", ["ENVI", None, "names"])
@pytest.mark.parametrize("each", [True, False])
@pytest.mark.parametrize(("unit", "per_nm"), [("nm", 1.0), ("Micrometers", 1e-3)])
def test_wavelengths_in_tags_of_bands_or_data_set_or_in_names(tmp_path: Path, values, domain, each, unit, per_nm):
    path = tagged(tmp_path / "c.tif", values, [])
    listed = {"wavelength": [f"{w * per_nm:g}" for w in CENTRE], "fwhm": [f"{9.5 * per_nm:g}"] * 4}
    listed["bbl"] = ["1", "1", "0", "1"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as out:
            if domain == "names":
                out.descriptions = [f"{w} {unit}" for w in listed["wavelength"]]
            for band in range((4 if each else 1) * (domain != "names")):
                entries = {key: texts[band] if each else ",".join(texts) for key, texts in listed.items()}
                out.update_tags(*([band + 1] if each else []), ns=domain, **{"wavelength units": unit, **entries})
    cube = open_cube(path, quantity="reflectance")
    assert cube.axis.centre_nm == pytest.approx(CENTRE)
    if domain == "names":
        assert any("names of the bands" in note for note in cube.notes)
    else:
        assert cube.axis.fwhm_nm == pytest.approx([9.5] * 4)
        assert cube.axis.good.tolist() == [True, True, False, True]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"wavelength_units": "inches"}, "in 'inches' cannot be used"),
        ({"wavelength": "blue"}, "that are no positive numbers"),
        ({"wavelength": "nan"}, "that are no positive numbers"),
        ({"fwhm": "-1"}, "'fwhm' of the bands that are no positive numbers"),
    ],
)
def test_tags_without_unit_or_number_are_not_believed(tmp_path: Path, values, spoil, message):
    tags = [{"wavelength": f"{w}", "wavelength_units": "nm", **spoil} for w in CENTRE]
    with pytest.raises(InputError, match=message):
        open_cube(tagged(tmp_path / "c.tif", values, tags), quantity="reflectance")


def test_a_file_that_gdal_converted_keeps_its_wavelengths(tmp_path: Path, values):
    """GDAL writes them twice, once rounded to a nanometre, and the widths rounded alone."""
    header = "\n".join([
        "ENVI", f"samples = {values.shape[1]}", f"lines = {values.shape[0]}", "bands = 4", "data type = 4",
        "interleave = bsq", "byte order = 0", "wavelength units = Nanometers",
        "wavelength = {433.29, 446.58, 659.87, 873.15}", "fwhm = {5.3, 5.3, 5.4, 5.4}",
    ])  # fmt: skip
    (tmp_path / "a.hdr").write_text(header + "\n")
    (tmp_path / "a.img").write_bytes(values.astype("<f4").transpose(2, 0, 1).tobytes())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        rasterio.shutil.copy(tmp_path / "a.img", tmp_path / "a.tif", driver="GTiff")
    (tmp_path / "a.hdr").rename(tmp_path / "no.header")
    cube = open_cube(tmp_path / "a.tif", quantity="reflectance")
    assert cube.axis.centre_nm == pytest.approx([433.29, 446.58, 659.87, 873.15], abs=1e-9)
    assert cube.axis.fwhm_nm == pytest.approx([5.0] * 4)
    assert any("whole nanometres" in note for note in cube.notes)


def test_two_wavelengths_of_a_band_are_refused(tmp_path: Path, values):
    path = tagged(tmp_path / "t.tif", values, [{"wavelength": f"{w}", "wavelength_units": "nm"} for w in CENTRE])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as out:
            for band, w in enumerate(CENTRE, start=1):
                out.update_tags(band, ns="IMAGERY", CENTRAL_WAVELENGTH_UM=f"{w / 1e3 + 0.002:.4f}")
    with pytest.raises(InputError, match="the bands have two wavelengths"):
        open_cube(path, quantity="reflectance")


def test_tags_in_falling_order_are_sorted_on_request(tmp_path: Path, values):
    tags = [{"wavelength": f"{w}", "wavelength_units": "nm", "fwhm": f"{w / 50}"} for w in CENTRE[::-1]]
    path = tagged(tmp_path / "c.tif", values, tags)
    with pytest.raises(InputError, match="sort_bands: true") as caught:
        open_cube(path, quantity="reflectance")
    assert "c.tif" in str(caught.value)
    cube = open_cube(path, quantity="reflectance", sort_bands=True)
    assert cube.axis.centre_nm == pytest.approx(CENTRE)
    assert cube.axis.fwhm_nm == pytest.approx(np.array(CENTRE) / 50)
    assert cube.read(0, 1).values == pytest.approx(values[:1, :, ::-1], rel=1e-6)


def test_a_mask_in_the_file_is_not_passed_over(tmp_path: Path, values):
    tags = [{"wavelength": f"{w}", "wavelength_units": "nm"} for w in CENTRE]
    path = tagged(tmp_path / "c.tif", values, tags)
    with warnings.catch_warnings(), rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as out:
            out.write_mask(np.arange(values[..., 0].size).reshape(values.shape[:2]) > 5)
    with pytest.raises(InputError, match="mask or alpha band"):
        open_cube(path, quantity="reflectance")


def test_threads_that_read_a_file_without_position_warn_of_nothing(tmp_path: Path, values, monkeypatch):
    monkeypatch.setattr(tiff, "MAX_READ_BYTES", 0)  # as of a large image: each opens the file
    raster = open_raster(tagged(tmp_path / "c.tif", np.tile(values, (40, 8, 1)), []))
    with warnings.catch_warnings(record=True) as seen, ThreadPoolExecutor(8) as pool:
        warnings.simplefilter("always")
        blocks = list(pool.map(lambda line: raster.read_lines(line, 1), range(raster.lines)))
    # Others may come from what earlier tests left to be collected.
    assert not [w for w in seen if issubclass(w.category, NotGeoreferencedWarning)]
    assert np.array_equal(np.concatenate(blocks), raster.read_lines(0, raster.lines))


def test_percent_is_named_with_the_scale_that_mends_it(tmp_path: Path, axis, values):
    path = write_cube(tmp_path / "pct.img", 100.0 * values, data_type=4, axis=axis)
    with pytest.raises(InputError) as caught:
        open_cube(path, quantity="reflectance")
    assert "0.01 where they are percent" in str(caught.value.mend)
    assert not caught.value.what.endswith(" 1")
    read = open_cube(path, quantity="reflectance", scale=0.01).pixels(np.ones((6, 5), bool))
    assert read == pytest.approx(values.reshape(-1, 4), rel=1e-6)


def test_a_container_that_is_not_read_is_called_what_it_is(tmp_path: Path):
    path = tmp_path / "scene.hdf"
    path.write_bytes(b"\x0e\x03\x13\x01" + bytes(600))
    with pytest.raises(InputError, match=r"HDF4.*not read as a cube") as caught:
        open_raster(path)
    assert "docs/formats.md, Cubes" in str(caught.value.mend)

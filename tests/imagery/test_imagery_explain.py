"""``hyperval explain``: the reader's own record, with the origin of every number and what mends a lack."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval import api, cli
from hyperval.imagery import write_cube


def rows(*given, **options):
    return {what: (value, origin) for what, value, origin in api.explain(*given, **options) if what != "assumed"}


@pytest.fixture
def cube(tmp_path, axis, values):
    extra = {"reflectance scale factor": "10000"}
    return write_cube(tmp_path / "c.img", values, data_type=4, axis=axis, ignore_value=-9.0, extra=extra)


def test_numbers_of_a_header_come_with_file_and_line(cube, values, axis):
    told = rows(cube)
    lines, samples, bands = values.shape
    assert told["size"] == (
        f"{lines} lines, {samples} samples, {bands} bands of float32",
        f"{cube.with_suffix('.hdr')}:3 'samples'",
    )
    value, origin = told["wavelengths"]
    assert value == f"{bands}, {axis.centre_nm[0]:g} to {axis.centre_nm[-1]:g} nm"
    line = int(origin.rsplit(":", 1)[1])
    assert cube.with_suffix(".hdr").read_text().splitlines()[line - 1].startswith("wavelength =")
    assert told["no data"][0] == "-9"
    assert told["scale of reflectance"] == (
        "x 0.0001 to 0.0001, + 0 to 0",
        "stored values / 10000 (reflectance scale factor)",
    )


def test_what_is_not_known_is_said_with_what_mends_it(cube, capsys):
    told = rows(cube)
    assert told["quantity"] == ("not known", "state quantity: (init: --quantity)")
    assert "exclude each other" in told["scale of radiance"][0]
    assert "state scale:" in told["scale of radiance"][1]
    assert told["position"][0] == "none"
    assert cli.run(["explain", str(cube)]) == 0
    assert "quantity\tnot known\tstate quantity: (init: --quantity)\n" in capsys.readouterr().out


def test_a_guess_is_called_one(tmp_path, axis, values):
    cube = write_cube(tmp_path / "c.img", values, data_type=4, axis=axis)
    header = cube.with_suffix(".hdr")
    header.write_text(header.read_text().replace("wavelength units = Nanometers", "wavelength units = Unknown"))
    assert rows(cube)["wavelength unit"] == ("nm", "guess: by the values")


def test_an_array_without_wavelengths_and_a_file_of_spectra(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((3, 4, 5), np.uint16))
    told = rows(tmp_path / "a.npy")
    assert told["is"] == ("array 'a' of a NumPy file", "its first bytes")
    assert "collection.bands" in told["wavelengths"][1]
    (tmp_path / "s.txt").write_text("wavelength_nm reflectance\n" + "".join(f"{w} 0.5\n" for w in range(400, 500, 10)))
    assert rows(tmp_path / "s.txt")["spectrum"][0] == "s: 10 values, 400 to 490 nm"

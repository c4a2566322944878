"""Files that lie about themselves or lead elsewhere: each is refused with one clear error."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import resource
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from hyperval.errors import InputError, UsageError
from hyperval.imagery import open_cube
from hyperval.paths import checked_file
from hyperval.spectra import SpectralAxis

SIZE = 6 * 5 * 4 * 2


def test_sparse_120_gb_file_is_read_by_blocks(edit):
    # Apparent size as the header says, no block on disk: opening must not touch it all.
    lines = 3_000_000_000
    path = edit(lines=str(lines))
    os.truncate(path, lines * 5 * 4 * 2)
    cube = open_cube(path, quantity="reflectance")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    block = next(cube.blocks())
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert block.values.nbytes <= 8 << 20
    assert grown_mb < 100
    assert cube.pixels((np.array([0, lines - 1]), np.array([0, 4]))).shape == (2, 4)


def test_two_headers_must_be_chosen_from(cube_file: Path):
    second = cube_file.with_name("cube.img.hdr")
    shutil.copy(cube_file.with_suffix(".hdr"), second)
    with pytest.raises(UsageError, match="two headers"):
        open_cube(cube_file, quantity="reflectance")
    assert open_cube(cube_file, quantity="reflectance", header=second).lines == 6


def test_symlink_out_of_the_root(cube_file: Path, tmp_path: Path):
    root = tmp_path / "root"
    root.mkdir()
    for suffix in (".img", ".hdr"):
        (root / f"link{suffix}").symlink_to(cube_file.with_suffix(suffix))
    with pytest.raises(UsageError, match="outside the data root"):
        open_cube(root / "link.img", quantity="reflectance", root=root)
    with pytest.raises(UsageError, match="outside the data root"):
        open_cube(root / ".." / "cube.img", quantity="reflectance", root=root)
    assert open_cube(root / "link.img", quantity="reflectance", root=tmp_path).lines == 6


def test_folder_pipe_and_device(tmp_path: Path):
    pipe = tmp_path / "pipe.img"
    os.mkfifo(pipe)
    for path in (tmp_path, pipe, Path("/dev/zero")):
        with pytest.raises(InputError, match=r"is a folder|is a pipe"):
            open_cube(path, quantity="reflectance")


@pytest.mark.parametrize(
    "path",
    [
        "/vsicurl/http://example.invalid/a.tif", "/vsizip/a.zip/a.tif", "http://example.invalid/a.img",
        "s3://bucket/a.tif", "GTIFF_DIR:1:a.tif", "a\0b.img",
    ],
)  # fmt: skip
def test_urls_and_virtual_paths(path: str):
    with pytest.raises(UsageError, match="not a path of a local"):
        checked_file(path)


# GeoTIFF ----------------------------------------------------------------------------------------


@pytest.fixture
def tiff(tmp_path: Path, values: np.ndarray) -> Path:
    path = tmp_path / "t.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=6, width=5, count=4, dtype="int16", crs="EPSG:32618",
        transform=Affine(2, 0, 3e5, 0, -2, 47e5), nodata=-99,
    ) as dataset:  # fmt: skip
        dataset.write(np.rint(values * 10000).astype("int16").transpose(2, 0, 1))
    return path


def test_more_bands_than_an_imager_has_are_refused(tmp_path: Path):
    # One pixel of 32,769 bands in 1.4 kB: width, height, bits, samples per pixel, strip and its place.
    entries = [(256, 4, 1), (257, 4, 1), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 32_769)]
    entries += [(278, 4, 1), (279, 4, 1), (284, 3, 1)]
    body = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    path = tmp_path / "many.tif"
    path.write_bytes(struct.pack("<2sHIH", b"II", 42, 8, len(entries)) + body + bytes(1300))
    with pytest.raises(InputError, match="32769 bands\n  expected: at most 20000"):
        open_cube(path, quantity="other")
    path.write_bytes(path.read_bytes().replace(struct.pack("<I", 32_769), struct.pack("<I", 16_385)))
    with pytest.raises(InputError, match="1430 bytes for 16385 bands of 1 lines and 1 samples"):
        open_cube(path, quantity="other")


def test_other_sidecars_of_a_geotiff_are_not_read(tiff: Path, axis: SpectralAxis, values: np.ndarray):
    """Overviews and masks beside the file; a world file does not move one that knows its place."""
    with rasterio.open(tiff) as dataset:
        profile = dataset.profile
    for name, size in (("t.tif.ovr", (3, 3)), ("t.tif.msk", (6, 5))):
        smaller = profile | {"height": size[0], "width": size[1], "dtype": "uint8", "nodata": None, "count": 4}
        with rasterio.open(tiff.with_name(name), "w", **smaller) as dataset:
            dataset.write(np.zeros((4, *size), "u1"))
    tiff.with_suffix(".tfw").write_text("9\n0\n0\n-9\n0\n0\n")
    with rasterio.open(tiff, "r+") as dataset:  # these are read, once
        dataset.scales, dataset.offsets = (1e-4,) * 4, (0.01,) * 4
    assert np.allclose(open_cube(tiff, quantity="reflectance", axis=axis).read(0, 6).values, values + 0.01, atol=1e-12)
    cube = open_cube(tiff, quantity="reflectance", scale=1e-4, axis=axis)
    assert (cube.ignore_value, cube.pixel_area_m2, cube.crs.to_epsg()) == (-99, 4.0, 32618)
    block = cube.read(0, 6)
    assert np.allclose(block.values, values, atol=1e-15)
    assert block.valid.all()
    assert cube.transform == Affine(2, 0, 3e5, 0, -2, 47e5)
    assert {p.name for p in cube.source_files} == {"t.tif"}


def test_sidecars_of_an_envi_cube_are_not_read(cube_file: Path, values: np.ndarray):
    cube_file.with_name("cube.img.aux.xml").write_text(
        "<PAMDataset><PAMRasterBand band='1'><NoDataValue>5</NoDataValue><Scale>7</Scale></PAMRasterBand>"
        "<GeoTransform>0, 9, 0, 0, 0, -9</GeoTransform></PAMDataset>"
    )
    for name in ("cube.img.ovr", "cube.img.msk", "cube.enp", "cube.img.enp", "cube.sta", "cube.wld"):
        cube_file.with_name(name).write_bytes(b"\0" * 50)
    cube = open_cube(cube_file, quantity="reflectance")
    assert np.allclose(cube.read(0, 6).values, values, atol=1e-15)
    assert (cube.ignore_value, cube.transform) == (None, None)
    assert {p.name for p in cube.source_files} == {"cube.img", "cube.hdr"}


@pytest.mark.parametrize("packing", ["gzip", "zip", "bzip2", "xz"])
def test_a_compressed_data_file_is_called_that(cube_file: Path, packing: str):
    raw = cube_file.read_bytes()
    if packing == "zip":
        import zipfile

        with zipfile.ZipFile(cube_file, "w") as archive:
            archive.writestr("cube.img", raw)
    else:
        pack = {"gzip": gzip.compress, "bzip2": bz2.compress, "xz": lzma.compress}[packing]
        cube_file.write_bytes(pack(raw))
    with pytest.raises(InputError, match=rf"cube\.img: the data file is compressed \({packing}\)") as caught:
        open_cube(cube_file, quantity="reflectance")
    assert "decompress it" in str(caught.value)


def test_sidecar_header_of_another_size(tiff: Path, cube_file: Path):
    header = cube_file.with_suffix(".hdr")
    tiff.with_suffix(".hdr").write_text(header.read_text().replace("lines = 6", "lines = 7"))
    with pytest.raises(InputError, match="its header says"):
        open_cube(tiff, quantity="reflectance")


def test_a_vrt_or_a_broken_file_named_tif_is_refused(tmp_path: Path, tiff: Path):
    fake = tmp_path / "v.tif"
    fake.write_text(f"<VRTDataset rasterXSize='5' rasterYSize='6'><SRSDataset>{tiff}</SRSDataset></VRTDataset>")
    with pytest.raises(InputError, match="not a readable GeoTIFF"):
        open_cube(fake, quantity="reflectance")
    os.truncate(tiff, tiff.stat().st_size // 2)
    with pytest.raises(InputError, match="GeoTIFF"):
        list(open_cube(tiff, quantity="other", axis=SpectralAxis(np.arange(4) + 400.0, 1.0)).blocks())


@pytest.mark.parametrize(
    ("size", "header", "message"),
    [
        (SIZE * 6 // 10, {}, "40 % missing"),
        (SIZE - 1, {}, "truncated"),
        (SIZE + 1, {}, "longer than its header"),
        (SIZE * 2, {}, "longer than its header"),
        (SIZE, {"header_offset": "100000"}, "truncated"),
        (SIZE, {"samples": "1000000000", "lines": "1000000000"}, "truncated"),  # before memory is taken
    ],
)
def test_a_data_file_of_another_size_than_its_header_says(edit, size: int, header, message: str):
    path = edit(**header)
    os.truncate(path, size)
    with pytest.raises(InputError, match=message) as caught:
        open_cube(path, quantity="reflectance")
    assert caught.value.exit_code == 3
    assert str(path) in str(caught.value)


def test_a_data_file_that_is_cut_while_it_is_read_or_is_gone(cube_file: Path):
    cube = open_cube(cube_file, quantity="reflectance")
    os.truncate(cube_file, SIZE // 2)
    with pytest.raises(InputError, match="became shorter while it was read"):
        cube.read(0, 6)
    cube_file.unlink()
    for named in (cube_file, cube_file.with_suffix(".hdr")):
        with pytest.raises(InputError, match=r"no such|data files beside the header: none"):
            open_cube(named, quantity="reflectance")

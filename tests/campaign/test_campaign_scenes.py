"""Detection scenes in the containers of their community become campaigns that run: MATLAB 5, MATLAB 7.3, NumPy."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from hyperval import cli
from hyperval.errors import InputError, UsageError
from hyperval.imagery import arrays, open_cube, open_raster, read_regions
from hyperval.run import read_rows

LINES, SAMPLES, BANDS = 40, 36, 8


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray]:
    """Counts (lines, samples, bands) of one background, and a map of four objects of 9, 6, 4 and 2 pixels."""
    rng = np.random.default_rng(5)
    mean = np.linspace(900.0, 1500.0, BANDS)
    data = rng.multivariate_normal(mean, 400.0 * (0.6 + 0.4 * np.eye(BANDS)), (LINES, SAMPLES))
    marked = np.zeros((LINES, SAMPLES), np.uint8)
    for top, left, height, width in ((4, 4, 3, 3), (12, 20, 2, 3), (25, 6, 2, 2), (33, 28, 1, 2)):
        marked[top : top + height, left : left + width] = 1
    data[marked == 1] += np.linspace(400.0, -200.0, BANDS)
    return data.round().astype(np.uint16), marked


def written(path: Path, data: np.ndarray, **others: np.ndarray) -> Path:
    """The arrays in the container that the end of the name says, ``.v73.mat`` MATLAB 7.3; perhaps in a struct."""
    held, group = {"data": data, **others}, "scene/" * path.name.startswith("s.")
    if path.suffix == ".npy":
        np.save(path, data)
    elif path.name.endswith(("73.mat", ".h5")):
        marked = path.name.endswith(".v73.mat")  # programs other than MATLAB leave its mark out
        with h5py.File(path, "w", userblock_size=512 * marked) as file:
            for name, array in held.items():
                file.create_dataset(group + name, data=array if path.suffix == ".h5" else array.T, chunks=True)
        if marked:
            with open(path, "r+b") as stream:
                stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    else:
        scipy.io.savemat(path, {"scene": held} if group else held, do_compression=True)
    return path


@pytest.mark.parametrize("name", ["a.mat", "a.v73.mat", "a-73.mat", "a.npy", "s.mat", "s.h5", "b.mat", "b.v73.mat"])
def test_the_values_are_those_of_the_array(tmp_path, scene, name):
    data, marked = scene
    more = {} if name.endswith("npy") else {"map": marked}
    held = np.moveaxis(data, 2, 0) if name.startswith("b.") else data  # which the map beside it tells
    path = written(tmp_path / name, held, **more)
    cube = open_cube(path, quantity="counts", axis="numbers", variable={"s": "scene.data"}.get(name[0]))
    assert np.array_equal(np.concatenate([b.values for b in cube.blocks(7)]), data)
    assert np.array_equal(cube.marked_pixels(some := ([3, 3, 39], [0, 35, 7]))[0], data[some])
    assert np.array_equal(cube.read_some_bands(5, 4, [6, 2]), data[5:9][:, :, [6, 2]])
    assert (cube.unit, cube.dtype) == ("counts", np.uint16)
    if more:
        found = read_regions(path, (LINES, SAMPLES))
        assert [np.array_equal(r.mask, marked == 1) for r in found.values()] == [True]


def test_the_arrays_of_a_file_are_told_apart_and_one_is_chosen(tmp_path, scene):
    centre = np.linspace(450.0, 900.0, BANDS)
    for name in ("a.mat", "a.v73.mat"):  # wavelengths that stand beside an image are its own
        path = written(tmp_path / name, scene[0], wavelengths=centre[None, :], fwhm=np.full((1, BANDS), 9.5))
        axis = open_cube(path, quantity="counts").axis
        assert np.stack([axis.centre_nm, axis.fwhm_nm]) == pytest.approx(np.stack([centre, np.full(BANDS, 9.5)]))
    path = written(tmp_path / "a.mat", scene[0], other=scene[0][:, :, :3].astype(float))
    with pytest.raises(UsageError, match=r"2 arrays could be meant: data, other(?s:.*)--key"):
        open_raster(path)
    assert open_raster(path, variable="other").bands == 3
    with pytest.raises(InputError, match=r"the file has data 40 x 36 x 8(?s:.*)named nothing"):
        open_raster(path, variable="nothing")


def test_what_would_not_fit_into_memory_is_refused_before_it_is_read(tmp_path, scene, monkeypatch):
    monkeypatch.setattr(arrays, "MAX_MATRIX_BYTES", 1000)
    with pytest.raises(InputError, match=r"in memory at once(?s:.*)-v7.3"):
        open_raster(written(tmp_path / "s.mat", scene[0]))
    assert open_raster(written(tmp_path / "a.v73.mat", scene[0])).bands == BANDS


def is_met(cube: Path, folder: Path, *more: str) -> bool:
    """Whether ``init`` and ``validate`` alone take a scene to a report whose criteria are met, or inconclusive."""
    assert cli.run(["init", "--cube", str(cube), "-o", str(folder), *more]) == 0
    path = folder / "campaign.yaml"
    assert cli.run(["validate", "--dry-run", str(path)]) == 0
    assert cli.run(["validate", str(path), "-o", str(folder / "out")]) in (0, 5)
    assert (folder / "out" / "report.html").exists()
    gates = {(row.product, row.metric): row.outcome for row in read_rows(folder / "out") if row.gates}
    return {gates["roc", "pd_difference@1e-2"], gates["scores", "pfa_ratio@1e-2"]} <= {"agrees", "undecided"}


def test_a_scene_goes_from_its_file_to_a_report(tmp_path, scene):
    data, marked = scene[0], scene[1] + 2 * (np.indices(scene[1].shape) == 0).all(axis=0)  # another material
    assert is_met(written(tmp_path / "s.h5", data, map=marked), tmp_path / "new")
    # Of objects of 9, 6, 4 and 2 pixels the second and fourth give the spectrum, the first and third are scored.
    regions = read_regions(tmp_path / "new" / "objects.csv", (LINES, SAMPLES))
    assert {name: region.n for name, region in regions.items()} == {
        "known objects": 8, "other materials": 1, "scored object 1": 9, "scored object 2": 4,
    }  # fmt: skip
    spectrum = tmp_path / "new" / "target.txt"
    assert np.loadtxt(spectrum) == pytest.approx(data[regions["known objects"].mask].mean(axis=0))
    spectrum.write_text("0")  # a draft that is refused, as one stands there, writes nothing beside it
    assert (cli.run(["init", f"--cube={tmp_path}/s.h5", f"-o{tmp_path}/new"]), spectrum.read_text()) == (2, "0")


def test_bands_that_hold_nothing_or_one_number_do_not_count(tmp_path, scene):
    data = scene[0].astype(float)
    data[:, :, 2], data[:, :, 5], data[0, 0, 6] = np.nan, 7.0, np.inf
    cube = open_cube(written(tmp_path / "scene.mat", data), quantity="counts", axis="numbers")
    assert (cube.axis.centre_nm.tolist(), np.flatnonzero(~cube.axis.good).tolist()) == ([1, 2, 4, 5, 6, 7, 8], [4])
    assert any("1 bands hold one number in all pixels seen, 1 none (the first: 3, 6)" in note for note in cube.notes)
    one = np.where(np.indices(scene[1].shape)[0] < 10, scene[1], 0).astype(bool)
    nan, nm = tmp_path / "nan.mat", np.linspace(450.0, 900.0, BANDS)
    assert is_met(written(nan, data / 2e3, gt=one, valid=1 - one, wavelengths=nm), tmp_path / "new")  # of one object
    assert is_met(nan, tmp_path / "known", "--quantity", "reflectance")  # whose wavelengths are known
    assert "by the words" not in (tmp_path / "new" / "campaign.yaml").read_text()  # nothing says counts
    most = ["init", "--cube", str(written(tmp_path / "most.mat", data, map=1 - one)), "-o", str(tmp_path / "most")]
    options = "radiance", "reflectance --scale 1", "counts"  # the second is no reflectance
    assert [cli.run([*most, "--quantity", *each.split()]) for each in options] == [2, 3, 0]
    assert "the map marks 99% of the image" in (tmp_path / "most" / "campaign.yaml").read_text()


def test_without_a_map_anomalies_are_looked_for(tmp_path, scene):
    cube, folder = written(tmp_path / "scene.npy", np.random.default_rng(1).random((40, 60, 400))), tmp_path / "new"
    assert cli.run(["init", f"--cube={cube}", f"-o{folder}", f"--spectra={tmp_path}", "--time=2020-01-01"]) == 0
    assert "not used for this counts image: --time" in (folder / "campaign.yaml").read_text()
    assert "detectors: [rx]" in (folder / "campaign.yaml").read_text().split(f"not used: {tmp_path.name};")[1]
    assert cli.run(["observe", str(folder / "campaign.yaml"), "-o", str(folder / "out")]) == 0
    assert "(red, green, blue: bands 301, 201, 101)" in (folder / "out" / "report.html").read_text()  # no wavelengths


@pytest.mark.data
@pytest.mark.parametrize("name", ["abu-airport-1", "sandiego", "hydice"])
def test_the_public_scenes_go_from_their_file_to_a_report(data_dir, tmp_path, name):
    assert is_met(data_dir(f"scenes/{name}.mat"), tmp_path / name)

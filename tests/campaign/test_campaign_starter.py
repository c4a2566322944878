"""The first draft of a campaign is one that a dry run calls ready; what no file states is marked as a guess."""

import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import yaml
from affine import Affine
from jsonschema import Draft202012Validator
from rasterio.crs import CRS
from spectral.io.envi import SpectralLibrary

from hyperval import cli
from hyperval.campaign import WRONG, dry_run, load_job, summary
from hyperval.config import FILL_IN, SCHEMA_LINE
from hyperval.imagery import write_cube
from hyperval.sensor import load_sensor
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class
from small_campaign import data_of

UNIT = "uW cm-2 sr-1 nm-1"


@pytest.fixture
def sources(small) -> list[str]:
    """Arguments that name the small collection, with spectra of its fields and planks."""
    (spectra := small.folder / "spectra").mkdir()
    axis = load_sensor(str(small.folder / "sensor.yaml")).axis
    means = np.array([builtin_class(material, axis).mean for material in ("grass", "yellow-paint-plank")])
    head = {"wavelength": axis.centre_nm, "spectra names": ["Field grass", "Yellow_Paint_Plank"]}
    for name in ("field", "same"):  # two files each
        SpectralLibrary(means, head | {"wavelength units": "nm"}).save(str(spectra / name))
    files = small.collection
    return [
        "init", "--cube", str(files / "small_rad.hdr"), "--regions", str(files / "regions.geojson"),
        "--targets", str(files / "targets.csv"), "--spectra", str(files / "panel_spectra.csv"),
        "--spectra", str(spectra),
    ]  # fmt: skip


def test_a_radiance_collection_becomes_a_campaign_that_a_dry_run_calls_ready(small, sources, capsys):
    folder = small.folder / "new one"
    flight = ["--time", "2012-07-18T16:00:00Z", "--altitude-km", "1", "--sensor", str(small.folder / "sensor.yaml")]
    assert cli.run([*sources, "--unit", UNIT, *flight, "-o", str(folder)]) == 0
    assert cli.run([*sources, "--quantity", "counts", "-o", str(small.folder / "raw")]) == 0
    files = [folder / "campaign.yaml", small.folder / "raw" / "campaign.yaml"]
    assert summary(dry_run(files)) == ["new-one: ready", "raw: ready"]
    campaign, raw = (load_job(file).campaign for file in files)
    assert campaign.detection.targets[0].material == "yellow-paint-plank"
    scene = campaign.scenarios[0].scene
    assert [(c.name, c.spectrum.measured) for c in scene.classes] == [("field", None), ("court", "court")]
    assert scene.targets[0].host == "court"
    text = files[0].read_text()
    schema = json.loads((folder / text.partition("\n")[0].removeprefix(SCHEMA_LINE)).read_text())
    assert list(Draft202012Validator(schema).iter_errors(yaml.safe_load(text))) == []
    told = [a.removeprefix("guess: ") for a in campaign.assumptions]
    assert "collection.regions: ../collection/regions.geojson: pixel coordinates" in told  # fail as longitudes first
    assert len(told) == len(re.findall(r"^ *# guess: ", text, re.MULTILINE)) >= 8
    assert all(f"guess: {line}" in capsys.readouterr().err for line in told[:1])
    radiance = next(g for g in campaign.comparisons if g.product == "radiance")  # of none that its own pixels gave
    lines = [p.region for c in (campaign, raw) for p in c.collection.empirical_line.panels]
    assert [*radiance.subjects, *lines] == ["field", *["white-panel", "black-panel", "grey-panel-35"] * 3]


def test_what_cannot_be_guessed_is_left_to_be_filled_in(small, sources, capsys):
    (header := small.collection / "small_rad.hdr").write_text(header.read_text() + "acquisition time = 2012-07-18\n")
    assert cli.run([*sources, "--unit", UNIT, "-o", str(folder := small.folder / "draft")]) == 0
    assert any(re.search("to fill in.*these 16 bands.*--sensor", str(i)) for i in dry_run([folder / "campaign.yaml"]))
    folder = small.folder / "second"
    assert cli.run([*sources, "--unit", UNIT, "--sensor", str(small.folder / "sensor.yaml"), "-o", str(folder)]) == 0
    state = yaml.safe_load((folder / "campaign.yaml").read_text())["scenarios"][0]["atmosphere"]
    assert [k for k, v in state.items() if str(v).startswith(FILL_IN)] == ["sensor_altitude_km", "time_utc"]
    assert state["latitude_deg"] == pytest.approx(42.9, abs=0.1)
    assert re.search(r"to fill in: .*time_utc: .*\(--time\)\n.*2 values to fill in", capsys.readouterr().err)
    assert [cli.run([v, f"{folder}/campaign.yaml", "-o", f"{folder}/{v}"]) for v in ("validate", "observe")] == [2, 0]


W = np.arange(450.0, 900.0, 10.0)


def written(path: Path, stored: np.ndarray, *entries: str, bands: np.ndarray | None = W) -> Path:
    """An ENVI image of stored numbers on a map, with further entries in its header."""
    axis = None if bands is None else SpectralAxis(bands, np.full(bands.size, 10.0))
    place = {"transform": Affine(1, 0, 275400, 0, -1, 4753700), "crs": CRS.from_epsg(32618)}
    write_cube(path, stored, data_type=1 if bands is None else 2, axis=axis, **place)
    header = path.with_suffix(".hdr")
    own = ("data gain values", *(entry.partition(" =")[0] for entry in entries))
    kept = [row for row in header.read_text().splitlines() if not row.startswith(own)]
    header.write_text("\n".join([*kept, *entries]) + "\n")
    return path


@pytest.fixture
def delivery(tmp_path):
    """A radiance line as others write it: lawn, court, flat panels, felts of two sizes where no class is drawn."""
    rng, w = np.random.default_rng(5), W
    lawn, court, felt = 0.05 + 0.4 * (w > 700.0), 0.1 + 0.0002 * (w - 450.0), np.where(w < 600.0, 0.1, 0.6)
    image = np.where(np.arange(40)[None, :, None] < 20, lawn, court) * rng.normal(1.0, 0.05, (40, 40, 1))
    names = {"court": np.s_[10:30, 30:38], "lawn": np.s_[34:39, 2:8], "black": np.s_[0:2, 22:24]}
    names |= {"whiteref": np.s_[0:5, 32:38], "single pixel": np.s_[37:38, 15:16]}
    image[names["black"]], image[names["whiteref"]] = 0.04, 0.6
    felts = [(8, 5, 1.0), (14, 10, 0.5), (20, 5, 1.0), (26, 10, 0.5)]
    for line, sample, side in felts:
        image[line, sample] += side**2 * (felt - image[line, sample])
    stored = np.round(1000.0 * (image * 10.0 + 1.0 + rng.normal(0.0, 0.02, image.shape)))
    written(tmp_path / "line.img", stored, "reflectance scale factor = 1000 ; as rho", "data units = microW/cm^2/nm/sr")
    classes = np.zeros((40, 40, 1), np.uint8)
    for number, part in enumerate(names.values(), 1):
        classes[part] = number
    kinds = "file type = ENVI Classification", "classes = 6", f"class names = {{none, {', '.join(names)}}}"
    written(tmp_path / "map.img", classes, *kinds, bands=None)
    table = np.column_stack([w, lawn, court, felt, 0.04 + 0 * w, 0.6 + 0 * w])
    np.savetxt(tmp_path / "field.csv", table, delimiter=",", header="nm,lawn,court,felt,black,whiteref", comments="")
    (tmp_path / "asd").mkdir()
    for i, (name, k) in product((1, 2), {"Felt.0000": 3, "lawn_000": 1, "black0": 4, "WR0": 5, "whiteref0": 5}.items()):
        np.savetxt(tmp_path / "asd" / f"{name}{i}.txt", table[:, [0, k]] * [1.0, 0.8 + 0.1 * i], header="nm refl")
    rows = "".join(f"felt,{line + 0.5},{sample + 0.5},{side:g}\n" for line, sample, side in felts)
    (tmp_path / "felts.csv").write_text("material,line,sample,side_m\n" + rows, "utf-16")  # as spreadsheets save it
    return [
        "init", "--cube", str(tmp_path / "line.img"), "--regions", str(tmp_path / "map.img"),
        "--targets", str(tmp_path / "felts.csv"), "--sensor", "aviris-ng", "--time", "2012-07-18T16:00:00Z",
        "--altitude-km", "1", "-o", str(tmp_path / "new"), "--spectra",
    ]  # fmt: skip


def test_a_delivered_radiance_line_becomes_a_campaign_without_a_question(delivery, tmp_path):
    assert cli.run([*delivery, str(tmp_path / "field.csv")]) == 0
    assert summary(dry_run([tmp_path / "new" / "campaign.yaml"])) == ["new: ready"]
    campaign = load_job(tmp_path / "new" / "campaign.yaml").campaign
    cube, line, scene = campaign.collection.cube, campaign.collection.empirical_line, campaign.scenarios[0].scene
    assert (cube.quantity, cube.unit, cube.scale) == ("radiance", "microW/cm^2/nm/sr", 0.001)
    # Panels by their flat spectra, as no name says it; four pixels of black tell no SNR.
    assert [[p.region for p in line.panels], campaign.collection.snr_regions] == [["black", "whiteref"], ["whiteref"]]
    # A single pixel has no spread; no class is drawn around the felts: what is seen there is like the lawn.
    assert ([c.name for c in scene.classes], scene.targets[0].host) == (["court", "lawn"], "lawn")
    subjects = {s.name: s.fill.geometry.side_m for s in scene.targets[0].subjects}
    assert subjects == {"felt 1 m": 1.0, "felt 0.5 m": 0.5}
    assert next(g for g in campaign.comparisons if g.product == "roc").subjects == tuple(subjects)
    # What tests a budget that is guessed does not decide.
    decides = {(g.product, g.metric): g.gate for g in campaign.comparisons if g.product in ("radiance", "reflectance")}
    tests = {("radiance", "p_value_shape"): False, ("reflectance", "p_value_full"): False}
    assert decides == tests | {(of, "median_difference_ratio_windows"): True for of, _ in tests}

    # Readings that the instrument numbered are the replicates of a spectrum; those of its reference are of nothing.
    asked = [*delivery, str(tmp_path / "asd"), "-o", str(tmp_path / "many")]
    classes = ["init", "--cube", str(tmp_path / "map.img"), "-o", str(tmp_path / "none")]  # which are no image
    assert [cli.run(each) for each in ([*asked, *classes[1:3]], asked, classes)] == [2, 0, 2]
    assert summary(dry_run([tmp_path / "many" / "campaign.yaml"])) == ["many: ready"]
    many = load_job(tmp_path / "many" / "campaign.yaml").campaign
    sought = [*many.detection.targets, *many.collection.empirical_line.panels]
    files = [Path(file).name for one in sought for file in one.spectrum.replicates.files]
    assert files == [f"{name}{i}.txt" for name in ("Felt.0000", "black0", "whiteref0") for i in (1, 2)]
    assert re.search("a third: felt.#, black#, lawn_#, whiteref#.*not used: WR01.txt, WR02.txt;", str(many.assumptions))

    (felts := tmp_path / "felts.csv").write_text(felts.read_text("utf-16").replace(",0.5\n", ",1\n"))  # of one size
    assert cli.run([*delivery, str(tmp_path / "field.csv"), "-o", str(tmp_path / "one")]) == 0
    scene = load_job(tmp_path / "one" / "campaign.yaml").campaign.scenarios[0].scene
    assert scene.targets[0].fill.geometry.side_m == 1.0


def test_without_two_panels_there_is_no_detection_in_radiance(delivery, tmp_path):
    table = np.loadtxt(tmp_path / "field.csv", delimiter=",", skiprows=1)[:, :4]
    np.savetxt(tmp_path / "few.csv", table, delimiter=",", header="wavelength_nm,lawn,court,felt", comments="")
    assert cli.run([*delivery, str(tmp_path / "few.csv")]) == 0
    path = tmp_path / "new" / "campaign.yaml"
    assert any("no detection: in radiance it needs an empirical line" in a for a in load_job(path).campaign.assumptions)
    assert summary(dry_run([path])) == ["new: ready"]
    # Written by hand all the same, the dry run says so before the collection is read; and that spectra end too early.
    content = yaml.safe_load(path.read_text())
    target = {"name": "felt", "material": "felt", "spectrum": {"file": "../few.csv", "record": "felt"}}
    content["detection"] = {"group": "{target} {side_m} m", "detectors": ["cem"], "targets": [target]}
    path.write_text(yaml.safe_dump(content))
    for bands, words in ((45, "detection on radiance needs an empirical line"), (20, "'court' does not cover")):
        np.savetxt(tmp_path / "few.csv", table[:bands], delimiter=",", header="nm,lawn,court,felt", comments="")
        assert any(words in str(i) for i in dry_run([path]) if i.state == WRONG)


def test_a_cube_alone_becomes_a_draft_without_a_prediction(small, capsys, tmp_path):
    cube = tmp_path / "small_rad.hdr"  # one that states no unit
    (tmp_path / "small_rad.img").symlink_to(small.collection / "small_rad.img")
    cube.write_text(re.sub(r"(?m)^data units.*\n", "", (small.collection / cube.name).read_text()))
    draft, folder = small.folder / "draft", small.folder / "alone"
    assert cli.run(["init", "--cube", str(cube), "-o", str(draft)]) == 0
    (asked,) = (i for i in dry_run([draft / "campaign.yaml"]) if i.is_blocking)
    assert (asked.state, re.search("--[a-z]+", asked.detail)[0]) == ("to fill in", "--unit")
    assert "then also needed: --spectra, --time, --altitude-km, --sensor" in capsys.readouterr().err  # all at once
    told = ["init", "--cube", str(cube), "-o", str(folder), "--unit"]
    assert [cli.run([*told, unit]) for unit in ("W/m2-sr-um", UNIT, UNIT)] == [2, 0, 2]  # what is there is not replaced
    for wrong in (["--time", "yesterday"], ["--sensor", "no"], ["--altitude-km", "-1"]):
        assert cli.run([*told, UNIT, *wrong, "-o", str(small.folder / "no")]) == 2
    assert "--spectra" in (folder / "campaign.yaml").read_text()
    assert "already exists" in capsys.readouterr().err
    assert cli.run([*told, "W m-2 sr-1 nm-1", "-o", str(draft / "b"), "--name", "../B 2"]) == 0  # no such values
    assert "(--scale)" in capsys.readouterr().err
    assert "\nname: b-2\n" in (draft / "b" / "campaign.yaml").read_text()  # one that a campaign may have
    np.save(tmp_path / "c.npy", np.ones((4, 4, 3)))  # regions of a bare image are not read yet, and must be there
    assert cli.run(["init", "--cube", str(tmp_path / "c.npy"), "-o", str(draft / "c"), "--regions", "none.xml"]) == 3


@pytest.mark.parametrize(("region", "records", "matched"), data_of("names_of_spectra"))
def test_spectra_go_with_names_only_where_one_alone_fits(tmp_path, region, records, matched):
    cube = written(tmp_path / "line_refl.img", np.random.default_rng(3).normal(600.0, 40.0, (20, 20, W.size)).round())
    (header := cube.with_suffix(".hdr")).write_text(header.read_text().replace("450.0, 460.0", "460.0, 450.0"))
    shape = {"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9], [0, 9], [0, 0]]]}
    features = [{"type": "Feature", "properties": {"name": region}, "geometry": shape}]
    (tmp_path / "regions.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    table = np.column_stack([W, *(0.2 + 0.0002 * W * (1 + i) for i in range(len(records)))])
    head = ",".join(["wavelength_nm", *(f'"{name}"' for name in records)])
    np.savetxt(tmp_path / "field.csv", table, delimiter=",", header=head, comments="")
    assert cli.run(["init", "--cube", str(cube), "--regions", str(tmp_path / "regions.geojson"), "--spectra",
                    str(tmp_path / "field.csv"), "-o", str(tmp_path / "new")]) == 0  # fmt: skip
    content = yaml.safe_load((tmp_path / "new" / "campaign.yaml").read_text())
    assert re.search(rf"True, 'scale': '?{'0.001' if matched else FILL_IN}", str(content["collection"]["cube"]))
    classes = [s["spectrum"] for one in content.get("scenarios", []) for s in one["scene"]["classes"]]
    # Nothing is predicted, or compared, without one.
    assert [c.get("record") or c["replicates"]["records"] for c in classes] == [matched][: matched is not None]

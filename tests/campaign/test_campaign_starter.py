"""The first draft of a campaign is one that a dry run calls ready; what no file states is marked as a guess."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperval import cli
from hyperval.campaign.dry_run import WRONG, dry_run, summary
from hyperval.campaign.schema import load_campaign
from hyperval.campaign.starter_scene import Spectrum, matching_spectrum
from hyperval.config import FILL_IN
from hyperval.scene.builtin import builtin_class
from hyperval.sensor.specification import load_sensor

UNIT = "uW cm-2 sr-1 nm-1"


@pytest.fixture
def sources(small) -> list[str]:
    """Arguments that name the small collection, with spectra of its fields and planks."""
    spectra = small.folder / "spectra"
    spectra.mkdir()
    axis = load_sensor(str(small.folder / "sensor.yaml")).axis
    for name, material in (("Field grass", "grass"), ("Yellow_Paint_Plank", "yellow-paint-plank")):
        table = np.column_stack([axis.centre_nm, builtin_class(material, axis).mean])
        np.savetxt(spectra / f"{name}.txt", table, header="wavelength_nm reflectance", comments="")
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
    items = dry_run([folder / "campaign.yaml"])
    assert [i for i in items if i.state == WRONG] == []
    assert summary(items) == ["new-one: ready"]
    campaign = load_campaign(folder / "campaign.yaml")
    line = campaign.collection.empirical_line
    assert line is not None
    assert [p.region for p in line.panels] == ["white-panel", "black-panel", "grey-panel-35"]
    assert campaign.detection is not None
    assert campaign.detection.targets[0].material == "yellow-paint-plank"
    scene = campaign.scenarios[0].scene
    assert [(c.name, c.spectrum.measured) for c in scene.classes] == [("field", None), ("court", "court")]
    assert scene.targets[0].host == "court"
    # Pixel coordinates fail as longitudes first; every guess is an assumption of the report and stands in the file.
    text = (folder / "campaign.yaml").read_text()
    told = [a.removeprefix("guess: ") for a in campaign.assumptions]
    assert "collection.regions: ../collection/regions.geojson: pixel coordinates" in told
    assert len(told) == len(re.findall(r"^ *# guess: ", text, re.MULTILINE)) >= 8
    said = capsys.readouterr().err
    assert all(f"guess: {line}" in said for line in told)
    # No comparison of a surface whose own pixels gave its statistics.
    radiance = next(g for g in campaign.comparisons if g.product == "radiance")
    assert radiance.subjects == ("field", "white-panel", "black-panel", "grey-panel-35")


def test_what_cannot_be_guessed_is_left_to_be_filled_in(small, sources, capsys):
    folder = small.folder / "draft"
    assert (
        cli.run([*sources, "--unit", UNIT, "--sensor", str(small.folder / "sensor.yaml"), "-o", str(folder)]) == 0
    )
    state = yaml.safe_load((folder / "campaign.yaml").read_text())["scenarios"][0]["atmosphere"]
    assert [k for k, v in state.items() if str(v).startswith(FILL_IN)] == ["sensor_altitude_km", "time_utc"]
    assert state["latitude_deg"] == pytest.approx(42.9, abs=0.1)
    assert "2 values to fill in" in capsys.readouterr().err
    assert cli.run(["validate", str(folder / "campaign.yaml"), "-o", str(folder / "out")]) == 2


def test_a_reflectance_image_with_scaled_integers_gets_its_scale(tmp_path, write_reflectance):
    cube = write_reflectance(tmp_path / "line_refl.img")
    assert cli.run(["init", "--cube", str(cube), "--spectra", str(tmp_path / "spectra"),
                    "--targets", str(tmp_path / "felt.csv"), "-o", str(tmp_path / "felt")]) == 0  # fmt: skip
    campaign = load_campaign(tmp_path / "felt" / "campaign.yaml")
    assert campaign.collection.cube is not None
    assert campaign.collection.cube.scale == 0.0001
    assert summary(dry_run([tmp_path / "felt" / "campaign.yaml"])) == ["felt: ready"]


@pytest.fixture
def write_reflectance():
    """Writes 20 x 20 pixels of reflectance times 10000, a felt spectrum and a list of one target."""

    def write(path: Path) -> Path:
        rng = np.random.default_rng(3)
        wavelengths = np.arange(450.0, 900.0, 10.0)
        stored = rng.normal(3000.0, 200.0, (20, wavelengths.size, 20)).astype("<i2")
        path.write_bytes(stored.tobytes())
        path.with_suffix(".hdr").write_text(
            "ENVI\nsamples = 20\nlines = 20\nbands = 45\nheader offset = 0\ndata type = 2\ninterleave = bil\n"
            "byte order = 0\nwavelength units = nm\n"
            "map info = {UTM, 1, 1, 275400, 4753700, 1, 1, 18, North, WGS-84}\n"
            f"wavelength = {{{', '.join(map(str, wavelengths))}}}\n"
        )
        (path.parent / "spectra").mkdir()
        rows = "\n".join(f"{w} 0.5" for w in wavelengths)
        (path.parent / "spectra" / "felt.txt").write_text(f"wavelength_nm reflectance\n{rows}\n")
        (path.parent / "felt.csv").write_text("material,line,sample,side_m\nfelt,10.5,10.5,2\n")
        return path

    return write


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ([], "the files do not say the unit of the radiance"),
        (["--unit", UNIT], "no sensor of the library has the 16 bands of the image"),
    ],
)
def test_what_no_file_says_is_asked_for(small, sources, missing, said, capsys):
    folder = small.folder / "none"
    assert cli.run([*sources, *missing, "-o", str(folder)]) in (2, 3)
    assert said in capsys.readouterr().err
    assert not (folder / "campaign.yaml").exists()


def test_a_campaign_that_is_there_is_not_replaced(small, sources, capsys):
    small.write()
    before = (small.folder / "campaign.yaml").read_bytes()
    assert cli.run([*sources, "--unit", UNIT, "-o", str(small.folder)]) == 2
    assert (small.folder / "campaign.yaml").read_bytes() == before
    assert "is there already" in capsys.readouterr().err


def test_spectra_go_with_names_only_where_one_alone_fits():
    def named(*names: str) -> list[Spectrum]:
        return [Spectrum(name, Path("lib.sli"), name, None, False) for name in names]

    assert matching_spectrum("blueFabric", named("Mean of Blue Fabric, 4 readings", "Red Fabric")).name.startswith(
        "Mean"
    )
    assert matching_spectrum("blue fabric 2", named("Blue Fabric", "Red Fabric")).name == "Blue Fabric"
    assert matching_spectrum("fabric", named("Blue Fabric", "Red Fabric")) is None
    assert matching_spectrum("panel", named("panel", "panel white")).name == "panel"
    assert matching_spectrum("road", named("...")) is None

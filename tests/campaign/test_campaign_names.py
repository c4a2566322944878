"""A dry run finds every name that does not fit, with its file and line, before anything is computed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hyperval import cli
from hyperval.campaign.dry_run import WRONG, dry_run, summary
from hyperval.config import load_yaml
from hyperval.metrics import foreign


def mistakes(path):
    return [(i.what, i.detail) for i in dry_run([path]) if i.state == WRONG]


def test_a_campaign_whose_names_all_fit_is_ready(small):
    path = small.write()
    assert mistakes(path) == []
    assert summary(dry_run([path])) == ["small: ready"]


def region(small):
    small.data["collection"]["leave_out"][1] = "black-panle"


def snr_region(small):
    small.data["collection"]["snr_regions"] = ["panel"]


def panel(small):
    small.data["collection"]["empirical_line"]["panels"][2]["region"] = "grey"


def record(small):
    small.data["collection"]["empirical_line"]["panels"][0]["spectrum"]["record"] = "pink"


def background(small):
    small.data["detection"]["background"] = ["scene", "feld"]


def material(small):
    small.data["detection"]["targets"][0]["material"] = "blue-paint"


def spectrum(small):
    small.data["detection"]["targets"][0]["spectrum"] = {"builtin": "yellow"}


def group(small):
    small.data["detection"]["group"] = "{size}"


def pool(small):
    small.data["detection"]["pools"] = [{"name": "all", "subjects": ["small-planks", "huge-planks"]}]


def area_target(small):
    small.data["detection"]["areas"][0]["target"] = "green"


def sensor(small):
    small.scenario["sensor"] = "hymapp"


def surface(small):
    small.scenario["scene"]["classes"][1]["spectrum"] = {"builtin": "asphallt"}


def measured(small):
    small.scenario["scene"]["classes"][1]["covariance"] = {"measured": "cort"}


def compared(small):
    small.gate("radiance")["subjects"][0] = "meadow"


def metric(small):
    small.data["comparisons"][0]["metric"] = "median_abs_difference_ratio_window"


def product(small):
    small.data["comparisons"][0]["metric"] = "pd_difference@1e-2"


def target_outside(small):
    small.edit("targets.csv", lambda text: text.replace("39.5,3.5", "39.5,9000.5", 1))


def region_outside(small):
    small.data["collection"]["regions"].append({"name": "far", "rectangle": [500, 0, 4, 4]})


def pixel_size(small):
    import re

    header = small.collection / "small_rad.hdr"
    header.write_text(re.sub(r"(?m)^(map info|coordinate system string) = .*\n", "", header.read_text()))


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        (region, "collection.leave_out.1", "no region 'black-panle'"),
        (snr_region, "collection.snr_regions.0", "no region 'panel'"),
        (panel, "collection.empirical_line.panels.2.region", "no region 'grey'"),
        (record, "collection.empirical_line.panels.0.spectrum", "pink"),
        (background, "detection.background.1", "no region 'feld'"),
        (material, "detection.targets.0.material", "no object of material 'blue-paint'"),
        (spectrum, "detection.targets.0.spectrum", "'yellow'"),
        (group, "detection.targets.0.material", "no 'size'"),
        (pool, "detection.pools.0.subjects.1", "no subject 'huge-planks'"),
        (area_target, "detection.areas.0.target", "no detection target 'green'"),
        (sensor, "scenarios.0.sensor", "unknown sensor 'hymapp'"),
        (surface, "scenarios.0.scene.classes.1.spectrum", "asphallt"),
        (measured, "scenarios.0.scene.classes.1.covariance.measured", "no region 'cort'"),
        (compared, "comparisons.0.subjects.0", "no 'meadow'"),
        (metric, "comparisons.0.metric", "no part of the spectrum is 'window'"),
        (product, "comparisons.0.metric", "'pd_difference' is a metric of scores or roc, not of radiance"),
        (target_outside, "collection.targets", "targets.csv"),
        (region_outside, "collection.regions.1", "not in the image"),
        (pixel_size, "detection.areas", "ground area of a pixel"),
    ],
)
def test_a_name_that_does_not_fit_is_told_with_its_line(small, change, key, words):
    change(small)
    path = small.write()
    found = mistakes(path)
    ((where, what),) = [m for m in found if m[0].split(": ")[1] == key]
    assert words in what
    file, line = where.split(": ")[0].rsplit(":", 1)
    assert file == str(path)
    text = path.read_text().splitlines()[int(line) - 1]
    named = [part for part in key.split(".") if not part.isdigit()]
    assert f"{named[-1]}:" in text or text.lstrip().startswith("- ")


def test_the_exit_code_is_that_of_an_invalid_campaign(small, capsys):
    region(small)
    assert cli.run(["validate", "--dry-run", str(small.write())]) == 2
    assert "small: 1 names that do not fit" in capsys.readouterr().err


def test_names_of_a_simulated_collection_are_those_of_its_scene(tmp_path):
    import re
    from pathlib import Path

    page = Path(__file__).parents[2] / "docs" / "first-campaign.md"
    for name, text in re.findall(r"<!-- file: (\S+) -->\n```yaml\n(.*?)```", page.read_text(), re.DOTALL):
        (tmp_path / name).write_text(text)
    path = tmp_path / "campaign.yaml"
    text = path.read_text().replace("leave_out: [white-panel", "leave_out: [white-pannel")
    path.write_text(text.replace("record: black-panel", "record: black"))
    (region_name, names), (line, record) = sorted(mistakes(path))
    assert line.endswith("collection.empirical_line.panels.1.spectrum")
    assert "no spectrum 'black'; expected: one of white-panel, black-panel" in record
    assert region_name.endswith("collection.leave_out.0")
    assert "one of white-panel, black-panel, field, court" in names


def test_warnings_of_a_run_stand_on_the_console_and_beside_its_results(small, tmp_path, capsys):
    panels = small.data["collection"]["empirical_line"]["panels"]
    for entry in panels:
        entry["relative_uncertainty"] = 0.01
    panels[2]["spectrum"] = {"constant": 0.6}  # grey, and not as bright as is said
    out = tmp_path / "out"
    cli.run(["observe", str(small.write()), "-o", str(out)])
    said = capsys.readouterr().err
    assert "small: warning: the panels of the empirical line do not lie on one line" in said
    assert any("do not lie on one line" in w for w in json.loads((out / "provenance.json").read_text())["warnings"])


def test_no_shipped_campaign_names_a_metric_that_its_product_lacks():
    campaigns = sorted((Path(__file__).parents[2] / "campaigns").glob("*/campaign*.yaml"))
    assert len(campaigns) >= 5
    named = [(g["product"], g["metric"]) for path in campaigns for g in load_yaml(path)[0]["comparisons"]]
    assert [(metric, foreign(metric, product)) for product, metric in named if foreign(metric, product)] == []

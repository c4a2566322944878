"""Entries of a configuration by dotted path."""

import pytest

from hyperval.errors import UsageError
from hyperval.scenario import load_scenario
from hyperval.settings import setting, with_settings


def test_reads_entries_and_defaults():
    scenario = load_scenario("yellow-planks-asphalt")
    assert setting(scenario, "scene.adjacency.effective_neighbours") == 1000.0
    first = scenario.scene.classes[0]
    assert setting(scenario, f"scene.classes.{first.name}.fraction") == first.fraction
    assert setting(scenario, "scene.classes.0.gain") == first.gain


def test_changes_one_entry_and_keeps_the_rest():
    scenario = load_scenario("yellow-planks-asphalt")
    target = scenario.scene.targets[0].name
    found = with_settings(scenario, {"processing.seed": 7, f"scene.targets.{target}.gain": 2.5})
    assert found.processing.seed == 7
    assert found.scene.targets[0].gain == 2.5
    assert found.folder == scenario.folder
    assert scenario.scene.targets[0].gain != 2.5
    assert with_settings(found, {"processing.seed": 0, f"scene.targets.{target}.gain": 1.0}) == with_settings(
        scenario, {"processing.seed": 0, f"scene.targets.{target}.gain": 1.0}
    )


def test_makes_parts_that_the_file_leaves_out():
    found = with_settings(load_scenario("panels"), {"sensor_changes.calibration_error_percent": 2.0})
    assert found.sensor_changes is not None
    assert found.sensor_changes.calibration_error_percent == 2.0


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("atmosphere.aot", 0.1, "aot"),
        ("scene.classes.gravel.gain", 1.0, "no item 'gravel'"),
        ("scene.classes.99.gain", 1.0, "no item '99'"),
        ("name.first", 1.0, "has no parts"),
        ("a..b", 1.0, "no dotted path"),
        ("scene.[x", 1.0, "bracket"),
        ("processing.seed", -1, "greater than or equal"),
    ],
)
def test_refuses_paths_that_lead_nowhere(path, value, message):
    with pytest.raises(UsageError, match=message.replace("[", r"\[")):
        with_settings(load_scenario("yellow-planks-asphalt"), {path: value})

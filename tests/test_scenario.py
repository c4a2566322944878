"""Scenario files by name and path, and their entries by dotted path; what is refused in one is in tests/model."""

import pytest

from hyperval.errors import InputError, UsageError
from hyperval.scenario import builtin_scenarios, load_scenario
from hyperval.settings import with_settings


@pytest.mark.parametrize("name", builtin_scenarios())
def test_builtin_scenarios_load_by_name(name):
    assert load_scenario(name).name == name


def test_unknown_name_and_missing_file(tmp_path):
    with pytest.raises(UsageError, match="one of green-planks-grass, panels"):
        load_scenario("yellow-planks")
    with pytest.raises(InputError, match="no such file"):
        load_scenario(tmp_path / "none.yaml")


def test_a_campaign_is_told_from_a_scenario(tmp_path):
    path = tmp_path / "campaign.yaml"
    path.write_text("schema: 1\nname: a\ncollection: {}\nscenarios: []\n")
    with pytest.raises(UsageError, match=r"a campaign, not a scenario\n.*hyperval validate .*campaign\.yaml -o DIR"):
        load_scenario(path)


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

"""Files of settings: strict YAML, scenarios by name, paths into them."""

import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperval import config
from hyperval.errors import InputError, UsageError
from hyperval.scenario import load_scenario
from hyperval.settings import with_settings

# Strict YAML: every way in which a plain YAML reader changes or hides what somebody wrote.


class Inner(config.Model):
    altitude_km: float
    bands: tuple[int, ...] = ()


class Outer(config.Model):
    name: str
    inner: Inner
    ratio: float = 1.0


def value_of(text: str) -> object:
    return config.parse_yaml(f"key: {text}")[0]["key"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3), ("5e2", 500.0), ("-1.5E+3", -1500.0), ("2.", 2.0), (".5", 0.5), ("-7", -7), ("true", True),
        ("FALSE", False), ("null", None), ("~", None), ("", None),
    ],
)  # fmt: skip
def test_core_scalars_have_their_type(text, value):
    found = value_of(text)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    "text",
    ["16:30", "0123", "08", "0x1F", "0o17", "no", "yes", "on", "off", "y", "2012-09-20", "1_000", "1e", "NaN", "="],
)
def test_words_that_other_yaml_readers_turn_into_something_else_stay_text(text):
    assert value_of(text) == text


def test_nan_and_infinity_are_read_but_no_model_takes_them():
    assert math.isnan(value_of(".nan"))
    assert value_of("-.inf") == -math.inf
    for text in (".nan", ".inf", "-.inf"):
        data, lines = config.parse_yaml(f"altitude_km: {text}")
        with pytest.raises(UsageError, match="finite"):
            config.validate(Inner, data, lines, "c.yaml")


LEVELS = "\n".join(f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 10)}]" for i in range(1, 10))
SYNTAX = r"^c\.yaml:\d+: "
REFUSED = {
    "a: 1\nb: 2\na: 3\n": r"c\.yaml:3: the key 'a' occurs twice \(first on line 1\)",
    "a: &x 1\nb: *x": "anchors and aliases",
    "a: &x [1]": "anchors and aliases",
    "base: &b {c: 1}\nd:\n  <<: *b": "anchors and aliases",
    "l0: &l0 [a]\n" + LEVELS: "anchors and aliases",
    "a: !!python/object/apply:os.system ['true']": "tag",
    "a: !!str 1": "tag",
    "a: !mine 1": "tag",
    "a: " + "[" * (config.MAX_DEPTH + 1) + "]" * (config.MAX_DEPTH + 1): "deep",
    "a: " + "[" * 400_000 + "]" * 400_000: "deep",
    "a: [" + "0," * 100_001 + "]": "too many entries",
    'a: 1\ntitle: "x\\ud800"\n': r"c\.yaml:2: .*invalid Unicode character escape",  # no report could be written
    'a: 1\ntitle: "x\ud800"\n': r"c\.yaml:2: .*unpaired UTF-16",
    **dict.fromkeys(["a: [1, 2", "a: {b: 1", "a:\n\t- 1", "a: 'x", "? [1]\n: 2", "a: 1\n---\nb: 2"], SYNTAX),
}


@pytest.mark.parametrize("number", range(len(REFUSED)))
def test_what_is_no_plain_yaml_is_refused_with_its_line_before_a_tree_is_built(number, monkeypatch):
    text, words = list(REFUSED.items())[number]
    if words != SYNTAX and "occurs twice" not in words:
        monkeypatch.setattr(yaml, "compose", lambda text, Loader: pytest.fail("a tree was built"))
    with pytest.raises(UsageError, match=words):
        config.parse_yaml(text, "c.yaml")


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_with_a_message(text):
    try:
        data, lines = config.parse_yaml(text, "c.yaml")
    except UsageError as error:
        assert str(error).startswith("c.yaml")  # noqa: PT017 - both ends are asserted
    else:
        assert data is None or lines[()] >= 1


def test_files_that_are_no_text_and_one_of_windows(tmp_path):
    path = tmp_path / "a.yaml"
    for file, words in ((tmp_path, "name a file in it, such as"), (path, "no such file")):
        with pytest.raises(InputError, match=words):
            config.load_yaml(file)
    for content, words in ((bytes(config.MAX_BYTES + 1), "larger than"), ("name: Köln".encode("latin-1"), "UTF-8")):
        path.write_bytes(content)
        with pytest.raises(UsageError, match=words):
            config.load_yaml(path)
    path.write_bytes(b"\xef\xbb\xbfname: x\r\ninner:\r\n  altitude_km: 1.5\r\n")
    assert config.load_model(Outer, path) == Outer(name="x", inner=Inner(altitude_km=1.5))


def test_every_mistake_is_listed_in_the_order_of_the_file():
    data, lines = config.parse_yaml("ratio: .nan\nbogus: 1\ninner:\n  altitud_km: 2\n  bands: [1, two]\n")
    with pytest.raises(UsageError) as caught:
        config.validate(Outer, data, lines, "c.yaml")
    assert caught.value.exit_code == 2
    found = [line.strip() for line in str(caught.value).splitlines()]
    assert [line.split(": ")[0] for line in found] == [f"c.yaml:{n}" for n in (1, 1, 2, 3, 4, 5)]
    assert "c.yaml:4: inner.altitud_km: unknown key; did you mean 'altitude_km'?" in found
    assert sum("name: is missing" in line for line in found) == 1


class Powered(config.Model):
    unit: config.RadianceUnit
    wavelength_unit: config.WavelengthUnit = "nm"


def test_units_are_known_when_the_file_is_read():
    assert config.validate(Powered, {"unit": "W/m^2/sr/um"}, {}, "a.yaml").unit == "W/m^2/sr/um"
    data, lines = config.parse_yaml("unit: W/m2\nwavelength_unit: cm-1\n", "a.yaml")
    with pytest.raises(UsageError) as caught:
        config.validate(Powered, data, lines, "a.yaml")
    assert "a.yaml:1: unit: unknown radiance unit 'W/m2'; one of uW cm-2 sr-1 nm-1" in str(caught.value)
    assert "a.yaml:2: wavelength_unit: unknown wavelength unit 'cm-1'; one of nm" in str(caught.value)


def test_of_many_mistakes_the_first_are_listed():
    data, lines = config.parse_yaml("".join(f"key{i}: 1\n" for i in range(500)))
    with pytest.raises(UsageError, match=r"and 48[0-9] more") as caught:
        config.validate(Inner, data, lines, "c.yaml")
    assert len(str(caught.value).splitlines()) <= 22


# Scenario files by name and path, and their entries by dotted path; what is refused in one is in tests/model.


def test_unknown_name_and_missing_file(tmp_path):
    with pytest.raises(UsageError, match="one of green-planks-grass, panels"):
        load_scenario("yellow-planks")
    with pytest.raises(InputError, match="no such file"):
        load_scenario(tmp_path / "none.yaml")


def test_a_campaign_is_told_from_a_scenario(tmp_path):
    (path := tmp_path / "campaign.yaml").write_text("schema: 1\nname: a\ncollection: {}\nscenarios: []\n")
    with pytest.raises(UsageError, match=r"a campaign, not a scenario\n.*hyperval validate .*campaign\.yaml -o DIR"):
        load_scenario(path)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("atmosphere.aot", 0.1, "aot"),
        ("scene.classes.gravel.gain", 1.0, "no item 'gravel'"),
        ("scene.classes.99.gain", 1.0, "no item '99'"),
        ("name.first", 1.0, "has no parts"),
        ("a..b", 1.0, "not a dotted path"),
        ("scene.[x", 1.0, "bracket"),
        ("processing.seed", -1, "greater than or equal"),
    ],
)
def test_refuses_paths_that_lead_nowhere(path, value, message):
    with pytest.raises(UsageError, match=message.replace("[", r"\[")):
        with_settings(load_scenario("yellow-planks-asphalt"), {path: value})

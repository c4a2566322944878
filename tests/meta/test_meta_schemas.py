"""Published schemas are what the models read; every shipped file names its own and holds to it; mistakes are marked."""

import json
import runpy
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from hyperval import cli
from hyperval.config import FILL_IN, SCHEMA_LINE, load_yaml

ROOT = Path(__file__).parents[2]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "schemas.py"))


def marked(path: Path, kind: str, data: object) -> list[str]:
    """What an editor marks in a file: by the schema that its first line names."""
    named = path.read_text("utf-8").partition("\n")[0].removeprefix(SCHEMA_LINE)
    schema = json.loads((path.parent / named).read_text("utf-8"))
    assert Path(named).name.partition(".")[0] == kind
    return [e.message for e in Draft202012Validator(schema).iter_errors(data) if FILL_IN not in str(e.instance)]


def test_published_schemas_are_as_the_models_have_them(capsys):
    assert SCRIPT["main"]() == 0, capsys.readouterr().out
    assert cli.run(["schema", "sensor"]) == 0
    Draft202012Validator.check_schema(schema := json.loads(capsys.readouterr().out))
    words = schema["$defs"]["RegularBands"]["properties"]["step_nm"]
    assert (words["title"], words["unit"], words["exclusiveMinimum"]) == ("step", "nm", 0)
    assert "(as in src/hyperval/sensor/library/" in words["description"]


@pytest.mark.parametrize(("path", "kind"), SCRIPT["shipped"]().items(), ids=lambda v: getattr(v, "stem", v))
def test_every_shipped_file_holds_to_the_schema_that_its_first_line_names(path, kind):
    assert marked(path, kind, load_yaml(path)[0]) == []


@pytest.mark.parametrize(
    ("file", "key", "value", "words"),
    [
        ("campaigns/hysu-2018/scenario.yaml", "scene.clases", [], "'clases' was unexpected"),
        ("src/hyperval/scenarios/panels.yaml", "processing.seed", -1, "-1 is less than the minimum of 0"),
        ("src/hyperval/scenarios/panels.yaml", "atmosphere.aot550", "0,1", "is not valid under any of the given"),
        ("studies/planks.yaml", "formulation", "better", "'better' is not one of ['corrected', 'thesis']"),
    ],
)
def test_a_mistake_is_marked(file, key, value, words):
    data = load_yaml(ROOT / file)[0]
    group, _, last = key.rpartition(".")
    (data[group] if group else data)[last] = value
    (message,) = marked(ROOT / file, "scenario", data)
    assert words in message


def test_each_key_of_a_file_stands_in_a_file_that_uses_it():
    assert SCRIPT["unused"]() == []

"""What the README and its companions promise is there; examples of docs/regression.md call what there is."""

import re
import runpy
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from hyperval import cli
from hyperval.baseline import Accepted
from hyperval.config import parse_yaml
from hyperval.scenario import Scenario

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "campaigns").rglob("*.md")])
MADE = {"reference/commands.md", "reference/files.md", "reference/metrics.md"}  # by the documentation, from the code
REGRESSION = (ROOT / "docs" / "regression.md").read_text("utf-8")
EXAMPLES: list[Any] = [
    yaml.safe_load(text) for text in re.findall(r"^```yaml\n(.*?)^```", REGRESSION, re.MULTILINE | re.DOTALL)
]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_to_files(page):
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text("utf-8"))
    broken = [link for link in links if "://" not in link and link not in MADE and not (page.parent / link).exists()]
    assert broken == []


def test_readme_names_every_campaign_and_command_and_no_other():
    campaigns = {path.parent.name for path in (ROOT / "campaigns").glob("*/campaign*.yaml")}
    assert set(re.findall(r"^\| `([\w-]+)` \|", README, re.MULTILINE)) == campaigns
    commands = {c.callback.__name__ for c in cli.app.registered_commands if c.callback}
    text = README.partition("## The commands behind")[2].partition("##")[0]
    assert set(re.findall(r"^    hyperval +(\w+)", text, re.MULTILINE)) == commands | {
        str(group.name) for group in cli.app.registered_groups
    }


def test_the_reference_of_files_has_every_model_and_its_keys():
    """It is made when the documentation is built; each model says first what it is."""
    page = runpy.run_path(str(ROOT / "scripts" / "files_page.py"))["page"]()
    assert {*re.findall(r"\[(\w+)\]\(#\w+\)", page)} <= {*re.findall(r"^### (\w+)$", page, re.MULTILINE)}
    section = page.partition("### Scenario\n\nOne scenario.\n")[2].partition("\n### ")[0]
    keys = [info.alias or name for name, info in Scenario.model_fields.items()]
    odd = re.findall(r"; \(as in|\| `` \|", page)  # without words of its own; an empty text as a default
    assert [*re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE), *odd] == keys


TARGETS = ["validate", "check", "power", "scoreboard", "test", "setup", "lint", "types", "lock", "clean", "help"]


def test_make_knows_its_targets():
    done = subprocess.run(["make", "--dry-run", "-C", str(ROOT), *TARGETS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("#!/bin/sh\nexit 1\n", "Python 3.11 or newer is needed"),
        ('#!/bin/sh\ncase "$2" in *ensurepip*) exit 1;; esac\nexit 0\n', "python3-venv"),
        (None, "there is no 'no-such-python' on the PATH"),
    ],
    ids=["too-old", "no-venv", "none"],
)
def test_setup_says_what_is_lacking(tmp_path, script, message):
    python = tmp_path / "python-stand-in"
    python.write_text(script or "")
    python.chmod(0o755)
    if shutil.which("uv", path="/usr/bin:/bin") and message == "python3-venv":
        pytest.skip("uv needs no venv module")
    places = {"PYTHON": str(python) if script else "no-such-python", "VENV": str(tmp_path / "venv")}
    done = subprocess.run(
        ["/bin/sh", str(ROOT / "scripts" / "setup.sh")],
        env={"PATH": "/usr/bin:/bin", **places}, cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert message in done.stderr
    assert script is None or "to fix it:" in done.stderr
    assert not (tmp_path / "venv").exists()


def texts(node: Any) -> list[str]:
    """Every text of an example."""
    if isinstance(node, str):
        return [node]
    inner = node.values() if isinstance(node, dict) else node if isinstance(node, list) else []
    return [text for value in inner for text in texts(value)]


def test_the_examples_for_both_services_check_and_write_junit():
    actions, gitlab = EXAMPLES
    steps = actions["jobs"]["check"]["steps"]
    assert all("uses" in step or "run" in step for step in steps)
    assert any(step.get("uses", "").startswith("actions/cache@") for step in steps)
    assert gitlab["hyperval-check"]["artifacts"]["reports"]["junit"] == "check.xml"
    for example, settings in (
        (actions, actions["jobs"]["check"]["env"]),
        (gitlab, gitlab["hyperval-check"]["variables"]),
    ):
        assert {"HYPERVAL_DATA", "HYPERVAL_CACHE"} <= set(settings)
        lines = [line.strip() for text in texts(example) for line in text.splitlines()]
        (command,) = [shlex.split(line)[1:] for line in lines if line.startswith("hyperval ")]
        assert command[0] == "check"
        assert command[command.index("--junit") + 1] == "check.xml"


def test_the_line_of_a_baseline_is_one():
    line = re.search(r'^    (".*\})$', REGRESSION, re.MULTILINE)[1]
    ((key, entry),) = parse_yaml(line)[0].items()
    assert key.startswith("radiance | ")
    assert Accepted.model_validate(entry).width == 0.002

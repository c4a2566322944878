"""What the README and its companions promise is there."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from hyperval import cli

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "campaigns").rglob("*.md")])
MADE = {"reference/files.md", "reference/metrics.md"}  # by the documentation, from the code


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_to_files(page):
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text("utf-8"))
    broken = [link for link in links if "://" not in link and link not in MADE and not (page.parent / link).exists()]
    assert broken == []


def test_readme_names_every_campaign_and_no_other():
    named = set(re.findall(r"^\| `([\w-]+)` \|", (ROOT / "README.md").read_text(), re.MULTILINE))
    there = {path.parent.name for path in (ROOT / "campaigns").glob("*/campaign*.yaml")}
    assert named == there


def test_readme_names_every_command_and_no_other():
    text = (ROOT / "README.md").read_text().partition("## The commands behind")[2].partition("##")[0]
    named = set(re.findall(r"^    hyperval +(\w+)", text, re.MULTILINE))
    there = {c.callback.__name__ for c in cli.app.registered_commands if c.callback}
    assert named == there | {str(group.name) for group in cli.app.registered_groups}


@pytest.mark.parametrize(
    "target",
    ["validate", "check", "power", "scoreboard", "test", "setup", "lint", "types", "lock", "clean", "help"],
)
def test_make_knows_the_target(target):
    if not shutil.which("make"):
        pytest.skip("make is not installed")
    done = subprocess.run(["make", "--dry-run", "-C", str(ROOT), target], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("#!/bin/sh\nexit 1\n", "Python 3.11 or newer is needed"),
        ('#!/bin/sh\ncase "$2" in *ensurepip*) exit 1;; esac\nexit 0\n', "python3-venv"),
    ],
    ids=["too-old", "no-venv"],
)
def test_setup_says_what_is_lacking(tmp_path, script, message):
    python = tmp_path / "python-stand-in"
    python.write_text(script)
    python.chmod(0o755)
    done = subprocess.run(
        ["/bin/sh", str(ROOT / "scripts" / "setup.sh")],
        env={"PATH": "/usr/bin:/bin", "PYTHON": str(python), "VENV": str(tmp_path / "venv")},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    if shutil.which("uv", path="/usr/bin:/bin") and message == "python3-venv":
        pytest.skip("uv needs no venv module")
    assert done.returncode == 2
    assert message in done.stderr
    assert "to mend it:" in done.stderr
    assert not (tmp_path / "venv").exists()


def test_setup_without_any_python_says_so(tmp_path):
    done = subprocess.run(
        ["/bin/sh", str(ROOT / "scripts" / "setup.sh")],
        env={"PATH": "/usr/bin:/bin", "PYTHON": "no-such-python", "VENV": str(tmp_path / "venv")},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "there is no 'no-such-python' on the PATH" in done.stderr

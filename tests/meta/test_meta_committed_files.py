"""What no committed file may hold: registry hosts, paths of one machine, lock files that hold hosts, big files."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAX_BYTES = 2_000_000

# Written in pieces, so that this file passes its own check.
HOSTS = ("py" + r"pi\.org", "python" + "hosted", "npm" + r"js\.(?:com|org)", r"deb\.debian", r"conda\.anaconda")
REGISTRY_HOST = re.compile("|".join(HOSTS), re.IGNORECASE)
FOLDERS = "|".join(("wo" + "rk", "fa" + "rm", "ho" + "me", "ro" + "ot", "tm" + "p"))
MACHINE_PATH = re.compile(rf"(?<![\w.])/(?:{FOLDERS})/\w")
LOCKS_WITH_HOSTS = {"uv.lock", "package-lock.json", "poetry.lock", "Pipfile.lock"}


def findings(text: str) -> list[str]:
    """The lines of ``text`` that name a registry host or a path of a machine."""
    return [line for line in text.splitlines() if REGISTRY_HOST.search(line) or MACHINE_PATH.search(line)]


@pytest.mark.parametrize(
    "line",
    ["see https://py" + "pi.org/simple", "--index-url https://files.python" + "hosted.org/x", "cd /wo" + "rk/main",
     'open("/ho' + 'me/me/a.img")', "data in /ro" + "ot/data"],
)  # fmt: skip
def test_the_check_sees_what_it_is_for(line):
    assert findings(line) == [line]


@pytest.mark.parametrize("line", ["src/work/main.py", "../elsewhere/data", "a home/office", "the pypi classifier"])
def test_the_check_leaves_the_rest_alone(line):
    assert findings(line) == []


def test_no_registry_host_and_no_machine_path(project_files):
    found = {}
    for path in project_files:
        try:
            text = path.read_text("utf-8")
        except UnicodeDecodeError:
            continue
        if lines := findings(text):
            found[str(path.relative_to(ROOT))] = lines[:3]
    assert found == {}


def test_no_lock_file_that_names_hosts(project_files):
    assert [p.name for p in project_files if p.name in LOCKS_WITH_HOSTS] == []


def test_no_large_file(project_files):
    assert [str(p.relative_to(ROOT)) for p in project_files if p.stat().st_size > MAX_BYTES] == []


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-dev.lock", "requirements-docs.lock"])
def test_locks_pin_every_package_with_a_hash_and_hold_no_address(lock):
    text = (ROOT / lock).read_text()
    assert "://" not in text
    entries = re.split(r"\n(?=\w)", text.strip())
    assert len(entries) > 20
    for entry in entries:
        assert re.match(r"[A-Za-z0-9][\w.-]*==\S+", entry), entry.splitlines()[0]
        assert "--hash=sha256:" in entry, entry.splitlines()[0]


def test_locks_cover_every_dependency_and_agree():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    groups, extras = project["dependency-groups"], project["project"]["optional-dependencies"]
    wanted = {
        "requirements.lock": [*project["project"]["dependencies"], *extras["web"], *groups["build"]],
        "requirements-dev.lock": groups["dev"],
        "requirements-docs.lock": groups["docs"],
    }
    wanted["requirements.lock"] += project["build-system"]["requires"]
    pins: dict[str, str] = {}
    for lock, packages in wanted.items():
        locked = dict(re.findall(r"^([\w.-]+)==(\S+)", (ROOT / lock).read_text(), re.MULTILINE))
        names = {re.split(r"[<>=~!\[ ;]", w)[0].lower().replace("_", "-") for w in packages}
        assert names - set(locked) == set()
        # They go into one environment.
        assert {name: pins[name] for name in pins.keys() & locked} == {n: locked[n] for n in pins.keys() & locked}
        pins |= locked
    assert set(wanted) == {p.name for p in ROOT.glob("requirements*.lock")}

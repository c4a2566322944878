"""What no committed file may hold; what is installed is pinned, with licences that allow its use."""

import json
import re
import subprocess
import sys
import tomllib
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


@pytest.fixture(scope="session")
def project_files() -> list[Path]:
    """Every tracked file of the checkout that still exists."""
    done = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, check=False)
    if done.returncode != 0:
        pytest.skip("not a git checkout")
    return [p for name in done.stdout.decode().split("\0") if name and (p := ROOT / name).is_file()]


def findings(text: str) -> list[str]:
    """The lines of ``text`` that name a registry host or a path of a machine."""
    return [line for line in text.splitlines() if REGISTRY_HOST.search(line) or MACHINE_PATH.search(line)]


@pytest.mark.parametrize(
    ("line", "seen"),
    [
        ("see https://py" + "pi.org/simple", True), ("--index-url https://files.python" + "hosted.org/x", True),
        ("cd /wo" + "rk/main", True), ('open("/ho' + 'me/me/a.img")', True), ("data in /ro" + "ot/data", True),
        ("src/wo" + "rk/main.py", False), ("../elsewhere/data", False), ("a home/office", False),
        ("the pypi classifier", False),
    ],
)  # fmt: skip
def test_the_check_sees_what_it_is_for_and_leaves_the_rest_alone(line, seen):
    assert findings(line) == [line] * seen


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


def test_no_lock_file_that_names_hosts_and_no_large_file(project_files):
    assert [p.name for p in project_files if p.name in LOCKS_WITH_HOSTS or p.stat().st_size > MAX_BYTES] == []


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


# Licences of another kind come with duties for whoever passes the package on, and are looked at first.
ALLOWED = re.compile(
    r"BSD|MIT|ISC|Apache|Python Software Foundation|PSF|Zlib|HPND|CC0|Public Domain|Unlicense"
    r"|Mozilla Public License 2\.0|MPL-2\.0"
)


def printed(*words: str) -> str:
    command = [sys.executable, str(ROOT / "scripts" / "bill_of_materials.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_every_dependency_is_listed_with_a_licence_that_allows_its_use():
    lines = [re.split(r"\s{2,}|\s(?=\d)", line, maxsplit=2) for line in printed().splitlines()]
    listed = {re.sub(r"[-_.]+", "-", name).lower(): licence for name, _, licence in lines}
    direct = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert {re.match(r"[\w-]+", text)[0].lower() for text in direct} <= set(listed)
    locked = {m[1] for m in re.finditer(r"^([a-z0-9-]+)==", (ROOT / "requirements.lock").read_text(), re.MULTILINE)}
    assert set(listed) <= locked
    assert {name: licence for name, licence in listed.items() if not ALLOWED.search(licence)} == {}


def test_the_list_for_other_tools_is_cyclonedx_and_repeats():
    text = printed("--cyclonedx")
    assert text == printed("--cyclonedx")
    document = json.loads(text)
    assert (document["bomFormat"], document["specVersion"]) == ("CycloneDX", "1.6")
    assert len(document["components"]) == len(printed().splitlines())
    assert all(re.fullmatch(r"pkg:pypi/[a-z0-9-]+@\S+", c["purl"]) for c in document["components"])

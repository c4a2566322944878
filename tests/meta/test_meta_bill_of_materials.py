"""The list of what an installation is made of: complete, with licences that allow its use, always the same."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
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

"""Print what an installation is made of: every package that hyperval needs, with version and licence.

python scripts/bill_of_materials.py                a table
python scripts/bill_of_materials.py --cyclonedx    CycloneDX 1.6 in JSON, for tools that look for known weaknesses
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"


def needed() -> list[Distribution]:
    """The distributions that hyperval needs, directly or not, without its extras, in the order of their names."""
    listed: dict[str, Distribution] = {}
    direct = [Requirement(text) for text in tomllib.loads(PROJECT.read_text("utf-8"))["project"]["dependencies"]]
    waiting = [(r.name, frozenset(r.extras)) for r in direct]
    seen: set[tuple[str, frozenset[str]]] = set()
    while waiting:
        item = waiting.pop()
        if item in seen:
            continue
        seen.add(item)
        try:
            package = distribution(item[0])
        except PackageNotFoundError:
            continue  # for another system or Python, by a marker that this one does not meet
        listed[re.sub(r"[-_.]+", "-", package.metadata["Name"]).lower()] = package
        for text in package.requires or ():
            requirement = Requirement(text)
            environments = [{"extra": extra} for extra in item[1] or {""}]
            if requirement.marker is None or any(requirement.marker.evaluate(e) for e in environments):
                waiting.append((requirement.name, frozenset(requirement.extras)))
    return [listed[key] for key in sorted(listed)]


def licence(package: Distribution) -> str:
    """What a distribution says of its licence: an SPDX expression, else its classifiers, else the first line."""
    about = package.metadata
    if about.get("License-Expression"):
        return str(about["License-Expression"])
    kinds = [c.rpartition(" :: ")[2] for c in about.get_all("Classifier", []) if c.startswith("License :: ")]
    text = (about.get("License") or "").strip().splitlines()
    return ", ".join(kinds) or (text[0][:60] if text else "not stated")


def cyclonedx(packages: list[Distribution]) -> str:
    """The same list as CycloneDX; nothing in it depends on when it was made."""
    components = [
        {
            "type": "library", "name": p.metadata["Name"], "version": p.version,
            "purl": f"pkg:pypi/{re.sub(r'[-_.]+', '-', p.metadata['Name']).lower()}@{p.version}",
            "licenses": [{"license": {"name": licence(p)}}],
        }
        for p in packages
    ]  # fmt: skip
    document = {"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1, "components": components}
    return json.dumps(document, indent=1) + "\n"


def main(arguments: list[str]) -> int:
    """Print the list in the form that is wanted."""
    packages = needed()
    if arguments == ["--cyclonedx"]:
        sys.stdout.write(cyclonedx(packages))
    else:
        for p in packages:
            print(f"{p.metadata['Name']:24} {p.version:14} {licence(p)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

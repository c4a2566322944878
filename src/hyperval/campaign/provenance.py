"""What a run was made of: inputs, versions, command, seed, formulation."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

import hyperval
from hyperval.datasets import InputLog
from hyperval.executors import command_line
from hyperval.products import Products
from hyperval.scenario import Scenario


def record_of(
    log: InputLog,
    scenarios: Sequence[Scenario],
    seed: int | None,
    configuration: Mapping[str, Any],
    sides: Sequence[Products] | Mapping[str, Products],
) -> dict[str, Any]:
    """The provenance record of a run: what was read, with which scenarios, seed, configuration and engines.

    It holds nothing that differs between two runs of the same inputs on the same machine: no times, no absolute
    paths, and the command without its output folder.
    """
    models = {k: v.model_dump(mode="json", by_alias=True) for k, v in configuration.items() if isinstance(v, BaseModel)}
    blas = np.show_config(mode="dicts").get("Build Dependencies", {}).get("blas", {})  # that NumPy was built with
    named = sides.items() if isinstance(sides, Mapping) else enumerate(sides)
    return {
        "hyperval": hyperval.__version__,
        "source_revision": source_revision(),
        "command": command_without_output(),
        "configuration": {**configuration, **models},
        "formulation": ", ".join(sorted({s.formulation for s in scenarios})) or "none",
        "seed": seed,
        "inputs": log.entries(),
        "engines": {str(name): dict(side.provenance) for name, side in named},
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "linear_algebra": {k: str(blas.get(k, "unknown")) for k in ("name", "version")},
        "packages": package_versions(),
    }


def command_without_output(arguments: Sequence[str] | None = None) -> list[str]:
    """The command line, with the output folder, the place of files and what only a terminal shows left out.

    Two runs into different folders have the same provenance.
    """
    program, *words = [*(command_line() if arguments is None else arguments)] or [""]
    out, skip = [Path(program).name] if program else [], False
    for word in words:
        path = Path(word)
        of_place = re.match(r"(--output|--data-dir|--junit)(=|$)|-o", word)
        # Left out is what gives the same results.
        if not skip and not of_place and word not in {"--again", "-q", "--quiet", "--debug"}:
            out.append("/".join(path.parts[-2:]) if path.is_absolute() else word)
        skip = not skip and of_place is not None and word in {"-o", "--output", "--data-dir", "--junit"}
    return out


@cache
def package_versions() -> Mapping[str, str]:
    """Name and version of every installed distribution, sorted.

    Read once, and the two lines alone: several hundred files, parsed whole, take half a second.
    """
    texts = (d.read_text("METADATA") or d.read_text("PKG-INFO") or "" for d in importlib.metadata.distributions())
    line = re.compile(r"^(Name|Version): *(.*?)\s*$", re.MULTILINE)
    heads = [dict(line.findall(text.partition("\n\n")[0])) for text in texts]
    return dict(sorted({head["Name"].lower(): head.get("Version", "") for head in heads if "Name" in head}.items()))


def source_revision() -> dict[str, Any] | None:
    """Commit of the source tree and whether it was changed; None for an installed package."""
    root = Path(hyperval.__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    git = partial(subprocess.run, cwd=root, capture_output=True, text=True, timeout=10, check=True)
    try:
        lines = git(["git", "status", "--porcelain=v2", "--branch", "--", "src"]).stdout.splitlines()
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": lines[0].split()[-1], "changed": any(not line.startswith("#") for line in lines)}

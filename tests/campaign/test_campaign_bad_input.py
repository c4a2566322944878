"""Bad input through the command line: one clear error, the contract's exit code, no traceback, no output."""

import os
import re
from pathlib import Path
from typing import Any

import pytest

from hyperval import api, cli
from small_campaign import SmallCampaign, data_of

CASES = data_of("broken_campaigns")


def replaced(small: SmallCampaign, name: str, old: str, new: str) -> None:
    small.edit(name, lambda text: re.sub(old, new, text, flags=re.MULTILINE))


def broken(small: SmallCampaign, case: dict[str, Any]) -> Path:
    """The campaign file, once what a case names was done to it and its collection."""
    if "remove" in case:
        (small.collection / case["remove"]).unlink()
    if "halve" in case:
        path = small.collection / case["halve"]
        os.truncate(path, path.stat().st_size // 2)
    if "replace" in case:
        replaced(small, *case["replace"])
    if "double" in case:
        small.data[case["double"]] *= 2
    for key, value in case.get("set", {}).items():
        *inside, last = key.split(".")
        at = small.data
        for part in inside:
            at = at[part]
        at[last] = at[last] + value if isinstance(at.get(last), list) and inside else value
    return small.write()


@pytest.mark.parametrize("name", CASES)
def test_one_clear_error_and_nothing_written(name, small, tmp_path, capsys):
    case = CASES[name]
    assert cli.run(["validate", str(broken(small, case)), "-o", str(tmp_path / "out")]) == case["code"]
    said = capsys.readouterr()
    for part in case["says"]:
        assert re.search(part, said.err), f"{part!r} is not in:\n{said.err}"
    assert said.out == ""
    assert said.err.startswith("hyperval: ")
    assert said.err.count("hyperval: ") == 1  # one error
    assert not re.search("Traceback|internal error", said.err)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small"]


@pytest.mark.parametrize("stated", ["nm", None])
def test_what_is_stated_or_can_only_be_meant_one_way_mends_a_file(stated, small):
    replaced(small, "small_rad.hdr", r"^wavelength units = .*\n", "")
    small.data["collection"]["cube"]["wavelength_unit"] = stated
    replaced(small, *CASES["panel spectrum in percent"]["replace"])
    for panel in small.data["collection"]["empirical_line"]["panels"]:
        panel["spectrum"]["reflectance_unit"] = "percent"
    assert api.validate(small.write()).results.exit_code() == 0

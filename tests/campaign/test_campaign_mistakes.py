"""Mistakes in campaign files and bad input: one clear error each, with file and line, and nothing written."""

import os
import re
from pathlib import Path
from typing import Any

import pytest

from hyperval import api, cli
from hyperval.campaign import load_job, read_jobs
from hyperval.errors import UsageError
from small_campaign import DATA, SmallCampaign, data_of

# Mistakes in a campaign file: each with its file and line, all at once, and what was probably meant.


ROOT = Path(__file__).parents[2]
GOOD = (DATA / "lawn.yaml").read_text()
SPECTRA = GOOD[GOOD.index("  spectra:") : GOOD.index("scenarios:")]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "campaigns").glob("*/campaign*.yaml")), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_the_campaigns_of_the_project_are_valid(path):
    # A campaign with values to be filled in has tests of its own.
    waiting = "FILL_IN" in path.read_text()
    for campaign in [read_jobs(path)[0].outline] if waiting else [job.campaign for job in read_jobs(path)]:
        assert any(gate.gate for gate in campaign.comparisons) or "broken" in campaign.name
        assert campaign.assumptions


@pytest.mark.parametrize(("old", "new", "line", "message"), data_of("lawn_mistakes"))
def test_each_mistake_is_named_with_its_line_and_nothing_else(tmp_path, old, new, line, message):
    path, replaced = tmp_path / "campaign.yaml", SPECTRA if old == "SPECTRA" else old
    assert replaced in GOOD
    path.write_text(GOOD.replace(replaced, new))
    with pytest.raises(UsageError, match=message) as caught:
        load_job(path)
    assert f"campaign.yaml:{line}:" in str(caught.value)
    assert caught.value.exit_code == 2
    # Of a scenario alone: neither of a day that it is not, nor keys that a scenario has as unknown.
    assert "did you mean 'scene'" not in str(caught.value)
    assert "radcalnet: is missing" not in str(caught.value) or "radcalnet" in message


# Bad input through the command line: one clear error, the contract's exit code, no traceback, no output.


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

"""Bad input through the command line: one clear error, the contract's exit code, no traceback, no output."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from hyperval import api, cli
from small_campaign import SmallCampaign

Change = Callable[[SmallCampaign], object]


def replaced(name: str, old: str, new: str) -> Change:
    """Put ``new`` for what the pattern ``old`` meets in a file of the collection."""
    return lambda small: small.edit(name, lambda text: re.sub(old, new, text, flags=re.MULTILINE))


def halved(small: SmallCampaign) -> None:
    path = small.collection / "small_rad.img"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def remove(name: str) -> Change:
    return lambda small: (small.collection / name).unlink()


def settings(change: Callable[[dict], object]) -> Change:
    return lambda small: change(small.data)


def percent(small: SmallCampaign) -> None:
    """The panel spectra times 100, the wavelengths as they are."""
    times_100 = lambda match: f",{100.0 * float(match[1]):.4f}"  # noqa: E731
    small.edit("panel_spectra.csv", lambda text: re.sub(r",(\d\S*?)(?=,|$)", times_100, text, flags=re.MULTILINE))


def no_unit_of_the_wavelengths(small: SmallCampaign) -> None:
    """Nor do the numbers tell it: 45 is too short in nm, 2200 too long in um."""
    replaced("small_rad.hdr", r"^wavelength units = .*\n", "")(small)
    replaced("small_rad.hdr", r"\b450\.0", "45.0")(small)


# name: (what is broken, exit code, what the message says: what, where, expected or how to mend it)
CASES: dict[str, tuple[Change, int, tuple[str, ...]]] = {
    "missing cube": (remove("small_rad.img"), 3, ("small_rad.img", "no such file")),
    "missing header": (remove("small_rad.hdr"), 3, ("small_rad", "header")),
    "truncated cube": (halved, 3, ("small_rad.img", f"{84 * 72 * 16} bytes", f"{84 * 72 * 16 * 2} bytes", "expected")),
    "wavelength units missing": (
        no_unit_of_the_wavelengths, 2,
        (r"small_rad\.hdr", "states no wavelength unit", "expected: nm or um", "wavelength_unit: nm"),
    ),
    "region outside the image": (
        settings(lambda d: d["collection"]["regions"].append({"name": "far", "rectangle": [80, 0, 10, 10]})), 3,
        ("region 'far'", "lines 80-89", "lines 0-83"),
    ),
    "target outside the image": (
        replaced("targets.csv", r"39\.5,3\.5", "900.5,900.5"), 3, (r"targets\.csv:2", "image|outside"),
    ),
    "target list with a word for a number": (
        replaced("targets.csv", r"(?<=,)3", "x3"), 3, (r"targets\.csv:\d+", "expected: a number"),
    ),
    "panel spectrum in percent": (
        percent, 3,
        (r"panel_spectra\.csv", "looks like percent", "expected: reflectance as a fraction",
         "to mend it: state reflectance_unit: percent"),
    ),
    "key that is gone": (
        settings(lambda d: d["collection"].update(precision="fast")), 2,
        (r"campaign\.yaml:\d+: collection\.precision: this key is gone; .*always summed in float64.*leave it out",),
    ),
    "address for a file": (
        settings(lambda d: d["collection"]["cube"].update(path="https://example.org/a.img")), 2,
        (r"https://example\.org/a\.img", "not a path of a local file"),
    ),
    "missing scenario": (settings(lambda d: d.update(scenarios=["none.yaml"])), 3, (r"none\.yaml", "no such")),
    "two scenarios of one subject": (
        settings(lambda d: d["scenarios"].append(d["scenarios"][0])), 2, ("two scenarios predict the radiance of",),
    ),
    "simulated files without a simulation": (
        settings(lambda d: d["collection"]["cube"].update(path="simulated:small_rad.img")), 2,
        ("this campaign simulates nothing", "set collection.simulate"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_one_clear_error_and_nothing_written(name, small, tmp_path, capsys):
    change, code, message = CASES[name]
    change(small)
    assert cli.run(["validate", str(small.write()), "-o", str(tmp_path / "out")]) == code
    said = capsys.readouterr()
    for part in message:
        assert re.search(part, said.err), f"{part!r} is not in:\n{said.err}"
    assert said.out == ""
    assert said.err.startswith("hyperval: ")
    assert said.err.count("hyperval: ") == 1  # one error
    assert not re.search("Traceback|internal error", said.err)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small"]


@pytest.mark.parametrize("stated", ["nm", None])
def test_what_is_stated_or_can_only_be_meant_one_way_mends_a_file(stated, small):
    replaced("small_rad.hdr", r"^wavelength units = .*\n", "")(small)
    small.data["collection"]["cube"]["wavelength_unit"] = stated
    percent(small)
    for panel in small.data["collection"]["empirical_line"]["panels"]:
        panel["spectrum"]["reflectance_unit"] = "percent"
    assert api.validate(small.write()).results.exit_code() == 0


def test_no_campaign_of_that_name_and_two_of_one(small, tmp_path: Path, capsys):
    assert cli.run(["validate", str(tmp_path / "none.yaml"), "-o", str(tmp_path / "out")]) == 3
    assert "none.yaml: no such file" in capsys.readouterr().err
    path = str(small.write())
    assert cli.run(["validate", path, path, "-o", str(tmp_path / "out")]) == 2
    assert "two campaigns are named 'small'" in capsys.readouterr().err

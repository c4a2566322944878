"""Bad input through the command line: one clear error, the contract's exit code, no traceback, no output."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from hyperval import api, cli
from small_campaign import SmallCampaign


def header(entry: str, value: str | None) -> Callable[[SmallCampaign], None]:
    """Change an entry of the cube's header, or take it out."""

    def change(small: SmallCampaign) -> None:
        line = "" if value is None else f"{entry} = {value}\n"
        small.edit("small_rad.hdr", lambda t: re.sub(rf"(?m)^{entry} = (?:\{{[^}}]*\}}|.*)\n", line, t))

    return change


def cube(change: Callable[[bytes], bytes]) -> Callable[[SmallCampaign], None]:
    def write(small: SmallCampaign) -> None:
        path = small.collection / "small_rad.img"
        path.write_bytes(change(path.read_bytes()))

    return write


def remove(name: str) -> Callable[[SmallCampaign], None]:
    return lambda small: (small.collection / name).unlink()


def settings(change: Callable[[dict], object]) -> Callable[[SmallCampaign], None]:
    return lambda small: (change(small.data), None)[1]


def percent(small: SmallCampaign) -> None:
    """The panel spectra times 100, the wavelengths as they are."""

    def scaled(text: str) -> str:
        comment, titles, *rows = text.splitlines()
        out = [comment, titles]
        for row in rows:
            wavelength, *values = row.split(",")
            out.append(",".join([wavelength, *(f"{100.0 * float(v):.4f}" for v in values)]))
        return "\n".join(out) + "\n"

    small.edit("panel_spectra.csv", scaled)


def far_region(small: SmallCampaign) -> None:
    small.data["collection"]["regions"].append({"name": "far", "rectangle": [80, 0, 10, 10]})


def far_target(small: SmallCampaign) -> None:
    """Move the first target to line 900."""

    def moved(text: str) -> str:
        titles, first, *rest = text.splitlines()
        values = first.split(",")
        values[titles.split(",").index("line")] = "900.5"
        return "\n".join([titles, ",".join(values), *rest]) + "\n"

    small.edit("targets.csv", moved)


def no_unit_of_the_wavelengths(small: SmallCampaign) -> None:
    """Nor do the numbers tell it: 45 is too short in nm, 2200 too long in um."""
    header("wavelength units", None)(small)
    small.edit("small_rad.hdr", lambda t: t.replace("450.0", "45.0"))


# name: (what is broken, exit code, what the message says: what, where, expected or how to mend it)
CASES: dict[str, tuple[Callable[[SmallCampaign], None], int, tuple[str, ...]]] = {
    "missing cube": (remove("small_rad.img"), 3, ("small_rad.img", "no such file")),
    "missing header": (remove("small_rad.hdr"), 3, ("small_rad", "header")),
    "truncated cube": (
        cube(lambda b: b[: len(b) // 2]), 3,
        ("small_rad.img", f"{84 * 72 * 16} bytes", f"{84 * 72 * 16 * 2} bytes", "expected"),
    ),
    "wavelength units missing": (
        no_unit_of_the_wavelengths, 2,
        (r"small_rad\.hdr", "states no wavelength unit", "expected: nm or um", "wavelength_unit: nm"),
    ),
    "region outside the image": (far_region, 3, ("region 'far'", "lines 80-89", "lines 0-83")),
    "region file that is no JSON": (
        lambda small: small.edit("regions.geojson", lambda t: t[: len(t) // 2]), 3, (r"regions\.geojson",),
    ),
    "target outside the image": (far_target, 3, (r"targets\.csv:2", "image|outside")),
    "target list with a word for a number": (
        lambda small: small.edit("targets.csv", lambda t: t.replace("36.", "x36.").replace("39.", "x39.")), 3,
        (r"targets\.csv:\d+", "expected: a number"),
    ),
    "panel spectrum in percent": (
        percent, 3,
        (r"panel_spectra\.csv", "looks like percent", "expected: reflectance as a fraction",
         "to mend it: state reflectance_unit: percent"),
    ),
    "panel that is no region": (
        settings(lambda d: d["collection"]["empirical_line"]["panels"][0].update(region="grey")), 2,
        ("no region 'grey'", "white-panel"),
    ),
    "key that is gone": (
        settings(lambda d: d["collection"].update(precision="fast")), 2,
        (r"campaign\.yaml:\d+: collection\.precision: this key is gone; .*always summed in float64.*leave it out",),
    ),
    "unknown key": (
        settings(lambda d: d["collection"].update(leaveout=[])), 2,
        (r"campaign\.yaml:\d+: collection\.leaveout: unknown key; did you mean 'leave_out'\?",),
    ),
    "address for a file": (
        settings(lambda d: d["collection"]["cube"].update(path="https://example.org/a.img")), 2,
        (r"https://example\.org/a\.img", "not a path of a local file"),
    ),
    "unknown sensor": (
        settings(lambda d: d["scenarios"][0].update(sensor="no-sensor")), 2,
        ("unknown sensor 'no-sensor'", "aviris-ng"),
    ),
    "missing scenario": (
        settings(lambda d: d.update(scenarios=["none.yaml"])), 3, (r"none\.yaml", "no such"),
    ),
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
    out = tmp_path / "out"
    found = cli.run(["validate", str(small.write()), "-o", str(out)])
    said = capsys.readouterr()
    assert found in (code if isinstance(code, tuple) else (code,)), said.err
    for part in message:
        assert re.search(part, said.err), f"{part!r} is not in:\n{said.err}"
    assert said.out == ""
    assert said.err.startswith("hyperval: ")
    assert said.err.count("hyperval: ") == 1  # one error
    assert "Traceback" not in said.err
    assert "internal error" not in said.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small"]


@pytest.mark.parametrize("name", ["missing cube", "truncated cube", "wavelength units missing", "unknown key"])
def test_observe_alone_says_the_same(name, small, tmp_path, capsys):
    change, code, message = CASES[name]
    change(small)
    assert cli.run(["observe", str(small.write()), "-o", str(tmp_path / "out")]) == code
    assert re.search(message[-1], capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("stated", ["nm", None])
def test_what_is_stated_or_can_only_be_meant_one_way_mends_a_file(stated, small):
    header("wavelength units", None)(small)
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
    assert not (tmp_path / "out").exists()

"""Channel files of MODTRAN, read and compared with."""

from __future__ import annotations

import gzip
import importlib.util
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hyperval.atmosphere import extraterrestrial_irradiance, read_channels, read_chn, read_modtran_runs
from hyperval.errors import InputError

WIDTHS = (12, 3, 3, 13, 13, 8, 13, 9, 9, 9, 9, *([13] * 10), *([10] * 5), 11)


def made_up(rows, rho=0.0):
    """A channel table of this form: L = L_a + F (A + B) rho / (1 - S rho)."""
    rule = "  ".join("-" * w for w in WIDTHS)
    lines = ["", "HEAD", rule]
    for number, (nm, path, f, a, b, s) in enumerate(rows, 1):
        width = 10.0
        ground = f * a * rho / (1 - s * rho)
        scattered = path + f * b * rho / (1 - s * rho)
        total = ground + scattered
        values = [nm, 1, number, 0.0, total * 1e-6, 300.0, total * width * 1e-6, 1.0, width, nm - 9, nm + 9]
        values += [0.0, 0.0, 0.0, 0.4 * scattered * width * 1e-6, 0.6 * scattered * width * 1e-6]
        values += [ground * width * 1e-6, 0.0, f * width * 1e-6, 0.0, 0.0, a, b, s, 0.9, 1.0]
        cells = [f"{v:>{w}.6E}" if w == 13 else f"{v:>{w}.7g}" for v, w in zip(values, WIDTHS, strict=False)]
        lines.append("  ".join(cells) + "  CENTER")
    return "\n".join(lines) + "\n\n"


ROWS = [
    (450.0, 2.0, 40.0, 0.75, 0.09, 0.18),
    (550.0, 1.0, 38.0, 0.82, 0.06, 0.11),
    (865.0, 0.2, 22.0, 0.9, 0.03, 0.04),
]


def write(tmp_path, text, name="run.chn"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_reads_what_was_written_whatever_the_ground_and_packed(tmp_path):
    black = read_chn(write(tmp_path, made_up(ROWS)))
    _, path, f, a, b, s = np.array(ROWS).T
    wanted = {"path_radiance": path, "direct": f * a, "adjacency": f * b, "ground_irradiance": np.pi * f * a / 0.9}
    for name, values in (wanted | {"spherical_albedo": s}).items():
        np.testing.assert_allclose(getattr(black, name), values, rtol=2e-6)
    bright = read_chn(write(tmp_path, made_up(ROWS, 0.4), "bright.chn"))
    np.testing.assert_allclose(bright.path_radiance, black.path_radiance, rtol=1e-4)
    with gzip.open(tmp_path / "runs.chn.gz", "wt") as stream:
        stream.write(made_up(ROWS, 0.5) + made_up(ROWS, 0.0) + made_up(ROWS, 0.1))
    assert [round(b.albedo, 4) for b in read_channels(tmp_path / "runs.chn.gz")] == [0.5, 0.0, 0.1]
    assert np.array_equal(read_chn(tmp_path / "runs.chn.gz").path_radiance, black.path_radiance)
    np.testing.assert_allclose(read_modtran_runs([tmp_path / "runs.chn.gz"]).adjacency, f * b, rtol=1e-4)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda t: t.replace("3.800000E-04", "3.8000*0E-04", 1), r"run\.chn:5: '3\.8000\*0E-04' in columns"),
        (lambda t: t.replace("3.800000E-04", "         NaN", 1), r"run\.chn:5: a value that is not finite"),
        (lambda t: t.replace("      0.75", "          ", 1), r"run\.chn:4: '' in columns"),
        (lambda t: "\n".join(line[:80] for line in t.split("\n")), r"run\.chn:3: unknown columns"),
        (lambda t: "\n".join(t.split("\n")[:3]) + "\n", "without rows"),
        (lambda t: "nothing of the kind\n", "no table"),
        (lambda t: t.replace("       10", "        0", 1), r"run\.chn:4: equivalent width 0 nm"),
        (lambda t: t.replace("       10", "       11", 1), r"run\.chn:4: channel radiance .* mean radiance times"),
        (
            lambda t: t.replace("8.000000E-06", "8.100000E-06", 1),
            r"run\.chn:4: channel .* sum of its parts",
        ),
        (lambda t: t.replace(t.split("\n")[4] + "\n", "", 1), r"run\.chn:5: channel 3\n  expected: channel 2"),
        (lambda t: t.rsplit("  CENTER", 1)[0][:-1], r"run\.chn:6: a line of \d+ characters"),
        (lambda t: t + t.rsplit("\n", 3)[0] + "\n", r"run\.chn:\d+: a table of 2 channels\n  expected: 3, as in"),
    ],
)
def test_malformed_file_is_refused_with_its_line(tmp_path, harm, said):
    text = made_up(ROWS)
    harmed = harm(text)
    assert harmed != text
    with pytest.raises(InputError, match=said):
        read_chn(write(tmp_path, harmed))


def test_absent_and_broken_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_chn(tmp_path / "absent.chn")
    (tmp_path / "broken.chn.gz").write_bytes(b"\x1f\x8b\x08rubbish")
    with pytest.raises(InputError, match="cannot read"):
        read_chn(tmp_path / "broken.chn.gz")


@pytest.mark.data
@pytest.mark.parametrize(
    "relative",
    [
        "pasadena/lut/AOT550-0.1000_H2OSTR-1.5000.chn",
        "modtran/wagl_modtran5_6/POINT-0-ALBEDO-0.chn",
        "modtran/modtran6/thermal_AERFRAC_1-0.0100_H2OSTR-0.5000.chn",
    ],
)
def test_single_black_runs_and_overlapping_spectrometers(data_dir, relative):
    path = data_dir(relative)
    (block,) = read_channels(path)
    terms = read_chn(path)
    assert np.all(np.diff(terms.wavelength_nm) >= 0)
    assert block.albedo == 0.0
    np.testing.assert_allclose(terms.path_radiance, block.radiance, rtol=1e-4)


@pytest.fixture(scope="module")
def scripts():
    """The scripts that made the numbers, their errors and the tables of validation/atmosphere/README.md."""
    folder, modules = Path(__file__).parents[2] / "validation/atmosphere", []
    for name in ("modtran_cases", "compare_modtran", "engine_ratio", "fine_structure"):
        spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        modules.append(module)
    return modules[1:]


@pytest.fixture(scope="module")
def verdicts_of(scripts, terms_of):
    """Verdicts over all airborne states, computed once."""
    compare_modtran = scripts[0]

    @cache
    def compute(locate):
        pairs = [compare_modtran.matched(case, terms_of(case.state)) for case in compare_modtran.cases(locate)]
        found = compare_modtran.differences(pairs)
        return found, {v.name: v for v in compare_modtran.verdicts(found)}

    return compute


WINDOWS = (
    "400-500", "500-600", "600-685", "740-755", "775-805", "845-885", "1000-1070", "1220-1250", "1550-1700",
    "2100-2300",
)  # fmt: skip
CRITERIA = [
    *(f"total radiance, {w} nm" for w in WINDOWS),
    *(f"path radiance, {w} nm" for w in WINDOWS[:7]),
    "total radiance, transmittance above 0.7",
    "total radiance, transmittance 0.85-1",
    "total radiance, transmittance 0.7-0.85",
]


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("criterion", CRITERIA)
def test_embedded_engine_against_modtran_6(data_dir, verdicts_of, criterion):
    found, verdicts = verdicts_of(data_dir)
    assert found.states == 11
    verdict = verdicts[criterion]
    assert verdict.limit == (0.10 if "path" in criterion else 0.05 if "transmittance" in criterion else 0.02)
    assert abs(verdict.median) <= verdict.limit


@pytest.mark.data
@pytest.mark.slow
def test_each_flight_is_predicted_from_the_other_and_the_budget_is_what_is_left(
    data_dir, scripts, engine_cache, monkeypatch
):
    """Here and not beside the tests of the ratio: the states are those of the tests above, and computed once."""
    monkeypatch.setenv("HYPERVAL_CACHE", str(engine_cache))
    made, fine = scripts[1:]
    pairs = made.pairs_of(data_dir)
    ratio = made.fitted([p for p in pairs if p.flight == "topoflux"])
    error = made.differences(
        [(p.ours(ratio), p.theirs) for p in pairs if p.flight == "pasadena" and p.case.albedos]  # run with DISORT
    )
    for low, high, limit, least in ((0.85, 1.01, 0.05, 0.99), (0.7, 0.85, 0.05, 0.9), (0.5, 0.7, 0.1, 0.9)):
        here = error.transmitting(low, high)
        assert np.mean(np.abs(error.total[here]) <= limit) >= least
    clear = (error.gas > made.WINDOW) & error.window(500.0, 1700.0)
    assert np.mean(np.abs(error.albedo[clear]) <= 0.1) >= 0.9
    rest, depth = fine.residuals(pairs)[1:]
    for low, high in pairwise(fine.DEPTHS):
        here = np.isfinite(rest) & (depth >= low) & (depth < high)
        budget = np.sqrt(np.mean(fine.RELATIVE**2 + (fine.PER_OPTICAL_DEPTH * depth[here]) ** 2))
        assert 0.4 < np.sqrt(np.mean(rest[here] ** 2)) / budget < 2.0


def test_the_document_holds_tables_that_the_script_writes():
    text = (Path(__file__).parents[2] / "validation/atmosphere/README.md").read_text("utf-8")
    between = text.split("<!-- compare_modtran.py: begin -->")[1].split("<!-- compare_modtran.py: end -->")[0]
    assert "| criterion | limit | median |" in between
    assert between.count("| met |") == len(CRITERIA)
    assert "MISSED" not in between


@pytest.mark.data
def test_a_white_diffuser_above_the_air_has_the_sunlight_of_another_source(data_dir):
    """The sun of 2017-11-08T18:42Z over Pasadena, 52.4 deg from the zenith at 0.9906 au, by ASTM G173."""
    terms = read_chn(data_dir("pasadena/lut_multi/AOT550-0.1000_H2OSTR-1.5000.chn"))
    visible = (terms.wavelength_nm > 450.0) & (terms.wavelength_nm < 1000.0)
    other = extraterrestrial_irradiance("astm-g173", terms.wavelength_nm, 0.9906) * np.cos(np.deg2rad(52.4)) / np.pi
    assert terms.diffuser_radiance is not None
    assert np.median(terms.diffuser_radiance[visible] / other[visible]) == pytest.approx(1.0, abs=0.02)

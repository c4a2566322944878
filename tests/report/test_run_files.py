"""A finished run's files: products with unit, name and keys, tables that are one table, figures drawn from them."""

import csv
import dataclasses
import io
import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import xarray as xr
import yaml
from synthetic_run import NASTY, axis, make_run

import hyperval
from hyperval import cli, products, run
from hyperval.errors import InputError
from hyperval.results import COLUMNS, Outcome, Result, ResultTable, Role

ROOT = Path(__file__).parents[2]
SAMPLE = "pasadena-2017"
AXIS = dataclasses.replace(axis(3), good=np.array([True, False, True]))
DRAWS = np.random.default_rng(11).normal(0.8, 0.1, (40, 24))
ODD = Result(
    NASTY, "radiance", 'comma, "quote"\nline', "", "bias_ratio", 0.1 + 0.2, "1", band_nm=float(np.float64(1) / 3),
    lower=-math.inf, n=np.int64(3), role=Role.GATE, outcome=Outcome.DISAGREES, reason="µ \x00 ]]> <&>",
)  # fmt: skip


def _curve(points, **more):
    pfa = np.logspace(-3, 0, points)
    return products.RocCurve(pfa, pfa**0.1, pfa**0.2, pfa**0.05, np.linspace(1, 0, points), **more)


def _sides():
    spectrum = products.SpectralEstimate(np.array([1.0, 2.0, 3.0]), np.diag([0.01, 0.02, 0.03]), None, 5)
    key = ("plank", "cem")
    spread = dataclasses.replace(spectrum, pixel_covariance=np.eye(3), spread_errors=np.full((2, 4, 3), 0.1))
    fewer = dataclasses.replace(spread, spread_errors=np.full((2, 2, 3), 0.2), rounding=np.full(3, 1e-5))
    predicted = products.PredictedProducts(
        AXIS, {"plank": spectrum, "grass": spread, "road": fewer},
        roc={(*key, "pixel"): _curve(4, preset_pfa=np.logspace(-2, 0, 4))},
        scores={key: products.ScoreDistribution(1.0, 0.1, None, np.arange(5.0), np.full(5, 0.2))},
        abundance={key: products.Abundance(9.0, 0.4, None, 9.5)}, object_scores={key: products.ObjectScores(DRAWS)},
        exceedance={key: products.ExceedanceCurve(np.arange(3.0), *np.full((3, 3), 0.1))},
        distribution={"grass": products.PixelDistribution(5.0)},
        noise={"plank": {"shot": np.array([1e-4, 2e-4, 3e-4])}}, full_scale={"plank": np.array([0.1, 0.2, 0.3])},
    )  # fmt: skip
    areas = {"auc": products.AreaEstimate(0.97, 0.95, 0.99, "bounded")}
    law = products.PixelDistribution(
        6.0, 5.0, 8.0, 0.01, 2, 7.0, 6.0, 9.0, 2, 50, np.array([30.0, 20.0]), np.linspace(0.1, 9.0, 7),
        np.linspace(0.9, 0.0, 7), 5,
    )  # fmt: skip
    alarms = products.AlarmsAtDetection(0.9, 0.31, 17, 1.7e-3, 1e-3, 3e-3, 1.1e-3, 2.7e-3)
    observed = products.ObservedProducts(
        AXIS, {"plank": spectrum}, provenance={"quantity": "counts"},
        roc={
            (*key, "pixel"): _curve(4, n_target=40, n_background=10_000, alarms=np.array([1, 20, 300, 10_000]),
                                    areas=areas, at_detection=(alarms,)),
            (*key, "object"): _curve(6, n_target=3, unit="object"),
        },
        object_scores={key: products.ObjectScores(np.array([0.7]), ("north",))},
        exceedance={key: products.ExceedanceCurve(np.arange(2.0), *np.full((3, 2), 0.2), 10_000)},
        distribution={"grass": law, "road": products.PixelDistribution(9.0, n=400)},
        classification={("grass / road", "2 bands"): products.ClassificationError(0.1, 0.08, 0.12, 900)},
    )  # fmt: skip
    return predicted, observed


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("nc")
    run.write_products(path, dict(zip(("predicted", "observed"), _sides(), strict=True)), title="t", simulated=True)
    return path


@pytest.fixture(scope="module")
def groups(folder):
    return {g: xr.load_dataset(folder / "products.nc", group=g, engine="h5netcdf") for g in ("predicted", "observed")}


def test_products_are_variables_with_keys_units_and_names(groups, folder, tmp_path):
    predicted, observed = groups.values()
    at = observed.set_xindex("roc_unit").sel(roc_unit="pixel")
    np.testing.assert_array_equal(at["roc_alarms"].to_numpy()[:4], [1, 20, 300, 10_000])
    assert np.isnan(at["roc_alarms"].to_numpy()[4:]).all(), "the shorter curve is filled up"
    assert (observed["roc_area_value"].item(), observed["roc_alarm_pfa"].item()) == (0.97, 1.7e-3)
    assert (observed["object_score_name"].item(), observed["object_score"].item()) == ("north", 0.7)
    np.testing.assert_allclose(predicted["object_score_quantile"][0], np.quantile(DRAWS, run.OBJECT_QUANTILES))
    np.testing.assert_array_equal(predicted["noise_variance_shot"][0], [1e-4, 2e-4, 3e-4])
    for data in groups.values():
        for name, variable in data.variables.items():
            assert variable.attrs.get("long_name") or variable.attrs.get("standard_name"), name
            assert variable.dtype.kind in "OTU" or "units" in variable.attrs, name
        assert data["good_band"].attrs["flag_meanings"].split() == ["not_used", "used"]
        np.testing.assert_array_equal(data["good_band"], [1, 0, 1])
    root = xr.load_dataset(folder / "products.nc", engine="h5netcdf")  # the spectra of both sides
    known, at = _sides()[0].radiance["plank"], {"side": "predicted", "subject": "plank"}
    np.testing.assert_array_equal(root["radiance"].sel(at), known.mean)
    np.testing.assert_allclose(root["radiance_standard_uncertainty"].sel(at), known.standard_uncertainty)
    assert (root["radiance"].dims, list(root["wavelength"])) == (("side", "subject", "band"), list(AXIS.centre_nm))
    run.write_products(tmp_path, dict(zip(groups, _sides(), strict=True)), title="t", simulated=True)
    assert (tmp_path / "products.nc").read_bytes() == (folder / "products.nc").read_bytes()


def _same(one, other, at=""):
    """Whether two entries hold the same, arrays to the last bit but for covariances, which are float32."""
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            _same(getattr(one, field.name), getattr(other, field.name), f"{at}.{field.name}")
    elif isinstance(one, dict | tuple):
        items, others = (x if isinstance(x, dict) else dict(enumerate(x)) for x in (one, other))
        assert items.keys() == others.keys(), at
        for key in items:
            _same(items[key], others[key], f"{at}[{key}]")
    elif isinstance(one, np.ndarray):
        np.testing.assert_allclose(other, one, rtol=1e-7 if "covariance" in at or "spread" in at else 0.0, err_msg=at)
    else:
        assert one == other or (one != one and other != other), at


def test_every_product_comes_back_as_it_was(folder):
    """But for predicted scores of objects, of which the file has quantiles: to a hundredth of their spread."""
    read = run.read_products(folder).pair
    for side, back in zip(_sides(), read, strict=True):
        for field in dataclasses.fields(side):
            if field.name != "object_scores":
                _same(getattr(side, field.name), getattr(back, field.name), field.name)
    _same(_sides()[1].object_scores, read[1].object_scores)
    parts = [0.025, 0.3, 0.5, 0.975]
    drawn = np.quantile(read[0].object_scores["plank", "cem"].values, parts)
    np.testing.assert_allclose(drawn, np.quantile(DRAWS, parts), atol=1e-3)


@pytest.mark.parametrize(("kind", "style"), [pytest.param("pdf", "journal", marks=pytest.mark.slow), ("png", "house")])
def test_figures_are_drawn_from_the_file_in_each_format(folder, tmp_path, kind, style):
    assert cli.run(["figures", str(folder), "-o", str(tmp_path / "out"), "--format", kind, "--style", style]) == 0
    files = {p.name: p.read_bytes() for p in (tmp_path / "out").glob(f"*.{kind}")}
    named = ("radiance", "roc", "scores", "object-scores", "object-transforms", "pixel-tails")
    assert {f"{name}.{kind}" for name in named} <= set(files)
    assert all(content.startswith({"pdf": b"%PDF-", "png": b"\x89PNG"}[kind]) for content in files.values())
    assert b"CreationDate" not in b"".join(files.values())


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"products\.nc"):
        run.read_products(tmp_path)
    (tmp_path / "products.nc").write_bytes(b"no netcdf")
    with pytest.raises(InputError, match="cannot be read"):
        run.read_products(tmp_path)
    assert cli.run(["figures", str(tmp_path), "-o", str(tmp_path / "out")]) == 3
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def whole():
    return make_run(bands=8, subjects=("grass", "lawn"), curves=2)


@pytest.fixture(scope="module")
def opened(whole, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    run.write_products(folder, whole.products, title=whole.title, simulated=True)
    run.write_table(whole.table, folder)
    return hyperval.open(folder)


def test_spectra_curves_and_scores_of_an_opened_run_are_tables(whole, opened):
    rows = opened.spectra.query("side == 'observed' and product == 'radiance' and subject == 'lawn'")
    known = whole.pair[1].radiance["lawn"]
    np.testing.assert_array_equal(rows["band_nm"], whole.pair[1].axis.centre_nm)
    np.testing.assert_array_equal(rows["value"], known.mean)
    np.testing.assert_allclose(rows["standard_uncertainty"], known.standard_uncertainty, rtol=1e-12)
    (key, curve), *_ = whole.pair[0].roc.items()
    rows = opened.roc.set_index(["side", "subject", "detector", "unit"]).loc[("predicted", *key)]
    np.testing.assert_array_equal(rows["pd"], curve.pd)
    (subject, detector), score = next(iter(whole.pair[1].scores.items()))
    row = opened.scores.set_index(["side", "subject", "detector"]).loc[("observed", subject, detector)]
    assert (row["mean"], row["sd"], row["n"]) == (score.mean, score.sd, score.n)
    assert len(opened.summary) == sum(row.planned for row in whole.table)


@pytest.fixture
def table() -> ResultTable:
    return make_run(rows=[ODD]).table


def read_back(table) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(run.results_csv(table), newline="")))


def test_csv_and_json_read_back_exactly(table):
    rows = read_back(table)
    assert tuple(rows[0]) == COLUMNS
    for read, row in zip(rows, table, strict=True):
        for column in COLUMNS:
            value = getattr(row, column)
            if isinstance(value, float | int) and not isinstance(value, bool):
                assert float(read[column] or "nan") == pytest.approx(value, rel=0, abs=0, nan_ok=True), column
            elif column != "n" or value is not None:
                assert read[column] == str(value)
    text = run.results_csv([Result("c", "p", "s", "m", "z", np.float64(0.1), n=np.int64(4))])
    assert text.splitlines()[1] == "c,p,s,m,,z,0.1,1,,,4,,,inform,model,none,,,,,,,,,,,,,,False,,"
    document = json.loads(run.results_json(table), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    counts = {"agrees": 5, "disagrees": 2, "undecided": 0, "skipped": 1, "error": 0, "none": 81}
    assert (document["counts"], sum(counts.values()), len(document["rows"])) == (counts, len(table), len(table))
    last = dict(zip(document["columns"], document["rows"][-1], strict=True))
    assert (last["value"], last["upper"], last["lower"], last["n"]) == (ODD.value, None, "-inf", 3)


def test_junit_counts_match_the_table(table):
    table.append(Result("other", "roc", "a", "CEM", "pd", role=Role.GATE, outcome=Outcome.ERROR, reason="singular"))
    root = ElementTree.fromstring(run.junit_xml(table))  # noqa: S314 - our own text
    assert int(root.get("tests")) == len(root.findall(".//testcase")) == len(table.where(role="gate"))
    for element, key in (("failure", "failures"), ("error", "errors"), ("skipped", "skipped")):
        (found,) = root.findall(f".//{element}")
        assert (found.get("message") != "", root.get(key)) == (True, "1")
    assert [suite.get("name") for suite in root] == ["invented", NASTY, "other"]
    assert "difference_ratio 400" not in run.junit_xml(table), "informational rows are no test cases"
    assert ElementTree.fromstring(run.junit_xml([])).get("tests") == "0"  # noqa: S314


@pytest.mark.parametrize("text", ["one\rtwo", "one\r\ntwo", "\rone", "one\r"])
def test_a_bare_carriage_return_ends_no_row(text):
    table = [Result("c", "radiance", "s", "m", "bias_ratio", value=1.0, reason=text)]
    (read,) = read_back(table)
    assert read["reason"].lstrip("'") == text.replace("\r\n", "\n").replace("\r", "\n")
    assert len(pd.read_csv(io.StringIO(run.results_csv(table)))) == 1


@pytest.mark.parametrize("text", ["=1+1", "+A1", "-2+3", "@SUM(A1)", "\t=1"])
def test_no_text_of_the_csv_is_a_formula_to_a_spreadsheet(text):
    (read,) = read_back([Result(text, "radiance", text, text, "bias_ratio", value=-1.5, lower=-2.0, reason=text)])
    assert {read[k] for k in ("campaign", "subject", "method", "reason")} == {"'" + text}
    assert (float(read["value"]), float(read["lower"])) == (-1.5, -2.0)  # numbers stay numbers


def test_the_committed_sample_has_the_accepted_numbers():
    with (ROOT / "reports" / "sample" / SAMPLE / "summary.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    found = {" | ".join(r[k] for k in ("product", "subject", "method", "metric")): r for r in rows}
    accepted = yaml.safe_load((ROOT / "validation" / "baselines" / f"{SAMPLE}.yaml").read_text())["metrics"]
    planned = {key: item for key, item in accepted.items() if item.get("outcome") not in (None, "none")}
    assert len(planned) > 20
    for key, item in planned.items():
        assert found[key]["outcome"] == item["outcome"]
        room = item["tolerance"] * (abs(item["accepted"]) if item["of"] == "value" else item.get("half_width", 1.0))
        assert math.isclose(float(found[key]["value"]), item["accepted"], rel_tol=1e-5, abs_tol=room), key

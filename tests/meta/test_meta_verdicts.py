"""A small campaign that passes; each product is falsified in turn, and the verdict must turn."""

from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest

from hyperval import cli
from hyperval.campaign import load_job, run_campaign
from hyperval.results import Cause, Outcome, ResultTable
from hyperval.simulate import field_axis
from hyperval.statistics_library import builtin_class
from small_campaign import SmallCampaign

Change = Callable[[SmallCampaign], Any]
MEDIAN = "median_abs_difference_ratio_windows"
CLASSES = ["field", "court"]


def table_of(small: SmallCampaign) -> ResultTable:
    path = small.write()
    return run_campaign(load_job(path)).table


def failing(table: ResultTable) -> set[tuple[str, str]]:
    """Product and subject of every gate that disagrees."""
    return {(row.product, row.subject) for row in table.where(role="gate").where(outcome=Outcome.DISAGREES)}


def with_spread(small: SmallCampaign) -> None:
    """Ask for a classifier, and gate spread, tails and its error."""
    small.data["classification"] = {
        "classes": CLASSES, "features": [{"name": "1 band", "bands_nm": [560]}], "block_lines": 4,
    }  # fmt: skip
    small.data["comparisons"] += [
        {"product": "covariance", "subjects": CLASSES, "metric": "total_variance_ratio", "within": [0.85, 1.15],
         "method": "radiance", "reason": "closure"},
        {"product": "covariance", "subjects": CLASSES, "metric": "tail_inverse_dof_difference",
         "within": [-0.05, 0.05], "reason": "closure"},
        {"product": "classification", "subjects": ["field / court"], "metric": "error_difference",
         "within": [-0.06, 0.06], "reason": "closure"},
    ]  # fmt: skip


def test_the_campaign_passes_as_it_stands(small):
    with_spread(small)
    table = table_of(small)
    assert failing(table) == set()
    met = {row.product for row in table.where(role="gate").where(outcome=Outcome.AGREES)}
    assert met == {"radiance", "reflectance", "abundance", "covariance", "classification"}
    curves = [row for row in table.where(role="gate") if row.product == "roc"]
    assert {(row.outcome, row.value) for row in curves} == {(Outcome.UNDECIDED, 1.0)}  # coverage
    assert len(table.where(outcome=Outcome.ERROR)) == 0
    assert table.exit_code() == 0


def scene(small: SmallCampaign, what: str, at: int) -> dict[str, Any]:
    """A class, panel or target of the scenario."""
    return small.scenario["scene"][what][at]


def fill(small: SmallCampaign, at: int, fixed: float) -> None:
    scene(small, "targets", 0)["subjects"][at]["fill"] = {"fixed": fixed}


def brighter(small: SmallCampaign, item: dict[str, Any], builtin: str) -> None:
    """A spectrum of the model is a built-in mean times 1.05, from a file."""
    axis = field_axis()
    values = pd.DataFrame({"wavelength_nm": axis.centre_nm, "scaled": 1.05 * builtin_class(builtin, axis).mean})
    values.to_csv(small.folder / "scaled.csv", index=False)
    item["spectrum"] = {"file": "scaled.csv", "wavelength_unit": "nm", "reflectance_unit": "fraction"}


def brighter_class(small: SmallCampaign) -> None:
    item = scene(small, "classes", 0)
    item["covariance"] = {"builtin": "grass"}
    brighter(small, item, "grass")


def swapped_panels(small: SmallCampaign) -> None:
    """Two panels of the empirical line change places: the line itself goes wrong."""
    panels = small.data["collection"]["empirical_line"]["panels"]
    panels[0]["region"], panels[2]["region"] = panels[2]["region"], panels[0]["region"]


def of_truth(column: str, change: Callable[[Any], Any]) -> Change:
    """A column of the truth of the targets is another."""

    def falsify(small: SmallCampaign) -> None:
        path = small.collection / "targets.csv"
        table = pd.read_csv(path)
        table.assign(**{column: change(table[column])}).to_csv(path, index=False)

    return falsify


GREEN = {"builtin": "green-paint-plank"}
# What is falsified, and products and subjects whose gates must turn.
FALSIFIED: dict[str, tuple[Change, set[tuple[str, str]]]] = {
    "reflectance of a class": (brighter_class, {("radiance", "field"), ("reflectance", "field")}),
    "reflectance of a panel": (
        lambda s: brighter(s, scene(s, "panels", 0), "white-panel"), {("radiance", "white-panel")}
    ),
    "atmosphere": (lambda s: s.scenario["atmosphere"].update(aot550=0.4), {("radiance", "black-panel")}),
    "spectrum of the target": (lambda s: scene(s, "targets", 0).update(spectrum=GREEN), {("roc", "small-planks")}),
    "spectrum of the filter": (
        lambda s: s.data["detection"]["targets"][0].update(spectrum=GREEN),
        {("roc", "small-planks"), ("abundance", "large-planks")},
    ),
    "fill of the small planks": (lambda s: fill(s, 0, 0.04), {("roc", "small-planks")}),
    "area in the truth": (of_truth("area_m2", lambda area: 1.7 * area), {("abundance", "large-planks")}),
    "targets moved": (of_truth("line", lambda at: at - 2.0), {("roc", "small-planks"), ("roc", "large-planks")}),
    "scale of the cube": (
        lambda s: s.data["collection"]["cube"].update(scale=1.05e-3), {("radiance", "field"), ("radiance", "court")}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FALSIFIED)
def test_each_falsified_input_turns_the_verdict(name, small):
    change, expected = FALSIFIED[name]
    change(small)
    table = table_of(small)
    assert expected <= failing(table)
    assert table.exit_code() == 1
    if name == "fill of the small planks":  # a harness that fails everything would satisfy the lines above
        assert failing(table) == expected
        assert len(table.where(role="gate").where(outcome=Outcome.AGREES)) == 8


@pytest.mark.parametrize(
    ("at", "change", "metric"),
    [
        (0, {"covariance": {"relative_sd": 0.5, "band_sd": 0.001}}, "total_variance_ratio"),
        (0, {"tail_dof": 5.0}, "tail_inverse_dof_difference"),
        (1, {"spectrum": {"builtin": "grass"}}, "error_difference"),  # the court is a second field
    ],
)
def test_a_falsified_spread_turns_its_gate(small, at, change, metric):
    with_spread(small)
    scene(small, "classes", at).update(change)
    table = table_of(small)
    assert Outcome.DISAGREES in {row.outcome for row in table.where(metric=metric)}
    assert table.exit_code() == 1


def test_statistics_of_the_collection_itself_are_not_compared_with_themselves(small):
    with_spread(small)
    scene(small, "classes", 0).update(spectrum={"measured": "field"}, tail_dof="measured")
    table = table_of(small)
    # The plan names it, so its absence is an error and not silence.
    (level,) = table.where(product="radiance", subject="field")
    assert level.outcome is Outcome.ERROR
    assert "no radiance of" in level.reason
    rows = table.where(product="covariance", subject="field")
    absent = {row.metric for row in rows.where(outcome=Outcome.ERROR)}
    assert absent == {"total_variance_ratio", "tail_inverse_dof_difference"}
    told = {row.metric for row in rows if row.outcome is not Outcome.ERROR}
    assert told.isdisjoint(absent)
    assert "background_tail_dof" in told  # measured, and said to have nothing to compare with


def test_a_line_whose_panels_contradict_each_other_decides_no_reflectance(small):
    swapped_panels(small)
    table = table_of(small)
    gates = [row for row in table.where(role="gate") if row.product == "reflectance"]
    assert {row.subject for row in gates} == {"field", "court"}
    assert all(row.outcome is Outcome.UNDECIDED and row.value > row.limit_high for row in gates)
    panels = [r for r in table.where(product="reflectance", metric="p_value_full") if "panel" in r.subject]
    assert panels
    assert all(row.outcome is Outcome.DISAGREES and row.value < 1e-9 for row in panels)


def test_the_command_line_says_so(small, tmp_path):
    brighter_class(small)
    out = tmp_path / "out"
    assert cli.run(["-q", "validate", str(small.write()), "-o", str(out)]) == 1
    for name, words in (("results.csv", ",disagrees,"), ("junit.xml", "<failure"), ("report.html", "Not met.")):
        assert words in (out / name).read_text()


@pytest.mark.parametrize(
    ("remove", "product", "side"),
    [
        (lambda s: s.gate("radiance").update(subjects=["field", "lawn*"]), "radiance", "planned but absent"),
        (lambda s: s.data["detection"].update(areas=[]), "abundance", "planned but absent"),
        (lambda s: s.scenario["scene"].update(targets=[]), "roc", "in the prediction"),
        (lambda s: s.scenario["scene"].update(panels=[]), "radiance", "in the prediction"),
        (lambda s: s.scenario["processing"].update(elm="none"), "reflectance", "in the prediction"),
        (lambda s: s.data.pop("detection"), "roc", "in the observation"),
    ],
    ids=["subject", "areas", "targets", "panels", "line", "detection"],
)
def test_a_product_that_one_side_lacks_is_an_error_where_it_gates(small, remove, product, side):
    remove(small)
    table = table_of(small)
    assert any(side in row.reason for row in table.where(outcome=Outcome.ERROR, product=product))
    assert table.exit_code() == 1


def test_an_uncertainty_does_not_excuse_a_wrong_mean(small):
    """A wrong mean under a budget that reaches beyond the range: it is not called right, and not shown to be wrong.

    Grass 5 % too bright puts the median |difference ratio| above its limit, which disagrees as long as the interval
    does too (the test of the falsified inputs above).  A calibration known to 50 % makes that interval value +- 1
    at the least: it holds the whole range and is wider than it, so that no value of this collection meets the
    criterion.  What it could have found is more than its own half width, and the row says that.
    """
    brighter_class(small)
    small.data["collection"]["calibration"] = {"relative": 0.5}
    table = table_of(small)
    (row,) = table.where(role="gate").where(product="radiance", subject="field", metric=MEDIAN)
    assert row.lower < row.limit_high < row.value < row.upper
    assert (row.outcome, row.cause) == (Outcome.UNDECIDED, Cause.NEVER)
    assert row.upper - row.value > max(1.96 * 0.5 * 0.9, row.limit_high)
    assert row.detectable > row.upper - row.value
    assert table.exit_code(strict=True) == 1

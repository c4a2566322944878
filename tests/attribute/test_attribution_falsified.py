"""Twins with one input falsified on purpose: the falsified input must be the first reason named.

The collection is true; what the model is told of it is not.  Each kind is run on the same simulated collection, so
that a wrong answer is one of method, not of luck.
"""

from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperval.campaign import jobs_of, run_campaign
from hyperval.errors import UsageError
from hyperval.results import Outcome

FALSIFIED = yaml.safe_load((Path(__file__).parent / "falsified.yaml").read_text())
LEFT_OUT = "a class that was left out"


def _falsify(small, kind):
    small.data["attribution"] = {"what_ifs": [], "totals": False}
    for path, value in FALSIFIED[kind].items():
        *keys, last = (int(key) if key.isdigit() else key for key in path.split("."))
        reduce(getitem, keys, small.data)[last] = value
    if "field" in kind or kind == LEFT_OUT:
        small.data["comparisons"] = [small.gate("radiance") | {"subjects": ["field"]}]


def _state_surroundings(small):
    """Panels and planks are part of the surroundings, of which the model is told the two fields alone.

    One panel is no sample of its SNR, so that is left out.
    """
    small.scenario["uncertainty"] = {
        "adjacency_reflectance_relative": 0.1,
        "fractions": [{"subject": "field", "absolute": 0.1}],
    }
    small.data["collection"]["targets"]["guard_pixels"] = 1
    del small.data["collection"]["snr_regions"]
    small.data["comparisons"] = [g for g in small.data["comparisons"] if g["product"] != "snr"]


def _reasons(small):
    table = run_campaign(jobs_of(small.write())[0], show_progress=False).table
    gains = {
        r.method: r.value
        for r in table
        if r.subject == "all" and r.product in ("attribution", "what-if") and r.metric == "likelihood_gain"
    }
    return table, sorted(gains, key=lambda n: -gains[n])


@pytest.mark.parametrize("kind", [pytest.param(k, marks=[pytest.mark.slow] * (i > 0)) for i, k in enumerate(FALSIFIED)])
def test_the_falsified_input_is_named_first(small, kind):
    _falsify(small, kind)
    if kind != LEFT_OUT:  # one class has no fraction that could be off
        _state_surroundings(small)  # else they are wrong too: they alone have a reduced chi-square of 6
    table, ranked = _reasons(small)
    assert ranked[0] == kind
    (chi,) = [r for r in table.where(product="attribution", subject="all") if r.metric == "reduced_chi_square"]
    assert chi.value > 3.0
    assert chi.outcome is Outcome.DISAGREES


def test_nothing_is_blamed_where_nothing_was_falsified(small):
    small.data["attribution"] = {"totals": False}
    _state_surroundings(small)
    table, _ = _reasons(small)
    (chi,) = [r for r in table.where(product="attribution", subject="all") if r.metric == "reduced_chi_square"]
    # 100 and more residuals: 1.5 is far outside of what a true model gives.
    assert chi.value < 1.5
    worst = max(r.value for r in table.where(product="attribution") if r.metric == "likelihood_gain")
    assert worst < 15.0


def test_a_collection_that_is_measured_again_and_shares_of_the_variance(small):
    """The change found is the one that was made; read with the right scale it meets its model."""
    _falsify(small, "sensor gain")
    _state_surroundings(small)
    right = {"name": "the header's scale", "question": "was it read wrongly?",
             "observe": {"collection.cube.scale": 1e-3}}  # fmt: skip
    small.data["attribution"] = {"what_ifs": [right], "each": ["field"]}
    table, _ = _reasons(small)
    (row,) = table.where(product="attribution", subject="all", method="sensor gain", metric="likelihood_gain")
    units = float(row.reason.partition(": ")[2].split()[0])
    assert np.isclose(units, 4.0, atol=0.3), "4 % in steps of 1 %"
    by_metric = {r.metric: r for r in table.where(product="what-if", method=right["name"])}
    (before,) = [r for r in table.where(product="attribution", subject="all") if r.metric == "reduced_chi_square"]
    assert by_metric["reduced_chi_square"].value < 1.5 < 3.0 < before.value
    assert by_metric["reduced_chi_square"].reason.startswith(f"{before.value:.4g} before")
    (alone,) = [r for r in table.where(product="attribution", subject="field") if r.metric == "reduced_chi_square"]
    assert alone.value > 3.0
    stated = [r for r in table.where(product="sensitivity") if "share of the variance" in r.reason]
    shares = [[float(w.split()[0]) for w in r.reason.split("variance ")[1].split(", ")] for r in stated]
    assert len({r.method for r in stated}) >= 2
    # No stated input moves what is observed alone, as an SNR: it has no shares, and none is said to be no number.
    assert not [r for r in table.where(product="sensitivity") if "nan" in r.reason]
    for first, total in shares:
        assert -1e-9 <= first <= total + 1e-9 <= 1.0 + 2e-9


def test_an_experiment_that_compares_other_things_is_refused(small):
    small.data["attribution"] = {"totals": False, "what_ifs": [
        {"name": "fewer", "question": "?", "observe": {"collection.snr_regions": []}}]}  # fmt: skip
    with pytest.raises(UsageError, match="'fewer' compares other things than the campaign does"):
        _reasons(small)

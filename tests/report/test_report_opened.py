"""A finished run is opened by one word, and its numbers are tables."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_run import make_run

import hyperval
from hyperval.errors import UsageError
from hyperval.run import write_products, write_table


@pytest.fixture(scope="module")
def run():
    return make_run(bands=8, subjects=("grass", "lawn"), curves=2)


@pytest.fixture(scope="module")
def opened(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    sides = {"predicted": run.prediction, "observed": run.observation}
    write_products(folder, sides, title=run.title, simulated=True)
    write_table(run.table, folder)
    return hyperval.open(folder)


def test_spectra_curves_and_scores_are_those_of_the_run(run, opened):
    rows = opened.spectra.query("side == 'observed' and product == 'radiance' and subject == 'lawn'")
    np.testing.assert_array_equal(rows["band_nm"], run.observation.axis.centre_nm)
    np.testing.assert_array_equal(rows["value"], run.observation.radiance["lawn"].mean)
    u = run.observation.radiance["lawn"].standard_uncertainty
    np.testing.assert_allclose(rows["standard_uncertainty"], u, rtol=1e-12)
    (key, curve), *_ = run.prediction.roc.items()
    names = ["side", "subject", "detector", "unit"]
    rows = opened.roc.set_index(names).loc[("predicted", *key)]
    np.testing.assert_array_equal(rows["pd"], curve.pd)
    (subject, detector), score = next(iter(run.observation.scores.items()))
    row = opened.scores.set_index(["side", "subject", "detector"]).loc[("observed", subject, detector)]
    assert (row["mean"], row["sd"], row["n"]) == (score.mean, score.sd, score.n)
    assert len(opened.summary) == sum(row.planned for row in run.table)


def test_a_measurand_has_its_errors_by_the_names_of_obsarray(run, opened):
    data = opened.measurand("observed", "radiance", "lawn")
    known = run.observation.radiance["lawn"]
    (component,) = data["radiance"].attrs["unc_comps"]
    u = data[component]
    assert (u.attrs["err_corr_1_dim"], u.attrs["err_corr_1_form"]) == ("band", "err_corr_matrix")
    correlation = data[u.attrs["err_corr_1_params"][0]].to_numpy()
    np.testing.assert_array_equal(np.diag(correlation), 1.0)
    np.testing.assert_allclose(
        correlation * np.outer(u, u),
        known.error_covariance,
        rtol=1e-5,
        atol=1e-7 * np.abs(known.error_covariance).max(),
    )
    np.testing.assert_array_equal(data["radiance"], known.mean)
    with pytest.raises(UsageError, match="observed radiance lawn"):
        opened.measurand("observed", "radiance", "a wall")


def test_a_notebook_shows_words_and_rows_escaped(opened):
    text = opened._repr_html_()
    assert text.startswith("<pre>&lt;Run of invented&gt;")
    assert "<table" in text
    assert text.count("<tr") < 14
    assert "<td>none</td>" not in text  # what was judged, not the numbers of single bands


def test_products_have_a_short_repr(run):
    text = repr(run.prediction)
    assert text.startswith("<PredictedProducts of 8 bands, 400-2450 nm: 2 radiance, 2 snr")
    assert len(text) < 200


def test_the_package_has_no_other_name():
    with pytest.raises(AttributeError, match="nothing_there"):
        _ = hyperval.nothing_there

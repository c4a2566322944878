"""The Python API: every verb from paths and objects, short reprs, tables, datasets, plots; its examples run."""

import doctest

import matplotlib
import pytest
import xarray as xr

from hyperval import api
from hyperval.api import objects, verbs
from hyperval.errors import InputError, UsageError
from hyperval.products import Products
from small_campaign import scenario_data, scene_data, write_yaml

matplotlib.use("Agg")
pytestmark = pytest.mark.slow
STUDY = {
    "schema": 1,
    "name": "small-study",
    "scenario": "scenario.yaml",
    "inputs": [
        {"name": "fill", "path": "scene.targets.yellow.subjects.small-planks.fill.fixed", "values": [0.05, 0.1]}
    ],
    "outputs": [{"name": "pd", "kind": "pd", "subject": "small-planks", "pfa": 1e-2}],
    "plots": [{"kind": "lines", "x": "fill", "output": "pd"}],
}


@pytest.fixture
def beside(figures, small, monkeypatch):
    """The working directory of a user: a campaign, its scenario and its scene, a study."""
    monkeypatch.chdir(small.folder)
    small.write()
    write_yaml(small.folder / "scenario.yaml", scenario_data())
    write_yaml(small.folder / "scene.yaml", scene_data())
    write_yaml(small.folder / "study.yaml", STUDY)
    return small


@pytest.mark.parametrize("module", [api, verbs, objects], ids=lambda m: m.__name__)
def test_every_example_runs(beside, module):
    finder = doctest.DocTestFinder(exclude_empty=True)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    for case in finder.find(module, globs={**vars(module), **vars(verbs)}):
        runner.run(case)
    assert runner.failures == 0
    assert module is objects or runner.tries > 5


def test_every_verb_has_an_example():
    names = {"predict", "observe", "compare", "validate", "study", "check", "simulate", "open", "metrics"}
    assert names <= set(verbs.__all__) <= set(api.__all__)
    for name in verbs.__all__:
        text = getattr(verbs, name).__doc__ or ""
        assert ">>>" in text or name == "load_scenario", name


def looks_right(thing) -> None:
    """Whether a reader in a terminal and one in a notebook get what they need."""
    text = repr(thing)
    assert 1 <= len(text.splitlines()) <= 10
    assert max(map(len, text.splitlines())) <= 104
    assert isinstance(thing.to_xarray(), xr.Dataset | xr.DataTree)
    assert len(thing.to_dataframe()) > 0
    if hasattr(thing, "plot"):
        axes = thing.plot()
        assert axes.has_data()
        assert axes.get_xlabel()


def test_objects_show_themselves(beside):
    run = api.validate(api.load_campaign("campaign.yaml"), output="results")
    opened = api.open("results")
    for thing in (run, opened, run.prediction, run.observation, run.results, api.metrics()):
        looks_right(thing)
    assert opened.results.exit_code() == run.results.exit_code()
    assert opened.to_xarray()["predicted"]["radiance"].equals(run.to_xarray()["predicted"]["radiance"])
    looks_right(api.simulate("scene.yaml", "simulated"))
    looks_right(api.study("study.yaml", output="studied"))
    looks_right(api.open("studied"))


def test_sides_are_products_and_compare_takes_them(beside):
    observed = api.observe("campaign.yaml")
    predicted = api.predict(api.load_scenario("scenario.yaml"), axis=observed.axis)
    assert isinstance(observed, Products)
    rows = api.compare(predicted, observed)
    assert {r.product for r in rows} == {r.product for r in api.compare("scenario.yaml", "campaign.yaml")}
    assert predicted.plot.roc().get_xscale() == "log"
    with pytest.raises(UsageError, match="nothing to draw"):
        observed.plot.spectra("abundance")


def test_what_is_no_result_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        api.open(tmp_path)

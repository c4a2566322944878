"""The Python API: every verb from paths and objects, short reprs, tables, datasets, plots; its examples run."""

import doctest
import subprocess
import sys

import matplotlib
import pytest
import xarray as xr

from hyperval import api, scenario
from hyperval.api import objects
from hyperval.errors import InputError, UsageError
from small_campaign import data_of, scenario_data, scene_data, write_yaml

matplotlib.use("Agg")
pytestmark = pytest.mark.slow


@pytest.fixture
def beside(figures, small, monkeypatch):
    """The working directory of a user: a campaign, its scenario and its scene, a study."""
    monkeypatch.chdir(small.folder)
    small.write()
    write_yaml(small.folder / "scenario.yaml", scenario_data())
    write_yaml(small.folder / "scene.yaml", scene_data())
    write_yaml(small.folder / "study.yaml", data_of("small_study"))
    return small


@pytest.mark.parametrize("module", [api, objects, scenario], ids=lambda m: m.__name__)
def test_every_example_runs(beside, module):
    finder = doctest.DocTestFinder(exclude_empty=True)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    for case in finder.find(module, globs={**vars(module), **vars(objects)}):
        runner.run(case)
    assert runner.failures == 0
    assert runner.tries > 3 or module is scenario
    assert all(">>>" in getattr(api, name).__doc__ for name in api.__all__ if name.islower())


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
    assert list(predicted.roc) == list(observed.roc) == list(api.validate("campaign.yaml").roc)
    curve = predicted.products.roc["small-planks", "cem", "pixel"]
    found = predicted.pd("small-planks", pfa=float(curve.pfa[30]), detector="cem", unit="pixel")
    assert (found.value, str(found.lower)) == (curve.pd[30], "nan")  # as the scenario states no uncertainty
    with pytest.raises(UsageError, match="no ROC curve of 'a wall'"):
        predicted.pd("a wall")
    data = observed.to_xarray()  # a product is nothing for a subject that has none
    assert data["radiance"].dims == data["snr"].dims == ("subject", "wavelength")
    assert data["snr"].sel(subject="small-planks").isnull().all()
    rows = api.compare(predicted, observed)
    assert {r.product for r in rows} == {r.product for r in api.compare("scenario.yaml", "campaign.yaml")}
    with pytest.raises(UsageError, match="nothing to draw"):
        observed.plot.spectra("abundance")


def test_libraries_load_when_they_are_used():
    heavy = "numpy", "pandas", "xarray", "scipy", "matplotlib", "pydantic"
    script = f"import sys; from hyperval import api; print([m for m in {heavy} if m in sys.modules], api.predict)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("[] <function predict")


def test_what_is_no_result_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        api.open(tmp_path)

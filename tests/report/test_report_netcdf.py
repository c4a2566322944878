"""Everything a side holds stands in products.nc, with unit, name and keys."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import xarray as xr

from hyperval.products import (
    Abundance,
    AlarmsAtDetection,
    AreaEstimate,
    ClassificationError,
    ExceedanceCurve,
    ObjectScores,
    ObservedProducts,
    PixelDistribution,
    PredictedProducts,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.run import OBJECT_QUANTILES, read_pair, write_products
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 600.0, 700.0]), np.full(3, 6.0), np.array([True, False, True]))
DRAWS = np.random.default_rng(11).normal(0.8, 0.1, (40, 24))


def _curve(points, **more):
    pfa = np.logspace(-3, 0, points)
    return RocCurve(pfa, pfa**0.1, pfa**0.2, pfa**0.05, np.linspace(1, 0, points), **more)


def _sides():
    spectrum = SpectralEstimate(np.array([1.0, 2.0, 3.0]), np.diag([0.01, 0.02, 0.03]), None, 5)
    key = ("plank", "cem")
    predicted = PredictedProducts(
        AXIS, {"plank": spectrum}, roc={(*key, "pixel"): _curve(4, preset_pfa=np.logspace(-2, 0, 4))},
        scores={key: ScoreDistribution(1.0, 0.1, None, np.arange(5.0), np.full(5, 0.2))},
        abundance={key: Abundance(9.0, 0.4, None, 9.5)}, object_scores={key: ObjectScores(DRAWS)},
        exceedance={key: ExceedanceCurve(np.arange(3.0), *np.full((3, 3), 0.1))},
        noise={"plank": {"shot": np.array([1e-4, 2e-4, 3e-4])}}, full_scale={"plank": np.array([0.1, 0.2, 0.3])},
    )  # fmt: skip
    areas = {"auc": AreaEstimate(0.97, 0.95, 0.99, "bounded")}
    tail = {"distance": np.array([1.0, 4.0]), "exceedance": np.array([0.5, 0.01])}
    alarms = AlarmsAtDetection(0.9, 0.31, 17, 1.7e-3, 1e-3, 3e-3, 1.1e-3, 2.7e-3)
    observed = ObservedProducts(
        AXIS, {"plank": spectrum},
        roc={
            (*key, "pixel"): _curve(4, n_target=40, n_background=10_000, alarms=np.array([1, 20, 300, 10_000]),
                                    areas=areas, at_detection=(alarms,)),
            (*key, "object"): _curve(6, n_target=3, unit="object"),
        },
        object_scores={key: ObjectScores(np.array([0.7, 0.9]), ("north", "south"))},
        exceedance={key: ExceedanceCurve(np.arange(2.0), *np.full((3, 2), 0.2), 10_000)},
        distribution={
            "grass": PixelDistribution(8.0, n=500, effective_n=np.array([90.0, 80.0]), **tail),
            "road": PixelDistribution(9.0, n=400),
        },
        classification={("grass / road", "2 bands"): ClassificationError(0.1, 0.08, 0.12, 900)},
    )  # fmt: skip
    return predicted, observed


@pytest.fixture(scope="module")
def groups(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nc")
    path = folder / "products.nc"
    predicted, observed = _sides()
    write_products(folder, {"predicted": predicted, "observed": observed}, title="t", simulated=True)
    return {g: xr.load_dataset(path, group=g, engine="h5netcdf") for g in ("predicted", "observed")}, path


def test_detection_products_come_back(groups):
    (predicted, observed), _ = groups[0].values(), groups[1]
    at = observed.set_xindex("roc_unit").sel(roc_unit="pixel")
    np.testing.assert_array_equal(at["roc_alarms"].values[:4], [1, 20, 300, 10_000])
    assert np.isnan(at["roc_alarms"].values[4:]).all(), "the shorter curve is filled up"
    assert (observed["roc_area_value"].item(), observed["roc_area_upper"].item()) == (0.97, 0.99)
    assert observed["roc_alarm_pfa"].item() == 1.7e-3
    assert dict(zip(observed["object_score_name"].values, observed["object_score"].values, strict=True)) == {
        "north": 0.7, "south": 0.9}  # fmt: skip
    np.testing.assert_allclose(predicted["object_score_quantile"][0], np.quantile(DRAWS, OBJECT_QUANTILES))
    np.testing.assert_array_equal(predicted["noise_variance_shot"][0], [1e-4, 2e-4, 3e-4])


def test_every_variable_has_a_unit_and_a_name_in_words(groups):
    for data in groups[0].values():
        for name, variable in data.variables.items():
            assert variable.attrs.get("long_name") or variable.attrs.get("standard_name"), name
            assert variable.dtype.kind in "OTU" or "units" in variable.attrs, name
        assert data["good_band"].attrs["flag_meanings"].split() == ["not_used", "used"]
        np.testing.assert_array_equal(data["good_band"], [1, 0, 1])


def test_two_writes_give_the_same_bytes(groups, tmp_path):
    predicted, observed = _sides()
    write_products(tmp_path, {"predicted": predicted, "observed": observed}, title="t", simulated=True)
    assert (tmp_path / "products.nc").read_bytes() == groups[1].read_bytes()


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
        np.testing.assert_allclose(other, one, rtol=1e-7 if "covariance" in at else 0.0, err_msg=at)
    else:
        assert one == other or (one != one and other != other), at


def test_every_product_comes_back_as_it_was(groups):
    read = read_pair(groups[1].parent)
    for side, back in zip(_sides(), read, strict=True):
        for field in dataclasses.fields(side):
            if field.name != "object_scores":  # a law comes back as other draws of it
                _same(getattr(side, field.name), getattr(back, field.name), field.name)
    assert _same(_sides()[1].object_scores, read[1].object_scores) is None  # it raises where they differ


def test_the_root_of_the_file_shows_the_spectra_of_both_sides(groups):
    data = xr.load_dataset(groups[1], engine="h5netcdf")
    assert data["radiance"].dims == ("side", "subject", "band")
    known = _sides()[0].radiance["plank"]
    at = {"side": "predicted", "subject": "plank"}
    np.testing.assert_array_equal(data["radiance"].sel(at), known.mean)
    np.testing.assert_allclose(data["radiance_standard_uncertainty"].sel(at), known.standard_uncertainty)
    np.testing.assert_array_equal(data["wavelength"], AXIS.centre_nm)

"""The trade desk: its curve is the model's, its study gives it again, what is required is met."""

from pathlib import Path

import numpy as np
import pytest

from hyperval import api
from hyperval.model import evaluations, predict, with_values
from hyperval.study import Trade, complete, live_figure, next_piece, prepare

PLANKS = "yellow-planks-asphalt"
FILL = "scene.targets.[yellow plank].subjects.[yellow plank 0.02].fill.fixed"
ZENITH, SIGNAL = "atmosphere.solar_zenith_deg", "sensor_changes.signal_factor"


def whole(source, **asked):
    """What is asked, complete, and what stands when all pieces have come."""
    trade = complete(Trade(**asked), prepare(source, Trade(**asked)))
    now = None
    while now is None or now.todo:
        now = next_piece(source, trade, now)
    return trade, now


def of_model(source, trade, path, x):
    """P_D of the plain model."""
    moved = {key: np.full(x.size, value) for key, value in trade.moved.items()}
    pd = np.empty(x.size)
    for index, e in evaluations(with_values(prepare(source, trade).world, {path: x, **moved})):
        pd[index] = e.scores(trade.subject[0], "cem").detection(np.array([[trade.pfa]]))[:, 0]
    return pd


@pytest.mark.parametrize(("path", "low", "high", "wanted"), [(FILL, 0.005, 0.2, 0.9), (ZENITH, 10.0, 70.0, 0.0187)])
def test_a_curve_is_that_of_the_model_and_a_required_value_meets_it(path, low, high, wanted):
    trade, now = whole(PLANKS, x=path, x_from=low, x_to=high, wanted=wanted, moved={SIGNAL: 1.5})
    x = np.geomspace(low, high, 33) if path == FILL else np.linspace(low, high, 33)
    np.testing.assert_allclose(now.values[0, :, 0], of_model(PLANKS, trade, path, x), rtol=1e-12)
    ((value, words),) = now.needed
    assert of_model(PLANKS, trade, path, np.array([value])) == pytest.approx(wanted, rel=1e-6)
    assert f"{value:.4g}" in words


def test_limits_are_those_of_a_prediction(tmp_path):
    file, folder = tmp_path / "uncertain.yaml", Path(api.__file__).parents[1] / "scenarios"
    text = (folder / f"{PLANKS}.yaml").read_text("utf-8")
    file.write_text(text + "uncertainty: {fills: [{subject: yellow plank 0.02, absolute: 0.002}]}\n", "utf-8")
    trade, now = whole(str(file), x=FILL, x_from=0.02, x_to=0.2)
    curve = predict(prepare(str(file), trade).scenario).roc["yellow plank 0.02", "cem", "pixel"]
    at = int(np.argmin(abs(curve.pfa - 1e-3)))
    assert now.limits[0, 0, 0] == pytest.approx([curve.pd_lower[at], curve.pd_upper[at]], rel=1e-3)
    value, (low, high) = now.values[0, :, 0], now.limits[0, :, 0].T  # at every point, not where predicted alone
    assert np.all((low >= 0.0) & (low <= value) & (value <= high) & (high <= 1.0))


def test_a_target_with_a_side_has_a_gsd_and_overlays_are_curves():
    asked = {"side_m": 0.3, "background": ["asphalt", "grass"], "sensor": ["prospectir-vs", "hyspex-vnir-1600"]}
    trade, now = whole(PLANKS, **asked, wanted=0.5)
    assert (trade.x.rpartition(".")[2], now.values.shape) == ("gsd_m", (4, 33, 1))
    assert [round(words.count("hyspex")) for _, words in now.needed] == [0, 1, 0, 1]
    told = live_figure(PLANKS, complete(Trade(**asked, output="snr", from_nm=1500, to_nm=1600), prepare(PLANKS, trade)))
    assert [value is None for _, value in told["values"]] == [False, True]
    assert ". hyspex-vnir-1600: output 'snr': no usable band from 1500" in told["error"]
    assert len(live_figure(PLANKS, trade, with_limits=True)["values"]) == 4


def test_the_second_input_stands_where_its_slider_does():
    trade, now = whole(PLANKS, x=FILL, x_from=0.01, x_to=0.3, y=ZENITH, wanted=0.5, moved={ZENITH: 60.0})
    assert of_model(PLANKS, trade, FILL, np.array([now.needed[0][0]])) == pytest.approx(0.5, rel=1e-6)

"""What no formula can answer is refused in words."""

from dataclasses import replace

import numpy as np
import pytest

from hyperval import model, pixels
from hyperval.errors import UsageError

EYE, RNG = np.eye(3), np.random.default_rng(0)
GAIN, OFFSET = np.array([10.0, 6.0, 2.0]), np.array([1.0, 0.5, 0.1])


def panel(name="white", rho=0.6, sd=0.01, variance=1e-4, n=30, radiance=None):
    rho = np.full(3, rho)
    radiance = OFFSET + GAIN * rho if radiance is None else radiance
    return pixels.MeasuredPanel(name, rho, np.full(3, sd**2), radiance, np.full(3, variance), n)


def line(white=None, *, sd=0.01, rho=0.05, change=None, **options):
    """The line through a black panel and a white one of which something is wrong."""
    return pixels.fit_elm((replace(white or panel(sd=sd), **(change or {})), panel("black", rho, 0.01)), **options)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: pixels.pixel_detector("sam", np.zeros(3), np.ones(3), None), "it has no direction"),
        (lambda: pixels.pixel_detector("cem-correlation", np.zeros(3), np.ones(3), EYE), "zero in every band"),
        (lambda: pixels.pixel_detector("cem", np.ones(3), np.zeros(3), None), "'cem' needs the covariance"),
        (lambda: pixels.pixel_detector("ace", None, np.zeros(3), EYE), "'ace' needs a target spectrum"),
        (lambda: pixels.whitener_of(np.zeros(3), np.diag([1.0, 1.0, 0.0])), "1 of 3 bands have no variance"),
        (lambda: pixels.pixel_detector("CEM", np.ones(3), np.zeros(3), EYE), "unknown detector 'CEM'"),
        (lambda: pixels.pixel_detector("rx", None, np.zeros(3), EYE).score(EYE), "whitener"),
        (lambda: pixels.register_detector("My detector", lambda *a: None), "detector name 'My detector'"),
        (lambda: pixels.register_detector("cem", lambda *a: None), "there is a detector 'cem' already"),
        (lambda: model.feature_bands(np.arange(3.0), np.zeros(3, bool), ()), "no usable band for classification"),
        (lambda: model.principal_components(EYE, 0), "0 principal components of 3 bands"),
        (lambda: model.principal_components(EYE, 4), "4 principal components of 3 bands"),
        (lambda: model.with_distances(None, [model.ClassLaw(np.zeros(3), EYE)]), "classification needs two classes"),
        (lambda: line(change={"radiance": np.full(3, np.nan)}), "panel 'white' holds NaN or infinity"),
        (lambda: line(panel(rho=60.0)), "divide percent by 100"),
        (lambda: line(panel(rho=-0.2)), "reflectance of -0.2"),
        (lambda: line(panel(rho=np.nan)), "no reflectance in any band"),
        (lambda: line(rho=0.55), "differ by 0.05"),
        (lambda: line(panel(variance=25.0)), "gain is below 5 times"),
        (lambda: line(panel(radiance=GAIN * 0)), "check which panel"),
        (lambda: line(panel(sd=0.0, variance=0.0)), "some panels have an error"),
        (lambda: pixels.fit_elm((panel(),)), "1 panel for an empirical line"),
        (lambda: pixels.fit_elm((panel("black", 0.0, 0.1),), intercept=False), "below 5 times"),
        (lambda: pixels.darkest_pixel_panel(OFFSET - 0.41, GAIN / 1e3, GAIN > 0, 0.0, 0.01), "unknown in 1 bands"),
        (lambda: pixels.empirical_roc([1, np.nan, 2], [0, 1]), "1 of 3 target scores are NaN"),
        (lambda: pixels.empirical_roc([], [0.0]), "no target scores"),
        (lambda: pixels.empirical_roc([1.0], []), "no background scores"),
        (lambda: pixels.empirical_roc([1.0], [0.0], 0.0), "must lie in"),
        (lambda: model.RocArea(0.2, 0.1), "no range of false-alarm probabilities"),
        (lambda: pixels.osp_filter(np.array([0.3, 0.7, 0.0]), EYE[:2]), "mixture of the undesired"),
        (lambda: model.mid_p_limits(3, 2), "between 0 and the number of trials"),
        (lambda: model.bounded_mean_limits([1.2]), "between 0 and 1"),
        (lambda: model.clopper_pearson(1, 2, 95.0), "expected: a number between 0 and 1"),
        (lambda: pixels.fit_tail_dof(np.ones(5), 2), "say nothing of tails"),
        (lambda: pixels.fit_tail_dof(np.ones(20), 20, estimated_on=20), "20 pixels for distances in 20 bands"),
        (lambda: pixels.fit_mixture(np.ones((30, 2)), 40, RNG), "40 components of 30 pixels"),
        (lambda: pixels.chosen_count(np.ones((30, 2)), np.zeros(30), (1, 2), RNG), "one block of the image"),
        (lambda: pixels.snr_decorrelated(np.ones((4, 5))), "at least 5"),
        (lambda: pixels.snr_decorrelated(np.ones((10, 2))), "two neighbours"),
        (lambda: pixels.snr_decorrelated(np.full((5, 3), np.nan)), "NaN"),
    ],
)
def test_what_has_no_answer_is_refused(call, words):
    with pytest.raises(UsageError, match=words):
        call()

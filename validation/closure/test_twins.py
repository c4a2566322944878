"""The twin under other seeds, and the broken twin under the twin's own criteria.

False failures.  Over the 30 seeds 2012 to 2041 the predicted P_D lay inside the measured 95 % interval in 585 of
600 cases at 1e-2 and 1e-3 together (97.5 %); a pool of 30 holds fewer than 27 with 0.7 %.  One right campaign in
twenty may find a criterion not met.  The seeds were chosen beforehand and are fixed: a failure here is a change of the
software, or of the random numbers that it draws, and not chance.
"""

from __future__ import annotations

import re
import shutil
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hyperval.campaign import load_job, run_campaign
from hyperval.compare import covariance, judge_rows
from hyperval.config import parse_yaml
from hyperval.results import Outcome, Result, ResultTable

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from small_campaign import write_yaml

TWIN = Path(__file__).parents[2] / "campaigns" / "share2012-twin"
SEEDS, LEVELS, FIELDS = (2012, 2013, 2014), ("1e-2", "1e-3"), ("grass-field", "asphalt-court")

pytestmark = pytest.mark.slow


def run_twin(name: str, seed: int, folder: Path) -> ResultTable:
    """What criteria of a twin ask for, whose scene is drawn with ``seed``: not why the sides differ, nor other spreads.

    Draws of the covariances of panels and planks take a fifth of a run, and no criterion is on them.
    """
    shutil.copytree(TWIN, folder, dirs_exist_ok=True)
    data, _ = parse_yaml((TWIN / name).read_text("utf-8"))
    scene = folder / data["collection"]["simulate"]
    scene.write_text(re.sub(r"(?m)^seed: .*$", f"seed: {seed}", scene.read_text("utf-8")), "utf-8")
    write_yaml(folder / name, {key: value for key, value in data.items() if key != "attribution"})
    compare = covariance.compare_covariance
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(covariance, "compare_covariance", lambda *x: compare(*x) if x[2] in FIELDS else ())
        return run_campaign(load_job(folder / name)).table


def detection(table: ResultTable, metric: str) -> list[Result]:
    """Rows of the ten fills, by pixel, the smallest fill of each colour first."""
    rows = [r for r in table.where(product="roc", method="cem/pixel", metric=metric) if "-fill-" in r.subject]
    assert len(rows) == 10
    return sorted(rows, key=lambda r: r.subject)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[int, ResultTable]:
    return {seed: run_twin("campaign.yaml", seed, tmp_path_factory.mktemp(f"seed{seed}")) for seed in SEEDS}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_right_model_meets_its_criteria_in_every_band_of_the_fields(runs, seed):
    assert not [r.key for r in runs[seed] if r.gates and r.outcome in (Outcome.DISAGREES, Outcome.ERROR)]
    # About 51,000 pixels: the standard error is 0.05 % and less, so that every single band must hold.
    worst = runs[seed].where(product="radiance", metric="max_abs_difference_ratio_windows")
    assert max(r.value for r in worst if r.subject in FIELDS) <= 0.01


@pytest.mark.parametrize("pfa", LEVELS)
def test_nine_of_ten_detection_probabilities_lie_inside_and_have_no_common_sign(runs, pfa):
    inside = [r.value for table in runs.values() for r in detection(table, f"pd_inside_measured_interval@{pfa}")]
    assert sum(inside) >= 27
    # A bias hides inside wide intervals; it shows in the mean over all cases.  Over 30 seeds the mean of a seed
    # scatters by 0.010 (and averages to -0.001), that of three by 0.006: 0.02 is 3.5 times that.
    gaps = [r.value for table in runs.values() for r in detection(table, f"pd_difference@{pfa}")]
    assert abs(float(np.mean(gaps))) <= 0.02


@pytest.mark.parametrize("pfa", LEVELS)
def test_the_interval_tells_a_fill_from_the_next(runs, pfa):
    # The check can fail: the prediction for the next larger plank must lie outside, save where both are certain.
    wrong = 0
    for table in runs.values():
        both = zip(detection(table, f"pd_measured@{pfa}"), detection(table, f"pd_predicted@{pfa}"), strict=True)
        for (here, _), (_, larger) in pairwise(both):
            same = here.subject.split("-")[0] == larger.subject.split("-")[0]
            wrong += same and not here.lower <= larger.value <= here.upper
    assert wrong >= 18  # of 24


def test_the_broken_twin_fails_the_criteria_of_closure(tmp_path):
    broken = run_twin("campaign-broken.yaml", 2012, tmp_path)
    table = ResultTable(judge_rows(list(broken), load_job(TWIN / "campaign.yaml").campaign.comparisons))
    failed = {row.product for row in table.where(outcome=Outcome.DISAGREES) if row.gates}
    assert failed >= {"radiance", "reflectance", "roc", "scores", "covariance"}
    for pfa in LEVELS:
        # Seeds 2012 to 2015 put 8 to 10 cases outside at 1e-2 and 9 at 1e-3; under closure it is 0 or 1.  The model
        # knows neither mixtures nor tails: it is too hopeful, not merely different.
        inside = detection(broken, f"pd_inside_measured_interval@{pfa}")
        gaps = [g.value for g, i in zip(detection(broken, f"pd_difference@{pfa}"), inside, strict=True) if not i.value]
        assert len(gaps) >= 6
        assert min(gaps) > 0.0
    # The model puts every plank in the middle of a pixel, where the collection leaves it as it fell.
    (lower,) = broken.where(product="scores", subject="green-fill-0.200", method="cem", metric="score_mean_difference")
    assert lower.lower > 0.0

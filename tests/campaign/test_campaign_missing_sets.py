"""A campaign whose data sets are not on the machine names them all in one command."""

from __future__ import annotations

from pathlib import Path

import pytest

from hyperval.campaign.dry_run import dry_run
from hyperval.campaign.job import Job, jobs_of
from hyperval.campaign.one import run_campaign
from hyperval.errors import UsageError
from hyperval.results import Outcome

PASADENA = Path(__file__).resolve().parents[2] / "campaigns" / "pasadena-2017" / "campaign.yaml"


def test_every_missing_set_is_named_at_once(tmp_path, monkeypatch):
    monkeypatch.delenv("HYPERVAL_DATA", raising=False)
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path))
    (job,) = jobs_of(PASADENA)
    assert isinstance(job, Job)
    rows = list(run_campaign(job).table)
    assert rows
    assert {row.outcome for row in rows} == {Outcome.SKIPPED}
    assert all(row.reason.endswith("hyperval data fetch pasadena aviris-ng") for row in rows)
    assert not any(str(tmp_path) in row.reason for row in rows)  # two machines write the same rows


@pytest.mark.parametrize("held", [True, False])
def test_a_mistyped_name_is_a_mistake_and_not_a_missing_set(small, tmp_path, monkeypatch, held):
    """Whether the data are at hand or not: what the registry cannot know is refused before anything runs."""
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path))
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "cache"))
    if held:
        (tmp_path / "hysu/published/svc").mkdir(parents=True)
        (tmp_path / "hysu/published/svc/DLR_HySU_SVC.lib").write_bytes(b"x")
    small.scenario["scene"]["panels"][0]["spectrum"] = {"file": "data:hysu/published/svc/DLR_HySU_SCV.lib"}
    path = small.write()
    with pytest.raises(UsageError, match="no such file in any registered data set") as caught:
        jobs_of(path)
    assert caught.value.exit_code == 2
    assert "data:hysu/published/svc/DLR_HySU_SVC.lib" in caught.value.expected
    assert "campaign.yaml: scenarios.scene.panels.spectrum.file" in caught.value.where
    (item,) = [i for i in dry_run([path]) if "SCV" in i.what]
    assert item.lacking
    assert "perhaps data:hysu/published/svc/DLR_HySU_SVC.lib" in item.detail

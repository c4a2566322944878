"""A campaign whose data sets are not on the machine names them all in one command."""

from __future__ import annotations

from pathlib import Path

from hyperval.campaign.one import Job, jobs_of, run_campaign
from hyperval.results import Status

PASADENA = Path(__file__).resolve().parents[2] / "campaigns" / "pasadena-2017" / "campaign.yaml"


def test_every_missing_set_is_named_at_once(tmp_path, monkeypatch):
    monkeypatch.delenv("HYPERVAL_DATA", raising=False)
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path))
    (job,) = jobs_of(PASADENA)
    assert isinstance(job, Job)
    rows = list(run_campaign(job).table)
    assert rows
    assert {row.status for row in rows} == {Status.SKIPPED}
    assert all(row.reason.endswith("hyperval data fetch pasadena aviris-ng solar") for row in rows)

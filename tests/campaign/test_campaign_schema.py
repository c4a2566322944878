"""Mistakes in a campaign file: each with its file and line, all at once, and what was probably meant."""

from pathlib import Path

import pytest

from hyperval.campaign import job_of, read_jobs
from hyperval.errors import UsageError
from small_campaign import DATA, data_of

ROOT = Path(__file__).parents[2]
GOOD = (DATA / "lawn.yaml").read_text()
SPECTRA = GOOD[GOOD.index("  spectra:") : GOOD.index("scenarios:")]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "campaigns").glob("*/campaign*.yaml")), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_the_campaigns_of_the_project_are_valid(path):
    # A campaign with values to be filled in has tests of its own.
    waiting = "FILL_IN" in path.read_text()
    for campaign in [read_jobs(path)[0].outline] if waiting else [job.campaign for job in read_jobs(path)]:
        assert any(gate.gate for gate in campaign.comparisons) or "broken" in campaign.name
        assert campaign.assumptions


@pytest.mark.parametrize(("old", "new", "line", "message"), data_of("lawn_mistakes"))
def test_each_mistake_is_named_with_its_line_and_nothing_else(tmp_path, old, new, line, message):
    path, replaced = tmp_path / "campaign.yaml", SPECTRA if old == "SPECTRA" else old
    assert replaced in GOOD
    path.write_text(GOOD.replace(replaced, new))
    with pytest.raises(UsageError, match=message) as caught:
        job_of(path)
    assert f"campaign.yaml:{line}:" in str(caught.value)
    assert caught.value.exit_code == 2
    # Of a scenario alone: neither of a day that it is not, nor keys that a scenario has as unknown.
    assert "did you mean 'scene'" not in str(caught.value)
    assert "radcalnet: Field" not in str(caught.value) or "radcalnet" in message

"""The power of a campaign: what its gates see of errors injected into its model, and what they do not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hyperval.campaign.job import jobs_of
from hyperval.campaign.one import run_campaign
from hyperval.campaign.power import Power, power, power_table, turned
from hyperval.errors import UsageError
from hyperval.metrics import Evidence
from hyperval.report.html import report_page
from hyperval.report.run import Injected, PowerTable, Sight, accepted_table, gate_values, own_files, write_power_table
from hyperval.results import Outcome, Result, Role
from hyperval.uncertainty.injected import InjectedError, injected_errors

BRIGHT, QUIET, TAILS = "sunlight x 1.05", "noise x 1.5", "tails left out"
SUBJECTS = ["white-panel", "grey-panel-35"]
DIGEST = "ab" * 32


def some_errors(*names: str) -> list[InjectedError]:
    return [e for e in injected_errors() if e.name in names]


def on_radiance_alone(small, limit: float) -> list:
    small.gate("radiance").update(subjects=SUBJECTS, at_most=limit)
    small.data["comparisons"] = [small.gate("radiance")]
    small.data["detection"] = None
    del small.data["detection"], small.data["collection"]["targets"]
    small.scenario["scene"].pop("targets")
    return jobs_of(small.write())


def table(**more) -> PowerTable:
    fields = {
        "schema": 1, "campaign": "small", "version": "0", "files": {"campaign.yaml": DIGEST}, "gates": 2,
        "disagreeing": 0,
        "errors": {
            BRIGHT: Injected(gates=("radiance | grass | sixs | bias_ratio",), informing={"snr": 1}),
            "blur x 1.5": Injected(informing={"roc": 2}),
            QUIET: Injected(),
            TAILS: Injected(not_applicable="no class has tails"),
        },
    }  # fmt: skip
    return PowerTable.model_validate({**fields, **more})


def row(outcome, subject="grass", role=Role.GATE, **more) -> Result:
    return Result("small", "radiance", subject, "sixs", "bias_ratio", 0.1, outcome=outcome, role=role, **more)


@pytest.mark.slow
def test_a_gate_sees_what_it_can_and_one_that_nothing_fails_sees_nothing(make_small):
    """A limit that nearly nothing breaks makes the same error unseen: what a table says follows from the gates."""
    (job,) = on_radiance_alone(make_small("sound"), 0.02)
    found = power_table(job, errors=some_errors(BRIGHT, QUIET, TAILS))
    assert {n: p.sight for n, p in found.errors.items()} == {
        BRIGHT: Sight.GATES, QUIET: Sight.UNSEEN, TAILS: Sight.NOT_APPLICABLE,
    }  # fmt: skip
    assert [name.split(" | ")[1] for name in found.errors[BRIGHT].gates] == SUBJECTS
    assert found.errors[TAILS].not_applicable == "no class has tails"
    assert (found.gates, found.disagreeing, found.campaign) == (2, 0, "small")
    assert set(found.files) == {"campaign.yaml", "sensor.yaml"}
    (job,) = on_radiance_alone(make_small("falsified"), 0.9)
    assert not power_table(job, errors=some_errors(BRIGHT)).errors[BRIGHT].gates


def test_only_what_turns_counts():
    before = [row(Outcome.AGREES), row(Outcome.DISAGREES, "roof"), row(Outcome.UNDECIDED, "lawn", Role.INFORM)]
    after = [row(Outcome.DISAGREES), row(Outcome.DISAGREES, "roof"), row(Outcome.DISAGREES, "lawn", Role.INFORM)]
    found = turned(before, after)
    assert found.gates == ("radiance | grass | sixs | bias_ratio",)
    assert found.informing == {"radiance": 1}
    assert turned(before, [replace(r, outcome=Outcome.UNDECIDED) for r in after]).sight is Sight.UNSEEN
    two = [row(Outcome.AGREES, limit_high=h) for h in (0.1, 0.2)]
    assert turned([replace(two[0], outcome=Outcome.DISAGREES), two[1]], [
        replace(r, outcome=Outcome.DISAGREES) for r in two
    ]).gates == ("radiance | grass | sixs | bias_ratio",)  # fmt: skip
    assert row(Outcome.AGREES).evidence is Evidence.MODEL


def test_the_sentence_names_what_goes_unseen():
    assert table().sentence == (
        "The criteria detect 1 of 3 injected model errors. Informational comparisons alone detect: blur x 1.5. "
        "Undetected: noise x 1.5. Not applicable: tails left out."
    )
    assert table(disagreeing=2).sentence.endswith("2 criteria that are not met already cannot detect any.")


def test_a_table_is_stored_and_read_back(tmp_path):
    write_power_table(tmp_path / "small.yaml", table())
    assert accepted_table("small", tmp_path) == table()
    assert accepted_table("other", tmp_path) is None
    (tmp_path / "other.yaml").write_text((tmp_path / "small.yaml").read_text())
    with pytest.raises(UsageError, match="is the power table of 'small'"):
        accepted_table("other", tmp_path)


def test_files_that_changed_since_are_named():
    inputs = [
        {"reference": "campaign.yaml", "sha256": DIGEST}, {"reference": "data:set/cube.hdr", "sha256": "0"},
        {"reference": "scenario.yaml", "sha256": DIGEST},
    ]  # fmt: skip
    assert own_files(inputs) == {"campaign.yaml": DIGEST, "scenario.yaml": DIGEST}
    assert table().changed_files(inputs) == ["scenario.yaml"]
    assert table().changed_files([{"reference": "campaign.yaml", "sha256": "1"}]) == ["campaign.yaml"]
    assert table(files=own_files(inputs)).changed_files(inputs) == []


def test_a_table_is_old_where_a_gate_has_another_value_now():
    """The code may have changed and no file of the campaign: what the gates gave then stands in the table."""
    then = table(stated=gate_values([row(Outcome.AGREES), row(Outcome.AGREES, "roof")]))
    assert then.stated == {f"radiance | {s} | sixs | bias_ratio": 0.1 for s in ("grass", "roof")}
    now = [row(Outcome.AGREES), row(Outcome.AGREES, "roof"), row(Outcome.AGREES, "lawn", Role.INFORM)]
    assert then.moved_gates(now) == []
    assert then.moved_gates([now[0], replace(now[1], value=0.2)]) == ["radiance | roof | sixs | bias_ratio"]
    assert then.moved_gates(now[:1]) == ["radiance | roof | sixs | bias_ratio"]
    assert then.moved_gates([*now, row(Outcome.AGREES, "pond")]) == ["radiance | pond | sixs | bias_ratio"]


def test_an_error_that_is_seen_otherwise_than_accepted_is_a_change():
    now = table(errors={BRIGHT: Injected(), QUIET: Injected()})
    assert Power("small", now, accepted=table(errors={BRIGHT: table().errors[BRIGHT]})).changes == [
        "sunlight x 1.05: unseen, accepted: gates",
        "noise x 1.5: unseen, accepted: not in the table",
    ]
    assert Power("small", table(), accepted=table()).changes == []
    assert Power("small", now).changes == []


@pytest.mark.slow
def test_tables_are_written_accepted_and_shown(small, tmp_path, monkeypatch):
    """From the command's function to the page: the first screen names what goes unseen; an old table says so."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hyperval.campaign.power.injected_errors", lambda: some_errors(BRIGHT, QUIET, TAILS))
    path = on_radiance_alone(small, 0.02)[0].path
    (found,) = power([path], output=tmp_path / "out", accept=True)
    assert sorted(p.name for p in (tmp_path / "out").glob("*.*") if not p.name.startswith(".")) == [
        "power.csv", "small.yaml",
    ]  # fmt: skip
    lines = (tmp_path / "out" / "power.csv").read_text().splitlines()
    assert lines[1].startswith("small,sunlight x 1.05,gates,2,")
    assert lines[2:] == [
        "small,noise x 1.5,unseen,0,0,",
        "small,tails left out,not applicable,0,0,no class has tails",
    ]
    assert accepted_table("small") == found.table
    run = run_campaign(jobs_of(path)[0])
    page = report_page(run, [])
    assert "Undetected: noise x 1.5." in page[: page.index("<nav")]
    assert "The table is" not in page
    changed = [{**i, "sha256": "0"} if i["reference"] == "campaign.yaml" else i for i in run.provenance["inputs"]]
    page = report_page(replace(run, provenance={**run.provenance, "inputs": changed}), [])
    assert "The table is older than campaign.yaml" in page[: page.index("<nav")]
    old = found.table.model_copy(update={"stated": dict.fromkeys(found.table.stated, 0.5)})
    assert "The table is old: 2 of its criteria had other values" in report_page(replace(run, power=old), [])
    assert "What this campaign could have found is not known" in report_page(replace(run, power=None), [])


def test_a_campaign_is_named_once(small):
    path = small.write()
    with pytest.raises(UsageError, match="two campaigns are named 'small'"):
        power([path, path])

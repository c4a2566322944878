"""The power of a campaign: what its gates see of errors injected into its model, and what they do not."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from hyperval import campaign, cli
from hyperval.attribute import injected_errors
from hyperval.errors import UsageError
from hyperval.report import report_page
from hyperval.results import Outcome, Result, Role

BRIGHT, QUIET, TAILS = "sunlight x 1.05", "noise x 1.5", "tails left out"
SUBJECTS = ["white-panel", "grey-panel-35"]
DIGEST = "ab" * 32


def some_errors(*names):
    return {name: error for name, error in injected_errors().items() if name in names}


def on_radiance_alone(small, **limit: float) -> Path:
    gate = {k: v for k, v in small.gate("radiance").items() if k != "at_most"}
    small.data["comparisons"] = [gate | limit | {"subjects": SUBJECTS}]
    del small.data["detection"], small.data["collection"]["targets"]
    small.scenario["scene"].pop("targets", None)
    return small.write()


ERRORS = {
    BRIGHT: campaign.InjectedError(gates=("radiance | grass | sixs | bias_ratio",), informing={"snr": 1}),
    "PSF width x 1.5": campaign.InjectedError(informing={"roc": 2}),
    QUIET: campaign.InjectedError(),
    TAILS: campaign.InjectedError(not_applicable="no class has tails"),
}


def table(**more) -> campaign.PowerTable:
    fields = {"campaign": "small", "version": "0", "files": {"campaign.yaml": DIGEST}, "gates": 2, "disagreeing": 0}
    return campaign.PowerTable.model_validate({"schema": 1, "errors": ERRORS, **fields, **more})


def row(outcome, subject="grass", role=Role.GATE, **more) -> Result:
    return Result("small", "radiance", subject, "sixs", "bias_ratio", 0.1, outcome=outcome, role=role, **more)


@pytest.mark.slow
def test_only_what_turns_counts_and_a_gate_that_nothing_fails_sees_nothing(make_small, monkeypatch):
    """A limit that nearly nothing breaks, or one that is broken already, makes the same error unseen."""
    monkeypatch.setattr("hyperval.compare.covariance.sampled", lambda *words: None)  # no criterion is on a spread
    monkeypatch.setattr("hyperval.campaign.power.WORLDS", 1)  # how often causes are named is not looked at
    (job,) = campaign.load_jobs(on_radiance_alone(make_small("sound"), at_most=0.02))
    found = campaign.power_table(job, errors=some_errors(BRIGHT, QUIET, TAILS))
    sights = [campaign.DetectedBy.GATES, campaign.DetectedBy.INFORMING, campaign.DetectedBy.NOT_APPLICABLE]
    assert [p.detected_by for p in found.errors.values()] == sights
    assert [name.split(" | ")[1] for name in found.errors[BRIGHT].gates] == SUBJECTS
    assert (found.gates, found.disagreeing, found.campaign) == (2, 0, "small")
    assert set(found.files) == {"campaign.yaml", "sensor.yaml"}
    (job,) = campaign.load_jobs(on_radiance_alone(make_small("loose"), at_most=0.9))
    assert not campaign.power_table(job, errors=some_errors(BRIGHT)).errors[BRIGHT].gates
    (job,) = campaign.load_jobs(on_radiance_alone(make_small("broken"), within=[0.5, 0.6]))
    broken = campaign.power_table(job, errors=some_errors(BRIGHT))
    # One is not met without the error, and does not count with it; the other was inconclusive.
    assert (broken.gates, broken.disagreeing) == (1, 1)
    assert [name.split(" | ")[1] for name in broken.errors[BRIGHT].gates] == ["white-panel"]


def test_the_sentence_names_what_goes_unseen():
    assert table().sentence == (
        "The criteria detect 1 of 3 injected model errors. Informational comparisons alone detect: PSF width x 1.5. "
        "Undetected: noise x 1.5. Not applicable: tails left out."
    )
    assert table(disagreeing=2).sentence.endswith("2 criteria that are already not met cannot detect any.")


def test_a_table_is_stored_and_read_back_and_says_what_is_younger(tmp_path):
    (place := tmp_path / "validation/power").mkdir(parents=True)
    campaign.write_power_table(place / "small.yaml", table())
    assert campaign.accepted_table("small", tmp_path / "copies" / "of it") == table()
    assert campaign.accepted_table("other", tmp_path) is None
    (place / "other.yaml").write_text((place / "small.yaml").read_text())
    with pytest.raises(UsageError, match="is the power table of 'small'"):
        campaign.accepted_table("other", tmp_path)
    inputs = [
        {"reference": "campaign.yaml", "sha256": DIGEST}, {"reference": "data:set/cube.hdr", "sha256": "0"},
        {"reference": "scenario.yaml", "sha256": DIGEST},
    ]  # fmt: skip
    assert campaign.own_files(inputs) == {"campaign.yaml": DIGEST, "scenario.yaml": DIGEST}
    assert table().changed_files(inputs) == ["scenario.yaml"]
    assert table().changed_files([{"reference": "campaign.yaml", "sha256": "1"}]) == ["campaign.yaml"]
    # The code may have changed and no file of the campaign: what the gates gave then stands in the table.
    then = table(stated=campaign.gate_values([row(Outcome.AGREES), row(Outcome.AGREES, "roof")]))
    now = [row(Outcome.AGREES), row(Outcome.AGREES, "roof"), row(Outcome.AGREES, "lawn", Role.INFORM)]
    assert then.changed_gates(now) == []
    assert then.changed_gates([now[0], replace(now[1], value=0.2)]) == ["radiance | roof | sixs | bias_ratio"]
    assert then.changed_gates([*now, row(Outcome.AGREES, "pond | a")]) == ["radiance | pond | a | sixs | bias_ratio"]


@pytest.mark.slow
def test_tables_are_written_accepted_shown_and_changes_told(small, tmp_path, monkeypatch, capsys):
    """From the command to the page: the first screen names what goes unseen; an old table says so."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hyperval.compare.covariance.sampled", lambda *words: None)  # no criterion is on a spread
    monkeypatch.setattr("hyperval.campaign.power.WORLDS", 1)
    monkeypatch.setattr("hyperval.attribute.injected_errors", lambda: some_errors(BRIGHT, QUIET, TAILS))
    small.data["attribution"] = {}
    path = on_radiance_alone(small, at_most=0.02)
    assert cli.run(["power", str(path), "-o", "out", "--accept"]) == 0
    assert sorted(p.name for p in Path("out").glob("*.*") if not p.name.startswith(".")) == ["power.csv", "small.yaml"]
    lines = Path("out/power.csv").read_text().splitlines()
    assert lines[1].startswith("small,sunlight x 1.05,criteria,2,")
    informing, without = "informational comparisons,0,1,", "not applicable,0,0,no class has tails"
    assert lines[2:] == [f"small,noise x 1.5,{informing}", f"small,tails left out,{without}"]
    run = campaign.run_campaign(campaign.load_jobs(path)[0])
    assert run.power is not None
    page = report_page(run, [])
    assert "Informational comparisons alone detect: noise x 1.5." in page[: page.index("<nav")]
    assert "The table is" not in page
    assert "Which errors this campaign would detect is not known" in report_page(replace(run, power=None), [])
    known, inputs = campaign.accepted_table("small", tmp_path), run.provenance["inputs"]
    changed = [{**i, "sha256": "0"} if i["reference"] == "campaign.yaml" else i for i in inputs]
    younger = report_page(replace(run, power=(known, known.outdated(changed, run.table))), [])
    assert "The table is older than campaign.yaml" in younger[: younger.index("<nav")]
    old = known.model_copy(update={"stated": dict.fromkeys(known.stated, 0.5)})
    assert old.outdated(inputs, run.table).startswith("The table is outdated: 2 of its criteria had different values")
    errors = {BRIGHT: campaign.InjectedError(), "another": campaign.InjectedError(), TAILS: known.errors[TAILS]}
    campaign.write_power_table(tmp_path / "validation/power/small.yaml", known.model_copy(update={"errors": errors}))
    capsys.readouterr()
    assert cli.run(["power", str(path)]) == 1
    said = capsys.readouterr().err
    assert "sunlight x 1.05: criteria, accepted: undetected" in said
    assert "noise x 1.5: informational comparisons, accepted: not in the table" in said
    assert "another: not in the table, accepted: undetected" in said

    monkeypatch.setattr("hyperval.campaign.products.outcomes", lambda *_: [])  # what follows asks for reasons alone

    def since() -> str:
        rows = campaign.run_campaign(campaign.load_jobs(small.write())[0]).table
        return next(iter(rows.where(subject="since the accepted run", metric="reduced_chi_square"))).reason

    small.scenario["uncertainty"] = {"sensor_gain": {"relative": 0.05}}
    assert since().startswith("check the stated uncertainty (reduced chi-square ")
    del small.scenario["uncertainty"]
    small.scenario["atmosphere"]["aot550"] *= 1.5
    assert since().startswith("check the aerosol optical depth (x 0.66")
    small.scenario["atmosphere"]["aot550"] /= 1.5
    small.scenario["sensor_changes"] = {"fixed_noise_factor": 2.5}
    assert "noise without signal" in since()
    del small.scenario["sensor_changes"]
    small.data["collection"]["cube"]["scale"] = 1e-2  # the header's is 1e-3
    assert since().startswith("check the unit of the measured spectra (x 10 explains 100 %")
    del small.data["collection"]["cube"]["scale"]
    corner = re.compile(r"\[(\d+\.?\d*), (\d+\.?\d*)\]")
    small.edit("regions.geojson", lambda text: corner.sub(lambda m: f"[{float(m[1]) - 1}, {float(m[2]) + 1}]", text))
    assert since().startswith("check the position of the regions (-1 lines, +1 samples explains 99 %")

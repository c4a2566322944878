"""Campaigns and sensors of the project: references, words, numbers with their sources."""

import re
from pathlib import Path

import pytest

from hyperval.attribute import injected_errors
from hyperval.campaign import accepted_table, load_job
from hyperval.config import load_yaml
from hyperval.datasets import owner_of
from hyperval.metrics import plain_words
from hyperval.results import Outcome
from hyperval.sensor import library_names, load_sensor
from hyperval.sensor_check import SensorNumber, check_sensor, numbers
from hyperval.storage import sha256_of
from small_campaign import stand_in_atmosphere

# A newcomer gets every file that a campaign names, and reads in words what its comparisons are of; power tables.


ROOT = Path(__file__).parents[2]


def test_every_data_reference_of_a_campaign_is_registered():
    unknown = {
        f"{path.relative_to(ROOT)}: {reference}"
        for path in (ROOT / "campaigns").rglob("*.yaml")
        for pair in re.findall(r"""["'](data:[^"']+)["']|(?<!["'])(data:[^\s"',\]}#]+)""", path.read_text("utf-8"))
        for reference in pair
        if reference and owner_of(reference) is None
    }
    assert unknown == set()


@pytest.mark.parametrize("path", sorted((ROOT / "campaigns").glob("*/campaign*.yaml")), ids=lambda p: p.parent.name)
def test_first_screens_name_no_metric_by_its_identifier(path):
    for item in load_yaml(path)[0]["comparisons"]:
        metric = item["metric"] + "_fraction" * ("fraction_at_least" in item)
        assert "_" not in plain_words(metric, item["product"])


@pytest.mark.parametrize(
    ("campaign", "metric"),
    [
        ("hysu-2018", "pit_uniformity_p_value"),
        ("share2012-independent", "median_difference_ratio_vnir"),
        ("share2012-independent", "median_difference_ratio_swir1"),
        ("share2012-independent", "p_value_full"),
        ("radcalnet-baotou-2018", "median_difference_ratio_windows"),
    ],
)
def test_what_was_set_after_the_data_were_seen_says_so_and_what_it_was_before(campaign, metric):
    """As the history of the files and the changelog have it."""
    gates = load_job(ROOT / "campaigns" / campaign / "campaign.yaml").campaign.comparisons
    marked = [gate for gate in gates if gate.metric == metric]
    assert marked
    assert all(gate.chosen_after and gate.before for gate in marked)


TABLES = sorted((ROOT / "validation" / "power").glob("*.yaml"))


@pytest.mark.parametrize("path", TABLES or [None], ids=lambda path: path.stem)
def test_an_accepted_power_table_has_each_standard_error_its_gates_and_the_files_of_a_campaign(path):
    table = accepted_table(path.stem, ROOT)
    assert table is not None
    assert list(table.errors) == list(injected_errors())
    assert 0 < len(table.stated) <= table.gates + table.disagreeing
    folders = [p.parent for p in (ROOT / "campaigns").glob("*/campaign*.yaml") if p.name in table.files]
    # A criterion more, or a limit that is another, makes it stale: hyperval power --accept.
    now = [{name: sha256_of(folder / name) for name in table.files if (folder / name).is_file()} for folder in folders]
    assert table.files in now
    named = {gate for injected in table.errors.values() for gate in injected.gates}
    assert len(named) <= table.gates  # no more turn than could


# Every number of the sensor library stands with a source or the word "assumed"; every sensor passes its checks.


DOCS = Path(__file__).parents[2] / "docs" / "sensors.md"
# A source says where a number is from: a document, a derivation, or that it is assumed and why.
_EMPTY = re.compile(r"^(assumed[:\s]*|source|unknown|not stated|n/?a|-+)$", re.IGNORECASE)


def without_source(listed: list[SensorNumber]) -> list[str]:
    """Names of the numbers whose source says nothing."""
    return [n.name for n in listed if len(n.source) < 8 or _EMPTY.match(n.source.strip())]


def test_the_page_names_every_sensor():
    text = DOCS.read_text("utf-8")
    assert [name for name in library_names() if name not in text] == []


@pytest.mark.parametrize("name", library_names())
def test_every_number_has_a_source(name):
    specification = load_sensor(name).specification
    listed = numbers(specification)
    assert len(listed) >= 3
    assert without_source(listed) == []
    for item in specification.published_snr:  # or it says that it has none
        assert item.radiance is not None or item.scene is not None or "no radiance is stated" in item.source


def test_the_check_of_sources_sees_an_empty_one():
    sources = {"a": "assumed", "b": "assumed: typical CCD", "c": "not stated"}
    assert without_source([SensorNumber(name, "1", "", said) for name, said in sources.items()]) == ["a", "c"]


# The atmosphere is the stand-in: ratios published for a scene are compared in it elsewhere, with the solver.
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in ("hydice", "prisma") else pytest.mark.slow) for n in library_names()]
)
def test_every_sensor_passes_the_suite(name):
    check = check_sensor(name, engine=stand_in_atmosphere, vary=0.2)
    scenes = {f"{r[0]:g} nm" for i in check.sensor.specification.published_snr if i.scene for r in i.table}
    bad = [
        (r.product, r.subject, r.metric)
        for r in check.table
        if r.outcome in (Outcome.DISAGREES, Outcome.ERROR, Outcome.SKIPPED)
        and not (r.product == "published_snr" and r.subject in scenes)
    ]
    assert bad == []

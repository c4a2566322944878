"""Every number of the sensor library stands with a source or the word "assumed"; every sensor passes its checks."""

import re
from pathlib import Path

import pytest

from hyperval.results import Outcome
from hyperval.sensor import library_names, load_sensor
from hyperval.sensor_check import Number, check_sensor, numbers
from small_campaign import stand_in_atmosphere

DOCS = Path(__file__).parents[2] / "docs" / "sensors.md"
# A source says where a number is from: a document, a derivation, or that it is assumed and why.
_EMPTY = re.compile(r"^(assumed[:\s]*|source|unknown|not stated|n/?a|-+)$", re.IGNORECASE)


def without_source(listed: list[Number]) -> list[str]:
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
    listed = [Number("a", "1", "assumed"), Number("b", "1", "assumed: typical CCD"), Number("c", "1", "not stated")]
    assert without_source(listed) == ["a", "c"]


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

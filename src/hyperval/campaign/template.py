"""Campaigns of several runs, such as flight lines: one text, in which words in braces differ from run to run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from hyperval.config import Location
from hyperval.errors import UsageError

MAX_RUNS = 100


def campaign_runs(data: Any, lines: dict[Location, int], name: str) -> list[tuple[dict[str, str], Any]]:
    """The words and the content of every run of a campaign file; one without words where it lists none.

    ``runs`` is a list of mappings from a word to a text; ``{word}`` stands for the text wherever it occurs in the
    file and in its scenario files.

    Raises
    ------
    UsageError : runs that are no such list, or whose words differ or are not used.
    """
    if not isinstance(data, dict) or "runs" not in data:
        return [({}, data)]
    runs = data["runs"]
    rest = {key: value for key, value in data.items() if key != "runs"}
    where = f"{name}:{lines.get(('runs',), 1)}"
    good = isinstance(runs, list) and 0 < len(runs) <= MAX_RUNS
    if not good or not all(isinstance(run, dict) and run for run in runs):
        raise UsageError("'runs' is no list of runs", where=where, expected="- {run: 0920-1631, start: ...}")
    for i, run in enumerate(runs):
        at = f"{name}:{lines.get(('runs', i), 1)}"
        wrong = [key for key, text in run.items() if not re.fullmatch(r"\w+", key) or not isinstance(text, str)]
        if wrong or run.keys() != runs[0].keys():
            raise UsageError(
                f"the run has {', '.join(wrong) if wrong else 'other words than the first'}",
                where=at,
                expected="the same words in every run, each with a text (in quotation marks where it is a number)",
            )
    return [(dict(run), with_words(rest, run)) for run in runs]


def with_words(content: Any, words: Mapping[str, str]) -> Any:
    """The content with ``{word}`` replaced in every text; other braces stay as they are."""
    if isinstance(content, dict):
        return {key: with_words(value, words) for key, value in content.items()}
    if isinstance(content, list):
        return [with_words(value, words) for value in content]
    if isinstance(content, str):
        for word, text in words.items():
            content = content.replace(f"{{{word}}}", text)
    return content

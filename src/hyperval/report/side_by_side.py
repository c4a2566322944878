"""Two runs side by side: what changed its verdict, what moved, both runs' curves in one chart, their pictures."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hyperval.errors import refuse
from hyperval.figures import first_figures, outcome_words
from hyperval.report import verdict as v
from hyperval.report.html import embed_images, flatten, page
from hyperval.results import WORST_FIRST, Cause, Outcome, Pair, Result, ResultTable, paired
from hyperval.run import Run, to_xarray
from hyperval.storage import whole_folder

_FIGURE_BYTES = 4_200_000


def compare_runs(one: Path, other: Path, output: Path) -> str:
    """Write a page that sets two folders of results side by side, and the differences as a results table.

    Returns
    -------
    What differs, in a sentence.

    Raises
    ------
    InputError : a folder that holds no results.
    UsageError : two runs that have no comparison in common.
    """
    a, b = Run.open(one), Run.open(other)
    pairs = paired(a.table, b.table)
    refuse(not any(p.a and p.b for p in pairs), "results.common", f"{one}, {other}")
    with whole_folder(output, beside=(one, other)) as folder:
        Run(difference_table(pairs)).write(folder, side_by_side_page(a, b, pairs))
    return conclusion(pairs)


def conclusion(pairs: Sequence[Pair]) -> str:
    """What differs between two runs, and what differs most.

    >>> a, b = (Result("c", "radiance", "lawn", "sixs", "bias_ratio", value) for value in (0.01, 0.03))
    >>> print(conclusion([Pair(a, a), Pair(b, b)]))
    Identical: all 2 comparisons have the same value and outcome in both runs.
    >>> print(conclusion([Pair(a, a), Pair(a, None), Pair(a, b)]))
    Changed or in one run only: 2 of 3 comparisons, most radiance lawn sixs bias_ratio: 0.01 in A, 0.03 in B.
    >>> rounding = (Result("c", "scores", "all", "cem", "score_mean_observed", x) for x in (2e-17, -3e-17))
    >>> a, b = (replace(row, lower=row.value - 0.1, upper=row.value + 0.1) for row in (a, b))
    >>> print(conclusion([Pair(*rounding), Pair(a, b)]).partition("most ")[2])
    radiance lawn sixs bias_ratio: 0.01 in A, 0.03 in B.
    """
    changed = [p for p in pairs if not p.is_same]
    if not changed:
        return f"Identical: all {len(pairs)} comparisons have the same value and outcome in both runs."
    most = max(changed, key=lambda p: (p.gates and p.verdict_changed, p.size))
    a, b = (v.value_text(row) if row else "none" for row in (most.a, most.b))
    count = f"Changed or in one run only: {len(changed)} of {len(pairs)} comparisons"
    return f"{count}, most {most.name}: {a} in A, {b} in B."


def difference_table(pairs: Sequence[Pair]) -> ResultTable:
    """One row for each comparison that both runs have, its value B minus A; the others are skipped."""
    rows = []
    for p in pairs:
        r = p.either
        row = Result(r.campaign, r.product, r.subject, r.method, f"{r.metric}_change", unit=r.unit, band_nm=r.band_nm)
        if p.a and p.b:
            words = f"A {v.value_text(p.a)} ({p.a.outcome.word}), B {v.value_text(p.b)} ({p.b.outcome.word})"
            rows.append(replace(row, value=p.difference, reason=words))
        else:
            only = f"only in run {'A' if p.a else 'B'}"
            rows.append(replace(row, outcome=Outcome.SKIPPED, cause=Cause.ONE_RUN, reason=only))
    return ResultTable(rows)


def side_by_side_page(a: Run, b: Run, pairs: Sequence[Pair]) -> str:
    """The page: both verdicts, verdicts that changed, what moved most, provenance that differs, figures."""
    changed = [p for p in pairs if p.verdict_changed]
    changed.sort(key=lambda p: WORST_FIRST.index((p.b or p.either).outcome))
    moved = sorted((p for p in pairs if p.size > 0 and not p.verdict_changed), key=lambda p: -p.size)
    summary_rows = [p for p in moved if not math.isfinite(p.either.band_nm)]
    # Of their predictions, or of their collections where those alone differ: B first, so that differences are B - A.
    both = [(y, x) for x, y in zip(a.pair, b.pair, strict=True) if x and y and not to_xarray(x).equals(to_xarray(y))]
    charts = first_figures(both[0], names=("run B", "run A")) if both and (moved or changed) else []
    equal = [n for n, path in a.figures.items() if n in b.figures and path.read_bytes() == b.figures[n].read_bytes()]
    first, second = flatten(a.provenance), flatten(b.provenance)
    folders = [(run.folder or Path()).resolve() for run in (a, b)]
    above = os.path.commonpath([folder.parent for folder in folders])
    labels = zip("AB", (a, b), (folder.relative_to(above).as_posix() for folder in folders), strict=True)
    return page(
        "pair.html.j2", charts,
        runs=[{"label": label, "folder": name, "screen": v.first_screen(list(run.table)),
               "counts": outcome_words(run.table)} for label, run, name in labels],
        changed=changed,
        moved=summary_rows,
        bands=len(moved) - len(summary_rows),
        single=[p for p in pairs if not (p.a and p.b) and not p.gates and not math.isfinite(p.either.band_nm)],
        same=sum(p.is_same for p in pairs),
        is_identical=all(p.is_same for p in pairs),
        conclusion=conclusion(pairs),
        inputs=[(k, first.get(k, "–"), second.get(k, "–")) for k in first | second if first.get(k) != second.get(k)],
        charts=charts,
        figures=_different_figures(a, b, equal),
        equal=equal,
        number=v.number_text,
    )  # fmt: skip


def _different_figures(a: Run, b: Run, equal: Sequence[str]) -> list[dict[str, Any]]:
    """Figures that are not the same in both runs, as data; beyond the size of the page they are named only."""
    names = [name for name in dict.fromkeys([*a.figures, *b.figures]) if name not in equal]
    paths = {(name, run): each.figures.get(name) for name in names for run, each in zip("AB", (a, b), strict=True)}
    files = ((key, path.read_bytes(), path.suffix[1:]) for key, path in paths.items() if path)
    sources = embed_images(files, _FIGURE_BYTES)
    sides = {key: {"source": sources.get(key, ""), "there": path is not None} for key, path in paths.items()}
    return [{"name": name.rsplit(".", 1)[0], "sides": [sides[name, "A"], sides[name, "B"]]} for name in names]

"""``report.html`` of a study."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyperval.report.html import common_words, environment
from hyperval.report.style import Drawing
from hyperval.report.verdict import number_text
from hyperval.study.plan import Plan
from hyperval.study.schema import Input, Output
from hyperval.study.summary import CurveKnee, words_of
from hyperval.study.tables import StudyTable

_MOST_REASONS = 12
_MOST_VALUES = 12
_MOST_KNEES = 24


def study_page(
    plan: Plan,
    table: StudyTable,
    drawings: Sequence[Drawing],
    record: Mapping[str, Any],
    names: Sequence[str],
    knees: Sequence[CurveKnee],
) -> str:
    """The page: figures first, then answers, knees, what moved, what was asked, and how it was evaluated."""
    study = plan.study
    questions = {q.name: q for q in study.required}
    return (
        environment()
        .get_template("study.html.j2")
        .render(
            **common_words(),
            study=study,
            scenario=plan.scenario,
            title=study.title or study.name,
            summary=f"{len(table.values):,} points were evaluated; nothing here passes or fails. "
            f"Tables: {', '.join(names)}.",
            figures=[{"drawing": d, "source": d.source} for d in drawings],
            from_words=f"From {names[0]}; study {study.name}, scenario {plan.scenario.name}",
            answers=[_answer(table, f.name, questions[f.name]) for f in table.outputs if f.name in questions],
            knees=[_knee(k) for k in knees[:_MOST_KNEES]],
            knees_left_out=max(0, len(knees) - _MOST_KNEES),
            inputs=[_input(i) for i in study.inputs],
            outputs=[_output(plan, table, o) for o in study.outputs],
            has_error=bool(plan.sky_error),
            notes=_notes(plan),
            reasons=_reasons(table),
            record=record,
        )
    )


def _answer(table: StudyTable, name: str, question: Any) -> dict[str, Any]:
    values = np.asarray(table.column(name), float)
    finite = values[np.isfinite(values)]
    words = [t.split(f"{name}: ", 1)[1].split("; ")[0] for t in table.reasons.values() if f"{name}: " in t]
    common = Counter(words).most_common(1)
    kinds = {k: number_text(float(f(finite))) if finite.size else "–" for k, f in _THREE.items()}
    return {
        "words": f"{question.words} for {question.output} = {number_text(question.equals)}, "
        f"looked for from {number_text(question.between[0])} to {number_text(question.between[1])}",
        "solved": finite.size, "n": values.size,
        "why": f"{len(words)} points, such as: {common[0][0]}" if common else "", **kinds,
    }  # fmt: skip


_THREE: dict[str, Any] = {"least": np.min, "median": np.median, "greatest": np.max}


def _knee(item: CurveKnee) -> dict[str, str]:
    point = item.point
    return {
        "output": item.question.output,
        "along": item.question.along + (", in its logarithm" if item.question.scale == "log" else ""),
        "others": words_of({k: v.item() if hasattr(v, "item") else v for k, v in item.others.items()}),
        "x": number_text(point.x),
        "y": number_text(point.y),
        "curvature": number_text(point.curvature),
        "reason": point.reason,
    }


def _input(item: Input) -> dict[str, str]:
    moves = [
        m.path + (f" = {m.offset:g} + {m.factor:g} x" if (m.factor, m.offset) != (1.0, 0.0) else "")
        for m in item.targets
    ]
    if item.grid is not None:
        g = item.grid
        values = f"{g.count} from {g.start:g} to {g.stop:g}, {g.spacing}"
    elif item.values is not None:
        shown = [f"{v:g}" if isinstance(v, float) else str(v) for v in item.values]
        values = ", ".join(shown[:_MOST_VALUES]) + (
            f" and {len(shown) - _MOST_VALUES} more" if len(shown) > _MOST_VALUES else ""
        )
    else:
        assert item.random is not None  # noqa: S101 - the model's own check
        kind = next(n for n in ("uniform", "log_uniform", "normal") if getattr(item.random, n) is not None)
        values = f"{kind.replace('_', '-')} from {item.random.ends[0]:g} to {item.random.ends[1]:g}"
        if item.random.normal:
            values = f"normal, {item.random.normal[0]:g} ± {item.random.normal[1]:g}, cut at {item.random.ends}"
    return {"words": item.words, "moves": "; ".join(moves), "taken": values}


def _output(plan: Plan, table: StudyTable, output: Output) -> dict[str, str]:
    values = np.asarray(table.column(output.name), float)
    finite = values[np.isfinite(values)]
    error = plan.sky_error.get(f"output {output.name}")
    return {
        "name": output.name,
        "words": _meaning(plan, output),
        "n": f"{finite.size} of {values.size}",
        "error": "" if error is None else f"{error:.1e}",
        **{k: number_text(float(f(finite))) if finite.size else "–" for k, f in _THREE.items()},
    }


def _meaning(plan: Plan, o: Output) -> str:
    detector = o.detector or next(iter(plan.scenario.processing.detectors), "")
    if o.kind == "pd":
        at = f"P_FA {o.pfa:g}" if o.pfa is not None else "the P_FA of the input"
        return f"P_D of {o.subject} at {at}, {detector}, by {o.by}"
    if o.kind == "log10-pfa":
        return f"log10 of P_FA at which P_D of {o.subject} is {o.pd:g}, {detector}"
    if o.kind == "auc":
        return f"area under the ROC of {o.subject}, {detector}"
    if o.kind == "log-auc":
        return (
            f"mean P_D of {o.subject} over P_FA {o.pfa_range[0]:g} to {o.pfa_range[1]:g}, "
            f"evenly in its logarithm, {detector}"
        )
    where = (
        f"at {o.band_nm:g} nm"
        if o.range_nm is None
        else f"mean of the windows in {o.range_nm[0]:g}-{o.range_nm[1]:g} nm"
    )
    if o.kind == "snr":
        return f"SNR of {o.subject} {where}" + ("" if o.calibration_error else ", without calibration error")
    return f"radiance of {o.subject} {where} [{o.unit}]"


def _notes(plan: Plan) -> list[str]:
    notes = list(plan.notes)
    for name in ("radiance, worst", "radiance, rms"):
        if name in plan.sky_error:
            notes.append(
                f"interpolated atmosphere at {plan.study.atmosphere.checked} held-out states: {name} "
                f"relative error {plan.sky_error[name]:.1e} (ground of 0.3, two-way gas transmittance above 0.1)"
            )
    if any(i.random for i in plan.study.inputs):
        notes.append(f"random inputs: Sobol sequence, scrambled, seed {plan.study.design.seed}")
    return notes


def _reasons(table: StudyTable) -> list[tuple[str, int]]:
    """The reasons without their numbers, and how many points each has."""
    plain = [re.sub(r"; it comes to [^;]*", "", text) for text in table.reasons.values()]
    return Counter(plain).most_common(_MOST_REASONS)

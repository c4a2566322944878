"""The background's scores against theirs, tail included: predicted over measured false-alarm probability."""

from __future__ import annotations

from hyperval.compare.rows import RowMaker, scientific
from hyperval.processing.exceedance import LEAST_EXPECTED_ALARMS, false_alarm_ratio
from hyperval.products import ExceedanceCurve, background_of
from hyperval.results import Cause, Result

LEVELS = (1e-1, 1e-2, 1e-3, 1e-4)


def compare_exceedance(
    predicted: ExceedanceCurve | None,
    observed: ExceedanceCurve | None,
    *,
    campaign: str,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows ``pfa_ratio@1e-3`` and the like: predicted over measured P_FA at the threshold that was measured for it.

    The interval is that of the measured P_FA, from blocks of the image.  A level that expects fewer than 10 alarms
    gives a SKIPPED row, save that levels below 1e-3 then give none.

    Parameters
    ----------
    subject : what is looked for; the rows stand under the name of its background
    """
    make = RowMaker(campaign, "scores", background_of(subject), method)

    def rows(predicted: ExceedanceCurve, observed: ExceedanceCurve) -> list[Result]:
        out = []
        for level in LEVELS:
            name, expected = f"pfa_ratio@{scientific(level)}", level * (observed.n or 0)
            if expected < LEAST_EXPECTED_ALARMS:
                if level >= 1e-3:
                    out.append(
                        make.skipped(
                            Cause.FEW_ALARMS, f"{observed.n} background pixels expect {expected:.3g} alarms", name
                        )
                    )
                continue
            ratio = false_alarm_ratio(predicted, observed, level)
            at, model = ratio.at, ratio.predicted
            measured, threshold = float(observed.probability[at]), float(observed.threshold[at])
            beyond = threshold > predicted.threshold[predicted.probability > 0][-1]
            words = f"threshold {threshold:.4g}: predicted {'at most ' if beyond else ''}{model:.3g}, "
            words += f"measured {measured:.3g} ({observed.lower[at]:.2g} to {observed.upper[at]:.2g})"
            interval = ratio.lower, ratio.upper
            out.append(make.row(name, ratio.value, interval=interval, n=observed.n, reason=words))
        return out

    return make.compared(predicted, observed, rows)

"""What pages draw of a prediction, small enough to be written while somebody waits: means, errors, curves, scores.

Covariances, which are most of ``products.nc``, are left to that file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, reader
from hyperval.products import Prediction, RocCurve, ScoreDistribution, SpectralEstimate
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
_SPECTRA = ("radiance", "toa_reflectance", "snr", "reflectance")
_CURVE = ("pfa", "pd", "pd_lower", "pd_upper", "threshold")
_VERSION = 1


def write_answer(path: Path, prediction: Prediction) -> None:
    """Write what is drawn of a prediction."""
    axis = prediction.axis
    arrays: dict[str, Any] = {"nm": axis.centre_nm, "fwhm": axis.fwhm_nm, "good": axis.good}
    names: dict[str, Any] = {"version": _VERSION, "notes": list(prediction.notes)}
    for product in _SPECTRA:
        estimates: Mapping[str, SpectralEstimate] = getattr(prediction, product)
        names[product] = list(estimates)
        if estimates:
            arrays[product] = np.stack([[e.mean, e.standard_uncertainty] for e in estimates.values()])
    names["roc"] = [list(key) for key in prediction.roc]
    for number, curve in enumerate(prediction.roc.values()):
        arrays[f"roc{number}"] = np.stack([getattr(curve, part) for part in _CURVE])
    names["scores"] = [[*key, s.mean, s.sd] for key, s in prediction.scores.items()]
    for number, score in enumerate(prediction.scores.values()):
        if score.grid is not None and score.density is not None:
            arrays[f"score{number}"] = np.stack([score.grid, score.density])
    with path.open("wb") as file:
        np.savez(file, names=np.array(json.dumps(names)), **arrays)


@reader
def read_answer(path: Path) -> Prediction:
    """A prediction as pages draw it: the error covariance of a spectrum is diagonal.

    Raises
    ------
    InputError : no such file, or a damaged one.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            names = json.loads(str(stored["names"]))
            axis = SpectralAxis(stored["nm"], stored["fwhm"], stored["good"])
            spectra: dict[str, Any] = {
                product: dict(_estimates(names[product], stored, product)) for product in _SPECTRA
            }
            roc = {
                (s, d, u): RocCurve(**dict(zip(_CURVE, stored[f"roc{i}"], strict=True)), unit=u)
                for i, (s, d, u) in enumerate(names["roc"])
            }
            scores = {
                (s, d): ScoreDistribution(mean, sd, None, *stored.get(f"score{i}", ()))
                for i, (s, d, mean, sd) in enumerate(names["scores"])
            }
    except (OSError, ValueError, KeyError, TypeError, EOFError) as error:
        raise InputError("the numbers of this run cannot be read", mend="run it again") from error
    return Prediction(axis, **spectra, scores=scores, roc=roc, notes=tuple(names["notes"]))


def _estimates(
    names: list[str], stored: Mapping[str, Array], product: str
) -> Iterator[tuple[str, SpectralEstimate]]:
    for number, name in enumerate(names):
        mean, u = stored[product][number]
        yield name, SpectralEstimate(mean, np.diag(u**2))

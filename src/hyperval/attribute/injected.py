"""Standard errors, each injected into the model alone: a comparison that is worth its name sees them.

An error is one or several inputs that stand at another value than stated.  The truth of the model departs, what the
detectors look for and how bands are labelled stays: the pipeline that is compared is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.model import Origins, Truth, World, predict, read, value_at
from hyperval.products import PredictedProducts, SpectralEstimate
from hyperval.scenario import Scenario
from hyperval.statistics_library import BUILTIN_NAMES, builtin_mean

Array = npt.NDArray[np.float64]

NORMAL_DOF = 1e6  # degrees of freedom of tails that are left out


class NotInjectable(UsageError):
    """An error of something that the scenario does not have."""


@dataclass(frozen=True)
class InjectedError:
    """An error of a standard size.

    Attributes
    ----------
    name : as the power table has it
    values : what stands where, for what a scenario says
    """

    name: str
    values: Callable[[World], Truth]

    def truth(self, world: World) -> Truth:
        """What truly stands where with the error.

        Raises
        ------
        NotInjectable : the scenario has nothing of the kind.
        """
        try:
            values = self.values(world)
            for path in values:
                value_at(world, path)
        except NotInjectable:
            raise
        except UsageError as error:
            raise NotInjectable(error.what) from error
        return values


def injected_errors() -> tuple[InjectedError, ...]:
    """The standard errors, in the order of the power table."""
    return (
        InjectedError("sunlight x 0.95", partial(_times, path="light.irradiance", factor=0.95)),
        InjectedError("sunlight x 1.05", partial(_times, path="light.irradiance", factor=1.05)),
        InjectedError("path radiance x 1.1", partial(_times, path="light.path", factor=1.1)),
        InjectedError("spherical albedo x 1.5", partial(_times, path="light.spherical_albedo", factor=1.5)),
        InjectedError("spectral shift of 0.1 band", partial(_shifted, bands=0.1)),
        InjectedError("spectral shift of 0.5 band", partial(_shifted, bands=0.5)),
        InjectedError("wavelengths + 5 nm", partial(_shifted, nm=5.0)),
        InjectedError("noise x 1.5", partial(_times, path="sensor.noise", factor=1.5)),
        InjectedError("electrons x 1.05", partial(_times, path="sensor.electrons", factor=1.05)),
        InjectedError("class spread x 0.8", partial(_spread, factor=0.8)),
        InjectedError("class spread x 1.25", partial(_spread, factor=1.25)),
        InjectedError("tails left out", _without_tails),
        InjectedError("class means exchanged", _class_means_exchanged),
        InjectedError("target spectra x 0.8", _darker_targets),
        InjectedError("target spectra exchanged", _target_spectra_exchanged),
        InjectedError("target spectra of another material", _other_material),
        InjectedError("target covariance by f, not f squared", _fine_texture),
        InjectedError("fill x 0.8", partial(_times, path="fill", factor=0.8)),
        InjectedError("blur x 1.5", partial(_times, path="blur", factor=1.5)),
        InjectedError("empirical line gain x 1.02", partial(_line, gain=1.02, offset=0.0)),
        InjectedError("empirical line offset + 0.005", partial(_line, gain=1.0, offset=0.005)),
    )


def injected_prediction(
    scenario: Scenario, error: InjectedError, origins: Origins | None = None, *, objects: bool | int = False
) -> tuple[PredictedProducts, Truth]:
    """The prediction of a scenario with one error injected, its budget as stated; and the truth behind it.

    Raises
    ------
    NotInjectable : the scenario has nothing of the kind.
    """
    truth = error.truth(read(scenario, origins))
    prediction = predict(scenario, origins, truth=truth, objects=objects)
    if "line.gain" in truth:  # what was collected is through its own line: an error of the model's shows in its own
        gain, offset = truth["line.gain"], truth["line.offset"]
        seen = {name: _through_line(estimate, gain, offset) for name, estimate in prediction.reflectance.items()}
        prediction = replace(prediction, reflectance=seen)
    return prediction, truth


def _times(world: World, *, path: str, factor: float) -> Truth:
    nominal = np.asarray(value_at(world, path)[0], dtype=float)
    if not np.any(nominal):
        raise NotInjectable(f"{path} is 0")
    return {path: factor * nominal}


def _shifted(world: World, *, bands: float = 0.0, nm: float = 0.0) -> Truth:
    """True band centres off by a part of each band's width, or by so much; spectra may end before such a band."""
    moves: dict[str, Any] = {"sensor.wavelength_shift_nm": bands * world.stated.axis.fwhm_nm + nm}
    for key in ("classes", "panels", "sites", "targets"):
        for s in getattr(world.stated.scenario.scene, key):
            if s.spectrum.measured is None:
                moves[f"scene.{key}.[{s.name}].spectrum.gaps"] = "allowed"
    return moves


def _spread(world: World, *, factor: float) -> Truth:
    """Standard deviation of every class."""
    return {f"surfaces.[{c.name}].spread": factor for c in world.stated.scenario.scene.classes}


def _without_tails(world: World) -> Truth:
    paths = [f"surfaces.[{c.name}].tail_dof" for c in world.stated.scenario.scene.classes]
    heavy = {path: NORMAL_DOF for path in paths if value_at(world, path)[0] < NORMAL_DOF}
    if not heavy:
        raise NotInjectable("no class has tails")
    return heavy


def _class_means_exchanged(world: World) -> Truth:
    """Those of the two classes that cover most."""
    classes = sorted(world.stated.scenario.scene.classes, key=lambda c: -c.fraction)
    if len(classes) < 2:
        raise NotInjectable("there is one class")
    a, b = classes[0].name, classes[1].name
    return _means(world, {a: b, b: a})


def _darker_targets(world: World) -> Truth:
    return {path: 0.8 * value_at(world, path)[0] for path in _target_means(world).values()}


def _target_spectra_exchanged(world: World) -> Truth:
    """Each target has the spectrum of the next one."""
    names = list(_target_means(world))
    if len(names) < 2:
        raise NotInjectable("there is one target")
    return _means(world, dict(zip(names, (*names[1:], names[0]), strict=True)))


def _other_material(world: World) -> Truth:
    """Of the built-in materials the one that is least like the target."""
    moves = {}
    others = [builtin_mean(n, world.stated.axis) for n in BUILTIN_NAMES if not n.endswith("NN")]
    for name, path in _target_means(world).items():
        own = world.stated.surfaces[name].mean
        gaps = [float(np.nanmean((mean - own) ** 2)) for mean in others]
        moves[path] = others[int(np.argmax(gaps))]
    return moves


def _fine_texture(world: World) -> Truth:
    """All of the targets' spread."""
    names = [name for name in _target_means(world) if np.any(world.stated.surfaces[name].covariance)]
    if not names:
        raise NotInjectable("no target has a spread")
    return {f"surfaces.[{name}].fine_texture": 1.0 for name in names}


def _target_means(world: World) -> dict[str, str]:
    """Target -> path of its mean spectrum."""
    paths = {t.name: f"surfaces.[{t.name}].mean" for t in world.stated.scenario.scene.targets}
    if not paths:
        raise NotInjectable("there is no target")
    return paths


def _means(world: World, taken: Mapping[str, str]) -> Truth:
    """Path of a mean -> that of another surface, where that is known."""
    moves = {}
    for name, other in taken.items():
        own, there = world.stated.surfaces[name].mean, world.stated.surfaces[other].mean
        moves[f"surfaces.[{name}].mean"] = np.nan_to_num(np.where(np.isfinite(there), there, own))
    return moves


def _line(world: World, *, gain: float, offset: float) -> Truth:
    """An empirical line that is off for the detectors; where reflectance was collected, in the surfaces' own."""
    if world.stated.scenario.atmosphere is None:
        return {"sensor.gain": gain, "sensor.offset": offset}
    if world.stated.scenario.processing.elm == "none":
        raise NotInjectable("there is no empirical line")
    return {"line.gain": gain, "line.offset": offset}


def _through_line(estimate: SpectralEstimate, gain: float, offset: float) -> SpectralEstimate:
    pixels = estimate.pixel_covariance
    return replace(
        estimate,
        mean=gain * estimate.mean + offset,
        pixel_covariance=None if pixels is None else gain**2 * pixels,
    )

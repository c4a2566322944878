"""Standard errors, each injected into the model alone: a comparison that is worth its name sees them.

An error is one or several inputs that stand at another value than stated.  The truth of the model departs, what the
detectors look for and how bands are labelled stays: the pipeline that is compared is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
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
        InjectedError("sunlight x 0.95", _times("light.irradiance", 0.95)),
        InjectedError("sunlight x 1.05", _times("light.irradiance", 1.05)),
        InjectedError("path radiance x 1.1", _times("light.path", 1.1)),
        InjectedError("spherical albedo x 1.5", _times("light.spherical_albedo", 1.5)),
        InjectedError("spectral shift of 0.1 band", _shifted(bands=0.1)),
        InjectedError("spectral shift of 0.5 band", _shifted(bands=0.5)),
        InjectedError("wavelengths + 5 nm", _shifted(nm=5.0)),
        InjectedError("noise x 1.5", _times("sensor.noise", 1.5)),
        InjectedError("electrons x 1.05", _times("sensor.electrons", 1.05)),
        InjectedError("class spread x 0.8", _spread(0.8)),
        InjectedError("class spread x 1.25", _spread(1.25)),
        InjectedError("tails left out", _without_tails),
        InjectedError("class means exchanged", _class_means_exchanged),
        InjectedError("target spectra x 0.8", _darker_targets),
        InjectedError("target spectra exchanged", _target_spectra_exchanged),
        InjectedError("target spectra of another material", _other_material),
        InjectedError("target covariance by f, not f squared", _fine_texture),
        InjectedError("fill x 0.8", _times("fill", 0.8)),
        InjectedError("blur x 1.5", _times("blur", 1.5)),
        InjectedError("empirical line gain x 1.02", _line(1.02, 0.0)),
        InjectedError("empirical line offset + 0.005", _line(1.0, 0.005)),
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


def _times(path: str, factor: float) -> Callable[[World], Truth]:
    def values(world: World) -> Truth:
        nominal = np.asarray(value_at(world, path)[0], dtype=float)
        if not np.any(nominal):
            raise NotInjectable(f"{path} is 0")
        return {path: factor * nominal}

    return values


def _shifted(*, bands: float = 0.0, nm: float = 0.0) -> Callable[[World], Truth]:
    """True band centres off by a part of each band's width, or by so much; spectra may end before such a band."""

    def values(world: World) -> Truth:
        moves: dict[str, Any] = {"sensor.wavelength_shift_nm": bands * world.stated.axis.fwhm_nm + nm}
        scene = world.stated.scenario.scene
        for key in ("classes", "panels", "sites", "targets"):
            for s in getattr(scene, key):
                if s.spectrum.measured is None:
                    moves[f"scene.{key}.[{s.name}].spectrum.gaps"] = "allowed"
        return moves

    return values


def _spread(factor: float) -> Callable[[World], Truth]:
    """Standard deviation of every class."""
    return lambda world: {f"surfaces.[{c.name}].spread": factor for c in world.stated.scenario.scene.classes}


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


def _line(gain: float, offset: float) -> Callable[[World], Truth]:
    """An empirical line that is off for the detectors; where reflectance was collected, in the surfaces' own."""

    def values(world: World) -> Truth:
        if world.stated.scenario.atmosphere is None:
            return {"sensor.gain": gain, "sensor.offset": offset}
        if world.stated.scenario.processing.elm == "none":
            raise NotInjectable("there is no empirical line")
        return {"line.gain": gain, "line.offset": offset}

    return values


def _through_line(estimate: SpectralEstimate, gain: float, offset: float) -> SpectralEstimate:
    pixels = estimate.pixel_covariance
    return replace(
        estimate,
        mean=gain * estimate.mean + offset,
        pixel_covariance=None if pixels is None else gain**2 * pixels,
    )

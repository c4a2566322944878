"""Radiance, SNR, noise and reflectance of every subject, with their errors (3.7-3.20, and the empirical line)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.data import Errors
from hyperval.model.detection import Evaluation
from hyperval.model.fill import fill_distribution
from hyperval.model.inputs import UncertainInput, number_input, spectral_directions
from hyperval.model.objects import HOST, PLACE, Shares, host_covariance, place_covariance, shares_of
from hyperval.model.propagate import combined, known
from hyperval.model.radiance import (
    Background,
    Light,
    of_truth,
    retrieved_covariance,
    retrieved_reflectance,
    target_pixel_covariance,
    target_pixel_reflectance,
    toa_reflectance,
)
from hyperval.model.world import World, find, settled, with_truths
from hyperval.products import SpectralEstimate
from hyperval.scenario import SpectralForm

Array = npt.NDArray[np.float64]
SpectralErrors = Mapping[tuple[str, str], Mapping[str, Errors]]  # (product, subject) -> source -> its errors
TABLE, INTERPOLATION_NM = "interpolation of the table", 300.0  # source in the budget; its correlation length
_TOGETHER = 32  # directions whose spectra are in memory at once
_NOTHING = 1e-9  # of an error: what rounding leaves where nothing follows
_SEEN_BY_NO_SPECTRUM = ("dark", "bright", "line_gain", "line_offset", "spread", "tail", "fine_texture")


def without_calibration_error(subject: str) -> str:
    """Name under which ``snr`` holds a subject with C_R left out of (3.20)."""
    return f"{subject} (no calibration error)"


def reflectances(world: World, light: Light) -> dict[str, tuple[Array, Array]]:
    """Subject -> (U or 1, 1, B) what it reflects, as a surface in the open would have to, and what meets light of the
    surroundings (3.10).

    ``light`` : of each truth
    """
    scene, mean = world.stated.scenario.scene, world.mean

    def of(name: str) -> Array:
        number = world.surface(name)
        return mean[:, number : number + 1]

    out = {s.name: 2 * (of(s.name),) for s in (*scene.classes, *scene.panels, *scene.sites)}
    full = {t.name: lit(world, light, number)[:2] for number, t in enumerate(scene.targets)}
    for number, (t, _, population) in enumerate(world.stated.populations):
        target = scene.targets[t]
        host = of(target.host)
        if (shares := shares_at(world, number)) is not None:
            each = [[sum(s.mean[j] for j, n in enumerate(s.names) if n == name) for name in full] for s in shares[0]]
            fractions = np.array(each, dtype=float)[shares[1]]
            one, under = (
                host + sum(fractions[:, j, None, None] * (x[k] - host) for j, x in enumerate(full.values()))
                for k in (0, 1)
            )
            out[population.name] = one, under
            continue
        fills = world.fills(number)
        mean_fill = (fills.weights * fills.values).sum(axis=1)[:, None]
        one, under = (target_pixel_reflectance(mean_fill, x, host) for x in full[target.name])
        out[population.name] = one, under
    return out


def lit(world: World, light: Light, target: int) -> tuple[Array, Array, Array | float]:
    """A target under its own light, as :meth:`Light.surface` has it."""
    number = world.surface(world.stated.targets[target].name)
    return light.surface(world.mean[:, number], world.column("beam")[:, target], world.column("sky_view")[:, target])


def shares_at(world: World, number: int) -> tuple[list[Shares], npt.NDArray[np.intp]] | None:
    """The different shares of an object's pixels at its place, and which (U,) of them each truth has; None where there
    is no place, or the printed form.
    """
    stated, scenario = world.stated, world.stated.scenario
    t, _, population = stated.populations[number]
    if scenario.formulation == "thesis" or population.fill.geometry is None or population.position_m is None:
        return None
    models, which = world.fill_models(number)
    position, targets, each = scenario.uncertainty.position_m, world.targets_at(0), []
    for fill in models:
        key = "shares", number, repr((fill, [p.fill for target in targets for p in target.populations]))
        if key not in stated.kept:
            moved = population.model_copy(update={"fill": fill})
            stated.kept[key] = shares_of(targets[t], moved, targets, position, scenario.processing.seed)
        each.append(stated.kept[key])
    return each, which


def mean_spectra(e: Evaluation) -> dict[tuple[str, str], Array]:
    """(product, subject) -> (U or 1, B) mean spectra of all truths (3.7-3.20)."""
    light, out = e.light.rows(e.which), {}
    pure = set(e.stated.names["surface"]) - set(e.stated.names["target"])
    for name, (rho, _) in reflectances(e.world, light).items():
        level = light.level(rho)
        if light.radiant:
            out["radiance", name] = level[:, 0]
            white = light.terms.diffuser_radiance
            if e.scenario.is_of_space and white is not None:
                out["toa_reflectance", name] = toa_reflectance(level, white)[:, 0]
            if light.noise is not None and name in pure:
                for key, with_c in ((name, True), (without_calibration_error(name), False)):
                    out["snr", key] = light.noise.snr(level, calibration=with_c)[:, 0]
        if not light.radiant or light.elm is not None:
            # What the empirical line is off by belongs to collected reflectance, not to the predicted one.
            out["reflectance", name] = retrieved_reflectance(light.library_line, level)[:, 0]
    return out


def interpolation_input(world: World) -> list[UncertainInput]:
    """Error of the path radiance by interpolation between the nodes of a table; none without one.

    Its size is :func:`hyperval.atmosphere.table.path_error`; it is smooth over wavelength.
    """
    if world.stated.scenario.atmosphere is None:
        return []
    sigma = world.stated.atmosphere({}, 1).path_uncertainty
    if sigma is None or not np.any(sigma):
        return []
    rows = spectral_directions(world, sigma[0, 0], SpectralForm(correlation_nm=INTERPOLATION_NM))
    return [number_input(world, TABLE, "engine", "light.path_error", 0.0, rows=rows)]


def spectral_errors(world: World, inputs: Iterable[UncertainInput]) -> SpectralErrors:
    """Errors of the mean spectra of one truth: half the difference of up and down along each direction of each input,
    the rest held.
    """
    out: dict[tuple[str, str], dict[str, list[Array]]] = {}
    for item in inputs:
        if find(world.stated, item.path)[0].field in _SEEN_BY_NO_SPECTRUM:
            continue
        least = _NOTHING * float(np.abs(item.rows).max(initial=0.0))
        of_spectrum = item.subject and item.kind == "surface"
        for start in range(0, len(item.rows), _TOGETHER):
            some = range(start, min(start + _TOGETHER, len(item.rows)))
            there = moved_by(world, [item.direction(k, z) for z in (1.0, -1.0) for k in some])
            for key, rows in half_differences(there, len(some)).items():
                if item.kind == "engine" and key[0] == "reflectance":  # the empirical line takes it off
                    continue
                if of_spectrum and not np.nanmax(np.abs(rows), initial=0.0) > least:
                    continue
                name = "field spectrum" if of_spectrum else item.name
                out.setdefault(key, {}).setdefault(name, []).append(np.nan_to_num(rows))
    return {key: {name: Errors(np.concatenate(r)) for name, r in each.items()} for key, each in out.items()}


def moved_by(world: World, truths: Sequence[Mapping[str, object]]) -> World:
    """Truths beside the one of a world, which may be moved itself."""
    one = World(world.stated, {p: v[:1] for p, v in world.moved.items()})
    return with_truths(one, truths)


def half_differences(world: World, size: int) -> dict[tuple[str, str], Array]:
    """(product, subject) -> (K, B) half of what the first K truths have more than the last K."""
    whole: dict[tuple[str, str], Array] = {}
    for index, part in settled(world):
        for key, values in mean_spectra(Evaluation(part)).items():
            whole.setdefault(key, np.empty((2 * size, values.shape[1])))[index] = values
    return {key: 0.5 * (values[:size] - values[size:]) for key, values in whole.items()}


def spectral_products(e: Evaluation, u: int, errors: SpectralErrors) -> dict[str, Any]:
    """All spectra of one truth with their errors: product, by its name in ``Prediction``, -> subject -> what it is."""
    world = e.world.rows(np.array([u]))
    names = ("radiance", "snr", "reflectance", "toa_reflectance", "noise", "full_scale")
    out: dict[str, Any] = {name: {} for name in names}
    light, v = e.light.row(int(e.which[u])), int(e.which[u])
    means = {key: of_truth(values, u) for key, values in e.once("spectra", lambda: mean_spectra(e)).items()}
    each, bands = e.once("reflectances", lambda: reflectances(e.world, e.light.rows(e.which))), len(e.axis)
    around = Background.of(e.at, np.arange(bands)).covariance(v)
    pure = {*e.stated.names["surface"]} - {*e.stated.names["target"]}
    # One piece of memory for all: new pages for each matrix take longer than the numbers in it.
    *room, scratch = np.empty((1 + 2 * len(each), bands, bands))
    for number, (name, (rho, under)) in enumerate(each.items()):
        rho, under = (of_truth(x, u)[0] for x in (rho, under))
        of_radiance, of_reflectance = room[2 * number : 2 * number + 2]
        others: Mapping[str, Array] = {}
        if name in pure:
            covariance, gain = _of_surface(world, name), _gain(world, name)
        else:
            covariance, gain, others = _mixed(world, e.light.rows(np.array([v])), name)
        level = light.level(rho)
        seen = light.pixel_covariance(level, under, covariance, around, gain, of_radiance, scratch)
        for product in ("radiance", "toa_reflectance", "snr", "reflectance"):
            keys = (name, without_calibration_error(name)) if product == "snr" else (name,)
            for key in keys:
                if (product, key) not in means:
                    continue
                shapes, pixel = {}, None
                if product == "radiance":
                    shapes, pixel = {source: light.through(c) for source, c in others.items()}, known(seen)
                elif product == "reflectance":
                    shapes = {source: light.through(c) for source, c in others.items()}
                    pixel = known(seen)
                    if light.radiant:
                        shapes = {s: retrieved_covariance(light.library_line, c) for s, c in shapes.items()}
                        pixel = known(retrieved_covariance(light.library_line, seen, of_reflectance))
                total, budget = combined(errors.get((product, key), {}), shapes, bands)
                estimate = SpectralEstimate(means[product, key], total, pixel, None, budget)
                out[product][key] = estimate
        if light.radiant and light.noise is not None:
            if light.noise.full_scale is not None:
                out["full_scale"][name] = light.noise.full_scale_fraction(level)
            if name in pure:
                out["noise"][name] = asdict(light.noise.breakdown(level))
    return out


def _gain(world: World, name: str) -> float:
    """g_m of a class; 1 of any other surface."""
    classes = world.stated.classes
    return float(world.column("class_gain")[0, classes.index(name)]) if name in classes else 1.0


def _of_surface(world: World, name: str) -> Array:
    """(B, B) covariance of a surface in one truth, its gain included."""
    covariance, stretch = world.stated.surfaces[name].covariance, world.stretch[0, world.surface(name)]
    factor = _gain(world, name)
    if stretch.size == 1:
        factor *= float(stretch[0]) ** 2
    else:
        covariance = covariance * np.outer(stretch, stretch)
    return covariance if factor == 1.0 else factor * covariance


def _mixed(world: World, light: Light, name: str) -> tuple[Array, float, Mapping[str, Array]]:
    """Covariance of target pixels of one population (3.10, 3.12), gain of the host, and errors (B, B) of the mean of
    one object at its place by source.
    """
    stated = world.stated
    number, (t, _, _) = next((i, p) for i, p in enumerate(stated.populations) if p[2].name == name)
    target = stated.targets[t]
    full = {o.name: lit(world, light, i)[0][0, 0] for i, o in enumerate(stated.targets)}
    shade, own = lit(world, light, t)[2], _of_surface(world, target.name)
    if np.ndim(shade):
        factor = np.asarray(shade)[0, 0]
        own = own * np.outer(factor, factor)
    host, gain = world.mean[0, world.surface(target.host)], _gain(world, target.host)
    behind = _of_surface(world, target.host)
    models, which = world.fill_models(number)
    fill = fill_distribution(models[which[0]])
    covariance = target_pixel_covariance(
        fill.mean, fill.variance, full[target.name], own, host, behind,
        target_gain=float(world.column("target_gain")[0, t]),
        fine_texture=float(world.column("fine_texture")[0, world.surface(target.name)]),
        formulation=stated.scenario.formulation,
    )  # fmt: skip
    shares = shares_at(world, number)
    if shares is None:
        return covariance, gain, {}
    one = shares[0][shares[1][0]]
    return covariance, gain, {PLACE: place_covariance(one, full, host), HOST: host_covariance(one, behind, 1.0)}

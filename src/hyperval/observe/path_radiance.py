"""Path radiance of a scenario: what its engine sees of black ground."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePath

from hyperval.collection import PathRadiance
from hyperval.errors import UsageError
from hyperval.predict import Origins, predict
from hyperval.products import SpectralEstimate
from hyperval.scenario import Surface, load_scenario
from hyperval.scenario_sources import SpectrumSource
from hyperval.scenario_uncertainty import Uncertainty
from hyperval.spectra.axis import SpectralAxis

BLACK = "black ground"


def path_estimate(source: PathRadiance, axis: SpectralAxis, resolve: Callable[[str], Path]) -> SpectralEstimate:
    """Path radiance of a scenario [uW cm-2 sr-1 nm-1] with its error by the scenario's ``uncertainty``.

    L_P = L_a + B rho_ave / (1 - S rho_ave) of (3.7): what the scenario predicts for a site of reflectance 0.

    Raises
    ------
    UsageError : a scenario without an atmosphere, or one that states no uncertainty.
    """
    path = resolve(source.scenario)
    scenario = load_scenario(path)
    if scenario.atmosphere is None or scenario.uncertainty == Uncertainty():
        lacks = "no atmosphere" if scenario.atmosphere is None else "no uncertainty"
        raise UsageError(
            f"path_radiance: the scenario states {lacks}",
            where=str(path),
            expected="an atmosphere, and the uncertainty of what its path radiance depends on",
        )
    black = Surface(name=BLACK, spectrum=SpectrumSource(constant=0.0))
    scene = scenario.scene.model_copy(update={"sites": [*scenario.scene.sites, black], "targets": []})

    def beside(reference: str) -> Path:  # references of a scenario are relative to its own file
        if ":" in reference:
            return resolve(reference)
        return resolve((PurePath(source.scenario).parent / reference).as_posix())

    bare = scenario.model_copy(update={"scene": scene})
    return predict(bare, Origins(axis, resolve=beside)).radiance[BLACK]

"""The terms of equation 3.7, which every atmosphere engine returns; running an engine's program, and a cache of arrays.

Surfaces are Lambertian: their BRDF (3.1) is the reflectance factor over pi (3.2).  What the source writes apart, the
engine integrates: light of the sun that the surface reflects (3.3), skylight on the surface (3.4) and what it reflects
of that (3.5) are A and B, light scattered into the line of sight (3.6) is L_a.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.data import Array
from hyperval.errors import EngineError, refuse
from hyperval.spectra.axis import SpectralAxis, band_average
from hyperval.storage import last_line, tie, whole_file

_NARROW = 0.5  # channels this much narrower than the bands, or more, can be averaged as samples
# What goes in proportion to the sunlight; the rest are parts of light, which it leaves as they are.
_OF_THE_SUN = {"path_radiance", "direct", "adjacency", "ground_irradiance", "path_uncertainty", "diffuser_radiance"}
NOT_AVERAGED = ("wavelength_nm", "provenance", "fwhm_nm", "solar_lines", "notes")
_SIMILAR_WIDTH = 1.35  # channels within this factor of a band's width stand for it


@dataclass(frozen=True)
class AtmosphericTerms:
    """Terms of L = path_radiance + (direct rho + adjacency rho_ave) / (1 - spherical_albedo rho_ave).

    All arrays have shape (n,), one value per wavelength.

    Attributes
    ----------
    wavelength_nm : sample or band-centre positions [nm]
    path_radiance : L_a, radiance over a black surface [uW cm-2 sr-1 nm-1]
    direct : A, radiance per unit reflectance of the viewed pixel [uW cm-2 sr-1 nm-1]
    adjacency : B, radiance per unit average reflectance scattered into the view [uW cm-2 sr-1 nm-1]
    spherical_albedo : S [1]
    ground_irradiance : global irradiance on a black ground [uW cm-2 nm-1]
    gas_transmittance : two-way (sun-ground-sensor) gas transmittance [1]; tells windows from absorption
    provenance : engine, version, solar spectrum, state
    fwhm_nm : widths of the channels over which the terms are averaged already [nm]; None: samples of a spectrum
    diffuse_fraction : part of ``ground_irradiance`` that comes from the sky [1]; None where the engine does not
        tell it from the sun's beam
    path_uncertainty : standard uncertainty of ``path_radiance`` by interpolation between the nodes of a table,
        common to neighbouring wavelengths [uW cm-2 sr-1 nm-1]; None where nothing was interpolated
    diffuser_radiance : mu0 E0 / pi, radiance of a white level diffuser outside the atmosphere, over which radiance
        is top-of-atmosphere reflectance [uW cm-2 sr-1 nm-1]; None where the engine does not give it
    solar_lines : finer wavelengths [nm], and there the sunlight over the straight line between its values at
        ``wavelength_nm`` [1]: the Fraunhofer lines that the terms' own sampling smooths; None: it smooths none
    notes : what is to be said of them
    """

    wavelength_nm: Array
    path_radiance: Array
    direct: Array
    adjacency: Array
    spherical_albedo: Array
    ground_irradiance: Array
    gas_transmittance: Array
    provenance: dict[str, Any] = field(default_factory=dict)
    fwhm_nm: Array | None = None
    diffuse_fraction: Array | None = None
    path_uncertainty: Array | None = None
    diffuser_radiance: Array | None = None
    solar_lines: tuple[Array, Array] | None = None
    notes: tuple[str, ...] = ()

    def at_bands(self, axis: SpectralAxis) -> AtmosphericTerms:
        """The terms averaged over the band responses of ``axis``.

        Terms that are channel averages already are not averaged again: channels about as wide as the bands are
        interpolated to the band centres (unchanged where they are the same), much narrower ones serve as samples.

        Raises
        ------
        UsageError : the terms do not cover the bands, or their channels are too wide or of another width.
        """

        values = self.spectra()
        if self._are_channels_of(axis):
            bands = {name: np.interp(axis.centre_nm, self.wavelength_nm, row) for name, row in values.items()}
        else:  # one set of weights for all terms
            averages = band_average(self.wavelength_nm, np.stack(list(values.values())), axis)
            bands = dict(zip(values, averages, strict=True))
        if self.solar_lines is not None:  # what goes with the sunlight is averaged with its lines where they are
            nm, lines = self.solar_lines
            lit = [name for name in values if name in _OF_THE_SUN]
            fine = lines * np.stack([np.interp(nm, self.wavelength_nm, values[name]) for name in lit])
            bands |= dict(zip(lit, band_average(nm, fine, axis), strict=True))
        whole: dict[str, Any] = {**bands, "provenance": self.provenance}
        return AtmosphericTerms(wavelength_nm=axis.centre_nm, **whole)

    def spectra(self) -> dict[str, Array]:
        """The terms that the engine gives, by name: (n,) each."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in NOT_AVERAGED}
        return {name: values for name, values in arrays.items() if values is not None}

    def _are_channels_of(self, axis: SpectralAxis) -> bool:
        """True when the terms are averages over channels like those of ``axis``, False when they are samples."""
        if self.fwhm_nm is None:
            return False
        ratio = np.interp(axis.centre_nm, self.wavelength_nm, self.fwhm_nm) / axis.fwhm_nm
        if np.all(ratio <= _NARROW):
            return False
        similar = (ratio >= 1.0 / _SIMILAR_WIDTH) & (ratio <= _SIMILAR_WIDTH)
        reach = 0.1 * axis.fwhm_nm
        covered = (axis.centre_nm >= self.wavelength_nm[0] - reach) & (axis.centre_nm <= self.wavelength_nm[-1] + reach)
        off = int(np.argmin(similar & covered))
        ends, wide = self.wavelength_nm[[0, -1]], not np.all(similar & covered)
        refuse(wide, "terms.channels", nm=axis.centre_nm[off], fwhm=axis.fwhm_nm[off], ends=ends)
        return True


def lit_by(unit: Array, values: Mapping[str, Array]) -> dict[str, Any]:
    """Terms under a sun of mu0 E0 / pi = ``unit`` (n,), from those over it: what tables hold (``between``)."""
    return {
        "path_radiance": unit * values["path"], "direct": unit * values["direct"],
        "adjacency": unit * values["adjacency"], "spherical_albedo": values["spherical_albedo"],
        "ground_irradiance": np.where(values["ground"] > 0.0, np.pi * unit * values["ground"], np.nan),
        "gas_transmittance": values["gas"], "diffuse_fraction": values.get("diffuse"), "diffuser_radiance": unit,
    }  # fmt: skip


Arrays = dict[str, Array]


def run_program(
    command: Sequence[str], name: str, mend: str, *, timeout_s: float, text: str = "", **options: Any
) -> subprocess.CompletedProcess[str]:
    """What a program says that is given ``text`` to read; it and its children end with this process and its patience.

    Parameters
    ----------
    command : the program and its arguments
    name, mend : what messages call it, and what they advise where it cannot be started
    timeout_s : how long it may take [s]
    options : of ``Popen``, such as its working directory (``cwd``) and its variables (``env``)

    Raises
    ------
    EngineError : it cannot be started, or takes longer.
    """
    try:
        process = subprocess.Popen(  # noqa: S603
            [*tie(), *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            errors="replace", start_new_session=True, **options,
        )  # fmt: skip
    except OSError as error:
        raise EngineError(f"{name} cannot be started: {error.strerror}", where=command[0], mend=mend) from error
    with process:
        try:
            output, complaint = process.communicate(text, timeout_s)
        except subprocess.TimeoutExpired as error:
            raise EngineError(f"{name} ran longer than {timeout_s:g} s", where=command[0]) from error
        finally:
            if process.poll() is None:
                with contextlib.suppress(OSError):
                    os.killpg(process.pid, signal.SIGKILL)
    if tie() and process.returncode in (126, 127):  # of setpriv, as of a shell
        raise EngineError(f"{name} cannot be started: {last_line(complaint)}", where=command[0], mend=mend)
    return subprocess.CompletedProcess(command, process.returncode, output, complaint)


def cached(folder: Path, kind: str, inputs: Mapping[str, Any], compute: Callable[[], Arrays]) -> Arrays:
    """The arrays stored for ``inputs``, computed and stored first where there are none.

    An entry that cannot be read, belongs to other inputs or holds other content than was written counts as none.
    A cache that cannot be written (a read-only home) is no error: the result is computed every time.
    """
    about = json.dumps(inputs, sort_keys=True, allow_nan=False)
    path = folder / kind / f"{hashlib.sha256(about.encode()).hexdigest()[:40]}.npz"
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as entry:
            stored = {n: np.asarray(entry[n], dtype=float) for n in entry.files if n not in ("inputs", "content")}
            if str(entry["inputs"]) == about and str(entry["content"]) == content_digest(stored):
                return stored
    except Exception:  # noqa: S110 - whatever a damaged archive raises: what it holds is computed again
        pass
    arrays = compute()
    with contextlib.suppress(OSError), whole_file(path) as temporary, open(temporary, "wb") as written:
        np.savez(written, inputs=np.array(about), content=np.array(content_digest(arrays)), **arrays)  # type: ignore[arg-type]
    return arrays


def content_digest(arrays: Mapping[str, Array]) -> str:
    """SHA-256 over names, shapes and values of arrays."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name], dtype="<f8")
        digest.update(f"{name}{np.shape(arrays[name])}\n".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()

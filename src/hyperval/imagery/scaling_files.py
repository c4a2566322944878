"""Scaling of a raster by its header, the tags of a GeoTIFF, or a file of divisors beside it."""

from __future__ import annotations

from hyperval.imagery.envi_raster import EnviRaster
from hyperval.imagery.gain_file import divided
from hyperval.imagery.rasters import Raster
from hyperval.imagery.scaling import Scaling, scaling_of
from hyperval.imagery.tiff_raster import TiffRaster


def file_scaling(raster: Raster, *, quantity: str, unit: str | None, scale: float | None) -> Scaling:
    """Gain and offset of every band of a file that is no product with a description of its own.

    Raises
    ------
    InputError, UsageError : as for :func:`hyperval.imagery.scaling.scaling_of`.
    """
    if isinstance(raster, TiffRaster):
        return scaling_of(
            raster.header, raster.bands, quantity=quantity, unit=unit, scale=scale, file_gains=raster.gains,
            file_offsets=raster.offsets,
        )  # fmt: skip
    path = raster.divisors_path if isinstance(raster, EnviRaster) else None
    gains, unit = divided(path, raster.bands, quantity, unit, scale)
    return scaling_of(
        raster.header, raster.bands, quantity=quantity, unit=unit, scale=scale,
        file_gains=() if gains is None else gains.tolist(),
        file_note="" if path is None else f"stored values / those of {path.name}",
    )  # fmt: skip

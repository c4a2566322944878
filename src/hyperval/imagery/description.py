"""What a product says of its own image: bands, units, scale, no-data, sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, UsageError
from hyperval.imagery.band_table import BandTable, ordered_bands, stated_unit, wavelengths_in_nm
from hyperval.imagery.scaling import Scaling, scaled
from hyperval.units import radiance_to_internal

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Description:
    """What a file, or the metadata beside it, says of an image.

    Attributes
    ----------
    product : in words, for notes
    wavelength, fwhm : (B,) of the stored bands in ``wavelength_unit``; 0 where a band has none. Widths may lack
    wavelength_unit : as the file states it, None when it does not
    good : (B,) False for bands that the product marks as bad
    gain, offset : (B,) value = gain * stored + offset in ``unit``, or numbers for all bands
    quantity : "radiance" or "reflectance", None when the product does not say
    unit : of the scaled values, None when the product does not say
    ignore_value : stored value that means no data
    sensor : name of the instrument, "" when unknown
    sorts : bands may be sorted by wavelength without being told to, as the layout of the product is known
    entries : what else is said, by key, as the entries of a header
    notes : what was assumed
    rectified : False for an image in scanner geometry, whatever map position its file states
    sun_zenith_deg : zenith angle of the sun for the whole image, None when it is not stated
    """

    product: str
    wavelength: Array
    fwhm: Array | None = None
    wavelength_unit: str | None = None
    good: npt.NDArray[np.bool_] | None = None
    gain: npt.ArrayLike = 1.0
    offset: npt.ArrayLike = 0.0
    quantity: str | None = None
    unit: str | None = None
    ignore_value: float | None = None
    sensor: str = ""
    sorts: bool = False
    entries: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    rectified: bool = True
    sun_zenith_deg: float | None = None

    @property
    def all_notes(self) -> tuple[str, ...]:
        """The product and its sensor, then the notes."""
        by = f" of {self.sensor}" if self.sensor and self.sensor.lower() not in self.product.lower() else ""
        return (f"read as {self.product}{by}", *self.notes)

    def band_table(self, given_unit: str | None, where: str, *, sort_bands: bool = False) -> BandTable:
        """The bands that have a wavelength, in nm and in order.

        Raises
        ------
        InputError : no band has a wavelength, or two share one.
        UsageError : a unit that contradicts the file, or that nobody states.
        """
        has = np.flatnonzero(np.isfinite(self.wavelength) & (self.wavelength > 0))
        if not has.size:
            raise InputError("no band has a wavelength", where=where)
        listed = self.wavelength[has]
        unit, note = stated_unit(self.wavelength_unit, given_unit, listed, where)
        centre = wavelengths_in_nm(listed, unit, where)
        width = None if self.fwhm is None else wavelengths_in_nm(self.fwhm[has], unit, where, width=True)
        if width is not None and not np.all(width > 0):
            raise InputError("band widths (fwhm) that are not positive", where=where)
        good = np.ones(has.size, bool) if self.good is None else self.good[has]
        if not good.any():
            raise InputError("the product marks every band as bad", where=where)
        notes = list(note)
        if has.size < self.wavelength.size:
            notes.append(f"{self.wavelength.size - has.size} stored bands without a wavelength are left out")
        if not good.all():
            notes.append(f"bad-band list: {int((~good).sum())} of {good.size} bands are bad")
        table = ordered_bands(
            centre, width, good, sort_bands=sort_bands or self.sorts, where=where, notes=tuple(notes)
        )
        return BandTable(table.axis, has[table.stored_band], table.notes)

    def scaling(self, quantity: str, unit: str | None, scale: float | None, where: str) -> Scaling:
        """Gain and offset of every stored band; what the campaign states must be what the product says.

        Raises
        ------
        InputError : the product holds another quantity.
        UsageError : another unit than the product's, or one that nobody states.
        """
        if self.quantity is not None and quantity not in ("other", self.quantity):
            raise InputError(
                f"the product holds {self.quantity}, the campaign says {quantity}",
                where=where,
                mend=f"state quantity: {self.quantity}, or name the {quantity} product",
            )
        both = quantity == "radiance" and unit is not None and self.unit is not None and scale is None
        if both and radiance_to_internal(str(unit)) != radiance_to_internal(str(self.unit)):
            raise UsageError(
                f"the product states its radiance in {self.unit}, the campaign in {unit}",
                where=where,
                mend="leave unit out",
            )
        bands = self.wavelength.size
        gain, offset = (np.broadcast_to(np.asarray(v, float), bands).copy() for v in (self.gain, self.offset))
        note = f"scale of the {self.product}" if np.any(gain != 1.0) or np.any(offset != 0.0) else ""
        return scaled(gain, offset, note, quantity=quantity, unit=unit or self.unit, scale=scale)

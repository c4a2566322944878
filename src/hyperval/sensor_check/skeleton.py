"""The file that a new sensor starts from: every entry with what it is, to be filled in from a data sheet."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hyperval.errors import UsageError

_HEAD = """\
# A sensor, from its data sheet.  Replace every FILL_IN; every number stands with its source: the data sheet with
# its page, a publication, or "assumed: why".  Then: hyperval sensor check {name}.yaml -o {name}-check
schema: 1
name: {name}
title: "FILL_IN: what the sensor is, in a few words"
source: "FILL_IN: the data sheet or publication that most numbers are from"
bands:
  # Evenly spaced bands, one entry for each spectrometer, in rising wavelength.  A list may stand in place of parts:
  #   table: [[400.0, 5.0, 1], [405.0, 5.0, 1]]      rows of centre nm, full width at half maximum nm, 1 = good band
  # For a multispectral sensor add  spacing: separate
  parts:
{parts}
  source: "FILL_IN: where centres and widths are from"
arms:
"""

_PART = """\
    # {arm}
    - first_nm: "FILL_IN: centre of the first band [nm]"
      step_nm: "FILL_IN: spacing of the bands [nm]"
      count: "FILL_IN: number of bands"
      fwhm_nm: "FILL_IN: full width at half maximum [nm], not sigma and not half the width"
"""

_ARM = """\
  - name: {arm}
    range_nm: ["FILL_IN: shortest wavelength [nm]", "FILL_IN: longest wavelength [nm]"]
    throughput:
      # A Omega of one pixel.  Other conventions: f-number with f_number, pixel_pitch_um; slit with f_number,
      # slit_width_um, slit_height_um; value with cm2_sr.
      convention: square-ifov
      aperture_m: "FILL_IN: diameter of the aperture [m]"
      ifov_mrad: "FILL_IN: field of one pixel [mrad]"
      source: "FILL_IN"
    # A number that changes with wavelength has a table in place of value:  table: [[400, 0.3], [700, 0.6]]
    optical_transmittance: {{value: "FILL_IN: of optics and grating together, 0-1", source: "FILL_IN"}}
    quantum_efficiency: {{value: "FILL_IN: electrons per photon, 0-1", source: "FILL_IN"}}
    integration_time_s: {{value: "FILL_IN: exposure of one reading [s]", source: "FILL_IN"}}
    fixed_noise_electrons: {{value: "FILL_IN: read and dark noise of one reading [electrons]", source: "FILL_IN"}}
    bits: "FILL_IN: bits of the digital word"
    bits_source: "FILL_IN"
    # One of full_well_electrons, saturation_radiance [uW cm-2 sr-1 nm-1], lsb_electrons.
    full_well_electrons: {{value: "FILL_IN: electrons at full scale", source: "FILL_IN"}}
"""

_TAIL = """\
# What differs from pixel to pixel in the radiometric calibration; an error common to a band does not count.
calibration_error_percent: {value: "FILL_IN: one standard deviation [%]", source: "FILL_IN"}
# Published signal-to-noise ratios, with what they refer to; take the part out where there are none.
published_snr:
  - source: "FILL_IN"
    says: value                     # or: at least
    table: [["FILL_IN: wavelength [nm]", "FILL_IN: ratio"]]
    radiance: {value: "FILL_IN: radiance it holds for [uW cm-2 sr-1 nm-1]", source: "FILL_IN"}
"""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def skeleton(name: str, arms: Sequence[str] = ("VNIR",)) -> str:
    """The text of a sensor file with everything still to be filled in.

    Parameters
    ----------
    name : short name of the sensor
    arms : names of its spectrometers, in rising wavelength

    Raises
    ------
    UsageError : a name that could not stand in a file name, no arm, or the same one twice.
    """
    for text in (name, *arms):
        if not _NAME.fullmatch(text):
            raise UsageError(f"the name {text!r}", expected="letters, digits, dots, dashes and underscores")
    if not arms or len(set(arms)) != len(arms):
        raise UsageError("the arms have no names of their own", expected="such as VNIR,SWIR")
    parts = "".join(_PART.format(arm=arm) for arm in arms).rstrip("\n")
    return _HEAD.format(name=name, parts=parts) + "".join(_ARM.format(arm=arm) for arm in arms) + _TAIL

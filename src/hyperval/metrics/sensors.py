"""Metrics of sensor files: acceptance, datasheet, accepted numbers."""

from __future__ import annotations

from hyperval.metrics.metric import Kind, Metric, Move, of_unit, of_value

_NUMBERS = "baseline.accepted.sensor_metrics"
_SUITE = "sensor_check.suite."
_ACCEPTANCE = "defined here, docs/sensors.md#3-check-it"
_ACCEPTED = "defined here, docs/regression.md#what-is-kept"
_SENSOR = "(3.13)-(3.20), docs/model.md#sensor"
_USUAL: tuple[Move, Move] = ((0.1, "interval"), (0.01, "value"))


def _exact(
    name: str,
    words: str,
    function: str,
    unit: str = "1",
    tolerance: tuple[Move, Move] = _USUAL,
    formula: str = "",
    reference: str = "",
) -> Metric:
    """A number without sampling error."""
    example = "hyperval check --sensors hyperion" if function == _NUMBERS else ""
    if function.startswith(_SUITE) and not function.endswith("applied_moments"):
        example = "hyperval sensor check hyperion"
    return Metric(
        name,
        words,
        function,
        formula,
        unit,
        kind=Kind.EXACT,
        tolerance=tolerance,
        reference=reference or (_ACCEPTED if function == _NUMBERS else _ACCEPTANCE),
        example=example,
    )


METRICS = (
    _exact("band_count", "bands", _NUMBERS, tolerance=of_unit(0.0), formula="B"),
    _exact("median_snr", "median signal-to-noise ratio over a region", _NUMBERS, tolerance=of_value(0.002),
           formula="median_b L / sigma", reference=_SENSOR),
    _exact("median_noise_*", "median over a region of one term of the noise, as radiance", _NUMBERS,
           "uW cm-2 sr-1 nm-1", of_value(0.002), formula="median_b sigma_i", reference=_SENSOR),
    _exact("median_bit_error_noise*", "median over a region of the noise of bit errors at a rate", _NUMBERS,
           "uW cm-2 sr-1 nm-1", of_value(0.002), formula="median_b sigma_e (3.19)", reference=_SENSOR),
    _exact("median_electrons_per_radiance", "median over a region of electrons per radiance (3.13)", _NUMBERS,
           "electrons per uW cm-2 sr-1 nm-1", of_value(0.001), formula="median_b g (3.13)", reference=_SENSOR),
    _exact("reference_radiance", "reference radiance in the band at a line", _NUMBERS, "uW cm-2 sr-1 nm-1",
           of_value(0.001), formula="rho E_0 cos(45 deg) / pi"),
    _exact("white_panel_radiance", "radiance of a white panel in the oxygen band", _NUMBERS, "uW cm-2 sr-1 nm-1",
           of_value(0.001), formula="L of (3.7)", reference="(3.7), docs/model.md#scene-and-atmosphere"),
    _exact("pd_at_pfa_*", "detection probability in a standard scenario", "processing.roc_model.detection_at",
           tolerance=of_unit(0.005), formula="P_D at the P_FA (3.33)",
           reference="(3.33), docs/model.md#processing"),
    _exact("runs", "a standard scenario that does not run with this sensor", _NUMBERS),
    _exact("bands", "number of bands", _SUITE + "band_count", formula="B"),
    _exact("first_band", "centre of the first band", _SUITE + "end", "nm", formula="min w"),
    _exact("last_band", "centre of the last band", _SUITE + "end", "nm", formula="max w"),
    _exact("bands_out_of_order", "bands that do not follow each other",
           _SUITE + "order", formula="count [w_(b+1) <= w_b]"),
    _exact("bands_without_width", "bands without a width", _SUITE + "without_width", formula="count [not FWHM > 0]"),
    _exact("fwhm_over_spacing_median", "median width over spacing of neighbours", _SUITE + "spacing",
           formula="median FWHM / (w_(b+1) - w_b)"),
    _exact("widest_gap_fwhm", "widest gap between neighbours, in widths", _SUITE + "gap", "FWHM",
           formula="max ((w_(b+1) - w_b) / FWHM - 1), FWHM the mean of both"),
    _exact("integral_error", "departure of the integral of a response from 1",
           "sensor_check.suite.applied_moments", formula="max |int h - 1|"),
    _exact("centroid_error_fwhm", "departure of its centre of mass, in widths",
           "sensor_check.suite.applied_moments", "FWHM", formula="max |int w h - w_b| / FWHM"),
    _exact("width_error", "departure of its width from the stated one", "sensor_check.suite.applied_moments",
           formula="max |FWHM of h / FWHM - 1|"),
    _exact("bands_outside_arms", "bands beyond every arm", _SUITE + "outside_arms", formula="count"),
    _exact("bands_of_arm", "bands of an arm", _SUITE + "bands_of_arm", formula="count"),
    _exact("lowest_electrons_per_radiance", "least of electrons per radiance over bands", _SUITE + "electrons",
           "electrons per uW cm-2 sr-1 nm-1", formula="min_b g"),
    _exact("lowest_*", "least value of a number of an arm over its bands", _SUITE + "least", "", formula="min_b x"),
    _exact("highest_*", "greatest value of a number of an arm over its bands", _SUITE + "greatest", "",
           formula="max_b x"),
    _exact("bands_beyond_table_of_*", "bands beyond a table, whose end value is carried on", _SUITE + "beyond_table",
           formula="count"),
    _exact("gain_error_by_photon_energy", "departure of electrons per radiance from energy over photon energy",
           _SUITE + "energy_gain", formula="max |g / (energy / photon energy) - 1|"),
    _exact("gain_error_by_photon_transfer", "departure of the gain that the noise implies", _SUITE + "photon_transfer",
           formula="median (g_noise / g - 1), g_noise from the noise at two radiances"),
    _exact("sum_of_terms_error", "departure of the noise from the sum of its terms", _SUITE + "sum_of_terms",
           formula="max |sum sigma_i^2 / sigma^2 - 1|"),
    _exact("lowest_snr", "least signal-to-noise ratio over bands", _SUITE + "lowest_snr", formula="min_b L / sigma"),
    _exact("quantisation_over_other_noise", "noise of the digital word over all other", _SUITE + "quantisation",
           formula="max sigma_q / sqrt(sigma_shot^2 + sigma_fixed^2)"),
    _exact("highest_part_of_full_scale", "greatest part of full scale over bands", _SUITE + "scene_saturation",
           formula="max_b L / L_full"),
    _exact("lowest_relative_growth_of_snr", "least growth of the ratio as an input grows", _SUITE + "growth",
           formula="min SNR(x_2) / SNR(x_1) - 1"),
    _exact("computed_over_published", "computed over published signal-to-noise ratio",
           _SUITE + "published", formula="SNR / SNR_published"),
    _exact("values_not_positive", "radiances or ratios that are not positive", _SUITE + "not_positive",
           formula="count [not x > 0]"),
    _exact("highest_snr_over_cap_of_c_r", "greatest ratio over its cap by calibration", _SUITE + "snr_over_cap",
           formula="max SNR C_R / 100"),
    _exact("panel_reflectance_error", "departure of the panels' reflectance after the empirical line",
           _SUITE + "panel_error",
           formula="max |rho_line - rho|"),
    _exact("lowest_step_of_roc", "least step of a predicted curve",
           _SUITE + "roc_step", formula="min (P_D,(k+1) - P_D,k)"),
    _exact("relative_change_of_snr", "change of the ratio as one assumed number is varied",
           _SUITE + "swings", formula="SNR' / SNR - 1"),
    _exact("change_of_pd", "change of a detection probability as one assumed number is varied",
           _SUITE + "swings", formula="P_D' - P_D"),
    _exact("known_discrepancy", "a stated discrepancy that no check shows", _SUITE + "stale"),
    _exact("sensor_check", "a check that could not be made", "sensor_check.suite.check_sensor"),
)  # fmt: skip

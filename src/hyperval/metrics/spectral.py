"""Metrics of spectra, spread and classification."""

from __future__ import annotations

import math

from hyperval.metrics.metric import Evidence, Kind, Metric, of_unit, of_value

_SPECTRA = "compare.spectral.compare_spectra"
_SPREAD = "compare.covariance.compare_covariance"
_TAILS = "compare.covariance.compare_distribution"
_CLASSES = "compare.scores.compare_classification"
_DIFFERENCE = "processing.intervals.difference_ratio"
_REGION = "; the ending names the bands: windows, their part in vnir, swir1, swir2, or absorption"
_GUM = "JCGM 100:2008, 5.2"
_RATIO = of_unit(0.002)
_P = of_unit(0.05)
_FLAG = of_unit(0.0)
_TILT = "a tilt of ±3 % from end to end of the windows"
_PIPELINE = Evidence.PIPELINE
_DRAWS = "draws of the error of both sides"
_BAND = "draws of covariances of as many pixels from the prediction"
_COVARIANCES = "defined here, docs/statistics.md#covariances"
_CLASSIFICATION = "defined here, docs/statistics.md#classification"
_SIZE = "defined here, docs/statistics.md#outcomes"
_HERE = "defined here, docs/statistics.md#spectra"
_CHI_SQUARE = "Press et al., Numerical Recipes, 3rd ed., 2007, 15.1"
_HOTELLING = "Nel & van der Merwe, Commun. Stat. Theory Methods 15, 3719, 1986; docs/statistics.md#spectra"
_T_LAW = "Lange, Little & Taylor, J. Am. Stat. Assoc. 84, 881, 1989"
_FUKUNAGA = "Fukunaga 1990, 3.4"

METRICS = (
    Metric("difference_ratio", "(predicted − collected) / collected in one band", _DIFFERENCE, "(p - c) / c",
           agreement=0.0, interval="normal, first order, both sides", tolerance=_RATIO, reference=_GUM,
           example="difference_ratio([1.1], [1.0])[0]", gives=0.1,
           short="{product} band by band"),
    Metric("z", "difference in one band over its standard uncertainty", "compare.spectral.z_scores",
           "(p - c) / sqrt(u_p^2 + u_c^2)", agreement=0.0, kind=Kind.STATISTIC, tolerance=of_unit(0.1),
           reference=_GUM, example="z_scores([0.2], [[0.01]])[0]", gives=2.0),
    Metric("median_difference_ratio_*", "median over bands of (predicted − collected) / collected" + _REGION,
           "compare.rows.median_interval", "median_b (p - c) / c", agreement=0.0,
           interval="normal, of the mean over the same bands", tolerance=_RATIO, reference=_GUM,
           example="median_interval(np.array([0.1, 0.2, 0.3]), np.eye(3) * 0.0003)[0]", gives=0.18040036,
           short="level of the {product}{part}"),
    Metric("median_abs_difference_ratio_*", "median over bands of |predicted − collected| / collected" + _REGION,
           "compare.rows.size_intervals", "median_b |p - c| / c", low=0.0, agreement=0.0, interval=_DRAWS,
           tolerance=_RATIO, example="size_intervals(np.array([0.1, -0.2, 0.3]), np.eye(3) * 1e-18)[0][0]",
           gives=0.2,
           short="{product}{part}", reference=_SIZE),
    Metric("max_abs_difference_ratio_*", "largest over bands of |predicted − collected| / collected" + _REGION,
           "compare.rows.size_intervals", "max_b |p - c| / c", low=0.0, agreement=0.0, interval=_DRAWS,
           tolerance=_RATIO, example="size_intervals(np.array([0.1, -0.2, 0.3]), np.eye(3) * 1e-18)[1][0]",
           gives=0.3,
           short="worst band of the {product}{part}", reference=_SIZE),
    Metric("bias_ratio", "mean over the windows of (predicted − collected) / collected", _DIFFERENCE,
           "mean_b (p - c) / c", agreement=0.0, interval="normal, full covariance", tolerance=_RATIO,
           reference=_GUM, example="difference_ratio([1.1, 1.3], [1.0, 1.0]).mean()", gives=0.2,
           short="mean level of the {product}"),
    Metric("absorption_centre_difference",
           "centre of an absorption of the atmosphere (predicted − measured); after @ which one",
           "compare.spectral.wavelength_rows", "c_p - c_o, c = sum d w dw / sum d dw", unit="nm", agreement=0.0,
           interval="normal, first order, both sides", tolerance=of_unit(0.1), reference=_GUM,
           short="wavelengths"),
    Metric("spectral_angle", "angle between the two spectra in the windows",
           "compare.spectral.spectral_angle_degrees", "2 atan2(|u - v|, |u + v|)", unit="degree", low=0.0,
           high=90.0, agreement=0.0, tolerance=of_value(0.01),
           reference="Kruse et al., Remote Sens. Environ. 44, 145, 1993",
           example="spectral_angle_degrees([1, 0], [1, 1])", gives=45.0),
    Metric("chi2_reduced_diagonal", "squared z per band, correlation left out",
           "compare.spectral.chi_square_diagonal", "sum z^2 / n", low=0.0, agreement=1.0, kind=Kind.STATISTIC,
           tolerance=of_value(0.02), example="chi_square_diagonal([0.2, 0.0], np.eye(2) * 0.01).reduced",
           gives=2.0, reference=_CHI_SQUARE),
    Metric("chi2_reduced_full", "squared difference in units of its uncertainty, per degree of freedom, "
           "correlation counted; about 1 when uncertainties explain it", "compare.spectral.chi_square_full",
           "r^T C^-1 r / n", low=0.0, agreement=1.0, kind=Kind.STATISTIC, tolerance=of_value(0.02),
           example="chi_square_full([0.2, 0.0], np.eye(2) * 0.01).reduced", gives=2.0, reference=_HOTELLING),
    Metric("chi2_reduced_shape", "the same after a common factor is taken out",
           "compare.spectral.chi_square_shape", "(r^T C^-1 r - (s/sd)^2) / (n - 1)", low=0.0, agreement=1.0,
           kind=Kind.STATISTIC, tolerance=of_value(0.02),
           example="chi_square_shape([0.1, -0.1], [1.0, 1.0], np.eye(2) * 0.01).reduced", gives=2.0,
           reference=_HERE),
    Metric("p_value_diagonal",
           "probability of a squared difference as large, correlation left out: accepts too much",
           "compare.spectral.chi_square_diagonal", "P(chi2_n >= sum z^2)", low=0.0, high=1.0, kind=Kind.TEST,
           tolerance=_P, example="chi_square_diagonal([0.2, 0.0], np.eye(2) * 0.01).p_value", gives=0.13533528,
           alternative=0.03, departure=_TILT, two_sided=True, reference=_CHI_SQUARE),
    Metric("p_value_full", "probability, were both sides right, of a difference as large, all stated errors and "
           "their correlation counted; near 1 the stated errors are too wide",
           "compare.spectral.chi_square_full", "P(chi2_n >= r^T C^-1 r)", low=0.0, high=1.0, kind=Kind.TEST,
           tolerance=_P, example="chi_square_full([0.2, 0.0], np.eye(2) * 0.01).p_value", gives=0.13533528,
           usual=(1e-3, math.inf), alternative=0.03, departure=_TILT, two_sided=True,
           short="{product} within its budget", reference=_HOTELLING),
    Metric("p_value_shape", "the same of the shape, a common factor taken out",
           "compare.spectral.chi_square_shape", "P(chi2_(n-1) >= shape)", low=0.0, high=1.0, kind=Kind.TEST,
           tolerance=_P, example="chi_square_shape([0.1, -0.1], [1.0, 1.0], np.eye(2) * 0.01).p_value",
           gives=0.15729921, alternative=0.03, departure=_TILT, two_sided=True,
           short="shape of the {product}", reference=_HERE),
    Metric("fraction_inside_95", "share of the bands with |z| <= 1.96", "compare.spectral.share_inside",
           "mean_b [|z| <= 1.96]", low=0.0, high=1.0, agreement=0.95, kind=Kind.STATISTIC, tolerance=of_unit(0.02),
           interval="exact binomial of B^2 / sum rho^2 bands",
           example="share_inside([0.2, 0.0], np.eye(2) * 0.01)[0]", gives=0.5,
           short="share of bands inside their intervals", reference=_HERE),
    Metric("fraction_inside_stated*", "share of the bands whose difference is at most twice the standard "
           "uncertainty that the source of the observation states, what both sides share included; the suffix "
           "_windows takes the windows of the atmosphere alone", "compare.spectral.fraction_inside_stated",
           "mean_b [|p - c| <= 2 u_b]", low=0.0, high=1.0, kind=Kind.COVERAGE, tolerance=of_unit(0.02),
           example="fraction_inside_stated(np.array([0.01, 0.03]), np.array([0.01, 0.01]))", gives=0.5,
           short="share of bands inside the stated uncertainty",
           reference="defined here, docs/campaigns.md#from-space-a-day-of-radcalnet"),
    # Spread from pixel to pixel.
    Metric("eigenvalue_ratio", "predicted over measured variance along one principal direction; the number after "
           "@ counts directions, largest first", _SPREAD, "E[lambda_k] / lambda_k", low=0.0, agreement=1.0,
           interval=_BAND,
           short="eigenvalues of the spread", reference=_COVARIANCES),
    Metric("eigenvalues_inside_95", "share of the leading eigenvalues inside the band of sampling", _SPREAD,
           low=0.0, high=1.0, kind=Kind.COVERAGE, tolerance=_FLAG, formula="mean_k [l_k <= lambda_k <= u_k]",
           reference=_COVARIANCES),
    Metric("total_variance_ratio", "predicted over measured variance, all bands together", _SPREAD, "tr / tr",
           low=0.0, agreement=1.0, interval=_BAND,
           short="total variance", reference=_COVARIANCES),
    Metric("subspace_angle", "largest principal angle of the first k eigenvectors; k after @", _SPREAD, unit="deg",
           low=0.0, high=90.0, agreement=0.0, kind=Kind.STATISTIC,
           formula="arccos of the least singular value of U_p^T U_o",
           reference="Bjorck & Golub, Math. Comput. 27, 579, 1973"),
    Metric("subspace_inside_95", "1 where that angle is no larger than sampling makes it in 95 % of draws", _SPREAD,
           low=0.0, high=1.0, kind=Kind.COVERAGE, tolerance=_FLAG, formula="[angle <= 95 % point of the draws]",
           reference="Bjorck & Golub, Math. Comput. 27, 579, 1973"),
    Metric("bhattacharyya_distance", "distance of the two normal laws",
           "processing.classification.bhattacharyya_distance",
           "dm^T S^-1 dm / 8 + ln(|S| / sqrt(|S_1| |S_2|)) / 2, S the mean covariance", low=0.0, agreement=0.0,
           kind=Kind.STATISTIC, reference="Fukunaga 1990, 3.4",
           example="bhattacharyya_distance([0.0], [[1.0]], [2.0], [[1.0]])", gives=0.5),
    Metric("bhattacharyya_covariance_excess", "how far the two covariances are apart (Bhattacharyya distance) "
           "beyond what sampling makes; 0 is the same", _SPREAD, "B - E[B]", agreement=0.0, interval=_BAND,
           short="shape of the spread", reference=_COVARIANCES),
    Metric("noise_ratio", "predicted over measured standard deviation of the noise among the pixels of a class, "
           "all bands together, the size of the class's own spread left free", "processing.sample.noise_part",
           "a^-1/2 of S = a N + g T", low=0.0, agreement=1.0, interval="normal, of a", tolerance=of_value(0.005),
           example="noise_part(4 * np.eye(2), np.eye(2), [1, 1], 100).factor", gives=4.0,
           short="noise", reference="Rao, J. Multivariate Anal. 1, 257, 1971"),
    Metric("background_tail_dof",
           "measured degrees of freedom of a multivariate t in all bands; infinite for normal pixels", _TAILS,
           low=0.0, interval="profile likelihood", evidence=_PIPELINE,
           formula="argmax_nu of the likelihood of t_nu at the squared distances", reference=_T_LAW),
    Metric("background_tail_dof_leading", "the same in the few leading components", _TAILS, low=0.0,
           interval="profile likelihood", evidence=_PIPELINE, formula="the same in the leading components",
           reference=_T_LAW),
    Metric("tail_inverse_dof_difference",
           "1/ν of the t law, predicted − measured; 0 for equal tails, larger 1/ν for heavier ones", _TAILS,
           "1/nu_p - 1/nu_c", agreement=0.0, interval="profile likelihood",
           short="tails", reference=_T_LAW),
    Metric("normality_p_value", "probability of the measured tails, were the pixels normal", _TAILS, low=0.0,
           high=1.0, kind=Kind.TEST, tolerance=_P, evidence=_PIPELINE,
           formula="Phi(-sqrt(2 ln L(nu) - 2 ln L(inf)))",
           reference="Self & Liang, J. Am. Stat. Assoc. 82, 605, 1987"),
    Metric("effective_pixels", "independent pixels behind the variance of the first component", _TAILS, low=0.0,
           evidence=_PIPELINE, formula="n / sum_h rho(h)^2 share(h)",
           reference="Cressie, Statistics for Spatial Data, 1993, 1.3"),
    # Classes told apart.
    Metric("error_predicted", "predicted probability that a Gaussian classifier names the wrong class", _CLASSES,
           low=0.0, high=1.0, interval="draws of the inputs", formula="mean_i P(class != i | i)",
           reference="Fukunaga 1990, 4.1"),
    Metric("error_observed", "measured probability that a Gaussian classifier names the wrong class", _CLASSES,
           low=0.0, high=1.0, interval="exact binomial, independent pixels",
           tolerance=((0.8, "interval"), (0.01, "value")), evidence=_PIPELINE,
           formula="wrong pixels over all, classes weighted alike", reference=_CLASSIFICATION),
    Metric("error_difference", "difference of these (predicted − measured)",
           "compare.rows.difference_interval", "p - o", low=-1.0, high=1.0, agreement=0.0,
           interval="Newcombe", tolerance=((0.8, "interval"), (0.01, "value")),
           reference="Newcombe, Stat. Med. 17, 873, 1998",
           example="difference_interval(0.8, (0.7, 0.9), 0.5, (0.5, 0.5))[0]", gives=0.2,
           short="classification error"),
    Metric("error_inside_interval", "1 when 0 lies in the 95 % interval of that difference, else 0", _CLASSES,
           low=0.0, high=1.0, kind=Kind.COVERAGE, tolerance=_FLAG, formula="[l <= 0 <= u] of the difference",
           short="classification error inside its interval", reference=_CLASSIFICATION),
    Metric("error_approximation", "the same probability from the Bhattacharyya distances", _CLASSES, low=0.0,
           high=1.0, formula="Phi(-sqrt(2 B))", reference="Kerekes & Landgrebe, TR-EE 89-49, Purdue, 1989"),
    Metric("error_bounds", "bounds of it; the value is their geometric mean", _CLASSES, low=0.0, high=1.0,
           interval="bounds", formula="sqrt(l u), l = (1 - sqrt(1 - e^(-2 B))) / 2, u = e^(-B) / 2",
           reference="Kailath, IEEE Trans. Commun. Technol. 15, 52, 1967"),
    Metric("error", "probability of a wrong class, one side alone", _CLASSES, low=0.0, high=1.0,
           interval="of that side", formula="mean_i P(class != i | i)", reference="Fukunaga 1990, 4.1"),
    Metric("distance", "Bhattacharyya distance of the two nearest classes, one side alone", _CLASSES, low=0.0,
           formula="d^T S^-1 d / 8 + ln(|S| / sqrt(|S_1| |S_2|)) / 2, S = (S_1 + S_2) / 2", reference=_FUKUNAGA),
    Metric("distance_predicted", "predicted Bhattacharyya distance of the two nearest classes", _CLASSES, low=0.0,
           formula="that of distance", reference=_FUKUNAGA),
    Metric("distance_observed", "measured Bhattacharyya distance of the two nearest classes", _CLASSES, low=0.0,
           evidence=_PIPELINE, formula="that of distance", reference=_FUKUNAGA),
)  # fmt: skip

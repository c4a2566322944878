"""The Python API: the same three verbs as the command line.

>>> from hyperval.api import compare, load_campaign, load_scenario, observe, predict   # doctest: +SKIP
>>> prediction = predict(load_scenario("panels"))                                      # doctest: +SKIP
>>> campaign = load_campaign("campaigns/pasadena-2017/campaign.yaml")                  # doctest: +SKIP
>>> observed = observe(campaign.collection, campaign.detection, resolve)               # doctest: +SKIP
>>> table = compare(prediction, observed.observation, campaign="mine")                 # doctest: +SKIP
"""

from hyperval.campaign.schema import load_campaign
from hyperval.compare import compare_products
from hyperval.datasets import resolve
from hyperval.observe import Observed, observe
from hyperval.predict import predict
from hyperval.products import Observation, Prediction
from hyperval.results import ResultTable
from hyperval.scenario import load_scenario

__all__ = [
    "Observation",
    "Observed",
    "Prediction",
    "ResultTable",
    "compare",
    "load_campaign",
    "load_scenario",
    "observe",
    "predict",
    "resolve",
]


def compare(
    prediction: Prediction, observation: Observation, *, campaign: str, method: str = "model"
) -> ResultTable:
    """Compare two sides on the same bands; one row for each metric of each product.

    Outcomes come from :func:`hyperval.compare.judged`.

    Raises
    ------
    UsageError : the two sides are not on the same bands.
    """
    return ResultTable(compare_products(prediction, observation, campaign=campaign, method=method))

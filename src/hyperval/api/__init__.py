"""The Python API: the verbs of the command line, from paths or objects, with tables and datasets to work on.

>>> from hyperval import api
>>> prediction = api.predict("scenario.yaml")
>>> prediction
<Prediction of 16 bands, 450-2200 nm>
  radiance: black-panel, court, field, grey-panel-35, large-planks, small-planks, white-panel
  ...
>>> prediction.to_dataframe().columns[:6].tolist()
['campaign', 'product', 'subject', 'method', 'band_nm', 'metric']
>>> run = api.validate("campaign.yaml")
>>> run.to_xarray()["predicted"]["radiance"].dims
('radiance_subject', 'band')

Every object has a short ``repr``, ``to_dataframe()``, ``to_xarray()`` and ``plot``; metrics have nothing to plot.
"""

from hyperval.api.objects import Collection, Metrics, Observation, Prediction, Results, Study, Validation
from hyperval.api.verbs import (
    check,
    compare,
    explain,
    load_campaign,
    load_scenario,
    metrics,
    observe,
    open,
    predict,
    simulate,
    study,
    validate,
)

__all__ = [
    "Collection", "Metrics", "Observation", "Prediction", "Results", "Study", "Validation", "check", "compare",
    "explain", "load_campaign", "load_scenario", "metrics", "observe", "open", "predict", "simulate", "study",
    "validate",
]  # fmt: skip

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
('subject', 'wavelength')

Every object has a short ``repr``, ``to_dataframe()``, ``to_xarray()`` and ``plot``; metrics have nothing to plot.
"""

import lazy_loader

# What is not asked for is not loaded: names and modules stand in the file of types beside this one.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

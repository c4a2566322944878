"""hyperval: does the model of a hyperspectral imager agree with what it collected?

Three verbs, the same in Python and on the command line::

    prediction  = hyperval.predict(scenario)
    observation = hyperval.observe(campaign)
    table       = hyperval.compare(prediction, observation, ...)
"""

__version__ = "0.1.0"

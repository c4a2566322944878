"""hyperval: does the model of a hyperspectral imager agree with what it measured?

``hyperval.open(DIR)`` reads a finished run; all verbs of the Python API are in :mod:`hyperval.api`.
The command line is ``hyperval``.
"""

import lazy_loader

__version__ = "0.1.0"
# What is not asked for is not loaded: names and modules stand in the file of types beside this one.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

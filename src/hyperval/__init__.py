"""hyperval: does the model of a hyperspectral imager agree with what it collected?

The Python API is :mod:`hyperval.api`; the command line is ``hyperval``.
"""

__version__ = "0.1.0"

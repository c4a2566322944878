"""hyperval: does the model of a hyperspectral imager agree with what it measured?

``hyperval.open(DIR)`` reads a finished run; all verbs of the Python API are in :mod:`hyperval.api`.
The command line is ``hyperval``.
"""

from typing import Any

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """``open``, loaded when it is asked for: the command line starts without the libraries behind it."""
    if name == "open":
        from importlib import import_module

        return import_module("hyperval.api").open
    raise AttributeError(f"module 'hyperval' has no attribute {name!r}")

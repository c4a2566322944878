"""Sensor specification, response and noise (3.13-3.20)."""

import lazy_loader

# What is not asked for is not loaded: names and modules stand in the file of types beside this one.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

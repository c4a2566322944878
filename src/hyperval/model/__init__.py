"""The forward model: truths of a scenario, moved by paths, and what a sensor would see and detect of them."""

import lazy_loader

# What is not asked for is not loaded: names and modules stand in the file of types beside this one.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

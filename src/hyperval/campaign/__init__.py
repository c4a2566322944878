"""Campaigns: reading the file, dry runs, running, provenance, drafts, and the power of the criteria."""

import lazy_loader

# What is not asked for is not loaded: names and modules stand in the file of types beside this one.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

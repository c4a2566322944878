"""Work on pixels: statistics of regions, empirical line, detectors, ROC with its intervals, laws of pixels, SNR."""

import lazy_loader

# What is not asked for is not loaded: names and modules stand in the file of types beside this one.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

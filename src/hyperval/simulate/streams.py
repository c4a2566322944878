"""Independent random streams, so that a pixel's draw depends on its place and not on the order of work."""

from __future__ import annotations

import numpy as np

PLACEMENT, TARGET_SPECTRA, FIELDS, SURFACE, NOISE, FIELD_SPECTRA = range(6)


def generator(seed: int, stream: int, index: int) -> np.random.Generator:
    """The generator of one stream and one line, group or field."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=(stream, index))))

"""The 6S engine at fewer wavelengths than it is run at otherwise, for tests that look at some of them."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.atmosphere import sixs


def run_solver_at(patch: pytest.MonkeyPatch, *nodes_nm: float) -> None:
    """Let the solver run at these wavelengths alone [nm], some of them below 1 um: there its terms stay the same.

    Twenty nodes of one hazy state take eight seconds, and between nodes there is but interpolation.
    """
    nodes = np.array(nodes_nm)
    patch.setattr(sixs, "NODES_NM", nodes)
    patch.setattr(sixs, "_MOLECULAR", int(np.sum(nodes < 1000.0)))

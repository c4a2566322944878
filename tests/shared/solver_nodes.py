"""The 6S engine at fewer wavelengths than it is run at otherwise, for tests that look at some of them."""

import numpy as np
import pytest

from hyperval.atmosphere import sixs


def run_solver_at(patch: pytest.MonkeyPatch, *nodes_nm: float) -> None:
    """Let the solver run at these wavelengths alone [nm]: between nodes there is but interpolation."""
    patch.setattr(sixs, "NODES_NM", np.array(nodes_nm))

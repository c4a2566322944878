"""No function of the package is kept for tests alone: production calls it, or a page tells users of it."""

from __future__ import annotations

import ast
from pathlib import Path

from test_every_equation_has_evidence import SOURCE, production

ROOT = Path(__file__).parents[2]
# Exact forms that the tests hold faster ones against; to be written in the tests instead.
REFERENCES = {
    "abundance_covariance", "auc_with_interval", "bootstrap_pd", "partial_auc", "roc_corners", "roc_points",
    "snr_interval", "snr_mean_sd", "wilson",
}  # fmt: skip
# The installed command; forms of our objects for other libraries; errors to be planted in a campaign.
ENTRANCES = {"main", "library_to_spy", "library_to_xarray", "planted_errors", "planted_prediction"}


def public_functions() -> dict[str, Path]:
    """Functions of modules by name, without those that a decorator hands to a registry."""
    return {
        node.name: path
        for path in SOURCE.rglob("*.py")
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not node.decorator_list
    }


def exported() -> set[str]:
    """Names that a package hands on in ``__all__``."""
    names: set[str] = set()
    for path in SOURCE.rglob("__init__.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
                names |= set(ast.literal_eval(node.value))
    return names


def test_no_function_is_called_by_tests_alone():
    pages = "\n".join(p.read_text("utf-8") for p in [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"])
    known = production() | exported() | ENTRANCES
    lonely = {n for n in public_functions() if n not in known and n not in pages}
    assert sorted(lonely - REFERENCES) == []


def test_the_list_of_exceptions_only_shrinks():
    functions, called = public_functions(), production()
    assert len(REFERENCES) <= 9
    assert [n for n in sorted(REFERENCES) if n in called] == []
    assert "roc_points" in functions

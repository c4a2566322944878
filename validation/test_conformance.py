"""Public files at hand are read as they were, and as second readers read them; the manifest can go red."""

from __future__ import annotations

import conformance
import pytest


@pytest.mark.data
def test_every_public_file_is_as_it_was(data_dir, monkeypatch, capsys):
    monkeypatch.setenv("HYPERVAL_DATA", str(data_dir("README.md").parent))
    monkeypatch.setattr("sys.argv", ["conformance.py"])
    assert conformance.main() == 0, capsys.readouterr().out


def test_other_numbers_and_another_refusal_are_changes(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("wavelength_nm,reflectance\n" + "".join(f"{nm},0.5\n" for nm in range(400, 500, 10)))
    entry = {"path": "s.csv", "reader": "spectra", "numbers": {"spectra": 1, "nm": [400.0, 490.0], "mean": 0.5}}
    assert conformance.outcome(path, entry) == ("equal", "")
    assert conformance.outcome(path, entry | {"numbers": {"mean": 0.51}})[0] == "changed"
    assert conformance.outcome(path, {"path": "s.csv", "reader": "spectra", "refused": "no numbers"})[0] == "opens now"
    path.write_text("nothing here\n")
    assert conformance.outcome(path, entry)[0] == "changed"
    words = conformance.outcome(path, entry)[1].removeprefix("refused: ")
    assert conformance.outcome(path, entry | {"refused": words[-30:]})[0] == "refused as expected"

"""A campaign file from somebody else must not reach beyond the data directory, nor open an address."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hyperval import datasets
from hyperval.config import parse_yaml
from hyperval.errors import HypervalError, InputError, UsageError


@pytest.mark.parametrize(
    "reference",
    [
        "data:../secret", "data:hysu/../../secret", "data:/etc/passwd", "data:", "data:a\0b", "data:a\\..\\b",
        "data:http://example.org/a", "data:C:/a", "data:data:a", "data://etc/passwd",
    ],
)  # fmt: skip
def test_data_reference_stays_inside(reference, tmp_path, monkeypatch):
    (tmp_path / "secret").write_text("x")
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "data"))
    with pytest.raises(UsageError, match="leaves the data directory"):
        datasets.resolve(reference)


@pytest.mark.parametrize(
    "reference",
    ["http://example.org/a.img", "https://example.org/a", "file:///etc/passwd", "/vsicurl/http://example.org/a",
     "/vsizip/a.zip", "", "  ", "a\0b"],
)  # fmt: skip
def test_plain_reference_is_no_address_and_no_virtual_file(reference, tmp_path: Path):
    with pytest.raises(UsageError):
        datasets.resolve(reference, tmp_path)


def test_pipe_is_not_opened(tmp_path: Path):
    import os

    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe"):
        datasets.resolve("pipe", tmp_path)


@given(st.text(max_size=60))
@example("data:" + "../" * 20)
def test_any_reference_is_a_file_below_the_root_or_an_error(reference):
    root = Path(__file__).parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYPERVAL_DATA", str(root))
        patch.setenv("HYPERVAL_CACHE", str(root / "none"))
        try:
            found = datasets.resolve("data:" + reference)
        except HypervalError as error:
            assert error.exit_code in (2, 3)  # noqa: PT017 - both ends are asserted
        else:
            assert found.resolve().is_relative_to(root)


def test_yaml_cannot_call_python(tmp_path: Path):
    victim = tmp_path / "made"
    with pytest.raises(UsageError, match="tag"):
        parse_yaml(f"a: !!python/object/apply:os.mkdir ['{victim}']")
    assert not victim.exists()

"""Progress says which campaign and step it belongs to, and nothing where nobody watches."""

import re

from hyperval.progress import step, track, watch_lines, working


def said(capsys) -> str:
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err)


def test_bars_name_campaign_step_and_count(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with step("hysu", 3, 4, "compare"):
        assert list(track([1, 2, 3], "inputs", show=True)) == [1, 2, 3]
        with working("figures", show=True):
            pass
        assert len(list(watch_lines("scores", 10, 2, show=True)(iter([(range(1), 0), (range(1, 2), 0)])))) == 2
    words = said(capsys)
    assert "hysu 3/4 compare: inputs" in words
    assert "3/3" in words
    assert "hysu 3/4 compare: figures" in words
    assert "hysu 3/4 compare: scores" in words
    assert list(track([1], "alone", show=True)) == [1]
    assert "hysu" not in said(capsys)
    with step("hysu", 3, 4, "compare"), working("figures", show=False):  # where nobody watches
        assert list(track(iter([1, 2]), "inputs", show=False)) == [1, 2]
    assert said(capsys) == ""

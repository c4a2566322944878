"""What a collection states wrongly, or what its files lack, is refused in words: the cases of ``refusals.yaml``."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from hyperval.errors import InputError, UsageError

CASES = yaml.safe_load((Path(__file__).parent / "refusals.yaml").read_text("utf-8"))
ERRORS = {error.__name__: error for error in (InputError, UsageError, ValueError)}


def changed(settings: Any, change: Any) -> Any:
    """Settings of which some entries are others; an empty entry takes the place of what stood there."""
    if not (isinstance(settings, dict) and isinstance(change, dict) and change):
        return change
    return settings | {key: changed(settings.get(key), value) for key, value in change.items()}


@pytest.mark.parametrize(
    ("fixture", "change", "error", "words"), [(name, *case) for name, cases in CASES.items() for case in cases]
)
def test_what_cannot_be_observed_is_refused_in_words(request, fixture, change, error, words):
    world = request.getfixturevalue(fixture)
    for name, content in change.pop("files", {}).items():
        world.resolve(name).unlink()
        if content is not None:
            world.text(name, content)
    for part, entries in change.items():
        setattr(world, part, changed(getattr(world, part), entries))
    with pytest.raises(ERRORS[error], match=words):
        world.observe()

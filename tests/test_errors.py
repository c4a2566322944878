"""Words for internal errors."""

import json

import pytest

from hyperval.errors import internal_error
from hyperval.units import wavelength_to_nm


@pytest.mark.parametrize(
    ("fails", "words"),
    [
        (lambda: wavelength_to_nm(None), "AttributeError: 'NoneType' object has no attribute 'strip' (at hyperval/un"),
        (lambda: json.loads("{"), "(at decoder.py:"),  # in another package the innermost place
    ],
)
def test_an_internal_error_says_where_it_arose(fails, words):
    with pytest.raises((AttributeError, json.JSONDecodeError)) as caught:
        fails()
    assert internal_error(caught.value).startswith("internal error: ")
    assert words in internal_error(caught.value)

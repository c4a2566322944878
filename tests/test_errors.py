"""Words for internal errors."""

import json

import pytest

from hyperval.errors import internal_error
from hyperval.units import wavelength_to_nm


def test_an_internal_error_says_where_it_arose():
    with pytest.raises(AttributeError) as caught:
        wavelength_to_nm(None)
    words = internal_error(caught.value)
    assert words.startswith(
        "internal error: AttributeError: 'NoneType' object has no attribute 'strip' (at hyperval/units.py:"
    )


def test_in_another_package_the_innermost_place_is_named_too():
    with pytest.raises(json.JSONDecodeError) as caught:
        json.loads("{")
    assert "(at decoder.py:" in internal_error(caught.value)
    assert internal_error(KeyError("x")) == "internal error: KeyError: 'x'"

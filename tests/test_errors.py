"""Every error of gelform's own can be caught by one name, and none passes for a wrong argument."""

import json

import pytest

from gelform import errors


def test_one_base():
    types = [value for value in vars(errors).values() if isinstance(value, type)]
    own = [one for one in types if one.__module__ == errors.__name__]
    assert len(own) >= 5
    assert all(issubclass(one, errors.GelformError) for one in own)
    assert not any(issubclass(one, ValueError | TypeError | OSError) for one in own)
    assert all(one.__doc__ for one in own)


def test_a_package_that_is_not_installed_names_its_extra():
    assert errors.needed("json", "none", "JSON") is json
    with pytest.raises(errors.DataError, match=r'Cubes needs the extra cube: pip install "gelform\[cube\]"'):
        errors.needed("gelform_cubes", "cube", "Cubes")

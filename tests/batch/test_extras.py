"""A package that is not installed is an error that names its extra."""

import json

import pytest

from gelform.batch.extras import needed
from gelform.errors import DataError


def test_there():
    assert needed("json", "none", "JSON") is json


def test_not_there():
    with pytest.raises(DataError, match=r'Cubes needs the extra cube: pip install "gelform\[cube\]"'):
        needed("gelform_cubes", "cube", "Cubes")

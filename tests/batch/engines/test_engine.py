"""What cannot be is said before the work."""

import pytest

from gelform.batch.engines.engine import Engine


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"name": "dask"}, "Expected an engine among pool, ray, got 'dask'"),
        ({"workers": 0}, "at least one worker"),
        ({"address": "auto"}, "an address with the engine ray, got one with pool"),
    ],
)
def test_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        Engine(**wrong)

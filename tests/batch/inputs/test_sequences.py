"""Names in the order in which people count."""

import pytest

from gelform.batch.inputs.sequences import natural


@pytest.mark.parametrize(
    "names", [["image2", "image10"], ["a", "a1", "a01b"], ["demo_9/x", "demo_10/x"], ["1", "a"]]
)
def test_numbers_count(names):
    assert sorted(set(names), key=natural) == names

"""One whole run, or several shards, each once."""

from contextlib import nullcontext

import pytest

from gelform.batch.locks import only_run
from gelform.errors import DataError

pytest.importorskip("fcntl")
WHOLE = (1, 1)


@pytest.mark.parametrize(
    ("first", "second", "together"),
    [
        (WHOLE, WHOLE, False),
        (WHOLE, (1, 2), False),
        ((1, 2), WHOLE, False),
        ((1, 2), (2, 2), True),
        ((1, 2), (1, 2), False),
    ],
)
def test_who_may_run_together(tmp_path, first, second, together):
    refused = pytest.raises(DataError, match=r"now\. Wait for it")
    with only_run(tmp_path, first), nullcontext() if together else refused, only_run(tmp_path, second):
        pass
    with only_run(tmp_path, second) as alone:  # the lock is let go
        assert alone == (second == WHOLE)

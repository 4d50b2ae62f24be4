"""Work arrays: never lent twice at once, lent again afterwards."""

from concurrent.futures import ThreadPoolExecutor
from itertools import count
from threading import Barrier

import pytest

from gelform.pool import Pool


def test_what_came_back_is_lent_again():
    made = count()
    pool = Pool(lambda: next(made))
    with pool.one() as first:
        pass
    with pool.one() as second, pool.one() as third:
        assert (first, second, third) == (0, 0, 1)


def test_work_is_forgotten_after_an_exception():
    """It may hold NaN, and would poison whatever uses it next."""
    pool = Pool(count().__next__)
    with pytest.raises(RuntimeError), pool.one():
        raise RuntimeError
    with pool.one() as fresh:
        assert fresh == 1


def test_threads_never_hold_the_same_work():
    pool, together = Pool(object), Barrier(8)

    def hold(_):
        with pool.one() as work:
            together.wait()  # all eight hold theirs at once
            return id(work)

    with ThreadPoolExecutor(8) as threads:
        assert len(set(threads.map(hold, range(8)))) == 8

"""Work arrays: never lent twice at once, lent again afterward."""

import platform
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from threading import Barrier

import pytest

from gelform.foundations.pool import Pool

PAGES_TAKEN_AGAIN = """
import resource, sys
import numpy as np
from gelform.foundations.pool import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory(20 << 20)
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    maps = [np.ones(75_000, np.float32) for _ in range(30)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
print([faults() for _ in range(5)][-1])
"""


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


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries take no notice")
def test_freed_memory_is_kept():
    """30 maps of 75 pages of 4 KB are made and freed, over and over."""
    taken = {
        how: int(
            subprocess.run(
                [sys.executable, "-c", PAGES_TAKEN_AGAIN, how], stdout=subprocess.PIPE, check=True
            ).stdout
        )
        for how in ("kept", "handed back")
    }
    assert taken["kept"] < 100 < taken["handed back"]

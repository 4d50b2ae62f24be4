"""The tally of many frames: doubtful ones, and failures by reason.

Long work reports to a callable (done, total, what); by default to none.

Picture files hold the pixels that were given, red first.

Work arrays: never lent twice at once, lent again afterward.
"""

import inspect
import platform
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from itertools import count
from threading import Barrier

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.foundations.findings import FrameTally, Progress, no_progress
from gelform.foundations.pictures import FAST_PNG, picture_bytes
from gelform.foundations.pool import Pool


def test_frames_with_a_doubtful_finding_or_without_depth_are_doubtful():
    tally = FrameTally()
    for names, known in ((["exposure", "steep"], True), (["beyond_gel", "exposure"], True), ([], False)):
        tally.add(names, known=known)
    assert (tally.frames, tally.doubtful, tally.unknown) == (3, 2, 1)
    assert tally.findings == {"exposure": 2, "steep": 1, "beyond_gel": 1}
    assert tally.is_doubtful
    assert not tally.is_useless
    tally.add(["exposure"], known=True)
    assert not tally.is_doubtful, "half is not most"


def test_a_reason_is_one_whatever_file_and_figure_it_names():
    tally = FrameTally()
    for reason in ("/a/1.png: too small (3 px)", "/b c.png: bad", "/d/22.png: too small (14 px)"):
        tally.add_failed(reason)
    assert sorted(tally.reasons.values()) == [1, 2]
    assert tally.examples[max(tally.reasons, key=tally.reasons.get)] == "/a/1.png: too small (3 px)"


def test_nothing_is_reported_by_default(capsys):
    assert no_progress(1, 2, "working") is None
    assert capsys.readouterr() == ("", "")


def test_every_public_progress_is_that_one():
    functions = [value for name in gelform.__all__ if inspect.isfunction(value := getattr(gelform, name))]
    reporting = [one for one in functions if "progress" in inspect.signature(one).parameters]
    assert reporting
    for function in reporting:
        parameter = inspect.signature(function).parameters["progress"]
        assert parameter.annotation in (Progress, "Progress"), function
        assert parameter.default is no_progress, function
        assert import_module(function.__module__).Progress is Progress, function


IMAGE = np.random.default_rng(0).integers(0, 256, (7, 9, 3)).astype(np.uint8)


def decoded(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("settings", [(), FAST_PNG])
def test_images_come_back_with_red_first(settings):
    np.testing.assert_array_equal(decoded(picture_bytes(IMAGE, settings=settings))[..., ::-1], IMAGE)


def test_maps_keep_their_type():
    levels = IMAGE[..., 0].astype(np.uint16) * 257
    np.testing.assert_array_equal(decoded(picture_bytes(levels)), levels)
    depth = levels.astype(np.float32) / 7
    np.testing.assert_array_equal(decoded(picture_bytes(depth, ".tiff")), depth)


def test_what_no_picture_holds_is_refused():
    with pytest.raises(DataError, match="cannot encode a picture of 0x4 px as PNG"):
        picture_bytes(np.zeros((0, 4, 3), np.uint8))


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

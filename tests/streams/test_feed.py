"""Where frames come from: the newest of what is live, every one of a recording."""

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.sensors.grabber import Grabber
from gelform.streams.feed import feed_from_source
from made.sources import ImageSource


def test_a_recording_gives_every_frame_in_order(at_rest):
    feed = feed_from_source(ImageSource(at_rest, live=False, count=5))
    assert feed.every
    assert [feed.next(-1).index for _ in range(5)] == [0, 1, 2, 3, 4]
    assert feed.state == "running"
    assert feed.next(4) is None
    assert feed.state == "ended"
    assert feed.reason


def test_a_live_source_is_opened_once_and_gives_frames_newer_than_the_last(at_rest):
    """A camera cannot be opened twice."""
    opened = []

    def open_it():
        opened.append(ImageSource(at_rest))
        return opened[-1]

    feed = feed_from_source(open_it)
    assert not feed.every
    first = feed.next(-1)
    assert feed.next(first.index).index > first.index
    assert feed.state == "running"
    feed.close()
    assert feed.state == "ended"
    assert [one.closed for one in opened] == [True]


def test_a_folder_is_read_from_its_first_image(at_rest, tmp_path):
    for number, image in enumerate(at_rest[:4]):
        cv2.imwrite(str(tmp_path / f"{number}.png"), image[..., ::-1])
    feed = feed_from_source(tmp_path)
    frames = [feed.next(-1) for _ in range(5)]
    assert [frame.index for frame in frames[:4]] == [0, 1, 2, 3]
    assert frames[4] is None
    np.testing.assert_array_equal(frames[0].image, at_rest[0])


def test_a_grabber_that_is_shared_goes_on(at_rest):
    with Grabber(lambda: ImageSource(at_rest)) as grabber:
        feed_from_source(grabber).close()
        assert grabber.newest(-1, 5) is not None
        assert grabber.state == "running"


def test_what_is_no_source():
    with pytest.raises(TypeError, match=r"Expected a source.*int"):
        feed_from_source(7)
    with pytest.raises(DataError, match="nowhere"):
        feed_from_source("nowhere.mp4")

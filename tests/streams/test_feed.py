"""Where frames come from: the newest of what is live, every one of a recording."""

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


def test_a_live_source_gives_frames_newer_than_the_last(at_rest):
    feed = feed_from_source(lambda: ImageSource(at_rest))
    assert not feed.every
    first = feed.next(-1)
    assert feed.next(first.index).index > first.index
    assert feed.state == "running"
    feed.close()
    assert feed.state == "ended"


def test_the_first_source_is_not_opened_twice(at_rest):
    opened = []

    def open_it():
        opened.append(ImageSource(at_rest))
        return opened[-1]

    feed = feed_from_source(open_it)
    assert feed.next(-1) is not None
    feed.close()
    assert len(opened) == 1
    assert opened[0].closed


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

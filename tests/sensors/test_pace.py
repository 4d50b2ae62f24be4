"""The pace of frames that do not come from a camera."""

import pytest

from gelform.sensors.pace import Pace


class Clock:
    """A clock that only sleep moves."""

    now = 100.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def pace(clock):
    return Pace(20.0, clock=clock, sleep=clock.sleep)


def test_waits_for_each_frame(pace, clock):
    assert [pace.wait_for(k) for k in range(4)] == pytest.approx([100, 100.05, 100.1, 100.15])
    assert clock.now == pytest.approx(100.15)


def test_does_not_wait_for_what_is_past(pace, clock):
    clock.now += 1
    assert pace.wait_for(3) == pytest.approx(100.15)
    assert clock.now == 101


def test_a_late_reader_goes_on_with_the_frame_that_is_due(pace, clock):
    pace.wait_for(0)
    assert pace.next_after(0) == 1
    clock.now += 0.52
    assert pace.next_after(0) == 10
    assert pace.late_s(0.5) == pytest.approx(0.02)
    assert pace.late_s(1.0) < 0

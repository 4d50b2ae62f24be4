"""The newest value between two threads: replaced, waited for, ended."""

from threading import Event, Thread

import pytest

from gelform.streams.hand_over import HandOver


def test_a_late_reader_gets_the_newest_alone():
    values = HandOver()
    for number, value in enumerate("abc"):
        values.put(number, value)
    assert values.newest() == values.newest(after=1) == "c"
    assert values.newest(after=2, timeout_s=0.01) is None


def test_readers_do_not_take_from_each_other():
    values = HandOver()
    values.put(7, "a")
    assert values.newest() == values.newest(after=6) == "a"


def test_where_every_value_counts_the_writer_waits():
    values, written = HandOver(every=True), Event()

    def write():
        values.put(0, "a")
        values.put(1, "b")
        written.set()

    Thread(target=write, daemon=True).start()
    assert values.newest(timeout_s=5) == "a"
    assert values.newest(after=0, timeout_s=5) == "b"
    assert written.wait(5)


def test_where_every_value_counts_an_unread_one_is_not_replaced():
    values, second = HandOver(every=True), Event()
    values.put(0, "a")
    writer = Thread(target=lambda: (values.put(1, "b"), second.set()), daemon=True)
    writer.start()
    assert not second.wait(0.05)
    values.end()  # frees a writer that nobody reads from any more
    writer.join(5)
    assert not writer.is_alive()


def test_a_reader_that_waits_is_woken_by_the_end():
    values, found = HandOver(), []
    reader = Thread(target=lambda: found.append(values.newest()), daemon=True)
    reader.start()
    values.end()
    reader.join(5)
    assert found == [None]


def test_the_error_comes_after_the_last_value():
    values = HandOver()
    values.put(0, "a")
    values.end(ValueError("broken"))
    values.end()
    assert values.newest() == "a"
    with pytest.raises(ValueError, match="broken"):
        values.newest(after=0)
    assert values.ended


def test_a_value_that_is_being_made_is_waited_for():
    """What lies here gets older while the new one is made: a reader gets the new one."""
    values, found = HandOver(), []
    values.put(0, "old")
    values.expect(1)
    reader = Thread(target=lambda: found.append(values.newest(timeout_s=5)), daemon=True)
    reader.start()
    reader.join(0.05)
    assert found == []
    values.put(1, "new")
    reader.join(5)
    assert found == ["new"]


def test_of_a_value_that_does_not_come_the_older_one_is_given():
    values = HandOver()
    values.put(0, "old")
    values.expect(1)
    assert values.newest(timeout_s=0) == values.newest(timeout_s=0.02) == "old"
    values.end()
    assert values.newest() == "old"

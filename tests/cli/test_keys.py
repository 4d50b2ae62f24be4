"""Single keys from a real terminal."""

import os
import sys

import pytest

from gelform.cli.keys import single_keys
from gelform.errors import DataError

termios = pytest.importorskip("termios", reason="no POSIX terminal here")


@pytest.fixture
def keyboard(monkeypatch):
    keys, terminal = os.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield keys
    os.close(keys)


def test_keys_come_without_enter_and_the_terminal_is_as_before(keyboard):
    before = termios.tcgetattr(sys.stdin)
    with single_keys("this") as key:
        os.write(keyboard, b" q")
        assert [key(5.0), key(5.0), key(0.01)] == [" ", "q", None]
    assert termios.tcgetattr(sys.stdin) == before


def test_the_terminal_is_as_before_also_after_an_error(keyboard):
    before = termios.tcgetattr(sys.stdin)
    with pytest.raises(RuntimeError), single_keys("this"):
        raise RuntimeError
    assert termios.tcgetattr(sys.stdin) == before


def test_no_terminal_says_so(monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with pytest.raises(DataError, match="this takes keys from a terminal"), single_keys("this"):
            pass

"""Sinks by name: what is unknown, what is not installed, nothing at all."""

import importlib.util

import pytest

from gelform.errors import DataError
from gelform.live.sinks.chosen import SINKS, feed


def test_none_is_fine(hub):
    assert feed(hub, []) == ([], [])


def test_an_unknown_one_is_named(hub):
    with pytest.raises(ValueError, match="sinks among rerun, foxglove, got rviz"):
        feed(hub, ["rerun", "rviz"])


@pytest.mark.parametrize("name", SINKS)
def test_without_its_extra_it_is_named(hub, name):
    if importlib.util.find_spec(name) is not None:
        pytest.skip(f"{name} is installed")
    with pytest.raises(DataError, match=rf"extra {name}: pip install 'gelform\[{name}\]'"):
        feed(hub, [name])

"""Sinks by name."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from gelform.live.hub import Hub
from gelform.live.sinks.feeder import Feeder
from gelform.live.sinks.foxglove import FoxgloveSink
from gelform.live.sinks.rerun import RerunSink

SINKS: dict[str, Callable[[], Any]] = {"rerun": RerunSink, "foxglove": FoxgloveSink}


def feed(hub: Hub, names: list[str]) -> tuple[list[Feeder], list[str]]:
    """Feed the sinks of those names; the feeders, and a sentence for each that says where it is seen.

    Raises
    ------
    ValueError
        An unknown name.
    DataError
        The sink's extra is not installed.
    GelformError
        No viewer answers, or the port is taken; none is fed then.
    """
    unknown = [name for name in names if name not in SINKS]
    if unknown:
        raise ValueError(f"Expected sinks among {', '.join(SINKS)}, got {', '.join(unknown)}.")
    made: list[tuple[str, Any]] = []
    with ExitStack() as undone:
        for name in dict.fromkeys(names):
            made.append((name, SINKS[name]()))
            undone.callback(made[-1][1].close)
        undone.pop_all()  # all were made: they stay
    return [Feeder(hub, sink, name) for name, sink in made], [sink.how for _, sink in made]

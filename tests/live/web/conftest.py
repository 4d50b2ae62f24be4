"""The server itself, on a free port, in a thread: what is tested is what runs."""

import threading

import pytest

from gelform.live.web.server import listen
from live_waiting import until


class Running:
    """A server that answers; `address` is host and port."""

    def __init__(self, hub, **how):
        self.server = listen(port=0, **how)
        self.uvicorn = self.server.uvicorn_of(hub)
        self.address = self.server.address
        self.url = f"http://{self.address}"
        self._thread = threading.Thread(target=self.server.run, args=(self.uvicorn,), daemon=True)
        self._thread.start()
        until(lambda: self.uvicorn.started)

    def close(self):
        self.uvicorn.should_exit = True
        self._thread.join(5)


@pytest.fixture
def serving(hub):
    """Starts servers of the hub; all end with the test."""
    running = []

    def start(**how):
        running.append(Running(hub, **how))
        return running[-1]

    yield start
    for one in running:
        one.close()

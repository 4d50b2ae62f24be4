"""A hub with one small simulated sensor, calibrated; a frame of it; servers that answer."""

from __future__ import annotations

import threading

import pytest
from websockets.sync.client import connect

from gelform import Frame, Reconstructor
from gelform.live.hub import Hub
from gelform.live.lists import Calibrations
from gelform.live.shown import ShownFrame
from gelform.live.station import Setup, Station
from gelform.live.web.server import listen
from gelform.sensors.simulated import SimulatedSource
from live_waiting import until


@pytest.fixture(scope="session")
def result(calibration, press):
    return Reconstructor(calibration).from_image(press.image)


@pytest.fixture
def shown(press, result):
    frame = Frame(press.image, 12.5, 10**18, 7)
    return ShownFrame(3, frame, press.image, result)


@pytest.fixture
def show():
    """Starts a station on a source, in a hub of its own if none is given; returned once its first frame is shown."""
    own, started = Hub(), []

    def on(opening, hub=own, setup=None, watched=lambda: True, waits=True):
        station = Station(len(hub.stations), "camera", opening, hub.changed, watched)
        station.setup = setup or Setup()
        hub.stations.append(station)
        started.append(station)
        station.start()
        if waits:
            until(lambda: station.newest)
        return station

    yield on
    for station in started:
        station.close()


@pytest.fixture
def hub(sensor, calibration, library, show):
    """A hub whose one station shows the simulated sensor at rest."""
    made = Hub(calibrations=Calibrations())

    def opened():
        source = SimulatedSource(sensor, rate_hz=20)  # enough to look at; 60 keep a processor busy
        source.rest()
        return source

    show(opened, made, Setup(calibration, made.calibrations.add("mine", calibration)))
    yield made
    made.close()


@pytest.fixture
def station(hub):
    """The hub's station."""
    return hub.stations[0]


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

    def opened(self, **headers):
        """A websocket as a page opens it, from the server's own origin by default."""
        return connect(
            f"ws://{self.address}/ws",
            origin=headers.pop("origin", self.url),
            additional_headers=headers,
            compression=None,
            max_size=None,
            close_timeout=1,
            proxy=None,
        )

    def close(self):
        self.uvicorn.should_exit = True
        self._thread.join(5)


@pytest.fixture
def serving_of():
    """Starts servers of any hub; all end with the test, and their hubs too."""
    running = []

    def start(hub, **how):
        running.append(Running(hub, **how))
        return running[-1]

    yield start
    for one in running:
        one.close()


@pytest.fixture
def serving(serving_of, request):
    """Starts servers of the hub, which is made when the first one is."""
    return lambda **how: serving_of(request.getfixturevalue("hub"), **how)

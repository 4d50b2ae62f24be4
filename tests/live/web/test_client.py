"""Messages of a client: each is a known command with fields of the right type, or is refused.

Websockets to the running server: credit, the newest frame, slow and hostile clients, wrong origins.
"""

import contextlib
import json
import sys
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from gelform import GelformError, open_source
from gelform.live.hub import BUSY, Hub
from gelform.live.shown import read_message
from gelform.live.web.app import MAX_CLIENTS
from gelform.live.web.client import (
    COMMANDS,
    MAX_BYTES,
    MAX_NUMBERS,
    MAX_OLDER,
    MessageError,
    done,
    parsed,
    thinned,
)
from gelform.sensors.simulated import SimulatedSource
from live_waiting import next_of, until
from made.sources import small_disk

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)
NAMES = st.sampled_from(["station", "name", "x_px", "frame", "speed", "paused", "view", "x"])


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=200) | JSON.map(json.dumps))
def test_whatever_is_no_message_is_refused_as_one(message):
    try:
        content = parsed(message)
    except MessageError:
        return
    assert isinstance(content["do"], str)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(COMMANDS)), st.dictionaries(NAMES, JSON))
def test_fields_are_checked_before_anything_happens(name, fields):
    """The hub has no station: what passes the checks can only be told so."""
    with pytest.raises(GelformError):
        done(Hub(), {"do": name, **fields})


def test_what_is_no_message():
    infinite = '{"do": "press", "station": 0, "x_px": Infinity, "y_px": 0}'
    for message in ("x" * (MAX_BYTES + 1), "[" * 9000, '{"do": NaN}', infinite, "{}", "[]", '{"do": 3}'):
        with pytest.raises(MessageError):
            parsed(message)


def test_wrong_fields_are_the_clients_fault_and_refusals_hold_no_path():
    right = {"station": 0, "x_px": 1, "y_px": 1}
    wrong = ({"station": True}, {"x_px": True}, {"x_px": 1e300}, {"z_px": 1}, {"station": -1})
    for fields in (*(right | one for one in wrong), {"station": 0, "x_px": 1}):
        with pytest.raises(MessageError):
            done(Hub(), {"do": "press", **fields})
    with pytest.raises(MessageError) as refused:
        done(Hub(), {"do": "../../etc/passwd"})
    assert "/" not in str(refused.value)


def test_what_is_done_is_announced_to_all_pages_and_what_is_refused_is_not(hub, station, monkeypatch):
    told = []
    monkeypatch.setattr(hub, "changed", lambda: told.append(station.paused))
    done(hub, {"do": "pause", "station": 0, "paused": True})
    with pytest.raises(GelformError, match="Open a recording first"):
        done(hub, {"do": "step", "station": 0, "by": 1})
    assert told == [True]


FIELDS = st.sampled_from(["do", "station", "planes"])
WATCH = {"do": "watch", "stations": [0], "planes": ["depth", "flags"], "encoding": "raw"}


@pytest.fixture
def running(serving):
    return serving()


def say(socket, **message):
    socket.send(json.dumps(message))


def next_frame(socket, timeout=5):
    return next_of(socket, lambda data: isinstance(data, bytes) and read_message(data), timeout)


def next_words(socket, kind, has=(), timeout=8):
    """The next words of a kind that have something under those names."""

    def words(data):
        found = json.loads(data) if isinstance(data, str) else {}
        return found if found.get("kind") == kind and all(found[name] for name in has) else None

    return next_of(socket, words, timeout)


@pytest.fixture
def socket(running):
    """A websocket that watches the hub's station."""
    with running.opened() as opened:
        say(opened, **WATCH)
        yield opened


def test_a_frame_comes_for_each_credit_and_no_more(socket, station):
    say(socket, do="credit")
    header, planes = next_frame(socket)
    assert header["station"] == 0
    assert set(planes) == {"depth", "flags"}
    assert len(planes["depth"]) == 2 * station.newest.result.depth.size
    with pytest.raises((TimeoutError, AssertionError)):
        next_frame(socket, 0.6)


def test_what_was_missed_is_passed_over(socket, station):
    say(socket, do="credit")
    first = next_frame(socket)[0]["serial"]
    until(lambda: station.newest.serial > first + 10)
    say(socket, do="credit")
    header, _ = next_frame(socket)
    assert header["serial"] > first + 9
    assert len(header["numbers"]) > 5  # but their numbers come, for the curves


def test_planes_are_those_of_the_newest_frame(socket, station):
    station.source.press_at(90, 60, 0.4, held_s=20)
    until(lambda: station.newest.numbers.peak > 0.3)
    station.paused = True
    time.sleep(0.3)
    say(socket, do="credit")
    wanted = station.newest.planes(WATCH["planes"], "raw")
    assert next_frame(socket)[1] == {one.facts["name"]: one.data for one in wanted}
    say(socket, **WATCH | {"planes": ["image"]})
    say(socket, do="credit")
    assert set(next_frame(socket)[1]) == {"image"}, "the held frame comes again"


def test_older_numbers_are_thinned_to_their_deepest():
    rows = [(k, k / 60, (k * 37) % 101 / 100, 0.0, 0.0) for k in range(MAX_NUMBERS + 3 * MAX_OLDER + 1)]
    kept = thinned(rows)
    assert kept[-MAX_NUMBERS:] == rows[-MAX_NUMBERS:]
    assert len(kept) <= MAX_NUMBERS + MAX_OLDER
    times_s = [row[1] for row in kept]
    assert times_s == sorted(times_s)
    assert times_s[0] < 4 / 60
    assert max(row[2] for row in kept[:-MAX_NUMBERS]) == max(row[2] for row in rows[:-MAX_NUMBERS])
    assert thinned(rows[:50]) == rows[:50]
    assert thinned([]) == []


def test_the_state_comes_by_itself_and_answers_to_buttons(socket):
    assert next_words(socket, "state")["stations"][0]["state"] == "running"
    say(socket, do="calibration", station=0, name="nonsense")
    assert "There is no calibration" in next_words(socket, "done")["problem"]
    say(socket, do="ping", sent=1.5)
    assert next_words(socket, "pong")["sent"] == 1.5
    say(socket, do="snapshot", station=0)
    assert next_words(socket, "snapshot")["number"] == 1


def test_a_stalled_client_costs_the_others_nothing(running, station):
    with running.opened() as stalled, running.opened() as quick:
        for socket in (stalled, quick):
            say(socket, **{**WATCH, "planes": ["depth", "image", "confidence"]})
        for _ in range(4):
            say(stalled, do="credit")  # and then it never reads
        serials = []
        for _ in range(30):
            say(quick, do="credit")
            serials.append(next_frame(quick)[0]["serial"])
        assert serials == sorted(set(serials))
        assert station.facts()["rate_hz"] > 0
        assert station.facts()["state"] == "running"


def test_clicks_at_a_held_sensor_cost_other_pages_nothing(running, hub, sensor, show):
    """Three pages click eight times on Background, where no frame will come; a fourth one looks at another sensor."""
    show(lambda: SimulatedSource(sensor, seed=1), hub)
    with running.opened() as onlooker, contextlib.ExitStack() as pages:
        clicking = [pages.enter_context(running.opened()) for _ in range(3)]
        say(clicking[0], do="pause", station=0, paused=True)
        assert next_words(clicking[0], "done")["problem"] == ""
        say(onlooker, **{**WATCH, "stations": [1], "planes": ["image"]})
        for socket in clicking:
            for _ in range(8):
                say(socket, do="background", station=0)
        began_s = time.monotonic()
        for _ in range(20):
            say(onlooker, do="credit")
            next_frame(onlooker, 8)
        for socket in clicking:
            problems = {next_words(socket, "done")["problem"] for _ in range(8)}
            assert problems <= {"The picture is held. Press Continue first.", BUSY}
        assert time.monotonic() - began_s < 10  # one click that waits for frames takes 15 s


def test_an_action_that_fails_as_nobody_expected_is_answered_and_logged(socket, monkeypatch, caplog):
    monkeypatch.setitem(COMMANDS, "zero", (lambda hub, station: [][station.number], {}))
    say(socket, do="zero", station=0)
    assert "mistake in gelform, not yours: IndexError" in next_words(socket, "done")["problem"]
    assert caplog.records[-1].exc_info[0] is IndexError


def test_pages_that_press_record_at_once_begin_one_file(running, hub, tmp_path):
    hub.folder = tmp_path
    with contextlib.ExitStack() as pages:
        sockets = [pages.enter_context(running.opened()) for _ in range(6)]
        for socket in sockets:
            say(socket, do="record", station=0, on=True, page="")
        problems = {next_words(socket, "done")["problem"] for socket in sockets}
        assert problems <= {"", BUSY}  # the first recording of a process takes longer to begin
        until(lambda: hub.recorders[0].stats.frames)
        say(sockets[-1], do="record", station=0, on=False, page="")
        next_words(sockets[-1], "done")
    assert len(list(tmp_path.iterdir())) == 1
    assert not hub.recorders


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="mounts a tmpfs")
def test_a_disk_that_fills_up_ends_the_recording_on_the_page_too(running, hub, tmp_path):
    with small_disk(tmp_path / "disk", 2048) as hub.folder, running.opened() as socket:
        say(socket, do="record", station=0, on=True, page="")
        until(lambda: 0 in hub.recorders)
        until(lambda: 0 not in hub.recorders)
        state = next_words(socket, "state", ["notices"])
        assert "No space left on device. Its first" in state["notices"][-1][2]
        assert state["recordings"] == {}
        (name,) = hub.recordings.facts()
        kept = len(list(open_source(hub.recordings.path(name["name"]))))
        assert f"Recorded {kept} frames: {name['name']}" in state["notices"][-1][2]


def test_other_pages_get_no_websocket(running):
    for headers in (
        {"origin": None},
        {"origin": "http://evil.example"},
        {"Host": "evil.example"},
        {"Sec-Fetch-Site": "cross-site"},
    ):
        with pytest.raises((InvalidHandshake, ConnectionClosed)), running.opened(**headers) as socket:
            socket.recv(timeout=3)


def test_without_the_token_there_is_no_websocket(serving):
    running = serving(token=True)
    with pytest.raises((InvalidHandshake, ConnectionClosed)), running.opened() as socket:
        socket.recv(timeout=3)
    port = running.address.split(":")[1]
    with running.opened(Cookie=f"gelform_{port}={running.server.token}") as socket:
        assert next_words(socket, "state")


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.text(max_size=300)
    | st.binary(max_size=300)
    | st.builds(json.dumps, st.dictionaries(FIELDS, st.none() | st.integers() | st.text(max_size=5)))
)
def test_nonsense_closes_its_own_websocket_alone(running, message):
    with running.opened() as socket:
        socket.send(message)
        until_closed(socket)
    with running.opened() as socket:
        assert next_words(socket, "state")


def test_of_several_stations_each_gets_its_turn(running, hub, sensor, show):
    show(lambda: SimulatedSource(sensor, seed=1), hub)
    with running.opened() as socket:
        say(socket, **{**WATCH, "stations": [0, 1], "planes": ["image"], "few": [1]})
        sent, from_station = {0: 0, 1: 0}, []
        for _ in range(8):  # one credit at a time, given when both have something new
            until(lambda: all(hub.stations[one].newest.serial > sent[one] for one in sent))
            say(socket, do="credit")
            header = next_frame(socket)[0]
            sent[header["station"]] = header["serial"]
            from_station.append(header["station"])
    assert from_station in ([0, 1] * 4, [1, 0] * 4)


def test_oversized_messages_and_floods_are_cut_off(running):
    with running.opened() as socket:
        socket.send("x" * 100_000)
        until_closed(socket)
    with running.opened() as socket:
        with contextlib.suppress(ConnectionClosed):
            for _ in range(5000):
                say(socket, do="credit")
        until_closed(socket)


def until_closed(socket):
    """Read until the server closes."""
    with contextlib.suppress(ConnectionClosed):
        for _ in range(1000):
            socket.recv(timeout=5)
        raise AssertionError("it was not closed")


def test_so_many_pages_and_no_more(running):
    with contextlib.ExitStack() as all_of_them:
        many = [all_of_them.enter_context(running.opened()) for _ in range(MAX_CLIENTS)]
        for socket in many:
            next_words(socket, "state")
        with pytest.raises(ConnectionClosed), running.opened() as socket:
            socket.recv(timeout=3)
        many.pop().close()
        until(lambda: _welcome(running))


def _welcome(running):
    try:
        with running.opened() as socket:
            return next_words(socket, "state")
    except ConnectionClosed:
        return None

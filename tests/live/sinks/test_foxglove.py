"""The real server of the Foxglove SDK, and a client that speaks its protocol."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
connect = pytest.importorskip("websockets.sync.client", reason="the extra live is not installed").connect

from gelform.errors import GelformError  # noqa: E402
from gelform.live.sinks.foxglove import FoxgloveSink  # noqa: E402

TCP, LISTENING = Path("/proc/net/tcp"), "0A"
MESSAGE_DATA = 1  # opcode of the protocol: then subscription u32, log time u64, the message


@pytest.fixture
def sink():
    made = FoxgloveSink(0)
    yield made
    made.close()


def test_a_client_gets_images_and_numbers(sink, shown):
    sink.show("sensor_0", shown)  # topics are announced with their first message
    with connect(sink.address, subprotocols=["foxglove.sdk.v1"]) as client:
        topics = {}
        while len(topics) < 3:
            said = json.loads(client.recv(timeout=10))
            topics |= {one["topic"]: one for one in said.get("channels", [])}
        wanted = topics["/sensor_0/indentation"]
        asked = {"op": "subscribe", "subscriptions": [{"id": 7, "channelId": wanted["id"]}]}
        client.send(json.dumps(asked))
        message = None
        for _ in range(50):
            sink.show("sensor_0", shown)
            try:
                message = client.recv(timeout=0.2)
            except TimeoutError:
                continue
            if isinstance(message, bytes) and message[0] == MESSAGE_DATA:
                break
    assert set(topics) == {"/sensor_0/image", "/sensor_0/indentation", "/sensor_0/numbers"}
    assert wanted["schemaName"] == "foxglove.RawImage"
    subscription, stamp_ns = struct.unpack("<IQ", message[1:13])
    assert (subscription, stamp_ns) == (7, shown.frame.wall_time_ns)
    metres = shown.result.depth_mm * np.float32(1e-3)
    metres[~shown.result.known] = np.nan
    assert metres.astype("<f4").tobytes() in message


@pytest.mark.skipif(not TCP.is_file(), reason="reads Linux's table of sockets")
def test_only_this_machine_can_connect(sink):
    port = int(sink.address.rpartition(":")[2])
    sockets = [line.split() for line in TCP.read_text().splitlines()[1:]]
    listening = [one[1] for one in sockets if one[3] == LISTENING and int(one[1].split(":")[1], 16) == port]
    assert listening == [f"0100007F:{port:04X}"]  # 127.0.0.1


def test_a_port_that_is_taken_is_said(sink):
    port = int(sink.address.rpartition(":")[2])
    with pytest.raises(GelformError, match=rf"cannot listen on 127\.0\.0\.1:{port}.*end it"):
        FoxgloveSink(port)

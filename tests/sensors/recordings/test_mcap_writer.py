"""MCAP files while they are written: readable after a kill, and by other readers."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_reader import mcap_playback, mcap_summary
from gelform.sensors.recordings.mcap_writer import McapRecording
from made.recorded import START_NS, frames, recorded
from made.small_disk import small_disk

reader = pytest.importorskip("mcap.reader", reason="the extra mcap is not installed")

RECORDER = """
import sys, time
from dataclasses import replace
from pathlib import Path
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_writer import McapRecording
from made.recorded import frames
recording, index = McapRecording(Path(sys.argv[1]), RecordingFacts("camera")), 0
while True:
    frame = replace(frames(1)[0], time_s=time.monotonic(), wall_time_ns=time.time_ns(), index=index)
    recording.write(frame)
    print(index, flush=True)
    index += 1
    time.sleep(0.01)
"""


def test_other_readers_find_topic_schema_and_index(tmp_path):
    with recorded(tmp_path / "a.mcap", frames(6)).open("rb") as file:
        other = reader.make_reader(file)
        messages = list(other.iter_messages())
        assert len(other.get_summary().chunk_indexes) >= 1
    schema, channel, first = messages[0]
    assert (schema.name, channel.topic) == ("sensor_msgs/msg/CompressedImage", "/gelform/image/compressed")
    assert (first.log_time, len(messages)) == (START_NS, 6)


def test_stamps_follow_the_monotonic_clock_where_the_other_is_set(tmp_path):
    back = [replace(one, wall_time_ns=one.wall_time_ns - k * 10**12) for k, one in enumerate(frames(3))]
    times = [frame.time_s for frame in mcap_playback(recorded(tmp_path / "a.mcap", back))]
    assert times == pytest.approx([0, 0.023, 0.04], abs=1e-6)


@pytest.mark.slow
def test_what_a_killed_recorder_wrote_is_read_up_to_the_last_second(tmp_path):
    path = tmp_path / "a.mcap"
    tests = os.path.dirname(os.path.dirname(os.path.dirname(__file__)))
    there = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, tests])}
    recorder = subprocess.Popen([sys.executable, "-c", RECORDER, path], stdout=subprocess.PIPE, env=there)
    try:
        until = time.monotonic() + 30
        written = 0
        while written < 120 and time.monotonic() < until:
            written = int(recorder.stdout.readline())
    finally:
        recorder.send_signal(signal.SIGKILL)
        rest = recorder.communicate()[0].split()
    last = int(rest[-1]) if rest else written
    taken = list(mcap_playback(path))
    assert [frame.index for frame in taken] == list(range(len(taken)))
    assert not mcap_summary(path).finished
    assert len(taken) >= 20
    seconds = (last - taken[-1].index) * 0.01
    assert seconds < 1.0


def test_without_the_extra_it_is_named_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(DataError, match=r'An MCAP file needs the extra mcap: pip install "gelform\[mcap\]"'):
        McapRecording(tmp_path / "a.mcap", RecordingFacts("camera"))
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_is_kept(tmp_path):
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(DataError, match="there already"):
        McapRecording(tmp_path / "a.mcap", RecordingFacts("camera"))
    assert (tmp_path / "a.mcap").read_text() == "mine"
    with pytest.raises(DataError, match="Cannot write"):
        McapRecording(tmp_path / "none" / "a.mcap", RecordingFacts("camera"))


def write_in_chunks(begun, path):
    """80 frames, flushed after nine each; the recording is put into the list."""
    begun.append(McapRecording(path, RecordingFacts("camera")))
    for number, frame in enumerate(frames(80)):
        begun[0].write(frame)
        if number % 9 == 8:
            begun[0]._flush()
    begun[0].close()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="mounts a tmpfs")
@pytest.mark.parametrize("kilobytes", [4, 8, 40, 250, 640])
def test_a_full_disk_says_so_and_leaves_what_it_says(tmp_path, kilobytes):
    """Frames of 9 kB, flushed by time or at the end; what is full at once is not there at all."""
    with small_disk(tmp_path / "disk", kilobytes) as disk:
        path = disk / "a.mcap"
        with pytest.raises(DataError, match="No space left") as full:
            write_in_chunks(recordings := [], path)
        if path.exists():
            (recording,) = recordings
            assert f"Its first {recording.frames} frames can be read." in str(full.value)
            assert len(list(mcap_playback(path))) == recording.frames > 0
            assert recording.frames % 9 == 0
            recording.close()
        else:
            assert kilobytes < 100
            assert "No frame of it is kept." in str(full.value)

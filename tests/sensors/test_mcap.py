"""MCAP files: records, topics of pictures, ROS 2 bags, damage; readable after a kill, and by other readers."""

import os
import signal
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from gelform.cli import main
from gelform.errors import DataError
from gelform.sensors.films import open_film
from gelform.sensors.mcap import (
    SAMPLED_RECORDS,
    McapRecording,
    PictureTopic,
    end_missing,
    is_bag_folder,
    mcap_file_in,
    mcap_records,
    message_from_picture,
    picture_topic_of,
)
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.source import open_source
from made.files import image_file, raw_message
from made.sources import FACTS, START_NS, frames, jpeg, recorded, small_disk

writer = pytest.importorskip("mcap.writer", reason="the extra mcap is not installed")
reader = pytest.importorskip("mcap.reader", reason="the extra mcap is not installed")


def folder(path, *names, metadata="rosbag2_bagfile_information:\n  version: 9\n"):
    path.mkdir()
    (path / "metadata.yaml").write_text(metadata)
    for name in names:
        (path / name).write_bytes(b"")
    return path


def test_a_folder_is_known_by_its_metadata_and_has_one_file(tmp_path):
    assert is_bag_folder(folder(tmp_path / "a", "a_0.mcap"))
    assert mcap_file_in(tmp_path / "a") == tmp_path / "a" / "a_0.mcap"
    assert not is_bag_folder(folder(tmp_path / "b", "a_0.mcap", metadata="name: other\n"))
    assert not is_bag_folder(tmp_path)


@pytest.mark.parametrize(
    ("said", "names"),
    [
        ("got 2 in .* such as .*a_0.mcap", ("a_0.mcap", "a_1.mcap")),
        ("rosbags-convert --src bag --dst bag_mcap --dst-storage mcap", ("a_0.db3",)),
        ("zstd -d a_0.mcap.zstd -o bag.mcap", ("a_0.mcap.zstd",)),
        ("Copy the whole folder", ()),
    ],
)
def test_what_to_do_where_there_is_not_one(tmp_path, said, names):
    with pytest.raises(DataError, match=said):
        mcap_file_in(folder(tmp_path / "bag", *names))


def test_channels_once_and_messages_with_their_topic(tmp_path):
    found = list(mcap_records(image_file(tmp_path / "a.mcap", {"/image": [b"a", b"b"]}, before=1)))
    channels, messages = (
        [(topic, schema, getattr(one, field)) for topic, schema, one in found if type(one).__name__ == kind]
        for kind, field in (("Channel", "message_encoding"), ("Message", "data"))
    )
    joints, image = ("/joints", "sensor_msgs/msg/JointState"), ("/image", "sensor_msgs/msg/Image")
    assert channels == [(*joints, "cdr"), (*image, "cdr")]
    assert messages == [(*joints, b"\0\1\0\0"), (*image, b"a"), (*image, b"b")]
    assert type(found[-1][2]).__name__ == "Footer"


def test_cut_short_it_ends_without_a_footer_and_what_is_no_mcap_file_is_refused(tmp_path):
    path = image_file(tmp_path / "a.mcap", {"/image": b"a"})
    path.write_bytes(path.read_bytes()[:-20])
    assert type(list(mcap_records(path))[-1][2]).__name__ != "Footer"
    path.write_text("this is text, and long enough to be looked at")
    for at, said in ((path, "no MCAP file"), (tmp_path / "missing.mcap", "No recording")):
        with pytest.raises(DataError, match=said):
            list(mcap_records(at))


PIXELS = np.zeros((4, 6, 3), np.uint8)
COLOR, UNSAID = raw_message(PIXELS), raw_message(PIXELS, "8UC3")
DEPTH = raw_message(np.zeros((4, 6, 4), np.uint8), "32FC1")


def test_the_colored_one_beside_depth_also_where_it_comes_late(tmp_path):
    path = image_file(tmp_path / "a.mcap", {"/s/indentation": DEPTH, "/s/image_raw": COLOR})
    assert picture_topic_of(path)[1] == PictureTopic("/s/image_raw", raw=True)
    path = image_file(tmp_path / "b.mcap", {"/image": COLOR}, before=3 * SAMPLED_RECORDS)
    assert picture_topic_of(path)[1].name == "/image"


COMPRESSED = {"schema": "sensor_msgs/msg/CompressedImage"}
NO_TOPIC = (  # topics, how they are written, what is said
    ({"/image": UNSAID, "/depth": DEPTH}, {}, r"/image \(8UC3\), /depth \(32FC1\).*encoding to rgb8 or bgr8"),
    ({"/left": COLOR, "/right": COLOR}, {}, r"got /left, /right.*mcap filter 1\.mcap -y /left"),
    ({}, {"before": 3}, "beside /joints"),
    ({"/image": []}, {}, "beside /image, /joints"),
    ({"/camera/compressedDepth": b"\0\1\0\0"}, COMPRESSED, "not compressed depth"),
)


def test_pictures_that_are_none_or_several_are_not_guessed_among(tmp_path):
    for k, (topics, how, said) in enumerate(NO_TOPIC):
        with pytest.raises(DataError, match=said):
            picture_topic_of(image_file(tmp_path / f"{k}.mcap", topics, **how))
    with pytest.raises(DataError, match="holds no frame"):
        open_film(image_file(tmp_path / "none.mcap", {"/image": []}, **COMPRESSED), scan=True)


FIRST_CHUNK_END = 14000  # bytes: a frame of noise takes 9.3 kB


@pytest.fixture
def chunk_per_frame(monkeypatch):
    monkeypatch.setattr("gelform.sensors.mcap.FLUSH_S", 0.0)


@pytest.mark.usefixtures("chunk_per_frame")
def test_a_file_cut_anywhere_is_named_and_gives_the_frames_before(tmp_path):
    path, cut = recorded(tmp_path / "whole.mcap", frames(6)), tmp_path / "cut.mcap"
    content, counts = path.read_bytes(), []
    for end in np.linspace(FIRST_CHUNK_END, len(content) - 1, 25).astype(int):
        cut.write_bytes(content[:end])
        assert "cut.mcap has no end: its recorder was killed, or it was copied in part" in end_missing(cut)
        counts.append(len(list(open_source(cut))))
    assert counts == sorted(counts)
    assert counts[-1] == 6
    assert 0 < counts[12] < 6
    (tmp_path / "whole.avi").write_bytes(b"RIFF" + bytes(100))
    for name in ("whole.mcap", "none.mcap", "whole.avi"):
        assert end_missing(tmp_path / name) == ""


@pytest.mark.slow
def test_any_one_byte_gives_frames_or_a_data_error(tmp_path):
    """Such as the length of a record in a chunk without a checksum, larger than any index."""
    path = recorded(tmp_path / "a.mcap", frames(2, shape=(4, 5), encoded=True))
    content, ended = path.read_bytes(), set()
    for at in range(8, 600):
        path.write_bytes(content[:at] + b"\xff" + content[at + 1 :])
        try:
            ended.add(len(list(open_film(path))))
        except DataError:
            ended.add("refused")
    assert "refused" in ended
    assert 2 in ended


@pytest.mark.usefixtures("chunk_per_frame")
def test_changed_bytes_and_a_recorder_killed_before_the_first_frame_are_said(tmp_path):
    path = recorded(tmp_path / "a.mcap", frames(6))
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x55
    path.write_bytes(content)
    with pytest.raises(DataError, match="damaged"):
        list(open_source(path))
    McapRecording(tmp_path / "b.mcap", FACTS)
    with pytest.raises(DataError, match="no frame yet"):
        open_source(tmp_path / "b.mcap")


def test_a_bag_of_raw_pictures_is_read_and_counted(tmp_path):
    given = [frame.image for frame in frames(3)]
    stamped = [raw_message(image, "bgr8", wall_time_ns=k + 5) for k, image in enumerate(given)]
    taken = list(open_source(image_file(tmp_path / "a.mcap", {"/image_raw": stamped})))
    assert [frame.index for frame in taken] == [0, 1, 2]  # though every message is numbered 0
    assert [frame.wall_time_ns for frame in taken] == [5, 6, 7]
    assert [frame.time_s for frame in taken] == [0.0, 0.01, 0.02]
    for image, frame in zip(given, taken):
        np.testing.assert_array_equal(frame.image, image[..., ::-1])
    changing = [raw_message(given[0]), raw_message(given[0], "8UC3")]
    with pytest.raises(DataError, match=r"Frame 1 of .*got 8UC3"):
        list(open_source(image_file(tmp_path / "b.mcap", {"/a": changing})))


def chunk_file(path, compression, data, size):
    """An MCAP file of one compressed chunk that states a size."""
    from mcap.data_stream import RecordBuilder
    from mcap.opcode import Opcode

    made = RecordBuilder()
    made.start_record(Opcode.CHUNK)
    for number, write in ((0, made.write8), (0, made.write8), (size, made.write8), (0, made.write4)):
        write(number)
    made.write_prefixed_string(compression)
    made.write8(len(data))
    made.write(data)
    made.finish_record()
    path.write_bytes(b"\x89MCAP0\r\n" + made.end())
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_of_few_bytes_cannot_fill_the_memory(tmp_path, compression):
    packed = pytest.importorskip({"zstd": "zstandard", "lz4": "lz4.frame"}[compression]).compress
    right = b"\x80" + (100).to_bytes(8, "little") + bytes(100)  # another program's record, which is skipped
    assert len(list(mcap_records(chunk_file(tmp_path / "right.mcap", compression, packed(right), 109)))) == 0
    bomb = packed(bytes(2**26))
    for size, said in (
        (2**32, "states 4.29e[+]03 MB, more than 256 MB"),
        (1000, "states 1000 bytes and holds more"),
        (2**27, f"states {2**27} bytes and holds {2**26}"),
    ):
        path = chunk_file(tmp_path / f"{size}.mcap", compression, bomb, size)
        tracemalloc.start()
        with pytest.raises(DataError, match=said):
            list(mcap_records(path))
        assert tracemalloc.get_traced_memory()[1] < 3 * 2**27
        tracemalloc.stop()
        with pytest.raises(SystemExit, match=r"^1$"):
            main(["info", str(path)])
    torn = chunk_file(tmp_path / "torn.mcap", compression, bomb[:20] + b"\xff" * 20 + bomb[40:], 2**26)
    with pytest.raises(DataError, match=r"a chunk (cannot be decompressed|states)"):
        list(mcap_records(torn))


def test_another_tools_compressed_file_is_read(tmp_path):
    pytest.importorskip("zstandard")
    with (tmp_path / "one.mcap").open("wb") as file:
        written = writer.Writer(file)  # whose chunks are compressed unless told otherwise
        written.start()
        schema = written.register_schema("sensor_msgs/msg/CompressedImage", "ros2msg", b"")
        channel = written.register_channel("/camera", "cdr", schema)
        written.add_message(channel, 10**9, message_from_picture(jpeg(), "jpeg", 7, "x"), 0, 0)
        written.finish()
    assert len(list(open_source(tmp_path / "one.mcap"))) == 1


RECORDER = """
import sys, time
from dataclasses import replace
from pathlib import Path
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.mcap import McapRecording
from made.sources import frames
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
    times = [frame.time_s for frame in open_source(recorded(tmp_path / "a.mcap", back))]
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
    taken = list(open_source(path))
    assert [frame.index for frame in taken] == list(range(len(taken)))
    assert end_missing(path)
    assert len(taken) >= 20
    seconds = (last - taken[-1].index) * 0.01
    assert seconds < 1.0


def test_without_the_extra_it_is_named_and_a_file_that_is_there_is_kept(tmp_path, monkeypatch):
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "mcap.writer", None)
        with pytest.raises(
            DataError, match=r'An MCAP file needs the extra mcap: pip install "gelform\[mcap\]"'
        ):
            McapRecording(tmp_path / "a.mcap", RecordingFacts("camera"))
    assert list(tmp_path.iterdir()) == []
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
            assert len(list(open_source(path))) == recording.frames > 0
            assert recording.frames % 9 == 0
            recording.close()
        else:
            assert kilobytes < 100
            assert "No frame of it is kept." in str(full.value)

"""Recordings played again: the same frames at the same times; cut short, damaged, foreign files."""

import numpy as np
import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_reader import mcap_playback, mcap_summary
from gelform.sensors.recordings.mcap_writer import McapRecording
from gelform.sensors.source import open_source
from made.recorded import frames
from made.ros_images import image_file, raw_message

writer = pytest.importorskip("mcap.writer", reason="the extra mcap is not installed")
FIRST_CHUNK_END = 14000  # bytes: a frame of noise takes 9.3 kB
FACTS = RecordingFacts("a camera", "S1", {"gain": 3.0, "reduced": 2}, 50.0, "abc")


def recorded(path, given, close=True):
    recording = McapRecording(path, FACTS)
    for frame in given:
        recording.write(frame)
        recording._flush()  # a chunk per frame
    if close:
        recording.close()
    return path


def test_the_same_frames_at_the_same_times(tmp_path):
    given = frames(6)
    source = open_source(recorded(tmp_path / "a.mcap", given))
    taken = list(source)
    assert (source.name, source.serial, source.rate_hz, source.live) == ("a camera", "S1", 50.0, False)
    assert source.settings == FACTS.settings
    for before, after in zip(given, taken):
        np.testing.assert_array_equal(after.image, before.image)
        assert (after.index, after.wall_time_ns) == (before.index, before.wall_time_ns)
    spaced = np.diff([frame.time_s for frame in given])
    np.testing.assert_allclose(np.diff([frame.time_s for frame in taken]), spaced, atol=1e-7)


def test_a_paced_replay_keeps_the_timing(tmp_path):
    given = frames(6)
    taken = list(mcap_playback(recorded(tmp_path / "a.mcap", given), paced=True))
    spaced = {frame.index: frame.time_s - given[0].time_s for frame in given}
    for frame in taken:
        assert frame.time_s - taken[0].time_s == pytest.approx(spaced[frame.index], abs=1e-6)


def test_the_cameras_jpegs_are_reduced_as_they_were(tmp_path):
    given = frames(3, encoded=True)
    taken = list(mcap_playback(recorded(tmp_path / "a.mcap", given)))
    assert [frame.encoded for frame in taken] == [frame.encoded for frame in given]
    assert taken[0].image.shape == (24, 32, 3)


def test_a_summary_counts_without_decoding(tmp_path):
    path = recorded(tmp_path / "a.mcap", frames(6))
    summary = mcap_summary(path)
    assert (summary.frames, summary.finished, summary.facts) == (6, True, FACTS)
    assert summary.duration_s == pytest.approx(6 / 50)


def test_a_file_cut_anywhere_gives_the_frames_before(tmp_path):
    content = recorded(tmp_path / "a.mcap", frames(6)).read_bytes()
    counts = []
    for end in np.linspace(FIRST_CHUNK_END, len(content) - 1, 25).astype(int):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(content[:end])
        counts.append(len(list(mcap_playback(cut))))
    assert counts == sorted(counts)
    assert counts[-1] == 6
    assert 0 < counts[12] < 6


def test_a_recorder_killed_before_the_first_frame(tmp_path):
    path = recorded(tmp_path / "a.mcap", [], close=False)
    with pytest.raises(DataError, match="no frame yet"):
        mcap_playback(path)


def test_changed_bytes_are_found(tmp_path):
    path = recorded(tmp_path / "a.mcap", frames(6))
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x55
    path.write_bytes(content)
    with pytest.raises(DataError, match="damaged"):
        list(mcap_playback(path))


def test_what_is_no_recording_says_so(tmp_path):
    text = tmp_path / "a.mcap"
    with pytest.raises(DataError, match="No recording"):
        mcap_playback(text)
    text.write_text("no mcap file at all, but long enough")
    with pytest.raises(DataError, match="no MCAP file"):
        mcap_playback(text)


def test_a_bag_of_raw_pictures_is_read_and_counted(tmp_path):
    given = [frame.image for frame in frames(3)]
    stamped = [raw_message(image, "bgr8", wall_time_ns=k + 5) for k, image in enumerate(given)]
    taken = list(mcap_playback(image_file(tmp_path / "a.mcap", {"/image_raw": stamped})))
    assert [frame.index for frame in taken] == [0, 1, 2]  # though every message is numbered 0
    assert [frame.wall_time_ns for frame in taken] == [5, 6, 7]
    assert [frame.time_s for frame in taken] == [0.0, 0.01, 0.02]
    for image, frame in zip(given, taken):
        np.testing.assert_array_equal(frame.image, image[..., ::-1])


def test_a_raw_picture_that_changes_its_encoding_is_an_error(tmp_path):
    image = frames(1)[0].image
    path = image_file(tmp_path / "a.mcap", {"/a": [raw_message(image), raw_message(image, "8UC3")]})
    with pytest.raises(DataError, match=r"Frame 1 of .*got 8UC3"):
        list(mcap_playback(path))


def foreign(path, topics, schema="sensor_msgs/msg/CompressedImage"):
    from gelform.sensors.recordings.messages import message_from_picture
    from made.mjpeg_server import jpeg

    with path.open("wb") as file:
        made = writer.Writer(file)
        made.start()
        number = made.register_schema(schema, "ros2msg", b"")
        for k, topic in enumerate(topics):
            channel = made.register_channel(topic, "cdr", number)
            made.add_message(channel, 10**9 * k, message_from_picture(jpeg(), "jpeg", 7, "x"), 0, k)
        made.finish()
    return path


def test_another_tools_file_is_read_where_it_is_clear_which_topic(tmp_path):
    pytest.importorskip("zstandard")
    assert len(list(mcap_playback(foreign(tmp_path / "one.mcap", ["/camera"])))) == 1
    with pytest.raises(DataError, match="/left, /right"):
        mcap_playback(foreign(tmp_path / "two.mcap", ["/left", "/right"]))
    with pytest.raises(DataError, match="beside /joints"):
        mcap_playback(foreign(tmp_path / "none.mcap", ["/joints"], "sensor_msgs/msg/JointState"))

"""MCAP files by number: unfinished ones up to their last whole chunk, changed ones refused, several chunks."""

import numpy as np
import pytest

from gelform.errors import DataError
from gelform.live.replay.indexed_mcap import McapIndex
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_writer import McapRecording


@pytest.fixture
def many_chunks(frames, tmp_path, monkeypatch):
    """A chunk for each frame."""
    monkeypatch.setattr("gelform.sensors.recordings.mcap_writer.FLUSH_S", 0.0)
    recording = McapRecording(tmp_path / "many.mcap", RecordingFacts("ring"))
    for frame in frames:
        recording.write(frame)
    recording.close()
    return tmp_path / "many.mcap"


def test_frames_are_found_across_chunks(many_chunks, frames):
    index = McapIndex(many_chunks)
    for number in (6, 0, 5, 1, 4):
        found = index.frame(number)
        np.testing.assert_array_equal(found.image, frames[number].image)
        assert found.index == number


def test_a_killed_recorders_file_has_its_whole_chunks(many_chunks, frames, tmp_path):
    whole = many_chunks.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: int(0.6 * len(whole))])
    index = McapIndex(torn)
    assert 2 <= len(index.times_s) < len(frames)
    np.testing.assert_array_equal(index.frame(1).image, frames[1].image)


def test_damaged_bytes_are_an_error(many_chunks, tmp_path):
    content = bytearray(many_chunks.read_bytes())
    content[len(content) // 2] ^= 0xFF
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(bytes(content))
    with pytest.raises(DataError, match=r"damaged\.mcap"):
        McapIndex(damaged).frame(3)


def test_a_file_that_was_replaced_meanwhile_is_noticed(many_chunks, forms):
    index = McapIndex(many_chunks)
    many_chunks.write_bytes(forms["mcap"].read_bytes())
    with pytest.raises(DataError):
        index.frame(5)

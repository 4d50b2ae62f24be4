"""What a recording says of its camera, and pictures without loss."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.facts import (
    RecordingFacts,
    encoded_from_frame,
    image_from_encoded,
    reduction_in,
)
from made.recorded import frames


def test_facts_survive_their_json():
    facts = RecordingFacts("DIGIT D1", "D1", {"gain": 3.0, "fourcc": "YUYV"}, 60.0, "abc", "0.1")
    assert RecordingFacts.from_json(facts.to_json(), "x") == facts


def test_damaged_facts_say_so():
    for text in ("", "[]", '{"format_version": 1, "colour": 3}', '{"name": "x"}'):
        with pytest.raises(DataError, match="x is damaged"):
            RecordingFacts.from_json(text, "x")


def test_a_newer_format_names_the_release():
    newer = RecordingFacts("a", library_version="9.1").to_json().replace('_version": 1', '_version": 2')
    with pytest.raises(DataError, match=r"gelform 9\.1"):
        RecordingFacts.from_json(newer, "x")


def test_pixels_are_kept_without_loss():
    frame = frames(1)[0]
    kind, content = encoded_from_frame(frame)
    assert kind == "png"
    np.testing.assert_array_equal(image_from_encoded(content, 1, "x"), frame.image)


def test_the_cameras_jpeg_is_kept_as_it_is():
    frame = frames(1, encoded=True)[0]
    assert encoded_from_frame(frame) == ("jpeg", frame.encoded)
    image = image_from_encoded(frame.encoded, 2, "x")
    assert image.shape == (24, 32, 3)
    np.testing.assert_allclose(image[5, 5], (200, 0, 5), atol=4)


def test_damaged_pictures_say_which():
    for content in (b"", b"\x89PNG but torn", frames(1, encoded=True)[0].encoded[:-40]):
        with pytest.raises(DataError, match="frame 7 is damaged"):
            image_from_encoded(content, 1, "frame 7")


def test_the_reduction_stands_in_the_settings():
    assert (reduction_in({}), reduction_in({"reduced": 4})) == (1, 4)


def test_noise_is_written_smaller_than_by_repetitions():
    """A smooth image with a camera's noise, against the fastest level of zlib."""
    rows, columns = np.mgrid[:120, :160]
    smooth = np.stack([90 + rows / 4, 80 + columns / 4, 100 - rows / 5], axis=-1)
    image = smooth + np.random.default_rng(0).normal(0, 1.5, smooth.shape)
    frame = replace(frames(1)[0], image=np.rint(image).astype(np.uint8))
    content = encoded_from_frame(frame)[1]
    usual = cv2.imencode(".png", frame.image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    assert len(content) < 0.85 * len(usual)
    np.testing.assert_array_equal(image_from_encoded(content, 1, "x"), frame.image)

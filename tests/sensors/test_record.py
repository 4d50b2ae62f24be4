"""Recording from a grabber, in a thread or not; attachments; one file plays elsewhere as it was shown here.

Facts about the camera; lossless pictures; ROS 2 messages, byte by byte in both directions.
"""

from __future__ import annotations

import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError, DataError
from gelform.image.view import Frame
from gelform.sensors.films import open_film
from gelform.sensors.grabber import Grabber
from gelform.sensors.mcap import (
    RAW_SCHEMA_NAME,
    SCHEMA_NAME,
    McapRecording,
    decoded,
    end_missing,
    message_from_picture,
    pixels_from_raw,
    time_ns_of,
)
from gelform.sensors.playback import (
    Playback,
    RecordingFacts,
    encoded_from_frame,
    image_from_encoded,
    reduction_in,
)
from gelform.sensors.record import (
    KEPT_FRAMES,
    Recorder,
    attached_background,
    attached_calibration,
    attached_to,
    attachments_of,
    new_recording,
    record_frames,
    share,
)
from gelform.sensors.source import open_source
from live_waiting import until
from made.files import raw_message
from made.sources import ImageSource, camera, frames, recorded


def written(path, attached):
    frame = Frame(np.zeros((8, 8, 3), np.uint8), 0.0, 10**18, 0)
    return recorded(path, [frame], RecordingFacts("ring"), attached)


def test_frames_are_played_as_they_were_recorded(tmp_path):
    facts = RecordingFacts("a camera", "S1", {"gain": 3.0, "reduced": 2}, 50.0, "abc")
    for encoded in (False, True):
        given = frames(6, encoded=encoded)
        path = recorded(tmp_path / f"{encoded}.mcap", given, facts)
        source = open_source(path)
        assert (source.name, source.serial, source.rate_hz, source.live) == ("a camera", "S1", 50.0, False)
        assert source.settings == facts.settings
        for before, after in zip(given, source, strict=True):
            assert (after.index, after.wall_time_ns) == (before.index, before.wall_time_ns)
            assert after.time_s == pytest.approx(before.time_s - given[0].time_s, abs=1e-6)
            assert after.encoded == before.encoded
            assert after.image.shape == ((24, 32, 3) if encoded else before.image.shape)
            if not encoded:
                np.testing.assert_array_equal(after.image, before.image)
        film = open_film(path)
        assert (len(film.times_s), end_missing(path), film.camera) == (6, "", facts)
        assert film.times_s[-1] == pytest.approx(6 / 50)
        with pytest.raises(DataError, match="there already"):
            recorded(path, given, facts)


def test_calibration_and_background_come_back_where_they_are(tmp_path, calibration):
    background = np.rint(calibration.background)
    path = written(tmp_path / "a.mcap", attachments_of(calibration, background))
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)
    bare = written(tmp_path / "bare.mcap", {})
    (tmp_path / "background.png").write_bytes(b"x")
    for none in (bare, tmp_path):
        assert attached_to(none) == {}
        assert attached_calibration(none) is attached_background(none) is None


def test_an_attachment_that_is_damaged_or_too_large_is_refused(tmp_path, calibration, monkeypatch):
    content = bytearray(attachments_of(calibration)["calibration.npz"])
    content[len(content) // 2] ^= 0xFF
    damaged = {"calibration.npz": bytes(content), "background.png": b"\x89PNG torn"}
    path = written(tmp_path / "a.mcap", damaged)
    with pytest.raises(CalibrationError):
        attached_calibration(path)
    with pytest.raises(DataError, match=r"background\.png"):
        attached_background(path)
    monkeypatch.setattr("gelform.sensors.record.MAX_ATTACHMENT_BYTES", 1000)
    with pytest.raises(DataError, match="at most"):
        attached_to(path)


SLOW_HZ = 10.0  # at its own pace a camera passes over frames for which a busy machine has no time


def test_every_frame_is_written_and_gaps_are_counted(tmp_path):
    with Grabber(camera(12, rate_hz=SLOW_HZ), keep=KEPT_FRAMES) as grabber:
        recording = new_recording(tmp_path / "r.mcap", grabber, calibration_digest="abc")
        stats = record_frames(grabber, recording)
        recording.close()
    assert (stats.frames, stats.missing) == (12, 1)
    assert stats.duration_s == pytest.approx(12 / SLOW_HZ)
    source = open_source(tmp_path / "r.mcap")
    assert source.serial == "S1"
    assert [frame.index for frame in source] == [0, 1, 2, *range(4, 13)]


def test_stops_after_so_many_frames_or_when_told_and_has_the_name_of_an_mcap_file(tmp_path):
    with Grabber(camera(200), keep=KEPT_FRAMES) as grabber:
        for name in ("r.MP4", "r"):
            with pytest.raises(DataError, match=r"Expected a new file \*\.mcap"):
                new_recording(tmp_path / name, grabber)
        assert not list(tmp_path.iterdir())
        recording = new_recording(tmp_path / "r.mcap", grabber)
        assert record_frames(grabber, recording, frames=3).frames == 3
        assert record_frames(grabber, recording, going_on=lambda stats: stats.frames < 2).frames == 2
        assert record_frames(grabber, recording, seconds=0.05).duration_s <= 0.05
        assert record_frames(grabber, recording, seconds=0).duration_s == 0


def test_the_time_is_that_of_the_frames_however_fast_they_are_read(tmp_path):
    first = McapRecording(tmp_path / "first.mcap", RecordingFacts("x", None, {}, 100.0))
    for k in range(30):
        first.write(Frame(np.full((8, 10, 3), k, np.uint8), k / 100, 10**18 + k, k))
    first.close()
    with Grabber(lambda: open_source(tmp_path / "first.mcap"), keep=KEPT_FRAMES) as grabber:  # not paced
        stats = record_frames(grabber, new_recording(tmp_path / "again.mcap", grabber), seconds=0.105)
    assert (stats.frames, stats.missing) == (11, 0)
    assert stats.duration_s == pytest.approx(0.1)


def test_a_recording_that_is_read_slowly_is_not_cut_by_our_clock(tmp_path):
    written = threading.Event()

    def frames():
        for k in range(6):
            if k == 1:
                written.wait(10)
                time.sleep(0.3)  # longer than one wait for a frame, and than what is to be recorded
            yield Frame(np.full((8, 10, 3), k, np.uint8), k / 100, 10**18 + k, k)

    def going_on(stats):
        if stats.frames:
            written.set()
        return True

    with Grabber(lambda: Playback(frames(), RecordingFacts("x", rate_hz=100.0)), keep=KEPT_FRAMES) as grabber:
        recording = new_recording(tmp_path / "r.mcap", grabber)
        stats = record_frames(grabber, recording, seconds=0.045, going_on=going_on)
    assert stats.frames == 5


@pytest.mark.parametrize("form", ["mcap", "images", "video"])
def test_the_file_holds_frames_times_and_calibration(form, forms, frames, calibration, tmp_path):
    recording = open_film(forms[form])
    background = np.rint(calibration.background)
    path = share(recording, tmp_path, calibration=calibration, background=background)
    again = open_film(path)
    np.testing.assert_allclose(again.times_s, recording.times_s, atol=1e-6)
    np.testing.assert_array_equal(again[4].image, frames[4].image)
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)
    here = gelform.Reconstructor(calibration, background=background)(recording[4])
    there = gelform.Reconstructor(attached_calibration(path), background=attached_background(path))
    np.testing.assert_array_equal(there(again[4]).depth_mm, here.depth_mm)


def test_progress_is_told_and_nothing_is_left_of_a_share_that_failed(forms, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.sensors.record.named_by_time", lambda _: "a")
    said = []
    recording = open_film(forms["mcap"])
    path = share(recording, tmp_path, calibration=None, progress=lambda *what: said.append(what[:2]))
    assert said[-1] == (6, 7)
    again = share(recording, tmp_path, calibration=None)  # in the same second
    assert (again.name, len(open_film(again).times_s)) == ("a-2.mcap", 7)
    assert attached_calibration(path) is None
    monkeypatch.setattr("gelform.sensors.record.named_by_time", lambda _: "b")

    def stop(done, *_):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        share(recording, tmp_path, calibration=None, progress=stop)
    assert {path.name for path in tmp_path.glob("*.mcap*")} == {"a.mcap", "a-2.mcap"}
    assert not list(tmp_path.glob(".*"))


def test_it_ends_when_it_is_large_enough_or_no_longer_wanted(frames, calibration, tmp_path):
    limit, images = 100_000, [frame.image for frame in frames]
    with Grabber(lambda: ImageSource(images), keep=KEPT_FRAMES) as grabber:
        for folder, how, said in (
            ("large", {"max_bytes": limit}, "its limit of"),
            ("unwanted", {"wanted": lambda: False}, "the page that began it was closed"),
        ):
            ended = []
            (tmp_path / folder).mkdir()
            how |= {"calibration": calibration, "on_ended": ended.append}
            recorder = Recorder(grabber, tmp_path / folder, **how)
            recorder.start()
            until(lambda ended=ended: ended)
            assert said in recorder.problem
            assert attached_calibration(recorder.path).digest == calibration.digest
            if folder == "large":
                frame_bytes = recorder.stats.written_bytes / recorder.stats.frames
                assert limit <= recorder.stats.written_bytes < limit + 2 * frame_bytes


def test_a_recording_whose_folder_is_removed_says_so(frames, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.sensors.mcap.FLUSH_S", 0.0)
    (tmp_path / "own").mkdir()
    with Grabber(lambda: ImageSource([frames[0].image])) as grabber:
        recorder = Recorder(grabber, tmp_path / "own")
        shutil.rmtree(tmp_path / "own")
        recorder.start()
        until(lambda: recorder.problem)
    assert "was deleted. No frame of it is kept." in recorder.problem
    assert recorder.stats.frames == 0


def test_two_sensors_in_one_second_are_both_kept(forms, frames, calibration, tmp_path, monkeypatch):
    """Recorded and shared at the same time, by two stations' threads."""
    monkeypatch.setattr("gelform.sensors.record.named_by_time", lambda kind: kind)
    images, recording = [frame.image for frame in frames], open_film(forms["mcap"])
    with Grabber(lambda: ImageSource(images), keep=KEPT_FRAMES) as grabber:
        recorders = [Recorder(grabber, tmp_path, calibration=calibration, max_bytes=1) for _ in range(2)]
        for one in recorders:
            one.start()
        with ThreadPoolExecutor(4) as pool:
            shared = list(pool.map(lambda _: share(recording, tmp_path, calibration=None), range(4)))
        until(lambda: all(one.problem for one in recorders))
        for one in recorders:
            one.close()
    assert len({*shared, *(one.path for one in recorders)}) == 6
    assert [len(open_film(path).times_s) for path in shared] == [7] * 4
    assert all(len(open_film(one.path).times_s) >= 1 for one in recorders)


def test_facts_of_the_first_format_are_read_for_ever_and_damaged_ones_say_so():
    text = (
        '{"name": "DIGIT D1", "serial": "D1", "settings": {"gain": 3.0}, "rate_hz": 60.0, "calibration_digest": "abc", '
        '"library_version": "0.1.0", "format_version": 1}'
    )
    facts = RecordingFacts("DIGIT D1", "D1", {"gain": 3.0}, 60.0, "abc", "0.1.0")
    assert RecordingFacts.from_json(text, "x") == facts
    assert RecordingFacts.from_json(facts.to_json(), "x") == facts
    for text in ("", "[]", '{"format_version": 1, "color": 3}', '{"name": "x"}'):
        with pytest.raises(DataError, match="x is damaged"):
            RecordingFacts.from_json(text, "x")
    newer = RecordingFacts("a", library_version="9.1").to_json().replace('_version": 1', '_version": 2')
    with pytest.raises(DataError, match=r"gelform 9\.1"):
        RecordingFacts.from_json(newer, "x")


def test_pixels_are_kept_without_loss_and_damaged_pictures_say_which():
    frame = frames(1)[0]
    kind, content = encoded_from_frame(frame)
    assert kind == "png"
    np.testing.assert_array_equal(image_from_encoded(content, 1, "x"), frame.image)
    frame = frames(1, encoded=True)[0]
    assert encoded_from_frame(frame) == ("jpeg", frame.encoded)
    image = image_from_encoded(frame.encoded, 2, "x")
    assert image.shape == (24, 32, 3)
    np.testing.assert_allclose(image[5, 5], (200, 0, 5), atol=4)
    assert (reduction_in({}), reduction_in({"reduced": 4})) == (1, 4)
    for content in (b"", b"\x89PNG but torn", frames(1, encoded=True)[0].encoded[:-40]):
        with pytest.raises(DataError, match=r"frame 7 is .*(damaged|empty)"):
            image_from_encoded(content, 1, "frame 7")


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


WHEN_NS = 5 * 10**9 + 7


def test_there_and_back_and_torn_or_foreign_ones_refused():
    content = bytes(range(256))
    for frame_id in ("", "a", "camera", "Kamera ü"):
        for kind in ("png", "jpeg"):
            message = message_from_picture(content, kind, WHEN_NS, frame_id)
            found = decoded(message, SCHEMA_NAME)
            assert (found.data.tobytes(), time_ns_of(found)) == (content, WHEN_NS)
    message = message_from_picture(b"\xaa" * 50, "png", WHEN_NS, "cam")
    for end in (0, 3, 10, 20, len(message) - 1):
        with pytest.raises(ValueError, match="Expected"):
            decoded(message[:end], SCHEMA_NAME)
    with pytest.raises(ValueError, match="Expected"):
        decoded(b"\x00\x00" + message[2:], SCHEMA_NAME)  # of big numbers first, which these are not


PIXELS = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)


def raw_image(*what, **how):
    """The message of a picture, there and back."""
    return decoded(raw_message(*what, **how), RAW_SCHEMA_NAME)


def test_raw_pictures_with_padded_rows():
    for frame_id in ("", "a", "cam", "camera"):
        for padding in (0, 3):
            image = raw_image(PIXELS, "rgb8", wall_time_ns=WHEN_NS, padding=padding, frame_id=frame_id)
            assert (time_ns_of(image), image.encoding) == (WHEN_NS, "rgb8")
            np.testing.assert_array_equal(pixels_from_raw(image), PIXELS)
    np.testing.assert_array_equal(pixels_from_raw(raw_image(PIXELS, "bgr8")), PIXELS[..., ::-1])


def test_raw_pictures_that_are_none_are_refused():
    message = raw_message(PIXELS)
    for end in range(len(message)):
        with pytest.raises(ValueError, match="Expected"):
            decoded(message[:end], RAW_SCHEMA_NAME)
    for wrong in ({"step": 8}, {"height": 3}, {"height": 0}, {"data": np.empty(0, np.uint8)}):
        with pytest.raises(ValueError, match="rows of"):
            pixels_from_raw(replace(raw_image(PIXELS), **wrong))
    with pytest.raises(ValueError, match="ros2 bag convert"):
        decoded(b"\x28\xb5\x2f\xfd" + bytes(40), RAW_SCHEMA_NAME)


def test_encodings_of_other_drivers_become_rgb():
    """YUY2 and UYVY of a uniform color, by BT.601 with its limited range: 235 - 16 levels of luma."""
    alpha = np.full((*PIXELS.shape[:2], 1), 9, np.uint8)
    for encoding, stored in (
        ("rgba8", np.concatenate([PIXELS, alpha], axis=2)),
        ("bgra8", np.concatenate([PIXELS[..., ::-1], alpha], axis=2)),
    ):
        np.testing.assert_array_equal(pixels_from_raw(raw_image(stored, encoding, padding=3)), PIXELS)
    luma, u, v = 120, 100, 170
    scaled = 1.164 * (luma - 16)
    wanted = scaled + np.array([1.596 * (v - 128), -0.392 * (u - 128) - 0.813 * (v - 128), 2.017 * (u - 128)])
    for encoding, pair in (("yuv422_yuy2", (luma, u, luma, v)), ("yuv422", (u, luma, v, luma))):
        rows = np.tile(np.array(pair, np.uint8).reshape(1, 2, 2), (4, 3, 1))
        image = pixels_from_raw(raw_image(rows, encoding))
        assert image.shape == (4, 6, 3)
        assert np.abs(image - wanted).max() < 2
    for encoding, said in {
        "bayer_rggb8": "image_proc",
        "mono8": "in color",
        "8UC3": "channel is red",
    }.items():
        with pytest.raises(ValueError, match=f"Expected pictures in rgb8 or bgr8 .*got {encoding}.*{said}"):
            pixels_from_raw(raw_image(PIXELS, encoding))

"""Untouched, still, sliding: told apart in sequences whose truth is known.

A simulated video with presses, a slide and a roll: the presses come out, the rest is left out and named.
"""

from collections import namedtuple
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.presses.video import (
    Thumbnails,
    distances,
    noise_of,
    stretches,
    thumbnail,
    touch_threshold,
    untouched,
)
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts
from gelform.simulate import (
    Ball,
    Pose,
    press_poses,
    roll_poses,
    simulate_ball_presses,
    simulate_sequence,
    slide_poses,
)
from made.sources import video_file

SHAPE = (36, 48)
NOISE = 0.3


def gel(rng, contact=None):
    """A thumbnail of a gel with a color slope; contact: (x, y, strength) of a ball-like change."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    levels = np.stack([90 + x, 110 + 0 * x, 120 - y], axis=-1)
    if contact is not None:
        cx, cy, strength = contact
        dx, dy = (x - cx) / 4, (y - cy) / 4
        inside = np.exp(-(dx**2 + dy**2))[..., None] * strength
        levels += inside * np.stack([dx, dy, -dx - dy], axis=-1)
    return (levels + rng.normal(0, NOISE, levels.shape)).astype(np.float32)


def sequence(*parts, seed=0):
    """Thumbnails of parts: a number (that many untouched) or a list of contacts."""
    rng = np.random.default_rng(seed)
    frames = []
    for part in parts:
        contacts = [None] * part if isinstance(part, int) else part
        frames += [gel(rng, contact) for contact in contacts]
    return np.stack(frames)


def press(x, y, strength=40.0, hold=8):
    """Down in three frames, still, up in three."""
    ramp = [(x, y, strength * f) for f in (0.25, 0.5, 0.75)]
    return [*ramp, *[(x, y, strength)] * hold, *ramp[::-1]]


def found_in(levels, rate_hz=25.0):
    motion = distances(levels[1:], levels[:-1])
    rest = untouched(levels, motion)
    reference = levels[rest].mean(axis=0)
    return rest, stretches(levels, reference, noise_of(motion), rate_hz=rate_hz, factor=6.7)


def test_presses_are_found_with_their_still_part():
    levels = sequence(12, press(12, 10), 6, press(35, 20), 6, press(20, 28), 6)
    rest, found = found_in(levels)
    truth = np.zeros(len(levels), dtype=bool)
    for start, stop in ((0, 12), (26, 32), (46, 52), (66, 72)):
        truth[start:stop] = True
        assert rest[start + 1 : stop - 1].all()  # beside a touch a frame may be left out
    assert not rest[~truth].any()
    assert [len(stretch.stills) for stretch in found] == [1, 1, 1]
    for stretch, (start, x, y) in zip(found, ((15, 12, 10), (35, 35, 20), (55, 20, 28))):
        (still,) = stretch.stills
        assert start <= still.best < start + 8
        assert still.center_px == pytest.approx((x, y), abs=0.7)
    faster = found_in(levels, rate_hz=100.0)[1]
    assert not any(stretch.stills for stretch in faster), "8 frames are less than 0.2 s then"


@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_a_contact_that_slides_is_left_out(speed):
    path = [(8 + speed * k, 12, 40.0) for k in range(int(30 / speed))]
    _, found = found_in(sequence(12, press(12, 10), 6, path, 6))
    assert [len(stretch.stills) for stretch in found] == [1, 0]
    assert "slid or rolled" in found[1].reason
    moved = float(found[1].reason.split(" px")[0].split()[-1])
    assert moved == pytest.approx(6.7 * 30, rel=0.15)


def test_a_contact_that_only_goes_down_and_up_is_left_out():
    ramp = [(20, 15, s) for s in np.concatenate([np.linspace(8, 60, 6), np.linspace(60, 8, 6)])]
    _, (stretch,) = found_in(sequence(12, ramp, 6))
    assert stretch.stills == ()
    assert "depth kept changing" in stretch.reason


def test_rolling_with_rests_gives_a_press_at_each_rest_and_a_hand_that_hesitates_one():
    path = [*press(10, 10)[:-3], *[(10 + k, 10, 40.0) for k in range(1, 15)], *press(25, 10)[3:]]
    _, (stretch,) = found_in(sequence(12, path, 6))
    assert [round(still.center_px[0]) for still in stretch.stills] == pytest.approx([10, 25], abs=1)
    _, (stretch,) = found_in(sequence(12, [(20, 15, 20.0)] * 8 + press(20, 15), 6))
    (still,) = stretch.stills
    assert 12 + 8 + 3 <= still.best < 12 + 8 + 3 + 8  # the deep one


def test_a_light_touch_among_firm_presses_is_left_out():
    levels = sequence(12, press(12, 10), 6, press(35, 20), 6, press(20, 28, strength=14.0), 6)
    _, found = found_in(levels)
    assert [len(stretch.stills) for stretch in found] == [1, 1, 0]
    assert "lighter" in found[2].reason


@pytest.mark.parametrize(
    "after", [[8, press(35, 20, hold=40), 8], []], ids=["another press", "held to the end"]
)
def test_the_untouched_state_comes_back_though_a_press_was_held_longer(after):
    held = press(12, 10, hold=60)
    rest, _ = found_in(sequence(8, held if after else held[:-3], *after))
    assert rest[:7].all()
    assert not rest[11:71].any()


def test_the_untouched_state_comes_back_though_the_pressed_gel_is_smoother():
    levels = sequence(8, [None] * 8, 4, [None] * 8, 4)
    slope = np.linspace(-8, 8, SHAPE[0])[:, None, None].astype(np.float32)
    for start, share in ((8, 0.0), (20, 1.0)):  # a flat object takes the gel's own slope of color away
        press = levels[start : start + 8]
        press[:] = press.mean(axis=(1, 2), keepdims=True) + share * slope
    rest = untouched(levels, distances(levels[1:], levels[:-1]))
    assert rest[:7].all()
    assert rest[17:19].all()
    assert not rest[8:16].any()
    assert not rest[20:28].any()


def test_flicker_of_all_pixels_is_no_touch():
    rng = np.random.default_rng(1)
    levels = sequence(40) * (1 + 0.05 * rng.standard_normal((40, 1, 1, 1))).astype(np.float32)
    motion = distances(levels[1:], levels[:-1])
    touch = distances(levels, levels[0])
    assert touch.max() < 5
    assert noise_of(motion) < 4


def test_threshold_grows_with_the_noise_and_the_strongest_touch():
    quiet = np.full(50, 0.5)
    assert touch_threshold(quiet, 0.5) == 3.0
    assert touch_threshold(quiet, 2.0) == 8.0
    assert touch_threshold(np.full(50, 100.0), 0.5) == pytest.approx(12.0)


def test_thumbnails_average_and_are_thinned():
    thumbs = Thumbnails(most=10)
    image = np.zeros((72, 96, 3), np.uint8)
    for k in range(35):
        image[:] = k
        thumbs.add(image, k, k / 25)
    assert thumbs.index == [0, 4, 8, 12, 16, 20, 24, 28, 32]
    np.testing.assert_allclose(thumbs.levels()[:, 5, 5, 1], thumbs.index)
    assert thumbs.factor == 2
    checks = (np.indices((72, 96)).sum(axis=0) % 2 * 255)[..., None].repeat(3, axis=-1).astype(np.uint8)
    np.testing.assert_allclose(thumbnail(checks), 127.5, atol=0.5)


COUNT = 9
BALL_MM = 5.0
HOLD, RAMP, REST = 8, 4, 5


# A video and what is true of it: frames (first, last) of each hold and slide, and the still presses.
Filmed = namedtuple("Filmed", "path images holds slides stills")


@pytest.fixture(scope="module")
def filmed(sensor, tmp_path_factory):
    """A hand presses a ball at the places of `simulate_ball_presses`, trembling; once it slides, once it rolls."""
    rng = np.random.default_rng(4)
    stills = simulate_ball_presses(
        sensor, ball_diameters_mm=[BALL_MM], count=COUNT, rng=np.random.default_rng(3), oversample=1
    )
    poses, holds, slides = [Pose(-0.1)] * 15, [], []
    for k, press in enumerate(stills.presses):
        down = press_poses(press.press_depth_mm, RAMP, center_mm=press.center_mm)
        poses += down
        holds.append((len(poses) - 1, len(poses) + HOLD))
        for _ in range(HOLD):
            tremor = rng.normal(0, 0.004, 2)
            at = (press.center_mm[0] + tremor[0], press.center_mm[1] + tremor[1])
            poses.append(Pose(press.press_depth_mm + rng.normal(0, 0.003), at))
        poses += [*down[::-1], *[Pose(-0.1)] * REST]
        if k in (3, 6):
            path = slide_poses if k == 3 else roll_poses
            slides.append((len(poses), len(poses) + 25))
            poses += [*path(press.press_depth_mm, (-5, -3), (5, 3), 25), *[Pose(-0.1)] * REST]
    images = [p.image for p in simulate_sequence(sensor, Ball(BALL_MM / 2), poses, rng=rng)]
    path = tmp_path_factory.mktemp("video") / "presses.avi"
    video_file(path, images, "FFV1")
    return Filmed(path, images, holds, slides, stills)


@pytest.fixture(scope="module")
def how(sensor):
    return {"ball_diameter_mm": BALL_MM, "mm_per_px": sensor.mm_per_px}


@pytest.fixture(scope="module")
def read(filmed, how):
    return gelform.read_presses(filmed.path, **how)


def frame_of(press):
    return int(press.name.rsplit(" ", 1)[1])


def test_each_press_gives_one_still_frame(filmed, read):
    assert len(read.presses) == COUNT
    for press, (first, last) in zip(read.presses, filmed.holds):
        assert first <= frame_of(press) <= last
        assert press.ball_diameter_mm == BALL_MM


def test_slide_and_roll_are_left_out_and_named(filmed, read, sensor):
    assert len(read.notes) == 2
    for note, (first, last) in zip(read.notes, filmed.slides):
        start, stop = (float(t) for t in note.split(" s ")[0].split("-"))
        assert start == pytest.approx(first / 25, abs=0.1)
        assert stop == pytest.approx((last - 1) / 25, abs=0.1)
        assert "slid or rolled" in note


def test_background_is_the_untouched_gel_and_its_noise(filmed, sensor, how):
    read = gelform.presses_from_frames(frames_of(filmed.images), **how)
    still = np.mean([filmed.images[k] for k in range(15)], axis=0)
    assert np.abs(read.background - still).mean() < 0.4
    noise = np.sqrt(sensor.noise_sd**2 + sensor.noise_gain * still.mean(axis=(0, 1)) + 1 / 12)
    assert read.background_noise == pytest.approx(noise, rel=0.07)


def frames_of(images):
    return [gelform.Frame(image, k / 25, 0, k) for k, image in enumerate(images)]


def test_a_list_and_an_iterator_of_frames_give_the_same_cropped_once(filmed, how):
    frames = frames_of(filmed.images)
    one, other = (gelform.presses_from_frames(given, **how) for given in (frames, iter(frames)))
    assert [p.digest for p in one.presses] == [p.digest for p in other.presses]
    assert len(one.presses) == COUNT
    np.testing.assert_array_equal(one.background, other.background)
    cropped = gelform.presses_from_frames(iter(frames), **how, crop=(10, 6, 160, 120))
    assert cropped.image_shape == (120, 160)
    assert cropped.view.crop == (10, 6, 160, 120)
    for press, whole in zip(cropped.presses, one.presses, strict=True):
        np.testing.assert_array_equal(press.image, filmed.images[frame_of(press)][6:126, 10:170])
        np.testing.assert_array_equal(whole.image, filmed.images[frame_of(whole)])


def test_a_recording_whose_numbers_have_gaps_gives_the_same_as_its_frames(filmed, how, tmp_path):
    pytest.importorskip("mcap", reason="the extra mcap is not installed")
    images = filmed.images[: filmed.holds[2][1] + REST]
    recording = McapRecording(tmp_path / "presses.mcap", RecordingFacts("ring"))
    for k, image in enumerate(images):
        recording.write(gelform.Frame(image, 5 + k / 25, k, 7 + k + 3 * (k > 20)))
    recording.close()
    read = gelform.read_presses(tmp_path / "presses.mcap", **how)
    wanted = gelform.presses_from_frames(frames_of(images), **how)
    assert [frame_of(p) for p in read.presses] == [frame_of(p) for p in wanted.presses]
    assert [p.digest for p in read.presses] == [p.digest for p in wanted.presses]
    np.testing.assert_array_equal(read.background, wanted.background)


def test_a_data_set_gives_the_same_as_its_frames(filmed, how, h5py, tmp_path):
    images = filmed.images[: filmed.holds[2][1] + REST]
    with h5py.File(tmp_path / "demos.h5", "w") as file:
        file["data/a/gel"], file["data/b/gel"] = np.stack(images[:40]), np.stack(images[40:])
    read = gelform.read_presses(tmp_path / "demos.h5", **how, dataset="data/*/gel")
    wanted = gelform.presses_from_frames(frames_of(images), **how)
    assert [frame_of(p) for p in read.presses] == [frame_of(p) for p in wanted.presses]
    assert [p.digest for p in read.presses] == [p.digest for p in wanted.presses]
    np.testing.assert_array_equal(read.background, wanted.background)
    with pytest.raises(gelform.DataError, match="--dataset is of HDF5 files"):
        gelform.read_presses(tmp_path, **how, dataset="data/*/gel")


@pytest.mark.slow
def test_a_video_calibrates_nearly_as_well_as_stills(filmed, read):
    by_video = gelform.calibrate(read, color_model="polynomial").report
    stills = replace(
        read,
        background=filmed.stills.background.astype(np.float32),
        presses=tuple(
            replace(press, image=true.image) for press, true in zip(read.presses, filmed.stills.presses)
        ),
        background_noise=None,
    )
    by_stills = gelform.calibrate(stills, color_model="polynomial").report
    assert sum(row.accepted for row in by_video.presses) >= COUNT - 2
    name = "normal_free_deg"
    assert by_video.held_out[name] < 1.25 * by_stills.held_out[name] + 0.2
    assert any("slid or rolled" in note for note in by_video.notes)


def test_a_background_that_is_given_is_used(filmed, sensor, tmp_path):
    first, last = filmed.holds[0][0] - RAMP, filmed.holds[2][1]
    video_file(tmp_path / "busy.avi", [f for k, f in enumerate(filmed.images[:last]) if k > first], "FFV1")
    bgr = cv2.cvtColor(filmed.stills.background, cv2.COLOR_RGB2BGR)
    cv2.imwrite(str(tmp_path / "rest.png"), bgr)
    read = gelform.read_presses(
        tmp_path / "busy.avi", ball_diameter_mm=5, mm_per_px=0.1, background=tmp_path / "rest.png"
    )
    np.testing.assert_array_equal(read.background, filmed.stills.background)
    assert len(read.presses) == 3


def test_a_video_of_blue_green_red_is_read_so(filmed, read, how, tmp_path):
    video_file(
        tmp_path / "bgr.avi",
        [image[..., ::-1] for image in filmed.images[: filmed.holds[2][1] + REST]],
        "FFV1",
    )
    swapped = gelform.read_presses(tmp_path / "bgr.avi", **how, bgr=True)
    assert [frame_of(press) for press in swapped.presses] == [frame_of(press) for press in read.presses[:3]]
    for one, other in zip(
        (swapped.background, swapped.presses[0].image), (read.background, read.presses[0].image)
    ):
        assert np.abs(one - other.astype(float)).mean() < 2
    # OpenCV takes the background for blue, green, red.
    cv2.imwrite(str(tmp_path / "rest.png"), filmed.stills.background)
    given = gelform.read_presses(tmp_path / "bgr.avi", **how, bgr=True, background=tmp_path / "rest.png")
    np.testing.assert_array_equal(given.background, filmed.stills.background)


def test_frames_without_a_press_of_several_sizes_or_too_many_are_refused(filmed, how, monkeypatch):
    """With what they show; so are those without a ball or a scale."""
    frames, (first, last) = frames_of(filmed.images), filmed.slides[0]
    monkeypatch.setattr("gelform.calibration.presses.video.MAX_KEPT_BYTES", 20 * frames[0].image.nbytes)
    for given, changed, message in (
        (frames[:15], {}, r"No contact in .*15 frames.* gray levels"),
        (frames[first:last], {}, r"No stretch of the gel at rest in .*two seconds"),
        (
            [*frames[:15], *frames[first:last], *frames[:15]],
            {},
            r"No press in .*none of the 1 contacts rests",
        ),
        (
            [*frames[:20], replace(frames[20], image=frames[20].image[:100])],
            {},
            "size, got 100x176 after 132x176",
        ),
        ([], {}, "No frame in"),
        (iter(frames), {}, r"more after 20 frames\. Record a video"),
        (frames, {"ball_diameter_mm": None}, "which ball pressed"),
        (frames, {"mm_per_px": None}, "No scale"),
    ):
        with pytest.raises(gelform.DataError, match=message):
            gelform.presses_from_frames(given, **{**how, **changed})


def test_frames_have_a_time():
    for time_s in (None, float("nan"), "0"):
        with pytest.raises((TypeError, ValueError), match="time_s"):
            gelform.Frame(np.full((60, 80, 3), 90, np.uint8), time_s, 0, 1)


def test_light_that_drifts_is_noted(filmed, how):
    fading = np.linspace(1, 0.92, len(filmed.images))
    images = [(image * gain).astype(np.uint8) for image, gain in zip(filmed.images, fading)]
    read = gelform.presses_from_frames(frames_of(images), **how)
    assert len(read.presses) == COUNT
    assert any("light drifted" in note and "R 0.9" in note for note in read.notes)


def test_a_real_video_of_a_moving_finger_has_no_press(data):
    path = data / "mini-markers-video" / "mini_example.avi"
    with pytest.raises(gelform.DataError, match=r"No press in .*none of the 2 contacts rests"):
        gelform.read_presses(path, ball_diameter_mm=5, sensor="gelsight-mini")

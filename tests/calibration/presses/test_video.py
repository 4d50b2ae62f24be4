"""A simulated video with presses, a slide and a roll: the presses come out, the rest is left out and named."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.circles.find import find_contact
from gelform.calibration.presses.video import presses_from_frames
from gelform.image.background.change import ChangeSettings, color_change_from_image
from gelform.image.frame import Frame
from gelform.simulate import (
    Ball,
    Pose,
    press_poses,
    roll_poses,
    simulate_ball_presses,
    simulate_sequence,
    slide_poses,
)

COUNT = 9
BALL_MM = 5.0
HOLD, RAMP, REST = 8, 4, 5


@dataclass(frozen=True)
class Filmed:
    """A video and what is true of it: frames (first, last) of each hold, and the still presses."""

    path: Path
    images: list
    holds: list
    slides: list
    stills: object


def write(path, images, codec="FFV1"):
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 25.0, (width, height))
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    writer.release()


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
    write(path, images)
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


def test_circles_of_the_stills_are_where_the_ball_was(filmed, read):
    settings = ChangeSettings("divide", 10, 0.7)
    found = [find_contact(color_change_from_image(p.image, read.background, settings)) for p in read.presses]
    places = np.array([(contact.x_px, contact.y_px) for contact in found])
    off = places - [true.center_px for true in filmed.stills.presses]
    assert np.median(np.linalg.norm(off, axis=1)) < 1.0


def test_a_background_that_is_given_is_used(filmed, sensor, tmp_path):
    first, last = filmed.holds[0][0] - RAMP, filmed.holds[2][1]
    write(tmp_path / "busy.avi", [f for k, f in enumerate(filmed.images[:last]) if k > first])
    bgr = cv2.cvtColor(filmed.stills.background, cv2.COLOR_RGB2BGR)
    cv2.imwrite(str(tmp_path / "rest.png"), bgr)
    read = gelform.read_presses(
        tmp_path / "busy.avi", ball_diameter_mm=5, mm_per_px=0.1, background=tmp_path / "rest.png"
    )
    np.testing.assert_array_equal(read.background, filmed.stills.background)
    assert len(read.presses) == 3


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (["rest"], r"No contact in .*15 frames.* gray levels"),
        (["slide"], r"No stretch of the gel at rest in .*two seconds"),
        (["rest", "slide", "rest"], r"No press in .*none of the 1 contacts rests"),
    ],
)
def test_a_video_without_a_press_is_refused_with_what_it_shows(filmed, tmp_path, parts, message):
    first, last = filmed.slides[0]
    shown = {"rest": filmed.images[:15], "slide": filmed.images[first:last]}
    write(tmp_path / "a.avi", [image for part in parts for image in shown[part]])
    with pytest.raises(gelform.DataError, match=message):
        gelform.read_presses(tmp_path / "a.avi", ball_diameter_mm=5, mm_per_px=0.1)


def test_a_video_needs_a_ball_and_a_scale(filmed):
    with pytest.raises(gelform.DataError, match="which ball pressed"):
        gelform.read_presses(filmed.path, mm_per_px=0.1)
    with pytest.raises(gelform.DataError, match="No scale"):
        gelform.read_presses(filmed.path, ball_diameter_mm=5)


def test_frames_that_change_their_size_none_and_too_many(filmed, how, monkeypatch):
    frames = frames_of(filmed.images)
    odd = [*frames[:20], replace(frames[20], image=frames[20].image[:100])]
    with pytest.raises(gelform.DataError, match="frames of one size, got 100x176 after 132x176"):
        gelform.presses_from_frames(odd, **how)
    with pytest.raises(gelform.DataError, match="No frame in"):
        gelform.presses_from_frames([], **how)
    monkeypatch.setattr("gelform.calibration.presses.video.MAX_KEPT_BYTES", 20 * frames[0].image.nbytes)
    with pytest.raises(gelform.DataError, match=r"more after 20 frames\. Record a video"):
        gelform.presses_from_frames(iter(frames), **how)


@pytest.mark.parametrize("time_s", [None, float("nan"), "0"])
def test_frames_without_a_time_are_named(time_s, how):
    images = [np.full((60, 80, 3), 90, np.uint8)] * 3
    frames = [Frame(image, time_s if k == 1 else k / 25, 0, k) for k, image in enumerate(images)]
    for given in (frames, iter(frames)):
        with pytest.raises(TypeError, match="Expected time_s of frame 1 in seconds"):
            presses_from_frames(given, **how)


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

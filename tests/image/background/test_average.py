"""Background from frames: less noise, no trace of a touch, and frames that disagree are refused."""

import numpy as np
import pytest

from gelform.errors import DataError
from gelform.image.background.average import background_from_frames, noise_from_image, trimmed_mean

SHAPE = (48, 64)


def truth():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 64
    return np.stack([80 + 60 * x, 110 - 40 * y, 70 + 50 * x * y], axis=-1)


def frames(count, noise=2.0, seed=0):
    rng = np.random.default_rng(seed)
    noisy = (truth() + rng.normal(0, noise, (*SHAPE, 3)) for _ in range(count))
    return [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in noisy]


def touched(frame, at=(12, 40)):
    image = frame.copy()
    image[at[0] : at[0] + 16, at[1] : at[1] + 16] += np.array([30, 10, 20], dtype=np.uint8)
    return image


def test_noise_falls_with_the_number_of_frames():
    error = {
        n: np.sqrt(np.mean((background_from_frames(frames(n)).background - truth()) ** 2)) for n in (1, 4, 36)
    }
    assert error[4] / error[1] == pytest.approx(1 / 2, rel=0.1)
    assert error[36] / error[1] == pytest.approx(1 / 6, rel=0.15)  # a trimmed mean costs a few per cent


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_noise_is_that_of_one_frame(count):
    """Of a slope it is none."""
    noise = background_from_frames(frames(count, noise=2.0)).noise
    assert noise == pytest.approx([2.0] * 3, rel=0.12)
    assert noise_from_image(truth()) == pytest.approx([0] * 3, abs=1e-4)


def test_frames_that_are_touched_or_exposed_otherwise_are_left_out_by_name():
    images = frames(9)
    images[2], images[7] = touched(images[2]), touched(images[7])
    images[4] = np.clip(np.rint(images[4] * 1.06), 0, 255).astype(np.uint8)
    found = background_from_frames(images, names=[f"{k}.png" for k in range(9)])
    assert [name for name, _ in found.left_out] == ["2.png", "4.png", "7.png"]
    assert "by a touch or a shadow" in found.left_out[0][1]
    assert "+6 %" in found.left_out[1][1]
    clean = background_from_frames([image for k, image in enumerate(images) if k not in (2, 4, 7)])
    np.testing.assert_array_equal(found.background, clean.background)
    assert background_from_frames(images).left_out[0][0] == "frame 2"


def test_a_small_thing_that_moves_leaves_no_trace():
    """A fiber over a pixel or two in some frames is too small to cost a frame; the trimming takes it."""
    images = frames(15)
    for k in (1, 6, 11):
        images[k][20, 30:32] = 0
    found = background_from_frames(images)
    assert found.left_out == ()
    assert np.abs(found.background - truth())[20, 30:32].max() < 3


@pytest.mark.parametrize("count", [2, 4])
def test_frames_that_disagree_are_refused(count):
    images = frames(count)
    images[: count // 2] = [touched(image) for image in images[: count // 2]]
    with pytest.raises(DataError, match=r"that agree, got \d of \d .*frame 0: .*Take them again"):
        background_from_frames(images)


def test_no_frames_and_other_sizes_are_refused():
    with pytest.raises(DataError, match="got none"):
        background_from_frames([])
    with pytest.raises(ValueError, match="48x64"):
        background_from_frames([*frames(2), np.zeros((20, 30, 3), dtype=np.uint8)])


def test_a_long_stream_is_thinned_not_held():
    held = []

    def stream():
        for k in range(200):
            held.append(k)
            yield frames(1, seed=k)[0]

    found = background_from_frames(stream(), max_bytes=20 * frames(1)[0].nbytes)
    assert len(held) == 200
    rms = np.sqrt(np.mean((found.background - truth()) ** 2))
    assert 2 / np.sqrt(22) < rms < 2 / np.sqrt(9)  # 10 to 20 of the 200 were averaged


def test_a_stream_is_thinned_evenly():
    """Light that drifts by 2 % over the stream: the average is that of the whole, not of its end."""
    drift = np.linspace(0.99, 1.01, 160)
    images = (np.clip(np.rint(truth() * gain), 0, 255).astype(np.uint8) for gain in drift)
    found = background_from_frames(images, max_bytes=20 * frames(1)[0].nbytes)
    assert np.mean(found.background) / np.mean(truth()) == pytest.approx(1, abs=0.002)


def test_a_trimmed_mean_ignores_a_passing_speck_and_leaves_no_frame_out():
    images = frames(24)
    images[3][10:15, 10:15] = 250
    images = [
        np.clip(image * gain, 0, 255).astype(np.uint8) for image, gain in zip(images, np.linspace(1, 0.8, 24))
    ]
    mean, noise = trimmed_mean(images)
    assert np.abs(mean - 0.9 * truth())[10:15, 10:15].max() < 3.5
    assert (noise > 2).all()
    with pytest.raises(DataError, match="another exposure"):
        background_from_frames(images)

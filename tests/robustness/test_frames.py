"""Any frame: an error, a finding, or the true depth of the ball."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelform
from hostile.budget import SLOW_IF_ALL, cases
from hostile.damage import odd_arrays
from hostile.outcome import judge
from made.small_gel import SHAPE, Touch, calibration, depth_error, image_of

pytestmark = SLOW_IF_ALL

TOUCHES = st.builds(
    Touch,
    radius_mm=st.floats(3.0, 6.0),
    depth_mm=st.floats(0.15, 0.5),
    x_px=st.floats(25, 55),
    y_px=st.floats(22, 42),
    seed=st.integers(0, 1000),
)
LEVEL = st.sampled_from([0, 1, 128, 254, 255])
AMOUNT = st.floats(0.02, 1.0)


@pytest.fixture(scope="module")
def reconstruct():
    return gelform.Reconstructor(calibration())


def part_lost(image, amount, level, rng):
    """Rows or columns, at one end, of one level; of columns at least a block's width, as they are not sent by column."""
    count = round(amount * (SHAPE[0] - 1)) + 1
    wide = max(count, 32)
    side = [np.s_[:count], np.s_[-count:], np.s_[:, :wide], np.s_[:, -wide:]][rng.integers(4)]
    image[side] = level
    return image


def row_repeated(image, amount, level, rng):
    image[-round(amount * 40) - 2 :] = image[-round(amount * 40) - 3]
    return image


def band_copied(image, amount, level, rng):
    count = max(2, round(amount * 30))
    image[-count:] = image[:count]
    return image


def rows_shifted(image, amount, level, rng):
    """By so much that the seam is 5 grey levels high: what is less is not told from a gel's own edges."""
    start = rng.integers(0, SHAPE[0])
    image[start:] = np.roll(image[start:], 20 + round(amount * 20), axis=1)
    return image


def exposed(image, amount, level, rng):
    return np.clip(image * (0.3 + 1.4 * amount), 0, 255).astype(np.uint8)


def channel_off(image, amount, level, rng):
    image[..., rng.integers(3)] = level
    return image


def channels_turned(image, amount, level, rng):
    return image[..., rng.permutation(3)]


def speckled(image, amount, level, rng):
    image[rng.random(SHAPE) < 0.1 * amount] = level
    return image


def noisier(image, amount, level, rng):
    return np.clip(image + rng.normal(0, 3 * amount, image.shape), 0, 255).astype(np.uint8)


def compressed(image, amount, level, rng):
    _, content = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 30 + int(69 * amount)])
    return cv2.imdecode(content, cv2.IMREAD_COLOR)[..., ::-1]


def turned(image, amount, level, rng):
    return [image[::-1], image[:, ::-1], image[::-1, ::-1]][rng.integers(3)]


def of_other_values(image, amount, level, rng):
    return rng.integers(0, level + 1, image.shape).astype(np.uint8)


def constant(image, amount, level, rng):
    image[:] = level
    return image


def as_it_is(image, amount, level, rng):
    return image


DEGRADATIONS = [
    part_lost, row_repeated, band_copied, rows_shifted, exposed, channel_off, channels_turned, speckled, noisier, compressed,
    turned, of_other_values, constant, as_it_is,
]  # fmt: skip


@cases(250)
@given(touch=TOUCHES, how=st.sampled_from(DEGRADATIONS), amount=AMOUNT, level=LEVEL, seed=st.integers(0, 99))
def test_a_degraded_frame(reconstruct, touch, how, amount, level, seed):
    frame = np.ascontiguousarray(how(image_of(touch), amount, level, np.random.default_rng(seed)))
    case = f"frame {how.__name__} {amount:.2f} level {level} seed {seed} of {touch}"
    judge(case, lambda: reconstruct(frame), lambda result: depth_error(result.depth_mm, touch))


@cases(75)
@given(touch=TOUCHES, which=st.integers(0, 47))
def test_what_is_no_frame(reconstruct, touch, which):
    frame = odd_arrays(image_of(touch))[which]
    judge(f"no frame {which}", lambda: reconstruct(frame), lambda result: depth_error(result.depth_mm, touch))


@cases(60)
@given(touch=TOUCHES, how=st.sampled_from(DEGRADATIONS), amount=AMOUNT, level=LEVEL, seed=st.integers(0, 99))
def test_a_degraded_background(touch, how, amount, level, seed):
    rest = np.ascontiguousarray(how(image_of(None), amount, level, np.random.default_rng(seed)))
    judge(
        f"background {how.__name__} {amount:.2f} level {level} seed {seed}",
        lambda: gelform.Reconstructor(calibration(), background=rest)(image_of(touch)),
        lambda result: depth_error(result.depth_mm, touch),
    )


@cases(30)
@given(which=st.integers(0, 47))
def test_what_is_no_background(which):
    rest = odd_arrays(image_of(None))[which]
    touch = Touch()
    judge(
        f"no background {which}",
        lambda: gelform.Reconstructor(calibration(), background=rest)(image_of(touch)),
        lambda result: depth_error(result.depth_mm, touch),
    )

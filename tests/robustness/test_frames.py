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


def spoilt(image, where, level):
    image[where] = level
    return image


def as_image(values):
    return np.clip(values, 0, 255).astype(np.uint8)


def part_lost(image, amount, level, rng):
    """Rows or columns, at one end, of one level; of columns at least a block's width, as they are not sent by column."""
    count = round(amount * (SHAPE[0] - 1)) + 1
    wide = max(count, 32)
    return spoilt(
        image, [np.s_[:count], np.s_[-count:], np.s_[:, :wide], np.s_[:, -wide:]][rng.integers(4)], level
    )


def rows_shifted(image, amount, level, rng):
    """By so much that the seam is 5 gray levels high: what is less is not told from a gel's own edges."""
    start = rng.integers(0, SHAPE[0])
    image[start:] = np.roll(image[start:], 20 + round(amount * 20), axis=1)
    return image


def compressed(image, amount, level, rng):
    _, content = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 30 + int(69 * amount)])
    return cv2.imdecode(content, cv2.IMREAD_COLOR)[..., ::-1]


def band_copied(image, amount, level, rng):
    count = max(2, round(amount * 30))
    return spoilt(image, np.s_[-count:], image[:count])


def row_repeated(image, amount, level, rng):
    """At least 15, which makes 16 equal ones: JPEG makes fewer."""
    count = round(amount * 30) + 15
    return spoilt(image, np.s_[-count:], image[-count - 1])


DEGRADATIONS = {
    "part lost": part_lost,
    "row repeated": row_repeated,
    "band copied": band_copied,
    "rows shifted": rows_shifted,
    "compressed": compressed,
    "exposed": lambda image, amount, *_: as_image(image * (0.3 + 1.4 * amount)),
    "noisier": lambda image, amount, _, rng: as_image(image + rng.normal(0, 3 * amount, image.shape)),
    "channel off": lambda image, _, level, rng: spoilt(image, np.s_[..., rng.integers(3)], level),
    "channels turned": lambda image, amount, level, rng: image[..., rng.permutation(3)],
    "speckled": lambda image, amount, level, rng: spoilt(image, rng.random(SHAPE) < 0.1 * amount, level),
    "turned": lambda image, amount, level, rng: np.flip(image, [(0,), (1,), (0, 1)][rng.integers(3)]),
    "of other values": lambda image, _, level, rng: rng.integers(0, level + 1, image.shape).astype(np.uint8),
    "constant": lambda image, amount, level, rng: spoilt(image, np.s_[:], level),
    "as it is": lambda image, *_: image,
}


def degraded(image, how, *settings):
    return np.ascontiguousarray(DEGRADATIONS[how](image, *settings))


HOW = {
    "how": st.sampled_from(list(DEGRADATIONS)),
    "amount": AMOUNT,
    "level": LEVEL,
    "seed": st.integers(0, 99),
}


@cases(250)
@given(touch=TOUCHES, **HOW)
def test_a_degraded_frame(reconstruct, touch, how, amount, level, seed):
    frame = degraded(image_of(touch), how, amount, level, np.random.default_rng(seed))
    case = f"frame {how} {amount:.2f} level {level} seed {seed} of {touch}"
    judge(case, lambda: reconstruct(frame), lambda result: depth_error(result.depth_mm, touch))


@cases(75)
@given(touch=TOUCHES, which=st.integers(0, 47))
def test_what_is_no_frame(reconstruct, touch, which):
    frame = odd_arrays(image_of(touch))[which]
    judge(f"no frame {which}", lambda: reconstruct(frame), lambda result: depth_error(result.depth_mm, touch))


def judge_background(case, rest, touch):
    judge(
        f"background {case}",
        lambda: gelform.Reconstructor(calibration(), background=rest)(image_of(touch)),
        lambda result: depth_error(result.depth_mm, touch),
    )


@cases(60)
@given(touch=TOUCHES, **HOW)
def test_a_degraded_background(touch, how, amount, level, seed):
    rest = degraded(image_of(None), how, amount, level, np.random.default_rng(seed))
    judge_background(f"{how} {amount:.2f} level {level} seed {seed}", rest, touch)


@cases(30)
@given(which=st.integers(0, 47))
def test_what_is_no_background(which):
    judge_background(f"that is none {which}", odd_arrays(image_of(None))[which], Touch())

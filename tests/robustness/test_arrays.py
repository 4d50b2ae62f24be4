"""Every public function, with each of its arguments replaced by something odd in turn, and with all of them odd.

Any frame: an error, a finding, or the true depth of the ball.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelform
from hostile.damage import ODD_VALUES, odd_arrays
from hostile.doors import ALL_ODD, EXPORTS, OTHERS, USES, VALUES, called, parameters_of, right_arguments
from hostile.outcome import SLOW_IF_ALL, cases, judge
from made.small_gel import SHAPE, Touch, calibration, depth_error, image_of

pytestmark = SLOW_IF_ALL

SLOW = ("picture", "calibrate", "evaluate", "scale_from_stage")
ODD_SETTINGS = (*ODD_VALUES, 1e9, 3e38, float("nan"))
NOTHING_RIGHT = (
    *ODD_SETTINGS,
    (1, 2),
    (1.0, 2.0, 3.0),
    gelform.View(),
    *odd_arrays(np.ones((6, 8, 3), np.float32)),
)


@pytest.mark.parametrize("name", sorted(EXPORTS.keys() - ALL_ODD))
def test_every_export_has_right_arguments(name):
    """A new one needs a line in hostile/doors.py only for an argument of a name that is new."""
    if "nowhere" in str(arguments := right_arguments(name)):
        with pytest.raises(gelform.GelformError, match="nowhere"):
            called(name, arguments)
    else:
        called(name, arguments)


def test_every_line_of_the_tables_is_of_an_export():
    assert {*OTHERS, *USES, *ALL_ODD} <= EXPORTS.keys()
    assert VALUES.keys() <= {one for name in EXPORTS for one in parameters_of(name)}


@pytest.mark.parametrize("name", EXPORTS)
def test_all_arguments_odd(name, tmp_path, monkeypatch):
    """Of its signature, so that nobody has to write down what a function takes."""
    monkeypatch.chdir(tmp_path)
    named = [(one, p.default is p.empty) for one, p in parameters_of(name).items()]

    @cases(10)
    @given(data=st.data())
    def of_any_kind(data):
        given_ones = [one for one, needed in named if needed or data.draw(st.booleans())]
        chosen = {one: data.draw(st.integers(0, len(NOTHING_RIGHT) - 1)) for one in given_ones}
        judge(f"{name}({chosen})", lambda: called(name, {one: NOTHING_RIGHT[k] for one, k in chosen.items()}))

    of_any_kind()


def as_numbers(value: Any) -> np.ndarray | None:
    """The numbers that something holds, or None: same numbers in other clothes have to give the same result."""
    try:
        array = np.ma.getdata(value) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        return None if np.ma.isMaskedArray(value) or array.dtype.kind not in "fiub" else array.astype(float)
    except (TypeError, ValueError, RuntimeError):
        return None


def values_of(result: Any) -> list[np.ndarray]:
    """The arrays of a result, for comparison."""
    if isinstance(result, np.ndarray):
        return [result]
    if isinstance(result, tuple):
        return [array for one in result for array in values_of(one)]
    return [value for value in getattr(result, "__dict__", {}).values() if isinstance(value, np.ndarray)]


def difference(name: str, got: Any, argument: str, odd: Any) -> str | None:
    """Where the odd argument holds the right numbers, the result has to be the right one."""
    arguments = right_arguments(name)
    right, numbers = as_numbers(arguments.get(argument)), as_numbers(odd)
    if right is None or numbers is None or right.shape != numbers.shape or not np.allclose(right, numbers):
        return None
    for one, other in zip(values_of(got), values_of(called(name, arguments))):
        if not one.size and one.shape == other.shape:
            continue
        if one.shape != other.shape or not np.allclose(one, other, atol=2e-2 * max(1.0, np.abs(other).max())):
            return "the same numbers give another result"
    return None


@pytest.mark.parametrize("name", sorted(EXPORTS.keys() - ALL_ODD))
def test_one_argument_odd(name, tmp_path, monkeypatch):
    """Needed or an option, beside right ones."""
    monkeypatch.chdir(tmp_path)
    right = right_arguments(name)
    with np.errstate(all="ignore"):
        odd = {
            one: odd_arrays(right[one]) if isinstance(right.get(one), np.ndarray) else list(ODD_SETTINGS)
            for one in parameters_of(name)
        }

    @cases(4 if name in SLOW else 25)
    @given(argument=st.sampled_from(sorted(odd)), which=st.integers(0, 80))
    def of_any_kind(argument, which):
        which %= len(odd[argument])
        chosen = odd[argument][which]
        judge(
            f"{name}({argument}=odd {which}: {chosen!r:.30})",
            lambda: called(name, right | {argument: chosen}),
            lambda got: difference(name, got, argument, chosen),
        )

    of_any_kind()


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

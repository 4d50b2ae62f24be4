"""Untouched, still, sliding: told apart in sequences whose truth is known."""

import numpy as np
import pytest

from gelform.calibration.presses.stills import (
    Thumbnails,
    center_of,
    distances,
    noise_of,
    runs,
    stretches,
    thumbnail,
    touch_threshold,
    untouched,
)

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


def test_center_and_runs():
    rng = np.random.default_rng(2)
    x, y = center_of(gel(rng, (30.3, 11.6, 50)), gel(rng))
    assert (x, y) == pytest.approx((30.3, 11.6), abs=0.5)
    assert runs(np.array([1, 1, 0, 1, 0, 0, 1], dtype=bool)) == [(0, 2), (3, 4), (6, 7)]
    assert runs(np.zeros(3, dtype=bool)) == []

"""Where something last touched: seen as contact, or as blocks that stand out; with a margin, for a time."""

import numpy as np
import pytest

from gelform.streams.rest.touched import Touched

BLOCKS = (20, 30)
REST = np.full((*BLOCKS, 3), 100, np.float32)
NOWHERE = np.zeros(BLOCKS, bool)


def noisy(seed=0, levels=0.02):
    return np.random.default_rng(seed).normal(0, levels / 100, (*BLOCKS, 3)).astype(np.float32)


def test_noise_touches_nothing():
    touched = Touched(BLOCKS)
    for second in range(200):
        touched.see(float(second), 1.0, NOWHERE, noisy(second), REST)
    assert touched.not_since(0.0).all()


def test_contact_counts_with_a_margin():
    touched, contact = Touched(BLOCKS), NOWHERE.copy()
    contact[10, 15] = True
    near = touched.see(50.0, 1.0, contact, noisy(), REST)
    assert near[10, 15]
    assert near[12, 15]
    assert near[10, 13]
    assert not near[14, 15]
    assert near.sum() < 30
    np.testing.assert_array_equal(touched.not_since(50.0), ~near)
    assert touched.not_since(50.1).all()


def test_a_block_that_stands_out_is_touched():
    change = noisy()
    change[5, 7, 1] = 0.004  # in one channel
    assert Touched(BLOCKS).see(1.0, 1.0, NOWHERE, change, REST)[5, 7]


def test_what_is_slight_is_seen_in_time():
    """Half the noise limit of a second stands out of the mean of ten."""
    touched, seen = Touched(BLOCKS), []
    for second in range(30):
        change = noisy(second, levels=0.12)
        change[5, 7] += 0.0045
        seen.append(bool(touched.see(float(second), 1.0, NOWHERE, change, REST)[5, 7]))
    assert all(seen[20:])


def test_a_strong_touch_is_forgotten_soon():
    touched = Touched(BLOCKS)
    pressed = noisy()
    pressed[5, 7] = 0.4
    for second in range(20):
        touched.see(float(second), 1.0, NOWHERE, pressed, REST)
    for second in range(20, 60):
        touched.see(float(second), 1.0, NOWHERE, noisy(second), REST)
    assert touched.not_since(45.0).all()


def test_light_that_changes_everywhere_is_no_touch():
    """Blocks are held against each other: a pattern all over raises what counts as noise."""
    x = np.linspace(-0.01, 0.01, BLOCKS[1], dtype=np.float32)[None, :, None]
    assert not Touched(BLOCKS).see(1.0, 1.0, NOWHERE, x + noisy(), REST).any()


def test_nobody_looked():
    touched = Touched(BLOCKS)
    touched.everywhere(3.0)
    assert not touched.not_since(3.0).any()
    touched.nowhere()
    assert touched.not_since(0.0).all()


@pytest.mark.parametrize("blocks", [(1, 1), (3, 40)])
def test_small_images(blocks):
    touched = Touched(blocks)
    rest = np.full((*blocks, 3), 50, np.float32)
    assert touched.see(0.0, 1.0, np.ones(blocks, bool), rest * 0, rest).all()

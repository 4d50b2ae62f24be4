"""The gamut: 0 at the colours of the training presses, beyond them the slope that the difference is worth."""

import numpy as np
import pytest

from gelform.color_models._shared import gamut as module
from gelform.color_models._shared.gamut import Gamut
from kernel_agreement import assert_kernel_agrees


def test_distance_is_the_difference_of_colour_in_slopes():
    rng = np.random.default_rng(2)
    seen = rng.uniform(-0.3, 0.3, (20_000, 3)).astype(np.float32)
    gamut = Gamut.fit(seen, 2 * seen[:, :2])
    change = np.zeros((2, 3, 3), dtype=np.float32)
    change[0, 1], change[0, 2], change[1, 0] = (0.25, 0, 0), (0.5, 0, 0), (5.0, 0, 0)
    away = gamut.distance_of(change)
    assert away[0, 0] == away[0, 1] == 0
    worth = gamut.slope_per_change
    assert worth == pytest.approx(2 * np.sqrt(2 / 3), rel=0.02)
    assert away[0, 2] == pytest.approx(0.2 * worth, abs=1.6 * gamut.bin_width * worth)
    assert away[1, 0] == pytest.approx(4.7 * worth, rel=0.1)


def test_a_color_that_stands_alone_was_not_seen():
    rng = np.random.default_rng(3)
    seen = rng.uniform(-0.1, 0.1, (20_000, 3)).astype(np.float32)
    seen[7] = 0.9
    gamut = Gamut.fit(seen, seen[:, :2])
    lone = np.full((1, 1, 3), 0.9, dtype=np.float32)
    assert gamut.distance_of(lone)[0, 0] > 0.5 * gamut.slope_per_change


def test_the_kernel_is_the_table_and_the_way_to_it():
    rng = np.random.default_rng(5)
    change = rng.uniform(-0.6, 0.6, (9, 31, 3)).astype(np.float32)
    table = rng.uniform(size=(5, 5, 5)).astype(np.float32)
    low = np.array([-0.4, -0.3, -0.2], np.float32)

    def reference(change, table, low, distance, per_bin, worth):
        at = (change.astype(np.float64) - low) * per_bin
        inside = np.clip(at, 0, 4)
        nearest = tuple(np.floor(np.moveaxis(inside, -1, 0) + 0.5).astype(int))
        return table[nearest] + worth * np.linalg.norm(at - inside, axis=-1)

    distance = np.empty((9, 31), np.float32)
    assert_kernel_agrees(module._gamut_distance, reference, change, table, low, distance, 6.5, 0.7)


def test_the_grid_spans_all_colours_and_a_quarter_more():
    """Red changes three times as much as blue; what lies a bin beyond a colour that was seen counts as seen."""
    seen = np.random.default_rng(4).uniform(-1, 1, (40_000, 3)) * np.array([0.3, 0.2, 0.1])
    edge = 0.3 + 0.9 * 0.6 * 1.5 / 23  # 0.9 bins beyond the largest red
    gamut = Gamut.fit(np.concatenate([seen, [[0.49, 0, 0]]]), seen[:, :2])
    away = gamut.distance_of(seen[None].astype(np.float32))
    assert np.mean(away == 0) > 0.99
    assert gamut.distance_of(np.float32([[[edge, 0, 0]]])) == 0
    assert gamut.low[0] == pytest.approx(-0.45, abs=0.01)
    assert gamut.low[0] + 23 * gamut.bin_width == pytest.approx(0.45, abs=0.01)

"""The last moves bring circles that are off nearer to the truth; too few presses leave them."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.circles.settle import LEAST_PRESSES, settled


@pytest.fixture(scope="module")
def true(simulated, found):
    return [
        replace(contact, x_px=press.center_px[0], y_px=press.center_px[1])
        for contact, press in zip(found, simulated.presses)
    ]


def distances(contacts, true):
    return np.array([np.hypot(a.x_px - b.x_px, a.y_px - b.y_px) for a, b in zip(contacts, true)])


def test_circles_that_are_off_come_nearer_to_the_truth(prepared, true):
    rng = np.random.default_rng(3)
    off = [
        replace(c, x_px=c.x_px + dx, y_px=c.y_px + dy)
        for c, (dx, dy) in zip(true, rng.normal(0, 1.5, (len(true), 2)))
    ]
    after = distances(settled(prepared, off, off), true)
    assert np.sqrt(np.mean(after**2)) < 0.6 * np.sqrt(np.mean(distances(off, true) ** 2))


def test_few_presses_leave_their_circles(prepared, found):
    count = LEAST_PRESSES - 1
    assert settled(prepared[:count], found[:count], found[:count]) == tuple(found[:count])

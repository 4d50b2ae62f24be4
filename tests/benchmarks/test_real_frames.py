"""The benchmark on real frames counts what it says, its quick run works, and the pages quote its results alone."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage

from gelform.contact import contacts_from_mask
from gelform.simulate import LAYOUTS, simulate_press
from real_frames import page
from real_frames.contacts import contacts, counted, rest
from real_frames.faults import exposure, older_halves, tears, torn
from real_frames.sets import Run
from real_frames.simulated import TwoBalls
from report import RESULTS

FIGURES = json.loads((RESULTS / "real_frames.json").read_text(encoding="utf-8"))
TEXTS = {name: (page.ROOT / name).read_text(encoding="utf-8") for name in page.PAGES}


@dataclass
class Found:
    """A result with these discs (x, y, radius, depth) as contacts."""

    discs: list

    shape = (60, 80)

    def __post_init__(self):
        y, x = np.mgrid[: self.shape[0], : self.shape[1]]
        depth = np.zeros(self.shape)
        for cx, cy, radius, depth_mm in self.discs:
            depth[np.hypot(x - cx, y - cy) < radius] = depth_mm
        self.contacts, self.contact_labels = contacts_from_mask(depth != 0, depth, mm_per_px=0.1)


def test_contacts_are_counted():
    ball, speck, hollow = (40, 30, 10, 0.5), (5, 5, 3, 0.1), (70, 50, 3, -0.1)
    results = [Found(one) for one in ([], [ball], [speck], [ball, speck, hollow])]
    found = counted(results, [(40, 30, 12)] * 4)
    ratio = found.pop("radius over circle")
    assert list(found.values()) == [
        4,
        50,
        25,
        0.5,
        1,
        25,
    ]  # the speck alone is one contact, but not on the ball
    assert ratio == pytest.approx(10 / 12, abs=0.02)
    assert counted(results)["one, on the ball %"] is None


def test_a_circle_that_is_unsure_or_outside_is_not_judged():
    results = [Found([(40, 30, 10, 0.5)])] * 3
    assert counted(results, [None, (40, 30, 12), (40, 60, 12)])["one, on the ball %"] == 100


def test_torn_frames_are_counted():
    rest_image = np.random.default_rng(0).integers(100, 120, (96, 128, 3), np.uint8)
    gray = rest_image.copy()
    gray[48:] = 128
    sound = rest_image.copy()
    sound[40, 60] += 1
    assert torn(rest_image, [sound, gray, sound]) == {
        "frames": 3,
        "torn": 1,
        "percent": pytest.approx(100 / 3),
    }


@pytest.mark.slow
def test_two_balls_touch_a_gap_apart():
    sensor, rng = LAYOUTS["ring-120"], np.random.default_rng(0)
    for apart, contacts_of_both in ((0.0, 1), (2.6, 2)):
        press = simulate_press(sensor, TwoBalls(1.5, apart), depth_mm=0.3, rng=rng, oversample=1)
        labels, count = ndimage.label(press.contact)
        assert count == contacts_of_both
        if count == 2:
            (left, right) = (np.argwhere(labels == k)[:, 1] for k in (1, 2))
            centers = abs(left.mean() - right.mean()) * sensor.mm_per_px
            assert centers == pytest.approx(apart, abs=0.1)


@pytest.mark.slow
def test_quick_parts_run_on_one_set(data, tmp_path):
    run = Run(("digit-ball",), quick=True, cache=tmp_path)
    found = {part.__name__: part(run) for part in (contacts, rest, exposure, tears)}
    assert found["contacts"]["balls"]["digit-ball"]["frames"] == 7
    assert found["rest"]["digit-ball, background and noise"]["frames"] == 4
    moved = found["exposure"]["digit-ball"]
    assert 0 < moved["moved, median"] <= moved["moved, max"] < moved["largest, max"]
    assert found["tears"]["sound: digit-ball"]["torn"] == 0
    (kept,) = tmp_path.glob("*digit-ball.pickle")
    kept.rename(tmp_path / "gone")
    again = Run(("digit-ball",), quick=True, cache=tmp_path)
    (tmp_path / "gone").rename(kept)
    assert again.calibration("digit-ball").digest == run.calibration("digit-ball").digest


def test_halves_are_of_two_presses_with_a_contact_at_the_seam(data):
    run = Run()
    presses, halves = run.presses("mini-ball").presses, older_halves(run)
    assert 16 <= len(halves) < len(presses)
    for half in halves:
        above, below = (
            [k for k, one in enumerate(presses) if np.array_equal(one.image[rows], half[rows])]
            for rows in (np.s_[:120], np.s_[120:])
        )
        assert above[0] == below[0] + 1


@pytest.mark.parametrize("name", page.PAGES)
def test_pages_quote_the_recorded_figures(name):
    """`python benchmarks/real_frames.py --pages` writes them."""
    assert page.filled(TEXTS[name], FIGURES) == TEXTS[name]


def test_every_block_stands_in_a_page():
    quoted = {found[2] for text in TEXTS.values() for found in page.BLOCK.finditer(text)}
    assert quoted == set(page.BLOCKS)


def test_another_figure_is_noticed():
    text = TEXTS["docs/accuracy.md"]
    changed = json.loads(json.dumps(FIGURES))
    changed["contacts"]["balls"]["mini-ball"]["exactly one %"] += 1
    assert page.filled(text, changed) != text
    assert page.filled(page.filled(text, changed), FIGURES) == text

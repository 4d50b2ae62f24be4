"""The benchmark of decisions: its rows, its outline of an imprint, and the page that quotes it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from real_frames import page as pages
from report import recorded
from strangers import page
from strangers.frames import imprint
from strangers.page import decisions
from strangers.rest import is_still
from strangers.rows import row
from strangers.touched import blend

TEXT = (Path(__file__).parents[2] / page.PAGES[0]).read_text(encoding="utf-8")
FIGURES = recorded("strangers")


def filled(figures):
    return pages.filled(TEXT, figures, page.BLOCK, page.BLOCKS)


def test_the_page_quotes_the_recorded_figures():
    """`python benchmarks/strangers.py --pages` writes them."""
    assert {found[2] for found in page.BLOCK.finditer(TEXT)} == set(page.BLOCKS)
    assert filled(FIGURES) == TEXT


def test_another_figure_is_noticed():
    changed = json.loads(json.dumps(FIGURES))
    changed["unknown"]["homemade-hd"]["yes, wrong"] += 1
    assert filled(changed) != TEXT


def test_each_decision_has_frames_of_the_full_run():
    for what, part, ends, right in page.DECISIONS:
        assert sum(one[right] for name, one in FIGURES[part].items() if name.endswith(ends)), what


def test_a_row_counts_both_ways():
    found = row(no=[True, False], yes=[False, False, True, True], figures=[0.3, 0.1])
    assert (found["no"], found["no, wrong"], found["yes"], found["yes, wrong"]) == (2, 1, 4, 2)
    assert found["figures"] == [0.1, 0.3]
    assert row(yes=[True])["no, wrong %"] is None


def test_the_worst_set_has_the_largest_share():
    rows = {"a": row(no=[True] + 9 * [False]), "b": row(no=[True, False]), "c": row(no=20 * [False])}
    line = next(one for one in decisions({"torn": rows}).splitlines() if "called torn" in one)
    assert "| 2 of 32 | 6.2 % | 2 of 3 | b: 1 of 2 |" in line


@pytest.fixture
def gel():
    """A smooth background, (120, 160, 3)."""
    y, x = np.mgrid[:120, :160]
    return np.stack([90 + 0.3 * x, 100 + 0.3 * y, 130 - 0.2 * x], axis=-1).astype(np.float32)


def test_an_imprint_is_found_beside_a_change_of_light(gel):
    y, x = np.mgrid[:120, :160]
    inside = np.hypot(x - 100, y - 60) < 20
    image = 1.05 * gel
    image[..., 0][inside] += 1.5 * (x - 100)[inside]
    image[..., 1][inside] += 1.5 * (y - 60)[inside]
    found = imprint(np.clip(image, 0, 255).astype(np.uint8), gel)
    assert np.count_nonzero(found & inside) > 0.9 * inside.sum()
    assert np.count_nonzero(found & ~inside) < 0.2 * inside.sum()
    assert not imprint((1.05 * gel).astype(np.uint8), gel).any()


def test_a_touch_is_not_still_and_a_blend_is_part_of_it(gel):
    touched = gel.copy()
    touched[40:60, 40:60] += 30
    assert is_still(gel + 3, gel)
    assert not is_still(touched, gel)
    assert np.abs(blend(gel, touched, 0.25) - gel).max() == pytest.approx(7.5, abs=1e-3)

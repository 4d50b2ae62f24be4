"""How many presses are enough, as the docs show too, and where they are missing: a gap is where to press next."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gelform.calibration.coverage import (
    DIRECTIONS,
    NEEDED,
    REFINING,
    coverage_from_circles,
    coverage_notes,
    direction_of,
    name_of_place,
    one_part,
    press_coverage,
    press_next,
    square_tiles,
    tile_of,
)

PAGE = Path(__file__).parents[2] / "docs" / "press-folder.md"


def test_the_docs_show_the_table_and_enough_begins_at_the_number_of_its_row():
    rows = re.findall(r"^\| (\d+) \| .* \| .* \|$", PAGE.read_text(encoding="utf-8"), re.M)
    assert [int(number) for number in rows] == [need.presses for need in NEEDED]
    for need in NEEDED:
        assert (need.met(need.presses - 1), need.met(need.presses)) == (False, True)


def test_few_presses_carry_few_terms():
    for table in (REFINING, list(NEEDED)):
        counts = [row[0] for row in table]
        assert counts == sorted(counts)
    assert REFINING[0][0] == 0, "something is always fitted"


SHAPE = (240, 320)


def lattice(rows, cols, radius=25, shape=SHAPE):
    """Presses on a regular lattice over the image."""
    high, wide = shape[0] / rows, shape[1] / cols
    return [((j + 0.5) * wide, (i + 0.5) * high, radius) for i in range(rows) for j in range(cols)]


def test_a_press_shows_every_direction_of_its_cell_that_the_border_leaves_and_nothing_else():
    """Of a center on the left border the right half, where it falls to the right: dz/dx < 0. On the top border dz/dy < 0."""
    coverage = coverage_from_circles([(40.0, 40.0, 25.0)], SHAPE)
    assert (coverage.counts[0, 0] == 1).all()
    assert coverage.counts.sum() == DIRECTIONS
    assert coverage.fraction == pytest.approx(1 / 12)
    for circle, shown, beside in (((0.0, 40.0, 30.0), 4, 0), ((40.0, 0.0, 30.0), 6, 2)):
        counts = coverage_from_circles([circle], SHAPE).counts[0, 0]
        assert (counts[shown], counts[beside]) == (1, 0)


def test_presses_add_up():
    one, other = lattice(3, 4), lattice(2, 3)
    first, second, together = (coverage_from_circles(some, SHAPE) for some in (one, other, [*one, *other]))
    np.testing.assert_array_equal(together.counts, first.counts + second.counts)
    assert first.fraction == 1


def test_the_place_without_a_press_is_named_first():
    for row, col, name in ((0, 0, "top left"), (2, 3, "bottom right"), (0, 3, "top right")):
        circles = [c for k, c in enumerate(lattice(3, 4)) if k != row * 4 + col]
        coverage = coverage_from_circles(circles, SHAPE)
        place, *_ = press_next(coverage, 3)
        assert place.name == name
        added = coverage_from_circles([*circles, (place.x_px, place.y_px, 25.0)], SHAPE)
        assert added.fraction > coverage.fraction
        assert (added.counts[row, col] > 0).sum() >= 6
    for x, y, opposite in ((30, 30, "bottom right"), (290, 30, "bottom left"), (30, 210, "top right")):
        (place,) = press_next(coverage_from_circles([(x, y, 25.0)], SHAPE), 1)
        assert place.name == opposite, "of equal places the farthest"


@pytest.mark.slow
def test_pressing_where_it_is_said_covers_the_frame():
    circles = [(30.0, 30.0, 25.0)]
    for _ in range(40):
        places = press_next(coverage_from_circles(circles, SHAPE), 1)
        if not places:
            break
        circles.append((places[0].x_px, places[0].y_px, 25.0))
    assert coverage_from_circles(circles, SHAPE).fraction == 1
    assert len(circles) <= 20


def test_places_are_named_as_the_image_shows_them():
    places = (10, 10), (310, 10), (160, 230), (10, 120), (160, 120), (-5, 400)
    names = ["top left", "top right", "bottom", "left", "middle", "bottom left"]
    assert [name_of_place(x, y, SHAPE) for x, y in places] == names


def test_all_in_one_corner():
    circles = [(x / 3 + 200, y / 3 + 150, 25.0) for x, y, _ in lattice(5, 5)]
    assert one_part(circles, SHAPE) == "bottom right"
    (note,) = coverage_notes(circles, SHAPE)
    assert "All 25 presses lie in the bottom right" in note
    assert "top left (" in note
    assert one_part([(x, y / 3, r) for x, y, r in lattice(4, 5)], SHAPE) == "top"
    assert one_part([(x / 3, y, r) for x, y, r in lattice(4, 5)], SHAPE) == "left"
    assert one_part([(x, y / 4 + 90, r) for x, y, r in lattice(4, 5)], SHAPE) == "middle row"
    assert one_part(lattice(4, 5), SHAPE) is None


def test_presses_that_reach_over_the_image_are_in_no_part():
    """Twelve presses in three rows of four, whose contacts span three quarters of the height."""
    for radius in (10.0, 16.0, 28.0, 40.0):
        circles = [(x, y, radius) for x in (45, 120, 200, 275) for y in (57, 120, 182)]
        assert one_part(circles, SHAPE) is None
        (note,) = coverage_notes(circles, SHAPE)
        assert note.startswith("Take 8 more presses")
        assert note.endswith("Presses that fit so far: 12; 20 are advised.")
        assert "advised" not in str(coverage_notes(circles, SHAPE, started=True)), "5 are then"


@given(
    x=arrays(float, 6, elements=st.floats(0, SHAPE[1])),
    y=arrays(float, 6, elements=st.floats(0, SHAPE[0])),
    radius=st.floats(4, 60),
)
def test_all_presses_lie_in_the_part_that_is_named(x, y, radius):
    part = one_part([(*place, radius) for place in zip(x, y)], SHAPE)
    across, down = x / SHAPE[1], y / SHAPE[0]
    for name, share in (("left", 1 - across), ("right", across), ("top", 1 - down), ("bottom", down)):
        assert part is None or name not in part or (share >= 0.5).all()
    if part in ("middle", "middle row"):
        assert (abs(down - 0.5) <= 1 / 6 + 1e-9).all()
    if part in ("middle", "middle column"):
        assert (abs(across - 0.5) <= 1 / 6 + 1e-9).all()


def test_a_note_never_lists_nothing():
    """Large contacts in a part may show all directions of all tiles: then no place is named."""
    for circle in ((160.0, 120.0, 75.0), (160.0, 120.0, 5.0)):
        for count in (4, 30):
            said = " ".join(coverage_notes([circle] * count, SHAPE))
            assert not re.search(r" at [. ]", said)
            assert ("(x, y in px" in said) == (" at " in said)


def test_too_few_presses_are_counted_and_placed():
    circles = lattice(3, 4)
    del circles[4]
    (note,) = coverage_notes(circles, SHAPE)
    assert "Take 9 more presses, first at left (" in note
    assert coverage_notes(lattice(4, 5), SHAPE) == ()
    assert "Take 20 more presses" in coverage_notes([], SHAPE)[0]
    assert len({*press_next(coverage_from_circles([], SHAPE))}) == 5


def test_many_small_presses_that_leave_most_uncovered():
    circles = [(x, y, 12.0) for x, y, _ in [*lattice(2, 2), *lattice(2, 2), *lattice(3, 4)[::3]] * 2]
    (note,) = coverage_notes(circles, SHAPE)
    assert "% of the places and slope directions" in note


def test_tiles_are_about_square_and_counted_along_rows_and_directions_clockwise():
    shapes = (240, 320), (320, 240), (100, 1000)
    assert [square_tiles(shape) for shape in shapes] == [(6, 8), (8, 6), (2, 8)]
    assert tile_of([0, 79, 0, 79], [0, 0, 59, 59], (60, 80), (3, 4)).tolist() == [0, 3, 8, 11]
    slopes = np.array([(1, 0), (1, 1), (0, 1), (-1, 0), (0, -1)], dtype=float)
    assert direction_of(slopes).tolist() == [0, 1, 2, 4, 6]


def everywhere(step):
    return [(float(x), float(y), 20.0) for x in range(4, 160, step) for y in range(4, 120, step)]


@pytest.mark.parametrize("gap", [(130, 30), (30, 90)])
@pytest.mark.parametrize("errors", [None, np.ones((6, 8, DIRECTIONS))])
def test_the_next_press_is_in_the_gap(gap, errors):
    circles = [c for c in everywhere(10) if np.hypot(c[0] - gap[0], c[1] - gap[1]) > 35]
    coverage = coverage_from_circles(circles, (120, 160), tiles=(6, 8))
    first = press_next(coverage, 3, errors)[0]
    assert np.hypot(first.x_px - gap[0], first.y_px - gap[1]) < 25


def test_where_errors_are_large_another_press_is_worth_more():
    coverage = coverage_from_circles(everywhere(10), (120, 160), tiles=(6, 8))
    errors = np.ones((6, 8, DIRECTIONS))
    errors[4, 6] = 400  # about (130, 90)
    (first,) = press_next(coverage, 1, errors)
    assert np.hypot(first.x_px - 130, first.y_px - 90) < 30


def test_the_stated_coverage_counts_what_the_gel_follows():
    """A circle as wide as its ball is not followed to its rim: it shows no more than the same press by a larger ball."""
    wide = press_coverage([(80.0, 60.0, 40.0)], [40.0], (120, 160))
    narrow = press_coverage([(80.0, 60.0, 30.0)], [400.0], (120, 160))
    np.testing.assert_array_equal(wide.counts, narrow.counts)
    assert wide.counts.shape == (6, 8, DIRECTIONS)
    assert wide.fraction < press_coverage([(80.0, 60.0, 40.0)], [400.0], (120, 160)).fraction


def test_wide_contacts_in_the_middle_are_not_in_one_part():
    """They extend over more than 0.65 of either side."""
    centers = [(x, y) for x in (60, 80, 100) for y in (45, 75)]
    small, wide = ([(x, y, radius) for x, y in centers] for radius in (10, 36))
    assert one_part(small, (120, 160)) == "middle"
    assert one_part(wide, (120, 160)) is None

"""Blocks cover everything once, in order, and none is larger than it may be."""

from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.color_models._shared.blocks import BLOCK_PX, blocks_of


@settings(deadline=None)
@given(st.integers(0, 50_000), st.integers(1, 20_000))
def test_they_cover_all_rows_once(count, each_px):
    blocks = list(blocks_of(count, each_px))
    assert [row for block in blocks for row in range(block.start, block.stop)] == list(range(count))
    assert all(each_px * (b.stop - b.start) <= max(BLOCK_PX, each_px) for b in blocks)

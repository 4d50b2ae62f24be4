"""Frames taken a block of pixels at a time, so that what is worked on stays in the processor's cache."""

from __future__ import annotations

from collections.abc import Iterator

BLOCK_PX = 8192


def blocks_of(count: int, each_px: int = 1) -> Iterator[slice]:
    """Slices of `count` rows of `each_px` pixels, some 8000 pixels each.

    >>> list(blocks_of(5, each_px=4096))
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    """
    rows = max(1, BLOCK_PX // each_px)
    for start in range(0, count, rows):
        yield slice(start, min(start + rows, count))

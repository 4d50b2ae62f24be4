"""Blocks of one colour and rows that come twice."""

import numpy as np

from gelform.health.torn import Torn, torn_finding
from made.worn_frames import blocks_of, gel, pressed, with_part


def torn_of(background):
    return Torn(background.astype(np.float32), blocks_of(background))


def test_flat_blocks_with_the_rest_images_colour_are_sound():
    rest = gel()
    flat = with_part(
        rest, (slice(0, 48), slice(0, 48)), rest[:48, :48].mean(axis=(0, 1)).round().astype(np.uint8)
    )
    found = torn_of(rest).flat(blocks_of(flat))
    whole = torn_of(rest).flat(blocks_of(with_part(rest, (slice(0, 48), slice(0, 48)), 20)))
    assert found is None or np.count_nonzero(found) < 9
    assert np.count_nonzero(whole) == 9


def test_flat_blocks_of_many_colours_are_a_picture():
    frame = gel()
    rng = np.random.default_rng(3)
    for row in range(0, 96, 16):
        for column in range(0, 128, 16):
            frame[row : row + 16, column : column + 16] = rng.integers(0, 256, 3)
    found = torn_of(gel()).flat(blocks_of(frame))
    assert found is None or found.mean() < 0.1


def test_neighbouring_rows_that_are_alike_are_what_video_does():
    frame = pressed()
    frame[1::2] = frame[::2]
    assert torn_of(gel()).repeated_rows(blocks_of(frame), frame) is None


def test_the_finding_says_how_much():
    lost = np.zeros((10, 10), dtype=bool)
    lost[:4] = True
    finding = torn_finding(lost)
    assert (finding.name, finding.figure) == ("torn", 0.4)
    assert "40 % of the frame is torn" in finding.message

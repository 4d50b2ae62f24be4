"""Blocks and digests of a frame."""

import numpy as np
import pytest

from gelform.health import blocks
from gelform.health.blocks import Levels, Torn, torn_finding
from kernel_agreement import assert_kernel_agrees
from made.worn_frames import blocks_of, constant, gel, pressed, with_part

PRIME = np.uint64(0x9E3779B97F4A7C15)


def reference(image, rest, means, ranges, digests, jumps):
    h, w = means.shape[:2]
    seen = image[: 16 * h, : 16 * w].reshape(h, 16, w, 16, 3)[:, ::4].astype(int)
    means = (seen.sum(axis=(1, 3)) + 32) // 64
    ranges = np.ptp(seen, axis=(1, 3)).max(axis=-1)
    differs = (image.astype(int) - rest).reshape(len(image), -1)
    jumps = np.concatenate(
        [[0], np.minimum(np.abs(np.diff(differs, axis=0)), 16)[:, compared(differs.shape[1])].mean(axis=1)]
    )
    return means, ranges, np.array([digest(row.tobytes()) for row in image]), jumps


def compared(width):
    """Every third piece of 64 bytes; of a row that has no whole one, all."""
    if width < 64:
        return np.arange(width)
    return np.concatenate([np.arange(at, at + 64) for at in range(0, width - 63, 192)])


def digest(row):
    step = max(len(row) // 16, 8)
    even, odd = np.uint64(1), np.uint64(2)
    with np.errstate(over="ignore"):
        for count, at in enumerate(range(0, len(row), step)):
            word = np.uint64(int.from_bytes(row[at : at + 8], "little"))
            if count % 2:
                odd = (odd ^ word) * PRIME
            else:
                even = (even ^ word) * PRIME
        return (even + np.uint64(3) * odd).astype(np.int64)


@pytest.mark.parametrize("shape", [(240, 320), (35, 50), (16, 16), (20, 18)])
def test_the_kernel_agrees_with_numpy(shape):
    image = np.random.default_rng(1).integers(0, 256, (*shape, 3), dtype=np.uint8)
    rest = np.random.default_rng(2).integers(0, 256, image.shape, dtype=np.uint8)
    out = blocks_of(image, rest)
    assert_kernel_agrees(
        blocks._blocks, reference, image, rest, out.means, out.ranges, out.row_digests, out.row_jumps
    )


def test_jumps_are_those_of_the_difference_to_the_rest_image():
    rest = np.random.default_rng(8).integers(0, 200, (32, 64, 3), dtype=np.uint8)
    brighter = rest + 20
    assert blocks_of(brighter, rest).row_jumps.max() == 0
    brighter[12:] += 7
    np.testing.assert_allclose(blocks_of(brighter, rest).row_jumps, 7.0 * (np.arange(32) == 12))


def test_only_rows_alike_have_one_digest():
    image = np.random.default_rng(3).integers(0, 256, (64, 40, 3), dtype=np.uint8)
    image[40] = image[7]
    digests = blocks_of(image).row_digests
    assert digests[40] == digests[7]
    assert len(np.unique(digests)) == 63


def test_floats_are_rounded_as_a_camera_would():
    image = np.random.default_rng(4).uniform(0, 255, (32, 32, 3)).astype(np.float32)
    rounded = np.rint(image).astype(np.uint8)
    np.testing.assert_array_equal(blocks_of(image).means, blocks_of(rounded).means)


def test_pixels_of_blocks_reach_the_border():
    found = blocks_of(np.zeros((40, 60, 3), dtype=np.uint8))
    mask = found.pixels(np.array([[False, False, False], [False, False, True]]), 60)
    assert mask.shape == (40, 60)
    assert mask[16:, 32:].all()
    assert np.count_nonzero(mask) == 24 * 28


def test_an_image_smaller_than_a_block_has_none():
    found = blocks_of(np.zeros((5, 7, 3), dtype=np.uint8))
    assert found.means.shape == (0, 0, 3)
    assert not found.pixels(np.zeros((0, 0), dtype=bool), 7).any()


def test_a_rest_image_that_is_dark_itself_says_nothing_of_darkness():
    dim = np.minimum(gel(), 12)
    assert Levels(blocks_of(dim))(blocks_of(constant(0))) == ((), None)


def test_a_rest_image_that_is_saturated_itself_says_nothing_of_saturation():
    assert Levels(blocks_of(constant(250)))(blocks_of(constant(255))) == ((), None)


@pytest.mark.parametrize(("level", "found"), [(7, ["dark"]), (9, []), (251, []), (253, ["saturated"])])
def test_the_levels_that_count(level, found):
    findings, blocks = Levels(blocks_of(gel()))(blocks_of(constant(level)))
    assert [finding.name for finding in findings] == found
    assert (blocks is not None) == bool(found)


def test_what_is_counted_elsewhere_is_left_out():
    levels = Levels(blocks_of(gel()))
    black = blocks_of(constant(0))
    torn = np.ones(black.means.shape[:2], dtype=bool)
    torn[:3] = False
    findings, blocks = levels(black, torn)
    assert findings[0].figure == pytest.approx(0.5)
    assert not blocks[3:].any()


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

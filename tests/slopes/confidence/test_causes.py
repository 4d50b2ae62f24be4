"""The table of causes: each is said in words, and everything that lists them lists them all."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform.cli.commands.inspection import explain
from gelform.slopes.confidence import causes
from gelform.slopes.confidence.causes import CAUSES, outside_of_gel
from kernel_agreement import assert_kernel_agrees

PAGE = Path(__file__).resolve().parents[3] / "docs" / "confidence.md"


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_is_said_in_a_sentence_and_not_of_less_than_a_press_shows_itself(name):
    """After "5 % of the frame is ": no capital, and an end. Those without a sentence are no fault of pixels."""
    assert re.fullmatch(
        r"[a-z].*[.?]" if name not in ("wall", "light", "unit") else "", CAUSES[name].sentence
    )
    assert name == "compression" or CAUSES[name].named_from > 0.3
    assert [cause.color for cause in CAUSES.values()].count(CAUSES[name].color) == 1


def test_page_and_command_list_them_all_in_their_order():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert rows == list(CAUSES)
    listed = re.search(r"each cause: (.*?)\. With", " ".join(explain.__doc__.split()))[1].split(", ")
    assert sorted(listed) == sorted(CAUSES)


SHAPE = (40, 72)


def patch(box=np.s_[10:20, 30:44]):
    """A mask (H, W), True in the box."""
    mask = np.zeros(SHAPE, dtype=bool)
    mask[box] = True
    return mask


def test_an_unlit_corner_and_not_a_speck():
    background = np.full((*SHAPE, 3), 60, np.float32)
    corner = patch(np.s_[:12, :9])
    background[corner] = 5
    background[30:33, 30:33] = 2
    assert np.array_equal(outside_of_gel(background), corner)


def test_unlit_is_up_to_8_levels_of_every_channel_over_25_pixels():
    background = np.full((*SHAPE, 3), 9, np.float32)
    background[5:10, 5:10] = 8
    assert np.array_equal(outside_of_gel(background), patch(np.s_[5:10, 5:10]))
    background[5, 5, 2] = 9
    assert outside_of_gel(background) is None


def noisy(levels, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:120, :170]
    scene = 110 + 40 * np.sin(x / 30)[..., None] + 30 * np.cos(y / 25)[..., None] * np.array([1, 0.5, -1])
    rest = np.clip(scene, 0, 255).astype(np.uint8)
    image = np.clip(scene + rng.normal(0, levels, scene.shape), 0, 255).astype(np.uint8)
    return image, rest


@pytest.mark.parametrize(
    ("levels", "usual", "added"),
    [
        (3.0, 1.0, np.sqrt(3.0**2 - 1.5**2)),
        (6.0, 1.0, np.sqrt(6.0**2 - 1.5**2)),
        (1.5, 1.5, 0),
        (9.0, np.inf, 0),
    ],
)
def test_the_noise_of_single_pixels_beyond_the_usual(levels, usual, added):
    image, rest = noisy(levels)
    assert causes.excess_noise(image, rest, usual_levels=usual) == pytest.approx(added, rel=0.1)
    narrow = image[:, :20].copy(), rest[:, :20].copy()
    assert causes.excess_noise(*narrow, 1.0) == 0, "too narrow for blocks"


@pytest.mark.parametrize("cut", [0, 3, 6])
def test_blocks_of_a_jpeg_wherever_it_is_cut(cut):
    image, rest = noisy(3.0)

    def added(quality):
        _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        cuts = (one[:, cut:].copy() for one in (cv2.imdecode(coded, cv2.IMREAD_COLOR), rest))
        return causes.excess_noise(*cuts, 3.0)

    assert added(10) > 1
    assert added(95) == 0


def test_blocks_that_are_rounded_apart_add_their_deviation():
    """Each block of 8 pixels is off by 2 levels RMS; the noise in it is the usual 1.5."""
    _, rest = noisy(0.0)
    rng = np.random.default_rng(3)
    off = np.kron(rng.normal(0, 2, (15, 22, 3)), np.ones((8, 8, 1)))[:120, :170]
    image = np.clip(np.rint(rest + off + rng.normal(0, 1.5, rest.shape)), 0, 255).astype(np.uint8)
    assert causes.excess_noise(image, rest, 1.5) == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize("width", [9, 21, 50])
def test_jumps_agree_with_numpy(width):
    rng = np.random.default_rng(1)
    image, rest = rng.integers(0, 256, (2, 9, width, 3), dtype=np.uint8)

    def by_numpy(image, rest, work, medians, step):
        apart = image[::step].astype(int) - rest[::step]
        jumps = np.abs(np.diff(apart, axis=1)).mean(axis=(0, 2))
        return np.median(jumps[: (width - 1) // 8 * 8].reshape(-1, 8), axis=0)

    work, medians = np.empty(4 * width, np.int32), np.empty(8, np.float32)
    assert_kernel_agrees(causes._column_jumps, by_numpy, image, rest, work, medians, 4)

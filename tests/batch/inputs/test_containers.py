"""What a dataset holds for a frame becomes an RGB image, or is refused with what to do."""

import cv2
import numpy as np
import pytest

from gelform.batch.inputs.containers import blocks, image_from_values, is_frames, matching
from gelform.errors import DataError

IMAGE = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
THERE = {
    "data/demo_0/obs/gelsight": ((9, 6, 8, 3), "uint8"),
    "data/demo_1/obs/gelsight": ((7, 6, 8, 3), "uint8"),
    "data/demo_0/obs/wrist": ((9, 6, 8, 3), "uint8"),
}


def test_kinds_of_frames():
    png = cv2.imencode(".png", IMAGE[..., ::-1])[1].reshape(-1)
    for values in (IMAGE, IMAGE.astype(np.float32), np.concatenate([png, np.zeros(9, np.uint8)])):
        np.testing.assert_array_equal(image_from_values(values), IMAGE)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (IMAGE / 255, "Expected whole numbers from 0 to 255"),
        (IMAGE.astype(np.float32) * 2, "Expected whole numbers from 0 to 255"),
        (np.full((6, 8, 3), np.nan), "Expected whole numbers"),
        (np.moveaxis(IMAGE, 2, 0), "Move the channels last"),
        (np.zeros(0, np.uint8), "bytes that are no image"),
        (np.arange(90, dtype=np.uint8), "bytes that are no image"),
        (DataError("chunk 3 is damaged"), "chunk 3 is damaged"),
    ],
)
def test_refused(values, said):
    with pytest.raises(DataError, match=said):
        image_from_values(values)


def test_a_star_stands_for_one_name(tmp_path):
    assert matching(tmp_path, THERE, "data/*/obs/gelsight") == list(THERE)[:2]
    assert matching(tmp_path, THERE, "/data/demo_1/obs/gelsight") == ["data/demo_1/obs/gelsight"]


def test_what_is_there_is_listed(tmp_path):
    said = r"data/demo_\*/obs/gelsight \(2 of uint8 9x6x8x3\), data/demo_0/obs/wrist \(one of uint8"
    for wanted in ("data/*", "obs/gelsight", ""):
        with pytest.raises(DataError, match=said):
            matching(tmp_path, THERE, wanted)
    with pytest.raises(DataError, match="there is no dataset of frames"):
        matching(tmp_path, {}, "a")


class Damaged:
    """Seven frames in chunks of three; the fifth cannot be decoded."""

    shape, dtype, name = (7, 2, 2, 3), np.dtype(np.uint8), "d"

    def __getitem__(self, key):
        wanted = np.arange(7)[key]
        if 4 in np.atleast_1d(wanted):
            raise OSError("checksum")
        return np.multiply.outer(wanted, np.ones((2, 2, 3), np.uint8))


def test_one_frame_that_cannot_be_read_is_one():
    found = list(blocks(Damaged(), 1, 6, 3))
    assert [one if isinstance(one, DataError) else one[0, 0, 0] for one in found[:3]] == [1, 2, 3]
    assert "frame 4 of d: checksum" in str(found[3])
    assert [one[0, 0, 0] for one in found[4:]] == [5, 6]


@pytest.mark.parametrize(
    ("shape", "dtype", "yes"),
    [((9, 6, 8, 3), "u1", True), ((9, 6, 8, 3), "f4", True), ((9, 700), "u1", True), ((9,), "O", True),
     ((9, 6, 8, 1), "u1", False), ((9, 7), "f4", False), ((9,), "f8", False)],
)  # fmt: skip
def test_what_may_be_frames(shape, dtype, yes):
    assert is_frames(shape, np.dtype(dtype)) == yes

"""LeRobot's version 3.0: episodes one after the other in one mp4, found by their times."""

import json

import numpy as np
import pytest

from gelform.batch import run_batch
from gelform.batch.inputs.lerobot_set import (
    compression_of,
    is_lerobot_set,
    lerobot_info,
    lerobot_sequences,
    video_frames,
)
from gelform.batch.inputs.listing import listing_of
from gelform.errors import DataError

KEY, FPS = "observation.images.gel", 30


@pytest.fixture
def recorded(lerobot):
    return lerobot


def changed(root, **more):
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps({**info, **more}))


def test_episodes_are_sequences(recorded):
    root, _ = recorded
    assert is_lerobot_set(root)
    found = lerobot_sequences(root, KEY)
    assert [(one.name, one.offset, one.count) for one in found] == [
        (f"{KEY}/episode_000000", 0, 3),
        (f"{KEY}/episode_000001", 3, 4),
        (f"{KEY}/episode_000002", 7, 2),
    ]


@pytest.mark.parametrize("start", range(4))
def test_the_frames_of_an_episode_from_anywhere_in_it(recorded, start):
    root, frames = recorded
    (path,) = root.rglob("*.mp4")
    found = list(video_frames(path, 3, start, 4 - start))
    assert [time for time, _ in found] == pytest.approx([k / FPS for k in range(start, 4)], abs=1e-4)
    for k, (_, image) in enumerate(found, 3 + start):
        np.testing.assert_array_equal(image, frames[k])


def test_a_batch_of_it(recorded, cal, tmp_path):
    root, _ = recorded
    summary = run_batch(root, cal, tmp_path / "out", dataset=KEY, table="csv")
    assert (summary.complete, summary.frames, summary.errors) == (True, 9, 0)
    assert (tmp_path / f"out/frames/{KEY}/episode_000001/000003.npz").exists()


def test_a_video_that_is_cut_off_ends_with_a_reason(recorded, cal, tmp_path, encode):
    root, frames = recorded
    (path,) = root.rglob("*.mp4")
    encode(path, frames[:5])
    summary = run_batch(root, cal, tmp_path / "out", dataset=KEY, table="csv")
    assert (summary.frames, summary.errors) == (9, 4)
    assert "got 5. It is cut off" in (tmp_path / "out/frames.csv").read_text()


def test_compression_in_words(recorded):
    root, _ = recorded
    assert compression_of(root, KEY) == ""
    assert listing_of(root, dataset=KEY).warnings == ()
    told = {"video.codec": "av1", "video.pix_fmt": "yuv420p", "video.crf": 30}
    changed(root, features={KEY: {"dtype": "video", "shape": [64, 80, 3], "info": told}})
    assert compression_of(root, KEY) == "av1 yuv420p crf 30"
    (warning,) = listing_of(root, dataset=KEY).warnings
    assert "av1 yuv420p crf 30, with loss" in warning
    assert "27 um" in warning


def test_what_cannot_be_is_said(recorded):
    root, _ = recorded
    with pytest.raises(
        DataError, match=rf"there are {KEY} \(one of video 64x80x3\), .*still \(one of image 64x80x3\)"
    ):
        listing_of(root, dataset="observation.images.wrist")
    changed(root, codebase_version="v2.1")
    with pytest.raises(DataError, match=r"version v3.0, got v2.1 .* convert_dataset_v21_to_v30"):
        listing_of(root, dataset=KEY)
    (root / "meta/info.json").write_text("{")
    with pytest.raises(DataError, match="cannot be read as LeRobot's"):
        lerobot_info(root)

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

av = pytest.importorskip("av", reason="the extra lerobot is not installed")
pyarrow = pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
KEY, FPS = "observation.images.gel", 30
LENGTHS = (3, 4)


def encoded(path, frames, codec="libx264rgb", pixels="rgb24", **options):
    path.parent.mkdir(parents=True)
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=FPS, options=options or {"crf": "0", "g": "4"})
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        for frame in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(stream.encode())


@pytest.fixture
def recorded(tmp_path, images):
    """Two episodes of touches in one file; gives the folder and the frames."""
    root, frames = tmp_path / "set", [images[k % len(images)] for k in range(sum(LENGTHS))]
    encoded(root / f"videos/{KEY}/chunk-000/file-000.mp4", frames)
    told = {"video.codec": "h264", "video.pix_fmt": "gbrp", "video.crf": 0, "video.fps": FPS}
    feature = {"dtype": "video", "shape": [64, 80, 3], "info": told}
    path = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    info = {"codebase_version": "v3.0", "fps": FPS, "features": {KEY: feature}, "video_path": path}
    (root / "meta/episodes/chunk-000").mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps(info))
    rows, begin = [], 0
    for k, length in enumerate(LENGTHS):
        where = {f"videos/{KEY}/chunk_index": 0, f"videos/{KEY}/file_index": 0}
        times = {f"videos/{KEY}/from_timestamp": begin / FPS, f"videos/{KEY}/to_timestamp": 0.0}
        rows.append({"episode_index": k, "length": length, **where, **times})
        begin += length
    pyarrow.parquet.write_table(
        pyarrow.Table.from_pylist(rows[::-1]), root / "meta/episodes/chunk-000/file-000.parquet"
    )
    return root, frames


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
    assert (summary.complete, summary.frames, summary.errors) == (True, 7, 0)
    assert (tmp_path / f"out/frames/{KEY}/episode_000001/000003.npz").exists()


def test_a_video_that_is_cut_off_ends_with_a_reason(recorded, cal, tmp_path):
    root, frames = recorded
    (path,) = root.rglob("*.mp4")
    path.unlink()
    path.parent.rmdir()
    encoded(path, frames[:5])
    summary = run_batch(root, cal, tmp_path / "out", dataset=KEY, table="csv")
    assert (summary.frames, summary.errors) == (7, 2)
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
    assert "23 um" in warning


def test_what_cannot_be_is_said(recorded):
    root, _ = recorded
    with pytest.raises(DataError, match=rf"there are {KEY} \(one of video 64x80x3\)"):
        listing_of(root, dataset="observation.images.wrist")
    changed(root, codebase_version="v2.1")
    with pytest.raises(DataError, match=r"version v3.0, got v2.1 .* convert_dataset_v21_to_v30"):
        listing_of(root, dataset=KEY)
    (root / "meta/info.json").write_text("{")
    with pytest.raises(DataError, match="cannot be read as LeRobot's"):
        lerobot_info(root)

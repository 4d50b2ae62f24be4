"""LeRobot's version 3.0: consecutive episodes in one mp4, found by their times, or as images in tables."""

import json

import numpy as np
import pytest

from gelform.batch import run_batch
from gelform.batch.containers import (
    films_in_lerobot_set,
    is_lerobot_set,
    lerobot_info,
    stored_images,
    video_frames,
)
from gelform.batch.inputs import listing_of
from gelform.errors import DataError
from gelform.sensors.pictures import image_from_values
from made.files import encoded

pyarrow = pytest.importorskip("pyarrow", reason="the extra data is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="the extra data is not installed")

KEY, STORED, FPS = "observation.images.gel", "observation.images.still", 30


def changed(root, **more):
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps({**info, **more}))


def test_episodes_are_sequences_of_a_video_and_of_tables(lerobot):
    root, _ = lerobot
    assert is_lerobot_set(root)
    found = [(one.name, one.offset, one.count) for one in films_in_lerobot_set(root, KEY)]
    assert found == [(f"{KEY}/episode_{k:06d}", *place) for k, place in enumerate(((0, 3), (3, 4), (7, 2)))]
    listed = listing_of(root, dataset=STORED)
    found = [(one.path.name, one.offset, one.count) for one in listed.sequences]
    assert found == [("file-000.parquet", 0, 3), ("file-000.parquet", 3, 4), ("file-001.parquet", 0, 2)]
    assert listed.warnings == ()  # PNG


def test_the_frames_of_an_episode_from_anywhere_in_it(lerobot):
    """Rows are in groups of two, which the episode's ends cut."""
    root, frames = lerobot
    (path,) = root.rglob("*.mp4")
    for start, count in ((0, 4), (1, 2), (2, 2), (3, 1)):
        times = pytest.approx([k / FPS for k in range(start, start + count)], abs=1e-4)
        of_video = list(video_frames(path, 3, start, count))
        of_table = list(stored_images(table(root), STORED, 3, start, count))
        assert [time for time, _ in of_video] == times
        assert [time for time, _ in of_table] == times
        for k in range(count):
            np.testing.assert_array_equal(of_video[k][1], frames[3 + start + k])
            np.testing.assert_array_equal(image_from_values(of_table[k][1]), frames[3 + start + k])


@pytest.mark.parametrize(
    "pattern",
    [
        "../{video_key}.mp4",
        "/etc/{file_index}",
        "{video_key.__class__}",
        "{file_index:999999999d}",
        "{other}",
        None,
        "{",
    ],
)
def test_a_pattern_names_files_below_the_set_alone(lerobot, pattern):
    """Anyone may have written the set."""
    root, _ = lerobot
    changed(root, video_path=pattern, data_path=pattern)
    for key in (KEY, STORED):
        with pytest.raises(DataError, match="to name files below the data set"):
            films_in_lerobot_set(root, key)


def test_a_video_that_is_cut_off_ends_with_a_reason(lerobot, cal, tmp_path):
    root, frames = lerobot
    (path,) = root.rglob("*.mp4")
    encoded(path, frames[:5])
    summary = run_batch(root, cal, tmp_path / "out", dataset=KEY, table="csv")
    assert (summary.frames, summary.errors) == (9, 4)
    assert "got 5. It is cut off" in (tmp_path / "out/frames.csv").read_text()


def test_compression_in_words(lerobot):
    root, _ = lerobot
    assert listing_of(root, dataset=KEY).warnings == ()
    told = {"video.codec": "av1", "video.pix_fmt": "yuv420p", "video.crf": 30}
    changed(root, features={KEY: {"dtype": "video", "shape": [64, 80, 3], "info": told}})
    (warning,) = listing_of(root, dataset=KEY).warnings
    assert "av1 yuv420p crf 30, with loss" in warning
    assert "27 um" in warning


def test_what_cannot_be_is_said(lerobot):
    root, _ = lerobot
    there = rf"there are {KEY} \(one of video 64x80x3\), .*still \(one of image 64x80x3\)"
    with pytest.raises(DataError, match=there):
        listing_of(root, dataset="observation.images.wrist")
    changed(root, codebase_version="v2.1")
    with pytest.raises(DataError, match=r"version v3.0, got v2.1 .* convert_dataset_v21_to_v30"):
        listing_of(root, dataset=KEY)
    (root / "meta/info.json").write_text("{")
    with pytest.raises(DataError, match="cannot be read as LeRobot's"):
        lerobot_info(root)


def table(root, number=0):
    return root / f"data/chunk-000/file-{number:03d}.parquet"


def test_an_image_that_is_damaged_or_absent_is_a_row_with_its_error(lerobot, cal, tmp_path):
    root, _ = lerobot
    rows = parquet.read_table(table(root)).to_pylist()
    rows[1][STORED]["bytes"] = rows[1][STORED]["bytes"][:40]
    rows[4][STORED]["bytes"] = None
    parquet.write_table(pyarrow.Table.from_pylist(rows), table(root))
    done = run_batch(root, cal, tmp_path / "out", dataset=STORED, table="csv")
    assert (done.frames, done.errors) == (9, 2)
    said = (tmp_path / "out/frames.csv").read_text()
    assert "bytes that are no image" in said
    assert "has no bytes of an image" in said


def test_tables_that_do_not_agree(lerobot, cal, tmp_path):
    root, _ = lerobot
    with pytest.raises(DataError, match=r"Expected frame 0 .* in row 1 .* got frame 1"):
        list(stored_images(table(root), STORED, 1, 0, 2))
    with pytest.raises(DataError, match=r"Expected 8 rows .* got 7"):
        list(stored_images(table(root), STORED, 3, 1, 4))
    with pytest.raises(DataError, match=r"Expected 12 rows .* got 10"):
        list(stored_images(table(root), STORED, 10, 0, 2))
    table(root).write_bytes(table(root).read_bytes()[:500])
    with pytest.raises(DataError, match="Cannot read"):
        list(stored_images(table(root), STORED, 0, 0, 1))
    done = run_batch(root, cal, tmp_path / "out", dataset=STORED, table="csv")
    assert (done.frames, done.errors) == (9, 7)

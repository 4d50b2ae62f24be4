"""Images in the tables of a LeRobot data set: an episode's from anywhere in it, and what does not agree."""

import numpy as np
import pytest

from gelform.batch import run_batch
from gelform.batch.inputs.containers import image_from_values
from gelform.batch.inputs.lerobot_images import stored_images
from gelform.batch.inputs.listing import listing_of
from gelform.errors import DataError

KEY, VIDEO = "observation.images.still", "observation.images.gel"


def table(root, number=0):
    return root / f"data/chunk-000/file-{number:03d}.parquet"


def test_episodes_are_sequences(lerobot):
    root, _ = lerobot
    found = listing_of(root, dataset=KEY)
    assert [(one.path.name, one.offset, one.count) for one in found.sequences] == [
        ("file-000.parquet", 0, 3),
        ("file-000.parquet", 3, 4),
        ("file-001.parquet", 0, 2),
    ]
    assert found.warnings == ()  # PNG


@pytest.mark.parametrize(("start", "count"), [(0, 4), (1, 2), (3, 1)])
def test_the_images_of_an_episode_from_anywhere_in_it(lerobot, start, count):
    """Rows are in groups of two, which the episode's ends cut."""
    root, frames = lerobot
    found = list(stored_images(table(root), KEY, 3, start, count))
    assert [seconds for seconds, _ in found] == pytest.approx([k / 30 for k in range(start, start + count)])
    for k, (_, content) in enumerate(found, 3 + start):
        np.testing.assert_array_equal(image_from_values(content), frames[k])


def test_a_batch_is_that_of_the_video(lerobot, cal, tmp_path):
    root, _ = lerobot
    for name, key in (("a", KEY), ("b", VIDEO)):
        done = run_batch(root, cal, tmp_path / name, dataset=key, table="csv")
        assert (done.complete, done.frames, done.errors) == (True, 9, 0)
    for episode, frame in ((0, 0), (1, 3), (2, 1)):
        name = f"episode_{episode:06d}/{frame:06d}.npz"
        first, second = (
            np.load(tmp_path / f"{a}/frames/{key}/{name}") for a, key in (("a", KEY), ("b", VIDEO))
        )
        np.testing.assert_array_equal(first["depth_mm"], second["depth_mm"])


def test_an_image_that_is_damaged_or_absent_is_a_row_with_its_error(lerobot, cal, tmp_path):
    from pyarrow import Table, parquet

    root, _ = lerobot
    rows = parquet.read_table(table(root)).to_pylist()
    rows[1][KEY]["bytes"] = rows[1][KEY]["bytes"][:40]
    rows[4][KEY]["bytes"] = None
    parquet.write_table(Table.from_pylist(rows), table(root))
    done = run_batch(root, cal, tmp_path / "out", dataset=KEY, table="csv")
    assert (done.frames, done.errors) == (9, 2)
    said = (tmp_path / "out/frames.csv").read_text()
    assert "bytes that are no image" in said
    assert "has no bytes of an image" in said


def test_tables_that_do_not_agree(lerobot, cal, tmp_path):
    root, _ = lerobot
    with pytest.raises(DataError, match=r"Expected frame 0 .* in row 1 .* got frame 1"):
        list(stored_images(table(root), KEY, 1, 0, 2))
    with pytest.raises(DataError, match=r"Expected 8 rows .* got 7"):
        list(stored_images(table(root), KEY, 3, 0, 5))
    with pytest.raises(DataError, match=r"Expected 12 rows .* got 10"):
        list(stored_images(table(root), KEY, 10, 0, 2))
    table(root).write_bytes(table(root).read_bytes()[:500])
    with pytest.raises(DataError, match="Cannot read"):
        list(stored_images(table(root), KEY, 0, 0, 1))
    done = run_batch(root, cal, tmp_path / "out", dataset=KEY, table="csv")
    assert (done.frames, done.errors) == (9, 7)

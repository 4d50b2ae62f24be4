"""A diffusion policy's Zarr: episodes end where meta/episode_ends says; every frame's depth is that of its image."""

import shutil

import numpy as np
import pytest

import gelform
from gelform.batch import BatchSettings, run_batch
from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.zarr_datasets import zarr_sequences
from gelform.errors import DataError

zarr = pytest.importorskip("zarr", minversion="3", reason="the extra zarr is not installed")


@pytest.fixture(params=[2, 3])
def replay(tmp_path, images, request):
    path = tmp_path / "in" / "replay.zarr"
    group = zarr.open_group(str(path), mode="w", zarr_format=request.param)
    frames = np.stack([*images, images[0]])
    array = group.create_array("data/gel", shape=frames.shape, chunks=(2, *frames.shape[1:]), dtype="f4")
    array[:] = frames
    ends = group.create_array("meta/episode_ends", shape=(2,), dtype="i8")
    ends[:] = [3, 5]
    return path


def test_episodes_are_sequences(replay):
    found = zarr_sequences(replay, "replay.zarr", "data/gel")
    assert [(one.name, one.offset, one.count) for one in found] == [
        ("replay.zarr/data/gel/000000", 0, 3),
        ("replay.zarr/data/gel/000001", 3, 2),
    ]


def test_the_same_depth_as_by_hand(replay, cal, images, tmp_path):
    settings = BatchSettings("zarr", keep=("depth",), part_frames=2)
    for source, output in ((replay, "a"), (replay.parent, "b")):
        summary = run_batch(source, cal, tmp_path / output, settings, dataset="data/*")
        assert (summary.complete, summary.frames, summary.errors) == (True, 5, 0)
    depth = zarr.open_group(str(tmp_path / "a/frames"))["replay.zarr/data/gel/000001/depth_mm"]
    assert depth.shape[0] == 2
    np.testing.assert_array_equal(depth[0], gelform.Reconstructor(cal).from_image(images[3]).depth_mm)


def test_what_cannot_be_is_said(replay):
    with pytest.raises(DataError, match=r"there are data/gel \(one of float32 5x64x80x3\)"):
        listing_of(replay, dataset="data/img")
    zarr.open_group(str(replay))["meta/episode_ends"][:] = [3, 4]
    with pytest.raises(DataError, match="to end at the 5 frames"):
        listing_of(replay, dataset="data/gel")


def test_a_chunk_that_is_damaged_costs_its_frames_alone(replay, cal, tmp_path):
    names = ("data.gel.1.0.0.0", "data.gel.c.1.0.0.0")  # of Zarr 2 and 3
    paths = {".".join(path.relative_to(replay).parts): path for path in replay.rglob("*")}
    (chunk,) = [paths[name] for name in names if name in paths]
    chunk.write_bytes(chunk.read_bytes()[:50])
    summary = run_batch(replay, cal, tmp_path / "out", dataset="data/gel")
    assert (summary.complete, summary.frames, summary.errors) == (True, 5, 2)


def test_a_folder_that_is_no_group(tmp_path):
    (tmp_path / "a.zarr").mkdir()
    (tmp_path / "a.zarr/.zgroup").write_text("{")
    with pytest.raises(DataError, match="as a Zarr group"):
        listing_of(tmp_path / "a.zarr", dataset="data/gel")
    shutil.rmtree(tmp_path / "a.zarr")

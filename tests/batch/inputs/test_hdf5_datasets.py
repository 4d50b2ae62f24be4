"""robomimic's and ALOHA's HDF5: the depth of every frame is that of the same image in a file of its own."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.batch import BatchSettings, run_batch
from gelform.batch.inputs.hdf5_datasets import hdf5_sequences, hdf5_values
from gelform.batch.inputs.listing import listing_of
from gelform.errors import DataError

h5py = pytest.importorskip("h5py", reason="the extra hdf5 is not installed")


@pytest.fixture
def demos(tmp_path, images):
    """As robomimic writes them: ten demonstrations and one more, with images of 3 and 4 frames."""
    path = tmp_path / "demos.hdf5"
    with h5py.File(path, "w") as file:
        for k in (0, 2, 10):
            file[f"data/demo_{k}/obs/gelsight"] = np.stack(images[: 3 + (k == 10)])
            file[f"data/demo_{k}/actions"] = np.zeros((3, 7))
    return path


def test_demonstrations_are_sequences_in_their_order(demos):
    found = hdf5_sequences(demos, "demos.hdf5", "data/*/obs/gelsight")
    assert [one.name for one in found] == [f"demos.hdf5/data/demo_{k}/obs/gelsight" for k in (0, 2, 10)]
    assert [one.count for one in found] == [3, 3, 4]


def test_the_same_depth_as_by_hand(demos, cal, images, tmp_path):
    settings = BatchSettings(part_frames=3)
    summary = run_batch(demos, cal, tmp_path / "out", settings, dataset="data/*/obs/gelsight")
    assert (summary.complete, summary.frames, summary.errors) == (True, 10, 0)
    with np.load(tmp_path / "out/frames/demos.hdf5/data/demo_10/obs/gelsight/000003.npz") as file:
        truth = gelform.Reconstructor(cal).from_image(images[3]).depth_mm
        np.testing.assert_array_equal(file["depth_mm"], truth)
    assert run_batch(demos, cal, tmp_path / "out", settings, dataset="data/*/obs/gelsight").frames == 0


def test_compressed_images_and_one_that_is_torn(tmp_path, cal, images):
    """As ALOHA compresses them: JPEGs padded with zeros to one length. PNG here, for exact pixels."""
    coded = [cv2.imencode(".png", image[..., ::-1])[1].reshape(-1) for image in images]
    length = max(map(len, coded)) + 5
    padded = np.stack([np.pad(one, (0, length - len(one))) for one in coded])
    padded[1, 60:] = 0
    for k in range(2):
        with h5py.File(tmp_path / f"episode_{k}.hdf5", "w") as file:
            file["observations/images/gel"] = padded
    background = BatchSettings(background_frames=1)
    summary = run_batch(
        tmp_path / "episode_*.hdf5", cal, tmp_path / "out", dataset="observations/images/gel", table="csv"
    )
    assert (summary.complete, summary.frames, summary.errors) == (True, 8, 2)
    assert "no image" in (tmp_path / "out/frames.csv").read_text()
    summary = run_batch(
        tmp_path / "episode_0.hdf5", cal, tmp_path / "b", background, dataset="observations/images/gel"
    )
    assert summary.frames == 4


def test_what_cannot_be_is_said(demos, tmp_path):
    for source in (demos, tmp_path):
        with pytest.raises(DataError, match=r"there are data/demo_\*/obs/gelsight \(3 of uint8 3x64x80x3\)"):
            listing_of(source, dataset="data/*/obs/gelsihgt")
    with pytest.raises(DataError, match="may hold several datasets"):
        listing_of(demos)
    with pytest.raises(DataError, match="say with --dataset which dataset"):
        listing_of(tmp_path)
    with pytest.raises(DataError, match="got none"):
        next(hdf5_values(demos, "data/demo_1/obs/gelsight", 0, 1))
    demos.write_bytes(demos.read_bytes()[:900])
    with pytest.raises(DataError, match="It is damaged, cut off"):
        listing_of(demos, dataset="data/*/obs/gelsight")


def test_among_others_a_damaged_file_is_a_row(demos, cal, tmp_path):
    (tmp_path / "in").mkdir()
    demos.rename(tmp_path / "in/a.hdf5")
    (tmp_path / "in/b.hdf5").write_bytes(b"no HDF5")
    summary = run_batch(tmp_path / "in", cal, tmp_path / "out", dataset="data/*/obs/gelsight", table="csv")
    assert (summary.complete, summary.frames, summary.errors) == (True, 11, 1)
    assert "b.hdf5 as HDF5" in (tmp_path / "out/frames.csv").read_text().splitlines()[-1]

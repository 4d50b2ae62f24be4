"""Frames in HDF5 (robomimic's, ALOHA's) and Zarr (diffusion policies') give the depth of the same images in files.

LeRobot's version 3.0: consecutive episodes in one mp4, found by their times, or as images in tables.
"""

import json

import cv2
import numpy as np
import pytest

import gelform
from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.batch.inputs import listing_of
from gelform.errors import DataError
from gelform.sensors.containers import (
    blocks,
    container_values,
    films_in_container,
    films_in_lerobot_set,
    is_frames,
    is_lerobot_set,
    lerobot_info,
    matching,
    natural,
    stored_images,
    video_frames,
)
from gelform.sensors.pictures import image_from_values
from made.files import as_parquet, encoded

THERE = {
    "data/demo_0/obs/gelsight": ((9, 6, 8, 3), "uint8"),
    "data/demo_1/obs/gelsight": ((7, 6, 8, 3), "uint8"),
    "data/demo_0/obs/wrist": ((9, 6, 8, 3), "uint8"),
}


def test_a_star_stands_for_one_name_and_what_is_there_is_listed(tmp_path):
    assert matching(tmp_path, THERE, "data/*/obs/gelsight") == list(THERE)[:2]
    assert matching(tmp_path, THERE, "/data/demo_1/obs/gelsight") == ["data/demo_1/obs/gelsight"]
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


def test_what_may_be_frames():
    yes = (((9, 6, 8, 3), "u1"), ((9, 3, 6, 8), "f4"), ((9, 6, 8, 3), "f4"), ((9, 700), "u1"), ((9,), "O"))
    no = (((9, 6, 8, 1), "u1"), ((9, 7), "f4"), ((9,), "f8"))
    assert all(is_frames(shape, np.dtype(dtype)) for shape, dtype in yes)
    assert not any(is_frames(shape, np.dtype(dtype)) for shape, dtype in no)


def test_numbers_count():
    for names in (["image2", "image10"], ["a", "a1", "a01b"], ["demo_9/x", "demo_10/x"], ["1", "a"]):
        assert sorted(set(names), key=natural) == names


@pytest.fixture
def demos(h5py, tmp_path, images):
    """As robomimic writes them: ten demonstrations and one more, with images of 3 and 4 frames."""
    path = tmp_path / "demos.hdf5"
    with h5py.File(path, "w") as file:
        for k in (0, 2, 10):
            file[f"data/demo_{k}/obs/gelsight"] = np.stack(images[: 3 + (k == 10)])
            file[f"data/demo_{k}/actions"] = np.zeros((3, 7))
    return path


def test_demonstrations_are_sequences_and_give_the_same_depth_as_by_hand(demos, cal, images, tmp_path):
    found = films_in_container(demos, "demos.hdf5", "data/*/obs/gelsight")
    assert [one.name for one in found] == [f"demos.hdf5/data/demo_{k}/obs/gelsight" for k in (0, 2, 10)]
    assert [one.count for one in found] == [3, 3, 4]
    settings = BatchSettings(part_frames=3)
    summary = run_batch(demos, cal, tmp_path / "out", settings, dataset="data/*/obs/gelsight")
    assert (summary.complete, summary.frames, summary.errors) == (True, 10, 0)
    found = np.load(tmp_path / "out/frames/demos.hdf5/data/demo_10/obs/gelsight/000003.npz")
    truth = gelform.Reconstructor(cal).from_image(images[3]).depth_mm
    np.testing.assert_array_equal(found["depth_mm"], truth)
    assert run_batch(demos, cal, tmp_path / "out", settings, dataset="data/*/obs/gelsight").frames == 0


def test_compressed_images_and_one_that_is_torn(h5py, tmp_path, cal, images):
    """As ALOHA compresses them: JPEGs padded with zeros to one length. PNG here, for exact pixels."""
    coded = [cv2.imencode(".png", image[..., ::-1])[1].reshape(-1) for image in images]
    length = max(map(len, coded)) + 5
    padded = np.stack([np.pad(one, (0, length - len(one))) for one in coded])
    padded[1, 60:] = 0
    for k in range(2):
        with h5py.File(tmp_path / f"episode_{k}.hdf5", "w") as file:
            file["observations/images/gel"] = padded
    gel = "observations/images/gel"
    summary = run_batch(tmp_path / "episode_*.hdf5", cal, tmp_path / "out", dataset=gel, table="csv")
    assert (summary.complete, summary.frames, summary.errors) == (True, 8, 2)
    assert "truncated or damaged" in (tmp_path / "out/frames.csv").read_text()
    background = BatchSettings(background_frames=1)
    assert run_batch(tmp_path / "episode_0.hdf5", cal, tmp_path / "b", background, dataset=gel).frames == 4


@pytest.mark.parametrize("compressed", [False, True])
def test_channels_in_the_order_of_opencv(h5py, tmp_path, cal, images, compressed):
    """Depth of every frame is that of the same frame in RGB; without the option, each is refused by its name."""
    bgr = [np.ascontiguousarray(image[..., ::-1]) for image in images]
    with h5py.File(tmp_path / "bgr.h5", "w") as file:
        if compressed:
            pngs = [cv2.imencode(".png", image[..., ::-1])[1].reshape(-1) for image in bgr]
            file.create_dataset("gel", (len(bgr),), h5py.vlen_dtype(np.uint8))[:] = pngs
        else:
            file["gel"] = np.stack(bgr)
    given = {"dataset": "gel", "table": "csv"}
    settings = BatchSettings(bgr=True)
    summary = run_batch(tmp_path / "bgr.h5", cal, tmp_path / "out", settings, **given)
    assert (summary.frames, summary.errors) == (len(images), 0)
    for k, image in enumerate(images):
        truth = gelform.Reconstructor(cal).from_image(image).depth_mm
        found = np.load(tmp_path / f"out/frames/bgr.h5/gel/{k:06d}.npz")
        np.testing.assert_array_equal(found["depth_mm"], truth)
    assert run_batch(tmp_path / "bgr.h5", cal, tmp_path / "wrong", **given).errors == len(images)
    assert "--bgr" in (tmp_path / "wrong" / "frames.csv").read_text()
    with pytest.raises(DataError, match="bgr"):
        run_batch(tmp_path / "bgr.h5", cal, tmp_path / "out", BatchSettings(), **given)


def test_the_background_of_such_frames_is_in_the_same_order(h5py, tmp_path, cal, images):
    rest = np.rint(cal.background).astype(np.uint8)
    with h5py.File(tmp_path / "bgr.h5", "w") as file:
        file["gel"] = np.stack([image[..., ::-1] for image in (rest, rest, rest, *images)])
    settings = BatchSettings(bgr=True, background_frames=3)
    summary = run_batch(tmp_path / "bgr.h5", cal, tmp_path / "out", settings, dataset="gel", table="csv")
    assert (summary.frames, summary.errors) == (3 + len(images), 0)


def test_hdf5_that_cannot_be_is_said(demos, tmp_path):
    for source in (demos, tmp_path):
        with pytest.raises(DataError, match=r"there are data/demo_\*/obs/gelsight \(3 of uint8 3x64x80x3\)"):
            listing_of(source, dataset="data/*/obs/gelsihgt")
    with pytest.raises(
        DataError, match=r"holds 3 datasets of frames\. Give one with --dataset; there are data"
    ):
        listing_of(demos)
    with pytest.raises(DataError, match="say with --dataset which dataset"):
        listing_of(tmp_path)
    with pytest.raises(DataError, match="got none"):
        next(container_values(demos, "data/demo_1/obs/gelsight", 0, 1))
    demos.write_bytes(demos.read_bytes()[:900])
    with pytest.raises(DataError, match="It is damaged, cut off"):
        listing_of(demos, dataset="data/*/obs/gelsight")


def test_the_only_dataset_of_a_file_needs_no_name(h5py, tmp_path, images):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data/demo_0/obs/gel"] = np.stack(images)
        file["data/demo_0/depth"] = np.zeros((len(images), 4, 4), np.float32)
    (film,) = listing_of(tmp_path / "a.h5").sequences
    assert (film.dataset, film.count) == ("data/demo_0/obs/gel", len(images))
    with pytest.raises(DataError, match="there is no dataset of frames"):
        matching(tmp_path, {}, "")


def test_frames_that_were_never_written_are_refused_before_they_are_counted(h5py, tmp_path):
    with h5py.File(tmp_path / "bomb.h5", "w") as file:
        file.create_dataset("a", (10**9, 240, 320, 3), "u1", chunks=(1, 240, 320, 3), compression="gzip")
        file.create_dataset("b", (10**9, 64, 64, 3), "u1")
        large = (20_000, 20_000, 3)
        file.create_dataset("c", (3, *large), "u1", chunks=(1, *large), compression="gzip")
        file["c"].id.write_direct_chunk((0, 0, 0, 0), bytes(3 * 10**6))
        file.create_virtual_dataset("v", h5py.VirtualLayout((10**9, 8, 8, 3), "u1"))
    for name, said in (
        ("a", "states 1000000000 frames and stores 0 bytes"),
        ("b", "states 1000000000 frames and stores 0 bytes"),
        ("c", r"chunks of 1\.2 GB"),
        ("v", r"states 1000000000 frames of bomb\.h5/v; at most 1e\+07"),
    ):
        with pytest.raises(DataError, match=said):
            listing_of(tmp_path / "bomb.h5", dataset=name)


def test_zarr_frames_that_were_never_written_are_refused(zarr, tmp_path):
    group = zarr.open_group(str(tmp_path / "bomb.zarr"), mode="w")
    group.create_array("a", shape=(10**9, 240, 320, 3), chunks=(1, 240, 320, 3), dtype="u1")
    with pytest.raises(DataError, match="states 1000000000 frames"):
        listing_of(tmp_path / "bomb.zarr", dataset="a")


def test_among_others_a_damaged_file_is_a_row(demos, cal, tmp_path):
    (tmp_path / "in").mkdir()
    demos.rename(tmp_path / "in/a.hdf5")
    (tmp_path / "in/b.hdf5").write_bytes(b"no HDF5")
    summary = run_batch(tmp_path / "in", cal, tmp_path / "out", dataset="data/*/obs/gelsight", table="csv")
    assert (summary.complete, summary.frames, summary.errors) == (True, 11, 1)
    assert "b.hdf5 as HDF5" in (tmp_path / "out/frames.csv").read_text().splitlines()[-1]


@pytest.fixture(params=[2, 3])
def replay(zarr, tmp_path, images, request):
    path = tmp_path / "in" / "replay.zarr"
    group = zarr.open_group(str(path), mode="w", zarr_format=request.param)
    frames = np.stack([*images, images[0]])
    array = group.create_array("data/gel", shape=frames.shape, chunks=(2, *frames.shape[1:]), dtype="f4")
    array[:] = frames
    ends = group.create_array("meta/episode_ends", shape=(2,), dtype="i8")
    ends[:] = [3, 5]
    return path


def test_episodes_of_zarr_are_sequences_and_give_the_same_depth_as_by_hand(
    replay, zarr, cal, images, tmp_path
):
    found = films_in_container(replay, "replay.zarr", "data/gel")
    assert [(one.name, one.offset, one.count) for one in found] == [
        ("replay.zarr/data/gel/000000", 0, 3),
        ("replay.zarr/data/gel/000001", 3, 2),
    ]
    settings = BatchSettings("zarr", keep=("depth",), part_frames=2)
    for source, output in ((replay, "a"), (replay.parent, "b")):
        summary = run_batch(source, cal, tmp_path / output, settings, dataset="data/*")
        assert (summary.complete, summary.frames, summary.errors) == (True, 5, 0)
        assert verify_output(tmp_path / output) == (5, 0, [])
    arrays = zarr.open_group(str(tmp_path / "a/frames"))["replay.zarr/data/gel"]
    first, second = (arrays[f"{name}/depth_mm"] for name in ("000000", "000001"))
    assert (first.shape[0], second.shape[0]) == (3, 2)
    # The first frames of a sequence's second part, and of the second sequence.
    for depth, image in ((first[2], images[2]), (second[0], images[3])):
        np.testing.assert_array_equal(depth, gelform.Reconstructor(cal).from_image(image).depth_mm)


def test_zarr_that_cannot_be_is_said(zarr, replay, tmp_path):
    with pytest.raises(DataError, match=r"there are data/gel \(one of float32 5x64x80x3\)"):
        listing_of(replay, dataset="data/img")
    zarr.open_group(str(replay))["meta/episode_ends"][:] = [3, 4]
    with pytest.raises(DataError, match="to end at the 5 frames"):
        listing_of(replay, dataset="data/gel")
    (tmp_path / "a.zarr").mkdir()
    (tmp_path / "a.zarr/.zgroup").write_text("{")
    with pytest.raises(DataError, match="as a Zarr group"):
        listing_of(tmp_path / "a.zarr", dataset="data/gel")


def test_a_chunk_that_is_damaged_costs_its_frames_alone(replay, cal, tmp_path):
    names = ("data.gel.1.0.0.0", "data.gel.c.1.0.0.0")  # of Zarr 2 and 3
    paths = {".".join(path.relative_to(replay).parts): path for path in replay.rglob("*")}
    (chunk,) = [paths[name] for name in names if name in paths]
    chunk.write_bytes(chunk.read_bytes()[:50])
    summary = run_batch(replay, cal, tmp_path / "out", dataset="data/gel")
    assert (summary.complete, summary.frames, summary.errors) == (True, 5, 2)


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
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra data is not installed")
    rows = parquet.read_table(table(root)).to_pylist()
    rows[1][STORED]["bytes"] = rows[1][STORED]["bytes"][:40]
    rows[4][STORED]["bytes"] = None
    as_parquet(table(root), rows)
    done = run_batch(root, cal, tmp_path / "out", dataset=STORED, table="csv")
    assert (done.frames, done.errors) == (9, 2)
    said = (tmp_path / "out/frames.csv").read_text()
    assert "An encoded picture is truncated or damaged" in said
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

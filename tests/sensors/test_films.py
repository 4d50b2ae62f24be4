"""Frames of HDF5, Zarr and LeRobot play wherever a film does: one after the other, any of them, in RGB."""

import numpy as np
import pytest

from gelform import DataError, open_source
from gelform.batch.inputs import frames_of_part, listing_of, plan_of
from gelform.sensors.containers import films_inside, is_data_set
from gelform.sensors.films import film_of, films_in, open_film
from gelform.sensors.playback import Player
from made.files import EPISODES, FPS, KEY, STORED

DEMOS = "data/*/obs/gel"


@pytest.fixture(params=["hdf5", "zarr", KEY, STORED])
def data_set(request, tmp_path, images):
    """A path, the dataset, the frames of its nine (LeRobot) or eight images, and their rate."""
    if request.param in (KEY, STORED):
        root, frames = request.getfixturevalue("lerobot")
        return root, request.param, frames, FPS
    frames = [*images, *images[::-1]]
    if request.param == "hdf5":
        path = tmp_path / "demos.h5"
        with request.getfixturevalue("h5py").File(path, "w") as file:
            for k, part in enumerate((frames[:3], frames[3:])):
                file.create_dataset(f"data/demo_{k}/obs/gel", data=np.stack(part), chunks=(2, *part[0].shape))
        return path, DEMOS, frames, 25
    path = tmp_path / "replay.zarr"
    group = request.getfixturevalue("zarr").open_group(str(path), mode="w")
    array = group.create_array(
        "data/gel", shape=(8, *frames[0].shape), chunks=(2, *frames[0].shape), dtype="u1"
    )
    array[:] = np.stack(frames)
    group.create_array("meta/episode_ends", shape=(2,), dtype="i8")[:] = [3, 8]
    return path, "data/gel", frames, 25


def test_all_films_of_a_data_set_play_one_after_the_other(data_set):
    path, dataset, frames, rate_hz = data_set
    with open_source(path, dataset=dataset) as source:
        assert source.rate_hz == rate_hz
        found = list(source)
    assert [frame.index for frame in found] == list(range(len(frames)))
    assert [frame.time_s for frame in found] == pytest.approx(np.arange(len(frames)) / rate_hz)
    np.testing.assert_array_equal([frame.image for frame in found], frames)


def test_any_frame_by_its_number_and_those_alone_that_are_wanted(data_set):
    path, dataset, frames, _ = data_set
    film = open_film(path, dataset=dataset, scan=True)
    for number in (4, 5, 1, 2, len(frames) - 1, 0):
        np.testing.assert_array_equal(film[number].image, frames[number])
    np.testing.assert_array_equal([one.image for one in film.frames({2, 6})], [frames[2], frames[6]])
    with pytest.raises(IndexError):
        film[len(frames)]
    player = Player(film)
    assert next(iter(player)).recorded_s == 0


def test_a_batch_reads_the_same_frames(data_set):
    path, dataset, frames, _ = data_set
    parts = plan_of(listing_of(path, dataset=dataset), 2)
    found = [frame.image for part in parts for _, frame in frames_of_part(part)]
    np.testing.assert_array_equal(found, frames)


def test_red_and_blue_are_exchanged_once(data_set):
    path, dataset, frames, _ = data_set
    film = open_film(path, dataset=dataset, bgr=True)
    for found in (film[1], list(film)[1], next(film.frames({1})), next(film.each(1, 1))):
        np.testing.assert_array_equal(found.image, frames[1][..., ::-1])


def test_an_episode_by_its_name(lerobot):
    root, frames = lerobot
    assert is_data_set(root)
    start = EPISODES[0]
    found = list(open_source(root, dataset=f"{KEY}/episode_000001"))
    np.testing.assert_array_equal([one.image for one in found], frames[start : start + EPISODES[1]])
    for wanted in (f"{KEY}/episode_000009", f"{KEY}/episode_1", "observation.images.x"):
        with pytest.raises(DataError, match="Give one with --dataset; there are"):
            films_inside(root, root.name, wanted)


def test_a_damaged_frame_is_said_and_the_next_one_comes(h5py, tmp_path, images):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        frames = file.create_dataset("gel", (4,), h5py.vlen_dtype(np.uint8))
        (tmp_path / "a.png").write_bytes(b"")
        for k, image in enumerate(images):
            frames[k] = np.frombuffer(_png(image), np.uint8)[: 60 if k == 1 else None]
    film = open_film(tmp_path / "a.h5")
    np.testing.assert_array_equal(film[0].image, images[0])
    with pytest.raises(DataError, match="truncated or damaged"):
        film[1]
    np.testing.assert_array_equal(film[2].image, images[2])
    kinds = [type(one) for one in film.each()]
    assert kinds[1] is DataError
    assert kinds.count(DataError) == 1
    with pytest.raises(DataError, match="truncated or damaged"):
        list(film)


def _png(image):
    from gelform.foundations.files import picture_bytes

    return picture_bytes(image)


def test_a_dataset_is_named_for_data_sets_alone(h5py, tmp_path, images):
    for source in ("simulated", "http://localhost:9/", str(tmp_path)):
        with pytest.raises(DataError, match="--dataset is of HDF5 files"):
            open_source(source, dataset="gel")
    with h5py.File(tmp_path / "depth.h5", "w") as file:
        file["depth_mm"] = np.zeros((3, 4, 5), np.float32)
    with h5py.File(tmp_path / "gel.h5", "w") as file:
        file["a"] = file["b"] = np.stack(images)
    with pytest.raises(DataError, match=r"holds 2 datasets of frames\. Give one with --dataset"):
        open_source(tmp_path / "gel.h5")
    assert films_in(tmp_path) == [tmp_path / "gel.h5"]


def test_what_cannot_be_opened_is_said_when_it_is_read(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"no HDF5")
    pytest.importorskip("h5py", reason="the extra data is not installed")
    with pytest.raises(DataError, match="as HDF5"):
        open_film(tmp_path / "a.h5")
    (one,) = listing_of(tmp_path, dataset="gel").sequences
    with pytest.raises(DataError, match="as HDF5"):
        list(film_of(one, 1e6).each())

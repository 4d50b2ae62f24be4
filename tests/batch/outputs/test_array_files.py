"""HDF5, Zarr, videos: h5py, zarr and ffmpeg read the reconstructed values; the bytes depend on nothing else."""

import json
import os

import numpy as np
import pytest

from gelform.batch import run_batch
from gelform.batch.inputs.plan import Part
from gelform.batch.outputs.files import PartTarget
from gelform.batch.outputs.hdf5_files import hdf5_index
from gelform.batch.outputs.video import Codec, VideoWriter
from gelform.batch.outputs.zarr_arrays import shard_frames
from gelform.batch.settings import KEPT, BatchSettings
from gelform.errors import DataError
from gelform.exchange.exporters.quantised import depth_from_levels

LOSSLESS = Codec("ffv1", "gray16le", "matroska", {"level": "3", "slices": "4", "slicecrc": "1"})


@pytest.fixture
def av():
    return pytest.importorskip("av", reason="the extra data is not installed")


def assert_maps(maps, results):
    """Every map of every result, nothing where there is none."""
    assert {name.removesuffix("_mm") for name in maps} == set(KEPT)
    for name, stored in maps.items():
        assert stored.shape[0] == len(results)
        for k, result in enumerate(results):
            if result is None:
                assert not np.nan_to_num(stored[k]).any()
            else:
                np.testing.assert_array_equal(stored[k], getattr(result, name))
    assert np.isnan(maps["depth_mm"][2]).all()
    assert maps["depth_mm"].attrs["unit"] == "mm"


def assert_levels(levels, result):
    depth, known = depth_from_levels(levels)
    np.testing.assert_array_equal(known, result.known)
    assert np.abs(depth - result.depth_mm)[known].max() <= 0.51e-4


@pytest.mark.parametrize("counted", [True, False])
def test_every_map_as_h5py_reads_it(h5py, written, results, tmp_path, counted):
    _, rows = written("hdf5", keep=KEPT, counted=counted)
    with h5py.File(tmp_path / rows[0]["output"]) as file:
        assert_maps(dict(file.items()), results)


def test_one_hdf5_file_shows_every_sequence_as_a_whole(h5py, tree, cal, tmp_path):
    settings = BatchSettings("hdf5", keep=("depth",), dtype="uint16", part_frames=3)
    assert run_batch(tree, cal, tmp_path / "out", settings).complete
    with h5py.File(tmp_path / "out/frames.h5") as file:
        assert file["depth_mm"].shape == file["day2/depth_mm"].shape == (4, 64, 80)
        with h5py.File(tmp_path / "out/frames/day2/00000003.h5") as part:
            np.testing.assert_array_equal(file["day2/depth_mm"][3], part["depth_mm"][0])
        assert file["day2/depth_mm"][3].max() > 32768
    files = [f"frames/{name}0000000{k}.h5" for name in ("", "day2/") for k in (0, 3)]
    assert hdf5_index(tmp_path / "out", files) == (tmp_path / "out/frames.h5").read_bytes()


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize("part_frames", [5, 2 * 64])
def test_every_map_as_zarr_reads_it(zarr, written, results, tmp_path, counted, part_frames):
    written("zarr", keep=KEPT, counted=counted, part_frames=part_frames)
    assert_maps(dict(zarr.open_group(tmp_path / "frames", mode="r")["day/a"].arrays()), results)


def test_levels_as_zarr_reads_them(zarr, written, results, tmp_path):
    written("zarr", dtype="uint16", keep=("depth",), sequence="")
    array = zarr.open_array(tmp_path / "frames/depth_mm", mode="r")
    assert_levels(array[1], results[1])
    assert (array[2] == 0).all()
    assert (array.attrs["scale_factor"], array.attrs["add_offset"]) == pytest.approx((1e-4, -3.2768))


def test_every_file_of_zarr_is_recorded_and_an_altered_index_noticed(zarr, written, tmp_path):
    """The CRC-32C is that of the specification."""
    writer, rows = written("zarr", keep=("depth",))
    there = {p.relative_to(tmp_path).as_posix() for p in (tmp_path / "frames").rglob("*") if p.is_file()}
    assert {file.path for file in writer.files} == there
    assert rows[0] == {"output": "frames/day/a"}
    assert json.loads((tmp_path / "frames/zarr.json").read_text())["node_type"] == "group"
    path = tmp_path / next(file.path for file in writer.files if "/c/" in file.path)
    content = bytearray(path.read_bytes())
    content[-20] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="checksum"):
        zarr.open_array(tmp_path / "frames/day/a/depth_mm", mode="r")[0]


def test_no_shard_belongs_to_two_parts():
    for part, shard in [(256, 64), (5, 5), (1, 1), (67, 1), (90, 45)]:
        assert shard_frames(part) == shard


def target(folder, shape):
    return PartTarget(folder, Part(0, "a", folder), BatchSettings("lerobot"), shape, {})


def test_levels_of_any_width_come_back_from_a_video(av, tmp_path):
    """Rows of odd widths are padded in memory."""
    for shape in ((48, 64), (50, 70), (33, 41)):
        levels = np.random.default_rng(0).integers(0, 65536, (3, *shape), dtype=np.uint16)
        path = tmp_path / f"{shape[0]}/video.mkv"
        with VideoWriter(target(tmp_path, shape), path, LOSSLESS, 10, av) as video:
            for k, one in enumerate(levels):
                video.add(str(k), k, one)
            assert not path.exists()
        with av.open(str(path)) as file:
            frames = list(file.decode(video=0))
        assert [float(one.time) for one in frames] == pytest.approx([0, 0.1, 0.2])
        np.testing.assert_array_equal([one.to_ndarray(format="gray16le") for one in frames], levels)


def test_an_encoder_that_is_not_there(av, tmp_path):
    codec = Codec("nosuch", "gray16le", "matroska")
    video = VideoWriter(target(tmp_path, (48, 64)), tmp_path / "video.mkv", codec, 30, av)
    with pytest.raises(DataError, match="has no encoder nosuch"), video:
        pass
    assert os.listdir(tmp_path) == []

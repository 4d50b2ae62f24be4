"""Zarr: what zarr itself reads is what was reconstructed, and the bytes depend on nothing else."""

import json

import numpy as np
import pytest

from gelform.batch.outputs.zarr_arrays import shard_frames
from gelform.batch.settings import KEPT
from gelform.exporters.quantised import depth_from_levels

zarr = pytest.importorskip("zarr", minversion="3", reason="the extra zarr is not installed")


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize("part_frames", [5, 2 * 64])
def test_every_map_as_zarr_reads_it(written, results, tmp_path, counted, part_frames):
    written("zarr", keep=KEPT, counted=counted, part_frames=part_frames)
    group = zarr.open_group(tmp_path / "frames", mode="r")["day/a"]
    assert set(group) == {
        "depth_mm",
        "known",
        "depth_sigma_mm",
        "gradients",
        "normals",
        "confidence",
        "contact",
    }
    for name, array in group.arrays():
        assert array.shape[0] == 5
        for k, result in enumerate(results):
            if result is None:
                assert not np.nan_to_num(array[k]).any()
            else:
                np.testing.assert_array_equal(array[k], getattr(result, name))
    assert np.isnan(group["depth_mm"][2]).all()
    assert group["depth_mm"].attrs["unit"] == "mm"


def test_levels_as_zarr_reads_them(written, results, tmp_path):
    written("zarr", dtype="uint16", keep=("depth",), sequence="")
    array = zarr.open_array(tmp_path / "frames/depth_mm", mode="r")
    depth, known = depth_from_levels(array[1])
    np.testing.assert_array_equal(known, results[1].known)
    assert np.abs(depth - results[1].depth_mm)[known].max() <= 0.51e-4
    assert (array[2] == 0).all()
    told = array.attrs
    assert (told["scale_factor"], told["add_offset"]) == pytest.approx((1e-4, -3.2768))


def test_an_altered_index_is_noticed_by_zarr(written, tmp_path):
    """The CRC-32C is that of the specification."""
    writer, _ = written("zarr", keep=("depth",))
    path = tmp_path / next(file.path for file in writer.files if "/c/" in file.path)
    content = bytearray(path.read_bytes())
    content[-20] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="checksum"):
        zarr.open_array(tmp_path / "frames/day/a/depth_mm", mode="r")[0]


def test_every_file_is_recorded(written, tmp_path):
    writer, rows = written("zarr", keep=("depth",))
    there = {p.relative_to(tmp_path).as_posix() for p in (tmp_path / "frames").rglob("*") if p.is_file()}
    assert {file.path for file in writer.files} == there
    assert rows[0] == {"output": "frames/day/a"}
    assert json.loads((tmp_path / "frames/zarr.json").read_text())["node_type"] == "group"


def test_no_shard_belongs_to_two_parts():
    for part, shard in [(256, 64), (5, 5), (1, 1), (67, 1), (90, 45)]:
        assert shard_frames(part) == shard

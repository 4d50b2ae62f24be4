"""What is recorded of a file is what is there."""

import errno
import hashlib
import io

import numpy as np
import pytest

import gelform
from gelform.batch.inputs.plan import Part
from gelform.batch.outputs import files as output_files
from gelform.batch.outputs.files import (
    FlushedLater,
    OutputFile,
    PartTarget,
    RememberingFile,
    attributes_of,
    blank_maps,
    check_names,
    facts_of,
    maps_of,
    output_file,
)
from gelform.batch.settings import KEPT, BatchSettings
from gelform.errors import DataError
from made.small_gel import MM_PER_PX, SHAPE, Touch, depth_of


def test_a_file_as_written(tmp_path):
    target = PartTarget(tmp_path, Part(0, "a/b", tmp_path), BatchSettings(), (1, 1), {})
    content = b"abc" * (1 << 20)
    file = target.write(target.folder / "x", content)
    assert file == OutputFile("frames/a/b/x", len(content), hashlib.sha256(content).hexdigest())
    assert output_file(tmp_path, tmp_path / file.path) == file
    (tmp_path / "frames/a/b/y").mkdir()
    with pytest.raises(DataError, match="got the folder"):
        target.write(target.folder / "y", b"")


def test_files_that_are_flushed_later(tmp_path):
    with FlushedLater(tmp_path) as later:
        files = [later.write(tmp_path / f"frames/{k}", bytes([k])) for k in range(20)]
        assert (tmp_path / "frames/19").read_bytes() == bytes([19])
    assert all(output_file(tmp_path, tmp_path / file.path) == file for file in files)
    assert all(one.done() for one in later._files)


def test_a_disk_that_does_not_take_a_file_is_said(tmp_path):
    later = FlushedLater(tmp_path).__enter__()
    later.write(tmp_path / "a", b"1")
    later._files.append(later._flushing.submit(output_files._flush, tmp_path / "gone"))
    with pytest.raises(DataError, match="No such file"):
        later.__exit__(None, None, None)


class FullDisk(io.BytesIO):
    """Takes ten bytes."""

    def write(self, content):
        if self.tell() + len(content) > 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(content)


def test_the_first_error_is_remembered():
    file = RememberingFile(FullDisk())
    assert file.write(b"12345678") == 8
    file.check()
    assert file.write(b"12345678") == 8
    assert file.write(b"1") == 1
    with pytest.raises(OSError, match="No space left"):
        file.check()


@pytest.fixture(scope="module")
def result(cal, images):
    return gelform.Reconstructor(cal).from_image(images[3])


def test_blank_maps_are_of_the_same_kind(result):
    for settings in [BatchSettings(keep=KEPT), BatchSettings("zarr", dtype="uint16")]:
        maps, blank = maps_of(result, settings), blank_maps(settings, SHAPE)
        assert [(n, m.shape, m.dtype) for n, m in maps.items()] == [
            (n, m.shape, m.dtype) for n, m in blank.items()
        ]


def test_levels_turn_into_mm_by_their_attributes(result):
    settings = BatchSettings("zarr", dtype="uint16")
    told, levels = attributes_of("depth_mm", settings), maps_of(result, settings)["depth_mm"]
    depth = levels[result.known] * told["scale_factor"] + told["add_offset"]
    assert np.abs(depth - result.depth_mm[result.known]).max() <= 0.51e-4


def test_a_map_that_is_not_there_is_said(cal, images):
    without = gelform.Reconstructor(cal, depth_sigma=False).from_image(images[0])
    with pytest.raises(DataError, match="gives no depth_sigma_mm"):
        maps_of(without, BatchSettings(keep=("depth_sigma",)))


def test_figures_of_a_ball(result):
    """Against the true depth, over the contact that was found."""
    facts, touch = facts_of(result), Touch(depth_mm=0.35)
    truth = depth_of(touch)
    assert facts["contacts"] == 1
    assert facts["health"] == ""
    assert facts["deepest_mm"] == pytest.approx(truth.max(), abs=0.02)
    assert (facts["deepest_x_px"], facts["deepest_y_px"]) == pytest.approx((touch.x_px, touch.y_px), abs=4)
    assert facts["volume_mm3"] == pytest.approx(truth[result.contact].sum() * MM_PER_PX**2, rel=0.03)
    assert facts["contact_mm2"] == pytest.approx(result.contact.sum() * MM_PER_PX**2)


def test_a_folder_called_like_an_array_is_refused():
    check_names(["depth_mm"], BatchSettings())
    with pytest.raises(DataError, match="where an array known does"):
        check_names(["day1", "day2/known"], BatchSettings("zarr"))

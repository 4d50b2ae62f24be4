"""What is recorded of a file is what is there."""

import errno
import hashlib
import io

import pytest

from gelform.batch.inputs.plan import Part
from gelform.batch.outputs import places
from gelform.batch.outputs.places import FlushedLater, OutputFile, Place, RememberingFile, output_file
from gelform.batch.settings import BatchSettings
from gelform.errors import DataError


def test_a_file_as_written(tmp_path):
    place = Place(tmp_path, Part(0, "a/b", tmp_path), BatchSettings(), (1, 1), {})
    content = b"abc" * (1 << 20)
    file = place.write(place.folder / "x", content)
    assert file == OutputFile("frames/a/b/x", len(content), hashlib.sha256(content).hexdigest())
    assert output_file(tmp_path, tmp_path / file.path) == file
    (tmp_path / "frames/a/b/y").mkdir()
    with pytest.raises(DataError, match="got the folder"):
        place.write(place.folder / "y", b"")


def test_files_that_are_flushed_later(tmp_path):
    with FlushedLater(tmp_path) as later:
        files = [later.write(tmp_path / f"frames/{k}", bytes([k])) for k in range(20)]
        assert (tmp_path / "frames/19").read_bytes() == bytes([19])
    assert all(output_file(tmp_path, tmp_path / file.path) == file for file in files)
    assert all(one.done() for one in later._files)


def test_a_disk_that_does_not_take_a_file_is_said(tmp_path):
    later = FlushedLater(tmp_path).__enter__()
    later.write(tmp_path / "a", b"1")
    later._files.append(later._flushing.submit(places._flush, tmp_path / "gone"))
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

"""Levels through a lossless video, of any width; an encoder that is not there."""

import os

import numpy as np
import pytest

from gelform.batch.outputs.video_file import Codec, VideoFile
from gelform.errors import DataError

av = pytest.importorskip("av", reason="the extra ffv1 is not installed")
FFV1 = Codec("ffv1", "gray16le", "matroska")


@pytest.mark.parametrize("shape", [(48, 64), (50, 70), (33, 41)])
def test_levels_come_back(tmp_path, shape):
    """Rows of odd widths are padded in memory."""
    levels = np.random.default_rng(0).integers(0, 65536, (3, *shape), dtype=np.uint16)
    with VideoFile(av, tmp_path / "a/video.mkv", shape, FFV1, 10) as video:
        for one in levels:
            video.add(one)
        assert not (tmp_path / "a/video.mkv").exists()
    with av.open(str(tmp_path / "a/video.mkv")) as file:
        frames = list(file.decode(video=0))
    assert [float(one.time) for one in frames] == pytest.approx([0, 0.1, 0.2])
    np.testing.assert_array_equal([one.to_ndarray(format="gray16le") for one in frames], levels)


def test_an_encoder_that_is_not_there(tmp_path):
    video = VideoFile(av, tmp_path / "video.mkv", (48, 64), Codec("nosuch", "gray16le", "matroska"), 30)
    with pytest.raises(DataError, match="has no encoder nosuch"), video:
        pass
    assert os.listdir(tmp_path) == []

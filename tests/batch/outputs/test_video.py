"""Levels through a lossless video, of any width: what ffmpeg decodes; an encoder that is not there."""

import os

import numpy as np
import pytest

from gelform.batch.inputs.plan import Part
from gelform.batch.outputs.files import PartTarget
from gelform.batch.outputs.video import FFV1, Codec, VideoWriter
from gelform.batch.settings import BatchSettings
from gelform.errors import DataError
from gelform.exporters.quantised import depth_from_levels

av = pytest.importorskip("av", reason="the extra ffv1 is not installed")


def target(folder, shape):
    return PartTarget(folder, Part(0, "a", folder), BatchSettings("ffv1"), shape, {})


def test_levels_come_back(tmp_path):
    """Rows of odd widths are padded in memory."""
    for shape in ((48, 64), (50, 70), (33, 41)):
        levels = np.random.default_rng(0).integers(0, 65536, (3, *shape), dtype=np.uint16)
        path = tmp_path / f"{shape[0]}/video.mkv"
        with VideoWriter(target(tmp_path, shape), path, FFV1, 10, av) as video:
            for k, one in enumerate(levels):
                video.add(str(k), k, one)
            assert not path.exists()
        with av.open(str(path)) as file:
            frames = list(file.decode(video=0))
        assert [float(one.time) for one in frames] == pytest.approx([0, 0.1, 0.2])
        np.testing.assert_array_equal([one.to_ndarray(format="gray16le") for one in frames], levels)


def test_an_encoder_that_is_not_there(tmp_path):
    codec = Codec("nosuch", "gray16le", "matroska")
    video = VideoWriter(target(tmp_path, (48, 64)), tmp_path / "video.mkv", codec, 30, av)
    with pytest.raises(DataError, match="has no encoder nosuch"), video:
        pass
    assert os.listdir(tmp_path) == []


def test_levels_as_av_decodes_them(written, results, tmp_path):
    _, rows = written("ffv1", sequence="")
    assert rows[0] == {"output": "frames/frames.mkv"}
    _, rows = written("ffv1", sequence="day/a")
    name = "day/a.mkv"
    assert rows[0] == {"output": f"frames/{name}"}
    with av.open(str(tmp_path / "frames" / name)) as file:
        assert file.streams.video[0].codec_context.name == "ffv1"
        frames = [frame.to_ndarray(format="gray16le") for frame in file.decode(video=0)]
    assert len(frames) == 5
    assert not frames[2].any()
    depth, known = depth_from_levels(frames[3])
    np.testing.assert_array_equal(known, results[3].known)
    assert np.abs(depth - results[3].depth_mm)[known].max() <= 0.51e-4

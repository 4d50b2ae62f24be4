"""FFV1: what ffmpeg decodes are the levels of the depth, frame for frame."""

import numpy as np
import pytest

from gelform.exporters.quantised import depth_from_levels

av = pytest.importorskip("av", reason="the extra ffv1 is not installed")


@pytest.mark.parametrize(("sequence", "name"), [("day/a", "day/a.mkv"), ("", "frames.mkv")])
def test_levels_as_av_decodes_them(written, results, tmp_path, sequence, name):
    _, rows = written("ffv1", sequence=sequence)
    assert rows[0] == {"output": f"frames/{name}"}
    with av.open(str(tmp_path / "frames" / name)) as file:
        assert file.streams.video[0].codec_context.name == "ffv1"
        frames = [frame.to_ndarray(format="gray16le") for frame in file.decode(video=0)]
    assert len(frames) == 5
    assert not frames[2].any()
    depth, known = depth_from_levels(frames[3])
    np.testing.assert_array_equal(known, results[3].known)
    assert np.abs(depth - results[3].depth_mm)[known].max() <= 0.51e-4


def test_the_same_bytes_twice(written, tmp_path):
    assert written("ffv1", folder=tmp_path / "a")[0].files == written("ffv1", folder=tmp_path / "b")[0].files


def test_nothing_is_left_of_a_sequence_that_ended_early(written, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        written("ffv1", interrupted=True)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]

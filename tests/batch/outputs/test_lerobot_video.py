"""Depth in LeRobot's videos: codes of 1 um by the formula that LeRobot decodes them with; statistics of all of them."""

import json

import numpy as np
import pytest

from gelform.batch.outputs.lerobot_video import MAX_CODE, episode_of, statistics, video_path
from gelform.errors import DataError
from gelform.robots import depth_from_lerobot_levels

av = pytest.importorskip("av", reason="the extra lerobot is not installed")
KEY, EPISODE = "observation.images.gel", 1002
SEQUENCE = f"{KEY}/episode_{EPISODE:06d}"
VIDEO = f"frames/videos/{KEY}_depth/chunk-001/file-002.mp4"


def codes_in(path):
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("hevc", "gray12le")
        frames = list(file.decode(stream))
    assert [float(one.time) for one in frames] == pytest.approx(
        [k / 30 for k in range(len(frames))], abs=1e-6
    )
    return [one.to_ndarray(format="gray12le") for one in frames]


def as_lerobot_reads(codes, info):
    """Millimetres by LeRobot's linear formula, in float32 as there."""
    low, high = info["video.depth_min"], info["video.depth_max"]
    metres = codes.astype(np.float32) * np.float32((high - low) / 4095) + np.float32(low)
    return np.rint(np.clip(metres, low, high) * np.float32(1000))


def test_depth_as_lerobot_decodes_it(written, results, tmp_path):
    writer, rows = written("lerobot", sequence=SEQUENCE)
    assert rows[0] == {"output": VIDEO}
    assert rows[2] == {}
    codes = codes_in(tmp_path / VIDEO)
    said = json.loads((tmp_path / writer.files[1].path).read_bytes())
    info = said["feature"]["info"]
    assert (said["length"], info["is_depth_map"], info["depth_unit"]) == (5, True, "mm")
    assert not codes[2].any()  # it has an error
    for k in (0, 1, 3, 4):
        depth_mm = depth_from_lerobot_levels(as_lerobot_reads(codes[k], info))
        assert np.abs(depth_mm - results[k].depth_mm).max() <= 0.501e-3


def test_every_code_comes_back(tmp_path):
    info = {"video.depth_min": 0.0, "video.depth_max": MAX_CODE / 1000}
    codes = np.arange(MAX_CODE + 1)
    np.testing.assert_array_equal(as_lerobot_reads(codes, info), codes)


def test_the_same_bytes_twice(written, tmp_path):
    first, second = (
        written("lerobot", sequence=SEQUENCE, folder=tmp_path / name)[0].files for name in ("a", "b")
    )
    assert first == second


def test_nothing_is_left_of_an_episode_that_ended_early(written, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        written("lerobot", sequence=SEQUENCE, interrupted=True)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_depth_beyond_the_codes_is_refused(written, results, tmp_path):
    from dataclasses import replace

    from gelform.batch.outputs.writers import WRITERS

    writer, _ = written("lerobot", sequence=SEQUENCE)
    deep = replace(results[0], depth=results[0].depth + np.float32(3.2))
    with pytest.raises(DataError, match=r"up to 3.095 mm, .* got 3\.[2-9]"):
        writer.prepared(deep)
    assert WRITERS["lerobot"] is type(writer)


def test_statistics_are_those_of_all_pixels():
    levels = np.random.default_rng(0).integers(900, 1500, (3, 40, 50))
    found = statistics(np.bincount(levels.ravel(), minlength=MAX_CODE + 1), 3)
    assert (found["min"], found["max"], found["count"]) == (levels.min(), levels.max(), 3)
    assert (found["mean"], found["std"]) == pytest.approx((levels.mean(), levels.std()))
    for name, part in (("q01", 0.01), ("q50", 0.5), ("q99", 0.99)):
        assert found[name] == np.quantile(levels, part, method="inverted_cdf")


def test_names():
    assert episode_of(SEQUENCE) == (KEY, EPISODE)
    assert video_path(f"{KEY}_depth", EPISODE) == VIDEO.removeprefix("frames/")
    for other in ("", "day/a", "episode_x/1"):
        with pytest.raises(DataError, match="Expected an episode of a LeRobot data set"):
            episode_of(other)

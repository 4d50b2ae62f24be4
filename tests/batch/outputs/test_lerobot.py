"""Depth in LeRobot's videos and tables: 1 um a code by the formula that LeRobot decodes, with the statistics of all.

The data set keeps all its content, gains one feature in every table, and is complete after any interruption.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.batch.outputs.lerobot import (
    MAX_CODE,
    check_lerobot_source,
    episode_of,
    statistics,
    video_path,
    write_lerobot_set,
)
from gelform.depth.force import ForceModel, ForcePart
from gelform.errors import DataError
from gelform.robots import depth_from_lerobot_levels
from made.files import encoded

av = pytest.importorskip("av", reason="the extra data is not installed")
KEY, STORED, EPISODE = "observation.images.gel", "observation.images.still", 1002
FORCE = "observation.force.gel"
SEQUENCE = f"{KEY}/episode_{EPISODE:06d}"
VIDEO = f"frames/videos/{KEY}_depth/chunk-001/file-002.mp4"


def codes_in(path):
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("hevc", "gray12le")
        frames = list(file.decode(stream))
    times = [float(one.time) for one in frames]
    assert times == pytest.approx([k / 30 for k in range(len(frames))], abs=1e-6)
    return [one.to_ndarray(format="gray12le") for one in frames]


def as_lerobot_reads(codes, info):
    """Millimeters by LeRobot's linear formula, in float32 as there."""
    low, high = info["video.depth_min"], info["video.depth_max"]
    meters = codes.astype(np.float32) * np.float32((high - low) / 4095) + np.float32(low)
    return np.rint(np.clip(meters, low, high) * np.float32(1000))


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
    every = np.arange(MAX_CODE + 1)
    of_all = {"video.depth_min": 0.0, "video.depth_max": MAX_CODE / 1000}
    np.testing.assert_array_equal(as_lerobot_reads(every, of_all), every)


def test_depth_beyond_the_codes_is_refused(written, results, tmp_path):
    writer, _ = written("lerobot", sequence=SEQUENCE)
    deep = replace(results[0], depth=results[0].depth + np.float32(3.2))
    with pytest.raises(DataError, match=r"up to 3.095 mm, .* got 3\.[2-9]"):
        writer.prepared(deep)


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


SETTINGS = BatchSettings("lerobot", keep=("depth",))
DEPTH = f"{KEY}_depth"


@pytest.fixture
def done(lerobot, cal, tmp_path, visible):
    """The data set and its output."""
    root, _ = lerobot
    (root / ".cache").mkdir()
    (root / ".cache/left").write_text("x")
    (root / "README.md").write_text("of the data set\n")
    before = visible(root)
    summary = run_batch(root, cal, tmp_path / "out", SETTINGS, dataset=KEY, table="csv")
    assert (summary.complete, summary.frames, summary.errors) == (True, 9, 0)
    assert visible(root) == before
    return root, tmp_path / "out"


def rows_of(path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra data is not installed")
    return parquet.read_table(path).to_pylist()


def test_everything_else_is_as_it_was_and_the_tables_say_where_depth_is(done, visible):
    root, output = done
    before, after = visible(root), visible(output / "frames")
    del before[".cache/left"]  # hidden: no part of it
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"meta/info.json", "meta/stats.json", "meta/episodes/chunk-000/file-000.parquet"}
    new = set(after) - set(before)
    assert new == {f"videos/{DEPTH}/chunk-000/file-{k:03d}.mp4" for k in range(3)}
    assert "README.md" in after
    assert verify_output(output) == (9, 0, [])
    old, new = (json.loads((one / "meta/info.json").read_text()) for one in (root, output / "frames"))
    assert new["features"].pop(DEPTH)["shape"] == [64, 80, 1]
    assert new == old
    where = "meta/episodes/chunk-000/file-000.parquet"
    for before, after in zip(rows_of(root / where), rows_of(output / "frames" / where), strict=True):
        assert before.items() <= after.items()
        assert after[f"videos/{DEPTH}/file_index"] == after["episode_index"]
        assert after[f"videos/{DEPTH}/from_timestamp"] == 0
        assert after[f"videos/{DEPTH}/to_timestamp"] == pytest.approx(after["length"] / 30)
        assert after[f"stats/{DEPTH}/count"] == [after["length"]]


def test_statistics_of_all_episodes(done):
    _, output = done
    rows = rows_of(output / "frames/meta/episodes/chunk-000/file-000.parquet")
    stats = json.loads((output / "frames/meta/stats.json").read_text())
    assert stats["action"] == {"mean": [0.0, 0.0]}
    found = {name: np.ravel(value)[0] for name, value in stats[DEPTH].items()}
    of = {name: [np.ravel(row[f"stats/{DEPTH}/{name}"])[0] for row in rows] for name in found}
    weights = np.array(of["count"])
    assert (found["count"], found["min"], found["max"]) == (9, min(of["min"]), max(of["max"]))
    mean = np.average(of["mean"], weights=weights)
    squares = np.average(np.square(of["std"]) + np.square(of["mean"]), weights=weights)
    assert (found["mean"], found["std"]) == pytest.approx((mean, np.sqrt(squares - mean**2)))
    assert found["max"] > 1100  # something was pressed


@pytest.fixture
def with_force(cal):
    """The calibration with a normal force of 0.05 N/mm^3; there are no dots for shear."""
    normal = ForcePart(((0.05,),), (0.001, 100.0), 0.2, 0.0, 9)
    return replace(
        cal, force=ForceModel(normal, None, None, (), ("ball",), cal.digest, "2026-01-01T00:00:00Z")
    )


def test_the_force_on_each_frame_is_in_the_tables(lerobot, with_force, tmp_path):
    root, frames = lerobot
    assert run_batch(root, with_force, tmp_path / "out", SETTINGS, dataset=KEY, table="csv").complete
    assert verify_output(tmp_path / "out") == (9, 0, [])
    output = tmp_path / "out/frames"
    reconstruct = gelform.Reconstructor(with_force)
    true = np.array([reconstruct.from_image(frame).force.vector_n for frame in frames])
    assert np.isnan(true[:, :2]).all()
    assert np.nanmax(true[:, 2]) < 0  # it pushes toward the camera
    found = []
    for path in sorted(output.glob("data/*/*.parquet")):
        rows, old = rows_of(path), rows_of(root / path.relative_to(output))
        found += [(row.pop(FORCE), row.pop(f"{FORCE}_known")) for row in rows]
        assert rows == old
    np.testing.assert_allclose(np.array(found)[:, 0], np.nan_to_num(true), rtol=1e-6)
    np.testing.assert_array_equal(np.array(found)[:, 1], np.isfinite(true))
    told, stats = (json.loads((output / f"meta/{name}.json").read_text()) for name in ("info", "stats"))
    assert told["features"][FORCE] == {"dtype": "float32", "shape": [3], "names": ["x_n", "y_n", "z_n"]}
    assert stats[FORCE]["mean"] == pytest.approx([0, 0, np.nan_to_num(true[:, 2]).mean()])
    assert (stats[FORCE]["count"], stats[FORCE]["min"][2]) == ([9], pytest.approx(np.nanmin(true[:, 2])))
    assert stats[f"{FORCE}_known"]["max"] == [0, 0, 1]
    for row in rows_of(output / "meta/episodes/chunk-000/file-000.parquet"):
        assert row[f"stats/{FORCE}/count"] == [row["length"]]


def test_a_frame_with_an_error_is_level_zero_and_has_no_force(lerobot, with_force, tmp_path):
    root, frames = lerobot
    encoded(root / f"videos/{KEY}/chunk-000/file-000.mp4", frames[:-1])
    summary = run_batch(root, with_force, tmp_path / "out", SETTINGS, dataset=KEY, table="csv")
    assert (summary.complete, summary.errors) == (True, 1)
    last = rows_of(tmp_path / "out/frames/data/chunk-000/file-001.parquet")[-1]
    assert last[FORCE] == last[f"{FORCE}_known"] == [0, 0, 0]
    rows = rows_of(tmp_path / "out/frames/meta/episodes/chunk-000/file-000.parquet")
    assert [np.ravel(row[f"stats/{DEPTH}/min"])[0] == 0 for row in rows] == [True, False, False]
    assert rows[0]["episode_index"] == 2


def test_two_cameras_at_once(lerobot, cal, tmp_path):
    root, _ = lerobot
    assert run_batch(root, cal, tmp_path / "out", SETTINGS, dataset="*", table="csv").complete
    features = json.loads((tmp_path / "out/frames/meta/info.json").read_text())["features"]
    assert {DEPTH, f"{STORED}_depth"} <= set(features)
    files = (tmp_path / "out/frames/videos").rglob("file-001.mp4")
    first, second = (one.read_bytes() for one in files)
    assert first == second  # the video and the images in tables showed the same


def test_a_run_that_ended_before_its_tables_goes_on(done, lerobot, cal, visible):
    """info.json comes last: LeRobot finds no half of a data set."""
    root, output = done
    whole = visible(output)
    left = output / "frames/data/.gelform-123.tmp"
    left.write_bytes(b"half")
    (output / "frames/data/chunk-000/file-001.parquet").write_bytes(b"half")
    for name in ("parts/finished.json", "frames/meta/info.json", "frames/meta/stats.json"):
        (output / name).unlink()
    assert verify_output(output)[2]
    kept = output / "frames/data/chunk-000/file-000.parquet"
    copied_ns = kept.stat().st_mtime_ns
    summary = run_batch(root, cal, output, SETTINGS, dataset=KEY, table="csv")
    assert (summary.complete, summary.frames) == (True, 0)
    assert visible(output) == whole
    assert kept.stat().st_mtime_ns == copied_ns, "a whole copy is not made again"
    assert not left.exists()


def test_what_cannot_be_is_refused(lerobot, tree, cal, tmp_path):
    root, _ = lerobot
    with pytest.raises(DataError, match="Expected a LeRobot data set as input of the format lerobot"):
        run_batch(tree, cal, tmp_path / "out", SETTINGS)
    info = json.loads((root / "meta/info.json").read_text())
    info["features"][DEPTH] = {"dtype": "video", "shape": [64, 80, 1], "info": {"is_depth_map": True}}
    (root / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(DataError, match=f"has {DEPTH} already"):
        check_lerobot_source(root, {KEY})
    (root / "meta/info.json").write_text(json.dumps({**info, "video_path": "films/{video_key}.mp4"}))
    with pytest.raises(DataError, match="Expected videos at"):
        check_lerobot_source(root, {KEY})


def test_a_table_without_a_camera_stays(done, tmp_path):
    """Nothing is added where no part wrote."""
    root, _ = done
    write_lerobot_set(tmp_path / "other", [], root)
    before, after = ((one / "meta/info.json").read_text() for one in (root, tmp_path / "other/frames"))
    assert json.loads(before) == json.loads(after)

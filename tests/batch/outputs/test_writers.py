"""Every form returns the written depth, and the same bytes in any order and shards; damage is found.

h5py, zarr and ffmpeg read the reconstructed values.
"""

import errno
import io
import json
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.batch import KEPT, BatchSettings, FilmRef, RunOptions, run_batch, verify_output
from gelform.batch.inputs import Part
from gelform.batch.outputs import files as output_files
from gelform.batch.outputs.files import (
    FORMATS,
    FlushedLater,
    PartTarget,
    RememberingFile,
    blank_maps,
    check_names,
    facts_of,
    maps_of,
    output_file,
    shard_frames,
    write_hdf5_index,
)
from gelform.batch.outputs.writers import WRITERS, depth_of_row
from gelform.batch.records import COLUMNS
from gelform.depth.force import ForceModel, ForcePart
from gelform.errors import DataError
from made.small_gel import MM_PER_PX, SHAPE, Touch, depth_of


def test_files_that_are_flushed_later_and_a_disk_that_does_not_take_one(tmp_path):
    with FlushedLater(tmp_path) as later:
        files = [later.write(tmp_path / f"frames/{k}", bytes([k])) for k in range(20)]
        assert (tmp_path / "frames/19").read_bytes() == bytes([19])
    assert all(output_file(tmp_path, tmp_path / file.path) == file for file in files)
    assert all(one.done() for one in later._files)
    later = FlushedLater(tmp_path).__enter__()
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


def test_blank_maps_are_of_the_same_kind_and_one_that_is_not_there_is_said(result, cal, images):
    for settings in [BatchSettings(keep=KEPT), BatchSettings("zarr", dtype="uint16")]:
        maps, blank = maps_of(result, settings), blank_maps(settings, SHAPE)
        kinds, blank_kinds = ([(n, m.shape, m.dtype) for n, m in one.items()] for one in (maps, blank))
        assert kinds == blank_kinds
    without = result.changed(depth_sigma_mm=None)
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
    assert facts["normal_n"] is None
    assert "no loads" in facts["force_reason"]
    part = ForcePart(((0.5,),), (0.1, 1e4), 0.2, 0.1, 9)
    model = ForceModel(part, None, None, (), ("ball",), result.calibration_digest, "")
    pressed = facts_of(replace(result, force_model=model, outside_change=0.1))
    assert pressed["normal_n"] == pytest.approx(0.5 * facts["volume_mm3"], rel=1e-5)
    assert set(pressed) <= set(COLUMNS)


def test_a_folder_called_like_an_array_is_refused():
    check_names(["depth_mm"], BatchSettings())
    with pytest.raises(DataError, match="where an array known does"):
        check_names(["day1", "day2/known"], BatchSettings("zarr"))


def test_chosen_maps(written, results, tmp_path):
    for keep in (("depth", "known"), KEPT):
        _, rows = written("npz", keep=keep)
        with np.load(tmp_path / rows[1]["output"]) as file:
            names = {{"depth": "depth_mm", "depth_sigma": "depth_sigma_mm"}.get(name, name) for name in keep}
            assert set(file.files) == {*names, "mm_per_px", "meta"}
            for name in names:
                np.testing.assert_array_equal(file[name], getattr(results[1], name))
    _, rows = written("npz", keep=("contact",))
    assert depth_of_row(tmp_path, "npz", {**rows[0], "index": 0}) is None


def test_whole_results_and_none_of_an_error(written, results, tmp_path):
    _, rows = written("npz", keep=("all",))
    read = gelform.load_result(tmp_path / rows[0]["output"])
    np.testing.assert_array_equal(read.gradients, results[0].gradients)
    np.testing.assert_array_equal(depth_of_row(tmp_path, "npz", {**rows[0], "index": 0}), read.depth_mm)
    assert rows[2] == {}
    assert len(list((tmp_path / "frames/day/a").iterdir())) == 4


NEEDS = {"zarr": "numcodecs", "hdf5": "h5py", "lerobot": "av"}
TO_THE_LEVEL_MM = {"lerobot": 0.501e-3}
EPISODE = "gel/episode_000001"


def import_extra(form):
    if form in NEEDS:
        pytest.importorskip(NEEDS[form], reason="the extra data is not installed")


@pytest.mark.slow
@pytest.mark.parametrize("form", [form for form in FORMATS if form not in ("npz", "lerobot")])
def test_shards_and_repeated_parts_give_the_same_bytes(broken_tree, cal, tmp_path, visible, form):
    import_extra(form)
    settings = BatchSettings(form, keep=("depth",), part_frames=2)
    done = run_batch(broken_tree, cal, tmp_path / "a", settings, table="csv")
    assert (done.complete, done.frames, done.errors) == (True, 12, 4)
    for number in (2, 1):
        half = RunOptions(shard=(number, 2))
        last = run_batch(broken_tree, cal, tmp_path / "b", settings, options=half, table="csv")
    assert last.complete
    assert visible(tmp_path / "a") == visible(tmp_path / "b")
    assert verify_output(tmp_path / "b") == (8, 4, [])
    for path in sorted((tmp_path / "b/frames").rglob("*")):
        if path.is_file() and path.stat().st_size > 4000:
            path.write_bytes(path.read_bytes()[:-1])
            assert "bytes. Run the same command" in verify_output(tmp_path / "b")[2][0].what
            break
    assert run_batch(broken_tree, cal, tmp_path / "b", settings, table="csv").frames > 0
    assert visible(tmp_path / "a") == visible(tmp_path / "b")


@pytest.mark.parametrize("form", FORMATS)
def test_the_depth_of_every_frame(written, results, tmp_path, form):
    import_extra(form)
    _, rows = written(form, keep=("depth",), sequence=EPISODE)
    for index, (row, result) in enumerate(zip(rows, results)):
        depth = depth_of_row(tmp_path, form, {"output": "", **row, "index": index})
        if result is None:
            assert depth is None
        else:
            assert np.abs(depth - result.depth_mm)[result.known].max() <= TO_THE_LEVEL_MM.get(form, 0.51e-4)


@pytest.mark.parametrize("form", FORMATS)
def test_the_same_bytes_twice_and_none_of_a_part_that_ended_early(written, tmp_path, form):
    import_extra(form)
    (a, rows), (b, same) = (written(form, sequence=EPISODE, folder=tmp_path / name) for name in ("a", "b"))
    assert (a.files, rows) == (b.files, same)
    with pytest.raises(KeyboardInterrupt):
        written(form, sequence=EPISODE, folder=tmp_path / "c", interrupted=True)
    if form in ("hdf5", "lerobot"):  # the others have files of their own that are done
        assert not [path for path in (tmp_path / "c").rglob("*") if path.is_file()]


@pytest.fixture
def nested(tree):
    """Images in a folder of a folder, with none above it."""
    (tree / "years" / "2026").mkdir(parents=True)
    (tree / "day2").rename(tree / "years" / "2026" / "day2")
    return tree / "years"


@pytest.mark.parametrize("form", WRITERS)
def test_temporary_files_go_wherever_a_killed_run_leaves_them(form, request, cal, tmp_path):
    source = request.getfixturevalue("lerobot")[0] if form == "lerobot" else request.getfixturevalue("nested")
    import_extra(form)
    settings, output = BatchSettings(form, keep=("depth",), part_frames=2), tmp_path / "out"
    chosen = {"dataset": "*"} if form == "lerobot" else {}
    run_batch(source, cal, output, settings, table="csv", **chosen)
    files = [path for path in output.rglob("*") if path.is_file() and path.suffix != ".lock"]
    left = [folder / ".gelform-0123456789ab.tmp" for folder in {path.parent for path in files}]
    for path in left:
        path.write_bytes(b"half")
    for record in output.glob("parts/**/*.json"):
        record.unlink()
    assert run_batch(source, cal, output, settings, table="csv", **chosen).complete
    assert [path for path in left if path.exists()] == []


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
    before = (tmp_path / "out/frames.h5").read_bytes()
    write_hdf5_index(tmp_path / "out", files, tree)
    assert (tmp_path / "out/frames.h5").read_bytes() == before


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize("part_frames", [5, 2 * 64])
def test_every_map_as_zarr_reads_it(zarr, written, results, tmp_path, counted, part_frames):
    written("zarr", keep=KEPT, counted=counted, part_frames=part_frames)
    assert_maps(dict(zarr.open_group(tmp_path / "frames", mode="r")["day/a"].arrays()), results)


def test_levels_as_zarr_reads_them(zarr, written, results, tmp_path):
    written("zarr", dtype="uint16", keep=("depth",), sequence="")
    array = zarr.open_array(tmp_path / "frames/depth_mm", mode="r")
    known, truth = results[1].known, results[1].depth_mm
    depth = array[1] * array.attrs["scale_factor"] + array.attrs["add_offset"]
    assert np.abs(depth - truth)[known].max() <= 0.51e-4
    np.testing.assert_array_equal(array[1] > 0, known)
    assert (array[2] == 0).all()


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


def video_of(folder, shape):
    part = Part(0, FilmRef(EPISODE, folder, rate_hz=10))
    return WRITERS["lerobot"].writer(PartTarget(folder, part, BatchSettings("lerobot"), shape, {}))


def test_levels_of_any_width_come_back_from_a_video(tmp_path):
    """Rows of odd widths are padded in memory."""
    av = pytest.importorskip("av", reason="the extra data is not installed")
    for shape in ((48, 64), (50, 70), (33, 41)):
        levels = np.random.default_rng(0).integers(0, 4096, (3, *shape), dtype=np.uint16)
        with video_of(tmp_path / f"{shape[0]}", shape) as video:
            for k, one in enumerate(levels):
                video.add(str(k), k, (one, None))
            assert not list((tmp_path / f"{shape[0]}").rglob("*.mp4"))
        with av.open(str(tmp_path / f"{shape[0]}" / video.files[0].path)) as file:
            frames = list(file.decode(video=0))
        assert [float(one.time) for one in frames] == pytest.approx([0, 0.1, 0.2])
        np.testing.assert_array_equal([one.to_ndarray(format="gray12le") for one in frames], levels)


def test_an_encoder_that_is_not_there(tmp_path, monkeypatch):
    import_extra("lerobot")
    monkeypatch.setattr("gelform.batch.outputs.lerobot.ENCODER", "nosuch")
    with pytest.raises(DataError, match="has no encoder nosuch"), video_of(tmp_path, (48, 64)):
        pass
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]

"""Every form gives back the depth that was written; a whole run is complete and verified, in any order and shards the same
bytes; damage is found."""

import numpy as np
import pytest

from gelform.batch import BatchSettings, RunOptions, run_batch, verify_output
from gelform.batch.outputs.writers import WRITERS, depth_of_row
from gelform.batch.settings import FORMATS

NEEDS = {"zarr": "numcodecs", "hdf5": "h5py", "ffv1": "av", "lerobot": "av"}
TO_THE_LEVEL_MM = {"lerobot": 0.501e-3}
EPISODE = "gel/episode_000001"


def import_extra(form):
    if form in NEEDS:
        pytest.importorskip(NEEDS[form], reason=f"the extra {form} is not installed")


def settings_of(form):
    import_extra(form)
    return BatchSettings(form, keep=("depth",), part_frames=2)


def test_every_form_has_a_writer():
    assert set(WRITERS) == set(FORMATS)


@pytest.mark.slow
@pytest.mark.parametrize("form", [form for form in FORMATS if form not in ("npz", "lerobot")])
def test_shards_and_repeated_parts_give_the_same_bytes(broken_tree, cal, tmp_path, visible, form):
    settings = settings_of(form)
    done = run_batch(broken_tree, cal, tmp_path / "a", settings, table="csv")
    assert (done.complete, done.frames, done.errors) == (True, 12, 4)
    for shard in ((2, 2), (1, 2)):
        last = run_batch(
            broken_tree, cal, tmp_path / "b", settings, options=RunOptions(shard=shard), table="csv"
        )
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


@pytest.mark.parametrize("form", ["zarr", "hdf5"])
def test_a_video_is_written_as_it_is_read(film, cal, tmp_path, form):
    settings = settings_of(form)
    assert run_batch(film, cal, tmp_path / "out", settings).complete
    assert verify_output(tmp_path / "out") == (4, 0, [])


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


def test_depth_that_was_not_kept(written, tmp_path):
    _, rows = written("npz", keep=("contact",))
    assert depth_of_row(tmp_path, "npz", {**rows[0], "index": 0}) is None


def test_a_whole_result(written, results, tmp_path):
    _, rows = written("npz", keep=("all",))
    depth = depth_of_row(tmp_path, "npz", {**rows[0], "index": 0})
    np.testing.assert_array_equal(depth, results[0].depth_mm)


@pytest.mark.parametrize("form", FORMATS)
def test_the_same_bytes_twice_and_none_of_a_part_that_ended_early(written, tmp_path, form):
    import_extra(form)
    (a, rows), (b, same) = (written(form, sequence=EPISODE, folder=tmp_path / name) for name in ("a", "b"))
    assert (a.files, rows) == (b.files, same)
    with pytest.raises(KeyboardInterrupt):
        written(form, sequence=EPISODE, folder=tmp_path / "c", interrupted=True)
    if form in ("hdf5", "ffv1", "lerobot"):  # the others have files of their own that are done
        assert not [path for path in (tmp_path / "c").rglob("*") if path.is_file()]

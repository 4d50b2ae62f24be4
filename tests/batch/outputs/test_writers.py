"""Every form: a whole run is complete and verified, in any order and shards the same bytes; damage is found."""

import pytest

from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.batch.outputs.writers import WRITERS
from gelform.batch.settings import FORMATS

NEEDS = {"zarr": "numcodecs", "hdf5": "h5py", "ffv1": "av"}


def settings_of(form):
    if form in NEEDS:
        pytest.importorskip(NEEDS[form], reason=f"the extra {form} is not installed")
    return BatchSettings(form, keep=("depth",), part_frames=2)


def test_every_form_has_a_writer():
    assert set(WRITERS) == set(FORMATS)


@pytest.mark.parametrize("form", [form for form in FORMATS if form not in ("npz", "lerobot")])
def test_shards_and_repeated_parts_give_the_same_bytes(broken_tree, cal, tmp_path, visible, form):
    settings = settings_of(form)
    done = run_batch(broken_tree, cal, tmp_path / "a", settings, table="csv")
    assert (done.complete, done.frames, done.errors) == (True, 12, 4)
    for shard in ((2, 2), (1, 2)):
        last = run_batch(broken_tree, cal, tmp_path / "b", settings, shard=shard, table="csv")
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

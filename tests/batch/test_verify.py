"""Whatever is done to an output is found."""

import shutil

import pytest

from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.batch.records import record_path
from gelform.errors import DataError


@pytest.fixture
def output(broken_tree, cal, tmp_path):
    run_batch(broken_tree, cal, tmp_path / "out", BatchSettings(part_frames=4), table="csv")
    return tmp_path / "out"


def flipped(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_whole(output):
    assert verify_output(output) == (8, 4, [])


def test_one_thing_is_wrong(output, tmp_path):
    for damage, said in [
        (lambda out: (out / "frames/frame1.npz").unlink(), "is missing"),
        (lambda out: (out / "frames/frame1.npz").write_bytes(b"12345"), "has 5 of"),
        (lambda out: flipped(out / "frames/frame1.npz"), "was altered"),
        (lambda out: (out / "frames/more.npz").write_bytes(b""), "no part knows of it"),
        (lambda out: flipped(out / "frames.csv"), "not what the parts say"),
        (lambda out: (out / "frames.csv").open("a").write("x"), "not what the parts say"),
        (lambda out: (out / "frames.csv").unlink(), "is missing or"),
        (lambda out: flipped(record_path(out, 0)), "is damaged. Delete it"),
    ]:
        shutil.copytree(output, damaged := tmp_path / "damaged")
        damage(damaged)
        _, _, problems = verify_output(damaged)
        assert said in problems[0].what
        shutil.rmtree(damaged)


def test_a_part_that_is_not_done(output):
    record_path(output, 2).unlink()
    assert "1 of 3 parts are not done" in verify_output(output)[2][0].what


def test_no_output_of_a_batch(tmp_path):
    with pytest.raises(DataError, match="Expected the output folder of gelform batch"):
        verify_output(tmp_path)

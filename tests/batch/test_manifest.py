"""A manifest: the same goes on, anything else is refused by name, a damaged one says what to do."""

import dataclasses
from contextlib import nullcontext

import pytest

from gelform.batch.manifest import Manifest, begin, only_run, read_manifest
from gelform.batch.settings import BatchSettings
from gelform.errors import DataError

THERE = Manifest(BatchSettings().facts(), "c", "b", "l", 3, 700)


@pytest.fixture
def output(tmp_path):
    begin(tmp_path, THERE, overwrite=False)
    return tmp_path


def test_the_same_goes_on(output):
    begin(output, THERE, overwrite=False)
    assert read_manifest(output) == THERE


def test_anything_else_is_refused_by_name(output):
    for field, value, said in [
        ("calibration_digest", "other", "the calibration"),
        ("background_digest", "other", "the background"),
        ("listing_digest", "other", "the list of input files"),
        ("gelform_version", "9.9", "the version of gelform"),
        ("settings", BatchSettings(form="png").facts(), r"the setting form \(npz then, png now\)"),
        ("settings", BatchSettings(keep=("depth",)).facts(), r"keep \(depth,known then, depth now\)"),
    ]:
        wanted = dataclasses.replace(THERE, **{field: value})
        with pytest.raises(DataError, match=said):
            begin(output, wanted, overwrite=False)
        assert read_manifest(output) == THERE
        (output / "frames").mkdir()
        (output / "frames" / "0.npz").write_bytes(b"old")
        begin(output, wanted, overwrite=True)
        assert read_manifest(output) == wanted
        assert not (output / "frames").exists()
        begin(output, THERE, overwrite=True)


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    for overwrite in (False, True):
        with pytest.raises(DataError, match=r"holds thesis\.tex, but no manifest"):
            begin(tmp_path, THERE, overwrite=overwrite)
    assert (tmp_path / "thesis.tex").exists()


def test_a_manifest_that_cannot_be_read_says_what_to_do(output):
    for content, said in (
        ("", "is damaged. Give another output folder, or begin anew with --overwrite"),
        ('{"format": "gelform batch", "format_ver', "is damaged"),
        ("[]", "is damaged"),
        ('{"format": "gelform batch", "format_version": 1}', "is damaged"),
        ('{"format": "a web app", "format_version": 1}', "is no manifest of a batch"),
        ('{"format": "gelform batch", "format_version": 9, "gelform_version": "7"}', "of gelform 7. Install"),
    ):
        (output / "manifest.json").write_text(content)
        with pytest.raises(DataError, match=said):
            begin(output, THERE, overwrite=False)


def test_who_may_run_together(tmp_path):
    pytest.importorskip("fcntl")
    whole = (1, 1)
    for first, second, together in (
        (whole, whole, False),
        (whole, (1, 2), False),
        ((1, 2), whole, False),
        ((1, 2), (2, 2), True),
        ((1, 2), (1, 2), False),
    ):
        refused = nullcontext() if together else pytest.raises(DataError, match=r"now\. Wait for it")
        with only_run(tmp_path, first), refused, only_run(tmp_path, second):
            pass
        with only_run(tmp_path, second) as alone:  # the lock is let go
            assert alone == (second == whole)

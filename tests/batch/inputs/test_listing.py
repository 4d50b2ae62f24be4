"""Which frames there are, in which order, and that what came or went is noticed."""

import pytest

from gelform.batch.inputs.listing import listing_of
from gelform.errors import DataError

NATURAL = ("frame1.png", "frame2.png", "frame10.png", "frame11.png")


def test_a_tree_in_natural_order(tree):
    listing = listing_of(tree)
    assert [(one.name, one.images) for one in listing.sequences] == [("", NATURAL), ("day2", NATURAL)]
    assert listing.searched


def test_videos_and_recordings_are_sequences_of_their_own(tree, film):
    (tree / "day2" / film.name).write_bytes(film.read_bytes())
    (tree / "day3.mcap").write_bytes(b"")
    recorded = tree / "recorded"
    recorded.mkdir()
    (recorded / "frames.csv").write_text("")
    (recorded / "recording.json").write_text("{}")
    names = [one.name for one in listing_of(tree).sequences]
    assert names == ["", "day3.mcap", "day2", "day2/press.avi", "recorded"]
    assert [one.name for one in listing_of(film).sequences] == ["press.avi"]


def test_a_pattern(tree):
    listing = listing_of(str(tree / "day*" / "frame1*.png"))
    assert [(one.name, one.images) for one in listing.sequences] == [
        ("day2", ("frame1.png", "frame10.png", "frame11.png"))
    ], "named as beside other days"
    assert [one.name for one in listing_of(str(tree / "**" / "*.png")).sequences] == ["", "day2"]


def test_hidden_files_others_and_the_background_are_no_frames(tree):
    (tree / ".frame0.png").write_bytes(b"")
    (tree / "notes.txt").write_text("")
    listing = listing_of(tree, leave_out=[tree / "frame2.png"])
    assert listing.sequences[0].images == ("frame1.png", "frame10.png", "frame11.png")


def test_the_digest_knows_names_alone(tree):
    before = listing_of(tree).digest
    (tree / "frame1.png").write_bytes(b"another content")
    assert listing_of(tree).digest == before
    (tree / "frame1.png").rename(tree / "frame3.png")
    assert listing_of(tree).digest != before


def test_nothing_to_do_is_said(tmp_path):
    with pytest.raises(DataError, match=r"No file or folder .*absent. Check the path"):
        listing_of(tmp_path / "absent")
    for source in (tmp_path, str(tmp_path / "*.png")):
        with pytest.raises(DataError, match=r"Expected images, videos or recordings .* got none"):
            listing_of(source)

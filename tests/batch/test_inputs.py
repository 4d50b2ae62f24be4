"""The list of frames: order, parts and unique names; an unreadable frame gets its error, and the others are done."""

from itertools import chain
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform import DataError, Frame
from gelform.batch import run_batch
from gelform.batch.inputs import (
    Listing,
    backgrounds_of,
    frames_of_part,
    listing_of,
    plan_of,
    shard_of,
)
from gelform.batch.records import read_manifest
from gelform.sensors.containers import FilmRef
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts

NATURAL = ("frame1.png", "frame2.png", "frame10.png", "frame11.png")


def test_a_tree_in_natural_order_without_hidden_files_others_and_the_background(tree):
    listing = listing_of(tree)
    assert [(one.name, one.images) for one in listing.sequences] == [("", NATURAL), ("day2", NATURAL)]
    assert listing.searched
    (tree / ".frame0.png").write_bytes(b"")
    (tree / "notes.txt").write_text("")
    listing = listing_of(tree, leave_out=[tree / "frame2.png"])
    assert listing.sequences[0].images == ("frame1.png", "frame10.png", "frame11.png")


def test_videos_and_recordings_are_sequences_of_their_own(tree, film):
    (tree / "day2" / film.name).write_bytes(film.read_bytes())
    (tree / "day3.mcap").write_bytes(b"")
    names = [one.name for one in listing_of(tree).sequences]
    assert names == ["", "day3.mcap", "day2", "day2/press.avi"]
    assert [one.name for one in listing_of(film).sequences] == ["press.avi"]


def test_a_pattern(tree):
    listing = listing_of(str(tree / "day*" / "frame1*.png"))
    assert [(one.name, one.images) for one in listing.sequences] == [
        ("day2", ("frame1.png", "frame10.png", "frame11.png"))
    ], "named as beside other days"
    assert [one.name for one in listing_of(str(tree / "**" / "*.png")).sequences] == ["", "day2"]


def test_digests_are_those_that_outputs_already_have(tree):
    """With others, each output that was begun would be refused, and each of its parts done again."""
    for path in tree.rglob("*.png"):
        path.write_bytes(path.name.encode())
    (tree / "a.h5").write_bytes(bytes(100))
    episode = FilmRef("a.h5/gel/000001", tree / "a.h5", dataset="gel", offset=3, count=5)
    listing = Listing(tree, (*listing_of(tree).sequences, episode))
    assert listing.digest[:8] == "92b21ff9"
    parts = plan_of(listing, 3, 1)
    digests = [part.input_digest()[:8] for part in parts]
    assert digests == ["439dd6b8", "e5a5f454", "2c7fa515", "2ce2fed2", "6dda209d", "0ee2f627"]
    (tree / "frame1.png").unlink()  # an image of the first part, and the background of both
    assert [part.input_digest()[:8] == one for part, one in zip(parts, digests)] == [False] * 2 + [True] * 4


def test_nothing_to_do_is_said(tmp_path):
    with pytest.raises(DataError, match=r"No file or folder .*absent. Check the path"):
        listing_of(tmp_path / "absent")
    for source in (tmp_path, str(tmp_path / "*.png")):
        with pytest.raises(DataError, match=r"Expected images, videos or recordings .* got none"):
            listing_of(source)


IMAGES = tuple(f"{k}.png" for k in range(10))
LISTING = Listing(Path(), (FilmRef("a", Path("a"), IMAGES, count=10), FilmRef("b.mp4", Path("b.mp4"))))


@pytest.mark.parametrize("name", ["../up", "demos.h5/data/../../up", "/etc/up", ".."])
def test_no_name_leads_out_of_the_output(name):
    with pytest.raises(DataError, match="leads out of any folder"):
        FilmRef(name, Path("demos.h5"), dataset="data")


def test_every_image_is_in_one_part_under_a_name_of_its_own():
    for part_frames in [1, 3, 5, 10, 256]:
        parts = plan_of(LISTING, part_frames)
        assert tuple(chain.from_iterable(part.film.images for part in parts)) == IMAGES
        assert [part.number for part in parts] == list(range(len(parts)))
        assert [IMAGES[part.start] for part in parts[:-1]] == [part.film.images[0] for part in parts[:-1]]
        assert (parts[-1].film.name, parts[-1].film.images) == ("b.mp4", ())
    images = ("a.jpg", "a.png", "b.png")
    parts = plan_of(Listing(Path(), (FilmRef("", Path(), images, count=3),)), 1)
    assert [part.names for part in parts] == [("a.jpg",), ("a.png",), ("b",)]


def test_shards_share_all_parts():
    for count in [1, 2, 3, 20]:
        parts = plan_of(LISTING, 2)
        shares = [shard_of(parts, (number, count)) for number in range(1, count + 1)]
        assert sorted(part.number for share in shares for part in share) == list(range(len(parts)))
    for shard in [(0, 2), (3, 2)]:
        with pytest.raises(DataError, match="Expected a shard from 1/2 to 2/2"):
            shard_of([], shard)


def parts_of(source, part_frames=256, background_frames=0):
    return plan_of(listing_of(source), part_frames, background_frames)


def test_images_in_their_order(tree, images):
    found = [(part, *one) for part in parts_of(tree, 3)[:2] for one in frames_of_part(part)]
    assert [part.name_of(index) for part, index, _ in found] == ["frame1", "frame2", "frame10", "frame11"]
    assert [index for _, index, _ in found] == [0, 1, 2, 3]
    for (_, _, frame), image in zip(found, images):
        np.testing.assert_array_equal(frame.image, image)


def test_a_video_and_a_damaged_one_which_is_one_frame_with_its_error(film, images):
    (part,) = parts_of(film)
    found = list(frames_of_part(part))
    assert [part.name_of(index) for index, _ in found] == ["000000", "000001", "000002", "000003"]
    assert np.abs(found[2][1].image.astype(int) - images[2]).max() <= 1
    assert found[2][1].time_s == pytest.approx(0.08)
    film.write_bytes(film.read_bytes()[:40])
    ((_, error),) = frames_of_part(parts_of(film)[0])
    assert "press.avi" in str(error)


def test_a_recording_with_its_times(tmp_path, images):
    recording = McapRecording(tmp_path / "a.mcap", RecordingFacts("camera"))
    for index, image in enumerate(images):
        recording.write(Frame(image, 5 + 0.1 * index, 1000 + index, 7 + index))
    recording.close()
    found = list(frames_of_part(parts_of(tmp_path / "a.mcap")[0]))
    assert [frame.wall_time_ns for _, frame in found] == [1000, 1001, 1002, 1003]
    assert found[3][1].time_s == pytest.approx(0.3)


def table(folder, *rows):
    path = folder / "rest.csv"
    path.write_text("\n".join(("sequence,background", *rows)) + "\n")
    return path


def test_each_sequence_has_the_background_that_the_table_names(two_lights, cal, tmp_path):
    rest = table(two_lights, "a,a/rest.png", "b,b/rest.png")
    run_batch(two_lights, cal, tmp_path / "own", background=rest)
    assert len(list((tmp_path / "own/frames").rglob("*.npz"))) == 2  # the backgrounds are no frames
    for name in "ab":
        image = gelform.read_image(two_lights / name / "0.png")
        expected = gelform.Reconstructor(cal, background=image).from_image(image).depth_mm
        with np.load(tmp_path / "own/frames" / name / "0.npz") as file:
            np.testing.assert_array_equal(file["depth_mm"], expected)
    swapped = table(two_lights, "a,b/rest.png", "b,a/rest.png")
    with pytest.raises(DataError, match="started with something else: the background"):
        run_batch(two_lights, cal, tmp_path / "own", background=swapped)


def test_tables_name_files_as_windows_and_sequences_as_the_batch_write_them(tmp_path):
    written = table(tmp_path, "a,a/rest.png", "b,b/rest.png")
    own = backgrounds_of(written)
    written.write_text("sequence;background\r\na;a\\rest.png\r\nb;b\\rest.png\r\n")
    assert backgrounds_of(written) == own
    found = backgrounds_of(table(tmp_path, "'=a,'-b/rest.png", "plain,rest.png")).by_sequence
    assert found == {"=a": tmp_path / "-b/rest.png", "plain": tmp_path / "rest.png"}


def test_a_table_that_names_one_file_for_all_is_that_file(two_lights, cal, tmp_path):
    same = table(two_lights, "a,a/rest.png", "b,a/rest.png")
    assert run_batch(two_lights, cal, tmp_path / "one", background=two_lights / "a/rest.png").frames == 3
    run_batch(two_lights, cal, tmp_path / "both", background=same, table="csv")
    kept = [tmp_path / name / "frames/b/0.npz" for name in ("one", "both")]
    assert kept[0].read_bytes() == kept[1].read_bytes()
    assert all(read_manifest(tmp_path / name).background_digest for name in ("one", "both"))


def test_refused_before_anything_is_written(two_lights, cal, tmp_path):
    for rows, said in [
        (["a,a/rest.png"], "has no row for 'b'"),
        (["a,a/rest.png", "b,b/rest.png", "c,a/rest.png"], "the input lacks, 'c'"),
        (["a,a/rest.png", "b,b/none.png"], "The background .*none.png"),
        (["a,a/rest.png", "a,b/rest.png"], "each sequence once"),
        (["a"], "Expected 2 fields, got 1"),
        ([], "columns sequence and background"),
    ]:
        with pytest.raises(DataError, match=said):
            run_batch(two_lights, cal, tmp_path / "out", background=table(two_lights, *rows))
        assert not (tmp_path / "out").exists()
    with pytest.raises(DataError, match=r"No file .*rest\.csv"):
        backgrounds_of(tmp_path / "rest.csv")

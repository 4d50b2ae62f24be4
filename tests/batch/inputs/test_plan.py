"""Parts: every image once, the same whatever the shards, names that are told apart."""

from itertools import chain
from pathlib import Path

import pytest

from gelform.batch.inputs.containers import Sequence
from gelform.batch.inputs.listing import Listing, listing_of
from gelform.batch.inputs.plan import plan_of, shard_of
from gelform.errors import DataError

IMAGES = tuple(f"{k}.png" for k in range(10))
LISTING = Listing(Path(), (Sequence("a", Path("a"), IMAGES), Sequence("b.mp4", Path("b.mp4"))))


def test_every_image_is_in_one_part():
    for part_frames in [1, 3, 5, 10, 256]:
        parts = plan_of(LISTING, part_frames)
        assert tuple(chain.from_iterable(part.images for part in parts)) == IMAGES
        assert [part.number for part in parts] == list(range(len(parts)))
        assert [IMAGES[part.start] for part in parts[:-1]] == [part.images[0] for part in parts[:-1]]
        assert (parts[-1].sequence, parts[-1].images) == ("b.mp4", ())


def test_shards_share_all_parts():
    for count in [1, 2, 3, 20]:
        parts = plan_of(LISTING, 2)
        shares = [shard_of(parts, (number, count)) for number in range(1, count + 1)]
        assert sorted(part.number for share in shares for part in share) == list(range(len(parts)))


def test_no_such_shard():
    for shard in [(0, 2), (3, 2)]:
        with pytest.raises(DataError, match="Expected a shard from 1/2 to 2/2"):
            shard_of([], shard)


def test_a_suffix_stays_where_it_alone_tells_two_images_apart():
    images = ("a.jpg", "a.png", "b.png")
    parts = plan_of(Listing(Path(), (Sequence("", Path(), images),)), 1)
    assert [part.names for part in parts] == [("a.jpg",), ("a.png",), ("b",)]


def test_the_digest_of_a_part_follows_its_own_files_and_its_background(tree):
    def digests(background_frames):
        return [part.input_digest() for part in plan_of(listing_of(tree), 2, background_frames)]

    before, with_background = digests(0), digests(1)
    (tree / "frame1.png").write_bytes(b"of another size")
    assert [a == b for a, b in zip(digests(0), before)] == [False, True, True, True]
    assert [a == b for a, b in zip(digests(1), with_background)] == [False, False, True, True]


def test_a_file_that_goes_changes_the_digest(tree):
    part = plan_of(listing_of(tree), 256)[0]
    before = part.input_digest()
    (tree / "frame1.png").unlink()
    assert part.input_digest() != before

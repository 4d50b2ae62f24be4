"""A multipart stream cut into its parts, however its bytes arrive."""

import pytest

from gelform.sensors.mjpeg.parts import MAX_PART_BYTES, PartSplitter
from made.mjpeg_server import part

BODIES = [b"\xff\xd8one\xff\xd9", b"\xff\xd8" + bytes(3000) + b"\xff\xd9", b"\xff\xd8--fra\r\n\xff\xd9"]


@pytest.mark.parametrize("with_length", [True, False])
@pytest.mark.parametrize("size", [1, 7, 1000, 10**6])
def test_parts_come_out_whole_however_they_arrive(with_length, size):
    stream = b"".join(part(body, with_length) for body in BODIES) + b"--frame\r\n"
    splitter = PartSplitter("frame")
    found = [one for at in range(0, len(stream), size) for one in splitter.feed(stream[at : at + size])]
    assert found == BODIES


def test_servers_disagree_about_the_dashes():
    stream = part(BODIES[0], False, "--frame") + part(BODIES[1], False, "--frame") + b"----frame\r\n"
    for boundary in ("--frame", "frame", '"--frame"', "----frame"):
        assert PartSplitter(boundary).feed(stream) == BODIES[:2]


def test_a_part_longer_than_it_says_is_given_torn_and_the_next_one_whole():
    lying = part(BODIES[1]).replace(b"Content-Length: 3004", b"Content-Length: 1000")
    found = PartSplitter("frame").feed(lying + part(BODIES[0]))
    assert [len(one) for one in found] == [1000, len(BODIES[0])]
    assert found[1] == BODIES[0]


def test_bytes_without_a_boundary_are_refused():
    with pytest.raises(ValueError, match="64 MB"):
        PartSplitter("frame").feed(bytes(MAX_PART_BYTES + 1))

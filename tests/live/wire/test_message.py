"""Messages of the page: what is written is read again, at the alignment that typed arrays want."""

import numpy as np
import pytest

from gelform.errors import DataError
from gelform.live.wire import image_plane, message, read_message
from gelform.live.wire.planes import bits_plane, depth_plane

DEPTH = np.linspace(-0.1, 0.6, 35, dtype=np.float32).reshape(5, 7)


def test_planes_come_back_by_name():
    image = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    data = message({"serial": 4}, [image_plane(image, "raw"), depth_plane(DEPTH, "raw")])
    header, planes = read_message(data)
    assert header["serial"] == 4
    assert planes["image"] == image.tobytes()
    depth = header["planes"][1]
    levels = np.frombuffer(planes["depth"], np.uint16).reshape(depth["height"], depth["width"])
    np.testing.assert_allclose(
        (levels.astype(float) - depth["zero"]) * depth["step"], DEPTH, atol=0.51 * depth["step"]
    )


def test_planes_are_aligned_for_typed_arrays():
    odd = bits_plane("flags", np.ones((3, 5), np.uint8), "raw")
    data = message({"a": "ä"}, [odd, depth_plane(DEPTH, "raw")])
    header, _ = read_message(data)
    start = 8 + int.from_bytes(data[4:8], "little")
    assert all((start + plane["offset"]) % 8 == 0 for plane in header["planes"])


@pytest.mark.parametrize("cut", [0, 3, 7, 20, -1])
def test_torn_messages_are_refused(cut):
    data = message({}, [depth_plane(DEPTH, "raw")])
    with pytest.raises((DataError, ValueError)):
        read_message(data[: cut if cut >= 0 else len(data) - 8])


def test_other_bytes_are_refused():
    with pytest.raises(DataError, match="other bytes"):
        read_message(b"GET / HTTP/1.1\r\n")

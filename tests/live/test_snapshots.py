"""Files of a frame: read back with the usual tools."""

import numpy as np
import pytest

import gelform
from gelform.errors import GelformError
from gelform.live.shown import Shown
from gelform.live.snapshots import KEPT, Snapshots


@pytest.fixture
def saved(shown, tmp_path):
    """name -> the path of the file as a browser would save it."""
    snapshots = Snapshots()
    number = snapshots.add(shown)

    def save(name):
        path = tmp_path / snapshots.file(number, name)[0]
        path.write_bytes(snapshots.file(number, name)[1])
        return path

    return save


def test_the_result_loads_and_the_frame_is_the_cameras_in_rgb(saved, result, press):
    np.testing.assert_array_equal(gelform.load_result(saved("result.npz")).depth_mm, result.depth_mm)
    np.testing.assert_array_equal(gelform.read_image(saved("frame.png")), press.image)


def test_old_ones_go_and_unknown_files_are_refused(shown):
    snapshots = Snapshots()
    first = snapshots.add(shown)
    for _ in range(KEPT):
        last = snapshots.add(shown)
    for number, name in ((first, "result.npz"), (last, "../result.npz"), (99, "frame.png")):
        with pytest.raises(GelformError, match="no longer kept"):
            snapshots.file(number, name)


def test_a_frame_without_a_result_has_its_image(shown):
    snapshots = Snapshots()
    number = snapshots.add(Shown(1, shown.frame, shown.image))
    assert snapshots.file(number, "frame.png")[1].startswith(b"\x89PNG")
    with pytest.raises(GelformError, match="no result"):
        snapshots.file(number, "result.npz")

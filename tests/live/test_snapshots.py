"""Files of a frame: read back with the usual tools."""

import cv2
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


def test_depth_has_16_bits(saved, result):
    levels = cv2.imread(str(saved("depth.png")), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    depth = (levels.astype(float) - 32768) * 1e-4
    np.testing.assert_allclose(depth[result.known], result.depth_mm[result.known], atol=0.51e-4)
    assert not levels[~result.known].any()


def test_points_are_in_the_cameras_frame(saved, result):
    content = saved("points.ply").read_bytes()
    header, body = content.split(b"end_header\n", 1)
    assert b"binary_little_endian" in header
    points = np.frombuffer(body, "<f4").reshape(-1, 7)
    assert len(points) == result.known.sum()
    deepest = points[points[:, 2].argmin()]
    row, column = np.unravel_index(result.depth_mm.argmax(), result.shape)
    expected = [column * result.mm_per_px, row * result.mm_per_px, -result.peak_mm]
    np.testing.assert_allclose(deepest[:3], expected, rtol=1e-5)
    assert (points[:, 5] < 0).all()  # normals toward the camera, whose z points away from it


def test_without_a_background_of_the_page_there_is_none_to_fetch(shown):
    snapshots = Snapshots()
    assert "background.png" not in snapshots.names(snapshots.add(shown))
    shown.background = np.full((*shown.image.shape[:2], 3), 80.4, np.float32)
    number = snapshots.add(shown)
    assert "background.png" in snapshots.names(number)
    _, content = snapshots.file(number, "background.png")
    assert (cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) == 80).all()


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
    assert snapshots.names(number) == ["frame.png"]
    with pytest.raises(GelformError, match="no result"):
        snapshots.file(number, "points.ply")

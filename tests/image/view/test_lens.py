"""A lens shows a plane where the formula says, and is undone exactly."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gelform.image.view import Lens, View, frame_px_from_image_px, image_from_frame, image_px_from_frame_px

CAMERA = (220.0, 210.0, 158.0, 121.0)


def test_distortion_is_browns():
    """Worked out from the formula: radial and decentring terms, then the camera matrix."""
    lens = Lens(CAMERA, (-0.2, 0.05, 0.003, -0.002, 0.01))
    x, y = (250.0 - 158) / 220, (40.0 - 121) / 210
    r2 = x * x + y * y
    radial = 1 - 0.2 * r2 + 0.05 * r2**2 + 0.01 * r2**3
    xd = x * radial + 2 * 0.003 * x * y - 0.002 * (r2 + 2 * x * x)
    yd = y * radial + 0.003 * (r2 + 2 * y * y) + 2 * -0.002 * x * y
    seen = lens.frame_px_from_rectified_px(np.array([[250.0, 40.0]]))[0]
    np.testing.assert_allclose(seen, [220 * xd + 158, 210 * yd + 121], atol=1e-9)


def test_a_principal_point_may_lie_outside_the_frame():
    """Of a frame cut from a larger one."""
    points = np.array([[250.0, 40.0], [10.0, 200.0]])
    seen = Lens((220.0, 210.0, -158.0, -121.0)).frame_px_from_rectified_px(points)
    np.testing.assert_allclose(seen, points, atol=1e-9)


def test_perspective_comes_first():
    homography = (1.02, 0.03, -4.0, -0.02, 0.97, 3.0, 1e-4, -2e-4, 1.0)
    x, y, w = np.reshape(homography, (3, 3)) @ [100.0, 200.0, 1.0]
    seen = Lens(CAMERA, (), homography).frame_px_from_rectified_px(np.array([[100.0, 200.0]]))[0]
    np.testing.assert_allclose(seen, [x / w, y / w], atol=1e-9)


numbers = st.floats(-1, 1)


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[numbers] * 10))
def test_every_point_comes_back(u):
    distortion = (0.25 * u[0], 0.05 * u[1], 0.01 * u[2], 0.01 * u[3])
    tilt = (
        1 + 0.1 * u[4],
        0.1 * u[5],
        10 * u[6],
        0.1 * u[7],
        1 + 0.1 * u[4],
        10,
        3e-4 * u[8],
        3e-4 * u[9],
        1,
    )
    lens = Lens(CAMERA, distortion, tilt)
    points = np.random.default_rng(0).uniform([40, 30], [280, 210], (50, 2))
    flat = Lens(CAMERA, (), tilt).frame_px_from_rectified_px(points)
    square = np.sum(((flat - CAMERA[2:]) / CAMERA[:2]) ** 2, axis=1)
    unfolded = 1 + 3 * distortion[0] * square + 5 * distortion[1] * square**2
    assume(unfolded.min() > 0.2)  # beyond a fold two points are seen at one place
    back = lens.rectified_px_from_frame_px(lens.frame_px_from_rectified_px(points))
    np.testing.assert_allclose(back, points, atol=1e-6)


VIEWS = [
    View((240, 320), lens=Lens(CAMERA, (-0.2, 0.03))),
    View((240, 320), (20, 15, 280, 200), "x", lens=Lens(CAMERA, (-0.2, 0.03))),
    View((240, 320), (20, 15, 280, 200), "xy", (100, 140), Lens(CAMERA, (0.1,))),
    View((240, 320), (20.5, 15, 280, 200), "y", (100, 140)),
]


@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_points_of_image_and_frame_are_inverse(view):
    points = np.random.default_rng(1).uniform([5, 5], [view.shape[1] - 5, view.shape[0] - 5], (30, 2))
    there = frame_px_from_image_px(points, view)
    np.testing.assert_allclose(image_px_from_frame_px(there, view), points, atol=1e-6)


@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_the_image_shows_what_the_points_say(view):
    """A smooth pattern of the frame is seen in the image at the place that the point maps give."""

    def pattern(x, y):
        return 120 + 60 * np.sin(x / 25) * np.cos(y / 20)

    y, x = np.mgrid[:240, :320]
    frame = np.repeat(pattern(x, y)[..., None], 3, axis=-1).astype(np.float32)
    image = image_from_frame(frame, view)
    rows, columns = np.mgrid[8 : view.shape[0] - 8 : 7, 8 : view.shape[1] - 8 : 7]
    there = frame_px_from_image_px(np.stack([columns.ravel(), rows.ravel()], axis=1), view)
    inside = ((there > 2) & (there < [317, 237])).all(axis=1)
    assert inside.mean() > 0.8
    expected = pattern(there[:, 0], there[:, 1])[inside]
    assert np.abs(image[rows.ravel(), columns.ravel(), 0][inside] - expected).max() < 1.2


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"camera": [1, 2, 3]}, "camera as 4 numbers, got 3"),
        ({"camera": [*CAMERA, 1]}, "camera as 4 numbers, got 5"),
        ({"camera": [0, 200, 1, 1]}, "focal lengths > 0"),
        ({"camera": [200, 0, 1, 1]}, "focal lengths > 0"),
        ({"camera": CAMERA, "perspective": [1, 0, 0, 0, 1, 0, 0, 0, 1, 0]}, "9 numbers, got 10"),
        ({"camera": CAMERA, "distortion": [0] * 8}, "up to 5 numbers, got 8"),
        ({"camera": CAMERA, "perspective": [1, 0, 0, 1, 0, 0, 0, 0, 1]}, "singular"),
        ({"camera": CAMERA, "distortion": ["a"]}, "distortion as numbers"),
        ({"distortion": [0.1]}, "camera is needed"),
        ({"camera": CAMERA, "k1": 1}, "among camera, distortion, perspective"),
    ],
)
def test_wrong_lenses_are_refused(given, text):
    with pytest.raises(ValueError, match=text):
        View.from_dict({"frame_shape": [240, 320], "lens": given})

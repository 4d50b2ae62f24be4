"""A view maps pixel areas: what is seen stays where it was to a fraction of a pixel, there and back.

A lens shows a plane where the formula says, and is undone exactly. Frames, and the identity of their pixels.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gelform.image.view import (
    FLIPS,
    Lens,
    View,
    _maps_to_image,
    averaged,
    frame_px_from_image_px,
    image_from_frame,
    image_px_from_frame_px,
    pixel_positions,
    pixels_digest,
)
from made.images import frame_from_image


def ramp(shape, *, per_x=0.31, per_y=0.17, start=40.0):
    """A picture linear in the pixel's area center: a point of the world has the same value in every size."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    plane = start + per_x * x + per_y * y
    return np.stack([plane, plane / 2, 255 - plane], axis=-1).astype(np.float32)


def ramp_seen_through(view):
    """The same picture as the view's image must show it, worked out on paper."""
    height, width = view.shape
    left, top, crop_width, crop_height = view.crop or (0, 0, view.frame_shape[1], view.frame_shape[0])
    y, x = np.mgrid[:height, :width].astype(float)
    x = width - 1 - x if "x" in view.flip else x
    y = height - 1 - y if "y" in view.flip else y
    plane = (
        40 + 0.31 * ((x + 0.5) * crop_width / width + left) + 0.17 * ((y + 0.5) * crop_height / height + top)
    )
    return np.stack([plane, plane / 2, 255 - plane], axis=-1)


VIEWS = [
    View((48, 64), flip="x"),
    View((48, 64), flip="y"),
    View((48, 64), crop=(5, 7, 40, 30)),
    View((48, 64), crop=(5.25, 7.5, 40, 30), flip="xy"),
    View((48, 64), image_shape=(24, 32)),
    View((48, 64), image_shape=(96, 128)),
    View((300, 400), crop=(57.1, 42.9, 285.7, 214.3), image_shape=(24, 32)),
    View((300, 400), crop=(57.1, 42.9, 285.7, 214.3), image_shape=(40, 60), flip="x"),
    View((301, 403), image_shape=(20, 30)),
]
IDEAL = Lens((380.0, 390.0, 190.0, 160.0))  # without distortion, straight above: it shows what no lens shows


@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_a_plane_is_seen_where_it_is(view):
    seen = ramp_seen_through(view)
    for lens in (None, IDEAL):
        image = image_from_frame(ramp(view.frame_shape), replace(view, lens=lens))
        # remap places a sample to 1/32 px; half a pixel of shift would be 0.15 gray levels per unit of scale
        scale = max(1, view.frame_shape[1] / view.shape[1])
        assert np.abs(image - seen)[1:-1, 1:-1].max() < 0.02 * scale
        assert image.shape == (*view.shape, 3)
    x, y = frame_px_from_image_px(pixel_positions(view.shape), view).T
    plane = (40 + 0.31 * (x + 0.5) + 0.17 * (y + 0.5)).reshape(view.shape)
    np.testing.assert_allclose(plane, seen[..., 0], atol=1e-9)


def test_maps_that_threads_share_are_read_only():
    for lens in (None, IDEAL):
        maps = _maps_to_image(replace(VIEWS[3], lens=lens))[2:]
        assert not any(one.flags.writeable for one in maps)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_frame_from_image_is_undone(data):
    height, width = data.draw(st.integers(20, 80)), data.draw(st.integers(20, 80))
    left, top = data.draw(st.floats(0, 8)), data.draw(st.floats(0, 8))
    crop = (left, top, data.draw(st.floats(10, width - left)), data.draw(st.floats(10, height - top)))
    shape = data.draw(st.integers(8, 90)), data.draw(st.integers(8, 90))
    view = View((height, width), crop, data.draw(st.sampled_from(FLIPS)), shape)
    assume(view.shape != view.frame_shape)
    image = ramp(view.shape)
    again = image_from_frame(frame_from_image(image, view), view)
    # the outermost image pixel can lie between the last seen frame pixel and its repetition
    slack = max(1, int(np.ceil(2 * max(shape[0] / crop[3], shape[1] / crop[2]))))
    inner = np.s_[slack:-slack, slack:-slack]
    assert np.abs(again - image)[inner].max(initial=0) < 0.1


def test_flips_and_whole_pixel_crops_are_exact():
    for flip in FLIPS:
        frame = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
        image = image_from_frame(frame, View((30, 40), (4, 3, 20, 10), flip))
        expected = frame[3:13, 4:24]
        expected = expected[:, ::-1] if "x" in flip else expected
        expected = expected[::-1] if "y" in flip else expected
        assert np.array_equal(image, expected)
        assert image.dtype == np.uint8


def test_reducing_by_a_whole_number_averages_areas():
    frame = np.random.default_rng(0).uniform(0, 255, (28, 42, 3)).astype(np.float32)
    areas = frame.reshape(4, 7, 6, 7, 3).mean(axis=(1, 3))
    assert np.allclose(image_from_frame(frame, View((28, 42), image_shape=(4, 6))), areas, atol=1e-3)
    through = image_from_frame(frame, View((28, 42), image_shape=(4, 6), lens=IDEAL))
    assert np.allclose(through[1:-1, 1:-1], areas[1:-1, 1:-1], atol=1e-2)


def test_reducing_strongly_does_not_alias():
    for lens in (None, IDEAL):
        stripes = np.zeros((480, 640, 3), dtype=np.uint8)
        stripes[:, ::2] = 200
        image = image_from_frame(stripes, View((480, 640), (3.3, 2.2, 600, 450), "none", (60, 80), lens))
        assert np.abs(image.astype(float) - 100)[1:-1, 1:-1].max() < 15
        plain = cv2.resize(stripes, (80, 60), interpolation=cv2.INTER_NEAREST)
        assert np.abs(plain.astype(float) - 100).max() == 100


def test_a_flip_alone_takes_frames_of_any_size():
    for flip in FLIPS:
        for shape in ((30, 40), (31, 17)):
            frame = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
            view = View(flip=flip)
            image = image_from_frame(frame, view)
            np.testing.assert_array_equal(image, image_from_frame(frame, View(shape, flip=flip)))
            assert view.is_identity == (flip == "none")
            points = np.array([[0.0, 0.0], [3.0, 5.0]])
            np.testing.assert_array_equal(
                frame_px_from_image_px(points, view.of_frames(shape)),
                frame_px_from_image_px(points, View(shape, flip=flip)),
            )
            if flip != "none":
                with pytest.raises(ValueError, match="of_frames"):
                    frame_px_from_image_px(points, view)


def test_identity_passes_the_frame_itself():
    frame = np.zeros((12, 16, 3), dtype=np.uint8)
    assert image_from_frame(frame, View()) is frame
    assert image_from_frame(frame, View((12, 16))) is frame
    assert View((12, 16), crop=(0, 0, 16, 12), image_shape=(12, 16)).is_identity


def test_images_pass_and_frames_of_another_size_are_refused():
    view = View((48, 64), image_shape=(24, 32))
    image = np.zeros((24, 32, 3), dtype=np.uint8)
    assert image_from_frame(image, view) is image, "an image already"
    with pytest.raises(
        ValueError, match=r"frame of 48x64 px .*, or an image of .* px made of it, got 20x30\. Set the"
    ):
        image_from_frame(np.zeros((20, 30, 3), dtype=np.uint8), view)
    with pytest.raises(ValueError, match="gray"):
        image_from_frame(np.zeros((48, 64), dtype=np.uint8), view)


def test_settings_come_back():
    for view in (View(), *VIEWS, replace(VIEWS[3], lens=Lens((220.0, 210.0, 30.0, 20.0), (-0.2, 0.03)))):
        settings = view.to_dict()
        assert View.from_dict(settings) == view
        assert all(value is not None for value in settings.values())  # TOML has no null
        assert hash(View.from_dict(settings)) == hash(view)


def test_a_quarter_turn_is_exact_and_undone():
    frame = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    for turn, quarters in (("left", 1), ("right", -1)):
        view = View((30, 40), crop=(4, 6, 32, 20), flip="x", image_shape=(16, 10), turn=turn)
        assert view.shape == (16, 10)
        lying = View((30, 40), crop=(4, 6, 32, 20), flip="x", image_shape=(10, 16))
        image = image_from_frame(frame, view)
        np.testing.assert_array_equal(image, np.rot90(image_from_frame(frame, lying), quarters))
        assert image.flags.c_contiguous
        assert View.from_dict(view.to_dict()) == view


@pytest.mark.parametrize("turn", ["none", "left", "right"])
@pytest.mark.parametrize("flip", FLIPS)
@pytest.mark.parametrize("pitch", [(0.04, 0.05), (0.05, 0.04), (0.03, 0.0537)])
def test_squared_pixels_are_as_wide_as_high(pitch, flip, turn):
    """A step of one image pixel along x and along y is as long on the gel, and the whole view stays in sight."""
    view = View((97, 141), (3.5, 2.0, 130.0, 91.0), flip, turn=turn)
    squared = view.squared(pitch)
    at = frame_px_from_image_px([(0, 0), (1, 0), (0, 1), squared.shape[::-1]], squared)
    in_frame = pitch if turn == "none" else pitch[::-1]
    steps = np.linalg.norm((at[1:3] - at[0]) * in_frame, axis=1)
    np.testing.assert_allclose(steps, max(pitch), rtol=1e-9)
    left, top, width, height = squared.crop
    assert (left + width / 2, top + height / 2) == pytest.approx((3.5 + 130 / 2, 2 + 91 / 2))
    lost = (130 - width) * in_frame[0], (91 - height) * in_frame[1]
    assert 0 <= min(lost) <= max(lost) < max(pitch)
    assert image_from_frame(np.zeros((97, 141, 3), np.uint8), squared).shape[:2] == squared.shape


def test_averages_are_means_of_boxes_and_repeat_the_border():
    pixels = np.random.default_rng(0).uniform(0, 255, (7, 9, 3)).astype(np.float32)
    assert averaged(pixels, (1, 1)) is pixels
    small = averaged(pixels, (2, 3))
    assert small.shape == (4, 3, 3)
    np.testing.assert_allclose(small[:3], pixels[:6].reshape(3, 2, 3, 3, 3).mean(axis=(1, 3)), rtol=1e-5)
    np.testing.assert_allclose(small[3], pixels[6].reshape(3, 3, 3).mean(axis=1), rtol=1e-5)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_an_enlarged_image_repeats_the_frame_s_border(dtype):
    frame = ramp((12, 16), per_x=2, per_y=1).astype(dtype)
    image = image_from_frame(frame, View((12, 16), image_shape=(48, 64)))
    assert image.dtype == dtype
    np.testing.assert_array_equal(image[::47, ::63], frame[::11, ::15])


CAMERA = (220.0, 210.0, 158.0, 121.0)


def test_distortion_is_browns_after_the_perspective():
    """Worked out from the formula: radial and decentring terms, then the camera matrix."""
    lens = Lens(CAMERA, (-0.2, 0.05, 0.003, -0.002, 0.01))
    x, y = (250.0 - 158) / 220, (40.0 - 121) / 210
    r2 = x * x + y * y
    radial = 1 - 0.2 * r2 + 0.05 * r2**2 + 0.01 * r2**3
    xd = x * radial + 2 * 0.003 * x * y - 0.002 * (r2 + 2 * x * x)
    yd = y * radial + 0.003 * (r2 + 2 * y * y) + 2 * -0.002 * x * y
    seen = lens.frame_px_from_rectified_px(np.array([[250.0, 40.0]]))[0]
    np.testing.assert_allclose(seen, [220 * xd + 158, 210 * yd + 121], atol=1e-9)
    homography = (1.02, 0.03, -4.0, -0.02, 0.97, 3.0, 1e-4, -2e-4, 1.0)
    x, y, w = np.reshape(homography, (3, 3)) @ [100.0, 200.0, 1.0]
    seen = Lens(CAMERA, (), homography).frame_px_from_rectified_px(np.array([[100.0, 200.0]]))[0]
    np.testing.assert_allclose(seen, [x / w, y / w], atol=1e-9)


numbers = st.floats(-1, 1)


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[numbers] * 10))
def test_every_point_comes_back(u):
    a, b, c, d, e, f, g, h, i, j = u
    distortion = (0.25 * a, 0.05 * b, 0.01 * c, 0.01 * d)
    tilt = (1 + 0.1 * e, 0.1 * f, 10 * g, 0.1 * h, 1 + 0.1 * e, 10, 3e-4 * i, 3e-4 * j, 1)
    lens = Lens(CAMERA, distortion, tilt)
    points = np.random.default_rng(0).uniform([40, 30], [280, 210], (50, 2))
    flat = Lens(CAMERA, (), tilt).frame_px_from_rectified_px(points)
    square = np.sum(((flat - CAMERA[2:]) / CAMERA[:2]) ** 2, axis=1)
    unfolded = 1 + 3 * distortion[0] * square + 5 * distortion[1] * square**2
    assume(unfolded.min() > 0.2)  # beyond a fold two points are seen at one place
    back = lens.rectified_px_from_frame_px(lens.frame_px_from_rectified_px(points))
    np.testing.assert_allclose(back, points, atol=1e-6)


LENS = Lens(CAMERA, (-0.2, 0.03))


@pytest.mark.parametrize(
    "view",
    [
        View((240, 320), lens=LENS),
        View((240, 320), (20, 15, 280, 200), "x", lens=LENS),
        View((240, 320), (20, 15, 280, 200), "xy", (100, 140), Lens(CAMERA, (0.1,))),
        View((240, 320), (20.5, 15, 280, 200), "y", (100, 140)),
        View((240, 320), (20, 15, 280, 200), "x", (140, 100), LENS, "left"),
        View((240, 320), (20, 15, 280, 200), "y", turn="right"),
    ],
    ids=str,
)
def test_the_image_shows_what_the_points_say_and_they_come_back(view):
    """A smooth pattern of the frame is seen in the image at the place that the point maps give."""

    def pattern(x, y):
        return 120 + 60 * np.sin(x / 25) * np.cos(y / 20)

    frame = pattern(*pixel_positions((240, 320)).T).reshape(240, 320, 1).repeat(3, -1).astype(np.float32)
    image = image_from_frame(frame, view)
    columns, rows = (axis.ravel() for axis in np.mgrid[8 : view.shape[1] - 8 : 7, 8 : view.shape[0] - 8 : 7])
    points = np.stack([columns, rows], axis=1)
    there = frame_px_from_image_px(points, view)
    np.testing.assert_allclose(image_px_from_frame_px(there, view), points, atol=1e-6)
    inside = ((there > 2) & (there < [317, 237])).all(axis=1)
    assert inside.mean() > 0.8
    assert np.abs(image[rows, columns, 0] - pattern(*there.T))[inside].max() < 1.2


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"frameshape": [1, 2]}, "among frame_shape, crop, flip, image_shape, lens, turn, got frameshape"),
        ({"flip": "z"}, "none, x, y, xy, got 'z'"),
        *(({"turn": turn}, "turn among none, left, right, got") for turn in ("up", [], np.zeros(2), None)),
        ({"frame_shape": None, "crop": [0, 0, 4, 4]}, "Expected frame_shape"),
        ({"frame_shape": [4]}, r"\(height, width\)"),
        ({"frame_shape": [4, 0]}, "whole numbers"),
        ({"frame_shape": [4, 4.5]}, "whole numbers"),
        ({"frame_shape": "big"}, r"\(height, width\)"),
        ({"crop": [0, 0, 5, 4]}, "ending at column 5 and row 4"),
        ({"crop": [0, 0, 0.99, 4]}, "size >= 1 px"),
        ({"crop": [0, 0, 4, 1e-9]}, "size >= 1 px"),
        ({"crop": [-1, 0, 4, 4]}, "left, top >= 0"),
        ({"crop": [0, -1, 4, 4]}, "left, top >= 0"),
        ({"crop": [0, 0, float("nan"), 4]}, "left, top, width, height"),
        ({"lens": {"camera": [1, 2, 3]}}, r"camera as 4 finite numbers, got \[1, 2, 3\]"),
        ({"lens": {"camera": [*CAMERA, 1]}}, "camera as 4 finite numbers"),
        ({"lens": {"camera": [0, 200, 1, 1]}}, "focal lengths > 0"),
        ({"lens": {"camera": [200, 0, 1, 1]}}, "focal lengths > 0"),
        ({"lens": {"camera": CAMERA, "perspective": [1, 0, 0, 0, 1, 0, 0, 0, 1, 0]}}, "9 finite numbers"),
        ({"lens": {"camera": CAMERA, "distortion": [0] * 6}}, "up to 5 finite numbers"),
        ({"lens": {"camera": CAMERA, "perspective": [1, 0, 0, 1, 0, 0, 0, 0, 1]}}, "singular"),
        ({"lens": {"camera": CAMERA, "distortion": ["a"]}}, r"distortion as .* numbers, got \['a'\]"),
        ({"lens": {"distortion": [0.1]}}, "camera is needed"),
        ({"lens": {"camera": CAMERA, "k1": 1}}, "among camera, distortion, perspective"),
        ({"lens": 3}, "a lens as a table"),
    ],
    ids=str,
)
def test_wrong_settings_are_refused(wrong, text):
    with pytest.raises(ValueError, match=text):
        View.from_dict({"frame_shape": [4, 4], **wrong})


def test_the_digest_is_of_values_shape_and_dtype_and_not_of_the_layout():
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    changed = image.copy()
    changed[1, 2, 0] += 1
    others = changed, image.reshape(4, 2, 3), image.astype(np.float32), image[:, ::-1]
    assert len({pixels_digest(one) for one in (image, *others)}) == 5
    assert pixels_digest(image.copy()) == pixels_digest(image)
    assert pixels_digest(image[:, ::-1]) == pixels_digest(np.ascontiguousarray(image[:, ::-1]))
    assert len(pixels_digest(image)) == 64


@pytest.mark.parametrize("form", [lambda m: m.ravel().tolist(), np.ndarray.tolist])
def test_the_matrix_of_opencv_rectifies_as_it_does(form):
    frame = cv2.GaussianBlur(
        np.random.default_rng(0).uniform(0, 255, (120, 160, 3)).astype(np.float32), (0, 0), 4
    )
    corners = np.array([[20, 10], [140, 5], [150, 110], [12, 100]], dtype=np.float32)
    matrix = cv2.getPerspectiveTransform(
        corners, np.array([[0, 0], [159, 0], [159, 119], [0, 119]], np.float32)
    )
    view = View.from_dict({"frame_shape": [120, 160], "rectify": form(matrix)})
    expected = cv2.warpPerspective(frame, matrix, (160, 120))
    assert np.abs(image_from_frame(frame, view) - expected)[2:-2, 2:-2].max() < 1.0
    assert View.from_dict(view.to_dict()).lens == view.lens


def test_four_corners_are_those_of_the_image():
    frame = np.zeros((120, 160, 3), np.float32)
    corners = [[20, 10], [140, 6], [150, 110], [12, 100]]
    for k, (x, y) in enumerate(corners):
        cv2.circle(frame, (x, y), 4, (50.0 + 50 * k,) * 3, -1)
    view = View.from_dict({"frame_shape": [120, 160], "rectify": corners})
    image = image_from_frame(frame, view)
    np.testing.assert_allclose(image.shape[:2], (97.0, 130.0), atol=1)
    assert [round(float(image[y, x, 0])) for y, x in ((0, 0), (0, -1), (-1, -1), (-1, 0))] == [
        50,
        100,
        150,
        200,
    ]
    assert View.from_dict(view.to_dict()) == view
    for wrong in (corners[::-1], [corners[0]] * 4):
        with pytest.raises(ValueError, match="upper left, upper right, lower right, lower left"):
            View.from_dict({"frame_shape": [120, 160], "rectify": wrong})


@pytest.mark.parametrize("wrong", [[1.0] * 8, "x", [0.0] * 9, [[1, 0], [0, 1]]])
def test_a_matrix_that_rectifies_nothing_is_refused(wrong):
    with pytest.raises(ValueError, match=r"perspective as 9 finite numbers|can be undone"):
        View.from_dict({"rectify": wrong})

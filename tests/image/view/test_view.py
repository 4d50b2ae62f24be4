"""A view maps pixel areas: what is seen stays where it was to a fraction of a pixel, there and back."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gelform.image.view import FLIPS, Lens, View, frame_from_image, frame_px_from_image_px, image_from_frame
from gelform.image.view.view import image_px_from_frame_px


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


def test_a_plane_is_seen_where_it_is():
    for view in (*VIEWS, *(replace(view, lens=IDEAL) for view in VIEWS)):
        image = image_from_frame(ramp(view.frame_shape), view)
        inner = np.s_[1:-1, 1:-1]
        # remap places a sample to 1/32 px; half a pixel of shift would be 0.15 gray levels per unit of scale
        scale = max(1, view.frame_shape[1] / view.shape[1])
        assert np.abs(image - ramp_seen_through(view))[inner].max() < 0.02 * scale
        assert image.shape == (*view.shape, 3)


def test_points_lie_where_the_plane_says():
    """The frame's plane at the point that an image pixel comes from is what that pixel shows."""
    for view in VIEWS:
        y, x = np.mgrid[: view.shape[0], : view.shape[1]]
        there = frame_px_from_image_px(np.stack([x.ravel(), y.ravel()], axis=1), view)
        plane = 40 + 0.31 * (there[:, 0] + 0.5) + 0.17 * (there[:, 1] + 0.5)
        np.testing.assert_allclose(plane.reshape(view.shape), ramp_seen_through(view)[..., 0], atol=1e-9)


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
            np.testing.assert_array_equal(frame_from_image(image, view), frame)
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
    assert frame_from_image(frame, View()) is frame
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
    with pytest.raises(ValueError, match="24x32"):
        frame_from_image(np.zeros((48, 64, 3), dtype=np.uint8), view)


def test_settings_come_back():
    for view in (View(), *VIEWS, replace(VIEWS[3], lens=Lens((220.0, 210.0, 30.0, 20.0), (-0.2, 0.03)))):
        settings = view.to_dict()
        assert View.from_dict(settings) == view
        assert all(value is not None for value in settings.values())  # TOML has no null
        assert hash(View.from_dict(settings)) == hash(view)


def test_wrong_settings_are_refused():
    for wrong, text in (
        ({"frameshape": [1, 2]}, "among frame_shape, crop, flip, image_shape, lens, turn, got frameshape"),
        ({"flip": "z", "frame_shape": [4, 4]}, "none, x, y, xy, got 'z'"),
        ({"crop": [0, 0, 4, 4]}, "Expected frame_shape"),
        ({"frame_shape": [4]}, r"\(height, width\)"),
        ({"frame_shape": [4, 0]}, "whole numbers"),
        ({"frame_shape": [4, 4.5]}, "whole numbers"),
        ({"frame_shape": "big"}, r"\(height, width\)"),
        ({"frame_shape": [4, 4], "crop": [0, 0, 5, 4]}, "ending at column 5 and row 4"),
        ({"frame_shape": [4, 4], "crop": [0, 0, 0.99, 4]}, "size >= 1 px"),
        ({"frame_shape": [4, 4], "crop": [0, 0, 4, 1e-9]}, "size >= 1 px"),
        ({"frame_shape": [4, 4], "crop": [-1, 0, 4, 4]}, "left, top >= 0"),
        ({"frame_shape": [4, 4], "crop": [0, -1, 4, 4]}, "left, top >= 0"),
        ({"frame_shape": [4, 4], "crop": [0, 0, float("nan"), 4]}, "left, top, width, height"),
    ):
        with pytest.raises(ValueError, match=text):
            View.from_dict(wrong)


def test_a_quarter_turn_is_exact_and_undone():
    frame = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    for turn, quarters in (("left", 1), ("right", -1)):
        view = View((30, 40), crop=(4, 6, 32, 20), flip="x", image_shape=(16, 10), turn=turn)
        assert view.shape == (16, 10)
        lying = View((30, 40), crop=(4, 6, 32, 20), flip="x", image_shape=(10, 16))
        image = image_from_frame(frame, view)
        np.testing.assert_array_equal(image, np.rot90(image_from_frame(frame, lying), quarters))
        assert image.flags.c_contiguous
        points = np.array([[0.0, 0.0], [9.0, 0.0], [3.5, 12.25]])
        there = frame_px_from_image_px(points, view)
        np.testing.assert_allclose(image_px_from_frame_px(there, view), points, atol=1e-9)
        x, y = 3, 12
        marked = np.zeros((30, 40, 3), np.uint8)
        at = np.rint(frame_px_from_image_px([[x, y]], View((30, 40), turn=turn))[0]).astype(int)
        marked[at[1], at[0]] = 255
        assert image_from_frame(marked, View((30, 40), turn=turn))[y, x].min() == 255
        assert View.from_dict(view.to_dict()) == view
        alone = View(turn=turn)
        np.testing.assert_array_equal(frame_from_image(image_from_frame(frame, alone), alone), frame)
    for wrong in ("up", [], np.zeros(2), None):
        with pytest.raises(ValueError, match="turn among none, left, right, got"):
            View(turn=wrong)


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
    _, _, width, height = squared.crop
    lost = (130 - width) * in_frame[0], (91 - height) * in_frame[1]
    assert 0 <= min(lost) <= max(lost) < max(pitch)
    assert image_from_frame(np.zeros((97, 141, 3), np.uint8), squared).shape[:2] == squared.shape

"""The pictures of the page: their size, their colors, and the names under them."""

import base64

import cv2
import numpy as np
import pytest

from gelform.calibration.report.pictures import (
    HIGH,
    LOW,
    WIDTHS_PX,
    cap_scale_um,
    cap_url,
    jpeg_url,
    press_urls,
    short_names,
)


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["a/0/gelsight.png", "a/1/gelsight.png"], ["a/0", "a/1"]),
        (["0.png", "10.png"], ["0", "10"]),
        (["0.png", "1.jpg"], ["0.png", "1.jpg"]),
        (["x10.png", "y10.png"], ["x10", "y10"]),
        (["x" * 50 + ".png", "y.png"], ["x" * 13 + "…" + "x" * 14, "y"]),
        (["only.png"], ["only"]),
        ([".png", "a.png"], [".png", "a"]),
    ],
)
def test_names_lose_what_all_share(names, short):
    assert short_names(names) == short


def decoded(url):
    data = np.frombuffer(base64.b64decode(url.split(",", 1)[1]), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_UNCHANGED)


def test_a_jpeg_is_rgb_and_no_wider_than_asked():
    image = np.zeros((120, 160, 3), dtype=np.uint8)
    image[:, :80, 0] = 200
    back = decoded(jpeg_url(image, 80))
    assert back.shape == (60, 80, 3)
    assert back[30, 10, 2] > 150 > back[30, 10, 0] + 100
    assert decoded(jpeg_url(image, 320)).shape == image.shape


def test_many_presses_become_small():
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (120, 160, 3), dtype=np.uint8) for _ in range(12)]
    urls = press_urls(images, budget_bytes=60_000)
    assert sum(map(len, urls)) < 90_000
    assert decoded(urls[0]).shape[1] in WIDTHS_PX
    assert decoded(press_urls(images)[0]).shape[1] == 160


def test_too_high_is_red_too_low_blue_and_unknown_clear():
    error = np.zeros((40, 40), dtype=np.float32)
    error[:, :10], error[:, 30:] = 50, -50
    error[:10] = np.nan
    pixels = decoded(cap_url(error, 50.0))
    assert tuple(pixels[30, 3, 2::-1]) == HIGH
    assert tuple(pixels[30, 36, 2::-1]) == LOW
    assert pixels[30, 3, 3] == pixels[30, 36, 3] == 255
    assert pixels[30, 20, 3] == pixels[4, 3, 3] == 0


@pytest.mark.parametrize(("spread", "scale"), [(0.9, 1), (1.2, 1.5), (4.0, 5), (8.0, 10), (25.0, 30)])
def test_scales_are_round_and_hold_most_pixels(spread, scale):
    error = np.full((20, 20), spread, dtype=np.float32)
    error[0] = np.nan
    assert cap_scale_um([error]) == pytest.approx(scale)

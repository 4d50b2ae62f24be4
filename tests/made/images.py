"""An image of a checkerboard, as `gelform lens` reads it.

Samples of a ball under simple lights, for tests of color models.

Images of dark dots at known places, with uneven light and noise.

Real presses at half their size: four times as fast to calibrate, for tests that are not about the finest detail.

A background and an image with a contact.

A background image with a camera's noise, and damaged frames of the same gel.

A camera's frame whose view is an image.

A box of a frame, where something is known of its slopes.
"""

from dataclasses import replace

import cv2
import numpy as np

from gelform.exchange.plots import save_picture
from gelform.image.health import ImageBlocks, blocks_from_image
from gelform.image.view import as_levels, image_px_from_frame_px, pixel_positions
from gelform.slopes.color_models import Samples


def checkerboard(path, shape, square_px):
    """A checkerboard of 8x6 inner corners in the middle of a frame, white around it."""
    fine = 8
    board = np.kron(np.indices((7, 9)).sum(axis=0) % 2, np.ones((square_px * fine,) * 2))
    whole = np.ones((shape[0] * fine, shape[1] * fine))
    top, left = ((whole.shape[k] - board.shape[k]) // 2 for k in (0, 1))
    whole[top : top + board.shape[0], left : left + board.shape[1]] = board
    gray = cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA)
    save_picture(path, np.repeat((40 + 180 * gray).astype(np.uint8)[..., None], 3, axis=2))


SHAPE = (48, 64)
LIGHTS = np.array([[0.8, 0.1, 0.9], [-0.5, 0.6, 0.8], [-0.2, -0.9, 1.1]])


def ball_samples(change_of, count: int = 4000, seed: int = 0) -> Samples:
    """Random pixels with slopes up to 0.8, their color change by a given law of (gradients, x, y)."""
    rng = np.random.default_rng(seed)
    steepness, angle = 0.8 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    gradients = np.stack([steepness * np.cos(angle), steepness * np.sin(angle)], axis=-1)
    x, y = rng.uniform(0, SHAPE[1] - 1, count), rng.uniform(0, SHAPE[0] - 1, count)
    return Samples(change_of(gradients, x, y), x, y, gradients, np.ones(count), SHAPE)


def part_of(samples, which=slice(None)) -> Samples:
    """Some of the samples, in arrays of their own, of which nothing is remembered."""
    parts = ("color_change", "x_px", "y_px", "gradients", "weight")
    return replace(samples, **{part: getattr(samples, part)[which].copy() for part in parts})


def lambertian_change(gradients, x, y):
    """I/I0 - 1 of a Lambertian gel under three fixed lights."""
    length = np.sqrt(1 + np.sum(gradients**2, axis=-1))
    normals = np.concatenate([-gradients, np.ones((len(gradients), 1))], axis=-1) / length[:, None]
    return np.maximum(normals @ LIGHTS.T, 0) / LIGHTS[:, 2] - 1


class SlopesAsColors:
    """A color model whose color changes are the slopes themselves."""

    def gradients_at(self, change, x_px, y_px):
        return change[:, :2]

    def prepare(self, background, shape):
        assert background.shape == (*shape, 3)
        return self

    def gradients_from_color(self, change):
        return np.ascontiguousarray(change[..., :2]), None


def shading_change(gradients, x, y):
    """The same with lights that turn over the image, as near lights do."""
    turn = (x / SHAPE[1] - 0.5)[:, None] * np.array([0.3, -0.2, 0.25])
    return lambertian_change(gradients, x, y) * (1 + turn)


DOTS_SHAPE = (96, 128)
RADIUS = 3.0


def grid(pitch=16.0, shape=DOTS_SHAPE, margin=10.0):
    """Places (N, 2), x and y, of a square grid."""
    y, x = np.mgrid[margin : shape[0] - margin + 1 : pitch, margin : shape[1] - margin + 1 : pitch]
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def image_of_dots(places, *, radii=RADIUS, shape=DOTS_SHAPE, noise=0.0, seed=0, light=0.0):
    """(H, W, 3) uint8: soft-edged dots on gray; `light` adds a bump of light in the middle, as a contact does."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    level = 120 + 0.3 * x - 0.2 * y
    level *= 1 + light * np.exp(-((x - shape[1] / 2) ** 2 + (y - shape[0] / 2) ** 2) / 20**2)
    for (px, py), radius in zip(places, np.broadcast_to(radii, len(places))):
        level *= 1 - 0.85 / (1 + np.exp((np.hypot(x - px, y - py) - radius) / 0.4))
    rng = np.random.default_rng(seed)
    pixels = level[..., None] * [0.9, 1.0, 1.1] + rng.normal(0, noise, (*shape, 3))
    return np.clip(np.rint(pixels), 0, 255).astype(np.uint8)


def halved(presses):
    """The same presses, of images half as high and wide."""
    images = tuple(replace(press, image=_half(press.image)) for press in presses.presses)
    return replace(
        presses, presses=images, background=_half(presses.background), mm_per_px=2 * presses.mm_per_px
    )


def _half(image):
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


TOUCHED_SHAPE = (60, 80)


def scene(seed: int = 0) -> np.ndarray:
    """A smooth, unevenly lit background with noise, channels clearly different."""
    y, x = np.mgrid[: TOUCHED_SHAPE[0], : TOUCHED_SHAPE[1]] / 80
    levels = np.stack([60 + 90 * x, 110 - 40 * y, 80 + 60 * (1 - x) * y], axis=-1)
    return (levels + np.random.default_rng(seed).normal(0, 1, levels.shape)).astype(np.float32)


def touched(background: np.ndarray) -> np.ndarray:
    image = background.copy()
    image[20:40, 30:50] += np.array([40, -30, 20], dtype=np.float32)
    return np.clip(image, 0, 255)


WORN_SHAPE = (96, 128)


def gel(seed: int = 0) -> np.ndarray:
    """(H, W, 3) uint8: unevenly lit, with a camera's noise."""
    y, x = np.mgrid[: WORN_SHAPE[0], : WORN_SHAPE[1]] / WORN_SHAPE[1]
    levels = np.stack([60 + 90 * x, 150 - 60 * y, 80 + 60 * (1 - x) * y], axis=-1)
    noisy = levels + np.random.default_rng(seed).normal(0, 1.5, levels.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def pressed(seed: int = 1) -> np.ndarray:
    """The gel under a ball: one side brighter, the other darker."""
    image = gel(seed).astype(np.float32)
    y, x = np.mgrid[: WORN_SHAPE[0], : WORN_SHAPE[1]]
    inside = np.hypot(x - 60, y - 45) < 20
    slope = np.stack([(x - 60) / 20, (y - 45) / 20, -(x - 60) / 20], axis=-1) * 35
    return np.clip(np.rint(image + slope * inside[..., None]), 0, 255).astype(np.uint8)


def constant(level: int | tuple[int, int, int]) -> np.ndarray:
    """A frame of one color."""
    return np.full((*WORN_SHAPE, 3), level, dtype=np.uint8)


def with_part(image: np.ndarray, part: tuple[slice, slice], level: int | tuple[int, int, int]) -> np.ndarray:
    """The image with a part of one color."""
    changed = image.copy()
    changed[part] = level
    return changed


def blocks_of(image: np.ndarray) -> ImageBlocks:
    """The image's blocks."""
    return blocks_from_image(as_levels(image))


def frame_from_image(image, view):
    """A frame whose view is the image; pixels outside the view repeat the nearest one inside."""
    places = image_px_from_frame_px(pixel_positions(view.frame_shape), view)
    map_x, map_y = places.T.reshape(2, *view.frame_shape).astype(np.float32)
    return cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


PATCHED = (40, 72)


def patch(box=np.s_[10:20, 30:44]):
    """A mask (H, W), True in the box."""
    mask = np.zeros(PATCHED, dtype=bool)
    mask[box] = True
    return mask

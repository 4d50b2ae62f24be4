"""The two faces of a cube's edge in a frame: where they are, how steep they are, and how high the edge stands.

mini-edge is a GelSight Mini without presses of a ball. Its object is a cube of 10 mm, pressed edge first: two plane faces
that meet at 90 degrees in a straight edge. The gel is assumed to follow the faces up to where their color ends. So three of
the four angles of the two faces are known, whatever a calibration reads: the edge's direction in the image is seen, the
faces are perpendicular, and the edge is nearly level, so that its slope can be read. The fourth is the roll of the cube
about its edge. It is unknown, and the ratio of both slopes as they were read decides it: the least change of what was read.

`edge_in` and what judges depth are pure functions of a frame's slopes; `line_in` sees the image alone, so it can judge what
was made of slopes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

import gelform
from presses import DATA

EDGE_MM = 10.0  # length of the cube's edge
SHORTEST = 0.9  # of that length; a frame with a shorter edge is cut
# A face is steeper, across the edge, than this share of the 90 % quantile of the slopes beside the same 10 px of the edge:
# the gel that has left it falls to half of that within 10 px.
PLATEAU, STRIP_PX = 0.85, 10
FROM_EDGE_PX = 4.0  # the blur of a color change and of the camera mixes both faces nearer to the edge
STEEP = 0.18  # mm/mm, least slope of a face as it was read; other units' models read .2-.7
LEAST_PX = 300  # pixels of a face; a smaller one is cut
LIT = 15.0  # gray levels, least change of the colors' difference on a face
PROFILE_PX, SAMPLE_PX = 6.0, 0.25  # half length, and step, of the profiles across a line in the image
ANOTHER_LIGHT = 0.08  # |median of image over background - 1|: under .07 in the same light, .09-.15 in another


@dataclass(frozen=True, eq=False)
class Edge:
    """The edge of a cube in a frame of (H, W) px.

    Attributes
    ----------
    across : (2,) unit vector (x, y) in the image, perpendicular to the edge: the first face rises along it
    middle : (2,) x, y of the edge's middle, px
    length_px : length of the edge
    faces : (2, H, W) bool, pixels of the faces, without the pixels next to the edge
    slopes : (2,) median slope across the edge as it was read, > 0, of each face
    pitch : slope along the edge as it was read
    true_gradients : (2, 2) dz/dx, dz/dy of each face: the faces are perpendicular, the ratio of their slopes is as read
    """

    across: np.ndarray
    middle: np.ndarray
    length_px: float
    faces: np.ndarray
    slopes: np.ndarray
    pitch: float
    true_gradients: np.ndarray

    @property
    def angle_deg(self) -> float:
        """Angle between the normals of both faces as they were read; 90 is right."""
        return float(np.degrees(np.sum(np.arctan(self.slopes / np.hypot(1, self.pitch)))))

    @property
    def crest(self) -> np.ndarray:
        """Pixels (H, W) within 1 px of the edge, between its ends."""
        return on_line(self.faces.shape[1:], self)


def edge_in(gradients: np.ndarray, mm_per_px: float) -> Edge | None:
    """The edge of a cube in the slopes (H, W, 2) of a frame; None if it is cut: too short, or one face is too small."""
    size = np.hypot(gradients[..., 0], gradients[..., 1])
    steep = size > STEEP
    squares = gradients[steep].astype(np.float64)
    across = np.linalg.eigh(squares.T @ squares)[1][:, 1]
    for _ in range(2):  # the second time along the line, which is sharper than the mean of slopes
        slope = gradients @ across
        sides = [_largest(steep & (sign * slope > STEEP)) for sign in (1, -1)]
        if min(side.sum() for side in sides) < LEAST_PX:
            return None
        line = _line_between(*sides, across)
        if line is None:
            return None
        across, middle, length_px = line
    slope = gradients @ across
    away, along = _from_edge(size.shape, across, middle)
    between = np.abs(along) < 0.45 * length_px
    faces, slopes = [], []
    for sign, side in zip((1, -1), sides):
        near = side & between & (-sign * away > FROM_EDGE_PX)
        if near.sum() < LEAST_PX:
            return None
        faces.append(_largest(near & (sign * slope > PLATEAU * _along_edge(sign * slope, near, along))))
        slopes.append(float(np.median(sign * slope[faces[-1]])))
    if length_px * mm_per_px < SHORTEST * EDGE_MM or min(face.sum() for face in faces) < LEAST_PX:
        return None
    direction = np.array([-across[1], across[0]])
    pitch = float(np.mean([np.median(gradients[face] @ direction) for face in faces]))
    # n1 . n2 = 0 with gradients t1 across + pitch direction and -t2 across + pitch direction: t1 t2 = 1 + pitch^2.
    both, ratio = np.sqrt(1 + pitch**2), np.sqrt(slopes[0] / slopes[1])
    true = np.stack([both * ratio * across, -both / ratio * across]) + pitch * direction
    return Edge(across, middle, length_px, np.stack(faces), np.array(slopes), pitch, true)


@dataclass(frozen=True, eq=False)
class Line:
    """The line between two faces in an image: `across`, `middle`, `length_px` as of an `Edge`.

    `error_px` and `error_rad` are standard errors of the place across it and of its direction; `apart_px` and `apart_rad`:
    how far two ways of seeing it differ, where the colors pass the mean of both faces, and where they change most.
    """

    across: np.ndarray
    middle: np.ndarray
    length_px: float
    error_px: float
    error_rad: float
    apart_px: float
    apart_rad: float


def on_line(shape: Any, line: Edge | Line) -> np.ndarray:
    """Pixels (H, W) within 1 px of a line, between its ends."""
    away, along = _from_edge(shape, line.across, line.middle)
    return (np.abs(away) <= 1) & (np.abs(along) < 0.45 * line.length_px)


def line_in(image: np.ndarray, background: np.ndarray, mm_per_px: float) -> Line | None:
    """The line between the faces of a cube in an image (H, W, 3), of its gray levels alone; None if it is cut.

    The lights of a Mini color two faces red and blue, so the difference of both channels changes its sign at the edge.
    """
    change = image.astype(np.float64) - background
    signal = cv2.GaussianBlur(change[..., 0] - change[..., 2], (0, 0), 0.5)
    signal -= np.median(signal)
    smooth = cv2.GaussianBlur(signal, (0, 0), 1.0)
    sides = _largest(smooth > LIT), _largest(smooth < -LIT)
    if not all(side.any() for side in sides):
        return None
    before, after = (np.argwhere(side).mean(axis=0)[::-1] for side in sides)
    found = _line_between(*sides, after - before)
    if found is None or found[2] * mm_per_px < SHORTEST * EDGE_MM:
        return None
    lines = [_at_gray_levels(signal, *found, steepest=steepest) for steepest in (False, True)]
    (across, middle, *errors), (other, its_middle, *_) = lines
    turn = float(across[0] * other[1] - across[1] * other[0])
    return Line(across, middle, found[2], *errors, abs(float((its_middle - middle) @ across)), abs(turn))


def _at_gray_levels(
    signal: np.ndarray, across: np.ndarray, middle: np.ndarray, length_px: float, *, steepest: bool
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """A line moved to where the profiles across it step: across, middle, standard errors of its place and direction."""
    along = np.arange(-0.45 * length_px, 0.45 * length_px)
    away = np.arange(-PROFILE_PX, PROFILE_PX + SAMPLE_PX, SAMPLE_PX)
    for _ in range(4):  # until the profiles are perpendicular to it
        direction = np.array([-across[1], across[0]])
        x, y = np.moveaxis(middle + along[:, None, None] * direction + away[:, None] * across, -1, 0)
        profile = map_coordinates(signal, [y, x], order=1)
        steps = -np.gradient(gaussian_filter1d(profile, 1 / SAMPLE_PX, axis=1), axis=1)
        if steepest:
            size = np.maximum(steps - 0.5 * steps.max(axis=1, keepdims=True), 0)
            place = size @ away / size.sum(axis=1)
        else:
            ends = [np.median(profile[:, part], axis=1) for part in (slice(8), slice(-8, None))]
            share = (profile - ends[1][:, None]) / (ends[0] - ends[1])[:, None]
            place = away[0] + SAMPLE_PX * (np.clip(share, 0, 1).sum(axis=1) - 0.5)
        terms, weight = np.stack([np.ones_like(along), along], axis=1), np.ones_like(along)
        for _ in range(20):
            inverse = np.linalg.inv((terms * weight[:, None]).T @ terms)
            offset, slope = inverse @ (terms.T @ (weight * place))
            left = place - offset - slope * along
            scale = 1.48 * float(np.median(np.abs(left))) + 1e-3
            weight = (1 + np.square(left / (2 * scale))) ** -2.0
        turned = direction + slope * across
        middle, across = middle + offset * across, np.array([turned[1], -turned[0]]) / np.linalg.norm(turned)
    place_px, turn_rad = scale * np.sqrt(np.diag(inverse))
    return across, middle, float(place_px), float(turn_rad)


def crest_error_mm(
    edge: Edge, depth_mm: np.ndarray, mm_per_px: float, slopes: Sequence[float] = (1, 1)
) -> float:
    """What is missing in the depth (H, W) at the edge, mm, if the faces have these slopes across it; 45 degrees by default.

    The depth at the outer border of a face counts as right. The mean of both faces is free of errors in the edge's place.
    """
    away, along = _from_edge(depth_mm.shape, edge.across, edge.middle)
    crest, missing = depth_mm[edge.crest].mean(), []
    for side, face, slope in zip((-away, away), edge.faces, slopes):
        lines = np.round(along[face]).astype(int)
        outer = [np.argmax(np.where(lines == line, side[face], 0)) for line in np.unique(lines)]
        rise = crest - np.mean(depth_mm[face][outer])
        missing.append(np.mean(side[face][outer]) * mm_per_px * slope - rise)
    return float(np.mean(missing))


def frames() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """mini-edge: background (H, W, 3), and the images by name, without those of another light.

    The light of 14, 16, 18, 28, 36 and 38 is 8 to 15 % brighter than the background's, which no calibration is made for. Of
    the other twenty, `edge_in` finds 12 cut: the edge leaves the frame.
    """
    folder = DATA / "mini-edge"
    background = gelform.read_image(folder / "background.png")
    names = sorted(os.listdir(folder / "images"), key=lambda name: int(name.split(".")[0]))
    images = {name: gelform.read_image(folder / "images" / name) for name in names}
    return background, {name: one for name, one in images.items() if not another_light(one, background)}


def another_light(image: np.ndarray, background: np.ndarray) -> bool:
    """Whether an image (H, W, 3) was taken under another light than the background."""
    ratio = np.median((image + 1.0) / (np.asarray(background, np.float64) + 1.0), axis=(0, 1))
    return bool(abs(ratio.mean() - 1) > ANOTHER_LIGHT)


def _along_edge(slope: np.ndarray, side: np.ndarray, along: np.ndarray) -> np.ndarray:
    """The 90 % quantile of the slopes (H, W) of a side of the edge, for each strip across it, at all pixels."""
    strips = np.round(along / STRIP_PX).astype(int)
    found = np.full(along.shape, np.inf)
    for strip in np.unique(strips[side]):
        found[strips == strip] = np.quantile(slope[side & (strips == strip)], 0.9)
    return found


def _largest(mask: np.ndarray) -> np.ndarray:
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    return mask if len(boxes) < 2 else labels == 1 + np.argmax(boxes[1:, cv2.CC_STAT_AREA])


def _line_between(rising: np.ndarray, falling: np.ndarray, across: np.ndarray) -> Any:
    """Unit vector from the rising side to the falling one, middle and length (px) of the line where they meet."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    meet = cv2.dilate(rising.astype(np.uint8), disc) & cv2.dilate(falling.astype(np.uint8), disc)
    points = np.argwhere(_largest(meet > 0))[:, ::-1].astype(np.float64)
    if len(points) < LEAST_PX / 4:
        return None
    kept = points
    for _ in range(3):  # without the ends, where the meeting bends around the corners
        middle = kept.mean(axis=0)
        normal = np.linalg.svd(kept - middle, full_matrices=False)[2][1]
        kept = points[np.abs((points - middle) @ normal) < 3]
    normal *= np.sign(normal @ across)
    along = (kept - middle) @ np.array([-normal[1], normal[0]])
    ends = np.quantile(along, [0.01, 0.99])
    middle = middle + ends.mean() * np.array([-normal[1], normal[0]])
    return normal, middle, float(np.ptp(ends))


def _from_edge(shape: Any, across: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance of each pixel across the edge, and along it from its middle, px."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    x, y = x - middle[0], y - middle[1]
    return x * across[0] + y * across[1], -x * across[1] + y * across[0]

"""The pixels of a cube's two faces that the gel follows, from the color of a frame alone: truth for the outline of contacts.

mini-edge shows a cube pressed edge first. A plane face has one slope and so one color; where the gel leaves the face, the
color falls off. Everywhere along the edge, the profile of a face's color across it is even and then decays; the place of the
kink is the face's border there, and a plane face ends in a straight line. Slopes, depth and calibration have no part in it.
The ends of the edge were marked by eye, within 5 px; they are moved onto the line where the color steps most.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from scipy.optimize import least_squares

# x, y of both ends of the edge, px, in frames of mini-edge in which both faces lie within the frame.
ENDS = {
    "0.png": ((78, 106), (237, 118)), "2.png": ((58, 102), (219, 91)), "6.png": ((103, 129), (265, 128)),
    "8.png": ((105, 150), (267, 149)), "10.png": ((88, 72), (249, 99)), "14.png": ((105, 34), (84, 196)),
    "16.png": ((184, 44), (164, 205)), "22.png": ((48, 122), (207, 152)), "24.png": ((64, 85), (225, 103)),
    "28.png": ((91, 34), (255, 42)), "30.png": ((81, 48), (75, 212)),
}  # fmt: skip
MARKED_PX = 5.0  # error of the marks
STEP_PX = 2.0  # on both sides of the edge, between which the color's step is taken
DEEPEST_PX = 45.0  # of a face across the edge; the faces end before
FACE_PX = (3.0, 7.0)  # across the edge, where a face's own color is read
ALONG_PX = 15  # of the edge, over which profiles are averaged
KINKS_PX, DECAYS_PX = np.arange(2, 40, 0.5), (3.0, 6.0, 10.0, 15.0, 20.0)
ROBUST_PX = 1.5  # of a kink from the line; others count less


def touched_faces(image: np.ndarray, background: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The pixels (H, W) bool of both faces of a cube, in an image (H, W, 3) whose edge has these ends (x, y)."""
    rest = np.asarray(background, np.float32)
    rest = rest * np.median((image + 1.0) / (rest + 1.0), axis=(0, 1)).astype(np.float32)  # another light
    change = cv2.GaussianBlur(image.astype(np.float32) - rest, (0, 0), 1.0)
    first, last = sharpest(change, np.asarray(ends, np.float64))
    length = float(np.hypot(*(last - first)))
    along = (last - first) / length
    across = np.array([-along[1], along[0]])
    place, away = np.arange(2, length - 2), np.arange(0, DEEPEST_PX, 0.5)
    sides = []
    for side in (across, -across):
        at = first + along * place[:, None, None] + side * away[:, None]
        inside = np.all((at >= 0) & (at <= np.array(change.shape[1::-1]) - 1), axis=-1)
        width = straight(place / length - 0.5, kinks(sampled(change, at), inside, away))
        sides.append(first + along * place[:, None] + side * width[:, None])
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint(np.vstack([sides[0], sides[1][::-1]])).astype(np.int32)], 1)
    return mask > 0


def sharpest(change: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Both ends (2, 2), moved across the edge by up to the marks' error, so that the color steps most along the line."""
    along = ends[1] - ends[0]
    across = np.array([-along[1], along[0]]) / np.hypot(*along)
    share = np.linspace(0.04, 0.96, 80)[:, None]

    def step(moved: tuple[float, float]) -> float:
        line = ends[0] + along * share + across * (moved[0] + (moved[1] - moved[0]) * share)
        return float(
            np.abs(sampled(change, line + STEP_PX * across) - sampled(change, line - STEP_PX * across)).mean()
        )

    moves = np.arange(-MARKED_PX, MARKED_PX + 0.1, 0.5)
    return ends + np.array(max(itertools.product(moves, repeat=2), key=step))[:, None] * across


def kinks(profiles: np.ndarray, inside: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Where the color of a face (n, m, 3), along profiles across the edge at distances (m,), stops being even; NaN: unclear.

    A profile is even up to the kink and then decays exponentially; all kinks and decays are tried. Only what lies `inside`
    (n, m) the frame counts.
    """
    own = (away >= FACE_PX[0]) & (away <= FACE_PX[1])
    color = profiles[:, own].mean(axis=(0, 1))
    rows = cv2.blur(profiles @ (color / np.linalg.norm(color)).astype(np.float32), (1, ALONG_PX))
    seen, beyond = inside[:, away >= FACE_PX[0]].astype(np.float64), away[away >= FACE_PX[0]]
    rows = rows[:, away >= FACE_PX[0]] * seen
    found, left = np.full(len(rows), np.nan), np.full(len(rows), np.inf)
    for kink, decay in itertools.product(KINKS_PX, DECAYS_PX):
        shape = np.exp(-np.maximum(beyond - kink, 0) / decay)
        size = rows @ shape / np.maximum(seen @ shape**2, 1e-9)
        residual = np.square(rows - seen * size[:, None] * shape).sum(axis=1)
        found, left = np.where(residual < left, kink, found), np.minimum(residual, left)
    return np.where((found > KINKS_PX[1]) & (found < KINKS_PX[-1]), found, np.nan)


def straight(place: np.ndarray, width: np.ndarray) -> np.ndarray:
    """The line through widths (n,) at places along the edge, -.5 to .5, that a few wrong ones do not move."""
    seen = np.isfinite(width)
    start = [float(np.median(width[seen])), 0.0]
    fit = least_squares(
        lambda of: (of[0] + of[1] * place[seen] - width[seen]) / ROBUST_PX, start, loss="cauchy"
    )
    return np.clip(fit.x[0] + fit.x[1] * place, 0, DEEPEST_PX)


def sampled(change: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values of a map (H, W, 3) at places (..., 2), x and y; outside of the frame those of its border."""
    x, y = np.moveaxis(at.astype(np.float32), -1, 0)
    flat = cv2.remap(
        change,
        x.reshape(len(x), -1),
        y.reshape(len(y), -1),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return flat.reshape(*x.shape, 3)

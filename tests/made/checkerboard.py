"""An image of a checkerboard, as `gelform lens` reads it."""

import cv2
import numpy as np

from gelform.exchange.plots.canvas import save_picture


def checkerboard(path, shape, square_px):
    """A checkerboard of 8x6 inner corners in the middle of a frame, white around it."""
    fine = 8
    board = np.kron(np.indices((7, 9)).sum(axis=0) % 2, np.ones((square_px * fine,) * 2))
    whole = np.ones((shape[0] * fine, shape[1] * fine))
    top, left = ((whole.shape[k] - board.shape[k]) // 2 for k in (0, 1))
    whole[top : top + board.shape[0], left : left + board.shape[1]] = board
    gray = cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA)
    save_picture(path, np.repeat((40 + 180 * gray).astype(np.uint8)[..., None], 3, axis=2))

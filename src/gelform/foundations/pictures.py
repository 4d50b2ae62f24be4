"""Pixels as the bytes of a picture file, and as what a notebook shows."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence

import cv2
import numpy as np

from gelform.arrays import Array
from gelform.errors import DataError

# PNG with runs of equal bytes and Huffman codes only, because a camera's noise leaves no repetitions to find. Files are a
# fifth smaller than at zlib's level 1, and written as fast; any PNG reader reads them.
FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)


def picture_bytes(pixels: Array, ending: str = ".png", settings: Sequence[int] = ()) -> bytes:
    """The bytes of a picture file of an RGB image (H, W, 3) or a map (H, W).

    `ending` names the format; `settings` are OpenCV's.

    DataError: the format cannot hold the picture.
    """
    shown = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    try:
        done, content = cv2.imencode(ending, np.ascontiguousarray(shown), settings)
    except cv2.error:
        done = False
    if not done:
        size = f"{pixels.shape[0]}x{pixels.shape[1]}"
        raise DataError(f"OpenCV cannot encode a picture of {size} px as {ending[1:].upper()}.")
    return bytes(content.tobytes())


def shown_in_notebook(what: str, picture: bytes, rows: Iterable[tuple[str, str]]) -> str:
    """HTML of a picture, the bytes of a PNG, beside a table of (name, text); it fetches nothing from outside."""
    import html  # importing its table of characters takes longer than a frame

    shown = base64.b64encode(picture).decode("ascii")
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in rows
    )
    return (
        "<div style='display:flex;gap:1em;align-items:flex-start'>"
        f"<img alt='{html.escape(what)}' src='data:image/png;base64,{shown}'/><table>{cells}</table></div>"
    )

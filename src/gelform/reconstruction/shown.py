"""What a notebook shows of a result: the depth as a small picture beside its figures."""

from __future__ import annotations

import base64
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError


def shown_in_notebook(depth: NDArray[np.float32], rows: Iterable[tuple[str, str]]) -> str:
    """HTML of a depth map (H, W) and a table of (name, text); nothing in it is fetched from outside."""
    import html  # its table of characters takes longer to load than a frame

    picture = base64.b64encode(_depth_png(depth)).decode("ascii")
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in rows
    )
    return (
        "<div style='display:flex;gap:1em;align-items:flex-start'>"
        f"<img alt='depth' src='data:image/png;base64,{picture}'/><table>{cells}</table></div>"
    )


def _depth_png(depth: NDArray[np.float32], width_px: int = 240) -> bytes:
    """A small picture of the depth: dark at rest, bright where deep."""
    low, high = float(depth.min()), float(depth.max())
    levels = ((depth - low) * (255 / max(high - low, 1e-9))).astype(np.uint8)
    scale = width_px / depth.shape[1]
    size = (width_px, max(1, round(depth.shape[0] * scale)))
    small = cv2.resize(levels, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    done, png = cv2.imencode(".png", cv2.applyColorMap(small, cv2.COLORMAP_VIRIDIS))
    if not done:
        raise DataError(f"OpenCV cannot encode a picture of {depth.shape[0]}x{depth.shape[1]} px as PNG.")
    return bytes(png.tobytes())

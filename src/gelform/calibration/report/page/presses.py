"""The report's pictures of every press: its circle and errors, and depth minus the cap."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from html import escape
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.held_out.measure import HeldOutSample

WORSE = 2.0  # times the median error; worse presses are highlighted
SHOWN = (
    ("normal_free_deg", "normals", "°", 1),
    ("cap_free_um", "depth in the contact", " µm", 0),
    ("radius_percent", "ball's radius", " %", 1),
    ("off_contact_um", "depth off contact", " µm", 0),
)
BUDGET_BYTES = 1_300_000  # bytes of all pictures of presses; the page stays under 3 MB
# px, widths of a press's picture; the first that the budget allows is used.
WIDTHS_PX = (320, 240, 160, 112, 80, 56)
QUALITY = 82  # %, quality of JPEG
TILE_PX = 56  # px of a picture of depth minus cap
HIGH, LOW = (214, 69, 65), (40, 110, 200)  # RGB of depth above and below the ball


def presses_section(content: dict[str, Any], images: Sequence[NDArray[np.uint8]]) -> str:
    """Every press with its circle; the rejected ones come first, with their reasons."""
    rows, shape = content["presses"], content["calibration"]["image_shape"]
    urls = press_urls([np.asarray(image, dtype=np.uint8) for image in images])
    errors = [row["errors"]["normal_free_deg"] for row in rows if row["errors"]]
    limit = WORSE * float(np.median(errors)) if errors else np.inf
    rejected = [k for k, row in enumerate(rows) if not row["accepted"]]
    used = [k for k, row in enumerate(rows) if row["accepted"]]
    names = short_names([row["name"] for row in rows])
    tiles = {k: _press(rows[k], names[k], urls[k], shape, limit) for k in range(len(rows))}
    parts = [
        '<section id="presses"><h2>Presses and their circles</h2>',
        "<p class='lead'>gelform found the circles without a click. Under each press is its held-out error, by a model that "
        "has not seen this press. Click a press to enlarge it, and click again to close it.</p>",
    ]
    if rejected:
        parts.append(f"<h3>Left out: {len(rejected)}. The calibration does not use them</h3>")
        parts.append(f'<div class="presses">{"".join(tiles[k] for k in rejected)}</div>')
        parts.append(f"<h3>Used: {len(used)}</h3>")
    else:
        parts.append(f"<p>The calibration uses all {len(used)} presses.</p>")
    parts.append(f'<div class="presses">{"".join(tiles[k] for k in used)}</div></section>')
    return "".join(parts)


def _press(row: dict[str, Any], short: str, url: str, shape: Sequence[int], limit: float) -> str:
    errors = row["errors"]
    kind = "no" if not row["accepted"] else "worse" if errors and errors["normal_free_deg"] > limit else "ok"
    name, ball = escape(short), f"{row['ball_diameter_mm']:g} mm"
    below = f'<span class="why">{escape(row["reason"] or "")}</span>'
    if errors:
        below = f'<span class="figures">{_figure(errors, SHOWN[0])} · {_figure(errors, SHOWN[1])}</span>'
    more = [f"{row['name']}, ball {ball}"]
    more += [f"{shown[1]} {_figure(errors, shown)}" for shown in SHOWN] if errors else []
    x, y, radius = (row[key] for key in ("center_x_px", "center_y_px", "contact_radius_px"))
    more.append(f"circle at ({x:.1f}, {y:.1f}) px, radius {radius:.1f} px")
    return (
        f'<label class="press {kind}"><input type="checkbox" aria-label="Enlarge {name}"><span class="view" '
        f'style="--aspect:{shape[1] / shape[0]:.3f}">{_circled(url, shape, x, y, radius, name)}'
        f'<span class="name">{name}</span>{below}<span class="more">{escape(" · ".join(more))}</span></span></label>'
    )


def _circled(url: str, shape: Sequence[int], x: float, y: float, radius: float, name: str) -> str:
    """The picture in image pixels, so that the circle's own pixels place it."""
    height, width = shape
    arm = width / 45
    cross = f"M{x - arm:.1f} {y:.1f}H{x + arm:.1f}M{x:.1f} {y - arm:.1f}V{y + arm:.1f}"
    circle = f'cx="{x:.2f}" cy="{y:.2f}" r="{radius:.2f}"'
    return (
        f'<svg viewBox="-0.5 -0.5 {width} {height}" role="img" aria-label="{name}">'
        f'<image href="{url}" x="-0.5" y="-0.5" width="{width}" height="{height}" preserveAspectRatio="none"/>'
        f'<circle class="circle-under" {circle}/>'
        f'<circle class="circle" {circle}/>'
        f'<path class="center" d="{cross}"/></svg>'
    )


def _figure(errors: dict[str, float], shown: tuple[str, str, str, int]) -> str:
    key, _, unit, digits = shown
    value = errors.get(key)
    return "–" if value is None or not np.isfinite(value) else f"{value:.{digits}f}{unit}"


def short_names(names: Sequence[str], length: int = 28) -> list[str]:
    """Names without their common ending (`/gelsight.png`, `.png`); long ones lose their middle."""
    ending = os.path.commonprefix([name[::-1] for name in names])[::-1]  # noqa: RUF071 (letters are meant)
    cut = max(ending.find("/"), 0) if "/" in ending else max(ending.rfind("."), 0)
    shared = len(ending) - cut if ending[cut : cut + 1] in ("/", ".") else 0
    short = [name[: len(name) - shared] or name for name in names]
    return [
        name if len(name) <= length else f"{name[: length // 2 - 1]}…{name[len(name) - length // 2 :]}"
        for name in short
    ]


def caps_section(content: dict[str, Any], samples: Sequence[HeldOutSample]) -> str:
    """Depth minus the ball's cap of every held-out press, on one scale."""
    shown = sorted((one for one in samples if one.cap_error_um.size), key=lambda one: one.index)
    if not shown:
        return ""
    scale = cap_scale_um([one.cap_error_um for one in shown])
    names = short_names([row["name"] for row in content["presses"]])
    tiles = []
    for one in shown:
        row = content["presses"][one.index]
        label = escape(f"{names[one.index]}: {row['errors']['cap_free_um']:.0f} µm")
        tiles.append(
            f'<figure><img src="{cap_url(one.cap_error_um, scale)}" alt="{label}" title="{label}">'
            f"<figcaption>{row['errors']['cap_free_um']:.0f} µm</figcaption></figure>"
        )
    return (
        "<h3>Depth minus the ball's cap, every held-out press</h3>"
        f"<p class='lead'>Red is too high and blue too low. Full color is {scale:g} µm. The figure is the RMS. "
        "The color model causes a pattern that is the same in every press. A pattern that stays at one place of the gel is "
        "dust, a scratch or a shadow.</p>"
        f'<div class="caps">{"".join(tiles)}</div>'
    )


def jpeg_url(image: NDArray[np.uint8], width_px: int) -> str:
    """An RGB image, not wider than `width_px`, as a JPEG data URL."""
    height, width = image.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    settings = [int(cv2.IMWRITE_JPEG_QUALITY), QUALITY]
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), settings)
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def press_urls(images: Sequence[NDArray[np.uint8]], budget_bytes: int = BUDGET_BYTES) -> list[str]:
    """All presses as wide as the page's budget allows; hundreds become small."""
    for width in WIDTHS_PX:
        each = len(jpeg_url(images[len(images) // 2], width))
        if each * len(images) <= budget_bytes:
            break
    return [jpeg_url(image, width) for image in images]


def cap_scale_um(maps: Sequence[NDArray[np.float32]]) -> float:
    """The depth error of the tiles' full color: a round figure that few pixels exceed."""
    typical = float(np.nanquantile(np.abs(np.concatenate([one[::2, ::2].ravel() for one in maps])), 0.97))
    power = 10.0 ** np.floor(np.log10(max(typical, 1e-3)))
    return float(next(step * power for step in (1, 1.5, 2, 3, 5, 7, 10) if step * power >= typical))


def cap_url(error_um: NDArray[np.float32], scale_um: float) -> str:
    """Depth minus the cap as a PNG data URL: red above the ball, blue below, clear where it agrees or is unknown."""
    known = np.isfinite(error_um)
    ratio = np.where(known, np.clip(np.nan_to_num(error_um) / scale_um, -1, 1), 0)
    color = np.where(ratio[..., None] > 0, HIGH, LOW)
    alpha = np.where(known, 255 * np.abs(ratio), 0)
    pixels = np.dstack([color[..., ::-1], alpha]).astype(np.uint8)
    longest = max(pixels.shape[:2])
    if longest > TILE_PX:
        size = tuple(max(1, round(n * TILE_PX / longest)) for n in pixels.shape[1::-1])
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".png", pixels)
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode()

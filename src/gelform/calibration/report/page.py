"""The report as one self-contained HTML page: `page.html`, filled with the report's numbers and pictures."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np

from gelform.arrays import Image, Map
from gelform.calibration.presses.folder import Presses
from gelform.calibration.report import charts
from gelform.calibration.report.content import limit_in_words, shown
from gelform.calibration.report.record import FIGURES, setting_in_words, used_in_words
from gelform.calibration_file import Calibration

WIDTHS_PX = tuple(
    320 // n for n in (1, 2, 4, 8)
)  # of a press's picture; the first that the budget allows is used
TILE_PX = WIDTHS_PX[-1]  # of a picture of depth minus cap
HIGH, LOW = (255, 0, 0), (0, 0, 255)  # RGB of depth above and below the ball


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


def jpeg_url(image: Image, width_px: int) -> str:
    """An RGB image, not wider than `width_px`, as a JPEG data URL."""
    height, width = image.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]))
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def press_urls(images: Sequence[Image], budget_bytes: int = 1_300_000) -> list[str]:
    """All presses as wide as the page's budget allows, which keeps it under 3 MB; hundreds become small."""
    for width in WIDTHS_PX:
        each = len(jpeg_url(images[len(images) // 2], width))
        if each * len(images) <= budget_bytes:
            break
    return [jpeg_url(image, width) for image in images]


def cap_scale_um(maps: Sequence[Map]) -> float:
    """The depth error of the tiles' full color: a round figure that few pixels exceed."""
    typical = float(np.nanquantile(np.abs(np.concatenate([one[::2, ::2].ravel() for one in maps])), 0.97))
    return charts.round_above(max(typical, 1e-3))


def cap_url(error_um: Map, scale_um: float) -> str:
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


@cache
def templates() -> jinja2.Environment:
    """The templates of the page; text in them is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    opacity = [k / 3 for k in range(4)]  # of a petal that no, one, two, three or more presses show
    environment.globals |= {"charts": charts, "support_opacity": opacity}
    filters: dict[str, Any] = {
        "deg": lambda value: "–" if value is None else f"{value:.2f}°",
        "digits": digits,
        "g": lambda value: f"{value:g}",
        "limit": limit_in_words,
        "minute": lambda time_utc: time_utc[:16].replace("T", " "),
        "px": lambda value: f"{value:.1f}",
        "setting": setting_in_words,
        "shown": shown,
    }
    environment.filters |= filters
    return environment


def report_page(content: dict[str, Any], presses: Presses, calibration: Calibration) -> str:
    """The page of a calibration's report: the same page for the same report, byte for byte.

    Parameters
    ----------
    content : from `report_content`
    presses : the presses of the report, for their pictures
    calibration : for its held-out depth pictures and its background

    Returns
    -------
    html : str
        At most about 3 MB; hundreds of presses have smaller pictures.
    """
    rows, report = content["presses"], calibration.report
    urls = press_urls([np.asarray(press.image, dtype=np.uint8) for press in presses.presses])
    names = short_names([row["name"] for row in rows])
    errors = [row["errors"]["normal_free_deg"] for row in rows if row["errors"]]
    background = np.clip(np.round(calibration.background), 0, 255).astype(np.uint8)
    caps, caps_um = None, {i: cap for i, cap in sorted(report.caps_um.items()) if cap.size}
    if caps_um:  # of every held-out press, on one scale
        scale_um = cap_scale_um([*caps_um.values()])
        pictures = [
            (names[i], rows[i]["errors"]["cap_free_um"], cap_url(cap, scale_um)) for i, cap in caps_um.items()
        ]
        caps = {"scale_um": scale_um, "pictures": pictures}
    page = templates().get_template("page.html")
    return page.render(
        content=content,
        facts=content["calibration"],
        used=used_in_words(report.presses),
        checks={check["name"]: check for check in content["checks"]},
        labels={name: figure.replace("(um)", "(µm)") for name, figure in FIGURES.items()},
        tiles=[{"row": row, "name": name, "url": url} for row, name, url in zip(rows, names, urls)],
        worse_deg=2 * float(np.median(errors)) if errors else np.inf,
        caps=caps,
        background_url=jpeg_url(background, width_px=WIDTHS_PX[0]),
    )


def digits(value: float) -> str:
    """Three significant digits, with zeros at the end."""
    return f"{value:#.3g}".removesuffix(".")

"""The report as one self-contained HTML page: `page.html`, filled with the report's numbers and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from gelform.calibration.held_out.measure import HeldOutSample
from gelform.calibration.presses.folder import Presses
from gelform.calibration.report import charts
from gelform.calibration.report.pictures import (
    cap_scale_um,
    cap_url,
    jpeg_url,
    press_urls,
    short_names,
)
from gelform.calibration.report.record import FIGURES, setting_in_words, used_in_words
from gelform.calibration.report.verdict import limit_in_words, shown
from gelform.calibration_file import Calibration


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
    opacity = (0, 0.3, 0.55, 0.85)  # of a petal that no, one, two, three or more presses show
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
    rows = content["presses"]
    urls = press_urls([np.asarray(press.image, dtype=np.uint8) for press in presses.presses])
    names = short_names([row["name"] for row in rows])
    errors = [row["errors"]["normal_free_deg"] for row in rows if row["errors"]]
    background = np.clip(np.round(calibration.background), 0, 255).astype(np.uint8)
    return (
        templates()
        .get_template("page.html")
        .render(
            content=content,
            facts=content["calibration"],
            used=used_in_words(calibration.report.presses),
            checks={check["name"]: check for check in content["checks"]},
            labels={name: figure.replace("(um)", "(µm)") for name, figure in FIGURES.items()},
            tiles=[{"row": row, "name": name, "url": url} for row, name, url in zip(rows, names, urls)],
            worse_deg=2 * float(np.median(errors)) if errors else np.inf,
            caps=_caps(rows, names, calibration.report.samples),
            background_url=jpeg_url(background, width_px=320),
        )
    )


def _caps(
    rows: Sequence[dict[str, Any]], names: Sequence[str], samples: Sequence[HeldOutSample]
) -> dict[str, Any] | None:
    """Pictures of depth minus the ball's cap of every held-out press, on one scale; None without any."""
    known = sorted((one for one in samples if one.cap_error_um.size), key=lambda one: one.index)
    if not known:
        return None
    scale_um = cap_scale_um([one.cap_error_um for one in known])
    pictures = [
        (names[one.index], rows[one.index]["errors"]["cap_free_um"], cap_url(one.cap_error_um, scale_um))
        for one in known
    ]
    return {"scale_um": scale_um, "pictures": pictures}


def digits(value: float) -> str:
    """Three significant digits, with zeros at the end."""
    return f"{value:#.3g}".removesuffix(".")

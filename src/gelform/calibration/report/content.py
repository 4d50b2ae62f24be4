"""All numbers of a calibration's report, for report.json and the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.coverage import DIRECTIONS, Coverage, press_coverage, press_next, square_tiles
from gelform.calibration.enough import NEEDED
from gelform.calibration.held_out.measure import HeldOutSample, at_sample
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report.record import CalibrationReport, PressReport
from gelform.calibration.report.statistics import (
    DRAWS,
    error_map,
    errors_where,
    fraction_within_sigma,
    gain_curve,
    square_error_by_direction,
)
from gelform.calibration.report.verdict import checks_of, verdict_of
from gelform.calibration_file import Calibration
from gelform.reconstruct import Reconstructor
from gelform.sensors.profiles import scale_off_make

FORMAT, FORMAT_VERSION = "gelform calibration report", 1
FIGURES: tuple[tuple[str, Callable[..., NDArray[np.float64]]], ...] = (
    ("normal_deg", np.mean),
    ("normal_free_deg", np.mean),
    ("normal_rim_deg", np.mean),
    ("cap_um", np.mean),
    ("cap_free_um", np.mean),
    ("radius_percent", np.median),
    ("off_contact_um", np.mean),
)


def report_content(
    presses: Presses,
    calibration: Calibration,
    *,
    rng: np.random.Generator,
    learning: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """The report of a calibration in numbers and words that JSON can hold.

    Parameters
    ----------
    presses : the presses of the calibration, in the same order
    calibration : with its `report` and its held-out samples
    rng : generator that draws presses for the intervals
    learning : from `learning_curve`

    Returns
    -------
    content : dict
        The content of `CalibrationReport.to_dict`, and format, verdict, checks, figures (with 95 % intervals over
        presses), calibration, background, coverage, gain, where, error_map, sigma, learning.

    Raises
    ------
    ValueError
        The calibration has no report with samples, or it is of other presses.
    """
    report = calibration.report
    if report is None or not report.samples:
        raise ValueError(
            "Expected a calibration fresh from calibrate(), with its report: a saved one has none."
        )
    names = [press.name for press in presses.presses]
    if names != [row.name for row in report.presses]:
        raise ValueError(
            f"Expected the {len(report.presses)} presses of the report, got {len(names)} others."
        )
    samples: tuple[HeldOutSample, ...] = report.samples
    ratio = float(calibration.settings["contact_radius_ratio"])
    inner = [one.within(ratio) for one in samples]
    reconstruct = Reconstructor(calibration)
    sigmas = []
    for one in inner:
        sigma = reconstruct.from_image(presses.presses[one.index].image).gradients_sigma
        assert sigma is not None  # presses were measured
        sigmas.append(at_sample(sigma, one))
    shape = calibration.image_shape
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        **report.to_dict(),
        "figures": _figures(report.presses, rng),
        "calibration": _facts(presses, calibration),
        "background": _background(calibration),
        "coverage": _coverage(report, shape, calibration.known_mm_per_px),
        "gain": {
            "contact_radius_ratio": ratio,
            "contact": gain_curve(inner, rng),
            "rim": gain_curve(samples, rng),
        },
        "where": errors_where(samples, shape, ratio),
        "error_map": error_map(samples, shape, square_tiles(shape, 16)),
        "sigma": fraction_within_sigma(inner, sigmas, shape, square_tiles(shape, 4)),
        "learning": learning,
    }
    checks = checks_of(_checked_figures(content))
    return {**content, "checks": checks, "verdict": verdict_of(checks, (learning or {}).get("sentence"))}


def _figures(rows: Sequence[PressReport], rng: np.random.Generator) -> dict[str, dict[str, Any]]:
    """Each figure over the held-out presses with its 95 % interval, by drawing presses with replacement."""
    scored = [row.errors for row in rows if row.errors]
    figures = {}
    for name, middle in FIGURES:
        values = np.abs([errors[name] for errors in scored])
        values = values[np.isfinite(values)]
        if values.size:
            figures[name] = {
                "value": float(middle(values)),
                "interval": interval_of(values, middle, rng) if NEEDED.interval.met(values.size) else None,
                "presses": int(values.size),
                "statistic": middle.__name__,
            }
    return figures


def interval_of(
    values: NDArray[np.float64], middle: Callable[..., NDArray[np.float64]], rng: np.random.Generator
) -> list[float]:
    """95 % bootstrap interval of a mean or median over presses."""
    drawn = values[rng.integers(0, values.size, size=(DRAWS, values.size))]
    return [float(v) for v in np.percentile(middle(drawn, axis=1), (2.5, 97.5))]


def _facts(presses: Presses, calibration: Calibration) -> dict[str, Any]:
    return {
        "sensor_name": calibration.sensor_name,
        "make": presses.make,
        "serial": calibration.serial,
        "gel_id": calibration.gel_id,
        "image_shape": list(calibration.image_shape),
        "mm_per_px": calibration.known_mm_per_px,
        "mm_per_px_sigma": calibration.mm_per_px_sigma,
        "ball_diameters_mm": sorted({press.ball_diameter_mm for press in presses.presses}),
        "color_model": calibration.color_model.name,
        "settings": {key: list(v) if isinstance(v, tuple) else v for key, v in calibration.settings.items()},
        "digest": calibration.digest,
        "created_utc": calibration.created_utc,
        "library_version": calibration.library_version,
    }


def _background(calibration: Calibration) -> dict[str, Any]:
    background = calibration.background
    return {
        "mean": [float(v) for v in background.mean(axis=(0, 1))],
        "noise": [float(v) for v in calibration.background_noise],
        "saturated_percent": float(100 * np.mean((background >= 254.5).any(axis=-1))),
        "dark_percent": float(100 * np.mean((background < 5).any(axis=-1))),
        "untouched_change": float(calibration.untouched_change),
    }


def report_coverage(report: CalibrationReport, shape: tuple[int, int], mm_per_px: float) -> Coverage:
    """The coverage of the presses that a calibration was fitted on."""
    used = [row for row in report.presses if row.accepted]
    circles = [(r.center_x_px, r.center_y_px, r.contact_radius_px) for r in used]
    return press_coverage(circles, [r.ball_diameter_mm / 2 / mm_per_px for r in used], shape)


def _coverage(report: CalibrationReport, shape: tuple[int, int], mm_per_px: float) -> dict[str, Any]:
    """Number of presses that show each slope direction in each tile, and the next places to press at."""
    coverage = report_coverage(report, shape, mm_per_px)
    rows, columns = coverage.counts.shape[:2]
    errors = square_error_by_direction(report.samples, shape, (rows, columns))
    return {
        "rows": rows,
        "columns": columns,
        "directions": DIRECTIONS,
        "presses": coverage.counts.reshape(-1, DIRECTIONS).tolist(),
        "covered": coverage.fraction,
        "next": [
            {**asdict(place), "contact_radius_px": coverage.contact_radius_px}
            for place in press_next(coverage, 3, errors)
        ],
    }


def _checked_figures(content: dict[str, Any]) -> dict[str, float | None]:
    """The figure of each check, in its unit; None if unknown."""
    rows, facts = content["presses"], content["calibration"]
    used, different = [row for row in rows if row["accepted"]], [row for row in rows if not row["repeats"]]
    gains = [abs(b["gain"] - 1) for b in content["gain"]["contact"] if _counts(b)]
    fractions = [b["share"] for b in content["sigma"]["by_slope"]]
    fractions += [one for one in content["sigma"]["by_place"] if one is not None]
    sigma = facts["mm_per_px_sigma"]
    off = scale_off_make(facts["make"], tuple(facts["image_shape"]), facts["mm_per_px"])
    figures = {name: one["value"] for name, one in content["figures"].items()}
    return {
        **figures,
        "rejected_percent": 100 * (1 - len(used) / len(different)),
        "presses_used": float(len(used)),
        "ball_sizes": float(len({row["ball_diameter_mm"] for row in used})),
        "covered_percent": 100 * content["coverage"]["covered"],
        "gain_percent": 100 * max(gains) if gains else None,
        "sigma_percent": 100 * max(abs(one - 0.68) for one in fractions) if fractions else None,
        **({} if off is None else {"scale_off_percent": 100 * off}),
        "ball_sigmas": max((one["sigmas"] for one in content["balls"]), default=None),
        "scale_percent": None if sigma is None else 100 * sigma / facts["mm_per_px"],
    }


def _counts(gain: dict[str, Any]) -> bool:
    """Whether a bin of the gain curve is judged; few pixels of a few presses are too uncertain."""
    known = NEEDED.judged_gain.met(gain["presses"]) and gain["pixels"] >= 500
    return bool(known and gain["slope_to"] <= 0.8)

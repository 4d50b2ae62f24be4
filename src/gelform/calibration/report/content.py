"""All numbers of a calibration's report: statistics of held-out residuals, the verdict, and the next step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from gelform.arrays import Array, Map, Mask, Numbers
from gelform.calibration.coverage import (
    COARSE,
    DIRECTIONS,
    NEEDED,
    Coverage,
    direction_of,
    press_coverage,
    press_next,
    presses_to_cover,
    square_tiles,
    tile_of,
)
from gelform.calibration.held_out import at_pixels, by_press
from gelform.calibration.inputs import MOST_SIGMAS, REMEDY
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report.charts import RIGHT_PERCENT, SHARE_FAIR, SHARE_RIGHT
from gelform.calibration.report.record import CalibrationReport, PressReport
from gelform.calibration_file import Calibration
from gelform.errors import counted
from gelform.image.view import DARK
from gelform.reconstruct import Reconstructor
from gelform.result.metrics import angle_deg
from gelform.sensors.profiles import scale_off_make
from gelform.slopes.sigma import MIN_IN_BIN, ONE_SIGMA, SATURATED_FROM

SLOPE_EDGES = tuple(round(0.1 * k, 1) for k in range(13))  # mm/mm, the borders of bins
BOOTSTRAPS = 1000  # draws of presses, for intervals
OVERALL = 200  # pixels that the overall error counts as, where a tile has few
INTERVAL = [(100 + side * 95) / 2 for side in (-1, 1)]  # %, the ends of a 95 % interval


def _bins_of(slope: Array) -> Iterator[tuple[dict[str, float], Mask]]:
    """The limits of each bin of slopes that holds enough pixels, and the pixels in it."""
    for low, high in pairwise(SLOPE_EDGES):
        member = (slope >= low) & (slope < high)
        if np.count_nonzero(member) >= MIN_IN_BIN:
            yield {"slope_from": low, "slope_to": high}, member


def _tile_means(
    pixels: Array, shape: tuple[int, int], grid: tuple[int, int], *values: Any, least: int = MIN_IN_BIN
) -> list[list[Any]]:
    """Number of pixels in each tile, row by row, and their means of some values (N,); None where they are few."""
    tile = tile_of(pixels["x_px"], pixels["y_px"], shape, grid)
    count = np.bincount(tile, minlength=grid[0] * grid[1])
    sums = [np.bincount(tile, one, count.size) for one in values]
    return [
        count.tolist(),
        *([float(s / n) if n >= least else None for s, n in zip(one, count)] for one in sums),
    ]


def gain_curve(pixels: Array, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Recovered over true slope, by bins of the true slope, with a 95 % interval over presses.

    The gain of a bin is `sum g . t / sum t . t` over its pixels, g the reconstructed and t the true gradient:
    noise does not raise it, and a regression to the mean at the rim shows as less than 1.
    """
    presses = by_press(pixels)
    sums = np.zeros((3, len(presses), len(SLOPE_EDGES) - 1))
    for k, one in enumerate(presses):
        bins, true = np.linalg.norm(one["true"], axis=1), one["true"].astype(np.float64)
        for row, weights in enumerate(((one["solved"] * true).sum(1), (true**2).sum(1), np.ones(len(true)))):
            sums[row, k] = np.histogram(bins, SLOPE_EDGES, weights=weights)[0]
    alike = np.full(len(presses), 1 / len(presses))
    # How often each press is drawn in each bootstrap, (draws, presses).
    drawn = rng.multinomial(len(presses), alike, size=BOOTSTRAPS).astype(np.float64)
    curve = []
    for b, (low, high) in enumerate(pairwise(SLOPE_EDGES)):
        projected, square, count = sums[:, :, b]
        if not NEEDED.interval.met(int(np.count_nonzero(count))) or count.sum() < MIN_IN_BIN:
            continue
        among = drawn @ square
        gains = (drawn @ projected)[among > 0] / among[among > 0]
        curve.append(
            {
                "slope_from": low,
                "slope_to": high,
                "gain": float(projected.sum() / square.sum()),
                "interval": [float(v) for v in np.percentile(gains, INTERVAL)],
                "presses": int(np.count_nonzero(count)),
                "pixels": int(count.sum()),
            }
        )
    return curve


def error_map(pixels: Array, shape: tuple[int, int], grid: tuple[int, int]) -> dict[str, Any]:
    """Held-out slope errors by tile: mean (dx, dy), RMS length and number of pixels, None where there are few."""
    errors = (pixels["solved"] - pixels["true"]).astype(np.float64)
    parts = errors[:, 0], errors[:, 1], (errors**2).sum(1)
    count, dx, dy, square = _tile_means(pixels, shape, grid, *parts, least=10)
    mean = [None if x is None else [x, y] for x, y in zip(dx, dy)]
    rms = [None if one is None else math.sqrt(one) for one in square]
    return {"rows": grid[0], "columns": grid[1], "mean": mean, "rms": rms, "pixels": count}


def square_error_by_direction(pixels: Array, shape: tuple[int, int], tiles: tuple[int, int]) -> Numbers:
    """(rows, columns, 8) mean square slope error, drawn to the overall mean, which counts as some pixels."""
    size = tiles[0] * tiles[1] * DIRECTIONS
    index = tile_of(pixels["x_px"], pixels["y_px"], shape, tiles) * DIRECTIONS + direction_of(pixels["true"])
    square = ((pixels["solved"] - pixels["true"]).astype(np.float64) ** 2).sum(axis=1)
    total, count = np.bincount(index, square, size), np.bincount(index, minlength=size)
    overall = total.sum() / count.sum() if count.any() else 1.0
    mean: Numbers = (total + OVERALL * overall) / (count + OVERALL)
    return mean.reshape(*tiles, DIRECTIONS)


def fraction_within_sigma(
    pixels: Array, sigma: Map, shape: tuple[int, int], grid: tuple[int, int]
) -> dict[str, Any]:
    """Fraction of held-out slopes within one stated standard deviation, by bins of slope and of place; 0.68 is right.

    `sigma` (N, 2) is that of each pixel's slope. `off` is how far the lowest and the highest fraction lie below and above
    0.68, less the standard error over presses of each; empty without a bin of enough presses.
    """
    inside = (np.abs(pixels["solved"] - pixels["true"]) <= sigma).mean(axis=1)
    slope = np.linalg.norm(pixels["solved"], axis=1)
    count, by_place = _tile_means(pixels, shape, grid, inside)
    tile = tile_of(pixels["x_px"], pixels["y_px"], shape, grid)
    groups = [tile == k for k in np.flatnonzero(np.array(count) >= MIN_IN_BIN)]
    off = [
        _off_right(inside[one], pixels["press"][one]) for one in (*(m for _, m in _bins_of(slope)), *groups)
    ]
    known = [one for one in off if one is not None]
    return {
        "all": float(inside.mean()),
        "off": [max(one[side] for one in known) for side in (0, 1)] if known else [],
        "by_slope": [{**limits, "share": float(inside[member].mean())} for limits, member in _bins_of(slope)],
        "rows": grid[0],
        "columns": grid[1],
        "by_place": by_place,
    }


def _off_right(inside: Numbers, press: Array) -> tuple[float, float] | None:
    """How far a fraction is below and above 0.68, beyond its standard error over presses; None of few presses."""
    _, index = np.unique(press, return_inverse=True)
    fraction, sums = inside.mean(), np.bincount(index, inside - inside.mean())
    if not NEEDED.interval.met(sums.size):
        return None
    error = math.sqrt((sums**2).sum() * sums.size / (sums.size - 1)) / inside.size
    below, above = (max(0.0, 100 * (side * (ONE_SIGMA - fraction) - error)) for side in (1, -1))
    return float(below), float(above)


def errors_where(
    pixels: Array, shape: tuple[int, int], contact_radius_ratio: float, grid: tuple[int, int] = COARSE
) -> dict[str, Any]:
    """Normal errors of reconstructed presses by slope and by place: `contact` up to its edge, `rim` up to the visible rim.

    Means over pixels, so that a large contact counts for more than a small one; the figures of whole presses are means over
    presses. Bins of the ball's slope of under 50 pixels are left out, and such cells of the grid (rows, columns) are None.
    """
    return {
        "contact_radius_ratio": contact_radius_ratio,
        "contact": _part(pixels[pixels["rho"] < contact_radius_ratio], shape, grid),
        "rim": _part(pixels, shape, grid),
    }


def _part(pixels: Array, shape: tuple[int, int], grid: tuple[int, int]) -> dict[str, Any]:
    read, true = pixels["solved"], pixels["true"].astype(np.float64)
    angles = angle_deg(read, pixels["true"])
    count, by_place = _tile_means(pixels, shape, grid, angles)
    return {
        "normal_deg": float(angles.mean()) if angles.size else None,
        "by_slope": [
            {
                **limits,
                "normal_deg": float(angles[member].mean()),
                "gain": float(np.sum(read[member] * true[member]) / np.sum(true[member] ** 2)),
                "pixels": int(np.count_nonzero(member)),
            }
            for limits, member in _bins_of(np.linalg.norm(true, axis=1))
        ],
        "by_place": {"rows": grid[0], "columns": grid[1], "normal_deg": by_place, "pixels": count},
    }


LEVELS = ("good", "fair", "poor")


@dataclass(frozen=True)
class Limit:
    """The figure of a check, and the limits of good and fair."""

    name: str
    label: str
    unit: str
    good: float  # largest good figure; the smallest one if `rising`
    fair: float
    rising: bool  # a larger figure is better
    action: str  # the advice if it is not good


# Causes come before their effects. {press} says how often and how deep to press, {steep} how deep for a slope, {ball}
# which ball or pitch to check.
LIMITS = (
    Limit("rejected_percent", "presses rejected", "%", 10, 20, False,
          "Look at the rejected presses. Each reason says what to press or to write down differently."),
    Limit("ball_sigmas", "stated ball diameter against the measured one", "σ", MOST_SIGMAS, MOST_SIGMAS, False,
          "{ball}"),
    Limit("scale_off_percent", "mm_per_px against the make's", "%", 10, math.inf, False,
          "Check mm_per_px. Images of this make have another value, unless you crop them differently."),
    Limit("presses_used", "presses used", "", NEEDED.advised.presses, NEEDED.fair.presses, True,
          "{press}, first at the places marked 1, 2, 3."),
    Limit("radius_percent", "error of the ball's radius, held out", "%", 3, 6, False,
          "Check the diameter and the mm per pixel that you gave, and that each press is of that ball: two balls under one "
          "diameter read like this. Add presses of a second ball of another size."),
    Limit("covered_percent", "gel that presses cover, in all slope directions", "%", 80, 60, True,
          "{press}, first at the places marked 1, 2, 3. The presses do not show all slope directions there yet."),
    Limit("off_contact_um", "depth error off contact, held out", "µm", 30, 80, False,
          "Take a new background image in the same minute as the presses, with exposure and white balance fixed."),
    Limit("gain_percent", "largest deviation of the slope gain from 1", "%", 5, 12, False,
          "{steep}. Too few presses show the slopes whose gain is wrong."),
    Limit("normal_free_deg", "angle error of the normals, held out", "°", 3, 5, False,
          "Check that exposure and light did not change. Look for cast shadows. {press} at the places marked 1, 2, 3."),
    Limit("cap_free_um", "depth error in the contact, held out", "µm", 20, 40, False,
          "Look for a pattern in the depth pictures: dust, a shadow, a scratch. {press} at the places marked 1, 2, 3."),
    Limit("narrow_percent", "uncertainty too small, share within it below 68 %", "points",
          RIGHT_PERCENT - SHARE_RIGHT[0], RIGHT_PERCENT - SHARE_FAIR, False,
          "{press} at the places marked 1, 2, 3. Until then, errors are larger than stated where the share is low."),
    Limit("ball_sizes", "ball sizes", "", 2, 1, True,
          "Add presses of a second ball of another size. One size alone cannot show a wrong slope scale."),
    Limit("wide_percent", "uncertainty too large, share within it above 68 %", "points",
          SHARE_RIGHT[1] - RIGHT_PERCENT, math.inf, False,
          "Use it. Some slopes are better than their stated uncertainty."),
    Limit("scale_percent", "uncertainty of the scale", "%", 1, 3, False,
          "Measure mm_per_px on an object of known size. Write it into sensor.toml, together with mm_per_px_sigma."),
)  # fmt: skip
COVERED = next(limit for limit in LIMITS if limit.name == "covered_percent")
HEADLINE = ("normal_free_deg", "radius_percent")
# If one is poor, so is the headline, because the other figures rely on the labels.
REFUTING = ("ball_sigmas",)
# Effects of the number and the places of presses, where a light is as it was.
PRESSED = ("presses_used", "covered_percent")
MENDED_BY_PRESSES = ("gain_percent", "normal_free_deg", "cap_free_um", "narrow_percent")
UNKNOWN = "not known"  # in the place of a level


def level_of(limit: Limit, value: float | None) -> str:
    """good, fair or poor, of the figure as it is printed, or that it is not known."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    value, sign = float(f"{value:.3g}"), -1 if limit.rising else 1
    if sign * value <= sign * limit.good:
        return "good"
    return "fair" if sign * value <= sign * limit.fair else "poor"


def checks_of(
    figures: Mapping[str, float | None],
    standard_errors: Mapping[str, float] | None = None,
    advice: Mapping[str, str] | None = None,
) -> list[dict[str, Any]]:
    """Every check with its figure (None if unknown), its level and its limits, causes before their effects.

    A check that the sensor does not need, and that has no figure, is left out. Some figures have a standard error. `advice`
    has the words for {press}, {steep} and {ball} in the actions.
    """
    words = {"press": "Press again", "steep": "Press a little deeper", "ball": REMEDY, **(advice or {})}
    return [
        {
            **asdict(limit),
            "action": limit.action.format(**words),
            "value": figures[limit.name],
            "level": level_of(limit, figures[limit.name]),
            "standard_error": (standard_errors or {}).get(limit.name),
        }
        for limit in LIMITS
        if limit.name in figures
    ]


def verdict_of(checks: list[dict[str, Any]], learning_sentence: str | None = None) -> dict[str, Any]:
    """The headline: the worse of normals and radius in words; one sentence about the next step; then the checks.

    Both are errors at the places that were pressed. So over any other poor check the headline is fair at best.
    The next step belongs to the first check that is poor, then fair, then not known; causes come before their effects.
    What more presses mend is left to a check of their number and places that is not good. An uncertainty that is too large
    calls for nothing. If all is good, the sentence says how to keep it so.
    """
    named = {check["name"]: check for check in checks}
    level = max((named[name]["level"] for name in HEADLINE), key=LEVELS.index)
    poor = [check for check in checks if check["level"] == "poor" and check["name"] not in HEADLINE]
    refuted = [check for check in poor if check["name"] in REFUTING]
    if refuted:
        level = "poor"
    elif poor and level == "good":
        level = "fair"
    first_of = refuted or [one for one in checks if one["level"] != "good" and one["name"] != "wide_percent"]
    worst = ("poor", "fair", UNKNOWN)
    first = min(first_of, key=lambda check: worst.index(check["level"]), default=None)
    if first and first["name"] in MENDED_BY_PRESSES:
        causes = [named[name] for name in PRESSED if named[name]["level"] != "good"]
        first = min([*causes, first], key=lambda check: (check is first, worst.index(check["level"])))
    done = "Use it. Calibrate again after a new gel, another light or another camera setting."
    return {
        "level": level,
        "headline": _headline(level, named, bool(refuted)),
        "next": first["action"] if first else done,
        "because": _because(first) if first else None,
        "counts": {name: sum(check["level"] == name for check in checks) for name in (*LEVELS, UNKNOWN)},
        "checks": _checks_in_words(checks),
        "learning": learning_sentence,
    }


def _because(check: Mapping[str, Any]) -> str:
    return f"{check['label']}: {shown(check)}" + (f", {check['level']}" if check["level"] != UNKNOWN else "")


def _headline(level: str, named: Mapping[str, dict[str, Any]], refuted: bool) -> str:
    error = named["normal_free_deg"]["standard_error"]
    few = error is not None and not NEEDED.edge.met(int(named["presses_used"]["value"]))
    # What presses do not cover was not held out either.
    where = ", where presses are. Elsewhere errors are not known"
    figures = (
        f"held-out normals are off by {named['normal_free_deg']['value']:.1f}"
        f"{f' ± {error:.1f}' if few else ''}°, the ball radius by {named['radius_percent']['value']:.1f} %"
        f"{where if named['covered_percent']['level'] == 'poor' else ''}"
    )
    if refuted:
        return f"Poor: the ball diameter or mm_per_px is wrong. With them, {figures}"
    return f"{level.capitalize()}: {figures}"


def _checks_in_words(checks: Sequence[Mapping[str, Any]]) -> str:
    """How many checks are good; of each worse level the others with their figures; the names alone of what is not known."""
    groups = [f"{sum(one['level'] == 'good' for one in checks)} of {len(checks)} are good"]
    for level in ("poor", "fair", UNKNOWN):
        found = [one for one in checks if one["level"] == level]
        if found:
            listed = [one["label"] + ("" if level == UNKNOWN else f" ({shown(one)})") for one in found]
            groups.append(f"{level}: {', '.join(listed)}")
    return "; ".join(groups)


def shown(check: Mapping[str, Any]) -> str:
    """A check's figure with its unit."""
    if check["value"] is None:
        return UNKNOWN
    return f"{check['value']:.3g} {check['unit']}".replace(" °", "°").strip()


def limit_in_words(check: Mapping[str, Any], level: str) -> str:
    """A check's limit of good or fair, such as "≤ 5"; any figure is within an endless one."""
    side = "≥" if check["rising"] else "≤"
    return f"{side} {check[level]:g}" if math.isfinite(check[level]) else "any"


FORMAT, FORMAT_VERSION = "gelform calibration report", 1


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
    calibration : with its `report` and its held-out pixels
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
        The calibration has no report with pixels, or it is of other presses.
    """
    report = calibration.report
    if report is None or report.pixels is None:
        raise ValueError(
            "Expected a calibration fresh from calibrate(), with its report: a saved one has none."
        )
    names = [press.name for press in presses.presses]
    if names != [row.name for row in report.presses]:
        raise ValueError(
            f"Expected the {len(report.presses)} presses of the report, got {len(names)} others."
        )
    pixels, ratio = report.pixels, float(calibration.settings["contact_radius_ratio"])
    inner, reconstruct, sigmas = pixels[pixels["rho"] < ratio], Reconstructor(calibration), []
    for one in by_press(inner):
        sigma = reconstruct.from_image(presses.presses[one["press"][0]].image).gradients_sigma
        assert sigma is not None  # presses were measured
        sigmas.append(at_pixels(sigma, one))
    shape = calibration.image_shape
    coverage = report_coverage(report, shape, calibration.known_mm_per_px)
    rows, columns = coverage.counts.shape[:2]
    errors = square_error_by_direction(pixels, shape, (rows, columns))
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        **report.to_dict(),
        "figures": _figures(report.presses, rng),
        "calibration": _facts(presses, calibration),
        "background": _background(calibration),
        # number of presses that show each slope direction in each tile, and the next places to press at
        "coverage": {
            "rows": rows,
            "columns": columns,
            "directions": DIRECTIONS,
            "presses": coverage.counts.reshape(-1, DIRECTIONS).tolist(),
            "covered": coverage.fraction,
            "next": [
                {**asdict(place), "contact_radius_px": coverage.contact_radius_px}
                for place in press_next(coverage, 3, errors)
            ],
        },
        "gain": {
            "contact_radius_ratio": ratio,
            "contact": gain_curve(inner, rng),
            "rim": gain_curve(pixels, rng),
        },
        "where": errors_where(pixels, shape, ratio),
        "error_map": error_map(pixels, shape, square_tiles(shape, 16)),
        "sigma": fraction_within_sigma(inner, np.concatenate(sigmas), shape, square_tiles(shape, 4)),
        "learning": learning,
    }
    standard_errors = {name: one["standard_error"] for name, one in content["figures"].items()}
    checks = checks_of(_checked_figures(content), standard_errors, _advice(content, coverage))
    return {**content, "checks": checks, "verdict": verdict_of(checks, (learning or {}).get("sentence"))}


def _figures(rows: Sequence[PressReport], rng: np.random.Generator) -> dict[str, dict[str, Any]]:
    """Each figure over the held-out presses with its 95 % interval, by drawing presses with replacement."""
    scored, figures = [row.errors for row in rows if row.errors], {}
    for name in scored[0] if scored else ():
        middle = np.median if name == "radius_percent" else np.mean
        values = np.abs([errors[name] for errors in scored])
        values = values[np.isfinite(values)]
        if values.size:
            figures[name] = {
                "value": float(middle(values)),
                "interval": interval_of(values, middle, rng) if NEEDED.interval.met(values.size) else None,
                "standard_error": float(values.std(ddof=1) / values.size**0.5) if values.size > 1 else None,
                "presses": int(values.size),
                "statistic": middle.__name__,
            }
    return figures


def interval_of(values: Numbers, middle: Callable[..., Numbers], rng: np.random.Generator) -> list[float]:
    """95 % bootstrap interval of a mean or median over presses."""
    drawn = values[rng.integers(0, values.size, size=(BOOTSTRAPS, values.size))]
    return [float(v) for v in np.percentile(middle(drawn, axis=1), INTERVAL)]


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
        "saturated_percent": float(100 * np.mean((background >= SATURATED_FROM).any(axis=-1))),
        "dark_percent": float(100 * np.mean((background < DARK).any(axis=-1))),
        "untouched_change": float(calibration.untouched_change),
    }


def report_coverage(report: CalibrationReport, shape: tuple[int, int], mm_per_px: float) -> Coverage:
    """The coverage of the presses that a calibration was fitted on."""
    used = [row for row in report.presses if row.accepted]
    circles = [(r.center_x_px, r.center_y_px, r.contact_radius_px) for r in used]
    return press_coverage(circles, [r.ball_diameter_mm / 2 / mm_per_px for r in used], shape)


def _judged_gains(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The bins of the gain curve that count; few pixels of a few presses are too uncertain."""
    return [
        b
        for b in content["gain"]["contact"]
        if NEEDED.judged_gain.met(b["presses"]) and b["pixels"] >= 500 and b["slope_to"] <= 0.8
    ]


def _advice(content: Mapping[str, Any], coverage: Coverage) -> dict[str, str]:
    """Words for the actions: press as often as covers the gel, or the number advised lacks, as deep as most presses."""
    used = [row for row in content["presses"] if row["accepted"]]
    missing = presses_to_cover(coverage, COVERED.good / 100)
    more = max(NEEDED.advised.presses - len(used), missing, len(content["coverage"]["next"]))
    scale = content["calibration"]["mm_per_px"]
    balls = np.array([row["ball_diameter_mm"] / 2 for row in used])
    radii = np.minimum(scale * np.array([row["contact_radius_px"] for row in used]), balls)
    depth = float(np.median(balls - np.sqrt(balls**2 - radii**2)))
    press = f"Press the ball {counted(more, 'more time')}, about {depth:.1g} mm deep"
    worst = max(_judged_gains(content), key=lambda b: abs(b["gain"] - 1), default=None)
    # The contact's edge has the steepest slope.
    deep = float(np.median(balls)) * (1 - 1 / math.hypot(1, worst["slope_to"])) if worst else 0.0
    deeper = f"Press at least {deep:.2g} mm deep, or add a smaller ball"
    steep = deeper if deep > depth else f"{press}, at the places marked 1, 2, 3"
    doubted = [one for one in content["balls"] if one["checks"]]
    wrong = [one["remedy"] for one in sorted(doubted, key=lambda one: -one["sigmas"])]
    return {"press": press, "steep": steep, **({"ball": wrong[0]} if wrong else {})}


def _checked_figures(content: dict[str, Any]) -> dict[str, float | None]:
    """The figure of each check, in its unit; None if unknown."""
    rows, facts = content["presses"], content["calibration"]
    used, different = [row for row in rows if row["accepted"]], [row for row in rows if not row["repeats"]]
    gains = [abs(b["gain"] - 1) for b in _judged_gains(content)]
    narrow, wide = content["sigma"]["off"] or (None, None)
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
        "narrow_percent": narrow,
        "wide_percent": wide,
        **({} if off is None else {"scale_off_percent": 100 * off}),
        "ball_sigmas": max((one["sigmas"] for one in content["balls"] if one["checks"]), default=None),
        "scale_percent": None if sigma is None else 100 * sigma / facts["mm_per_px"],
    }

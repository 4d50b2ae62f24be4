"""The verdict: which part of a calibration is good, fair or poor, and the next step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from gelform.calibration.balls import MOST_SIGMAS, REMEDY
from gelform.calibration.enough import NEEDED

LEVELS = ("good", "fair", "poor")


@dataclass(frozen=True)
class Limit:
    """The figure of a check, and the limits of good and fair.

    Attributes
    ----------
    name, label, unit : of the figure
    good, fair : largest good and fair figure; the smallest one if `rising`
    rising : a larger figure is better
    action : the advice if it is not good
    """

    name: str
    label: str
    unit: str
    good: float
    fair: float
    rising: bool
    action: str


LIMITS = (
    Limit("rejected_percent", "presses rejected", "%", 10, 20, False,
          "Look at the rejected presses. Each reason says what to press or to write down differently."),
    Limit("presses_used", "presses used", "", NEEDED.advised.presses, NEEDED.fair.presses, True,
          f"Press the ball at more places: {NEEDED.advised.presses} presses or more. Begin at the places marked 1, 2, 3."),
    Limit("normal_free_deg", "angle error of the normals, held out", "°", 3, 5, False,
          "Press at the places marked 1, 2, 3. Check that exposure and light did not change. Look for cast shadows."),
    Limit("ball_sigmas", "stated ball diameter against the measured one", "σ", MOST_SIGMAS, MOST_SIGMAS, False,
          REMEDY + " Presses of another unit or of another ball contradict them."),
    Limit("scale_off_percent", "mm_per_px against the make's", "%", 10, math.inf, False,
          "Check mm_per_px. Images of this make have another value, unless you crop them differently."),
    Limit("radius_percent", "error of the ball's radius, held out", "%", 3, 6, False,
          "Check the ball's diameter and the mm per pixel that you gave. Add presses of a second ball of another size."),
    Limit("covered_percent", "places and slope directions that presses show", "%", 80, 60, True,
          "Press at the places marked 1, 2, 3. The presses do not show all slope directions there yet."),
    Limit("gain_percent", "largest deviation of the slope gain from 1", "%", 5, 12, False,
          "Press a little deeper, or add a smaller ball. Too few presses show the slopes whose gain is wrong."),
    Limit("cap_free_um", "depth error in the contact, held out", "µm", 20, 40, False,
          "Press at the places marked 1, 2, 3. Look for a pattern in the depth pictures: dust, a shadow, a scratch."),
    Limit("off_contact_um", "depth error off contact, held out", "µm", 30, 80, False,
          "Take a new background image in the same minute as the presses, with exposure and white balance fixed."),
    Limit("sigma_percent", "largest deviation of the uncertainty from 68 %", "%", 10, 23, False,
          "Press where the share is far from 68 %, first at places 1, 2, 3. Until then, the uncertainty is rough."),
    Limit("ball_sizes", "ball sizes", "", 2, 1, True,
          "Add presses of a second ball of another size. One size alone cannot show a wrong slope scale."),
    Limit("scale_percent", "uncertainty of the scale", "%", 1, 3, False,
          "Measure mm_per_px on an object of known size. Write it into sensor.toml, together with mm_per_px_sigma."),
)  # fmt: skip
HEADLINE = ("normal_free_deg", "radius_percent")
# If one is poor, so is the headline, because the other figures rely on the labels.
REFUTING = ("ball_sigmas",)


def level_of(limit: Limit, value: float | None) -> str:
    """good, fair or poor, of the figure as it is printed; an unknown one is fair."""
    if value is None or not math.isfinite(value):
        return "fair"
    value, sign = float(_printed(value)), -1 if limit.rising else 1
    if sign * value <= sign * limit.good:
        return "good"
    return "fair" if sign * value <= sign * limit.fair else "poor"


def checks_of(
    figures: Mapping[str, float | None], standard_errors: Mapping[str, float] | None = None
) -> list[dict[str, Any]]:
    """Every check with its figure (None if unknown), its level and its limits, causes before their effects.

    A check that the sensor does not need, and that has no figure, is left out. Some figures have a standard error.
    """
    return [
        {
            **asdict(limit),
            "value": figures[limit.name],
            "level": level_of(limit, figures[limit.name]),
            "standard_error": (standard_errors or {}).get(limit.name),
        }
        for limit in LIMITS
        if limit.name in figures
    ]


def verdict_of(checks: list[dict[str, Any]], learning_sentence: str | None = None) -> dict[str, Any]:
    """The headline: the worse of normals and radius in words, and one sentence about the next step.

    Both are errors at the places that were pressed. So over any other poor check the headline is fair at best, and names it.
    The next step belongs to the largest fault: a poor check comes before a fair one, and then the check whose figure is the
    most times its limit. Among equal ones the first counts, because causes come before their effects. If all is good, the
    sentence says how to keep it so.
    """
    named = {check["name"]: check for check in checks}
    level = max((named[name]["level"] for name in HEADLINE), key=LEVELS.index)
    poor = [check for check in checks if check["level"] == "poor" and check["name"] not in HEADLINE]
    refuted = [check for check in poor if check["name"] in REFUTING]
    if refuted:
        level = "poor"
    elif poor and level == "good":
        level = "fair"
    first_of = refuted or [check for check in checks if check["level"] != "good"]
    first = max(first_of, key=_severity, default=None)
    done = "Use it. Calibrate again after a new gel, another light or another camera setting."
    return {
        "level": level,
        "headline": _headline(level, named, poor, bool(refuted)),
        "next": first["action"] if first else done,
        "because": f"{first['label']}: {shown(first)}, {first['level']}" if first else None,
        "counts": {name: sum(check["level"] == name for check in checks) for name in LEVELS},
        "learning": learning_sentence,
    }


def _headline(
    level: str, named: Mapping[str, dict[str, Any]], poor: Sequence[dict[str, Any]], refuted: bool
) -> str:
    error, covered = named["normal_free_deg"]["standard_error"], named["covered_percent"]
    few = error is not None and not NEEDED.edge.met(int(named["presses_used"]["value"]))
    # What presses do not cover was not held out either.
    where = (
        f"where presses are ({shown(covered)} of places and slope directions), "
        if covered["level"] == "poor"
        else ""
    )
    figures = (
        f"{where}held-out normals are off by {named['normal_free_deg']['value']:.1f}"
        f"{f' ± {error:.1f}' if few else ''}°, the ball radius by {named['radius_percent']['value']:.1f} %"
        f"{'. Elsewhere errors are not known' if where else ''}"
    )
    if refuted:
        return f"Poor: the ball diameter or mm_per_px is wrong. With them, {figures}"
    said = [f"{level.capitalize()}: {figures}"]
    if poor and level != "poor":
        said.append("Poor checks: " + ", ".join(f"{check['label']} ({shown(check)})" for check in poor))
    if named["ball_sigmas"]["value"] is None:
        said.append("Nothing checked the ball diameter")
    if named.get("scale_off_percent", {"level": "good"})["level"] != "good":
        said.append("The mm_per_px is unusual for this sensor")
    return ". ".join(said)


def _severity(check: Mapping[str, Any]) -> tuple[int, float]:
    """The severity of a check: its level, then its figure over the limit of good, or the inverse if `rising`."""
    value, limit = check["value"], check["good"]
    if value is None or not math.isfinite(value):
        return LEVELS.index(check["level"]), 1.0
    part, whole = (value, limit) if check["rising"] else (limit, value)
    return LEVELS.index(check["level"]), whole / part if part > 0 else math.inf


def shown(check: dict[str, Any]) -> str:
    """A check's figure with its unit."""
    if check["value"] is None:
        return "not known"
    return f"{_printed(check['value'])} {check['unit']}".replace(" °", "°").strip()


def _printed(value: float) -> str:
    return f"{value:.3g}"


def limit_in_words(check: Mapping[str, Any], level: str) -> str:
    """A check's limit of good or fair, such as "≤ 5"; any figure is within an endless one."""
    side = "≥" if check["rising"] else "≤"
    return f"{side} {check[level]:g}" if math.isfinite(check[level]) else "any"

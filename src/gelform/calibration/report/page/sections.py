"""The sections of the report's page, each from the numbers of `report_content`."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.report.page import charts
from gelform.calibration.report.page.presses import jpeg_url
from gelform.calibration.report.verdict import shown
from gelform.foundations.npz_files import DIGEST_SHOWN

BACKGROUND_WIDTH_PX = 320  # px, of the picture of the gel at rest
CARDS = (
    ("normal_free_deg", "Normals in the contact", "°", "mean angle to the ball's normals, center fitted"),
    ("radius_percent", "The ball's radius", " %", "median error of a sphere fitted to the depth"),
    (
        "cap_free_um",
        "Depth in the contact",
        " µm",
        "RMS difference from the ball's cap, without fitting a scale",
    ),
    ("off_contact_um", "Depth off contact", " µm", "RMS where nothing touches the gel; 0 is right"),
)
COLUMNS = {
    "normal_free_deg": ("normals", "°"),
    "slope_error": ("typical slope error", "mm/mm"),
}
ERRORS_OF = {"normal_free_deg": ("normal_free_deg_se", "standard_error_deg")}
NOT_FIGURES = {"candidate", "chosen", "standard_error_deg"}


def section(anchor: str, title: str, *parts: str) -> str:
    """A section of the page with its title."""
    return f'<section id="{anchor}"><h2>{title}</h2>{"".join(parts)}</section>'


def table(head: str, rows: str, kind: str = "") -> str:
    """A table that scrolls if it is too wide."""
    return (
        f'<div class="scroll"><table{kind}><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _key(*entries: str) -> str:
    return f'<ul class="key">{"".join(f"<li>{entry}</li>" for entry in entries)}</ul>'


def figures_section(content: dict[str, Any]) -> str:
    """The four figures with their intervals, and every check with its limits."""
    checks = {check["name"]: check for check in content["checks"]}
    cards = []
    for name, label, unit, meaning in CARDS:
        one = content["figures"].get(name)
        if one is None:
            cards.append(
                f'<div class="card">{label}<b>–</b><span class="muted">no press leaves enough of the image free</span></div>'
            )
            continue
        check, interval = checks[name], one["interval"]
        between = f" <small>{digits(interval[0])} – {digits(interval[1])}</small>" if interval else ""
        cards.append(
            f'<div class="card">{label}<b>{digits(one["value"])}{unit}{between}</b>'
            f"{charts.limit_bar(one['value'], interval, check['good'], check['fair'])}"
            f'<span class="muted">{meaning}; {one["presses"]} presses</span></div>'
        )
    head = (
        '<th>check, and what to do if it is not good</th><th>figure</th><th class="text">verdict</th>'
        '<th class="limit">good</th><th class="limit">fair</th>'
    )
    return section(
        "figures",
        "Held-out errors",
        "<p class='lead'>A model of other presses read each press. The small figures are the 95 % interval over presses "
        "(drawn with replacement). No scale is fitted.</p>"
        f'<div class="cards">{"".join(cards)}</div><h3>Checks</h3>',
        table(head, "".join(_check_row(check) for check in content["checks"])),
    )


def _check_row(check: dict[str, Any]) -> str:
    side = "≥" if check["rising"] else "≤"
    action = "" if check["level"] == "good" else f'<span class="do">{escape(check["action"])}</span>'
    return (
        f"<tr><td>{escape(check['label'])}{action}</td><td>{shown(check)}</td>"
        f'<td class="text"><span class="tag {check["level"]}">{check["level"]}</span></td>'
        f'<td class="limit">{side} {check["good"]:g}</td><td class="limit">{side} {check["fair"]:g}</td></tr>'
    )


def coverage_section(content: dict[str, Any]) -> str:
    """The slope directions that each place has shown, and the next places to press at."""
    coverage, facts = content["coverage"], content["calibration"]
    places = "".join(
        f"<li>{escape(place_in_words(place, facts['mm_per_px']))}</li>" for place in coverage["next"]
    )
    filled = (
        f'<i style="background:var(--accent);opacity:{opacity}"></i>{count}'
        for count, opacity in zip(("one", "two", "three or more"), charts.SUPPORT_OPACITY[1:])
    )
    key = _key(
        '<i style="background:var(--card);border:1px solid var(--line)"></i>no press',
        *filled,
    )
    return section(
        "coverage",
        "Coverage: where presses are missing",
        f"<p class='lead'>The lights are near, so the same color means another slope at another place. Press every place "
        f"from all sides. The presses show {100 * coverage['covered']:.0f} % of the places and slope directions. "
        "A petal is a slope direction. It is empty if no press shows it, and full from three presses on. "
        "At the dashed circles, another press of the same ball would reduce the error most: there are few presses and "
        "large held-out errors.</p>"
        f'<div class="two"><div>{charts.coverage_map(coverage, facts["image_shape"])}{key}'
        f"</div><div><h3>Press here next</h3><ol>{places}</ol></div></div>",
    )


def models_section(content: dict[str, Any]) -> str:
    """The models that were tried, with every measured figure, and the rule of selection."""
    rows = content["candidates"]
    tried = {key for row in rows for key in row if key not in NOT_FIGURES and not key.endswith("_se")}
    keys = [key for key in COLUMNS if key in tried] + sorted(tried - COLUMNS.keys())
    head = "".join(f"<th>{_column(key)}</th>" for key in keys)
    end = 1.1 * max(row["normal_free_deg"] for row in rows)
    body = ""
    for row in rows:
        kind, chosen = (' class="chosen"', " ← chosen") if row["chosen"] else ("", "")
        figures = "".join(f"<td>{_with_error(row, key)}</td>" for key in keys)
        body += f"<tr{kind}><td>{escape(row['candidate'])}{chosen}</td>{figures}<td>{charts.range_bar(row, end)}</td></tr>"
    return section(
        "models",
        "Color models",
        f"<p class='lead'>{_how_chosen(rows)}</p>",
        table(f'<th>model</th>{head}<th class="text">normals, from 0°</th>', body, ' class="tight"'),
    )


def _how_chosen(rows: Sequence[dict[str, Any]]) -> str:
    dealt = (
        "The presses are split into folds. For each fold, a model is fitted and the circles are refined on the other folds. "
        "The model's slopes are compared with the ball's on the presses of the fold, inside the contact edge. A step is a "
        "correction of the slopes by the forward response: the color that a slope gives at a place and a depth. "
    )
    if len(rows) < 2:
        return dealt + "Only one model was tried."
    return dealt + (
        "The smallest typical slope error (geometric mean over presses) decides among the settings of one color model. "
        "Its step is chosen next, in the same way."
    )


def _column(key: str) -> str:
    label, unit = COLUMNS.get(key, (key.replace("_", " "), ""))
    return escape(f"{label}, {unit}" if unit else label)


def _with_error(row: dict[str, Any], key: str) -> str:
    value = row.get(key)
    if not isinstance(value, (int, float)) or not np.isfinite(value):
        return "–" if value is None or isinstance(value, float) else escape(str(value))
    names = ERRORS_OF.get(key, (f"{key}_se",))
    error = next((row[name] for name in names if row.get(name) is not None), None)
    return f"{value:.3g}" + (f" ± {error:.2g}" if error is not None else "")


def errors_section(content: dict[str, Any], caps: str) -> str:
    """Held-out slope errors over the frame, and depth minus the cap of every press."""
    errors = content["error_map"]
    limit = charts.scale_of_errors(errors)
    shades = (
        f'<i style="background:var(--poor);opacity:{0.04 + 0.9 * part:.2f}"></i>{part * limit:.2f} mm/mm'
        for part in (0.25, 0.5, 1)
    )
    key = _key(*shades, f"an arrow across a whole cell: {limit / 0.9:.2f} mm/mm", "blank: no held-out press")
    return section(
        "errors",
        "Residuals: where the errors are",
        f'<div class="two"><div>{charts.slope_error_map(errors, content["calibration"]["image_shape"])}</div><div>'
        "<p>The map shows the error of the held-out slopes by place. The shade is its RMS size. An arrow is the mean error, "
        "which more pixels do not reduce. If arrows agree over a region, the model does not know that "
        f"region's light.</p>{key}</div></div>{caps}",
    )


def where_section(content: dict[str, Any]) -> str:
    """Normal errors inside the contact and up to the visible rim, by slope and by place, as two tables."""
    where = content["where"]
    zone = "up to the rim"
    return section(
        "where",
        "Errors by slope and place",
        "<p class='lead'>The mean angle between the normals of the solved depth and the ball's, over held-out pixels, is "
        f"{_deg(where['contact']['normal_deg'])} inside the contact edge, at {where['contact_radius_ratio']:.2f} of "
        f"the visible radius, and {_deg(where['rim']['normal_deg'])} up to 3 px inside the visible rim. There the gel has "
        "left the ball, so most of the difference is no error of the color model.</p>"
        f'<div class="two">{_slope_table(where, zone)}'
        f'<div class="scroll">{_place_table(where)}<p class="muted">The image in cells, row by row: contact / '
        f"{zone}, degrees. A dash means too few held-out pixels.</p></div></div>",
    )


def _slope_table(where: dict[str, Any], zone: str) -> str:
    up_to_rim = {b["slope_from"]: b for b in where["rim"]["by_slope"]}
    rows = []
    for b in where["contact"]["by_slope"]:
        part = up_to_rim.get(b["slope_from"])
        rows.append(
            f"<tr><td>{b['slope_from']:g} – {b['slope_to']:g}</td><td>{_deg(b['normal_deg'])}</td>"
            f"<td>{_deg(part['normal_deg'] if part else None)}</td><td>{b['gain']:.2f}</td><td>{b['pixels']}</td></tr>"
        )
    head = (
        f"<th>the ball's slope</th><th>in the contact</th><th>{zone}</th><th>slope gain</th><th>pixels</th>"
    )
    return table(head, "".join(rows))


def _place_table(where: dict[str, Any]) -> str:
    whole, part = (where[name]["by_place"] for name in ("contact", "rim"))
    cells = [
        f"<td>{_deg(a)}\u00a0/\u00a0{_deg(b)}</td>" for a, b in zip(whole["normal_deg"], part["normal_deg"])
    ]
    columns = whole["columns"]
    rows = ["".join(cells[k : k + columns]) for k in range(0, len(cells), columns)]
    return f"<table><tbody>{''.join(f'<tr>{row}</tr>' for row in rows)}</tbody></table>"


def _deg(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}°"


def gain_section(content: dict[str, Any]) -> str:
    """Recovered over true slope."""
    gain = content["gain"]
    key = _key(
        '<i style="background:var(--accent);height:3px"></i>inside the contact edge, '
        f"{gain['contact_radius_ratio']:.2f} of the visible radius",
        '<i style="background:var(--second);height:3px"></i>up to the visible rim',
    )
    return section(
        "gain",
        "Slope gain",
        f'<div class="two"><div>{charts.gain_chart(gain)}{key}</div>'
        "<div><p>The slope gain is the recovered slope divided by the true slope. <strong>1 is right</strong>; the "
        "green band is ±5 %. Below 1, "
        "slopes are too flat: noise pulls them to the mean, or no press shows such slopes. Above 1, they are too steep. "
        "Bands are 95 % intervals over presses.</p><p>The dashed line counts up to the visible rim. Near the rim the gel "
        "has already left the ball, so the ball is steeper than the gel. This line falls on every sensor, and the color "
        "model alone is not the cause.</p></div></div>",
    )


def learning_section(content: dict[str, Any]) -> str:
    """The error by number of presses, and the gain from more."""
    learning, title = content["learning"], "How many presses?"
    if learning is None:
        return section(
            "learning",
            title,
            "<p>There is no learning curve: there are too few presses to hold some out.</p>",
        )
    low, high = learning["expected"]["more_deg_range"]
    points = "".join(
        f"<tr><td>{p['presses']}</td><td>{p['mean_deg']:.2f}°</td><td>{min(p['draws_deg']):.2f} – "
        f'{max(p["draws_deg"]):.2f}°</td><td class="text">{escape(p["model"])}</td></tr>'
        for p in learning["points"]
    )
    other = (
        f" The dashed line is the mean {escape(learning['other'])}." if learning.get("other_points") else ""
    )
    return section(
        "learning",
        title,
        f"<p><strong>{escape(learning['sentence'])}</strong></p>"
        f'<div class="two"><div>{charts.learning_chart(learning)}</div><div><p class="muted">Each time '
        f"{learning['held_out_presses']} presses are held out, and some of the others train, with circles refined on them "
        "alone. Pale dots are single draws of presses, and the line is their mean. The dotted law, error² = a + b/n, is "
        "fitted to the means. Rings mark its prediction for all presses now, and for ten more (if one draw is left out: "
        f"{low:.2f} – {high:.2f}°). “May” means that a single draw would change the answer. The figures at "
        f"the top are of models that trained on four fifths of the presses.{other}</p>",
        table('<th>presses</th><th>normals</th><th>draws</th><th class="text">model</th>', points),
        "</div></div>",
    )


def sigma_section(content: dict[str, Any]) -> str:
    """A comparison of the stated uncertainty of the slopes with the held-out errors."""
    sigma, shape = content["sigma"], content["calibration"]["image_shape"]
    return section(
        "sigma",
        "Uncertainty: is the stated standard deviation right?",
        "<p class='lead'>The figures are the share of held-out slopes within one stated standard deviation. 68 % is right, "
        "and the green band 60–76 % is good. Below it, the stated uncertainty is too small; above it, too large. "
        f"Overall, the share is {100 * sigma['all']:.0f} %. Outside the contact edge the gel has left the ball, and no "
        "pixel counts. The uncertainty was fitted on the same presses for the final model; held-out models are a little "
        "worse.</p>"
        f'<div class="two"><div>{charts.sigma_chart(sigma)}</div><div>{charts.share_map(sigma, shape)}'
        "<p class='muted'>The same share by place.</p></div></div>",
    )


def history_section(content: dict[str, Any], background: NDArray[np.float32]) -> str:
    """The facts of this calibration, and its background image."""
    rows = "".join(f"<dt>{escape(name)}</dt><dd>{value}</dd>" for name, value in _facts(content))
    notes = "".join(f"<li>{escape(note)}</li>" for note in content["notes"])
    picture = jpeg_url(np.clip(np.round(background), 0, 255).astype(np.uint8), BACKGROUND_WIDTH_PX)
    return section(
        "history",
        "Sensor and settings",
        f'<div class="two"><dl>{rows}</dl><div><img class="photo" src="{picture}" alt="the gel at rest">'
        "<p class='muted'>The background image shows the gel at rest. If a frame's background differs from it, "
        f'gelform warns or refuses the frame.</p></div></div><h3>Notes</h3><ul class="notes">{notes}</ul>',
    )


def _facts(content: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values, as HTML."""
    facts, background = content["calibration"], content["background"]
    sigma = facts["mm_per_px_sigma"]
    known = f" ± {sigma:.2g}" if sigma is not None else "; its uncertainty is not known"
    noise = ", ".join(f"{value:.2f}" for value in background["noise"])
    settings = ", ".join(f"{key} {setting_in_words(value)}" for key, value in facts["settings"].items())
    clipped = f"{background['saturated_percent']:.1f} % saturated, {background['dark_percent']:.1f} % dark"
    listed: list[tuple[str, Any]] = [
        ("Sensor", facts["sensor_name"]),
        ("Serial number", facts["serial"] or "not given"),
        ("Gel", facts["gel_id"] or "not given"),
        ("Image", f"{facts['image_shape'][0]} × {facts['image_shape'][1]} px"),
        ("Scale", f"{facts['mm_per_px']:.5g} mm per pixel{known}"),
        ("Balls", ", ".join(f"{ball:g} mm" for ball in facts["ball_diameters_mm"])),
        ("Color model", f"{facts['color_model']} ({settings})"),
        ("Made", f"{facts['created_utc'][:16].replace('T', ' ')} UTC, in {content['seconds']:.0f} s"),
        ("Background noise", f"{noise} gray levels (R, G, B)"),
        ("Background clipped", clipped),
        ("Library", f"gelform {facts['library_version']}"),
    ]
    escaped = [(name, escape(str(value))) for name, value in listed]
    return [*escaped, ("Digest", f"<code>{escape(facts['digest'])}</code>")]


def digits(value: float) -> str:
    """Three significant digits, with zeros at the end."""
    return f"{value:#.3g}".removesuffix(".")


def place_in_words(place: dict[str, Any], mm_per_px: float) -> str:
    """A place for people: part of the image, px, and mm from its left and its top."""
    x, y = place["x_px"], place["y_px"]
    from_left, from_top = x * mm_per_px, y * mm_per_px
    return f"{place['name']}: ({x:.0f}, {y:.0f}) px, {from_left:.1f} mm from the left, {from_top:.1f} mm from the top"


def setting_in_words(value: Any) -> str:
    """A setting as a person reads it: four significant digits, lists joined, the beginning of a digest; none: nothing."""
    if isinstance(value, dict):
        return ", ".join(f"{name}: {setting_in_words(one)}" for name, one in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return " / ".join(setting_in_words(one) for one in value) or "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    text = "none" if value in (None, "") else str(value)
    is_digest = len(text) == 64 and set(text) <= set("0123456789abcdef")
    return f"{text[:DIGEST_SHOWN]}…" if is_digest else text

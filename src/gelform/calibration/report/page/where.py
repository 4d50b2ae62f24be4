"""The section that says where held-out normals are off: by the ball's slope and by place."""

from __future__ import annotations

from typing import Any


def where_section(content: dict[str, Any]) -> str:
    """Normal errors inside the contact and up to the visible rim, by slope and by place, as two tables."""
    where = content["where"]
    zone = "up to the rim"
    return (
        '<section id="where"><h2>At which slopes and places?</h2>'
        "<p class='lead'>Mean angle between the normals of the solved depth and the ball's, over held-out pixels: "
        f"{_deg(where['contact']['normal_deg'])} inside the edge of the contact, at {where['contact_radius_ratio']:.2f} of "
        f"the visible radius; {_deg(where['rim']['normal_deg'])} up to 3 px inside the visible rim, where the gel has "
        "left the ball: that difference is mostly not the color model's.</p>"
        f'<div class="two"><div class="scroll">{_slope_table(where, zone)}</div>'
        f'<div class="scroll">{_place_table(where)}<p class="muted">The image in cells, row by row: contact / '
        f"{zone}, degrees. A dash: hardly a held-out press.</p></div></div></section>"
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
    return (
        f"<table><thead><tr><th>the ball's slope</th><th>contact</th><th>{zone}</th><th>gain, contact</th>"
        f"<th>pixels</th></tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )


def _place_table(where: dict[str, Any]) -> str:
    whole, part = (where[name]["by_place"] for name in ("contact", "rim"))
    cells = [f"<td>{_deg(a)} / {_deg(b)}</td>" for a, b in zip(whole["normal_deg"], part["normal_deg"])]
    columns = whole["columns"]
    rows = ["".join(cells[k : k + columns]) for k in range(0, len(cells), columns)]
    return f"<table><tbody>{''.join(f'<tr>{row}</tr>' for row in rows)}</tbody></table>"


def _deg(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}°"

"""What `gelform info` knows of a file, as lines that a person reads; `--json` gives the numbers themselves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Facts = Mapping[str, Any]
Lines = list[tuple[str, str]]
LISTED = 8  # contacts, the largest first; --json gives all
HELD_OUT = {
    "normal_free_deg": "normals {:.1f}°",
    "radius_percent": "ball's radius {:.1f} %",
    "cap_free_um": "depth in the contact {:.0f} um",
    "off_contact_um": "depth off it {:.0f} um",
}


def lines_of(facts: Facts) -> Lines:
    """(label, text) of each line; an unknown kind of file is listed as it is."""
    lines = WORDS.get(facts["kind"], _plain)(facts)
    return [("kind", str(facts["kind"])), *lines]


def _calibration(facts: Facts) -> Lines:
    settings = ", ".join(
        f"{name} {_said(value)}"
        for name, value in (facts.get("model_settings") or {}).items()
        if name != "shape"  # said of the images
    )
    held_out = facts.get("held_out") or {}
    known = [form.format(held_out[name]) for name, form in HELD_OUT.items() if name in held_out]
    named = [("serial", facts.get("serial")), ("gel", facts.get("gel_id"))]
    return [
        ("sensor", str(facts["sensor_name"])),
        *[(label, str(text)) for label, text in named if text],
        ("images", f"{_size(facts['image_shape'])}, {_scale(facts)}"),
        (
            "view",
            "a frame is an image as it is" if not facts.get("view") else _said(facts["view"]),
        ),
        ("color model", f"{facts['color_model']} ({settings})" if settings else str(facts["color_model"])),
        (
            "made from",
            f"{facts['training_presses']} presses" if facts["training_presses"] else "no presses: imported",
        ),
        ("held out", ", ".join(known) or "no errors on held-out presses are known"),
        ("slope noise", _noise(facts.get("slope_sigma"))),
        ("made", f"{facts['created_utc']}, by gelform {facts['library_version']}"),
        ("digest", str(facts["digest"])),
    ]


def _result(facts: Facts) -> Lines:
    unit = "mm" if "depth_mm" in facts else "px"
    low, high = facts[f"depth_{unit}"]
    pixels = facts["size_px"][0] * facts["size_px"][1]
    return [
        ("image", f"{_size(facts['size_px'])}, {_scale(facts)}"),
        ("depth", f"{low:.3f} to {high:.3f} {unit}, 0 at rest, zero by: {facts['zero']}"),
        ("contact", f"{facts['contact_px']} of {pixels} px"),
        *[(f"contact {k + 1}", _contact(contact)) for k, contact in enumerate(facts["contacts"][:LISTED])],
        *([("roughness", _roughness(facts["roughness"]))] if facts.get("roughness") else []),
        *([("markers", facts["markers"]["in_words"])] if facts["markers"] else []),
        ("known", f"{100 * facts['known_px'] / pixels:.0f} % of the pixels; the others are filled"),
        ("solver", f"{facts['solver']}, curl of the slopes {facts['curl_rms']:.3g} RMS"),
        *[("warning", message) for message in facts["findings"]],
        ("calibration", str(facts["calibration"])),
    ]


def _roughness(found: Facts) -> str:
    return (
        f"Sa {found['Sa_um']:.3g} um, Sq {found['Sq_um']:.3g} um, Sz {found['Sz_um']:.3g} um, Ssk {found['Ssk']:.2f}, "
        f"Sku {found['Sku']:.2f}, Sdr {found['Sdr_percent']:.3g} % of what is in contact (ISO 25178; form removed: "
        f"{found['form']}, S-filter {found['s_filter_mm']:.2g} mm, L-filter {found['l_filter_mm']:.2g} mm)"
    )


def _contact(contact: Facts) -> str:
    x, y = contact["deepest_px"]
    cut = ", cut by the image's border" if contact["cut_by_border"] else ""
    if contact["area_mm2"] is None:
        return f"{contact['area_px']} px, deepest at ({x}, {y}){cut}"
    major, minor = contact["axes_mm"]
    return (
        f"{contact['area_mm2']:.2f} mm², {contact['volume_mm3']:.3g} mm³, axes {major:.2f} x {minor:.2f} mm, "
        f"{contact['deepest_mm']:.3f} mm deep at ({x}, {y}){cut}"
    )


def _plain(facts: Facts) -> Lines:
    lines: Lines = []
    for name, value in facts.items():
        if name == "missing":
            lines += [("missing", str(one)) for one in value]
        elif name.endswith("size_px"):
            lines.append(("size", _size(value)))
        elif name != "kind":
            lines.append((name.replace("_", " "), _said(value)))
    return lines


WORDS: dict[str, Callable[[Facts], Lines]] = {"calibration": _calibration, "result": _result}


def _size(shape: Any) -> str:
    return f"{shape[0]}x{shape[1]} px (height x width)"


def _scale(facts: Facts) -> str:
    pitch, sigma = facts.get("mm_per_px"), facts.get("mm_per_px_sigma")
    if pitch is None:
        return "scale unknown: depth in pixels"
    return f"{_said(pitch)} mm per pixel" + (f" +- {sigma:.2g}" if sigma else ", its uncertainty not known")


def _noise(sigma: Facts | None) -> str:
    if not sigma:
        return "not known"
    steepest = f"{sigma['sigmas'][-1]:.3f} at a slope of {sigma['slopes'][-1]:.2f}"
    return f"{sigma['rest']:.3f} at rest, {sigma['sigmas'][0]:.3f} at a slope of {sigma['slopes'][0]:.2f}, {steepest}"


def _said(value: Any) -> str:
    from gelform.calibration.report.page.sections import (
        setting_in_words,
    )  # imports numpy, which --help does not wait for

    return setting_in_words(value)

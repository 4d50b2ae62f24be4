"""The report as one self-contained HTML page: no script, no network, no font, no extra."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from gelform.calibration.presses.folder import Presses
from gelform.calibration.report.page import sections
from gelform.calibration.report.page.presses import caps_section, presses_section
from gelform.calibration.report.page.style import STYLE
from gelform.calibration.report.record import FIGURES, used_in_words
from gelform.calibration_file import Calibration

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
NAV = (
    ("figures", "Figures"),
    ("presses", "Presses"),
    ("coverage", "Coverage"),
    ("models", "Color models"),
    ("errors", "Residuals"),
    ("where", "By slope and place"),
    ("gain", "Slope gain"),
    ("learning", "Learning curve"),
    ("sigma", "Uncertainty"),
    ("history", "Sensor and settings"),
)


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
    name = content["calibration"]["sensor_name"]
    samples = calibration.report.samples
    parts = [
        sections.figures_section(content),
        _saved_section(calibration.report),
        presses_section(content, [press.image for press in presses.presses]),
        sections.coverage_section(content),
        sections.models_section(content),
        sections.errors_section(content, caps_section(content, samples)),
        sections.where_section(content),
        sections.gain_section(content),
        sections.learning_section(content),
        sections.sigma_section(content),
        sections.history_section(content, calibration.background),
    ]
    return _document(
        f"Calibration of {name}", [_head(content, calibration.report), _verdict(content), _nav(), *parts]
    )


def _saved_section(report: Any) -> str:
    """The saved model's own held-out errors, next to those of the whole procedure."""
    words = {name: escape(figure.replace("(um)", "(µm)")) for name, figure in FIGURES.items()}
    rows = "".join(
        f"<tr><td>{words[name]}</td><td>{saved:.3g}</td><td>{report.held_out[name]:.3g}</td></tr>"
        for name, saved in report.held_out_saved.items()
    )
    return sections.section(
        "saved",
        "Held-out errors of the saved model and of the whole procedure",
        '<p class="lead"><b>Saved model</b>: a model of its kind and settings, fitted without each press. '
        "<b>Whole procedure</b>: the kind and settings are also chosen without each press, as above. This error is a "
        "little larger, because it includes the choice among models.</p>",
        sections.table("<th>held-out error</th><th>saved model</th><th>whole procedure</th>", rows),
    )


def _document(title: str, parts: Sequence[str]) -> str:
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _head(content: dict[str, Any], report: Any) -> str:
    facts = content["calibration"]
    unit = [f"{label} {facts[key]}" for key, label in (("serial", "serial"), ("gel_id", "gel")) if facts[key]]
    made = facts["created_utc"][:16].replace("T", " ")
    facts_of_run = [*unit, used_in_words(report.presses), f"made {made} UTC"]
    return (
        f"<header><h1>Calibration of {escape(facts['sensor_name'])}</h1>"
        f"<span>{escape(' · '.join(facts_of_run))}</span></header>"
    )


def _verdict(content: dict[str, Any]) -> str:
    verdict = content["verdict"]
    because = f" <span class='muted'>({escape(verdict['because'])})</span>" if verdict["because"] else ""
    return (
        f'<section class="verdict {verdict["level"]}"><h2>{escape(verdict["headline"])}</h2>'
        f"<p><strong>Next:</strong> {escape(verdict['next'])}{because}</p>"
        f"<p class='muted'>{_counted(verdict['counts'])}</p></section>"
    )


def _counted(counts: dict[str, int]) -> str:
    total = sum(counts.values())
    others = [f"{counts[name]} {name}" for name in ("fair", "poor") if counts[name]]
    return f"{counts['good']} of {total} checks are good" + (f", {' and '.join(others)}." if others else ".")


def _nav() -> str:
    links = "".join(f'<a href="#{anchor}">{label}</a>' for anchor, label in NAV)
    return f'<nav aria-label="Sections">{links}</nav>'

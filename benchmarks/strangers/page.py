"""The table of docs/guarantees.md that is made of results/strangers.json."""

from __future__ import annotations

from textwrap import fill as fill_text
from typing import Any

from real_frames.page import WIDTH, fill_pages, pattern_of
from report import table

PAGES = ("docs/guarantees.md",)
BLOCK = pattern_of("strangers")
TOUCH = {1.0: "as strong as it was", 0.5: "half as strong", 0.25: "a quarter as strong"}
# What is wrong; its part, the ends of the names of its rows, and which answer would be right
DECISIONS: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
    ("gel at rest refused by the starter", "rest", (", refused",), "no"),
    ("gel at rest that the starter calls touched", "rest", (", called touched",), "no"),
    ("frame at rest with a contact", "rest", (", contact",), "no"),
    ("frame at rest higher than 0.05 mm without a finding of its own", "rest", (", high",), "no"),
    ("frame at rest with a finding of its own", "rest", ("the calibration's",), "no"),
    *(
        (
            f"touch in a starter's background, {how}, accepted silently",
            "touched",
            (f", starter, {w:g}",),
            "yes",
        )
        for w, how in TOUCH.items()
    ),
    *(
        (f"touch in today's background, {how}, accepted silently", "touched", (f", today, {w:g}",), "yes")
        for w, how in TOUCH.items()
    ),
    ("another moment at rest refused as today's background", "moments", (", refused",), "no"),
    ("another moment at rest called touched", "moments", (", background_touched",), "no"),
    ("stream that begins at rest and gives no result", "streams", (", does not begin",), "yes"),
    ("stream that begins at rest and is called touched", "streams", ("is called touched",), "no"),
    ("stream that begins in contact and gives a silent result", "streams", ("without a finding",), "no"),
    ("press of a ball rejected", "presses", (", all",), "yes"),
    ("frame at rest or of an edge accepted among ten presses", "presses", (", mixed",), "no"),
    ("background of the right make refused by its light", "light", (", turned, mirrored or BGR",), "no"),
    ("turned, mirrored or BGR background accepted silently", "light", (", turned, mirrored or BGR",), "yes"),
    (
        "background of another make accepted silently",
        "light",
        (", as a gelsight-mini", ", as a digit"),
        "yes",
    ),
    ("sound frame called torn", "torn", ("",), "no"),
    ("frame of two moments not called torn", "torn", ("",), "yes"),
    ("sound frame called banded", "bands", (", 3 gray levels",), "no"),
    ("bands of 3 gray levels not called so", "bands", (", 3 gray levels",), "yes"),
    ("bands of 10 gray levels not called so", "bands", (", 10 gray levels",), "yes"),
    ("bands of 30 gray levels not called so", "bands", (", 30 gray levels",), "yes"),
    ("frame of the same exposure called brighter or darker", "exposure", ("",), "no"),
    ("frame 10 % brighter or darker and not called so", "exposure", ("",), "yes"),
    ("hard object at over 2 N without a contact", "contacts", (", contact",), "yes"),
    ("hard object of which `background_pressed` is said", "contacts", (", background_pressed",), "no"),
    ("imprint a third unknown without `contact_unknown`", "unknown", ("",), "yes"),
    ("imprint known to nine tenths with `contact_unknown`", "unknown", ("",), "no"),
)


def decisions(figures: dict[str, Any]) -> str:
    """Each decision: how often it is wrong over all sets, and on which set most often."""
    rows = []
    for what, part, ends, right in DECISIONS:
        found = {
            name: (row[f"{right}, wrong"], row[right], row["figures"])
            for name, row in figures.get(part, {}).items()
            if name.endswith(ends) and row[right]
        }
        if not found:
            continue
        wrong, count = (sum(row[k] for row in found.values()) for k in (0, 1))
        name = max(found, key=lambda one: (found[one][0] + 1) / (found[one][1] + 2) if found[one][0] else 0)
        most = f"{_set_of(name, ends)}: {found[name][0]} of {found[name][1]}" if wrong else ""
        sets = sum(row[0] > 0 for row in found.values())
        said = [value for row in found.values() for value in row[2] or ()]
        span = f"{min(said):.2g} to {max(said):.2g}" if said else ""
        share = f"{100 * wrong / count:.1f} %"
        rows.append([what, f"{wrong} of {count}", share, f"{sets} of {len(found)}", most, span])
    header = ["what is wrong", "frames", "share", "on sets", "the worst set", "figures of its findings"]
    return table(header, rows)


def _set_of(name: str, ends: tuple[str, ...]) -> str:
    end = next(one for one in ends if name.endswith(one))
    return name.removesuffix(end).split(", begins")[0].split(", a finding")[0]


def heights(figures: dict[str, Any]) -> str:
    """The highest known depth of frames at rest."""
    said = []
    for name, one in figures["rest"].items():
        if name.endswith(", contact"):
            said.append(
                f"Of {one['no']} frames at rest of {name.removesuffix(', contact')}, half have a highest known depth "
                f"of {one['highest, median mm']:.3f} mm or less, and 95 % of {one['highest, 95 % mm']:.3f} mm or less. "
                f"The worst is {one['worst mm']:.3f} mm with a sigma of {one['its sigma mm']:.3f} mm."
            )
    return fill_text(" ".join(said), WIDTH)


BLOCKS = {"decisions": decisions, "heights": heights}


def fill(figures: dict[str, Any]) -> list[str]:
    """Write the table into its page; the pages that changed."""
    return fill_pages(figures, PAGES, BLOCK, BLOCKS)

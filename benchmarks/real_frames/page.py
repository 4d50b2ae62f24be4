"""The tables and sentences of the pages that quote results/real_frames.json, and where they stand in a page.

A block stands between `<!-- real_frames: NAME -->` and `<!-- real_frames end -->`, each in a line of its own. Everything
between is made of the results, here and nowhere else.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from real_frames.contacts import FAINT, OBJECTS
from real_frames.following import FOLLOWING
from real_frames.sets import SETS
from real_frames.simulated import FRAMES, PAIRS
from report import table

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/accuracy.md", "docs/background.md", "docs/limits.md", "docs/streams.md")
WIDTH = 150  # characters of a line of a page
NAMES = {
    "mini-ball": "GelSight Mini",
    "mini-d": "GelSight Mini, another unit",
    "digit-ball": "DIGIT",
    "gelslim": "GelSlim 3.0",
    "gelslim-dots": "GelSlim 3.0 with marker dots",
    "gelsight-ball-deep": "GelSight, very deep presses",
}
VIDEO = "mini-markers-video"
Figures = dict[str, Any]
Blocks = Mapping[str, Callable[[Figures], str]]


def pattern_of(results: str) -> re.Pattern[str]:
    """What stands between the marks of a block of these results."""
    return re.compile(rf"(<!-- {results}: (\w+) -->\n)(.*?)(?=<!-- {results} end -->)", re.DOTALL)


BLOCK = pattern_of("real_frames")


def filled(
    text: str, figures: Figures, pattern: re.Pattern[str] = BLOCK, blocks: Blocks | None = None
) -> str:
    """A page with the blocks that the figures give."""
    made = BLOCKS if blocks is None else blocks
    return pattern.sub(lambda found: found[1] + made[found[2]](figures) + "\n", text)


def fill_pages(
    figures: Figures,
    pages: Sequence[str] = PAGES,
    pattern: re.Pattern[str] = BLOCK,
    blocks: Blocks | None = None,
) -> list[str]:
    """Write the blocks of every page; the pages that changed."""
    changed = []
    for name in pages:
        path = ROOT / name
        before = path.read_text(encoding="utf-8")
        if (after := filled(before, figures, pattern, blocks)) != before:
            path.write_text(after, encoding="utf-8")
            changed.append(name)
    return changed


def sensors(figures: Figures) -> str:
    """One row for each real sensor: contacts, rest, exposure, and errors of held-out balls."""
    moved_by = "depth moved by 5 % of light: 90 % of frames, worst"
    header = [
        "sensor",
        "presses",
        "exactly one contact",
        "a contact at rest",
        moved_by,
        "normal",
        "off contact",
    ]
    stated = all("far1 %" in one for one in figures["balls"]["errors"].values())  # not in older records
    rows = []
    for name in SETS:
        one, still = figures["contacts"]["balls"][name], figures["rest"][f"{name}, background and noise"]
        moved = figures["exposure"][name]
        off = [v for key, v in figures["balls"]["errors"].items() if key.split(",")[0] == name]
        rows.append(
            [
                NAMES[name],
                one["frames"],
                f"{one['exactly one %']:.0f} %",
                f"{still['percent']:.0f} %",
                f"{moved['moved, 90 %']:.1f} %, {moved['moved, max']:.1f} %",
                _mean(off, "edge_deg", "{:.1f} deg"),
                _mean(off, "off_contact_um", "{:.1f} um"),
                *([", ".join(_mean(off, f"far{n} %", "{:.0f} %") for n in (1, 2))] if stated else []),
            ]
        )
    return table(header + ["off contact within 1, 2 sigma"] * stated, rows)


def _mean(of_splits: Sequence[Figures], key: str, form: str) -> str:
    return form.format(sum(one[key] for one in of_splits) / len(of_splits))


def cube(figures: Figures) -> str:
    """The cube's edge, read by a starter and by the calibrations of two other units."""
    of = figures["edges"]
    names = {
        "starter": "the Mini starter",
        "mini-ball": "one Mini's calibration",
        "mini-d": "another Mini's calibration",
    }
    forms = {
        "frames": ("frames", "{:.0f}"),
        "angle between the faces, 90 degrees is right": ("angle of faces, deg", "{:.0f} deg"),
        "slope of the flatter face": ("flatter face's slope", "{:.2f}"),
        "slope of the steeper face": ("steeper face's slope", "{:.2f}"),
        "slopes of the faces within two sigma": ("within 2 sigma, %", "{:.0f} %"),
        "pixels of the faces with confidence over 0.3": ("confidence > 0.3, %", "{:.0f} %"),
        "depth missing at the edge": ("crest too low by, um", "{:.0f} um"),
        "frames with that depth within two sigma": ("crest within 2 depth sigma, %", "{:.0f} %"),
    }
    rows = [[what, *(form.format(of[name][key]) for name in names)] for what, (key, form) in forms.items()]
    return table(["cube's edge, 45 degrees, read by", *names.values()], rows)


def balls(figures: Figures) -> str:
    """What is stated about held-out balls, by the unit's own calibration and by that of another Mini."""
    header = [
        "balls of",
        "read by",
        "slopes within one sigma",
        "sure in the inner part",
        "caps within one sigma",
    ]
    rows = [
        [*_whose(what), *map(_share, list(row.values())[1:4])]
        for what, row in figures["beyond"]["balls"].items()
    ]
    return table(header, rows)


def steeper(figures: Figures) -> str:
    """What is stated about slopes that the presses have not shown."""
    header = [
        "balls of",
        "trained on slopes below",
        "steeper pixels within two sigma",
        "steeper pixels that are sure",
    ]
    found = (
        (what.split(", below "), list(row.values())[1:]) for what, row in figures["beyond"]["steeper"].items()
    )
    return table(header, [[NAMES[name], limit, *map(_share, shares)] for (name, limit), shares in found])


def _whose(what: str) -> tuple[str, str]:
    """Whose balls, and whose calibration."""
    name, by = what.split(", ")
    return NAMES[name], "its own calibration" if by == "own" else "the other Mini's calibration"


def others(figures: Figures) -> str:
    """What has no sensor's row of its own: other objects, frames at rest, torn frames, simulated frames."""
    balls, objects = figures["contacts"]["balls"], figures["contacts"]["objects"]["by the starter"]
    edge = [balls[f"mini-edge by the starter, {what}"] for what in ("all frames", "those in its light")]
    deeper = balls["digit-ball/deeper"]
    still, tears, made = figures["rest"], figures["tears"], figures["simulated"]
    ridge, older = tears["sound: cheese_tube_3, in contact"], tears["torn: mini-ball, older lower half"]
    sound = [row for name, row in tears.items() if name.startswith("sound") and row is not ridge]
    video = next(row for name, row in still.items() if name.startswith(VIDEO))
    faces, faint = figures["faces"], figures["contacts"]["faint"]
    on_cube = faces["cube by the starter"]
    flat = [row for name, row in faces.items() if row is not on_cube]
    rows = [
        ["a cube's edge has exactly one contact", edge[0]["frames"], _share(edge[0]["exactly one %"])],
        ["the same, in the light of the background", edge[1]["frames"], _share(edge[1]["exactly one %"])],
        [
            "share of its touched faces that the contact covers: median, least",
            on_cube["frames"],
            f"{on_cube['covered, median']:.2f}, {on_cube['covered, least']:.2f}",
        ],
        ["holes of that contact, a frame", on_cube["frames"], f"{on_cube['holes a frame']:.1f}"],
        [
            "holes in the contact of a simulated flat punch, a frame, by sensor",
            sum(row["frames"] for row in flat),
            ", ".join(f"{row['holes a frame']:.1f}" for row in flat),
        ],
        *(_faint(faint, f"{100 * share:.0f} %") for share in FAINT),
        [f"contacts of a {', a '.join(OBJECTS)}", 3, ", ".join(str(objects[one]) for one in OBJECTS)],
        [
            "a deeper, larger ball on the DIGIT has exactly one contact",
            deeper["frames"],
            _share(deeper["exactly one %"]),
        ],
        ["a video at rest has a contact", video["frames"], _share(video["percent"])],
        ["simulated gel at rest has a contact", *_sums(made["at_rest"].values(), "with a contact")],
        ["a sharp ridge is called torn", *_sums([ridge], "torn")],
        ["another sound frame is called torn", *_sums(sound, "torn")],
        ["a frame with an older lower half is called torn", *_sums([older], "torn")],
    ]
    for what, share in made["found_percent"].items():
        layout, depth = what.split(", ")
        rows.append([f"a simulated ball pressed by {depth} is found, `{layout}`", FRAMES, _share(share)])
    for layout, share in made["two_seen_percent"].items():
        rows.append([f"two simulated contacts 1 mm apart are seen as two, `{layout}`", PAIRS, _share(share)])
    for kind, score in sorted(made["overlap_median"].items()):
        name = f"outline of a simulated {kind}: median intersection over union"
        rows.append([name, made["objects"][kind], f"{score:.2f}"])
    return table(["measured", "frames", "figure"], rows)


def _faint(faint: Figures, share: str) -> list[Any]:
    rows = [faint[f"{name}, {share}"] for name in SETS]
    found = ", ".join(_share(row["one, on the ball %"]) for row in rows)
    what = f"presses blended to {share} have one contact, on the ball, by sensor as above"
    return [what, sum(row["frames"] for row in rows), found]


def _share(percent: float) -> str:
    return f"{percent:.0f} %"


def _sums(rows: Iterable[Figures], key: str) -> tuple[int, int]:
    """Number of frames, and number of those that the key counts."""
    rows = list(rows)
    return int(sum(row["frames"] for row in rows)), int(sum(row[key] for row in rows))


def limits(figures: Figures) -> str:
    """Two points of docs/limits.md."""
    edge = figures["edges"]["starter"]
    flat, high = (edge[f"{which} face's slope"] for which in ("flatter", "steeper"))
    one = {name: figures["contacts"]["balls"][name]["exactly one %"] for name in SETS}
    rest = sorted(value for name, value in one.items() if name != "mini-ball")
    steep = (
        "- **Steep faces.** Presses of a ball show few slopes near 1. On a GelSight Mini without own presses, the two faces "
        f"of a cube's edge read slopes of {flat:.2f} and {high:.2f} where about 1 is right. "
        f"The true slope lies within two sigma at {edge['within 2 sigma, %']:.0f} % of their pixels. "
        f"{edge['confidence > 0.3, %']:.0f} % of the pixels have a confidence over 0.3. "
        "[Accuracy](accuracy.md#real-frames-that-are-not-the-calibrations-ball) has the other figures."
    )
    others = f"{rest[0]:.0f} to {rest[-1]:.0f}" if f"{rest[0]:.0f}" != f"{rest[-1]:.0f}" else f"{rest[0]:.0f}"
    contacts = (
        f"- **Number of contacts.** One ball gives exactly one contact in {one['mini-ball']:.0f} % of the frames of a "
        f"GelSight Mini. On five other sensors it is {others} %."
    )
    return "\n".join(textwrap.fill(one, WIDTH, subsequent_indent="  ") for one in (steep, contacts))


def exposure(figures: Figures) -> str:
    """How far 5 % of exposure move the depth of real presses."""
    header = ["sensor", "frames", "median", "90 % of the frames", "maximum"]
    found = figures["exposure"]
    rows = [
        [NAMES[name], found[name]["frames"], *(f"{found[name][key]:.2f} %" for key in MOVED)] for name in SETS
    ]
    return table(header, rows)


MOVED = ("moved, median", "moved, 90 %", "moved, max")


def light(figures: Figures) -> str:
    """How far another light moves the depth of real and simulated presses."""
    header = ["sensor", "gain of 0.9 to 1.1", "tilted by 5 %", "20 levels of room light", "both"]
    rows = [
        [NAMES.get(name, name), *(_moved(row, scene) for scene in list(row)[1:])]
        for name, row in figures["light"].items()
    ]
    return table(header, rows)


def _moved(row: Figures, scene: str) -> str:
    return f"{row[scene]['moved, median']:.2f}, {row[scene]['90 %']:.2f}, {row[scene]['off, median']:.2f} %"


def following(figures: Figures) -> str:
    """What a stream learns of slow presses and drifting light."""
    pressed, real, drift = (figures["following"][key] for key in FOLLOWING)
    header = ["measured", "without memory", "with memory"]
    rows = [
        [
            f"simulated, {what}, {stage}: error of depth in contact",
            *(f"{row[f'{stage}, {by}']:.1f} um" for by in BY),
        ]
        for what, row in pressed.items()
        for stage in STAGES
    ]
    rows += [
        [
            f"{NAMES[name]}, {stage}: change of depth by the memory",
            "",
            f"{row[f'{stage}, memory']:.1f} % of the peak",
        ]
        for name, row in real.items()
        for stage in STAGES
    ]
    rows += [
        [
            f"simulated drift of {what}, after ten minutes: error of the background image",
            f"{row['not followed']:.1f} %",
            f"{row['followed']:.2f} %",
        ]
        for what, row in drift.items()
    ]
    return table(header, rows)


STAGES, BY = ("pressing", "held"), ("no memory", "memory")


BLOCKS = {
    "exposure": exposure,
    "light": light,
    "following": following,
    "sensors": sensors,
    "cube": cube,
    "balls": balls,
    "steeper": steeper,
    "others": others,
    "limits": limits,
}

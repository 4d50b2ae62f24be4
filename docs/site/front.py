"""The first page: two sentences, the live page, three doors, and the figures, with the README's own words and table."""

from __future__ import annotations

import re
from html import escape
from pathlib import Path

COMMANDS = r"^(?P<kept>[A-Z][^\n]*(?:\n[^\n]+)*\n\n```sh\n.+?^```$)"
STILL = "docs/images/live/desktop-light.jpg"  # for readers who asked their system for less motion
PAGES_MADE_HERE = {"Tutorials": ["docs/gallery"], "Reference": ["reference/index"]}
DOORS = (  # title, page, what one gets, a command, its other pages
    (
        "Try it",
        "docs/live.html",
        "You need no sensor. A simulated one runs in your browser, and objects touch it in turn.",
        "gelform live",
        {"Gallery": "docs/gallery.html", "Examples": "examples/index.html"},
    ),
    (
        "Calibrate mine",
        "docs/tutorial.html",
        "Press a ball for ten minutes. A GelSight Mini or a DIGIT begins without a press.",
        "gelform calibrate presses/ -o cal.npz",
        {"Starters": "docs/starters.html", "Cameras": "docs/cameras.html"},
    ),
    (
        "Use it in robots",
        "docs/robots.html",
        "Depth, contacts and uncertainty go to ROS 2, to LeRobot, to PyTorch, or to your own loop.",
        "gelform bag session.mcap -c cal.npz -o touch",
        {"ROS 2": "docs/ros.html", "LeRobot": "docs/lerobot.html", "PyTorch": "docs/torch.html"},
    ),
)


def write_front(source: Path) -> None:
    """`index.md` of a folder that holds the README and all other pages: the first page and the table of contents."""
    readme = (source / "README.md").read_text(encoding="utf-8")
    parts = [
        "---\nhide-toc: true\n---\n\n# gelform\n",
        found(r"^# gelform\n\n(?P<kept>.+?)\n\n", readme, "a paragraph after its title"),
        _picture(readme),
        _doors(),
        "## Install it\n",
        found(COMMANDS, readme, "a paragraph, then a block of commands"),
        found(r"^(?P<kept>## Figures\n.+?)(?=^## )", readme, "a section `## Figures`"),
        "[Limits](docs/limits.md) says where gelform stops being good.\n",
        _contents(source),
    ]
    (source / "index.md").write_text("\n\n".join(parts), encoding="utf-8")


def found(pattern: str, readme: str, what: str) -> str:
    """The group `kept` of a pattern in the README."""
    match = re.search(pattern, readme, re.MULTILINE | re.DOTALL)
    if not match:
        raise SystemExit(f"Expected {what} in README.md, which the first page shows, found none.")
    return match.group("kept").strip()


def _picture(readme: str) -> str:
    """The README's first picture, still where less motion is wanted; it leads to the live page."""
    seen = found(r"^!\[(?P<kept>[^\]]+)\]\(", readme, "a picture with its description")
    address = found(r"^!\[[^\]]+\]\((?P<kept>\S+)\)$", readme, "a picture alone in its line")
    still = f'<source srcset="{STILL}" media="(prefers-reduced-motion: reduce)">'
    return (
        '<p class="hero"><a href="docs/live.html"><picture>'
        f'{still}<img src="{address}" alt="{escape(seen)}"></picture></a></p>'
    )


def _doors() -> str:
    return '<div class="doors">' + "".join(_door(*door) for door in DOORS) + "</div>"


def _door(title: str, page: str, said: str, command: str, others: dict[str, str]) -> str:
    links = " · ".join(f'<a href="{target}">{words}</a>' for words, target in others.items())
    return (
        f'<section class="door"><h2><a href="{page}">{title}</a></h2><p>{said}</p>'
        f"<pre>{command}</pre><p>{links}</p></section>"
    )


def _contents(source: Path) -> str:
    """Hidden tables of contents, which the site's navigation shows: the sections of docs/index.md."""
    sections = sections_of((source / "docs" / "index.md").read_text(encoding="utf-8"))
    for title, pages in PAGES_MADE_HERE.items():
        sections[title] += pages
    sections["Tutorials"] = ["Overview <README>", *sections["Tutorials"]]
    listed = {"README"} | {page for pages in sections.values() for page in pages}
    known = [
        page.relative_to(source).with_suffix("")
        for page in (*source.glob("*.md"), *source.glob("docs/**/*.md"))
    ]
    names = sorted(page.as_posix() for page in known)
    sections["More"] = [
        name for name in names if name not in listed and name.split("/")[1:2] != ["decisions"]
    ]
    return "\n".join(
        f"```{{toctree}}\n:hidden:\n:caption: {title}\n\n" + "\n".join(pages) + "\n```\n"
        for title, pages in sections.items()
        if pages
    )


def sections_of(index: str) -> dict[str, list[str]]:
    """Pages by section of docs/index.md, in its order; those in Chinese have a section of their own."""
    sections: dict[str, list[str]] = {}
    chinese: list[str] = []
    for part in index.split("\n## ")[1:]:
        title = part.partition("\n")[0].partition(":")[0]
        targets = re.findall(r"\]\(([^)#]+\.md)", part)
        pages = [f"docs/{name}".removesuffix(".md") for name in dict.fromkeys(targets)]
        pages = [name.replace("docs/../", "") for name in pages]
        chinese += [name for name in pages if name.startswith("docs/zh/")]
        sections[title] = [name for name in pages if not name.startswith("docs/zh/")]
    return {**sections, "中文": chinese}

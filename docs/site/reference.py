"""The reference: every public name, from its docstring, in the order of the path."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

import gelform

STUB = Path(gelform.__file__).with_name("__init__.pyi")
IMPORT = re.compile(r"^from \.([\w.]+) import (\w+) as \w+$", re.MULTILINE)
PAGES = {
    "frames": ("Frames and views", "sensors frames view lens"),
    "color": ("Background and color change", "background markers"),
    "path": ("Normals, gradients, depth", "normals gradients depth depth_sigma contact"),
    "calibration": ("Calibration", "calibration starters importers calibration_file"),
    "results": ("Results", "reconstruct reconstruction plots metrics exporters"),
    "streams": ("Streams", "streams"),
    "errors": ("Errors", "errors"),
}
ROOMS = {
    "gelform.simulate": "The simulator",
    "gelform.design": "Comparing designs",
    "gelform.batch": "Data sets",
    "gelform.robots": "Robots",
}


def write_reference(folder: Path) -> None:
    """One page for each part of the path, one for each subpackage that users import."""
    folder.mkdir(parents=True)
    names = IMPORT.findall(STUB.read_text(encoding="utf-8"))
    known = " ".join(rooms for _, rooms in PAGES.values()).split()
    other = [name for module, name in names if module.split(".")[0] not in known]
    if other:
        raise SystemExit(
            f"Expected a page of PAGES in {__file__} for each public name, found none for {other}."
        )
    for page, (title, rooms) in PAGES.items():
        its = [name for module, name in names if module.split(".")[0] in rooms.split()]
        _write(folder / f"{page}.md", title, [("gelform", name) for name in its])
    for module, title in ROOMS.items():
        names_of_room = importlib.import_module(module).__all__
        _write(folder / f"{module}.md", title, [(module, name) for name in names_of_room])
    pages = "\n".join([*PAGES, *ROOMS])
    text = "# Reference\n\nEvery public name, in the order of the path. Units are suffixes: `_mm`, `_px`, `_deg`, `_s`.\n"
    (folder / "index.md").write_text(
        f"{text}\n```{{toctree}}\n:maxdepth: 2\n\n{pages}\n```\n", encoding="utf-8"
    )


def _write(path: Path, title: str, names: list[tuple[str, str]]) -> None:
    blocks = "\n".join(_block(module, name) for module, name in names)
    path.write_text(f"# {title}\n\n```{{eval-rst}}\n{blocks}\n```\n", encoding="utf-8")


def _block(module: str, name: str) -> str:
    thing = getattr(importlib.import_module(module), name)
    if inspect.isclass(thing):
        members = "" if issubclass(thing, Exception) else "   :members:\n"
        return f".. autoclass:: {module}.{name}\n{members}"
    if callable(thing):
        return f".. autofunction:: {module}.{name}\n"
    holds = ", ".join(f"``{key}``" for key in thing) if isinstance(thing, (dict, tuple)) else f"``{thing!r}``"
    return f".. py:data:: {module}.{name}\n\n   Holds {holds}.\n"

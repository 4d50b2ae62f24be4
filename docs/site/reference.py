"""The reference: every public name, from its docstring, in the order of the path."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

from sphinx.ext.autodoc.mock import mock

import gelform

STUB = Path(gelform.__file__).with_name("__init__.pyi")
IMPORT = re.compile(r"^from \.([\w.]+) import (\w+) as \w+$", re.MULTILINE)
PAGES = {
    "frames": ("Frames and views", "sensors image"),
    "color": ("Background and color change", "image.background image.markers"),
    "path": ("Normals, gradients, depth", "slopes depth"),
    "calibration": ("Calibration", "calibration exchange.importers calibration_file"),
    "results": ("Results", "reconstruct result exchange motion"),
    "streams": ("Streams", "sensors.streams"),
    "errors": ("Errors", "errors"),
}
INTRODUCTION = """# Python interface

Every public name, in the order of the path. Units are suffixes: `_mm`, `_px`, `_deg`, `_s`.
Shapes are (rows, columns, channels), and [conventions](../docs/conventions.md) has the axes and signs.
"""
ROOMS = {
    "gelform.simulate": "The simulator",
    "gelform.calibration.design": "Comparing designs",
    "gelform.batch": "Data sets",
    "gelform.robots": "Robots",
    "gelform.torch": "PyTorch",
    "gelform.sensors": "Cameras and recordings",
    "gelform.calibration.library": "The library of calibrations",
    "gelform.result.metrics": "Measures of error and surface",
}


def write_reference(folder: Path) -> None:
    """One page for each part of the path, one for each subpackage that users import. They are read without torch."""
    folder.mkdir(parents=True)
    names = IMPORT.findall(STUB.read_text(encoding="utf-8"))
    if other := [name for module, name in names if _page_of(module) is None]:
        raise SystemExit(f"Expected a page of PAGES in {__file__} for each name, found none for {other}.")
    with mock(["torch"]):
        for page, (title, _) in PAGES.items():
            its = [name for module, name in names if _page_of(module) == page]
            _write(folder / f"{page}.md", title, "gelform", its)
        for module, title in ROOMS.items():
            room = importlib.import_module(module)
            own = [n for n in room.__all__ if getattr(room, n) is not getattr(gelform, n, None)]
            _write(folder / f"{module}.md", title, module, own)
    listed = "\n".join([*PAGES, *ROOMS])
    text = f"{INTRODUCTION}\n```{{toctree}}\n:maxdepth: 2\n\n{listed}\n```\n"
    (folder / "index.md").write_text(text, encoding="utf-8")


def _page_of(module: str) -> str | None:
    """The page with the longest of the rooms that a module is in."""
    rooms = {room: page for page, (_, rooms) in PAGES.items() for room in rooms.split()}
    its = [room for room in rooms if f"{module}.".startswith(f"{room}.")]
    return rooms[max(its, key=len)] if its else None


def _write(path: Path, title: str, module: str, names: list[str]) -> None:
    """A page: the names with a sentence each, then all of their docstrings."""
    things = [(f"{module}.{name}", getattr(importlib.import_module(module), name)) for name in names]
    listed = "\n".join(f"   {name}" for name, thing in things if callable(thing))
    blocks = "\n".join(_block(*one) for one in things)
    summary = f".. autosummary::\n   :nosignatures:\n\n{listed}\n" if listed else ""
    path.write_text(f"# {title}\n\n```{{eval-rst}}\n{summary}\n{blocks}\n```\n", encoding="utf-8")


def _block(name: str, thing: object) -> str:
    if inspect.isclass(thing):
        members = "" if issubclass(thing, (Exception, tuple)) else "   :members:\n"
        return f".. autoclass:: {name}\n{members}"
    if callable(thing):
        return f".. autofunction:: {name}\n"
    parts = [str(key) for key in thing] if isinstance(thing, (dict, tuple)) else [repr(thing)]
    return f".. py:data:: {name}\n\n   Holds {', '.join(f'``{part}``' for part in parts)}.\n"

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
    "frames": ("Frames and views", "sensors frames view lens"),
    "color": ("Background and color change", "background markers"),
    "path": ("Normals, gradients, depth", "normals gradients depth depth_sigma contact"),
    "calibration": ("Calibration", "calibration starters importers calibration_file"),
    "results": ("Results", "reconstruct reconstruction plots metrics exporters"),
    "streams": ("Streams", "streams"),
    "errors": ("Errors", "errors"),
}
INTRODUCTION = """# Python interface

Every public name, in the order of the path. Units are suffixes: `_mm`, `_px`, `_deg`, `_s`.
Shapes are (rows, columns, channels), and [conventions](../docs/conventions.md) has the axes and signs.
"""
QUOTED = re.compile(r"(`[^`]*`)|[^`]+")
ROOMS = {
    "gelform.simulate": "The simulator",
    "gelform.design": "Comparing designs",
    "gelform.batch": "Data sets",
    "gelform.robots": "Robots",
    "gelform.torch": "PyTorch",
    "gelform.sensors": "Cameras and recordings",
    "gelform.calibrations": "The library of calibrations",
    "gelform.metrics": "Measures of error and surface",
}


def write_reference(folder: Path) -> None:
    """One page for each part of the path, one for each subpackage that users import. They are read without torch."""
    with mock(["torch"]):
        _write_pages(folder)


def _write_pages(folder: Path) -> None:
    folder.mkdir(parents=True)
    names = IMPORT.findall(STUB.read_text(encoding="utf-8"))
    known = " ".join(rooms for _, rooms in PAGES.values()).split()
    other = [name for module, name in names if module.split(".")[0] not in known]
    if other:
        raise SystemExit(
            f"Expected a page of PAGES in {__file__} for each public name, found none for {other}."
        )
    listed = {}
    for page, (title, rooms) in PAGES.items():
        its = [name for module, name in names if module.split(".")[0] in rooms.split()]
        listed[page] = title, [("gelform", name) for name in its]
    for module, title in ROOMS.items():
        room = importlib.import_module(module)
        own = [name for name in room.__all__ if getattr(room, name) is not getattr(gelform, name, None)]
        listed[module] = title, [(module, name) for name in own]
    for page, (title, its) in listed.items():
        _write(folder / f"{page}.md", title, its)
    tables = "\n".join(_table(page, *of_page) for page, of_page in listed.items())
    pages = "\n".join(listed)
    (folder / "index.md").write_text(
        f"{INTRODUCTION}\n{tables}\n```{{toctree}}\n:hidden:\n\n{pages}\n```\n", encoding="utf-8"
    )


def _table(page: str, title: str, names: list[tuple[str, str]]) -> str:
    """The names of a page, each with the first sentence of its docstring."""
    rows = [f"| {{py:obj}}`{name} <{module}.{name}>` | {_sentence(module, name)} |" for module, name in names]
    return "\n".join([f"## [{title}]({page}.md)", "", "| name | what it is |", "|---|---|", *rows, ""])


def _sentence(module: str, name: str) -> str:
    """The first paragraph of a docstring as Markdown, in one line; a value that has none says what it holds."""
    thing = getattr(importlib.import_module(module), name)
    if not (callable(thing) and thing.__doc__):
        return f"Holds {_holds(thing)}."
    said = " ".join(inspect.cleandoc(thing.__doc__).partition("\n\n")[0].split()).replace("``", "`")
    return QUOTED.sub(lambda part: part.group(0) if part.group(1) else _escaped(part.group(0)), said).replace(
        "|", r"\|"
    )


def _escaped(text: str) -> str:
    return re.sub(r"([*_<\[$])", r"\\\1", text)


def _write(path: Path, title: str, names: list[tuple[str, str]]) -> None:
    blocks = "\n".join(_block(module, name) for module, name in names)
    path.write_text(f"# {title}\n\n```{{eval-rst}}\n{blocks}\n```\n", encoding="utf-8")


def _block(module: str, name: str) -> str:
    thing = getattr(importlib.import_module(module), name)
    if inspect.isclass(thing):
        members = "" if issubclass(thing, (Exception, tuple)) else "   :members:\n"
        return f".. autoclass:: {module}.{name}\n{members}"
    if callable(thing):
        return f".. autofunction:: {module}.{name}\n"
    return f".. py:data:: {module}.{name}\n\n   Holds {_holds(thing, '``')}.\n"


def _holds(thing: object, quote: str = "`") -> str:
    """The content of a value in words."""
    parts = [str(key) for key in thing] if isinstance(thing, (dict, tuple)) else [repr(thing)]
    return ", ".join(f"{quote}{part}{quote}" for part in parts)

"""Facts of the machine for a bug report: versions, processor, cameras, extras; nothing about the user's files."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Any

from gelform.errors import GelformError

VARIABLES = ("GELFORM_ISA", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")  # they change speed or kernels
OPENCV = (
    "opencv-python",
    "opencv-contrib-python",
    "opencv-python-headless",
    "opencv-contrib-python-headless",
)
OF_DEVELOPERS = {"dev", "docs"}  # extras that only developers need
_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)[^;]*(?:;(?P<marker>.*))?")


def system_facts() -> dict[str, Any]:
    """Versions, processor, instruction set, extras and cameras of this machine."""
    from gelform import __version__

    core, extras = _requirements(_declared())
    return {
        "kind": "system",
        "gelform": __version__,
        "python": f"{platform.python_version()} ({platform.python_implementation()})",
        "system": platform.platform(),
        "processor": f"{platform.machine()}, {os.cpu_count()} cores",
        "kernels": _kernels(),
        "variables": {name: os.environ[name] for name in VARIABLES if name in os.environ},
        "packages": {name: _version(name) or "missing" for name in core},
        "opencv": _opencv(),
        "extras": {extra: _extra(names) for extra, names in extras.items()},
        "cameras": _cameras(),
    }


def system_lines(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """One line per fact; several lines for facts with several values."""
    lines: list[tuple[str, str]] = []
    for name, value in facts.items():
        if isinstance(value, dict):
            lines += [(label, str(text)) for label, text in value.items()]
        elif isinstance(value, list):
            lines += [("camera", str(one)) for one in value] or [("camera", "none")]
        elif name != "kind":
            lines.append((name, str(value)))
    return lines


def _declared() -> list[str]:
    """The requirements of the installed gelform; empty for a checkout that is only on the path."""
    try:
        return requires("gelform") or []
    except PackageNotFoundError:
        return []


def _requirements(declared: Iterable[str]) -> tuple[list[str], dict[str, list[str]]]:
    """Names of the packages that gelform always needs, and those of each extra, for this version of Python."""
    core: list[str] = []
    extras: dict[str, list[str]] = {}
    for requirement in declared:
        found = _REQUIREMENT.fullmatch(requirement)
        if found is None or not _for_this_python(found["marker"] or ""):
            continue
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", found["marker"] or "")
        if extra is None:
            core.append(found["name"])
        elif extra[1] not in OF_DEVELOPERS:
            extras.setdefault(extra[1], []).append(found["name"])
    return core, extras


def _for_this_python(marker: str) -> bool:
    """Whether a marker's condition on Python's version holds here."""
    for compared, major, minor in re.findall(r"python_version\s*(<|>=)\s*['\"](\d+)\.(\d+)['\"]", marker):
        below = sys.version_info[:2] < (int(major), int(minor))
        if below != (compared == "<"):
            return False
    return True


def _opencv() -> str:
    """Every installed distribution of OpenCV: all of them write the one folder cv2, and the last one installed wins."""
    found = [f"{name} {known}" for name in OPENCV if (known := _version(name)) is not None]
    if len(found) < 2:
        return ", ".join(found) or "none that pip knows"
    return f"{', '.join(found)}: they overwrite each other's cv2, so cv2.imshow may be missing (docs/installing.md)"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _extra(names: Iterable[str]) -> str:
    """The versions of an extra's packages, or the missing ones."""
    found = {name: _version(name) for name in names}
    missing = [name for name, known in found.items() if known is None]
    if missing:
        return f"missing: {', '.join(missing)}"
    return ", ".join(f"{name} {known}" for name, known in found.items())


def _kernels() -> str:
    """The instruction set in use, or the reason why the kernels cannot be loaded."""
    from gelform._native import instruction_set, library

    try:
        chosen = instruction_set()
        library(chosen)
    except (GelformError, ValueError) as problem:
        return str(problem)
    return chosen


def _cameras() -> list[str]:
    """Name and USB id of each camera; no serial number, because it identifies a unit and perhaps its owner."""
    from gelform.sensors.cameras.camera import cameras_there

    try:
        found = cameras_there()
    except (GelformError, OSError) as problem:
        return [f"not known: {problem}"]
    return [f"{one.name} ({one.usb_id or 'not on USB'}, {one.kind or 'no known sensor'})" for one in found]

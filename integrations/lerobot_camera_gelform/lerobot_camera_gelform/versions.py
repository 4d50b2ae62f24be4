"""A check of the versions of Python and LeRobot; it imports neither gelform nor LeRobot."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, version

PYTHON = (3, 12)
LEROBOT = (0, 6)
INSTALL = "pip install 'lerobot[dataset]>=0.6,<0.8' lerobot_camera_gelform"


def check_versions(python: tuple[int, ...] = sys.version_info[:3], lerobot: str | None = None) -> None:
    """Raise ImportError, with advice, for Python older than 3.12 or LeRobot older than 0.6.

    Parameters
    ----------
    python : the version of Python
    lerobot : the version of LeRobot; None: the installed one
    """
    if python < PYTHON:
        shown = ".".join(map(str, python))
        raise ImportError(
            f"Expected Python 3.12 or later, got {shown}: LeRobot 0.6 needs it, and pip quietly takes LeRobot 0.4.4 for an "
            f"older Python, which has no depth. Make an environment with python3.12 -m venv, then {INSTALL}."
        )
    found = _installed() if lerobot is None else lerobot
    if not found:
        raise ImportError(f"Expected LeRobot 0.6 or later, it is not installed: {INSTALL}.")
    if tuple(int(part) for part in found.split(".")[:2]) < LEROBOT:
        raise ImportError(
            f"Expected LeRobot 0.6 or later, got {found}, whose cameras have no depth. Update it: {INSTALL}."
        )


def _installed() -> str:
    try:
        return version("lerobot")
    except PackageNotFoundError:
        return ""

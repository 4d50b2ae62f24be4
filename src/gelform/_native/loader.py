"""Find and load the compiled kernels: one shared library for each instruction set, from the same sources."""

from __future__ import annotations

import os
import platform
import sys
from ctypes import CDLL
from functools import cache
from pathlib import Path

from gelform._native.sources import digest_of_library, digest_of_sources, native_folder
from gelform.errors import GelformError

# Name -> the level of the processor that it needs, as `cpu_level` in native/cpu.c counts.
ISAS = {"base": 1, "v3": 3, "v4": 4}
_FOLDER = Path(__file__).parent
_SUFFIX = ".dll" if sys.platform == "win32" else ".so"


@cache
def library(isa: str) -> CDLL:
    """The kernels compiled for one instruction set, loaded once.

    Raises
    ------
    GelformError
        The file is missing, made for another platform or from other C sources than those beside it, or the processor lacks
        the instructions; says what to do.
    """
    if isa not in ISAS:
        raise ValueError(f"Expected GELFORM_ISA to be one of {', '.join(ISAS)}, got {isa!r}.")
    if isa != "base" and library("base").cpu_level() < ISAS[isa]:
        raise GelformError(f"This processor cannot run the kernels for {isa!r}. Unset GELFORM_ISA.")
    path = _FOLDER / f"kernels_{isa}{_SUFFIX}"
    here = f"{sys.platform} {platform.machine()}"
    if not path.exists():
        raise GelformError(
            f"gelform's compiled kernels for {here} are missing ({path}). "
            "Install gelform with pip, which compiles them; in a checkout run: python hatch_build.py"
        )
    try:
        kernels = CDLL(str(path))
    except OSError as error:
        raise GelformError(
            f"gelform's compiled kernels do not load on {here} ({error}). "
            "Install gelform on this machine itself: pip install --force-reinstall --no-binary gelform gelform"
        ) from error
    if _expected_digest() not in (None, digest_of_library(kernels)):
        raise GelformError(
            f"gelform's compiled kernels ({path}) were made from other C sources than those in {native_folder()}: "
            "calling them could crash Python. Compile them again: python hatch_build.py"
        )
    return kernels


@cache
def _expected_digest() -> int | None:
    """Of a checkout's C sources; None for an installed package, whose libraries came with its Python."""
    folder = native_folder()
    return None if folder is None else digest_of_sources(folder)


@cache
def instruction_set() -> str:
    """The instruction set in use: the environment's GELFORM_ISA, else the best that this processor has."""
    wanted = os.environ.get("GELFORM_ISA")
    if wanted:
        return wanted
    best = library("base").cpu_level()
    return max((isa for isa in ISAS if ISAS[isa] <= best), key=ISAS.__getitem__)

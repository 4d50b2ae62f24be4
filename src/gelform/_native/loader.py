"""Find and load the compiled kernels: one shared library for each instruction set, from the same sources."""

from __future__ import annotations

import os
import platform
import sys
from ctypes import CDLL
from functools import cache
from pathlib import Path

from gelform._native.sources import (
    digest_of_library,
    digest_of_sources,
    digest_of_version,
    is_cut_off,
    native_folder,
)
from gelform.errors import GelformError

# Name -> required level of the processor, as `cpu_level` in native/cpu.c counts.
ISAS = {"base": 1, "v3": 3, "v4": 4}
_FOLDER = Path(__file__).parent
_SUFFIX = ".dll" if sys.platform == "win32" else ".so"


@cache
def library(isa: str) -> CDLL:
    """The kernels compiled for one instruction set, loaded once.

    Raises
    ------
    GelformError
        The file is missing or cut off; made for another platform, another version, or from C sources other than
        the present ones; or the processor lacks the instructions. The message says what to do.
    """
    if isa not in ISAS:
        raise ValueError(f"Expected GELFORM_ISA to be one of {', '.join(ISAS)}, got {isa!r}.")
    if isa != "base" and library("base").cpu_level() < ISAS[isa]:
        raise GelformError(f"This processor cannot run the kernels for {isa!r}. Unset GELFORM_ISA.")
    path = _FOLDER / f"kernels_{isa}{_SUFFIX}"
    here = f"{sys.platform} {platform.machine()}"
    if not path.exists():
        raise GelformError(f"gelform's compiled kernels for {here} are missing ({path}). {_remedy()}")
    try:
        if is_cut_off(path):
            raise GelformError(f"The end of gelform's compiled kernels is missing ({path}). {_remedy()}")
        kernels = CDLL(str(path))
    except OSError as error:
        raise GelformError(
            f"gelform's compiled kernels do not load on {here} ({error}). {_remedy()}"
        ) from error
    sources = native_folder()
    if sources is None and digest_of_library(kernels, "version") != digest_of_version(_version()):
        raise GelformError(
            f"gelform's compiled kernels ({path}) are not of gelform {_version()}, which is half installed: "
            f"calling them could crash Python. {_remedy()}"
        )
    if sources is not None and digest_of_library(kernels) not in (None, _digest_of(sources)):
        raise GelformError(
            f"gelform's compiled kernels ({path}) were made from other C sources than those in {sources}: "
            f"calling them could crash Python. {_remedy()}"
        )
    return kernels


def _remedy() -> str:
    if native_folder() is not None:
        return "Compile them again: python hatch_build.py"
    return "Install gelform again, on this machine itself: pip install --force-reinstall --no-deps gelform"


def _version() -> str:
    from gelform import __version__

    return __version__


@cache
def _digest_of(sources: Path) -> int:
    """Digest of a checkout's C sources, which do not change while Python runs."""
    return digest_of_sources(sources)


@cache
def instruction_set() -> str:
    """The instruction set in use: GELFORM_ISA from the environment, else the best one of this processor."""
    wanted = os.environ.get("GELFORM_ISA")
    if wanted:
        return wanted
    best = library("base").cpu_level()
    return max((isa for isa in ISAS if ISAS[isa] <= best), key=ISAS.__getitem__)

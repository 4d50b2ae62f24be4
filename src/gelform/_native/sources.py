"""Which sources a compiled library was made from: a digest of native/, the same for the build and for whoever loads it.

`hatch_build.py` compiles the digest into each library, and `loader` compares it with that of the sources beside it, so
that a library left over from other sources is refused: called by newer Python, it would write where it must not. Nothing
else of gelform is imported here, because the build runs without numpy.
"""

from __future__ import annotations

import zlib
from ctypes import CDLL
from pathlib import Path


def native_folder() -> Path | None:
    """The C sources of a checkout, an editable installation's too; None for an installed package, which has none."""
    checkout = Path(__file__).resolve().parents[3]
    return checkout / "native" if (checkout / "hatch_build.py").is_file() else None


def digest_of_sources(folder: Path) -> int:
    """CRC-32 of the names and contents of the C files below a folder."""
    digest = 0
    for path in sorted(folder.rglob("*.[ch]")):
        digest = zlib.crc32(path.relative_to(folder).as_posix().encode() + b"\0", digest)
        digest = zlib.crc32(path.read_bytes() + b"\0", digest)
    return digest


def digest_of_library(kernels: CDLL) -> int | None:
    """That of the sources a library was made from; None where it does not say: older ones do not."""
    try:
        return int(kernels.sources_digest() & 0xFFFFFFFF)
    except AttributeError:
        return None

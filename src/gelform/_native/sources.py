"""Which sources and which version a compiled library was made from, and whether its file is all there.

`hatch_build.py` compiles two digests into each library. `kernel` compares them: in a checkout that of native/, in an
installed package, which has no C sources, that of the version. A library left over from others is refused: called by newer
Python, it would write where it must not. Nothing else of gelform is imported here, because the build runs without numpy.
"""

from __future__ import annotations

import struct
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


def digest_of_version(version: str) -> int:
    """CRC-32 of a version's text."""
    return zlib.crc32(version.encode())


def digest_of_library(kernels: CDLL, of: str = "sources") -> int | None:
    """Digest of the `sources` or the `version` that a library was made from; None for older libraries, which lack it."""
    try:
        return int(getattr(kernels, f"{of}_digest")() & 0xFFFFFFFF)
    except AttributeError:
        return None


def is_cut_off(path: Path) -> bool:
    """Whether the end of a library is missing, as after an installation that was killed or on a full disk.

    Of Linux, whose loader alone does not look: it maps such a file, and the process dies at its first missing page. A
    library of ELF ends with its table of sections, whose place and size are in its first 64 bytes.
    """
    with path.open("rb") as file:
        head = file.read(64)
    if head[:5] != b"\x7fELF\x02" or len(head) < 64:
        return False  # of another system or of nothing: the loader says so
    (place,) = struct.unpack_from("<Q", head, 40)
    size, count = struct.unpack_from("<HH", head, 58)
    return path.stat().st_size < place + size * count

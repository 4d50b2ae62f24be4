"""The bytes of an npz file of one frame, put together at once.

`zipfile` writes a member in pieces, and goes back to say how long it was: a third of a millisecond for a frame, of which
a data set has millions. The layout is that of a stored archive (APPNOTE of the ZIP file format, sections 4.3.7, 4.3.12
and 4.3.16), which `numpy.load` and `gelform.npz_files.read_npz` read like any other.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from gelform.npz_files import MAX_BYTES, members_to_write

VERSION, NAMES_ARE_UTF8, STORED = 20, 0x800, 0
NEW_YEAR_1980 = 0, 1 << 5 | 1  # time and date: the same bytes at any time
_local = struct.Struct("<4s5H3I2H")
_central = struct.Struct("<4s6H3I5H2I")
_end = struct.Struct("<4s4H2IH")


def npz_bytes(
    arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any], *, kind: str, version: int
) -> bytes:
    """The content of a file as `write_npz` makes it; arguments and errors as there.

    Raises
    ------
    ValueError
        More than the 1 GB that `read_npz` would read, as well.
    """
    pieces: list[bytes] = []
    directory: list[bytes] = []
    offset = 0
    members = members_to_write(arrays, meta, kind, version)
    if sum(array.nbytes for array in members.values()) > MAX_BYTES:
        raise ValueError(f"Expected at most {MAX_BYTES / 1e6:.3g} MB of arrays in a file of one frame.")
    for name, array in members.items():
        file, header, body = f"{name}.npy".encode(), _header(array.dtype, array.shape), array.tobytes()
        size = len(header) + len(body)
        common = (
            NAMES_ARE_UTF8,
            STORED,
            *NEW_YEAR_1980,
            crc32(body, crc32(header)),
            size,
            size,
            len(file),
            0,
        )
        begin = _local.pack(b"PK\3\4", VERSION, *common)
        directory += (_central.pack(b"PK\1\2", VERSION, VERSION, *common, 0, 0, 0, 0, offset), file)
        pieces += (begin, file, header, body)
        offset += len(begin) + len(file) + size
    told = b"".join(directory)
    count = len(members)
    return b"".join([*pieces, told, _end.pack(b"PK\5\6", 0, 0, count, count, len(told), offset, 0)])


@lru_cache(maxsize=64)
def _header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    """The first bytes of a `.npy` file whose values follow in C order."""
    stream = io.BytesIO()
    facts = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, facts)
    return stream.getvalue()

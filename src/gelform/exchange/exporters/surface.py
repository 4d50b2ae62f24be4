"""Depth for other programs: in 16 bits, and as a surface with units (X3P, PLY, STL, TIFF).

X3P, the XML container of surface topography (ISO 25178-72, openGPS): heights in meters, with checksums.

The file is a zip of `main.xml`, `bindata/data.bin` (little-endian heights, row by row from the smallest y) and
`md5checksum.hex`. The axes are right-handed: x right, y up, z towards the camera. The image's rows are therefore stored from
the last to the first, and z is depth. Unknown heights are NaN, as the format requires.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import Array, Floats, Map, Mask
from gelform.errors import DataError, needed
from gelform.foundations.checks import check_is, check_mm_per_px, check_path, check_values
from gelform.foundations.files import made_folder, written_file
from gelform.foundations.pictures import picture_bytes
from gelform.result import Reconstruction

ZERO_LEVEL, MM_PER_LEVEL, UNKNOWN = 32768, 1e-4, 0  # 16-bit levels: 0.1 um per step, +-3.3 mm


def levels_from_depth(depth_mm: ArrayLike, known: ArrayLike | None = None) -> NDArray[np.uint16]:
    """16-bit levels (H, W) of a depth map in mm, -3.2767 to 3.2767 mm, rounded to 0.1 um; 0 where it is not known.

    DataError: depth is out of range; nothing is clipped.
    ValueError, TypeError: depth is no finite (H, W) array of numbers, or `known` has another shape.
    """
    exact = np.float32 if getattr(depth_mm, "dtype", None) == np.float32 else np.float64
    depth = check_values(depth_mm, "depth_mm", (), exact)
    mask = np.ones(depth.shape, dtype=bool) if known is None else np.asarray(known)
    if mask.dtype != np.bool_ or mask.shape != depth.shape:
        raise ValueError(f"Expected known as bool of shape {depth.shape}, got {mask.dtype} of {mask.shape}.")
    levels = np.divide(depth, MM_PER_LEVEL, dtype=np.float64)
    np.rint(levels, out=levels)
    levels += ZERO_LEVEL
    levels[~mask] = ZERO_LEVEL
    if levels.min() < UNKNOWN + 1 or levels.max() > np.iinfo(np.uint16).max:
        raise DataError(
            f"Expected depth from -3.2767 to 3.2767 mm, which 16 bits hold at 0.1 um, got {depth.min():.3f} to "
            f"{depth.max():.3f} mm. Write npz or tiff."
        )
    levels[~mask] = UNKNOWN
    return levels.astype(np.uint16)


def depth_from_levels(levels: Array) -> tuple[Map, Mask]:
    """Depth (H, W) float32, mm, 0 where unknown, and the map of known pixels, from 16-bit levels.

    TypeError: the levels are not uint16.
    """
    if getattr(levels, "dtype", None) != np.uint16:
        raise TypeError(f"Expected levels as uint16, got {getattr(levels, 'dtype', type(levels).__name__)}.")
    known = levels != UNKNOWN
    depth = (levels.astype(np.float64) - ZERO_LEVEL) * MM_PER_LEVEL
    return np.where(known, depth, 0).astype(np.float32), known


M_PER_MM = 1e-3
_MAIN = """<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:schemaLocation="http://www.opengps.eu/2008/ISO5436_2 http://www.opengps.eu/2008/ISO5436_2/ISO5436_2.xsd">
  <Record1>
    <Revision>ISO5436 - 2000</Revision>
    <FeatureType>SUR</FeatureType>
    <Axes>
      <CX><AxisType>I</AxisType><DataType>D</DataType><Increment>{x!r}</Increment><Offset>0.0</Offset></CX>
      <CY><AxisType>I</AxisType><DataType>D</DataType><Increment>{y!r}</Increment><Offset>0.0</Offset></CY>
      <CZ><AxisType>A</AxisType><DataType>D</DataType><Increment>1.0</Increment><Offset>0.0</Offset></CZ>
    </Axes>
  </Record1>
  <Record3>
    <MatrixDimension><SizeX>{width}</SizeX><SizeY>{height}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
    <DataLink><PointDataLink>bindata/data.bin</PointDataLink><MD5ChecksumPointData>{md5}</MD5ChecksumPointData></DataLink>
  </Record3>
  <Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4>
</p:ISO5436_2>
"""


def x3p_bytes(result: Reconstruction) -> bytes:
    """The container of a result with mm_per_px; the same result gives the same bytes."""
    height, width = result.depth_mm.shape
    heights = np.where(result.known, result.depth_mm.astype(np.float64) * M_PER_MM, np.nan)
    data = heights[::-1].astype("<f8").tobytes()
    x, y = (pitch * M_PER_MM for pitch in check_mm_per_px(result.mm_per_px))
    main = _MAIN.format(x=x, y=y, width=width, height=height, md5=_md5(data)).encode()
    checksum = f"{_md5(main)} *main.xml\n".encode()
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        for name, member in (("main.xml", main), ("bindata/data.bin", data), ("md5checksum.hex", checksum)):
            file.writestr(zipfile.ZipInfo(name), member, zipfile.ZIP_DEFLATED)
    return content.getvalue()


def _md5(content: bytes) -> str:
    """The checksum that the format requires; it protects no secret."""
    return hashlib.md5(content, usedforsecurity=False).hexdigest()


def save_surface(result: Reconstruction, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a result's surface; the ending of the name selects the format.

    | ending | content |
    |---|---|
    | .ply | points_mm (x, y, -depth) in the camera's optical frame, x right, y down, z away from the camera, as triangles |
    | .stl | the same surface, closed by walls and a flat base: watertight, to print |
    | .tif, .tiff | depth_mm, float32 |
    | .x3p | ISO 25178-72: heights in meters, x right, y up, z towards the camera |
    | .png | 16 bits: depth_mm = (v - 32768) x 1e-4, or 0 where depth is unknown |

    Parameters
    ----------
    result : with mm_per_px
    path : one of SURFACES' endings
    overwrite : whether to replace an existing file

    Raises
    ------
    ValueError, TypeError
        The ending is unknown, or the result is no Reconstruction.
    DataError
        The result is in pixels, depth exceeds the format's range, trimesh is missing (extra `mesh`), or the file exists or
        cannot be written.
    """
    check_is(result, Reconstruction, "result")
    path = check_path(path)
    if path.suffix.lower() not in SURFACES:
        raise ValueError(f"Expected a name that ends in {', '.join(SURFACES)}, got {path.name}.")
    if result.mm_per_px is None:
        raise DataError(f"Expected a result in mm to write {path.name}, got one without mm_per_px.")
    if path.exists() and not overwrite:
        raise DataError(f"{path} is there already. Choose another name, or overwrite.")
    content = SURFACES[path.suffix.lower()](result)
    made_folder(path.parent)
    with written_file(path, overwrite=overwrite) as file:
        file.write(content)
    return path


def points_from_result(result: Reconstruction) -> Floats:
    """points_mm (H*W, 3), row by row: (x, y, -depth_mm), right-handed, from the middle of the image."""
    height, width = result.depth.shape
    pitch_x, pitch_y = check_mm_per_px(result.mm_per_px)
    points = np.empty((height, width, 3), dtype=np.float32)
    points[..., 0] = (np.arange(width) - (width - 1) / 2) * pitch_x
    points[..., 1] = ((np.arange(height) - (height - 1) / 2) * pitch_y)[:, None]
    points[..., 2] = -result.depth_mm
    return points.reshape(-1, 3)


def _surface_triangles(height: int, width: int) -> NDArray[np.int64]:
    """Triangles (n, 3) of a grid of points; their normals point towards the camera, -z."""
    index = np.arange(height * width).reshape(height, width)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return np.concatenate([np.stack([c, b, a], -1), np.stack([c, d, b], -1)])


def _ply(result: Reconstruction) -> bytes:
    points, corners = points_from_result(result), _surface_triangles(*result.depth.shape)
    triangles = np.empty(len(corners), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, corners
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(corners)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode("ascii") + points.astype("<f4").tobytes() + triangles.tobytes()


def _stl(result: Reconstruction) -> bytes:
    top = points_from_result(result)
    base, count = top.copy(), len(top)
    base[:, 2] = top[:, 2].max() + 0.1 * np.ptp(top[:, 0])  # a tenth of the width below the lowest point
    surface, index = _surface_triangles(*result.depth.shape), np.arange(count).reshape(result.depth.shape)
    rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    after = np.roll(rim, -1)
    walls = np.concatenate(
        [np.stack([rim, after, rim + count], -1), np.stack([after, after + count, rim + count], -1)]
    )
    triangles = np.concatenate([surface, surface[:, ::-1] + count, walls])
    trimesh = needed("trimesh", "mesh", "Writing STL")
    return bytes(
        trimesh.Trimesh(np.concatenate([top, base]), triangles, process=False).export(file_type="stl")
    )


def _tiff(result: Reconstruction) -> bytes:
    return picture_bytes(result.depth_mm, ".tiff")


SURFACES: dict[str, Callable[[Reconstruction], bytes]] = {
    ".ply": _ply,
    ".stl": _stl,
    ".tiff": _tiff,
    ".tif": _tiff,
    ".png": lambda result: picture_bytes(levels_from_depth(result.depth_mm, result.known), ".png"),
    ".x3p": x3p_bytes,
}

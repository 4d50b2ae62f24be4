"""Depth for other programs: in 16 bits, as a surface with units (X3P, PLY, STL, TIFF); and tables for Taxim.

X3P is the XML container of surface topography (ISO 25178-72, openGPS): heights in meters, with checksums. The file is a zip
of `main.xml`, `bindata/data.bin` (little-endian heights, row by row from the smallest y) and `md5checksum.hex`. The axes
are right-handed: x right, y up, z towards the camera. The image's rows are therefore stored from the last to the first, and
z is depth. Unknown heights are NaN, as the format requires.

Taxim, TacEx and Isaac Lab render a sensor's images from Taxim's tables: Z. Si and W. Yuan, Taxim: an example-based
simulation model for GelSight tactile sensors, RA-L 7(2), 2022. Slopes are binned by angle and direction. Each bin has, per
channel, a quadratic polynomial of the pixel's place for the change in gray levels. The calibration's forward response fills
the table.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import Array, Floats, Map, Mask, Numbers
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import CalibrationError, DataError, needed
from gelform.exchange.exporters.press_folder import written_whole
from gelform.foundations.checks import (
    as_array,
    check_choice,
    check_is,
    check_mm_per_px,
    check_path,
    check_values,
)
from gelform.foundations.files import made_folder, picture_bytes, written_file
from gelform.image.background import image_from_color_change
from gelform.result import Reconstruction
from gelform.simulate.press import STEEPEST_RENDERED

ZERO_LEVEL, MM_PER_LEVEL, UNKNOWN = 32768, 1e-4, 0  # 16-bit levels: 0.1 um per step, +-3.3 mm


def levels_from_depth(depth_mm: ArrayLike, known: ArrayLike | None = None) -> NDArray[np.uint16]:
    """16-bit levels (H, W) of a depth map in mm, -3.2767 to 3.2767 mm, rounded to 0.1 um; 0 where it is not known.

    DataError: depth is out of range; nothing is clipped.
    ValueError, TypeError: depth is no finite (H, W) array of numbers, or `known` has another shape.
    """
    exact = np.float32 if getattr(depth_mm, "dtype", None) == np.float32 else np.float64
    depth = check_values(depth_mm, "depth_mm", (), exact)
    mask = np.ones(depth.shape, dtype=bool) if known is None else as_array(known, "known")
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
    made_folder(path.parent)
    with written_file(path, overwrite=overwrite) as file:
        file.write(SURFACES[path.suffix.lower()](result))
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


SURFACES: dict[str, Callable[[Reconstruction], bytes]] = {
    ".ply": _ply,
    ".stl": _stl,
    **dict.fromkeys((".tiff", ".tif"), lambda result: picture_bytes(result.depth_mm, ".tiff")),
    ".png": lambda result: picture_bytes(levels_from_depth(result.depth_mm, result.known), ".png"),
    ".x3p": x3p_bytes,
}


RENDERERS = {  # channel (of R, G, B) that each renderer reads from grad_r, grad_g, grad_b
    "taxim": (2, 1, 0),  # its images have OpenCV's order, blue first
    "isaaclab": (0, 1, 2),
}
BINS = 125  # as in Taxim


def save_taxim(
    calibration: Calibration | str | PathLike[str], folder: str | PathLike[str], *, renderer: str = "taxim"
) -> Path:
    """Write `polycalib.npz`, `bg.jpg`, `real_bg.npy` and a note with the renderer's settings for them.

    Parameters
    ----------
    calibration : a Calibration or its file
    folder : new or empty; appears complete or not at all
    renderer : "taxim" (and TacEx), whose `grad_r` is the blue channel, or "isaaclab", whose `grad_r` is the red one

    Returns
    -------
    folder : Path

    Raises
    ------
    CalibrationError
        The calibration was imported without a forward response, or has no mm per px.
    DataError
        The folder is not empty or cannot be written.
    ValueError
        The renderer is unknown.
    """
    calibration, folder = as_calibration(calibration), check_path(folder)
    check_choice(renderer, RENDERERS, "renderer")
    if calibration.mm_per_px is None:
        raise CalibrationError(
            "Expected a calibration with mm_per_px, which a renderer needs. Measure it with gelform scale."
        )
    with written_whole(folder) as partial:
        table = taxim_table(calibration)
        channels = zip(("grad_r", "grad_g", "grad_b"), RENDERERS[renderer])
        arrays: dict[str, Any] = {name: table[:, :, c] for name, c in channels}
        np.savez(partial / "polycalib.npz", bins=BINS, **arrays)
        background = calibration.background
        levels = np.rint(background).astype(np.uint8)
        full_color = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
        jpeg = picture_bytes(levels, ".jpg", (cv2.IMWRITE_JPEG_QUALITY, 100, *full_color))
        (partial / "bg.jpg").write_bytes(jpeg)
        np.save(partial / "real_bg.npy", background[..., list(RENDERERS[renderer])])
        (partial / "settings.txt").write_text(_settings(calibration, renderer), encoding="utf-8")
    return folder


def taxim_table(calibration: Calibration) -> Numbers:
    """Changes in gray levels, (bins, bins, 3, 6): by angle and direction, for R, G, B, in x^2, y^2, xy, x, y, 1.

    Angles run from 0 to 90 degrees, directions of the gradient from -180 to 180, both in BINS - 1 steps. Places are
    pixels of the calibrated image. A level gel changes nothing.

    CalibrationError: the calibration was imported without a forward response.
    """
    calibration.color_from_gradients(np.zeros((*calibration.image_shape, 2)))  # raises without a response
    response: Any = calibration.forward
    # The polynomials are fitted to 9 x 12 pixels spread over the image.
    lines = (np.round(np.linspace(0, n - 1, k)) for n, k in zip(calibration.image_shape, (9, 12)))
    y_px, x_px = (one.ravel() for one in np.meshgrid(*lines, indexing="ij"))
    blurred = cv2.GaussianBlur(calibration.background, (0, 0), 4)  # a quadratic polynomial contains no dust
    untouched = blurred[y_px.astype(int), x_px.astype(int)]
    terms = np.stack([x_px**2, y_px**2, x_px * y_px, x_px, y_px, np.ones(x_px.size)], axis=1)
    fit = np.linalg.pinv(terms)
    angles = (np.arange(BINS) + 0.5) * (np.pi / 2 / (BINS - 1))
    slopes = np.minimum(np.tan(np.minimum(angles, np.pi / 2 - 1e-6)), STEEPEST_RENDERED)
    slopes[0] = 0
    directions = (np.arange(BINS) + 0.5) * (2 * np.pi / (BINS - 1)) - np.pi
    table = np.empty((BINS, BINS, 3, 6))
    for steepness, slope in enumerate(slopes):
        gradients = slope * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
        change = response.color_from_gradients(
            np.repeat(gradients, x_px.size, axis=0), np.tile(x_px, BINS), np.tile(y_px, BINS)
        )
        background = np.tile(untouched, (BINS, 1, 1))
        levels = image_from_color_change(change.reshape(background.shape), background, calibration.change)
        table[steepness] = np.einsum("kp,dpc->dck", fit, levels.astype(np.float64) - background)
    return table


def _settings(calibration: Calibration, renderer: str) -> str:
    height, width = calibration.image_shape
    if renderer == "isaaclab":
        return (
            "GelSightRenderCfg(\n"
            '    base_data_path="<the folder above this one>",\n'
            '    sensor_data_dir_name="<this folder>",\n'
            f"    image_height={height},\n    image_width={width},\n    num_bins={BINS},\n"
            f"    mm_per_pixel={calibration.mm_per_px:.6g},\n)\n"
        )
    return f"h = {height}\nw = {width}\npixmm = {calibration.mm_per_px:.6g}\nnumBins = {BINS}\n"

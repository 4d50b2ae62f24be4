"""Objects to press into a simulated gel, from files: meshes (STL, PLY, OBJ) and height images."""

from __future__ import annotations

from os import PathLike

import cv2
import numpy as np

from gelform.errors import DataError
from gelform.foundations.checks import check_path, check_positive
from gelform.foundations.npz_files import present_file
from gelform.simulate import HeightMap, Mesh

MESH_SUFFIXES = (".stl", ".ply", ".obj")
MAX_MESH_BYTES = 2**29  # bytes; larger meshes take minutes


def read_mesh(path: str | PathLike[str], *, mm_per_unit: float = 1.0) -> Mesh:
    """Read a closed mesh; its +z side faces the gel, y goes down in the image.

    Parameters
    ----------
    path : .stl, .ply or .obj
    mm_per_unit : 1 for files in mm, 1000 for meters, 25.4 for inches

    Raises
    ------
    DataError
        The file is missing, of another kind, too large or damaged; or the mesh is empty, open, or of a size that suggests
        another unit.
    ImportError
        trimesh is not installed: `pip install "gelform[mesh]"`.
    """
    path = check_path(path)
    scale = check_positive(mm_per_unit, "mm_per_unit")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise DataError(f"Expected a mesh as {', '.join(MESH_SUFFIXES)}, got {path.name}.")
    present_file(path, "a mesh", MAX_MESH_BYTES)
    try:
        import trimesh
    except ImportError as problem:
        raise ImportError('Reading meshes needs trimesh: pip install "gelform[mesh]".') from problem
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
        vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    except Exception as problem:  # its readers raise many kinds of errors
        raise DataError(f"{path} is damaged, or no {path.suffix[1:].upper()} file: {problem}.") from problem
    if triangles.size == 0:
        raise DataError(f"{path}: Expected a mesh with triangles, got an empty one.")
    try:
        return Mesh(vertices * scale, triangles)
    except ValueError as problem:
        raise DataError(f"{path}: {problem}") from problem


def read_height_image(path: str | PathLike[str], *, mm_per_px: float, height_mm: float) -> HeightMap:
    """Read a height map from a gray image of 8 or 16 bits: black is the lowest, white is `height_mm` higher.

    DataError: the file is missing, no image, or in color.
    """
    path = present_file(path, "a gray image")
    gray = cv2.imdecode(np.frombuffer(path.read_bytes(), dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if gray is None:
        raise DataError(f"{path} is no image, or a damaged one.")
    if gray.ndim != 2 or gray.dtype not in (np.uint8, np.uint16):
        raise DataError(
            f"Expected a gray image of 8 or 16 bits, got {path} of shape {gray.shape}, {gray.dtype}."
        )
    scale = check_positive(height_mm, "height_mm") / float(np.iinfo(gray.dtype).max)
    return HeightMap(gray.astype(np.float64) * scale, mm_per_px)

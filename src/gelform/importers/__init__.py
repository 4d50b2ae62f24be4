"""Other packages' calibrations and tables, meshes and height images."""

from gelform.importers.calibrations import PACKAGES, import_calibration
from gelform.importers.relief import read_height_image, read_mesh
from gelform.importers.tables import TaximLook, is_taxim_forward, read_taxim_forward

__all__ = [
    "PACKAGES",
    "TaximLook",
    "import_calibration",
    "is_taxim_forward",
    "read_height_image",
    "read_mesh",
    "read_taxim_forward",
]

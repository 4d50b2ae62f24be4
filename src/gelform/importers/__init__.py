"""Other packages' calibrations and tables, meshes and height images."""

from gelform.importers.tables import TaximLook, read_taxim_forward

__all__ = ["TaximLook", "read_taxim_forward"]

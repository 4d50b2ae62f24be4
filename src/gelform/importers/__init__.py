"""Calibrations and tables of other packages, meshes and height images."""

from gelform.importers.tables import TaximLook, read_taxim_forward

__all__ = ["TaximLook", "read_taxim_forward"]

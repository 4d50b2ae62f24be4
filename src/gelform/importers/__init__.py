"""Calibrations and tables of other packages."""

from gelform.importers.tables import TaximLook, read_taxim_forward

__all__ = ["TaximLook", "read_taxim_forward"]

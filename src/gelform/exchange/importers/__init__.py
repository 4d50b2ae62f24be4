"""Calibrations and tables of other packages."""

from gelform.exchange.importers.tables import TaximLook, read_taxim_forward

__all__ = ["TaximLook", "read_taxim_forward"]

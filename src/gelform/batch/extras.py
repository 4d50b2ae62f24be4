"""Packages that only some inputs and outputs need, imported where they are used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from gelform.errors import DataError


def needed(module: str, extra: str, what: str) -> Any:
    """Import a module of an extra.

    Parameters
    ----------
    module, extra : such as "h5py", "hdf5"
    what : that needs it, such as "HDF5"

    Raises
    ------
    DataError
        It is not installed; the message says how to.
    """
    try:
        return import_module(module)
    except ImportError as missing:
        raise DataError(f'{what} needs the extra {extra}: pip install "gelform[{extra}]".') from missing

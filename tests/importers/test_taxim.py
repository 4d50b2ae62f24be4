"""Taxim's forward table: files of another kind, damaged or too large are refused."""

import io
import zipfile

import numpy as np
import pytest

import gelform
from gelform.importers.taxim import read_taxim
from made.taxim_tables import taxim_arrays

SHAPE = (24, 32)


def test_other_files_are_refused(tmp_path):
    background, path = np.zeros((*SHAPE, 3), dtype=np.float32), tmp_path / "polycalib.npz"
    with pytest.raises(gelform.DataError, match="No file"):
        read_taxim(path, background)
    good = taxim_arrays(bins=20)
    for spoilt, why in (
        ({k: v for k, v in good.items() if k != "bins"}, "lacks bins"),
        ({**good, "grad_r": good["grad_r"][:-1]}, "three tables"),
        ({**good, "bins": np.array(21)}, "three tables"),
        ({**good, "grad_g": good["grad_g"] * np.nan}, "finite"),
        ({**good, "bins": np.array([object()])}, "damaged"),
    ):
        np.savez(path, **spoilt)
        with pytest.raises(gelform.DataError, match=why):
            read_taxim(path, background)
    np.savez(path, **good)
    with pytest.raises(gelform.DataError, match="proportions"):
        read_taxim(path, np.zeros((32, 24, 3), dtype=np.float32))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(gelform.DataError, match="damaged"):
        read_taxim(path, background)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**27,)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("bins.npy", "w") as member:
        member.write(header.getvalue())
        for _ in range(257):
            member.write(bytes(2**20))
    with pytest.raises(gelform.DataError, match="declares 269 MB"):
        read_taxim(path, background)

"""The one table of a result's maps: it says what a result, its file and the documents say."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np

from gelform.result import Reconstruction, save_result
from gelform.result.maps import BESIDE_DEPTH, KEPT_MAPS, MAPS

DOCS = Path(__file__).parents[2] / "docs"


def test_the_table_has_every_map_of_a_result_and_its_file(result, tmp_path):
    held = {
        entry.name for entry in fields(Reconstruction) if "NDArray" in entry.type and "Call" not in entry.type
    }
    assert held == {"depth", *(row.name for row in BESIDE_DEPTH)}
    for row in MAPS.values():
        values = getattr(result, row.name)
        if values is not None:
            assert (values.shape, values.dtype) == ((*result.shape, *row.axes), np.dtype(row.dtype)), row.name
    save_result(result, tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz") as file:
        derived = {row.name for row in MAPS.values() if row.derived}
        assert MAPS.keys() - derived - {"depth_sigma_mm"} <= set(file.files)


def test_the_documents_list_what_a_batch_keeps():
    assert f"any of {', '.join(KEPT_MAPS)} |" in (DOCS / "batch.md").read_text(encoding="utf-8")


def test_help_reads_the_table_without_numpy():
    program = "import sys, gelform.result.maps; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

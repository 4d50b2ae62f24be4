"""Every form gives back the depth that was written."""

import numpy as np
import pytest

from gelform.batch.outputs.read_back import depth_of_row
from gelform.batch.settings import FORMATS

NEEDS = {"zarr": "numcodecs", "hdf5": "h5py", "ffv1": "av", "lerobot": "av"}
TO_THE_LEVEL_MM = {"lerobot": 0.501e-3}


@pytest.mark.parametrize("form", FORMATS)
def test_the_depth_of_every_frame(written, results, tmp_path, form):
    if form in NEEDS:
        pytest.importorskip(NEEDS[form], reason=f"the extra {form} is not installed")
    _, rows = written(form, keep=("depth",), sequence="gel/episode_000001")
    for index, (row, result) in enumerate(zip(rows, results)):
        depth = depth_of_row(tmp_path, form, {"output": "", **row, "index": index})
        if result is None:
            assert depth is None
        else:
            assert np.abs(depth - result.depth_mm)[result.known].max() <= TO_THE_LEVEL_MM.get(form, 0.51e-4)


def test_depth_that_was_not_kept(written, tmp_path):
    _, rows = written("npz", keep=("contact",))
    assert depth_of_row(tmp_path, "npz", {**rows[0], "index": 0}) is None


def test_a_whole_result(written, results, tmp_path):
    _, rows = written("npz", keep=("all",))
    depth = depth_of_row(tmp_path, "npz", {**rows[0], "index": 0})
    np.testing.assert_array_equal(depth, results[0].depth_mm)

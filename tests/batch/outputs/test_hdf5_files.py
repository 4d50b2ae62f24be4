"""HDF5: what h5py reads is what was reconstructed; the file of all sequences shows each as one."""

import numpy as np
import pytest

from gelform.batch import BatchSettings, run_batch
from gelform.batch.outputs.hdf5_files import hdf5_index
from gelform.batch.settings import KEPT

h5py = pytest.importorskip("h5py", reason="the extra hdf5 is not installed")


@pytest.mark.parametrize("counted", [True, False])
def test_every_map_as_h5py_reads_it(written, results, tmp_path, counted):
    _, rows = written("hdf5", keep=KEPT, counted=counted)
    with h5py.File(tmp_path / rows[0]["output"]) as file:
        for name, dataset in file.items():
            assert len(dataset) == 5
            for k, result in enumerate(results):
                if result is not None:
                    np.testing.assert_array_equal(dataset[k], getattr(result, name))
        assert np.isnan(file["depth_mm"][2]).all()
        assert not file["contact"][2].any()
        assert file["depth_mm"].attrs["unit"] == "mm"


def test_one_file_shows_every_sequence_as_a_whole(tree, cal, tmp_path):
    settings = BatchSettings("hdf5", keep=("depth",), dtype="uint16", part_frames=3)
    assert run_batch(tree, cal, tmp_path / "out", settings).complete
    with h5py.File(tmp_path / "out/frames.h5") as file:
        assert file["depth_mm"].shape == file["day2/depth_mm"].shape == (4, 64, 80)
        with h5py.File(tmp_path / "out/frames/day2/00000003.h5") as part:
            np.testing.assert_array_equal(file["day2/depth_mm"][3], part["depth_mm"][0])
        assert file["day2/depth_mm"][3].max() > 32768
    files = [f"frames/{name}/0000000{k}.h5" for name in (".", "day2") for k in (0, 3)]
    files = [name.replace("/./", "/") for name in files]
    assert hdf5_index(tmp_path / "out", files) == (tmp_path / "out/frames.h5").read_bytes()

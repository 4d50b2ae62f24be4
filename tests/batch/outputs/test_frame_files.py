"""Files of one frame: what numpy, OpenCV and load_result read is what was reconstructed."""

import cv2
import numpy as np

import gelform
from gelform.batch.settings import KEPT
from gelform.exporters.quantised import depth_from_levels


def test_chosen_maps(written, results, tmp_path):
    for keep in (("depth", "known"), KEPT):
        _, rows = written("npz", keep=keep)
        with np.load(tmp_path / rows[1]["output"]) as file:
            names = {{"depth": "depth_mm", "depth_sigma": "depth_sigma_mm"}.get(name, name) for name in keep}
            assert set(file.files) == {*names, "mm_per_px", "meta"}
            for name in names:
                np.testing.assert_array_equal(file[name], getattr(results[1], name))


def test_an_error_has_no_file(written, tmp_path):
    _, rows = written("npz")
    assert rows[2] == {}
    assert len(list((tmp_path / "frames/day/a").iterdir())) == 4


def test_whole_results(written, results, tmp_path):
    _, rows = written("npz", keep=("all",))
    read = gelform.load_result(tmp_path / rows[0]["output"])
    np.testing.assert_array_equal(read.gradients, results[0].gradients)


def test_depth_in_16_bits(written, results, tmp_path):
    _, rows = written("png")
    depth, known = depth_from_levels(cv2.imread(str(tmp_path / rows[0]["output"]), cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(known, results[0].known)
    assert np.abs(depth - results[0].depth_mm)[known].max() <= 0.51e-4

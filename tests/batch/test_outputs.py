"""Files of one frame: what numpy, OpenCV and load_result read is what was reconstructed."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.batch.outputs import facts_of, size_and_digest, writer_of
from gelform.batch.settings import KEPT, BatchSettings
from gelform.errors import DataError
from gelform.exporters.quantised import depth_from_levels
from hostile.small_gel import MM_PER_PX, Touch, depth_of


@pytest.fixture(scope="module")
def result(cal, images):
    return gelform.Reconstructor(cal).from_image(images[3])


def test_chosen_maps(result, tmp_path):
    for keep in (("depth", "known"), KEPT):
        path = tmp_path / f"{len(keep)}.npz"
        writer_of(result, BatchSettings(keep=keep))(path)
        with np.load(path) as file:
            names = {{"depth": "depth_mm", "depth_sigma": "depth_sigma_mm"}.get(name, name) for name in keep}
            assert set(file.files) == {*names, "mm_per_px", "meta"}
            for name in names:
                np.testing.assert_array_equal(file[name], getattr(result, name))


def test_whole_results(result, tmp_path):
    writer_of(result, BatchSettings(keep=("all",)))(tmp_path / "a.npz")
    np.testing.assert_array_equal(gelform.load_result(tmp_path / "a.npz").gradients, result.gradients)


def test_depth_in_16_bits(result, tmp_path):
    writer_of(result, BatchSettings(form="png"))(tmp_path / "a.png")
    depth, known = depth_from_levels(cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(known, result.known)
    assert np.abs(depth - result.depth_mm)[known].max() <= 0.51e-4


def test_the_same_bytes_twice(result, tmp_path):
    for form in ("npz", "png"):
        for name in ("a", "b"):
            writer_of(result, BatchSettings(form=form))(tmp_path / f"{name}.{form}")
        assert size_and_digest(tmp_path / f"a.{form}") == size_and_digest(tmp_path / f"b.{form}")


def test_a_map_that_is_not_there_is_said(cal, images, tmp_path):
    without = gelform.Reconstructor(cal, depth_sigma=False).from_image(images[0])
    with pytest.raises(DataError, match="gives no depth_sigma_mm"):
        writer_of(without, BatchSettings(keep=("depth_sigma",)))


def test_figures_of_a_ball(result):
    """Against the true depth, over the contact that was found."""
    facts, truth = facts_of(result), depth_of(Touch(depth_mm=0.35))
    assert facts["contacts"] == 1
    assert facts["findings"] == ""
    assert facts["deepest_mm"] == pytest.approx(truth.max(), abs=0.02)
    assert facts["volume_mm3"] == pytest.approx(truth[result.contact].sum() * MM_PER_PX**2, rel=0.03)
    assert facts["contact_mm2"] == pytest.approx(result.contact.sum() * MM_PER_PX**2)

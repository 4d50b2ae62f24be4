"""Several contacts of one body as one surface."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.exchange.exporters.surface import save_surface
from made.rigid_contacts import DEPTH_MM, MM_PER_PX, contact_of, plate, pose, texture

pytestmark = pytest.mark.linear_algebra

PATH = [pose(0.5 * k, 0.1 * k, 0.02 * k, 0.5 * k, 0, k) for k in (-2, -1, 0, 1, 2)]


@pytest.fixture(scope="module")
def parts():
    return [contact_of(texture(), one, radius_mm=2.0, stays=True) for one in PATH]


def true_depth(shape):
    height, width = shape
    y, x = (np.mgrid[:height, :width] - np.array(shape)[:, None, None] / 2 + 0.5) * MM_PER_PX
    return texture()(x, y) + DEPTH_MM


def test_the_surface_is_the_body_in_the_first_frame(parts):
    """Poses are from the body's own frame here, so that is the first frame."""
    whole = gelform.mosaic(parts, PATH)
    seen = whole.known
    assert seen.sum() > 1.2 * max(one.contact.sum() for one in parts)
    assert (whole.contact == seen).all()
    off = (whole.depth_mm - true_depth(whole.shape))[seen]
    assert np.abs(off).max() < 0.02
    assert off.std() < 0.003
    np.testing.assert_array_equal(whole.depth_mm[~seen], 0)


def test_wrong_poses_show(parts):
    """A sign, or a motion the other way round, is a hundred times worse."""
    whole = gelform.mosaic(parts, [np.linalg.inv(one) for one in PATH])
    assert (whole.depth_mm - true_depth(whole.shape))[whole.known].std() > 0.02


def test_sigma_has_the_poses_covariance(parts):
    motions = [gelform.motion_between(parts[2], one, start=start) for one, start in zip(parts, PATH)]
    assert all(one.pose is not None for one in motions)
    sure, unsure = gelform.mosaic(parts, [one.pose for one in motions]), gelform.mosaic(parts, motions)
    seen = sure.known & unsure.known
    assert (unsure.depth_sigma_mm[seen] >= sure.depth_sigma_mm[seen]).all()
    assert np.median(unsure.depth_sigma_mm[seen]) < 0.02
    vague = [replace(one, covariance=np.diag([0, 0, 0.1**2, 0, 0, 0])) for one in motions]
    np.testing.assert_allclose(gelform.mosaic(parts, vague).depth_sigma_mm[seen], 0.1, rtol=0.1)


def test_where_a_contact_ends_there_is_no_step():
    """A contact within a wider one that is wrong by 0.05 mm, and ends 2 mm from the middle: ramps, no steps."""
    wide, within = (contact_of(plate, radius_mm=radius, stays=True) for radius in (3.2, 2.0))
    deeper = replace(within, depth=(within.depth_mm + 0.05).astype(np.float32))
    depth = gelform.mosaic([wide, deeper], [np.eye(4)] * 2).depth_mm
    row = depth[depth.shape[0] // 2]
    assert row.max() - DEPTH_MM > 0.008
    assert np.abs(np.diff(row[row > 0])).max() < 0.002


def test_it_is_a_result_with_its_files(parts, tmp_path):
    whole = gelform.mosaic(parts, PATH)
    gelform.save_result(whole, tmp_path / "whole.npz")
    np.testing.assert_array_equal(gelform.load_result(tmp_path / "whole.npz").depth_mm, whole.depth_mm)
    assert save_surface(whole, tmp_path / "whole.ply").stat().st_size > 10_000


def test_lost_frames_are_left_out(parts):
    lost = gelform.motion_between(parts[0], contact_of(texture(), radius_mm=0.1))
    both = gelform.mosaic(parts, [*PATH[:4], lost])
    np.testing.assert_array_equal(both.depth_mm, gelform.mosaic(parts[:4], PATH[:4]).depth_mm)
    with pytest.raises(gelform.GelformError, match="no surface"):
        gelform.mosaic(parts[:1], [lost])


def test_what_does_not_go_together_is_refused(parts):
    with pytest.raises(ValueError, match="one pose for each"):
        gelform.mosaic(parts, PATH[:2])
    with pytest.raises(ValueError, match="one sensor"):
        gelform.mosaic([parts[0], contact_of(texture(), calibration_digest="b")], PATH[:2])
    with pytest.raises(ValueError, match="poses in mm"):
        gelform.mosaic(parts[:2], [PATH[0], pose(2000.0)])

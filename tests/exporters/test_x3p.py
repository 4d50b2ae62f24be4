"""X3P: what a reader by the standard's letter finds is the surface, in metres, with its checksums."""

import hashlib
import io
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import gelform
from gelform.exporters.surface import save_surface
from gelform.exporters.x3p import x3p_bytes
from made.small_gel import MM_PER_PX, SHAPE, Touch, calibration, image_of


@pytest.fixture(scope="module")
def result():
    found = gelform.Reconstructor(calibration())(image_of(Touch()))
    known = found.known.copy()
    known[:5] = False
    return replace(found, known=known)


def read(content):
    """Heights (SizeY, SizeX) and pitches, m; every checksum looked at."""
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        main = file.read("main.xml")
        digest, name = file.read("md5checksum.hex").decode().split()
        assert (digest, name) == (hashlib.md5(main).hexdigest(), "*main.xml")
        root = ElementTree.fromstring(main)
        assert root.tag == "{http://www.opengps.eu/2008/ISO5436_2}ISO5436_2"
        data = file.read(root.findtext("Record3/DataLink/PointDataLink"))
        assert hashlib.md5(data).hexdigest() == root.findtext("Record3/DataLink/MD5ChecksumPointData")
    assert root.findtext("Record1/FeatureType") == "SUR"
    assert root.findtext("Record1/Axes/CZ/DataType") == "D"
    size = [int(root.findtext(f"Record3/MatrixDimension/Size{axis}")) for axis in "XYZ"]
    pitch = [float(root.findtext(f"Record1/Axes/C{axis}/Increment")) for axis in "XYZ"]
    return np.frombuffer(data, "<f8").reshape(size[2], size[1], size[0])[0] * pitch[2], pitch[:2]


def test_the_surface_in_metres(result):
    heights, pitch = read(x3p_bytes(result))
    assert pitch == pytest.approx([MM_PER_PX * 1e-3] * 2)
    assert heights.shape == SHAPE
    upright = heights[::-1]  # y up
    np.testing.assert_allclose(upright[result.known] * 1e3, result.depth_mm[result.known], rtol=1e-12)
    assert np.isnan(upright[~result.known]).all()


def test_a_deep_point_low_in_the_image_has_a_small_y(result):
    heights, _ = read(x3p_bytes(result))
    row = np.unravel_index(np.nanargmax(heights), SHAPE)[0]
    assert row == pytest.approx(SHAPE[0] - 1 - 30, abs=4)


def test_by_its_ending_and_the_same_bytes_twice(result, tmp_path):
    path = save_surface(result, tmp_path / "a.x3p")
    assert path.read_bytes() == x3p_bytes(result)

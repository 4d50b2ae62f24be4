"""What is shown of a frame: the planes it has, each encoded once."""

import numpy as np

from gelform.live.shown import CONTACT, KNOWN, PLANES, Shown


def test_it_has_the_planes_of_its_result(shown, result):
    planes = {plane.facts["name"]: plane for plane in shown.planes(PLANES, "raw")}
    assert {"image", "depth", "confidence", "sigma", "flags"} <= planes.keys()
    assert "other" not in planes
    flags = np.frombuffer(planes["flags"].data, np.uint8).reshape(result.shape)
    np.testing.assert_array_equal(flags & CONTACT != 0, result.contact)
    np.testing.assert_array_equal(flags & KNOWN != 0, result.known)
    confidence = np.frombuffer(planes["confidence"].data, np.uint8).reshape(result.shape) / 255
    np.testing.assert_allclose(confidence, result.confidence, atol=0.5 / 255 + 1e-6)


def test_a_plane_is_encoded_once(shown):
    first, second = (shown.planes(["depth"], "small")[0] for _ in range(2))
    assert first is second


def test_the_header_says_what_the_result_says(shown, result, pressed):
    header = shown.header()
    assert header["peak"] == result.peak_mm
    assert header["mm_per_px"] == [result.mm_per_px] * 2
    assert header["unit"] == "mm"
    assert header["index"] == 7
    assert [one[0] for one in header["health"]] == [finding.name for finding in result.health]


def test_without_a_result_there_is_the_image_and_the_reason(shown):
    bare = Shown(1, shown.frame, shown.image, problem="Expected another size.")
    assert [plane.facts["name"] for plane in bare.planes(PLANES, "raw")] == ["image"]
    assert bare.header()["problem"] == "Expected another size."
    assert "peak" not in bare.header()

"""Messages of the page: written and read back; maps as bytes: steps, rounding, packing, both encodings.

The displayed data of a frame: its planes, each encoded once; its numbers, against those of the array.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gelform
from gelform.depth.force import ForceModel, ForcePart
from gelform.errors import DataError, Finding, GelformError
from gelform.exchange.exporters.surface import ZERO_LEVEL
from gelform.live.shown import (
    CONTACT,
    KEPT_SNAPSHOTS,
    KNOWN,
    PLANES,
    ShownFrame,
    Snapshots,
    depth_plane,
    image_plane,
    level_plane,
    message,
    number_plane,
    outlines_of,
    read_message,
)

DEPTH = np.linspace(-0.1, 0.6, 35, dtype=np.float32).reshape(5, 7)


def test_planes_come_back_by_name_aligned_for_typed_arrays():
    image = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    depth = depth_plane(DEPTH, "raw")
    data = message({"serial": 4, "a": "ä"}, [image_plane(image, "raw"), depth])
    header, planes = read_message(data)
    assert header["serial"] == 4
    assert planes == {"image": image.tobytes(), "depth": depth.data}
    assert header["planes"][1].items() >= depth.facts.items()
    start = 8 + int.from_bytes(data[4:8], "little")
    assert all((start + plane["offset"]) % 8 == 0 for plane in header["planes"])


def test_torn_messages_and_other_bytes_are_refused():
    data = message({}, [depth_plane(DEPTH, "raw")])
    for cut in (0, 3, 7, 20, len(data) - 8):
        with pytest.raises((DataError, ValueError)):
            read_message(data[:cut])
    with pytest.raises(DataError, match="other bytes"):
        read_message(b"GET / HTTP/1.1\r\n")


def floats(plane):
    """What the page makes of a plane."""
    facts, data = plane.facts, plane.data
    dtype = {"u8": np.uint8, "u16": np.uint16}[facts["kind"]]
    if facts["packed"]:
        steps = np.frombuffer(zlib.decompress(data), dtype).reshape(facts["height"], facts["width"])
        levels = np.cumsum(steps, axis=1, dtype=dtype)
    else:
        levels = np.frombuffer(data, dtype).reshape(facts["height"], facts["width"])
    return (levels.astype(float) - facts["zero"]) * facts["step"]


@pytest.fixture
def depth():
    y, x = np.mgrid[:40, :60].astype(np.float32)
    return (0.8 * np.exp(-((x - 30) ** 2 + (y - 15) ** 2) / 80) - 0.05).astype(np.float32)


def test_depth_is_exact_to_half_a_step_of_a_tenth_of_a_micrometer_that_grows_with_it(depth):
    plane = depth_plane(depth, "raw")
    assert plane.facts["step"] == 1e-4
    np.testing.assert_allclose(floats(plane), depth, atol=0.51e-4)
    np.testing.assert_allclose(floats(depth_plane(10 * depth, "raw")), 10 * depth, atol=2e-4)
    levels = np.frombuffer(depth_plane(np.array([[0, -40]], np.float32), "raw").data, np.uint16)
    assert levels[0] == ZERO_LEVEL, "zero stays zero"
    assert levels[1] >= 1, "0 is never sent"


def test_small_depth_is_every_second_pixel_and_much_smaller(depth):
    plane = depth_plane(depth, "small")
    np.testing.assert_allclose(floats(plane), depth[::2, ::2], atol=0.51e-4)
    assert len(plane.data) < depth[::2, ::2].size * 2 / 1.5


def test_levels_are_cut_at_255_steps():
    plane = level_plane("confidence", np.array([[0.0, 0.5, 1.0, 7.0]], np.float32), "raw")
    np.testing.assert_allclose(floats(plane), [[0, 0.502, 1, 1]], atol=1e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bits_come_through_packing(dtype):
    bits = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (20, 30)).astype(dtype)
    np.testing.assert_array_equal(floats(number_plane("causes", bits, "small")), bits[::2, ::2])
    np.testing.assert_array_equal(floats(number_plane("causes", bits, "raw")), bits)


def test_the_image_is_rgb_raw_and_as_jpeg(depth):
    image = np.stack([np.full((40, 60), level, np.uint8) for level in (200, 100, 30)], axis=-1)
    assert image_plane(image, "raw").data == image.tobytes()
    jpeg = image_plane(image, "small")
    decoded = cv2.imdecode(np.frombuffer(jpeg.data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_allclose(decoded, image, atol=4)


def test_the_force_is_there_with_its_sigma_or_the_reason(shown, result):
    """Nothing without known loads."""
    assert shown.header()["force"] is None
    part = ForcePart(((3.0,),), (0.1, 1e4), 0.2, 0.1, 9)
    model = ForceModel(part, None, None, (), ("ball",), result.calibration_digest, "")
    force = replace(shown, result=replace(result, force_model=model), _made={}).header()["force"]
    assert force["normal_n"] == pytest.approx(3 * result.numbers.volume, rel=1e-5)
    of_model = np.hypot(0.2 * force["normal_n"], 0.1)
    assert of_model < force["normal_sigma_n"] < 1.2 * of_model, "the volume's own is in it"
    assert force["shear_x_n"] is None is force["torsion_n_mm"]
    assert "no loads" in force["force_reason"]
    json.dumps(force)


def test_an_outline_goes_round_each_contact_also_inside_a_ring(result):
    y, x = np.indices(result.shape)
    radius = np.hypot(x - 88, y - 66)
    contact = ((radius > 40) & (radius < 55)) | (radius < 15)
    ringed = replace(result, contact=contact, known=np.ones_like(contact))
    outlines = [np.array(one).reshape(-1, 2) for one in outlines_of(ringed)]
    assert len(outlines) == len(ringed.contacts) == 2
    reach = sorted(np.hypot(*(one - (88, 66)).T).max() for one in outlines)
    np.testing.assert_allclose(reach, (15, 55), atol=1.5)
    filled = np.zeros(result.shape, np.uint8)
    cv2.fillPoly(filled, [np.array(one).reshape(-1, 1, 2) for one in outlines_of(result)], 1)
    assert (filled.astype(bool) != result.contact).sum() < 0.06 * result.contact.sum()
    assert outlines_of(replace(result, contact=np.zeros_like(result.contact))) == []


def test_what_is_not_known_is_told_and_is_no_deepest_point(shown, result):
    """Half of the press is not known: its filled depth is nobody's figure."""
    assert shown.planes(["unknown"], "raw") == []
    known = np.ones(result.shape, bool)
    _, column = np.unravel_index(result.depth.argmax(), result.shape)
    known[:, column - 3 : column + 4] = False
    partly = replace(result, known=known)
    numbers = partly.numbers
    assert numbers.peak == result.depth[known].max() < result.depth.max()
    assert known[numbers.y_px, numbers.x_px]
    again = replace(shown, result=partly, _made={})
    (plane,) = again.planes(["unknown"], "raw")
    np.testing.assert_array_equal(np.frombuffer(plane.data, np.uint8).reshape(result.shape), ~known)
    (depth,), (plane,) = again.planes(["depth"], "small"), again.planes(["unknown"], "small")
    sizes = [[one.facts[name] for name in ("height", "width")] for one in (depth, plane)]
    assert sizes[0] == sizes[1], "each pixel of the depth has its own"


def test_it_has_the_planes_of_its_result(shown, result):
    planes = {plane.facts["name"]: plane for plane in shown.planes(PLANES, "raw")}
    assert {"image", "depth", "confidence", "sigma", "flags"} <= planes.keys()
    flags = np.frombuffer(planes["flags"].data, np.uint8).reshape(result.shape)
    np.testing.assert_array_equal(flags & CONTACT != 0, result.contact)
    np.testing.assert_array_equal(flags & KNOWN != 0, result.known)
    confidence = np.frombuffer(planes["confidence"].data, np.uint8).reshape(result.shape) / 255
    np.testing.assert_allclose(confidence, result.confidence, atol=0.5 / 255 + 1e-6)
    first, second = (shown.planes(["depth"], "small")[0] for _ in range(2))
    assert first is second


def test_the_header_says_what_the_result_says(shown, result, press):
    header = shown.header()
    assert header["peak"] == result.peak_mm
    assert header["mm_per_px"] == [result.mm_per_px] * 2
    assert header["unit"] == "mm"
    assert [one[0] for one in header["health"]] == [finding.name for finding in result.health]
    assert header["contacts"] == [asdict(contact) for contact in result.contacts]


def test_causes_are_a_bit_each_where_one_alone_is_worse_than_a_clean_slope(shown, result):
    steep, dark = np.zeros((2, *result.shape))
    steep[:, :5] = dark[:3] = 0.021
    dark[3:] = 0.019
    why = SimpleNamespace(confidence=dark, maps={"steep": steep, "dark": dark}, full_confidence_sigma=0.02)
    explained = ShownFrame(1, shown.frame, shown.image, result, explain=lambda: why)
    (plane,) = explained.planes(["causes"], "raw")
    np.testing.assert_array_equal(floats(plane), (steep > 0.02) + 2 * (dark > 0.02))


def test_without_a_result_there_is_the_image_and_the_reason(shown):
    bare = ShownFrame(1, shown.frame, shown.image, problem="Expected another size.")
    assert [plane.facts["name"] for plane in bare.planes(PLANES, "raw")] == ["image"]
    assert bare.header()["problem"] == "Expected another size."
    assert "peak" not in bare.header()


def test_where_nothing_is_known_there_is_no_map_and_no_figure_but_the_findings(shown, result):
    """A flat surface of 0.000 mm would look as untouched gel does."""
    words = Finding("not_this_gel", "This is another gel.", 1.0)
    unknown = replace(result, known=np.zeros_like(result.known), health=(words,))
    assert unknown.numbers is None
    found = ShownFrame(1, shown.frame, shown.image, unknown)
    assert [plane.facts["name"] for plane in found.planes(PLANES, "raw")] == ["image"]
    header = found.header()
    assert (header["problem"], "peak" in header, "outlines" in header) == (words.message, False, False)
    assert header["health"] == [["not_this_gel", "This is another gel.", 1.0]]


@pytest.fixture
def saved(shown, tmp_path):
    """name -> the path of the file as a browser would save it."""
    snapshots = Snapshots()
    number = snapshots.add(shown)

    def save(name):
        path = tmp_path / snapshots.file(number, name)[0]
        path.write_bytes(snapshots.file(number, name)[1])
        return path

    return save


def test_the_result_loads_and_the_frame_is_the_cameras_in_rgb(saved, result, press):
    np.testing.assert_array_equal(gelform.load_result(saved("result.npz")).depth_mm, result.depth_mm)
    np.testing.assert_array_equal(gelform.read_image(saved("frame.png")), press.image)


def test_the_surface_is_in_mm_and_the_picture_is_a_picture(saved, result):
    trimesh = pytest.importorskip("trimesh")
    surface = trimesh.load(saved("surface.ply"), process=False)
    height, width = result.shape
    assert surface.vertices.shape == (height * width, 3)
    np.testing.assert_allclose(surface.vertices[:, 2], -result.depth_mm.ravel(), atol=1e-6)
    np.testing.assert_allclose(np.ptp(surface.vertices[:, 0]), (width - 1) * result.mm_per_px, rtol=1e-6)
    assert gelform.read_image(saved("picture.png")).std() > 10


def test_only_files_that_can_be_made_are_offered(shown, result, monkeypatch):
    assert Snapshots.names(shown) == ["frame.png", "result.npz", "surface.ply", "picture.png"]
    in_pixels = ShownFrame(1, shown.frame, shown.image, replace(result, mm_per_px=None))
    assert Snapshots.names(in_pixels) == ["frame.png", "result.npz", "picture.png"]
    assert Snapshots.names(ShownFrame(1, shown.frame, shown.image)) == ["frame.png"]
    monkeypatch.setattr("gelform.live.shown.find_spec", lambda _: None)
    assert Snapshots.names(shown) == ["frame.png", "result.npz", "surface.ply"]


def test_old_ones_go_unknown_files_are_refused_and_without_a_result_there_is_the_image(shown):
    snapshots = Snapshots()
    first = snapshots.add(shown)
    for _ in range(KEPT_SNAPSHOTS):
        last = snapshots.add(ShownFrame(1, shown.frame, shown.image))
    for number, name in ((first, "result.npz"), (last, "../result.npz"), (99, "frame.png")):
        with pytest.raises(GelformError, match="no longer kept"):
            snapshots.file(number, name)
    assert snapshots.file(last, "frame.png")[1].startswith(b"\x89PNG")
    with pytest.raises(GelformError, match="no result"):
        snapshots.file(last, "result.npz")

"""The comparison of two commits notices one bit, says where it is, and passes over times of day alone."""

import dataclasses

import numpy as np
import pytest

import gelform
from same import differences, digest, lasting, of_file, of_frames


@pytest.fixture
def depth():
    return np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)


def test_one_bit_of_an_array_is_noticed(depth):
    changed = depth.copy()
    changed.view(np.uint32)[1, 2] ^= 1
    assert digest(depth) == digest(depth.copy()) != digest(changed)


def test_type_and_shape_are_noticed(depth):
    others = [depth.astype(np.float64), depth.view(np.int32), depth.T, depth.ravel(), depth.tolist()]
    assert len({digest(one) for one in (depth, *others)}) == 1 + len(others)


def test_a_value_deep_in_a_record_is_noticed():
    @dataclasses.dataclass
    class Record:
        rows: list

    assert digest(Record([{"a": (1, 2.0)}])) != digest(Record([{"a": (1, np.nextafter(2.0, 3))}]))
    assert digest([1, 2]) != digest([12]) != digest(["12"])
    with pytest.raises(TypeError, match="got object"):
        digest(object())


def test_the_member_of_a_file_is_named_and_the_time_of_its_writing_does_not_count(tmp_path, depth):
    files = [tmp_path / "a.npz", tmp_path / "b.npz"]
    np.savez(files[0], depth=depth, known=depth > 0)
    depth[0, 0] = 1e-30
    np.savez(files[1], depth=depth, known=depth > 1e-20)
    old, new = (dict(of_file(file)) for file in files)
    assert differences(old, new) == ["changed  , depth.npy"]


def test_what_only_one_has_is_listed():
    assert differences({"a": "1", "b": "2"}, {"b": "2", "c": "3"}) == ["gone     a", "added    c"]


@pytest.mark.parametrize(
    ("first", "second", "alike"),
    [
        (b'"created_utc": "2026-11-28T08:04:11Z"', b'"created_utc": "2026-11-29T18:14:01Z"', True),
        (b'"seconds": 1.25, "peak_mm": 0.5', b'"seconds": 2, "peak_mm": 0.5', True),
        (b'"seconds": 1.25, "peak_mm": 0.5', b'"seconds": 1.25, "peak_mm": 0.51', False),
    ],
)
def test_times_alone_do_not_count(first, second, alike):
    assert (lasting(first) == lasting(second)) is alike


def test_all_of_a_result_counts(calibration, presses):
    """Also what is computed on first use, and no attribute before."""
    reconstruct, image = gelform.Reconstructor(calibration), presses.presses[0].image
    old, again = (of_frames("presses", calibration, [image]) for _ in range(2))
    names = {name.partition(": ")[2] for name in old}
    fields = {one.name for one in dataclasses.fields(reconstruct(image))} - {"difference_source"}
    assert names >= fields | {
        "normals",
        "contacts",
        "depth_difference_sigma",
        "row of a batch",
        "page, depth",
    }
    assert differences(old, again) == []
    darker = image.copy()
    darker[tuple(size // 2 for size in image.shape[:2])] -= 1
    assert "changed  presses: curl_rms" in differences(old, of_frames("presses", calibration, [darker]))

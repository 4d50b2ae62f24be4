"""Settings that cannot be are refused with what was expected."""

import json

import pytest

from gelform.batch import KEPT, BatchSettings


def test_refused():
    for wrong, said in [
        ({"form": "jpg"}, "Expected a format among npz, png, zarr, hdf5, ffv1, lerobot, got 'jpg'"),
        ({"keep": ("depht",)}, "Expected maps to keep among depth, known"),
        ({"keep": ()}, "Expected maps to keep"),
        ({"keep": ("all", "depth")}, "Expected maps to keep"),
        ({"form": "png", "keep": ("depth", "contact")}, "Expected depth alone in 16 bits"),
        ({"keep": ("depth_sigma",), "depth_sigma": False}, "Leave out --no-sigma"),
        ({"solver": "fast"}, "Expected a solver among auto, dct"),
        ({"background_frames": -1}, "Expected 0 to 200 frames"),
        ({"part_frames": 0}, "at least one frame"),
    ]:
        with pytest.raises(ValueError, match=said):
            BatchSettings(**wrong)


def test_every_map_can_be_kept_and_said_in_json():
    facts = BatchSettings(keep=KEPT).facts()
    assert json.loads(json.dumps(facts)) == facts
    assert facts["keep"] == list(KEPT)


def test_sigma_of_slopes_where_it_is_used():
    for asked, needed in [
        ({}, True),
        ({"solver": "dct"}, True),
        ({"depth_sigma": False}, True),
        ({"solver": "dct", "depth_sigma": False}, False),
        ({"solver": "dct", "depth_sigma": False, "keep": ("depth", "confidence")}, True),
        ({"solver": "dct", "depth_sigma": False, "keep": ("all",)}, True),
    ]:
        assert BatchSettings(**asked).slope_sigma is needed
